//! Force maps: newtons per pixel over a square centred on the skin (paper V-B, Table IV).
//! PURE. Uses: sim-core's contact. Never: sampling, files, the choice of contacts.
//!
//! Each contact's force is spread uniformly over a disc. A pixel gets the part of the disc's area
//! that it covers, in closed form: with `g(t) = integral of sqrt(r^2 - s^2) ds from 0 to t`, the
//! area of the disc to the lower left of a corner `(x, y)`, measured from the disc's centre, is
//!
//! ```text
//! pi r^2 / 4 + g(x) + g(y) + x y     corner inside the disc
//! 2 g(x) + 2 g(y)                    outside, x >= 0 and y >= 0
//! pi r^2 / 2 + 2 g(x)                outside, x < 0 and y >= 0 (likewise with x and y swapped)
//! 0                                  outside, x < 0 and y < 0
//! ```
//!
//! and a rectangle is the alternating sum over its four corners. `g` is computed once for each grid
//! line, so a corner costs an addition.

pub mod peaks;

#[cfg(test)]
mod tests;

use std::f64::consts::PI;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use sim_core::forward::Contact;

/// Side of the square that a map covers in the paper, mm; its centre is the centre of the skin.
pub const SIDE_MM: f64 = 640.0;
/// Smallest and largest side of a square, mm.
const SIDES_MM: (f64, f64) = (10.0, 6400.0);
/// Smallest and largest side of a pixel on a square of [`SIDE_MM`], mm. Limits of another square are in
/// proportion.
const PIXEL_MM: (f64, f64) = (2.0, 160.0);
/// Larger side of the paper's skin, mm.
pub const SKIN_MM: f64 = 560.0;
/// Largest map diameter on a square of [`SIDE_MM`], mm.
const DIAMETER_MAX_MM: f64 = 320.0;

/// Pixel, map diameter and side of a force map; written `4x20` (pixel x diameter, mm) on a square of
/// [`SIDE_MM`], and `2.5x10x100` (pixel x diameter x side) on another one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct ForceMapSpec {
    /// Side of a pixel, mm: a whole number of pixels fits the side of the square.
    pub pixel_mm: f64,
    /// Map diameter, mm: diameter of the disc over which the force of each contact is distributed.
    pub diameter_mm: f64,
    /// Side of the square, mm.
    pub side_mm: f64,
}

/// The twelve maps of Table IV, in its order.
pub const TABLE_IV_MAPS: [ForceMapSpec; 12] = [
    ForceMapSpec { pixel_mm: 4.0, diameter_mm: 20.0, side_mm: SIDE_MM },
    ForceMapSpec { pixel_mm: 4.0, diameter_mm: 28.0, side_mm: SIDE_MM },
    ForceMapSpec { pixel_mm: 4.0, diameter_mm: 32.0, side_mm: SIDE_MM },
    ForceMapSpec { pixel_mm: 4.0, diameter_mm: 44.0, side_mm: SIDE_MM },
    ForceMapSpec { pixel_mm: 4.0, diameter_mm: 52.0, side_mm: SIDE_MM },
    ForceMapSpec { pixel_mm: 4.0, diameter_mm: 60.0, side_mm: SIDE_MM },
    ForceMapSpec { pixel_mm: 10.0, diameter_mm: 10.0, side_mm: SIDE_MM },
    ForceMapSpec { pixel_mm: 10.0, diameter_mm: 30.0, side_mm: SIDE_MM },
    ForceMapSpec { pixel_mm: 10.0, diameter_mm: 50.0, side_mm: SIDE_MM },
    ForceMapSpec { pixel_mm: 10.0, diameter_mm: 70.0, side_mm: SIDE_MM },
    ForceMapSpec { pixel_mm: 20.0, diameter_mm: 20.0, side_mm: SIDE_MM },
    ForceMapSpec { pixel_mm: 20.0, diameter_mm: 60.0, side_mm: SIDE_MM },
];

