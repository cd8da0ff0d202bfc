//! The resistor network: sheet, foam resistors to the top layer, electrodes; solved exactly.
//! Uses: `mesh`, `circuit`. Never: how the foam's conductances came about.
//!
//! Unknowns are the sheet's nodes (and electrodes that are not nodes), beside one more: the top
//! layer. `order` and `kron` remove all nodes but the electrodes and the top without a subtraction;
//! `plan`, `lane` and `reduce` do the same for many loads side by side; `readout` turns what is left
//! into the impedances Z and the voltages.

pub mod adjoint;
pub mod back;
pub mod kron;
pub(crate) mod lane;
#[cfg(target_arch = "x86_64")]
pub(crate) mod lane_x86;
pub mod plan;
pub mod readout;
pub(crate) mod reduce;
pub mod sheet;

use crate::circuit::ReadoutCircuit;
use crate::mesh::Mesh;

/// A resistor between two nodes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resistor {
    /// One end.
    pub a: u32,
    /// The other end.
    pub b: u32,
    /// Conductance, S, > 0.
    pub conductance_s: f64,
}

/// Everything in the network but the foam.
#[derive(Debug, Clone, PartialEq)]
pub struct SheetNetwork {
    /// Place of each node, mm: the mesh's nodes, then electrodes that are nodes of their own.
    pub places_mm: Vec<[f64; 2]>,
    /// Resistors, no pair twice.
    pub resistors: Vec<Resistor>,
    /// Node of each electrode.
    pub electrodes: Vec<u32>,
}

/// An electrode that the network cannot hold.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ElectrodeError {
    /// An ideal electrode must stand on a node.
    #[error("network: electrode {electrode} is off every node and needs a contact resistance")]
    IdealOffNode {
        /// Index of the electrode.
        electrode: usize,
    },
    /// Two electrodes would be the same node.
    #[error("network: electrode {electrode} stands on another one's node")]
    SharedNode {
        /// Index of the second electrode.
        electrode: usize,
    },
    /// A resistance is negative or not a number.
    #[error("network: electrode {electrode} has a resistance of {ohm} ohm")]
    Resistance {
        /// Index of the electrode.
        electrode: usize,
        /// The value.
        ohm: f64,
    },
}

impl SheetNetwork {
    /// The sheet of a mesh (`sheet_s`: conductance per square of each triangle, S) with a circuit's
    /// electrodes on it.
    pub fn new(
        mesh: &Mesh,
        sheet_s: &[f64],
        circuit: &ReadoutCircuit,
    ) -> Result<Self, ElectrodeError> {
        let mut network = Self {
            places_mm: mesh.nodes_mm.clone(),
            resistors: sheet::resistors(mesh, sheet_s),
            electrodes: Vec::new(),
        };
        for (electrode, site) in circuit.electrodes.iter().enumerate() {
            for ohm in [site.contact_ohm, site.lead_ohm] {
                if !(ohm >= 0.0 && ohm.is_finite()) {
                    return Err(ElectrodeError::Resistance { electrode, ohm });
                }
            }
            let place = mesh.locate(site.x_mm, site.y_mm);
            let node = if site.contact_ohm > 0.0 {
                let own = network.places_mm.len() as u32;
                network.places_mm.push([site.x_mm, site.y_mm]);
                for (node, weight) in place.nodes.into_iter().zip(place.weights) {
                    if weight > 0.0 {
                        let conductance_s = weight / site.contact_ohm;
                        network.resistors.push(Resistor { a: node, b: own, conductance_s });
                    }
                }
                own
            } else {
                let on_node = place.weights.iter().position(|&w| w == 1.0);
                place.nodes[on_node.ok_or(ElectrodeError::IdealOffNode { electrode })?]
            };
            if network.electrodes.contains(&node) {
                return Err(ElectrodeError::SharedNode { electrode });
            }
            network.electrodes.push(node);
        }
        Ok(network)
    }
}
