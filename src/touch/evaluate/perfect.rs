//! The score of a perfect map under the same rule: the error of the peak rule itself.
//! PURE. Uses: force maps and their peaks, `touch`. Never: a net, a second kind of score.
//!
//! The true contacts are drawn as a label would be and read back as peaks. Contacts under the
//! threshold, two within one circle, a disc wider than the circle and large pixels all worsen the
//! score of a perfect map; a method is compared with that score, not with 0.

use crate::dataset::force_map::{ForceMap, ForceMapError};
use crate::dataset::pressed::as_pressed;
use crate::store::Contact;

use super::touch::{Touch, TouchError};

/// Why the perfect map of a frame cannot be scored.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum PerfectError {
    /// A contact is outside the map.
    #[error("drawing frame {frame}")]
    Draw {
        frame: usize,
        #[source]
        why: ForceMapError,
    },
    /// A value of a contact is not finite.
    #[error("scoring frame {frame}")]
    Score {
        frame: usize,
        #[source]
        why: TouchError,
    },
}

/// Compares each frame's true contacts with the peaks of the force map of these contacts. Frames with a contact of
/// unknown position or force have no map and are skipped. `ghost_mm`: distance of a ghost, mm.
///
/// # Errors
/// `PerfectError::Draw` if a contact is outside the map; `Score` if a value is not finite.
pub fn perfect<'a>(
    map: &ForceMap,
    frames: impl IntoIterator<Item = &'a [Contact]>,
    threshold_n: f64,
    ghost_mm: f64,
) -> Result<Vec<Touch>, PerfectError> {
    let mut pixels = vec![0.0; map.pixels() * map.pixels()];
    let mut touches = Vec::new();
    for (frame, truths) in frames.into_iter().enumerate() {
        let pressed: Option<Vec<_>> = truths.iter().map(as_pressed).collect();
        let Some(pressed) = pressed else { continue };
        pixels.fill(0.0);
        map.render(&pressed, &mut pixels).map_err(|why| PerfectError::Draw { frame, why })?;
        let peaks = map.peaks(&pixels, threshold_n).into_iter();
        let estimates: Vec<Contact> = peaks.map(Contact::from).collect();
        let touch = Touch::of(truths, &estimates, ghost_mm);
        touches.push(touch.map_err(|why| PerfectError::Score { frame, why })?);
    }
    Ok(touches)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chance::Chance;
    use crate::dataset::force_map::peaks::THRESHOLD_N;
    use crate::evaluate::distances::Distances;
    use crate::evaluate::score::Scores;

    /// Distance of a ghost on the paper's skin, mm.
    const GHOST_MM: f64 = Distances::PAPER.ghost_mm;

    fn map(spec: &str) -> ForceMap {
        ForceMap::new(spec.parse().unwrap(), [540.0, 560.0]).unwrap()
    }

    fn contact(x_mm: f64, y_mm: f64, force_n: f64) -> Contact {
        let (x_mm, y_mm, force_n) = (Some(x_mm), Some(y_mm), Some(force_n));
        Contact { x_mm, y_mm, force_n, diameter_mm: Some(20.0) }
    }

    /// The lab's points: 31 rows of 26, without two corners.
    fn points() -> Vec<[f64; 2]> {
        let pitch_mm = 10.0 * 3.0_f64.sqrt();
        let corner = |row: usize, column: usize| column == 0 && (row == 0 || row == 30);
        let place = |row: usize, column: usize| {
            let x = 270.0 - 12.75 * pitch_mm;
            [x + pitch_mm * (column as f64 + 0.5 * (row % 2) as f64), 55.0 + 15.0 * row as f64]
        };
        (0..31)
            .flat_map(|row| (0..26).map(move |column| (row, column)))
            .filter(|&(row, column)| !corner(row, column))
            .map(|(row, column)| place(row, column))
            .collect()
    }

    /// 2 to 4 weights of 4.905, 7.358 or 9.810 N at any position, as in Real-Unseen.
    fn unseen(frames: usize) -> Vec<Vec<Contact>> {
        let (points, mut chance) = (points(), Chance::named(1, "unseen"));
        let mut frame = || {
            let mut order: Vec<usize> = (0..points.len()).collect();
            chance.shuffle(&mut order);
            let count = 2 + chance.below(3) as usize;
            let weight = |place: &usize| {
                let force_n = [4.905, 7.358, 9.810][chance.below(3) as usize];
                contact(points[*place][0], points[*place][1], force_n)
            };
            order[..count].iter().map(weight).collect()
        };
        (0..frames).map(|_| frame()).collect()
    }

    fn score(spec: &str, frames: &[Vec<Contact>], threshold_n: f64) -> Scores {
        let frames = frames.iter().map(Vec::as_slice);
        let touches = perfect(&map(spec), frames, threshold_n, GHOST_MM).unwrap();
        Scores::of(&touches, &Distances::PAPER, 1)
    }

    /// 600 such frames had errors of -32.8 % and 60.7 mm with the threshold of 5 N, above a third
    /// of the weights; -0.5 % and 0.2 mm with 2.5 N (`docs/references.md`, "Feasibility study").
    #[test]
    fn a_perfect_map_of_light_weights_is_far_from_perfect_by_the_papers_rule() {
        let frames = unseen(600);
        let paper = score("4x20", &frames, THRESHOLD_N).all;
        let number = paper.number_percent.unwrap();
        assert!((number.mean + 32.8).abs() < 3.0 && (number.sd.unwrap() - 28.0).abs() < 3.0);
        assert!((paper.closest_mm.unwrap().mean - 60.7).abs() < 6.0, "{:?}", paper.closest_mm);
        assert!((paper.exact_rate.unwrap().mean - 0.33).abs() < 0.06);
        assert!(paper.location_mm.unwrap().mean < 2.5);
        let lower = score("4x20", &frames, 2.5).all;
        assert!(lower.number_percent.unwrap().mean.abs() < 1.5);
        assert!(lower.closest_mm.unwrap().mean < 2.0, "{:?}", lower.closest_mm);
        assert!(lower.force_percent.unwrap().mean.abs() < 3.0);
    }

    #[test]
    fn frames_without_forces_have_no_map_and_a_contact_off_the_map_is_named() {
        let known = vec![contact(100.0, 100.0, 10.0)];
        let pattern = vec![Contact { force_n: None, ..known[0] }];
        let frames = [known.clone(), pattern, Vec::new()];
        let slices = frames.iter().map(Vec::as_slice);
        let touches = perfect(&map("4x20"), slices, 5.0, GHOST_MM).unwrap();
        assert_eq!(touches.iter().map(|touch| touch.contacts).collect::<Vec<_>>(), [1, 0]);
        let off = [known, vec![contact(900.0, 0.0, 10.0)]];
        let slices = off.iter().map(Vec::as_slice);
        let refused = perfect(&map("4x20"), slices, 5.0, GHOST_MM).unwrap_err();
        assert!(matches!(refused, PerfectError::Draw { frame: 1, .. }), "{refused}");
    }
}