/// Why a force map cannot be rendered, with the limit.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum ForceMapError {
    #[error(
        "force map `{text}`: must be pixel x diameter in mm, as in 4x20, or with a side, as in 2.5x10x100"
    )]
    Syntax { text: String },
    #[error("side {side_mm} mm: must be from {} to {} mm", SIDES_MM.0, SIDES_MM.1)]
    Side { side_mm: f64 },
    #[error("pixel {pixel_mm} mm: must be from {least_mm} to {most_mm} mm")]
    PixelRange { pixel_mm: f64, least_mm: f64, most_mm: f64 },
    #[error("pixel {pixel_mm} mm: must divide {side_mm} mm, the side of the map")]
    PixelDivides { pixel_mm: f64, side_mm: f64 },
    #[error("diameter {diameter_mm} mm: must be above 0 and at most {most_mm} mm")]
    Diameter { diameter_mm: f64, most_mm: f64 },
    #[error(
        "skin of {width_mm} x {height_mm} mm: sides must be above 0 and at most {side_mm} mm, the side of \
         the map"
    )]
    Skin { width_mm: f64, height_mm: f64, side_mm: f64 },
    /// The disc of a contact is outside the square, or its position or force is not finite.
    #[error("contact of {force_n} N at ({x_mm}, {y_mm}) mm: its disc must touch the map's square")]
    Contact { x_mm: f64, y_mm: f64, force_n: f64 },
}

impl ForceMapSpec {
    /// Returns the specification if its side, pixel and map diameter are valid.
    ///
    /// # Errors
    /// `ForceMapError::Side`, `PixelRange`, `PixelDivides` or `Diameter` for a value outside its limits.
    pub fn checked(self) -> Result<Self, ForceMapError> {
        let Self { pixel_mm, diameter_mm, side_mm } = self;
        if !(SIDES_MM.0..=SIDES_MM.1).contains(&side_mm) {
            return Err(ForceMapError::Side { side_mm });
        }
        let (least_mm, most_mm) = (PIXEL_MM.0 * self.scale(), PIXEL_MM.1 * self.scale());
        if !(least_mm..=most_mm).contains(&pixel_mm) {
            return Err(ForceMapError::PixelRange { pixel_mm, least_mm, most_mm });
        }
        if ((side_mm / pixel_mm).round() * pixel_mm - side_mm).abs() > 1e-9 {
            return Err(ForceMapError::PixelDivides { pixel_mm, side_mm });
        }
        let most_mm = DIAMETER_MAX_MM * self.scale();
        if !(diameter_mm > 0.0 && diameter_mm <= most_mm) {
            return Err(ForceMapError::Diameter { diameter_mm, most_mm });
        }
        Ok(self)
    }

    /// Number of pixels along a side of the map.
    pub fn pixels(&self) -> usize {
        (self.side_mm / self.pixel_mm).round() as usize
    }

    /// The map of another skin: as many pixels, lengths in proportion to the larger side of the skin, mm.
    pub fn on_skin(&self, skin_mm: f64) -> Self {
        // Rounded up to hundredths, so that lengths have few digits.
        let times = (100.0 * skin_mm / SKIN_MM / self.scale()).ceil() / 100.0;
        let length_mm = |mm: f64| (1e3 * times * mm).round() / 1e3;
        Self {
            pixel_mm: length_mm(self.pixel_mm),
            diameter_mm: length_mm(self.diameter_mm),
            side_mm: length_mm(self.side_mm),
        }
    }

    /// Side of the square in sides of the paper's.
    fn scale(&self) -> f64 {
        self.side_mm / SIDE_MM
    }
}

impl FromStr for ForceMapSpec {
    type Err = ForceMapError;

    fn from_str(text: &str) -> Result<Self, ForceMapError> {
        let numbers: Option<Vec<f64>> = text.split('x').map(|n| n.trim().parse().ok()).collect();
        let spec = match numbers.as_deref() {
            Some(&[pixel_mm, diameter_mm]) => Self { pixel_mm, diameter_mm, side_mm: SIDE_MM },
            Some(&[pixel_mm, diameter_mm, side_mm]) => Self { pixel_mm, diameter_mm, side_mm },
            _ => return Err(ForceMapError::Syntax { text: text.to_owned() }),
        };
        spec.checked()
    }
}

