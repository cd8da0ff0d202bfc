//! The forward model: from forces on the skin to a frame of voltages.
//! Uses: all of this crate. Never: files, chance.
//!
//! `forces -> compression (superposed unit responses, clamped at 0 after the sum) -> fields ->
//! f(x) of Eq. 1 per node -> resistor network -> Z -> voltages`. Exact in f64.

use std::sync::Arc;

use crate::calibrated::CalibratedSensor;
use crate::circuit::ReadoutCircuit;
use crate::deformation::NodeForce;
use crate::digest::Digest;
use crate::fields::{FieldLength, LutError, NodeFields};
use crate::mesh::{Mesh, MeshError};
use crate::network::kron::{KronReduction, KronWork};
use crate::network::readout::ReadoutWork;
use crate::network::{ElectrodeError, SheetNetwork};
use crate::piezo::{NodeLaw, SPECIMEN_AREA_MM2};
use crate::responses::UnitResponses;
use crate::sensor::{ResistancePer, Sensor};
use crate::tip::{Share, Spreading, TipLattice};

/// Distance within which a contact counts as one on a point, mm, for callers that need the number
/// of the point; the model itself uses the exact position of every contact.
pub const POINT_TOLERANCE_MM: f64 = 0.5;

/// One contact with the tip's diameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Position on the skin along x, mm.
    pub x_mm: f64,
    /// Position on the skin along y, mm.
    pub y_mm: f64,
    /// Force, N, >= 0.
    pub force_n: f64,
}

