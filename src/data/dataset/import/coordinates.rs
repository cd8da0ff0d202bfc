//! The map from the coordinates of a robot to those of the skin, of an imported file's contacts.
//! PURE. Uses: toml, `syntax`. Never: a force or a diameter, which the map does not change.
//!
//! `skin = offset_mm + rotate(scale * mirror(robot))`: the mirror changes the sign of x, the rotation is
//! counter-clockwise about the origin.

use serde::{Deserialize, Serialize};

use crate::problem::{Checks, Problem};
use crate::syntax::parse_toml;

/// Largest magnitude of a component of the offset, mm.
const OFFSET_MAX_MM: f64 = 1e6;
/// Smallest and largest scale: from nm to mm, from km to mm.
const SCALES: [f64; 2] = [1e-6, 1e6];

/// A map of coordinates; by default it changes nothing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Coordinates {
    /// Angle of the rotation, counter-clockwise, degrees.
    pub rotate_deg: f64,
    /// Whether x changes its sign, before the rotation.
    pub mirror_x: bool,
    /// Position of the robot's origin on the skin, mm.
    pub offset_mm: [f64; 2],
    /// Length of the robot's unit, mm: 1000 for metres.
    pub scale: f64,
}

impl Default for Coordinates {
    fn default() -> Self {
        Self { rotate_deg: 0.0, mirror_x: false, offset_mm: [0.0; 2], scale: 1.0 }
    }
}

impl Coordinates {
    /// Parses a file with any of `rotate_deg`, `mirror_x`, `offset_mm` and `scale`; `file` is its name in
    /// messages.
    ///
    /// # Errors
    /// All problems of the text or, if it has none, of its values.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Vec<Problem>> {
        let map: Self = parse_toml(file, text)?;
        let mut checks = Checks::of(file);
        checks.within("rotate_deg", map.rotate_deg, -360.0..=360.0);
        for (at, mm) in map.offset_mm.into_iter().enumerate() {
            checks.within(&format!("offset_mm[{at}]"), mm, -OFFSET_MAX_MM..=OFFSET_MAX_MM);
        }
        checks.within("scale", map.scale, SCALES[0]..=SCALES[1]);
        checks.done().map(|()| map)
    }

    /// Skin coordinates, mm, of a point in coordinates of the robot.
    pub fn apply(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        if *self == Self::default() {
            return [x, y];
        }
        let x = if self.mirror_x { -x } else { x };
        // Exact for right angles, so that a point on the edge stays on the edge.
        let (sin, cos) = match self.rotate_deg.rem_euclid(360.0) {
            0.0 => (0.0, 1.0),
            90.0 => (1.0, 0.0),
            180.0 => (0.0, -1.0),
            270.0 => (-1.0, 0.0),
            degrees => degrees.to_radians().sin_cos(),
        };
        let [dx, dy] = self.offset_mm;
        [dx + self.scale * (cos * x - sin * y), dy + self.scale * (sin * x + cos * y)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_is_mirrored_then_rotated_then_scaled_then_moved() {
        let of = |text: &str| Coordinates::from_toml("map.toml", text).unwrap();
        assert_eq!(of("").apply([3.0, -4.0]), [3.0, -4.0]);
        assert_eq!(of("mirror_x = true").apply([3.0, 4.0]), [-3.0, 4.0]);
        assert_eq!(of("rotate_deg = 90").apply([3.0, 4.0]), [-4.0, 3.0]);
        assert_eq!(of("rotate_deg = -90").apply([3.0, 4.0]), [4.0, -3.0]);
        let all = of("rotate_deg = 90\nmirror_x = true\nscale = 10\noffset_mm = [100, 200]");
        assert_eq!(all.apply([3.0, 4.0]), [60.0, 170.0]);
        let [x, y] = of("rotate_deg = 45").apply([2_f64.sqrt(), 0.0]);
        assert!((x - 1.0).abs() < 1e-12 && (y - 1.0).abs() < 1e-12);
    }

    #[test]
    fn every_invalid_value_is_named() {
        let text = "rotate_deg = 900\noffset_mm = [1e9, 0]\nscale = 0\n";
        let problems = Coordinates::from_toml("map.toml", text).unwrap_err();
        let keys: Vec<&str> = problems.iter().map(|p| p.key.as_str()).collect();
        assert_eq!(keys, ["rotate_deg", "offset_mm[0]", "scale"]);
        let unknown = Coordinates::from_toml("map.toml", "rotate = 90\n").unwrap_err();
        assert!(unknown[0].to_string().contains("rotate_deg"), "{}", unknown[0]);
        assert!(Coordinates::from_toml("map.toml", "offset_mm = [1]\n").is_err());
    }
}
