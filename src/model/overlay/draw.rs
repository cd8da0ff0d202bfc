//! Draws the skin and the marks of a sheet.
//! PURE. Uses: `overlay::tiles`, sim-core's sensor, pdf-writer's content. Never: the structure of the
//! file. All lengths in mm.

use pdf_writer::{Content, Name, Str};
use sim_core::sensor::{Point, Sensor};

use super::tiles::{OVERLAP_MM, Sheet, Tiling};

/// Name of the font in the resources of a page.
pub(super) const PAGE_FONT: Name<'static> = Name(b"F1");
/// Ratio of the handles of a cubic arc of a quarter circle to its radius.
const QUARTER: f64 = 0.552_284_75;
/// Length of the ruler.
const RULER_MM: f64 = 100.0;
/// Height of the letters of a point's name.
const LABEL_MM: f64 = 3.0;
/// Radius of the disc of an electrode, and height of the letters in it.
const ELECTRODE_MM: f64 = 2.6;
const ELECTRODE_LABEL_MM: f64 = 2.2;
/// Half length of a cross at a point, and of a mark for cutting.
const CROSS_MM: f64 = 2.0;
const MARK_MM: f64 = 4.0;

const BLACK: [f32; 3] = [0.0, 0.0, 0.0];
const GREY: [f32; 3] = [0.6, 0.6, 0.6];
const PALE: [f32; 3] = [0.85, 0.85, 0.85];
const WHITE: [f32; 3] = [1.0, 1.0, 1.0];
const BLUE: [f32; 3] = [0.05, 0.3, 0.7];
const RED: [f32; 3] = [0.8, 0.1, 0.1];

/// Draws into the content of a page.
pub(super) struct Pen<'a> {
    content: &'a mut Content,
}

impl<'a> Pen<'a> {
    /// A pen whose unit is a millimetre.
    pub fn new(content: &'a mut Content) -> Self {
        Self { content }
    }

    /// The skin, as far as it is on a sheet.
    pub fn skin(&mut self, sensor: &Sensor, tiling: &Tiling, sheet: &Sheet) {
        let (margin, [width, height]) = (tiling.margin_mm as f32, tiling.part_mm());
        self.content.save_state();
        self.content.rect(margin, margin, width as f32, height as f32).clip_nonzero().end_path();
        let [x, y] = sheet.origin_mm.map(|mm| (tiling.margin_mm - mm) as f32);
        self.content.transform([1.0, 0.0, 0.0, 1.0, x, y]);
        let radius_mm = sensor.file.tip_diameter_mm / 2.0;
        let shown: Vec<&Point> = sensor
            .points()
            .iter()
            .filter(|p| tiling.shows(sheet, [p.x_mm, p.y_mm], radius_mm))
            .collect();
        for p in &shown {
            self.stroke(PALE, 0.12).circle([p.x_mm, p.y_mm], radius_mm).content.stroke();
        }
        for p in &shown {
            self.stroke(GREY, 0.2).hexagon([p.x_mm, p.y_mm], radius_mm).content.stroke();
        }
        for p in &shown {
            self.cross([p.x_mm, p.y_mm], CROSS_MM, BLACK, 0.25);
            self.text(&p.label(), [p.x_mm, p.y_mm - 5.5], LABEL_MM, BLACK, Align::Middle);
        }
        self.electrodes(sensor, tiling, sheet);
        self.stroke(BLACK, 0.5);
        let (width, height) = (sensor.file.width_mm, sensor.file.height_mm);
        self.content.rect(0.0, 0.0, width as f32, height as f32).stroke();
        self.legends(sensor);
        self.content.restore_state();
    }

    /// Electrodes with their indices in their discs: the names of points are next to them.
    fn electrodes(&mut self, sensor: &Sensor, tiling: &Tiling, sheet: &Sheet) {
        for (index, &[x, y]) in sensor.electrodes_mm().iter().enumerate() {
            if !tiling.shows(sheet, [x, y], 2.0 * LABEL_MM) {
                continue;
            }
            let [r, g, b] = BLUE;
            self.content.set_fill_rgb(r, g, b);
            self.circle([x, y], ELECTRODE_MM).content.fill_nonzero();
            let inside = [x, y - 0.36 * ELECTRODE_LABEL_MM];
            self.text(&format!("E{index}"), inside, ELECTRODE_LABEL_MM, WHITE, Align::Middle);
        }
    }

