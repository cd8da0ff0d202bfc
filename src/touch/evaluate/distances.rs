//! Distances by which answers are judged, in proportion to the skin.
//! PURE. Uses: the larger side of the paper's skin (`dataset::force_map`). Never: an answer, a pixel of a map.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::dataset::force_map::SKIN_MM;

/// Limits of the spacing by which scores are split, on the paper's skin, mm.
const SPACINGS_MM: [f64; 2] = [60.0, 120.0];

/// Distances by which answers on a skin are judged.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Distances {
    /// An estimate farther than this from every true contact is a ghost, and one farther from its own is wrong, mm.
    pub ghost_mm: f64,
    /// Error of a guess, mm: a contact of a frame without any estimate counts as this far off when nets are compared.
    pub guess_mm: f64,
}

impl Distances {
    /// Those of the paper's skin, 540 x 560 mm; a guess there: the mean distance of two random positions.
    pub const PAPER: Self = Self { ghost_mm: 40.0, guess_mm: 287.0 };

    /// Those of a skin with this extent along x and y, mm: in proportion to its larger side, as force maps are.
    /// Rounded to micrometres.
    pub fn on_skin(skin_mm: [f64; 2]) -> Self {
        let times = skin_mm[0].max(skin_mm[1]) / SKIN_MM;
        let length_mm = |mm: f64| (1e3 * times * mm).round() / 1e3;
        Self {
            ghost_mm: length_mm(Self::PAPER.ghost_mm),
            guess_mm: length_mm(Self::PAPER.guess_mm),
        }
    }

    /// Limits of the spacing by which scores are split, mm: 60 and 120 on the paper's skin, on others in the
    /// proportion of `ghost_mm`. Rounded to micrometres.
    pub fn spacings_mm(&self) -> [f64; 2] {
        SPACINGS_MM.map(|mm| (1e3 * mm * self.ghost_mm / Self::PAPER.ghost_mm).round() / 1e3)
    }
}

/// Reports without distances were judged by those of the paper's skin, whatever their skin.
impl Default for Distances {
    fn default() -> Self {
        Self::PAPER
    }
}

#[cfg(test)]
mod tests {
    use super::Distances;

    #[test]
    fn distances_are_in_proportion_to_the_larger_side_of_the_skin() {
        assert_eq!(Distances::on_skin([540.0, 560.0]), Distances::PAPER);
        assert_eq!(Distances::on_skin([560.0, 540.0]), Distances::PAPER);
        let small = Distances { ghost_mm: 7.143, guess_mm: 51.25 };
        assert_eq!(Distances::on_skin([60.0, 100.0]), small);
        let large = Distances::on_skin([1120.0, 560.0]);
        assert_eq!((large.ghost_mm, large.spacings_mm()), (80.0, [120.0, 240.0]));
        assert_eq!(Distances::PAPER.spacings_mm(), [60.0, 120.0]);
    }
}
