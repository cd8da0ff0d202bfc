//! One trial for other tools: a netlist, a finite element deck, a figure.
//! Uses: sim-core, `picture`. Never: files.

use sim_core::calculix;
use sim_core::deformation::Deformation;
use sim_core::forward::{Contact, ContactError, ForwardModel, Workspace};
use sim_core::network::ElectrodeError;
use sim_core::solve::SolveError;
use sim_core::spice::{self, LoadedCircuit, SpiceError};

use super::picture::{self, Scene};

/// Why a trial cannot be exported.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum ExportError {
    #[error(transparent)]
    Contact(#[from] ContactError),
    #[error(transparent)]
    Electrode(#[from] ElectrodeError),
    #[error(transparent)]
    Spice(#[from] SpiceError),
    #[error("drawing the deformed mesh: {0}")]
    Solve(#[from] SolveError),
}

/// Returns the circuit as a netlist for ngspice, with electrode `sink` at 0 V.
///
/// # Errors
/// `ExportError` if a contact or the sink is invalid, or the netlist cannot be written.
pub fn netlist(
    model: &ForwardModel,
    contacts: &[Contact],
    sink: usize,
) -> Result<String, ExportError> {
    let mut work = Workspace::default();
    model.voltages(contacts, &mut work)?;
    let title = format!("{}; model {}", words(contacts), model.model_hash());
    let skin = LoadedCircuit {
        title: &title,
        network: &model.network()?,
        circuit: model.circuit(),
        to_top_s: work.to_top_s(),
    };
    Ok(spice::netlist(&skin, sink)?)
}

/// Returns the deformation as an input deck for CalculiX.
///
/// # Errors
/// `ExportError::Contact` if the model rejects a contact.
pub fn deck(model: &ForwardModel, contacts: &[Contact]) -> Result<String, ExportError> {
    let title = format!("{}; sensor {}", words(contacts), model.sensor().file.name);
    Ok(calculix::deck(&title, model.mesh(), &model.node_forces(contacts)?))
}

/// Returns the deformed mesh as an SVG figure.
///
/// # Errors
/// `ExportError::Contact` if the model rejects a contact; `Solve` if the solve fails.
pub fn picture(model: &ForwardModel, contacts: &[Contact]) -> Result<String, ExportError> {
    let forces = model.node_forces(contacts)?;
    let deformation = Deformation::solve(model.mesh(), &forces)?;
    let name = &model.sensor().file.name;
    let title = format!("Deformed skin {name}: {} (simulated, n = 1 trial)", words(contacts));
    Ok(picture::draw(&Scene {
        mesh: model.mesh(),
        deformation: &deformation,
        contacts,
        forces: &forces,
        title: &title,
    }))
}

/// `untouched`, `1 contact, 20 N`, `3 contacts, 61.5 N in total`.
fn words(contacts: &[Contact]) -> String {
    let sum_n = contacts.iter().map(|c| c.force_n).sum::<f64>();
    match contacts.len() {
        0 => "untouched".into(),
        1 => format!("1 contact, {sum_n:.1} N"),
        n => format!("{n} contacts, {sum_n:.1} N in total"),
    }
}
