//! The forward model: forces on the skin in, a frame of voltages out.
//! Uses: all of this crate. Never: files, chance.
//!
//! `forces -> compression (superposed unit responses, clamped at 0 after the sum) -> fields ->
//! f(x) of Eq. 1 per node -> resistor network -> Z -> voltages`. Exact in f64.

use std::sync::Arc;

use crate::circuit::ReadoutCircuit;
use crate::deformation::NodeForce;
use crate::digest::{Digest, hex};
use crate::fields::{FieldLength, NodeFields};
use crate::mesh::{Mesh, MeshError};
use crate::network::kron::{KronReduction, KronWork};
use crate::network::readout::ReadoutWork;
use crate::network::{ElectrodeError, SheetNetwork};
use crate::piezo::{SPECIMEN_AREA_MM2, conductance_s};
use crate::responses::UnitResponses;
use crate::sensor::{ResistancePer, Sensor};

/// A contact counts as on a point within this distance, mm.
pub const POINT_TOLERANCE_MM: f64 = 0.5;

/// One contact of a tip's size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Place on the skin, mm.
    pub x_mm: f64,
    /// Place on the skin, mm.
    pub y_mm: f64,
    /// Force, N, >= 0.
    pub force_n: f64,
}

/// A force on one vertex node.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VertexForce {
    /// Row of the unit responses.
    pub row: usize,
    /// Force, N, >= 0.
    pub force_n: f64,
}

/// Why there is no forward model.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The mesh does not fit the sensor.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The unit responses are another sensor's.
    #[error("forward model: the unit responses belong to another sensor")]
    OtherResponses,
    /// A field's length does not fit.
    #[error(transparent)]
    Fields(#[from] FieldLength),
    /// An electrode does not fit.
    #[error(transparent)]
    Electrode(#[from] ElectrodeError),
}

/// A contact that the model does not take.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ContactError {
    /// It is not on one of the points.
    #[error("contact {contact} at ({x_mm:.2}, {y_mm:.2}) mm is on none of the skin's points")]
    NotAPoint {
        /// Index of the contact.
        contact: usize,
        /// Its place, mm.
        x_mm: f64,
        /// Its place, mm.
        y_mm: f64,
    },
    /// Its force is negative or not a number.
    #[error("contact {contact}: force {force_n} N is not a number >= 0")]
    Force {
        /// Index of the contact.
        contact: usize,
        /// Its force, N.
        force_n: f64,
    },
}

/// Eq. 1 at one node, with everything per node folded in.
#[derive(Debug, Clone, Copy)]
struct NodeLaw {
    a_ohm: f64,
    b_per_mm: f64,
    c_ohm: f64,
    compliance: f64,
}

/// The forward model of one skin. `Send + Sync`; each thread brings its own [`Workspace`].
#[derive(Debug)]
pub struct ForwardModel {
    sensor: Sensor,
    mesh: Mesh,
    responses: Arc<UnitResponses>,
    fields: NodeFields,
    circuit: ReadoutCircuit,
    /// Rows of the unit responses under each point's vertices.
    point_rows: Vec<[usize; 6]>,
    laws: Vec<NodeLaw>,
    reduction: KronReduction,
    /// Nodes of the network: the mesh's, and electrodes of their own.
    network_nodes: usize,
    hash: String,
}

/// Memory of one evaluation.
#[derive(Debug, Default)]
pub struct Workspace {
    forces: Vec<VertexForce>,
    compression_mm: Vec<f64>,
    to_top_s: Vec<f64>,
    kron: KronWork,
    readout: ReadoutWork,
}

impl Workspace {
    /// Foam compression of the last evaluation at every node, mm, after fields and clamp.
    pub fn compression_mm(&self) -> &[f64] {
        &self.compression_mm
    }

    /// Conductance of the foam at every node in the last evaluation, S.
    pub fn to_top_s(&self) -> &[f64] {
        &self.to_top_s
    }

    /// Impedances and electrode voltages of the last evaluation.
    pub fn readout(&self) -> &ReadoutWork {
        &self.readout
    }
}

