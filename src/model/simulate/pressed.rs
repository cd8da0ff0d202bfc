//! What the model computes for contacts that are given by their force or their depth: the other of the two,
//! and the frame and the dent.
//! PURE. Uses: `contacts`, `dent`, sim-core. Never: limits of input (`contacts` checks them).
//!
//! The depth of a tip is the mean compression of the foam at the six corners of its hexagon, which carry
//! its force (paper III-A). It is not the depth of the stage, which also contains the standoff, the
//! fabrics and what is below the skin.

use sim_core::forward::{Contact, ContactError, ForwardModel, Workspace};
use sim_core::tip::Spreading;

use super::contacts::{FORCE_MAX_N, Load, RequestedContact};
use super::dent::{DentMap, dent};

/// Largest number of rounds over the contacts: two tips that almost coincide need the most.
const PRESS_ROUNDS: usize = 400;
/// Halvings of a range of forces: to 1e-12 of it.
const HALVINGS: usize = 40;
/// Change of a force at which the forces are found, N.
const FOUND_N: f64 = 1e-7;
/// Difference from the requested depth that counts as reached, mm.
const REACHED_MM: f64 = 1e-3;

/// The skin under contacts, as the model computes it.
#[derive(Debug, Clone, PartialEq)]
pub struct Pressed {
    /// The contacts with their forces.
    pub contacts: Vec<Contact>,
    /// Depth of each contact, mm.
    pub depths_mm: Vec<f64>,
    /// Frame, V, injection-major.
    pub voltages_v: Vec<f64>,
    /// Compression of the foam over the skin.
    pub dent: DentMap,
}

/// Why contacts cannot be simulated.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum PressedError {
    #[error(transparent)]
    Contact(#[from] ContactError),
    /// No force reaches the depth of the contact of this index, from 0.
    #[error(
        "contact {contact}: {FORCE_MAX_N} N press {deepest_mm:.3} mm deep, less than the depth"
    )]
    TooDeep { contact: usize, deepest_mm: f64 },
}

/// Simulates contacts. Where other contacts alone press a place deeper than requested, the force of
/// its contact is 0.
///
/// # Errors
/// `PressedError::Contact` if a position is off the skin or a force is invalid; `TooDeep` if no force
/// up to `FORCE_MAX_N` reaches a depth.
pub fn pressed(
    model: &ForwardModel,
    placed: &[RequestedContact],
    work: &mut Workspace,
) -> Result<Pressed, PressedError> {
    let forces_n = forces_n(model, placed)?;
    let contact = |(c, &force_n): (&RequestedContact, &f64)| at(c, force_n);
    let contacts: Vec<Contact> = placed.iter().zip(&forces_n).map(contact).collect();
    let voltages_v = model.voltages(&contacts, work)?.to_vec();
    let compression_mm = work.compression_mm();
    let depth_mm =
        |c: &Contact| rim(model, c).iter().map(|(node, share)| share * compression_mm[*node]).sum();
    let depths_mm = contacts.iter().map(depth_mm).collect();
    let dent = dent(model, compression_mm);
    Ok(Pressed { contacts, depths_mm, voltages_v, dent })
}

/// A place where a depth is measured.
struct RimNode {
    node: usize,
    /// Share of the depth.
    share: f64,
    /// Compression of the nominal skin under 1 N on each contact, mm.
    units_mm: Vec<f64>,
}

/// Forces of contacts, N: those that are given, and those that press to a given depth.
fn forces_n(model: &ForwardModel, placed: &[RequestedContact]) -> Result<Vec<f64>, PressedError> {
    let given = |c: &RequestedContact| match c.load {
        Load::ForceN(force_n) => force_n,
        Load::DepthMm(_) => 0.0,
    };
    let mut forces_n: Vec<f64> = placed.iter().map(given).collect();
    if placed.iter().all(|c| matches!(c.load, Load::ForceN(_))) {
        return Ok(forces_n);
    }
    let mut loads = Vec::with_capacity(placed.len());
    for (index, contact) in placed.iter().enumerate() {
        let one = at(contact, 1.0);
        model.check(index, &one)?;
        loads.push(model.node_forces(&[one])?);
    }
    let unit_mm = |node: usize, of: usize| -> f64 {
        let rows = loads[of].iter();
        rows.map(|f| f.force_n * f64::from(model.responses().row(f.node as usize)[node])).sum()
    };
    let rims: Vec<Vec<RimNode>> = placed
        .iter()
        .map(|contact| {
            let nodes = rim(model, &at(contact, 0.0)).into_iter();
            let units_mm = |node| (0..placed.len()).map(|of| unit_mm(node, of)).collect();
            nodes.map(|(node, share)| RimNode { node, share, units_mm: units_mm(node) }).collect()
        })
        .collect();
    let depth_mm = |index: usize, forces_n: &[f64]| -> f64 {
        let of_node = |at: &RimNode| {
            let nominal_mm: f64 = at.units_mm.iter().zip(forces_n).map(|(u, f)| u * f).sum();
            at.share * compression_mm(model, at.node, nominal_mm)
        };
        rims[index].iter().map(of_node).sum()
    };
    for _ in 0..PRESS_ROUNDS {
        let mut change_n: f64 = 0.0;
        for (index, contact) in placed.iter().enumerate() {
            let Load::DepthMm(depth) = contact.load else { continue };
            let before = forces_n[index];
            let (mut low, mut high) = (0.0, FORCE_MAX_N);
            for _ in 0..HALVINGS {
                forces_n[index] = 0.5 * (low + high);
                if depth_mm(index, &forces_n) < depth {
                    low = forces_n[index];
                } else {
                    high = forces_n[index];
                }
            }
            // The lower end: without a depth there is no force.
            forces_n[index] = low;
            change_n = change_n.max((low - before).abs());
        }
        if change_n < FOUND_N {
            break;
        }
    }
    for (contact, placed) in placed.iter().enumerate() {
        let deepest_mm = depth_mm(contact, &forces_n);
        if matches!(placed.load, Load::DepthMm(depth) if deepest_mm < depth - REACHED_MM) {
            return Err(PressedError::TooDeep { contact, deepest_mm });
        }
    }
    Ok(forces_n)
}

