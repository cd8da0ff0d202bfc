//! What pressed in a stored trial, as the contacts that a simulation takes.
//! PURE. Uses: `store` (its rows), sim-core's contact. Never: the database.

use serde::Deserialize;
use sim_core::forward::Contact;

use crate::store::{RunKind, TrialRow};

/// What pressed: every attached tip whose force stands above the cells' noise, or the placed
/// weights. `None` where that is not known of each contact.
pub fn contacts(trial: &TrialRow, kind: RunKind, force_noise_n: f64) -> Option<Vec<Contact>> {
    let contact = |x_mm, y_mm, force_n| Contact { x_mm, y_mm, force_n };
    match kind {
        RunKind::RealHex => trial
            .arms
            .iter()
            .filter(|arm| arm.force_n > force_noise_n)
            .map(|arm| Some(contact(arm.x_mm, arm.y_mm, arm.force_n)))
            .collect(),
        RunKind::RealRandom | RunKind::Imported => {
            let placed = |[x_mm, y_mm, force_n]: [f64; 3]| contact(x_mm, y_mm, force_n);
            trial.contacts.iter().map(|c| c.pressed().map(placed)).collect()
        }
    }
}

/// The noise of a rig's load cells by its file, N; `None` where the text is no rig file. A force that
/// is not above it is no contact.
pub fn force_noise_n(rig: &str) -> Option<f64> {
    #[derive(Deserialize)]
    struct Rig {
        cells: Cells,
    }
    #[derive(Deserialize)]
    struct Cells {
        force_noise_n: f64,
    }
    toml::from_str(rig).ok().map(|rig: Rig| rig.cells.force_noise_n)
}