impl ForwardModel {
    /// The nominal skin of a sensor file.
    pub fn new(sensor: &Sensor, responses: Arc<UnitResponses>) -> Result<Self, ModelError> {
        let mesh = Mesh::new(sensor)?;
        let fields = NodeFields::nominal(&mesh);
        Self::with(sensor, responses, fields, ReadoutCircuit::nominal(sensor))
    }

    /// A skin that differs from the nominal one.
    pub fn with(
        sensor: &Sensor,
        responses: Arc<UnitResponses>,
        fields: NodeFields,
        circuit: ReadoutCircuit,
    ) -> Result<Self, ModelError> {
        if !responses.fits(sensor) {
            return Err(ModelError::OtherResponses);
        }
        let mesh = Mesh::new(sensor)?;
        fields.check(&mesh)?;
        let network = network(sensor, &mesh, &fields, &circuit)?;
        let row = |node: u32| responses.row_of(node).ok_or(ModelError::OtherResponses);
        let point_rows = mesh
            .points
            .iter()
            .map(|p| -> Result<[usize; 6], ModelError> {
                let mut rows = [0; 6];
                for (row_at, vertex) in rows.iter_mut().zip(p.vertices) {
                    *row_at = row(vertex)?;
                }
                Ok(rows)
            })
            .collect::<Result<_, _>>()?;
        Ok(Self {
            laws: node_laws(sensor, &mesh, &fields),
            hash: model_hash(sensor, &responses, &fields, &circuit),
            reduction: KronReduction::new(&network),
            network_nodes: network.places_mm.len(),
            sensor: sensor.clone(),
            mesh,
            responses,
            fields,
            circuit,
            point_rows,
        })
    }

    /// The sensor.
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    /// The mesh.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// The unit responses.
    pub fn responses(&self) -> &Arc<UnitResponses> {
        &self.responses
    }

    /// The fields.
    pub fn fields(&self) -> &NodeFields {
        &self.fields
    }

    /// The readout circuit.
    pub fn circuit(&self) -> &ReadoutCircuit {
        &self.circuit
    }

    /// The resistor network without the foam, as [`Workspace::to_top_s`] counts its nodes.
    pub fn network(&self) -> Result<SheetNetwork, ElectrodeError> {
        network(&self.sensor, &self.mesh, &self.fields, &self.circuit)
    }

    /// Rows of the unit responses under a point's six vertices.
    pub fn point_rows(&self, point: usize) -> &[usize; 6] {
        &self.point_rows[point]
    }

    /// Multiply-adds that the reduction of the network takes, per frame.
    pub fn multiply_adds(&self) -> usize {
        self.reduction.multiply_adds()
    }

    /// Name of the model: `sim-` and the start of a sha256 over all that its frames depend on.
    pub fn model_hash(&self) -> &str {
        &self.hash
    }

