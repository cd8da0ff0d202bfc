//! The deformed skin as in the paper's Fig. 4C: the bricks around the contacts in oblique view,
//! coloured by the foam's compression, with the point forces on them.
//! PURE. Uses: sim-core's mesh and displacement field, `svg`. Never: files, solving.
//!
//! Heights and depths are stretched by a factor that the figure states. SVG text is written here,
//! since plotters rounds coordinates to whole pixels.

mod axes;
mod svg;

use std::collections::BTreeSet;

use sim_core::deformation::{Deformation, NodeForce};
use sim_core::forward::Contact;
use sim_core::mesh::Mesh;

use svg::{Colour, Drawing, View};

/// Width of the figure, px.
const WIDTH: f64 = 1020.0;
/// Box of the skin on the figure: left, top, right, bottom, px. Its bottom extends as needed.
const STAGE: [f64; 4] = [60.0, 56.0, 835.0, 720.0];
/// Margin around the outermost contacts, mm.
const MARGIN_MM: f64 = 55.0;
/// Turn and elevation of the view, degrees.
const VIEW_DEG: [f64; 2] = [-28.0, 36.0];
/// Factor on heights and depths.
const STRETCH: f64 = 5.0;
/// Sides of a brick are divided into patches if their colours differ by more than this share of the
/// scale.
const SMOOTH: f64 = 0.03;
/// Number of patches along an edge.
const PATCHES: usize = 4;
/// Longest arrow, as a share of the part's longer side.
const ARROW_SHARE: f64 = 0.17;
/// Forces below this share of the largest have no arrow.
const LEAST_ARROW: f64 = 0.02;
/// Forces within this distance belong to a contact's label, mm.
const LABEL_NEAR_MM: f64 = 15.0;
/// Colour of forces.
const ARROW: Colour = [28.0, 79.0, 156.0];
/// Colours of the fabric, seen from the side.
const FABRIC: [Colour; 2] = [[96.0, 104.0, 116.0], [70.0, 78.0, 90.0]];
/// Colours of the compression from zero to the maximum: lightness decreases evenly.
const SCALE: [Colour; 6] = [
    [247.0, 244.0, 236.0],
    [250.0, 220.0, 150.0],
    [245.0, 170.0, 90.0],
    [222.0, 108.0, 72.0],
    [168.0, 52.0, 82.0],
    [88.0, 18.0, 80.0],
];

/// Contents of the figure.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// Mesh of the skin.
    pub mesh: &'a Mesh,
    /// Its displacement under the forces.
    pub deformation: &'a Deformation,
    /// The contacts, for the labels.
    pub contacts: &'a [Contact],
    /// The equivalent nodal forces.
    pub forces: &'a [NodeForce],
    /// Start of the caption.
    pub title: &'a str,
}

/// Draws the figure as SVG.
pub fn draw(scene: &Scene<'_>) -> String {
    let part = Part::around(scene);
    let most_mm = axes::round_up(part.most_compression_mm(scene));
    let faces = part.faces(scene, most_mm);
    let arrows = arrows(scene, &part);
    let all = faces.iter().flat_map(|f| f.corners).chain(part.floor());
    let all: Vec<_> = all.chain(arrows.iter().flat_map(|a| [a.from, a.to])).collect();
    let view = View::new(VIEW_DEG, STRETCH).fit(&all, STAGE);
    let lowest = all.iter().map(|&c| view.place(c)[1]).fold(0.0, f64::max);
    let height = (lowest + 70.0).max(480.0);

    let mut out = Drawing::new([WIDTH, height]);
    out.group("fill=\"#222\" font-size=\"17\"");
    out.words([24.0, 32.0], "start", scene.title);
    out.end_group();
    axes::draw(&mut out, &view, &part);
    out.group("stroke=\"#3c3c46\" stroke-width=\"0.4\" stroke-linejoin=\"round\"");
    for face in nearest_last(faces, &view) {
        for (corners, colour) in &face.patches {
            out.patch(&corners.map(|c| view.place(c)), *colour);
        }
        out.outline(&face.corners.map(|c| view.place(c)));
    }
    out.end_group();
    draw_arrows(&mut out, &view, &arrows, scene.contacts);
    axes::colour_bar(&mut out, [908.0, 130.0, 928.0, height - 110.0], most_mm);
    out.group("fill=\"#555\" font-size=\"13\"");
    out.words([24.0, height - 16.0], "start", &part.caption());
    out.end_group();
    out.finish()
}

/// The part of the skin that is shown.
struct Part {
    /// Range of its nodes along x and y, mm: `[from, to]`.
    range_mm: [[f64; 2]; 2],
    cells: Vec<[u32; 4]>,
    /// Height of the unloaded skin, mm.
    height_mm: f64,
}

/// A quadrilateral in space, mm.
type Quad = [[f64; 3]; 4];

/// A side of a brick, in patches of one colour each.
struct Face {
    corners: Quad,
    patches: Vec<(Quad, Colour)>,
}