impl fmt::Display for ForceMapSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.pixel_mm, self.diameter_mm)?;
        if self.side_mm == SIDE_MM { Ok(()) } else { write!(f, "x{}", self.side_mm) }
    }
}

impl TryFrom<String> for ForceMapSpec {
    type Error = ForceMapError;

    fn try_from(text: String) -> Result<Self, ForceMapError> {
        text.parse()
    }
}

impl From<ForceMapSpec> for String {
    fn from(spec: ForceMapSpec) -> Self {
        spec.to_string()
    }
}

/// Renders the maps of one specification on one skin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceMap {
    spec: ForceMapSpec,
    /// Skin coordinates of the square's corner at row 0, column 0, mm.
    origin_mm: [f64; 2],
}

impl ForceMap {
    /// Prepares maps of a skin with this extent along x and y, mm. The centre of the square is that of the
    /// skin.
    ///
    /// # Errors
    /// `ForceMapError::Skin` if the skin is larger than the square; the errors of
    /// [`ForceMapSpec::checked`].
    pub fn new(spec: ForceMapSpec, skin_mm: [f64; 2]) -> Result<Self, ForceMapError> {
        let spec = spec.checked()?;
        let side_mm = spec.side_mm;
        let fits = |extent_mm: f64| extent_mm > 0.0 && extent_mm <= side_mm;
        let [width_mm, height_mm] = skin_mm;
        if !skin_mm.into_iter().all(fits) {
            return Err(ForceMapError::Skin { width_mm, height_mm, side_mm });
        }
        let corner = |extent_mm: f64| (extent_mm - side_mm) / 2.0;
        Ok(Self { spec, origin_mm: skin_mm.map(corner) })
    }

    /// Number of pixels along a side: a map holds the square of this number.
    pub fn pixels(&self) -> usize {
        self.spec.pixels()
    }

    /// Adds contacts to `map`, which the caller has zeroed.
    ///
    /// `map` is row-major, `pixels x pixels`: `map[row * pixels + column]`, row 0 at the least y,
    /// column 0 at the least x; N per pixel. What a contact adds sums to its force. Only pixels
    /// that its disc overlaps are written. If a part of a disc is outside the square (on the
    /// default skin only discs above 80 mm), the other part carries the whole force.
    ///
    /// # Errors
    /// `ForceMapError::Contact` if the disc of a contact is outside the square, or a value is not
    /// finite. The contacts before it are already in `map`.
    ///
    /// # Panics
    /// If `map` is not `pixels x pixels` long.
    pub fn render(&self, contacts: &[Contact], map: &mut [f32]) -> Result<(), ForceMapError> {
        let pixels = self.pixels();
        assert_eq!(map.len(), pixels * pixels, "a map of {pixels} x {pixels} pixels");
        let disc = Disc::new(self.spec.diameter_mm / 2.0);
        for &Contact { x_mm, y_mm, force_n } in contacts {
            let columns = self.axis(&disc, x_mm - self.origin_mm[0]);
            let rows = self.axis(&disc, y_mm - self.origin_mm[1]);
            let area_mm2 = disc.within(&columns.whole, &rows.whole);
            if !(area_mm2 > 0.0 && force_n.is_finite()) {
                return Err(ForceMapError::Contact { x_mm, y_mm, force_n });
            }
            let pressure = force_n / area_mm2;
            for (row, y) in (rows.first..).zip(&rows.pixels) {
                let line = &mut map[row * pixels + columns.first..][..columns.pixels.len()];
                for (pixel, x) in line.iter_mut().zip(&columns.pixels) {
                    *pixel += (pressure * disc.within(x, y)) as f32;
                }
            }
        }
        Ok(())
    }