    /// The frame of contacts on points, V after gain: `[n * k + j]` = V_j - V_(j+1 mod n) while
    /// electrode k is the sink. No contacts: the untouched skin.
    pub fn voltages<'w>(
        &self,
        contacts: &[Contact],
        work: &'w mut Workspace,
    ) -> Result<&'w [f64], ContactError> {
        let mut forces = std::mem::take(&mut work.forces);
        let outcome = self.spread(contacts, &mut forces);
        if outcome.is_ok() {
            self.evaluate(&forces, work);
        }
        work.forces = forces;
        outcome.map(|()| work.readout.frame_v())
    }

    /// The forces on nodes of the surface that contacts amount to.
    pub fn node_forces(&self, contacts: &[Contact]) -> Result<Vec<NodeForce>, ContactError> {
        let mut forces = Vec::new();
        self.spread(contacts, &mut forces)?;
        let node = |row: usize| self.responses.vertices()[row];
        Ok(forces.iter().map(|f| NodeForce { node: node(f.row), force_n: f.force_n }).collect())
    }

    /// Replaces `forces` by those of contacts: each as six equal ones on its hexagon's vertices.
    fn spread(
        &self,
        contacts: &[Contact],
        forces: &mut Vec<VertexForce>,
    ) -> Result<(), ContactError> {
        forces.clear();
        for (contact, c) in contacts.iter().enumerate() {
            if !(c.force_n >= 0.0 && c.force_n.is_finite()) {
                return Err(ContactError::Force { contact, force_n: c.force_n });
            }
            let point = self
                .sensor
                .point_near(c.x_mm, c.y_mm, POINT_TOLERANCE_MM)
                .ok_or(ContactError::NotAPoint { contact, x_mm: c.x_mm, y_mm: c.y_mm })?;
            let force_n = c.force_n / 6.0;
            forces.extend(self.point_rows[point].map(|row| VertexForce { row, force_n }));
        }
        Ok(())
    }

    /// The frame of any forces on vertices (tilted tips, places between points), V after gain.
    pub fn voltages_of_vertex_forces<'w>(
        &self,
        forces: &[VertexForce],
        work: &'w mut Workspace,
    ) -> &'w [f64] {
        self.evaluate(forces, work);
        work.readout.frame_v()
    }

    fn evaluate(&self, forces: &[VertexForce], work: &mut Workspace) {
        let x = &mut work.compression_mm;
        x.clear();
        x.resize(self.mesh.plane_nodes(), 0.0);
        for force in forces {
            for (x, &unit) in x.iter_mut().zip(self.responses.row(force.row)) {
                *x += force.force_n * f64::from(unit);
            }
        }
        work.to_top_s.clear();
        work.to_top_s.resize(self.network_nodes, 0.0);
        for ((x, g), law) in x.iter_mut().zip(&mut work.to_top_s).zip(&self.laws) {
            *x = x.max(0.0) * law.compliance;
            if let Some(lut) = &self.fields.displacement {
                *x = lut.apply(*x);
            }
            *g = conductance_s(law.a_ohm, law.b_per_mm, law.c_ohm, *x);
        }
        let reduced = self.reduction.reduce(&work.to_top_s, &mut work.kron);
        work.readout.evaluate(reduced, &self.circuit);
    }
}

fn network(
    sensor: &Sensor,
    mesh: &Mesh,
    fields: &NodeFields,
    circuit: &ReadoutCircuit,
) -> Result<SheetNetwork, ElectrodeError> {
    let square_s = 1.0 / sensor.file.circuit.sheet_ohm_per_sq;
    let sheet_s: Vec<f64> =
        fields.ln_sheet_conductance.iter().map(|ln| square_s * ln.exp()).collect();
    SheetNetwork::new(mesh, &sheet_s, circuit)
}

fn node_laws(sensor: &Sensor, mesh: &Mesh, fields: &NodeFields) -> Vec<NodeLaw> {
    let piezo = &sensor.file.piezo;
    let areas = mesh.node_areas_mm2();
    (0..mesh.plane_nodes())
        .map(|node| {
            let scale = match piezo.resistance_per {
                ResistancePer::Node => 1.0,
                ResistancePer::Area => SPECIMEN_AREA_MM2 / areas[node],
            };
            NodeLaw {
                a_ohm: piezo.a_ohm * fields.ln_a[node].exp() * scale,
                b_per_mm: piezo.b_per_mm * fields.ln_b[node].exp(),
                c_ohm: piezo.c_ohm * fields.ln_c[node].exp() * scale,
                compliance: fields.ln_compliance[node].exp(),
            }
        })
        .collect()
}

fn model_hash(
    sensor: &Sensor,
    responses: &UnitResponses,
    fields: &NodeFields,
    circuit: &ReadoutCircuit,
) -> String {
    let mut digest = Digest::new("forward model 1; kron f64 1");
    digest.bytes(responses.own_key());
    let piezo = &sensor.file.piezo;
    digest.numbers([piezo.a_ohm, piezo.b_per_mm, piezo.c_ohm]);
    digest.word(match piezo.resistance_per {
        ResistancePer::Node => "node",
        ResistancePer::Area => "area",
    });
    digest.numbers([sensor.file.circuit.sheet_ohm_per_sq]);
    fields.digest(&mut digest);
    circuit.digest(&mut digest);
    format!("sim-{}", hex(&digest.finish()[..8]))
}