impl Part {
    /// The contacts and a margin; the whole skin without contacts.
    fn around(scene: &Scene<'_>) -> Self {
        let skin = range(scene.mesh.nodes_mm.iter().copied());
        let range_mm = if scene.contacts.is_empty() {
            skin
        } else {
            let around = range(scene.contacts.iter().map(|c| [c.x_mm, c.y_mm]));
            [0, 1].map(|axis| {
                let [from, to] = around[axis];
                [(from - MARGIN_MM).max(skin[axis][0]), (to + MARGIN_MM).min(skin[axis][1])]
            })
        };
        let inside = |cell: &&[u32; 4]| {
            let corners: BTreeSet<u32> = cell.iter().copied().collect();
            [0, 1].into_iter().all(|axis| {
                let sum: f64 = corners.iter().map(|&n| scene.mesh.nodes_mm[n as usize][axis]).sum();
                let [from, to] = range_mm[axis];
                (from..=to).contains(&(sum / corners.len() as f64))
            })
        };
        let cells: Vec<_> = scene.mesh.cells.iter().filter(inside).copied().collect();
        let range_mm = range(cells.iter().flatten().map(|&n| scene.mesh.nodes_mm[n as usize]));
        let height_mm = scene.mesh.sheets.iter().map(|s| s.height_mm).sum();
        Self { range_mm, cells, height_mm }
    }

    fn caption(&self) -> String {
        format!(
            "Heights and depths are drawn {STRETCH} times as large as lengths and widths. Sides: \
             fabric, foam, fabric. Arrows: point forces on the mesh's nodes."
        )
    }

    fn longer_mm(&self) -> f64 {
        self.range_mm.iter().map(|[from, to]| to - from).fold(0.0, f64::max)
    }

    fn floor(&self) -> [[f64; 3]; 4] {
        let [[x0, x1], [y0, y1]] = self.range_mm;
        [[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]]
    }

    fn most_compression_mm(&self, scene: &Scene<'_>) -> f64 {
        let nodes = self.cells.iter().flatten();
        nodes.map(|&n| scene.deformation.compression_mm(n as usize)).fold(0.0, f64::max)
    }

    /// The top of every cell, and the bricks' sides at the boundary of the part.
    fn faces(&self, scene: &Scene<'_>, most_mm: f64) -> Vec<Face> {
        let heights = scene.mesh.level_heights_mm();
        let moved = |level: usize, node: u32| {
            let [x, y] = scene.mesh.nodes_mm[node as usize];
            let [dx, dy, dz] = scene.deformation.at(level, node as usize);
            [x + dx, y + dy, heights[level] + dz]
        };
        let share = |n: u32| scene.deformation.compression_mm(n as usize) / most_mm;
        let surface = scene.mesh.levels() - 1;
        let tops = self
            .cells
            .iter()
            .map(|cell| Face::coloured(cell.map(|n| moved(surface, n)), cell.map(share)));
        let [foam, top] = scene.mesh.foam_levels;
        let rim = self.rim();
        let sides = rim.iter().flat_map(|&[a, b]| {
            (0..surface).map(move |level| {
                let corners = [(level, a), (level, b), (level + 1, b), (level + 1, a)];
                (level, corners, [a, b, b, a].map(share))
            })
        });
        let sides = sides.map(|(level, corners, shares)| {
            let corners = corners.map(|(level, node)| moved(level, node));
            match level {
                level if level < foam => Face::plain(corners, FABRIC[0]),
                level if level >= top => Face::plain(corners, FABRIC[1]),
                _ => Face::coloured(corners, shares),
            }
        });
        tops.chain(sides).collect()
    }

    /// Edges that belong to a single cell.
    fn rim(&self) -> Vec<[u32; 2]> {
        let edges = |cell: &[u32; 4]| {
            let next = [cell[1], cell[2], cell[3], cell[0]];
            [0, 1, 2, 3].map(|i| [cell[i], next[i]])
        };
        let all: BTreeSet<[u32; 2]> = self.cells.iter().flat_map(edges).collect();
        let single = |&[a, b]: &[u32; 2]| a != b && !all.contains(&[b, a]);
        all.iter().copied().filter(single).collect()
    }
}

impl Face {
    fn plain(corners: Quad, colour: Colour) -> Self {
        Self { corners, patches: vec![(corners, colour)] }
    }

    /// Coloured by shares of the scale at its corners, and shaded by its slope.
    fn coloured(corners: Quad, shares: [f64; 4]) -> Self {
        let [low, high] =
            shares.iter().fold([f64::MAX, f64::MIN], |[l, h], &s| [l.min(s), h.max(s)]);
        let n = if high - low > SMOOTH { PATCHES } else { 1 };
        let light = light(&corners);
        let at = |i: usize| i as f64 / n as f64;
        let patches = (0..n * n).map(|k| {
            let (i, j) = (k % n, k / n);
            let ends = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)];
            let quad = ends.map(|(i, j)| {
                let weights = bilinear(at(i), at(j));
                std::array::from_fn(|axis| weighted(weights, corners.map(|c| c[axis])))
            });
            let middle = bilinear(at(i) + 0.5 / n as f64, at(j) + 0.5 / n as f64);
            (quad, compression_colour(weighted(middle, shares)).map(|v| v * light))
        });
        Self { corners, patches: patches.collect() }
    }
}

