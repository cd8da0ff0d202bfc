//! A drawing as SVG text, and the oblique projection of positions on the skin.
//! PURE. Uses: nothing. Never: the meaning of the drawing.

use std::fmt::{Arguments, Write as _};

/// Red, green, blue, 0 to 255.
pub type Colour = [f64; 3];

/// A drawing to which elements are added; lengths in pixels, y down.
#[derive(Debug)]
pub struct Drawing {
    text: String,
}

impl Drawing {
    /// Starts an empty white drawing of this width and height.
    pub fn new([width, height]: [f64; 2]) -> Self {
        let mut drawing = Self { text: String::new() };
        drawing.line(format_args!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" font-family=\"Helvetica, Arial, sans-serif\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"white\"/>"
        ));
        drawing
    }

    /// Returns the SVG text.
    pub fn finish(mut self) -> String {
        self.line(format_args!("</svg>"));
        self.text
    }

    /// Starts a group of elements that share attributes; it ends with [`Drawing::end_group`].
    pub fn group(&mut self, attributes: &str) {
        self.line(format_args!("<g {attributes}>"));
    }

    /// Ends the last group.
    pub fn end_group(&mut self) {
        self.line(format_args!("</g>"));
    }

    /// Adds a filled polygon with the group's stroke.
    pub fn polygon(&mut self, places: &[[f64; 2]], fill: Colour) {
        let (points, fill) = (points(places), hex(fill));
        self.line(format_args!("<polygon points=\"{points}\" fill=\"{fill}\"/>"));
    }

    /// Adds a polygon whose stroke has its fill colour, so that no seam is visible between
    /// neighbours.
    pub fn patch(&mut self, places: &[[f64; 2]], fill: Colour) {
        let (points, fill) = (points(places), hex(fill));
        self.line(format_args!("<polygon points=\"{points}\" fill=\"{fill}\" stroke=\"{fill}\"/>"));
    }

    /// Adds a closed line with the group's stroke.
    pub fn outline(&mut self, places: &[[f64; 2]]) {
        let points = points(places);
        self.line(format_args!("<polygon points=\"{points}\" fill=\"none\"/>"));
    }

    /// Adds a straight line with the group's stroke.
    pub fn stroke(&mut self, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2]) {
        self.line(format_args!(
            "<line x1=\"{x1:.2}\" y1=\"{y1:.2}\" x2=\"{x2:.2}\" y2=\"{y2:.2}\"/>"
        ));
    }

    /// Adds text at a position; `anchor` is start, middle or end.
    pub fn words(&mut self, [x, y]: [f64; 2], anchor: &str, words: &str) {
        let words = words.replace('&', "&amp;").replace('<', "&lt;");
        self.line(format_args!(
            "<text x=\"{x:.2}\" y=\"{y:.2}\" text-anchor=\"{anchor}\">{words}</text>"
        ));
    }

    fn line(&mut self, text: Arguments<'_>) {
        self.text.write_fmt(text).expect("a String takes any text");
        self.text.push('\n');
    }
}

fn points(places: &[[f64; 2]]) -> String {
    places.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect::<Vec<_>>().join(" ")
}

fn hex([r, g, b]: Colour) -> String {
    let byte = |v: f64| v.round().clamp(0.0, 255.0) as u8;
    format!("#{:02x}{:02x}{:02x}", byte(r), byte(g), byte(b))
}

/// Parallel projection from the front, above and a little to the side; heights are stretched.
#[derive(Debug, Clone, Copy)]
pub struct View {
    /// Sine and cosine of the rotation about the vertical.
    turn: [f64; 2],
    /// Sine and cosine of the viewer's elevation.
    elevation: [f64; 2],
    stretch: f64,
    scale: f64,
    origin: [f64; 2],
}

impl View {
    /// Defines a view of stretched coordinates, in millimetres; [`View::fit`] scales it to the
    /// drawing. `angles_deg`: rotation about the vertical, and elevation of the viewer.
    pub fn new(angles_deg: [f64; 2], stretch: f64) -> Self {
        let [turn, elevation] = angles_deg.map(|deg: f64| {
            let (sin, cos) = deg.to_radians().sin_cos();
            [sin, cos]
        });
        Self { turn, elevation, stretch, scale: 1.0, origin: [0.0; 2] }
    }

    /// Scales and shifts the view so that all of these positions are in a box (left, top, right,
    /// bottom, px), as high as possible.
    pub fn fit(mut self, places: &[[f64; 3]], [left, top, right, bottom]: [f64; 4]) -> Self {
        let (mut low, mut high) = ([f64::MAX; 2], [f64::MIN; 2]);
        for place in places.iter().map(|&p| self.project(p)) {
            for axis in 0..2 {
                low[axis] = low[axis].min(place[axis]);
                high[axis] = high[axis].max(place[axis]);
            }
        }
        let [wide, tall] = [0, 1].map(|axis| (high[axis] - low[axis]).max(1e-9));
        let scale = ((right - left) / wide).min((bottom - top) / tall);
        self.origin =
            [(left + right) / 2.0 - scale * (low[0] + high[0]) / 2.0, top + scale * high[1]];
        self.scale = scale;
        self
    }

    /// Projects a position (mm; z up) to the drawing, px.
    pub fn place(&self, place: [f64; 3]) -> [f64; 2] {
        let [x, y] = self.project(place);
        [self.origin[0] + self.scale * x, self.origin[1] - self.scale * y]
    }

    /// Distance of a position from the viewer, mm, up to a constant.
    pub fn distance(&self, [x, y, z]: [f64; 3]) -> f64 {
        self.away([x, y]) * self.elevation[1] - self.stretch * z * self.elevation[0]
    }

    /// Distance of a position in the plane from the viewer along the plane, mm.
    pub fn away(&self, [x, y]: [f64; 2]) -> f64 {
        y * self.turn[1] - x * self.turn[0]
    }

    fn project(&self, [x, y, z]: [f64; 3]) -> [f64; 2] {
        let across = x * self.turn[1] + y * self.turn[0];
        let up = self.away([x, y]) * self.elevation[0] + self.stretch * z * self.elevation[1];
        [across, up]
    }
}
