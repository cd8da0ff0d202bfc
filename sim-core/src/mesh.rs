//! The hexagonal mesh (`docs/references.md`, "Skin geometry"): a triangular lattice of nodes, its
//! rhombic bricks, and the positions of the points on it.
//! Uses: `sensor`. Never: materials, forces, resistances.
//!
//! Nodes are at `x = X0 + (P/2) m`, `y = Y0 + (A/2) q` with `m + q` even, wherever that is on the
//! skin (A = the hexagon's side, P = A sqrt 3). A third of them, the points' sub-lattice, touch six
//! rhombi; the others touch three. A rhombus is the two triangles on either side of an edge between
//! two three-valent nodes; at the rim some triangles have no partner and become collapsed bricks.

use std::collections::HashMap;

use crate::sensor::{Layer, Sensor};

/// Why a sensor file has no mesh; points and the vertices of their hexagons count from 0.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum MeshError {
    #[error("meshing: point {point} at ({x_mm:.3}, {y_mm:.3}) mm is not a six-valent node")]
    PointOffNode { point: usize, x_mm: f64, y_mm: f64 },
    #[error("meshing: vertex {vertex} of point {point} is not on the skin")]
    VertexOffSkin { point: usize, vertex: usize },
}

/// A contact point on the mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PointNodes {
    /// The node under the tip's centre.
    pub centre: u32,
    /// The nodes under the hexagon's vertices, counter-clockwise from +y. A tip loads these nodes.
    pub vertices: [u32; 6],
}

/// Position on the mesh: three nodes and their barycentric weights (sum 1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeshPlace {
    /// Nodes of the triangle.
    pub nodes: [u32; 3],
    /// Weight of each node, >= 0.
    pub weights: [f64; 3],
}

/// One sheet of bricks through the thickness.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BrickSheet {
    /// Height of the bricks, mm.
    pub height_mm: f64,
    /// Young's modulus, MPa.
    pub youngs_mpa: f64,
    /// Poisson's ratio, in [0, 0.5).
    pub poisson: f64,
}

/// The mesh: a plane of nodes and cells, repeated through the layers.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    /// Position of each node in the plane, mm.
    pub nodes_mm: Vec<[f64; 2]>,
    /// Triangles of the resistive sheet, counter-clockwise; the six-valent node first.
    pub triangles: Vec<[u32; 3]>,
    /// Brick outlines, counter-clockwise; the rhombi first, then the collapsed rim triangles, whose
    /// first and last node are the same.
    pub cells: Vec<[u32; 4]>,
    /// Number of `cells` that are rhombi.
    pub rhombi: usize,
    /// Bricks through the thickness, from the bottom up.
    pub sheets: Vec<BrickSheet>,
    /// Node levels of the foam's bottom and top face (level 0 is the skin's bottom).
    pub foam_levels: [usize; 2],
    /// The points, in the sensor's order.
    pub points: Vec<PointNodes>,
}

/// Lattice coordinates of a node: `x = X0 + (P/2) m`, `y = Y0 + (A/2) q`.
type Lattice = (i32, i32);

/// The six neighbours of a node, counter-clockwise from +y.
const NEIGHBOURS: [Lattice; 6] = [(0, 2), (-1, 1), (-1, -1), (0, -2), (1, -1), (1, 1)];

/// Positions closer than this are the same, mm.
const SAME_PLACE_MM: f64 = 1e-6;

impl Mesh {
    /// Meshes the skin of a sensor.
    ///
    /// # Errors
    /// `MeshError` if a point or a vertex of its hexagon is not on a suitable node.
    pub fn new(sensor: &Sensor) -> Result<Self, MeshError> {
        let lattice = LatticeNodes::new(sensor);
        let triangles = triangles(&lattice);
        let (cells, rhombi) = cells(&triangles);
        let points = points(sensor, &lattice)?;
        let layers = &sensor.file.layers;
        let sheets: Vec<BrickSheet> =
            [&layers.bottom, &layers.foam, &layers.top].into_iter().flat_map(sheets_of).collect();
        let foam_bottom = layers.bottom.elements as usize;
        let foam_levels = [foam_bottom, foam_bottom + layers.foam.elements as usize];
        Ok(Self {
            nodes_mm: lattice.places_mm,
            triangles,
            cells,
            rhombi,
            sheets,
            foam_levels,
            points,
        })
    }

    /// Number of nodes in one level.
    pub fn plane_nodes(&self) -> usize {
        self.nodes_mm.len()
    }

    /// Number of node levels through the thickness.
    pub fn levels(&self) -> usize {
        self.sheets.len() + 1
    }

    /// Height of each node level above the bottom, mm.
    pub fn level_heights_mm(&self) -> Vec<f64> {
        let mut heights = vec![0.0];
        for sheet in &self.sheets {
            heights.push(heights[heights.len() - 1] + sheet.height_mm);
        }
        heights
    }