/// Weights of a quadrilateral's corners at a position of the unit square.
fn bilinear(u: f64, v: f64) -> [f64; 4] {
    [(1.0 - u) * (1.0 - v), u * (1.0 - v), u * v, (1.0 - u) * v]
}

fn weighted(weights: [f64; 4], values: [f64; 4]) -> f64 {
    weights.iter().zip(values).map(|(w, v)| w * v).sum()
}

/// Smallest and largest x and y of positions.
fn range(places: impl Iterator<Item = [f64; 2]>) -> [[f64; 2]; 2] {
    let mut range = [[f64::MAX, f64::MIN]; 2];
    for place in places {
        for axis in 0..2 {
            range[axis] = [range[axis][0].min(place[axis]), range[axis][1].max(place[axis])];
        }
    }
    range
}

/// Order of painting: nearer faces cover farther ones.
fn nearest_last(mut faces: Vec<Face>, view: &View) -> Vec<Face> {
    let distance = |f: &Face| f.corners.iter().map(|&c| view.distance(c)).sum::<f64>();
    faces.sort_by(|a, b| distance(b).total_cmp(&distance(a)));
    faces
}

/// Colour of a share of the scale, 0 to 1.
fn compression_colour(share: f64) -> Colour {
    let place = share.clamp(0.0, 1.0) * (SCALE.len() - 1) as f64;
    let below = (place as usize).min(SCALE.len() - 2);
    let part = place - below as f64;
    std::array::from_fn(|i| SCALE[below][i] + part * (SCALE[below + 1][i] - SCALE[below][i]))
}

/// Lightness of a face, 1 for a level one: faces that slope away are darker.
fn light(corners: &Quad) -> f64 {
    const LIGHT: [f64; 3] = [-0.45, -0.25, 0.857];
    let edge = |a: [f64; 3], b: [f64; 3]| [b[0] - a[0], b[1] - a[1], STRETCH * (b[2] - a[2])];
    let (p, q) = (edge(corners[0], corners[2]), edge(corners[1], corners[3]));
    let normal = [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]];
    let length = normal.iter().map(|n| n * n).sum::<f64>().sqrt();
    let lit: f64 = normal.iter().zip(LIGHT).map(|(n, l)| n * l).sum();
    (1.0 + 0.35 * (lit / length.max(1e-12) - LIGHT[2])).clamp(0.75, 1.04)
}

/// A point force.
struct Arrow {
    from: [f64; 3],
    to: [f64; 3],
}

fn arrows(scene: &Scene<'_>, part: &Part) -> Vec<Arrow> {
    let most_n = scene.forces.iter().map(|f| f.force_n).fold(0.0, f64::max);
    let surface = scene.mesh.levels() - 1;
    let arrow = |force: &NodeForce| {
        let [x, y] = scene.mesh.nodes_mm[force.node as usize];
        let [dx, dy, dz] = scene.deformation.at(surface, force.node as usize);
        let to = [x + dx, y + dy, part.height_mm + dz];
        let length = ARROW_SHARE * part.longer_mm() / STRETCH * force.force_n / most_n;
        Arrow { from: [to[0], to[1], to[2] + length], to }
    };
    scene.forces.iter().filter(|f| f.force_n > LEAST_ARROW * most_n).map(arrow).collect()
}

/// Draws the point forces, and the total force above those of each contact.
fn draw_arrows(out: &mut Drawing, view: &View, arrows: &[Arrow], contacts: &[Contact]) {
    out.group("stroke=\"#1c4f9c\" stroke-width=\"1.3\"");
    for arrow in arrows {
        let ([x, y], from) = (view.place(arrow.to), view.place(arrow.from));
        out.stroke(from, [x, y - 4.0]);
        out.polygon(&[[x, y], [x - 2.6, y - 6.0], [x + 2.6, y - 6.0]], ARROW);
    }
    out.end_group();
    out.group("fill=\"#16407f\" font-size=\"15\" font-weight=\"bold\"");
    for contact in contacts.iter().filter(|c| c.force_n > 0.0) {
        let near =
            |a: &&Arrow| (a.from[0] - contact.x_mm).hypot(a.from[1] - contact.y_mm) < LABEL_NEAR_MM;
        let tops = arrows.iter().filter(near).map(|a| view.place(a.from)[1]);
        let [x, _] = view.place([contact.x_mm, contact.y_mm, 0.0]);
        let y = tops.fold(f64::MAX, f64::min);
        out.words([x, y - 6.0], "middle", &format!("{} N", axes::number(contact.force_n)));
    }
    out.end_group();
}