/// Why a forward model cannot be built.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum ModelError {
    #[error(transparent)]
    Mesh(#[from] MeshError),
    #[error("forward model: the unit responses belong to another sensor")]
    OtherResponses,
    #[error(transparent)]
    Foam(#[from] LutError),
    #[error(transparent)]
    Fields(#[from] FieldLength),
    #[error(transparent)]
    Electrode(#[from] ElectrodeError),
}

/// Result of work with contacts.
pub type ContactResult<T> = Result<T, ContactError>;

/// Why the model rejects a contact; contacts count from 0.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum ContactError {
    /// `field`: `x_mm` or `y_mm`; `least_mm`: a tip's radius.
    #[error(
        "contact {contact}: {field} = {value_mm} is outside {least_mm} to {most_mm} mm: \
         a tip must be wholly on the skin"
    )]
    OffSkin { contact: usize, field: &'static str, value_mm: f64, least_mm: f64, most_mm: f64 },
    #[error("contact {contact}: force_n = {force_n} is not a finite number >= 0 N")]
    Force { contact: usize, force_n: f64 },
}

/// The forward model of one skin. `Send + Sync`; each thread needs its own [`Workspace`].
#[derive(Debug, Clone)]
pub struct ForwardModel {
    sensor: CalibratedSensor,
    mesh: Mesh,
    responses: Arc<UnitResponses>,
    fields: NodeFields,
    circuit: ReadoutCircuit,
    lattice: TipLattice,
    pub(crate) laws: Vec<NodeLaw>,
    pub(crate) reduction: KronReduction,
    /// Nodes of the network: those of the mesh, and electrodes that are separate nodes.
    network_nodes: usize,
    pub(crate) electrode_nodes: Vec<u32>,
    hash: String,
}

/// Memory of one evaluation.
#[derive(Debug, Default)]
pub struct Workspace {
    shares: Vec<Share>,
    forces: Vec<NodeForce>,
    pub(crate) compression_mm: Vec<f64>,
    pub(crate) to_top_s: Vec<f64>,
    pub(crate) kron: KronWork,
    pub(crate) readout: ReadoutWork,
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
    /// Builds the model of a sensor's skin: the calibrated skin if a calibration of the skin is
    /// applied to the sensor, else the nominal one of its file.
    ///
    /// # Errors
    /// `ModelError` if the mesh, the unit responses, the foam's law or an electrode does not match.
    pub fn new(
        sensor: impl Into<CalibratedSensor>,
        responses: Arc<UnitResponses>,
    ) -> Result<Self, ModelError> {
        let sensor = sensor.into();
        let mesh = Mesh::new(&sensor)?;
        let (fields, circuit) = match sensor.skin() {
            Some(skin) => (skin.fields.over(&sensor, &mesh)?, skin.electrodes.circuit(&sensor)),
            None => (NodeFields::nominal(&mesh), ReadoutCircuit::nominal(&sensor)),
        };
        Self::with(sensor, responses, fields, circuit)
    }

    /// Builds the model of a skin that differs from the nominal one.
    ///
    /// # Errors
    /// `ModelError` if the mesh, the unit responses, a field or an electrode does not match.
    pub fn with(
        sensor: impl Into<CalibratedSensor>,
        responses: Arc<UnitResponses>,
        fields: NodeFields,
        circuit: ReadoutCircuit,
    ) -> Result<Self, ModelError> {
        let sensor = sensor.into();
        if !responses.fits(&sensor) {
            return Err(ModelError::OtherResponses);
        }
        let mesh = Mesh::new(&sensor)?;
        fields.check(&mesh)?;
        let network = network(&sensor, &mesh, &fields, &circuit)?;
        Ok(Self {
            laws: node_laws(&sensor, &mesh, &fields),
            hash: model_hash(&sensor, &responses, &fields, &circuit),
            reduction: KronReduction::new(&network),
            network_nodes: network.places_mm.len(),
            electrode_nodes: network.electrodes,
            lattice: TipLattice::new(&sensor, &mesh),
            sensor,
            mesh,
            responses,
            fields,
            circuit,
        })
    }

    /// Returns the same skin with other electrodes.
    ///
    /// # Errors
    /// `ModelError::Electrode` if an electrode is invalid.
    pub fn with_circuit(&self, circuit: ReadoutCircuit) -> Result<Self, ModelError> {
        let network = network(&self.sensor, &self.mesh, &self.fields, &circuit)?;
        Ok(Self {
            hash: model_hash(&self.sensor, &self.responses, &self.fields, &circuit),
            reduction: self.reduction.of_another(&network),
            network_nodes: network.places_mm.len(),
            electrode_nodes: network.electrodes,
            circuit,
            ..self.clone()
        })
    }

    /// The sensor of the model, with its calibration.
    pub fn sensor(&self) -> &CalibratedSensor {
        &self.sensor
    }

    /// The mesh of the skin.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// The unit responses of the sensor.
    pub fn responses(&self) -> &Arc<UnitResponses> {
        &self.responses
    }

    /// The fields of the skin.
    pub fn fields(&self) -> &NodeFields {
        &self.fields
    }

    /// The readout circuit.
    pub fn circuit(&self) -> &ReadoutCircuit {
        &self.circuit
    }

    /// The resistor network without the foam; nodes are numbered as in [`Workspace::to_top_s`].
    ///
    /// # Errors
    /// `ElectrodeError` if an electrode is invalid.
    pub fn network(&self) -> Result<SheetNetwork, ElectrodeError> {
        network(&self.sensor, &self.mesh, &self.fields, &self.circuit)
    }

    /// Multiply-adds per frame in the reduction of the network.
    pub fn multiply_adds(&self) -> usize {
        self.reduction.multiply_adds()
    }

    /// Name of the model: `sim-` and the start of a sha256 over everything that determines its
    /// frames.
    pub fn model_hash(&self) -> &str {
        &self.hash
    }

    /// Computes the frame of contacts anywhere on the skin, V after gain: `[n * k + j]` = V_j -
    /// V_(j+1 mod n) while electrode k is the sink. No contacts: the untouched skin. [`crate::tip`]
    /// describes how a tip between the nodes loads them.
    ///
    /// # Errors
    /// `ContactError` with the first contact that [`Self::check`] rejects.
    pub fn voltages<'w>(
        &self,
        contacts: &[Contact],
        work: &'w mut Workspace,
    ) -> ContactResult<&'w [f64]> {
        self.load(contacts, work)?;
        Ok(self.solve(work))
    }

    /// Computes the frame of arbitrary forces on nodes (tilted tips), V after gain.
    pub fn voltages_of_node_forces<'w>(
        &self,
        forces: &[NodeForce],
        work: &'w mut Workspace,
    ) -> &'w [f64] {
        self.superpose(forces, &mut work.compression_mm);
        self.solve(work)
    }

    /// Checks the position and the force of a contact; `contact` is its index for the error.
    ///
    /// # Errors
    /// `ContactError::OffSkin` if the tip is not wholly on the skin; `ContactError::Force` if the
    /// force is negative or not finite.
    pub fn check(&self, contact: usize, c: &Contact) -> ContactResult<()> {
        let least_mm = self.sensor.file.tip_diameter_mm / 2.0;
        for (field, value_mm, extent_mm) in [
            ("x_mm", c.x_mm, self.sensor.file.width_mm),
            ("y_mm", c.y_mm, self.sensor.file.height_mm),
        ] {
            let most_mm = extent_mm - least_mm;
            if !(least_mm..=most_mm).contains(&value_mm) {
                return Err(ContactError::OffSkin { contact, field, value_mm, least_mm, most_mm });
            }
        }
        if !(c.force_n >= 0.0 && c.force_n.is_finite()) {
            return Err(ContactError::Force { contact, force_n: c.force_n });
        }
        Ok(())
    }

    /// Nodal forces on the surface that are equivalent to contacts.
    ///
    /// # Errors
    /// `ContactError` with the first contact that [`Self::check`] rejects.
    pub fn node_forces(&self, contacts: &[Contact]) -> ContactResult<Vec<NodeForce>> {
        let (mut shares, mut forces) = (Vec::new(), Vec::new());
        self.spread_all(contacts, &mut shares, &mut forces)?;
        Ok(forces)
    }

    /// Stores the compression of the nominal skin under contacts, before the clamp, in `work`.
    pub(crate) fn load(&self, contacts: &[Contact], work: &mut Workspace) -> ContactResult<()> {
        self.spread_all(contacts, &mut work.shares, &mut work.forces)?;
        self.superpose(&work.forces, &mut work.compression_mm);
        Ok(())
    }

    /// Writes the nodal forces of contacts; `shares` is memory.
    fn spread_all(
        &self,
        contacts: &[Contact],
        shares: &mut Vec<Share>,
        forces: &mut Vec<NodeForce>,
    ) -> ContactResult<()> {
        forces.clear();
        for (index, contact) in contacts.iter().enumerate() {
            self.check(index, contact)?;
            shares.clear();
            self.spread(contact, shares);
            let sixth_n = contact.force_n / 6.0;
            let loaded = shares.iter().filter(|share| share.sixths != 0.0);
            forces.extend(loaded.map(|s| NodeForce { node: s.node, force_n: sixth_n * s.sixths }));
        }
        Ok(())
    }

    /// The lattice on which tips are placed.
    pub fn lattice(&self) -> &TipLattice {
        &self.lattice
    }

    /// Appends the shares of a contact's force on the nodes to `shares`.
    pub(crate) fn spread(&self, contact: &Contact, shares: &mut Vec<Share>) {
        self.lattice.spread(Spreading::Sharp, [contact.x_mm, contact.y_mm], shares);
    }

    /// Sums the unit responses, each times its node's force, at every node.
    fn superpose(&self, forces: &[NodeForce], sum: &mut Vec<f64>) {
        sum.clear();
        sum.resize(self.mesh.plane_nodes(), 0.0);
        for force in forces {
            for (sum, &unit) in sum.iter_mut().zip(self.responses.row(force.node as usize)) {
                *sum += force.force_n * f64::from(unit);
            }
        }
    }

    /// Converts the compression of the nominal skin to that of this skin, and to conductances.
    pub(crate) fn conduct(&self, work: &mut Workspace) {
        work.to_top_s.clear();
        work.to_top_s.resize(self.network_nodes, 0.0);
        let nodes = work.compression_mm.iter_mut().zip(&mut work.to_top_s);
        for ((x, g), law) in nodes.zip(&self.laws) {
            *x = x.max(0.0) * law.compliance;
            if let Some(lut) = &self.fields.displacement {
                *x = lut.apply(*x);
            }
            *g = law.conductance_s(*x);
        }
    }

    fn solve<'w>(&self, work: &'w mut Workspace) -> &'w [f64] {
        self.conduct(work);
        let reduced = self.reduction.reduce(&work.to_top_s, &mut work.kron);
        work.readout.evaluate(reduced, &self.circuit);
        work.readout.frame_v()
    }
}

fn network(
    sensor: &Sensor,
    mesh: &Mesh,
    fields: &NodeFields,
    circuit: &ReadoutCircuit,
) -> Result<SheetNetwork, ElectrodeError> {
    let square_s = 1.0 / sensor.file.circuit.sheet_ohm_per_sq;
    let sheet_s: Vec<_> = (0..mesh.triangles.len())
        .map(|triangle| fields.sheet_factors(triangle).map(|factor| square_s * factor))
        .collect();
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
    let mut digest = Digest::new("forward model 2; kron f64 1");
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
    // How a tip's force is shared among the nodes.
    digest.word("sharp");
    format!("sim-{}", hex::encode(&digest.finish()[..8]))
}