    /// Names of the rows at the left, those of the columns below, and the directions of x and y.
    fn legends(&mut self, sensor: &Sensor) {
        let size_mm = 1.3 * LABEL_MM;
        let (mut rows, mut columns) = (Vec::new(), Vec::new());
        for p in sensor.points() {
            if !rows.contains(&p.row) {
                rows.push(p.row);
                let at = [-1.5, p.y_mm - 0.35 * size_mm];
                self.text(&format!("R{}", p.row + 1), at, size_mm, BLACK, Align::End);
            }
            // Odd rows are shifted: the names are below the even ones.
            if p.row % 2 == 0 && !columns.contains(&p.column) {
                columns.push(p.column);
                let at = [p.x_mm, -1.5 - size_mm];
                self.text(&format!("C{}", p.column + 1), at, size_mm, BLACK, Align::Middle);
            }
        }
        let [long, short] = [18.0, 2.0];
        let [x, y] = [-6.0, -14.0];
        self.stroke(BLACK, 0.3);
        for (to, wing) in [([x + long, y], [-short, short]), ([x, y + long], [short, -short])] {
            self.line([x, y], to);
            self.line(to, [to[0] + wing[0], to[1] + wing[1]]);
            let other = [to[0] - short, to[1] - short];
            self.line(to, other);
        }
        self.text("x", [x + long + 2.0, y - 1.2], LABEL_MM, BLACK, Align::Start);
        self.text("y", [x, y + long + 1.5], LABEL_MM, BLACK, Align::Middle);
    }

    /// Lines along which neighbouring sheets are cut and joined, and the ruler.
    pub fn marks(&mut self, tiling: &Tiling, sheet: &Sheet) {
        let (margin, part) = (tiling.margin_mm, tiling.part_mm());
        let cuts: [Vec<f64>; 2] = std::array::from_fn(|axis| {
            let first = (sheet.at[axis] > 0).then_some(margin + OVERLAP_MM / 2.0);
            let last = (sheet.at[axis] + 1 < tiling.counts[axis])
                .then_some(margin + part[axis] - OVERLAP_MM / 2.0);
            first.into_iter().chain(last).collect()
        });
        let [ends_x, ends_y] = part.map(|mm| [margin, margin + mm]);
        for &x in &cuts[0] {
            self.dashed([x, ends_y[0]], [x, ends_y[1]]);
        }
        for &y in &cuts[1] {
            self.dashed([ends_x[0], y], [ends_x[1], y]);
        }
        let corners_x = cuts[0].iter().flat_map(|&x| cuts[1].iter().map(move |&y| [x, y]));
        let corners: Vec<[f64; 2]> = corners_x.collect();
        for at in corners {
            self.cross(at, MARK_MM, RED, 0.3);
        }
        // In the strip that is cut off, if a sheet is below this one.
        self.ruler([margin + 30.0, margin + 0.7]);
    }

    /// A ruler with a tick at every 10 mm: a print at another scale is found with it.
    fn ruler(&mut self, [x, y]: [f64; 2]) {
        self.content.set_fill_rgb(1.0, 1.0, 1.0);
        let height = OVERLAP_MM as f32 / 2.0;
        self.content.rect(x as f32 - 3.0, y as f32 - 0.7, 172.0, height).fill_nonzero();
        self.stroke(RED, 0.3).line([x, y], [x + RULER_MM, y]);
        for tick in 0..=10 {
            let long = if tick % 5 == 0 { 4.0 } else { 2.5 };
            let x = x + f64::from(tick) * RULER_MM / 10.0;
            self.line([x, y], [x, y + long]);
        }
        let words = "100 mm: if it is not, print again at 100 %";
        self.text(words, [x + RULER_MM + 3.0, y + 0.5], 3.0, RED, Align::Start);
    }

