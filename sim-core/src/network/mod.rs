//! The resistor network: sheet, foam resistors to the top layer, electrodes; solved exactly.
//! Uses: `mesh`, `circuit`, `order`. Never: the origin of the foam's conductances.
//!
//! Unknowns are the sheet's nodes (and electrodes that are separate nodes), and one further: the
//! top layer. `order` and `kron` remove all nodes except the electrodes and the top without a
//! subtraction; `plan`, `lane` and `reduce` do the same for many loads in parallel; `readout`
//! converts the result to the impedances Z and the voltages.

pub mod adjoint;
mod back;
pub mod kron;
pub(crate) mod lane;
pub(crate) mod lane_work;
#[cfg(target_arch = "x86_64")]
pub(crate) mod lane_x86;
pub mod plan;
pub mod readout;
pub(crate) mod reduce;
pub mod sheet;

use crate::circuit::ReadoutCircuit;
use crate::mesh::Mesh;
use crate::order::{Part, dissect};

/// Rows, columns and products are processed in squares of this side length.
const TILE: usize = 4;

/// A resistor between two nodes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resistor {
    /// Node at one end.
    pub a: u32,
    /// Node at the other end.
    pub b: u32,
    /// Conductance, S, > 0.
    pub conductance_s: f64,
}

/// The network without the foam.
#[derive(Debug, Clone, PartialEq)]
pub struct SheetNetwork {
    /// Position of each node, mm: the mesh's nodes, then electrodes that are separate nodes.
    pub places_mm: Vec<[f64; 2]>,
    /// Resistors, at most one per pair of nodes.
    pub resistors: Vec<Resistor>,
    /// Node of each electrode.
    pub electrodes: Vec<u32>,
}

/// Why the network cannot contain an electrode; electrodes count from 0.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum ElectrodeError {
    #[error("network: electrode {electrode} is off every node and needs a contact resistance")]
    IdealOffNode { electrode: usize },
    #[error("network: electrode {electrode} is on the node of another one")]
    SharedNode { electrode: usize },
    #[error("network: electrode {electrode} has a resistance of {ohm} ohm")]
    Resistance { electrode: usize, ohm: f64 },
}

impl SheetNetwork {
    /// Builds the sheet of a mesh (`sheet_s`: conductance per square of each triangle, S, along x and y)
    /// with a circuit's electrodes on it.
    ///
    /// # Errors
    /// `ElectrodeError` with the first electrode that is off a node, on another one's node, or has
    /// an invalid resistance.
    pub fn new(
        mesh: &Mesh,
        sheet_s: &[[f64; 2]],
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
            let place = mesh.locate([site.x_mm, site.y_mm]);
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

    /// For each node, the nodes that share a resistor with it.
    fn neighbours(&self) -> Vec<Vec<u32>> {
        let mut neighbours = vec![Vec::new(); self.places_mm.len()];
        for r in &self.resistors {
            neighbours[r.a as usize].push(r.b);
            neighbours[r.b as usize].push(r.a);
        }
        neighbours
    }

    /// Parts of the removal of all nodes except the electrodes, which remain in the last part, the root: it removes nothing.
    fn parts(&self, neighbours: &[Vec<u32>]) -> Vec<Part> {
        let mut parts = dissect(&self.places_mm, neighbours, &self.electrodes);
        parts.push(Part { nodes: Vec::new(), children: vec![parts.len() - 1] });
        parts
    }
}

/// Index of a position among ascending ones.
fn row_of(sorted: &[u32], at: u32) -> u32 {
    sorted.binary_search(&at).expect("a front holds every node that its children left") as u32
}