fn at(contact: &RequestedContact, force_n: f64) -> Contact {
    Contact { x_mm: contact.x_mm, y_mm: contact.y_mm, force_n }
}

/// The nodes at the rim of a tip, with shares that add up to 1.
fn rim(model: &ForwardModel, tip: &Contact) -> Vec<(usize, f64)> {
    let mut shares = Vec::new();
    model.lattice().spread(Spreading::Linear, [tip.x_mm, tip.y_mm], &mut shares);
    shares.iter().map(|share| (share.node as usize, share.sixths / 6.0)).collect()
}

/// Compression of this skin's foam at a node, mm, from that of the nominal skin before the clamp.
fn compression_mm(model: &ForwardModel, node: usize, nominal_mm: f64) -> f64 {
    let fields = model.fields();
    let linear_mm = nominal_mm.max(0.0) * fields.ln_compliance[node].exp();
    fields.displacement.as_ref().map_or(linear_mm, |law| law.apply(linear_mm))
}

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;

    use sim_core::fields::{DisplacementLut, NodeFields};

    use super::*;
    use crate::calibrate::paper::{self, MODEL};

    /// A skin of the paper's sensor that is softer in places, with a foam that stiffens.
    static SKIN: LazyLock<ForwardModel> = LazyLock::new(|| {
        let mut fields = NodeFields::nominal(MODEL.mesh());
        for (node, ln) in fields.ln_compliance.iter_mut().enumerate() {
            *ln = 0.2 * (node as f64 / 50.0).sin();
        }
        let law = |i: i32| 4.5 * (1.0 - (-f64::from(i) * 0.1 / 4.0).exp());
        fields.displacement = Some(DisplacementLut::new(0.1, (0..100).map(law).collect()).unwrap());
        let (responses, circuit) = (MODEL.responses().clone(), MODEL.circuit().clone());
        ForwardModel::with(paper::sensor(), responses, fields, circuit).unwrap()
    });

    fn by(x_mm: f64, y_mm: f64, load: Load) -> RequestedContact {
        RequestedContact { x_mm, y_mm, load }
    }

    fn simulated(placed: &[RequestedContact]) -> Result<Pressed, PressedError> {
        pressed(&SKIN, placed, &mut Workspace::default())
    }

    #[test]
    fn forces_are_those_of_the_requested_depths_and_back() {
        let depths = [(270.0, 280.0, 1.5), (281.3, 300.0, 0.8), (61.7, 90.2, 2.0)];
        let by_depth = depths.map(|(x, y, depth)| by(x, y, Load::DepthMm(depth)));
        let found = simulated(&by_depth).unwrap();
        for (depth_mm, (.., asked)) in found.depths_mm.iter().zip(depths) {
            assert!((depth_mm - asked).abs() < 1e-5, "{depth_mm} for {asked}");
        }
        let forces = found.contacts.iter().map(|c| by(c.x_mm, c.y_mm, Load::ForceN(c.force_n)));
        assert_eq!(simulated(&forces.collect::<Vec<_>>()).unwrap(), found);
        assert!(found.contacts.iter().all(|c| c.force_n > 1.0), "{:?}", found.contacts);
    }

    #[test]
    fn the_frame_is_that_of_the_model_and_an_untouched_skin_has_no_dent() {
        let found = simulated(&[by(200.0, 150.0, Load::ForceN(20.0))]).unwrap();
        let mut work = Workspace::default();
        let contact = Contact { x_mm: 200.0, y_mm: 150.0, force_n: 20.0 };
        assert_eq!(found.voltages_v, SKIN.voltages(&[contact], &mut work).unwrap());
        let untouched = simulated(&[]).unwrap();
        assert_eq!(untouched.voltages_v, SKIN.voltages(&[], &mut work).unwrap());
        assert!(untouched.dent.values.iter().all(|mm| *mm == 0.0));
    }

    #[test]
    fn a_place_that_another_contact_presses_deeper_needs_no_force() {
        let deep = by(270.0, 280.0, Load::ForceN(40.0));
        let found = simulated(&[deep, by(272.0, 280.0, Load::DepthMm(0.1))]).unwrap();
        assert!(found.contacts[1].force_n < 1e-6 && found.depths_mm[1] > 0.1, "{found:?}");
        let none = simulated(&[by(270.0, 280.0, Load::DepthMm(0.0))]).unwrap();
        assert_eq!(none.contacts[0].force_n, 0.0);
    }

    #[test]
    fn a_depth_that_no_force_reaches_is_named() {
        let limp = by(270.0, 280.0, Load::DepthMm(1e3));
        let Err(PressedError::TooDeep { contact: 1, deepest_mm }) =
            simulated(&[by(100.0, 100.0, Load::ForceN(5.0)), limp])
        else {
            panic!()
        };
        assert!(deepest_mm > 3.0 && deepest_mm < 1e3, "{deepest_mm}");
    }
}