    /// Area of the plane that belongs to each node (a third of each of its triangles), mm2.
    pub fn node_areas_mm2(&self) -> Vec<f64> {
        let mut areas = vec![0.0; self.plane_nodes()];
        for triangle in &self.triangles {
            let third = self.triangle_area_mm2(triangle) / 3.0;
            for &node in triangle {
                areas[node as usize] += third;
            }
        }
        areas
    }

    /// Area of a triangle, mm2; positive when counter-clockwise.
    pub fn triangle_area_mm2(&self, triangle: &[u32; 3]) -> f64 {
        let [a, b, c] = triangle.map(|n| self.nodes_mm[n as usize]);
        0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]))
    }

    /// Centre of a triangle, mm.
    pub fn triangle_centre_mm(&self, triangle: &[u32; 3]) -> [f64; 2] {
        [0, 1].map(|axis| {
            triangle.iter().map(|&n| self.nodes_mm[n as usize][axis]).sum::<f64>() / 3.0
        })
    }

    /// Returns the triangle that contains a position, mm, or the nearest position on the mesh. A
    /// position on a node has that node with weight 1.
    pub fn locate(&self, at_mm: [f64; 2]) -> MeshPlace {
        let mut best = MeshPlace { nodes: [0; 3], weights: [1.0, 0.0, 0.0] };
        let mut best_depth = f64::NEG_INFINITY;
        for triangle in &self.triangles {
            let weights = self.barycentric(triangle, at_mm);
            let depth = weights.iter().copied().fold(f64::INFINITY, f64::min);
            if depth > best_depth {
                best_depth = depth;
                best = MeshPlace { nodes: *triangle, weights };
            }
        }
        for (k, &node) in best.nodes.iter().enumerate() {
            let [x, y] = self.nodes_mm[node as usize];
            if (x - at_mm[0]).hypot(y - at_mm[1]) < SAME_PLACE_MM {
                best.weights = [0.0; 3];
                best.weights[k] = 1.0;
                return best;
            }
        }
        let clamped = best.weights.map(|w| w.max(0.0));
        let sum: f64 = clamped.iter().sum();
        best.weights = clamped.map(|w| w / sum);
        best
    }

    /// Slopes of a located position's weights in x and y, 1/mm; on an edge, those of its triangle.
    /// Outside the mesh, where weights are clamped, those of the clamped weights.
    pub fn weight_slopes(&self, place: &MeshPlace, at_mm: [f64; 2]) -> [[f64; 2]; 3] {
        let [a, b, c] = place.nodes.map(|n| self.nodes_mm[n as usize]);
        let whole = 2.0 * self.triangle_area_mm2(&place.nodes);
        let along = |p: [f64; 2], q: [f64; 2]| [(p[1] - q[1]) / whole, (q[0] - p[0]) / whole];
        let raw = self.barycentric(&place.nodes, at_mm);
        let mut slopes = [along(b, c), along(c, a), along(a, b)];
        let beyond = |k: usize| raw[k] < 0.0 && place.weights[k] == 0.0;
        if (0..3).any(beyond) {
            for k in (0..3).filter(|&k| beyond(k)) {
                slopes[k] = [0.0; 2];
            }
            let sum: f64 = raw.iter().map(|w| w.max(0.0)).sum();
            let total = [0, 1].map(|axis| slopes.iter().map(|s| s[axis]).sum::<f64>());
            for (slope, weight) in slopes.iter_mut().zip(place.weights) {
                for (s, total) in slope.iter_mut().zip(total) {
                    *s = (*s - weight * total) / sum;
                }
            }
        }
        slopes
    }

    fn barycentric(&self, triangle: &[u32; 3], [x, y]: [f64; 2]) -> [f64; 3] {
        let [a, b, c] = triangle.map(|n| self.nodes_mm[n as usize]);
        let twice = |p: [f64; 2], q: [f64; 2]| (p[0] - x) * (q[1] - y) - (q[0] - x) * (p[1] - y);
        let whole = 2.0 * self.triangle_area_mm2(triangle);
        [twice(b, c) / whole, twice(c, a) / whole, twice(a, b) / whole]
    }
}

fn sheets_of(layer: &Layer) -> impl Iterator<Item = BrickSheet> {
    let count = layer.elements as usize;
    let sheet = BrickSheet {
        height_mm: layer.thickness_mm / f64::from(layer.elements),
        youngs_mpa: layer.youngs_mpa,
        poisson: layer.poisson,
    };
    std::iter::repeat_n(sheet, count)
}

/// The nodes of the plane, column by column.
struct LatticeNodes {
    coordinates: Vec<Lattice>,
    places_mm: Vec<[f64; 2]>,
    index: HashMap<Lattice, u32>,
    origin_mm: [f64; 2],
    step_mm: [f64; 2],
}