    /// Which sheet this is.
    pub fn caption(&mut self, name: &str, tiling: &Tiling, sheet: &Sheet) {
        let [columns, rows] = tiling.counts;
        let number = sheet.at[1] * columns + sheet.at[0] + 1;
        let words = match columns * rows {
            1 => format!("{name}, seen from above"),
            all => format!(
                "{name}, seen from above: sheet {number} of {all}, column {} of {columns} from the left, \
                 row {} of {rows} from the bottom",
                sheet.at[0] + 1,
                sheet.at[1] + 1
            ),
        };
        let at = [tiling.margin_mm + 2.0, tiling.margin_mm - 3.5];
        self.text(&words, at, 3.0, BLACK, Align::Start);
    }

    fn stroke(&mut self, [r, g, b]: [f32; 3], width_mm: f32) -> &mut Self {
        self.content.set_stroke_rgb(r, g, b).set_line_width(width_mm);
        self
    }

    fn circle(&mut self, [x, y]: [f64; 2], r: f64) -> &mut Self {
        let k = QUARTER * r;
        let at = |dx: f64, dy: f64| [(x + dx) as f32, (y + dy) as f32];
        let [x0, y0] = at(r, 0.0);
        self.content.move_to(x0, y0);
        for [a, b, c] in [
            [at(r, k), at(k, r), at(0.0, r)],
            [at(-k, r), at(-r, k), at(-r, 0.0)],
            [at(-r, -k), at(-k, -r), at(0.0, -r)],
            [at(k, -r), at(r, -k), at(r, 0.0)],
        ] {
            self.content.cubic_to(a[0], a[1], b[0], b[1], c[0], c[1]);
        }
        self.content.close_path();
        self
    }

    /// The hexagon of a point: its longest diagonal is the diameter of a tip, and is upright.
    fn hexagon(&mut self, [x, y]: [f64; 2], r: f64) -> &mut Self {
        for corner in 0..6 {
            let angle = (f64::from(corner) * 60.0 + 90.0).to_radians();
            let (cx, cy) = ((x + r * angle.cos()) as f32, (y + r * angle.sin()) as f32);
            if corner == 0 {
                self.content.move_to(cx, cy);
            } else {
                self.content.line_to(cx, cy);
            }
        }
        self.content.close_path();
        self
    }

    fn line(&mut self, from: [f64; 2], to: [f64; 2]) {
        self.content.move_to(from[0] as f32, from[1] as f32);
        self.content.line_to(to[0] as f32, to[1] as f32).stroke();
    }

    fn dashed(&mut self, from: [f64; 2], to: [f64; 2]) {
        self.stroke(RED, 0.15);
        self.content.set_dash_pattern([2.0, 2.0], 0.0);
        self.line(from, to);
        self.content.set_dash_pattern([], 0.0);
    }

    fn cross(&mut self, [x, y]: [f64; 2], half: f64, colour: [f32; 3], width_mm: f32) {
        self.stroke(colour, width_mm);
        self.line([x - half, y], [x + half, y]);
        self.line([x, y - half], [x, y + half]);
    }

    fn text(&mut self, words: &str, at: [f64; 2], size_mm: f64, [r, g, b]: [f32; 3], align: Align) {
        let width = size_mm * words.chars().map(width_em).sum::<f64>();
        let x = match align {
            Align::Start => at[0],
            Align::Middle => at[0] - width / 2.0,
            Align::End => at[0] - width,
        };
        self.content.set_fill_rgb(r, g, b);
        self.content.begin_text().set_font(PAGE_FONT, size_mm as f32);
        self.content.next_line(x as f32, at[1] as f32).show(Str(words.as_bytes())).end_text();
    }
}

/// Part of a text that is at its position.
#[derive(Debug, Clone, Copy)]
enum Align {
    Start,
    Middle,
    End,
}

/// Width of a character of Helvetica, as a share of the font's size: exact for what is centred.
fn width_em(c: char) -> f64 {
    match c {
        'R' | 'C' => 0.722,
        'E' => 0.667,
        ' ' => 0.278,
        'x' | 'y' => 0.5,
        _ => 0.556,
    }
}
