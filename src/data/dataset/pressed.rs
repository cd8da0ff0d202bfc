//! The contacts of a stored trial as input of a simulation.
//! PURE. Uses: `store` (its rows), sim-core's contact. Never: the database.

use serde::Deserialize;
use sim_core::forward::Contact;

use crate::store::{self, RunKind, TrialRow};

/// Returns the contacts of a trial: in Real-Hex each attached tip with a force above
/// `force_noise_n` (N), otherwise the stored contacts. `None` if the position or force of a contact
/// is unknown.
pub fn contacts(trial: &TrialRow, kind: RunKind, force_noise_n: f64) -> Option<Vec<Contact>> {
    match kind {
        RunKind::RealHex => trial
            .arms
            .iter()
            .filter(|arm| arm.force_n > force_noise_n)
            .map(|arm| Some(Contact { x_mm: arm.x_mm, y_mm: arm.y_mm, force_n: arm.force_n }))
            .collect(),
        RunKind::RealRandom | RunKind::Imported => trial.contacts.iter().map(as_pressed).collect(),
    }
}

/// Returns a stored contact with position and force; `None` if one of them is unknown.
pub fn as_pressed(contact: &store::Contact) -> Option<Contact> {
    contact.pressed().map(|[x_mm, y_mm, force_n]| Contact { x_mm, y_mm, force_n })
}

/// Returns where the tips of a trial are, mm: in Real-Hex each attached tip, with a force or without,
/// otherwise the trial's `contacts`, which [`contacts`] returns.
pub fn tips_mm(trial: &TrialRow, kind: RunKind, contacts: &[Contact]) -> Vec<[f64; 2]> {
    match kind {
        RunKind::RealHex => trial.arms.iter().map(|arm| [arm.x_mm, arm.y_mm]).collect(),
        RunKind::RealRandom | RunKind::Imported => {
            contacts.iter().map(|c| [c.x_mm, c.y_mm]).collect()
        }
    }
}

/// Returns the process seconds per wall second from the text of a rig file: 1 if it states none.
pub fn clock_rate(rig: &str) -> f64 {
    #[derive(Deserialize)]
    struct Rig {
        clock_rate: f64,
    }
    toml::from_str(rig).map_or(1.0, |rig: Rig| rig.clock_rate)
}

/// Returns the noise of the load cells from the text of a rig file, N; `None` if the text has no
/// such value. A force that does not exceed it is no contact.
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