    /// The pixels around a disc along one axis; `centre_mm` is measured from the square's corner.
    fn axis(&self, disc: &Disc, centre_mm: f64) -> Axis {
        let pixel_mm = self.spec.pixel_mm;
        // NaN becomes 0, so that there are no pixels; positions outside are clamped to the square.
        let clamped = |line: f64| line.clamp(0.0, self.pixels() as f64) as usize;
        let first = clamped(((centre_mm - disc.radius_mm) / pixel_mm).floor());
        let last = clamped(((centre_mm + disc.radius_mm) / pixel_mm).ceil());
        let line = |i: usize| disc.line(i as f64 * pixel_mm - centre_mm);
        let lines: Vec<Line> = (first..=last).map(line).collect();
        let whole = Span::new(lines[0], lines[lines.len() - 1]);
        let pixels = lines.windows(2).map(|pair| Span::new(pair[0], pair[1])).collect();
        Axis { first, whole, pixels }
    }
}

/// The pixels that a disc may overlap, along one axis.
struct Axis {
    /// Index of the first pixel.
    first: usize,
    /// Span from the first pixel to the last.
    whole: Span,
    pixels: Vec<Span>,
}

/// A grid line relative to a disc.
#[derive(Debug, Clone, Copy)]
struct Line {
    /// Signed distance from the disc's centre, mm, clamped to its radius.
    at_mm: f64,
    /// `g` at this distance, mm^2: area between the axis, the line and the disc's upper rim.
    under_mm2: f64,
}

/// The interval between two grid lines.
#[derive(Debug, Clone, Copy)]
struct Span {
    low: Line,
    high: Line,
    /// Squared distances of its nearest and farthest line from the disc's centre, mm^2.
    nearest_mm2: f64,
    farthest_mm2: f64,
}

impl Span {
    fn new(low: Line, high: Line) -> Self {
        let nearest_mm2 = low.at_mm.max(-high.at_mm).max(0.0).powi(2);
        let farthest_mm2 = high.at_mm.max(-low.at_mm).powi(2);
        Self { low, high, nearest_mm2, farthest_mm2 }
    }
}

/// A disc centred on the origin.
#[derive(Debug, Clone, Copy)]
struct Disc {
    radius_mm: f64,
}

impl Disc {
    fn new(radius_mm: f64) -> Self {
        Self { radius_mm }
    }

    fn line(&self, distance_mm: f64) -> Line {
        let r = self.radius_mm;
        let t = distance_mm.clamp(-r, r);
        let half_chord = (r * r - t * t).max(0.0).sqrt();
        Line { at_mm: t, under_mm2: 0.5 * (t * half_chord + r * r * (t / r).asin()) }
    }

    /// Area (mm^2) of the disc's part left of `x` and below `y`.
    fn lower_left(&self, x: Line, y: Line) -> f64 {
        let quarter = PI * self.radius_mm * self.radius_mm / 4.0;
        if x.at_mm * x.at_mm + y.at_mm * y.at_mm < self.radius_mm * self.radius_mm {
            return quarter + x.under_mm2 + y.under_mm2 + x.at_mm * y.at_mm;
        }
        match (x.at_mm >= 0.0, y.at_mm >= 0.0) {
            (true, true) => 2.0 * (x.under_mm2 + y.under_mm2),
            (false, true) => 2.0 * (quarter + x.under_mm2),
            (true, false) => 2.0 * (quarter + y.under_mm2),
            (false, false) => 0.0,
        }
    }

    /// Area (mm^2) of the disc within a rectangle: exactly 0 outside the disc, exactly the
    /// rectangle inside it.
    fn within(&self, x: &Span, y: &Span) -> f64 {
        let rim_mm2 = self.radius_mm * self.radius_mm;
        if x.nearest_mm2 + y.nearest_mm2 >= rim_mm2 {
            return 0.0;
        }
        if x.farthest_mm2 + y.farthest_mm2 < rim_mm2 {
            return (x.high.at_mm - x.low.at_mm) * (y.high.at_mm - y.low.at_mm);
        }
        let upper = self.lower_left(x.high, y.high) - self.lower_left(x.low, y.high);
        let lower = self.lower_left(x.high, y.low) - self.lower_left(x.low, y.low);
        (upper - lower).max(0.0)
    }
}
