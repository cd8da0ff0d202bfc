//! Force maps of methods: contacts drawn as a map, and the peaks of a map as contacts.
//! Uses: `dataset::force_map`. Never: nets, its own threshold.

use sim_core::forward::Contact;

use super::answer::{FoundContact, Reading};
use super::error::InferResult;
use crate::dataset::force_map::{ForceMap, ForceMapSpec, TABLE_IV_MAPS};

/// Map in which the contacts of methods without a map are drawn: the paper's Map 1, 160 x 160
/// pixels.
pub const MAP_1: ForceMapSpec = TABLE_IV_MAPS[0];

/// Whether readings contain force maps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ForceMaps {
    /// With the force map of each frame.
    With,
    /// Without force maps.
    Without,
}

impl ForceMaps {
    /// With force maps under a condition, otherwise without.
    pub fn if_wanted(wanted: bool) -> Self {
        if wanted { Self::With } else { Self::Without }
    }

    /// The map of a frame, or its side, if readings contain maps.
    pub fn keep<T>(self, map: impl FnOnce() -> T) -> Option<T> {
        (self == Self::With).then(map)
    }
}

/// Draws the contacts of readings without a map (Map 1); those without a force are skipped.
///
/// # Errors
/// `InferError::Map` if the map does not fit the skin.
pub fn draw(readings: &mut [Reading], skin_mm: [f64; 2]) -> InferResult<()> {
    if readings.iter().all(|reading| reading.force_map_n.is_some()) {
        return Ok(());
    }
    let draws = ForceMap::new(MAP_1, skin_mm)?;
    for reading in readings.iter_mut().filter(|reading| reading.force_map_n.is_none()) {
        let of =
            |c: &FoundContact| Some(Contact { x_mm: c.x_mm, y_mm: c.y_mm, force_n: c.force_n? });
        let pressed = reading.contacts.iter().filter_map(of);
        let mut map = vec![0.0; draws.pixels() * draws.pixels()];
        draws.render(&pressed.collect::<Vec<_>>(), &mut map)?;
        reading.force_map_n = Some(map);
        reading.force_map_mm = Some(MAP_1.side_mm);
    }
    Ok(())
}

/// The peaks of a map as contacts, strongest first.
pub fn contacts(draws: &ForceMap, map: &[f32], threshold_n: f64) -> Vec<FoundContact> {
    let mut peaks = draws.peaks(map, threshold_n);
    peaks.sort_by(|a, b| b.force_n.total_cmp(&a.force_n));
    let found = |p: &crate::dataset::force_map::peaks::Peak| FoundContact {
        x_mm: p.x_mm,
        y_mm: p.y_mm,
        force_n: Some(p.force_n),
        diameter_mm: Some(p.diameter_mm),
        ..FoundContact::default()
    };
    peaks.iter().map(found).collect()
}