impl LatticeNodes {
    fn new(sensor: &Sensor) -> Self {
        let origin_mm = [sensor.first_column_x_mm(), sensor.file.points.first_row_y_mm];
        let step_mm = [sensor.pitch_mm() / 2.0, sensor.side_mm() / 2.0];
        let range = |axis: usize, extent: f64| {
            let low = ((-SAME_PLACE_MM - origin_mm[axis]) / step_mm[axis]).ceil() as i32;
            let high = ((extent + SAME_PLACE_MM - origin_mm[axis]) / step_mm[axis]).floor() as i32;
            low..=high
        };
        let mut nodes = Self {
            coordinates: Vec::new(),
            places_mm: Vec::new(),
            index: HashMap::new(),
            origin_mm,
            step_mm,
        };
        for m in range(0, sensor.file.width_mm) {
            for q in range(1, sensor.file.height_mm).filter(|q| (m + q) % 2 == 0) {
                nodes.index.insert((m, q), nodes.coordinates.len() as u32);
                nodes.coordinates.push((m, q));
                nodes.places_mm.push([
                    origin_mm[0] + step_mm[0] * f64::from(m),
                    origin_mm[1] + step_mm[1] * f64::from(q),
                ]);
            }
        }
        nodes
    }

    fn neighbour(&self, (m, q): Lattice, (dm, dq): Lattice) -> Option<u32> {
        self.index.get(&(m + dm, q + dq)).copied()
    }

    /// Lattice coordinates of the node at a position, if there is one.
    fn at(&self, x_mm: f64, y_mm: f64) -> Option<Lattice> {
        let m = ((x_mm - self.origin_mm[0]) / self.step_mm[0]).round() as i32;
        let q = ((y_mm - self.origin_mm[1]) / self.step_mm[1]).round() as i32;
        let [x, y] = self.places_mm[*self.index.get(&(m, q))? as usize];
        ((x - x_mm).hypot(y - y_mm) < SAME_PLACE_MM).then_some((m, q))
    }
}

/// Whether lattice coordinates belong to the points' sub-lattice.
fn is_six_valent((m, q): Lattice) -> bool {
    (q - 3 * m.rem_euclid(2)).rem_euclid(6) == 0
}

fn triangles(lattice: &LatticeNodes) -> Vec<[u32; 3]> {
    let mut out = Vec::new();
    for (node, &place) in lattice.coordinates.iter().enumerate() {
        for (first, second) in [((1, -1), (1, 1)), ((1, 1), (0, 2))] {
            let (Some(b), Some(c)) =
                (lattice.neighbour(place, first), lattice.neighbour(place, second))
            else {
                continue;
            };
            let mut triangle = [node as u32, b, c];
            let centre = triangle
                .iter()
                .position(|&n| is_six_valent(lattice.coordinates[n as usize]))
                .expect("every lattice triangle has one node of the points' sub-lattice");
            triangle.rotate_left(centre);
            out.push(triangle);
        }
    }
    out
}

/// Pairs triangles over their edge between three-valent nodes; the unpaired ones collapse at their
/// six-valent node. Returns the cells and the number of rhombi.
fn cells(triangles: &[[u32; 3]]) -> (Vec<[u32; 4]>, usize) {
    let mut by_edge: HashMap<[u32; 2], u32> = HashMap::new();
    for &[centre, a, b] in triangles {
        by_edge.insert([a, b], centre);
    }
    let (mut rhombi, mut rim) = (Vec::new(), Vec::new());
    for &[centre, a, b] in triangles {
        match by_edge.get(&[b, a]) {
            Some(&other) if centre < other => rhombi.push([centre, a, other, b]),
            Some(_) => {}
            None => rim.push([centre, a, b, centre]),
        }
    }
    let count = rhombi.len();
    rhombi.append(&mut rim);
    (rhombi, count)
}

fn points(sensor: &Sensor, lattice: &LatticeNodes) -> Result<Vec<PointNodes>, MeshError> {
    let mut out = Vec::with_capacity(sensor.points().len());
    for (point, p) in sensor.points().iter().enumerate() {
        let place = lattice
            .at(p.x_mm, p.y_mm)
            .filter(|&place| is_six_valent(place))
            .ok_or(MeshError::PointOffNode { point, x_mm: p.x_mm, y_mm: p.y_mm })?;
        let mut vertices = [0; 6];
        for (vertex, step) in NEIGHBOURS.into_iter().enumerate() {
            vertices[vertex] =
                lattice.neighbour(place, step).ok_or(MeshError::VertexOffSkin { point, vertex })?;
        }
        out.push(PointNodes { centre: lattice.index[&place], vertices });
    }
    Ok(out)
}
