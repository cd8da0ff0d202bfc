//! The frame's derivative: by contacts (position, force) and by the skin's fields and circuit.
//! Uses: `forward`, `tip`, `piezo`, `network::adjoint`. Never: differences of frames.
//!
//! One elimination and one back-substitution per load, whatever the number of parameters; then each
//! parameter costs a sum over the nodes that it moves.
//!
//! Where the model has a kink the derivative is one-sided: a node at or below the clamps (uplift;
//! the smallest compression inside f) does not change with load or compliance; at a sample of a
//! displacement table the next piece counts; on an edge of the lattice, one of its two triangles.

use crate::circuit::ReadoutCircuit;
use crate::fields::NodeFields;
use crate::forward::{Contact, ContactResult, ForwardModel, Workspace};
use crate::mesh::Mesh;
use crate::network::adjoint::{Direction, Potentials};
use crate::network::kron::KronFactor;
use crate::network::{Resistor, sheet};
use crate::piezo::NodeLaw;
use crate::tip::Share;

/// A contact's parameters, in the order of [`Linearised::contacts`]: x (mm), y (mm), force (N).
pub const CONTACT_PARAMETERS: usize = 3;

/// A field of parameters of the skin or its circuit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Field {
    /// ln a of Eq. 1, per node.
    LnA,
    /// ln b of Eq. 1, per node.
    LnB,
    /// ln c of Eq. 1, per node.
    LnC,
    /// ln of the foam's compliance, per node.
    LnCompliance,
    /// ln of the sheet's conductance, per triangle.
    LnSheetConductance,
    /// ln of the sheet's conductance along x over that along y: one value.
    LnSheetAnisotropy,
    /// Lead resistance, ohm, per electrode.
    LeadOhm,
    /// Contact (spreading) resistance, ohm, per electrode. On an ideal electrode, from 0 up.
    ContactOhm,
    /// The electrode's x, mm. An ideal electrode is a node and cannot move: 0.
    ElectrodeX,
    /// The electrode's y, mm. An ideal electrode is a node and cannot move: 0.
    ElectrodeY,
}

impl Field {
    /// All fields, in the order of their declaration.
    pub const ALL: [Self; 10] = [
        Self::LnA,
        Self::LnB,
        Self::LnC,
        Self::LnCompliance,
        Self::LnSheetConductance,
        Self::LnSheetAnisotropy,
        Self::LeadOhm,
        Self::ContactOhm,
        Self::ElectrodeX,
        Self::ElectrodeY,
    ];

    /// Number of values of the field on a model.
    pub fn len(self, model: &ForwardModel) -> usize {
        match self {
            Self::LnA | Self::LnB | Self::LnC | Self::LnCompliance => model.mesh().plane_nodes(),
            Self::LnSheetConductance => model.mesh().triangles.len(),
            Self::LnSheetAnisotropy => 1,
            Self::LeadOhm | Self::ContactOhm | Self::ElectrodeX | Self::ElectrodeY => {
                model.circuit().electrodes.len()
            }
        }
    }
}

/// A direction in one field: the change of some of its values; the others are fixed.
#[derive(Debug, Clone, PartialEq)]
pub struct Mode {
    /// The field whose values change.
    pub field: Field,
    /// Index in the field, and change of that value. The cost is proportional to their number.
    pub entries: Vec<(u32, f64)>,
}

/// Derivatives of one node's conductance to the top, S per unit.
#[derive(Debug, Clone, Copy, Default)]
struct NodeSlopes {
    /// Per mm of the nominal skin's compression before the clamp.
    per_mm: f64,
    per_ln_a: f64,
    per_ln_b: f64,
    per_ln_c: f64,
    per_ln_compliance: f64,
}

impl NodeSlopes {
    fn new(law: &NodeLaw, fields: &NodeFields, sum_mm: f64) -> Self {
        let linear_mm = sum_mm.max(0.0) * law.compliance;
        let (compression_mm, slope) = match &fields.displacement {
            Some(lut) => (lut.apply(linear_mm), lut.slope(linear_mm)),
            None => (linear_mm, 1.0),
        };
        let of = law.conductance_slopes(compression_mm);
        let presses = if sum_mm > 0.0 { law.compliance } else { 0.0 };
        Self {
            per_mm: of.per_mm * slope * presses,
            per_ln_a: of.per_ln_a,
            per_ln_b: of.per_ln_b,
            per_ln_c: of.per_ln_c,
            per_ln_compliance: of.per_mm * slope * linear_mm,
        }
    }

    fn of(&self, field: Field) -> f64 {
        match field {
            Field::LnA => self.per_ln_a,
            Field::LnB => self.per_ln_b,
            Field::LnC => self.per_ln_c,
            Field::LnCompliance => self.per_ln_compliance,
            Field::LnSheetConductance
            | Field::LnSheetAnisotropy
            | Field::LeadOhm
            | Field::ContactOhm
            | Field::ElectrodeX
            | Field::ElectrodeY => 0.0,
        }
    }
}

/// Memory of a linearisation; each thread needs its own.
#[derive(Debug, Default)]
pub struct JacobianWork {
    forward: Workspace,
    factor: KronFactor,
    potentials: Potentials,
    slopes: Vec<NodeSlopes>,
    /// Nodes whose conductance changes with the load.
    moving: Vec<u32>,
    shares: Vec<Share>,
    /// Slopes of the compression before the clamp by a contact's parameters, at those nodes.
    load_slopes: Vec<[f64; CONTACT_PARAMETERS]>,
    direction: Direction,
    columns: Vec<f64>,
}

/// The model at one load, from which derivatives follow.
#[derive(Debug)]
pub struct Linearised<'a> {
    model: &'a ForwardModel,
    contacts: &'a [Contact],
    work: &'a mut JacobianWork,
}

impl ForwardModel {
    /// Factorises the model at a load. Its frame is bitwise equal to that of [`Self::voltages`].
    ///
    /// # Errors
    /// `ContactError` with the first contact that the model rejects.
    pub fn linearise<'a>(
        &'a self,
        contacts: &'a [Contact],
        work: &'a mut JacobianWork,
    ) -> ContactResult<Linearised<'a>> {
        self.load(contacts, &mut work.forward)?;
        let forward = &mut work.forward;
        let sums = forward.compression_mm.iter();
        work.slopes.clear();
        work.slopes.extend(
            sums.zip(&self.laws).map(|(&sum, law)| NodeSlopes::new(law, self.fields(), sum)),
        );
        work.moving.clear();
        let moves = |(node, s): (usize, &NodeSlopes)| (s.per_mm != 0.0).then_some(node as u32);
        work.moving.extend(work.slopes.iter().enumerate().filter_map(moves));
        self.conduct(forward);
        let reduced = self.reduction.factor(&forward.to_top_s, &mut forward.kron, &mut work.factor);
        forward.readout.evaluate(reduced, self.circuit());
        let electrodes = self.circuit().electrodes.len();
        work.potentials.solve(&self.reduction, &mut work.factor, &forward.readout, electrodes);
        Ok(Linearised { model: self, contacts, work })
    }
}

impl Linearised<'_> {
    /// The frame, V after gain.
    pub fn frame_v(&self) -> &[f64] {
        self.work.forward.readout.frame_v()
    }

    /// Foam compression at every node, mm, after fields and clamp.
    pub fn compression_mm(&self) -> &[f64] {
        self.work.forward.compression_mm()
    }

    /// Conductance of the foam at every node, S.
    pub fn to_top_s(&self) -> &[f64] {
        self.work.forward.to_top_s()
    }

    /// Derivative of the frame by every contact's x (V/mm), y (V/mm) and force (V/N):
    /// `[channels * (3 * contact + parameter) + channel]`, channels as in [`ForwardModel::voltages`].
    pub fn contacts(&mut self) -> &[f64] {
        let JacobianWork {
            forward,
            potentials,
            slopes,
            moving,
            shares,
            load_slopes,
            direction,
            columns,
            ..
        } = &mut *self.work;
        let model = self.model;
        let channels = forward.readout.frame_v().len();
        columns.clear();
        columns.resize(channels * CONTACT_PARAMETERS * self.contacts.len(), 0.0);
        direction.clear(potentials);
        for &node in moving.iter() {
            direction.to_top(potentials, node as usize, 0.0);
        }
        let mut out = columns.chunks_exact_mut(channels);
        for contact in self.contacts {
            shares.clear();
            model.spread(contact, shares);
            let sixth_n = contact.force_n / 6.0;
            load_slopes.clear();
            load_slopes.resize(moving.len(), [0.0; CONTACT_PARAMETERS]);
            for share in shares.iter() {
                let [along_x, along_y] = share.slope_per_mm.map(|slope| sixth_n * slope);
                let loads = [along_x, along_y, share.sixths / 6.0];
                let row = model.responses().row(share.node as usize);
                for (slopes, &node) in load_slopes.iter_mut().zip(moving.iter()) {
                    let unit = f64::from(row[node as usize]);
                    for (slope, load) in slopes.iter_mut().zip(loads) {
                        *slope += load * unit;
                    }
                }
            }
            for parameter in 0..CONTACT_PARAMETERS {
                direction.replace_to_top(
                    moving
                        .iter()
                        .zip(load_slopes.iter())
                        .map(|(&node, of_load)| slopes[node as usize].per_mm * of_load[parameter]),
                );
                if let Some(column) = out.next() {
                    direction.frame(potentials, &forward.readout, model.circuit(), column);
                }
            }
        }
        columns
    }

    /// Derivative along modes of the fields: `[channels * mode + channel]`, V after gain per unit
    /// of the mode.
    ///
    /// # Panics
    /// If a mode has an index beyond its field.
    pub fn modes(&mut self, modes: &[Mode]) -> &[f64] {
        let JacobianWork { forward, potentials, slopes, direction, columns, .. } = &mut *self.work;
        let model = self.model;
        let channels = forward.readout.frame_v().len();
        columns.clear();
        columns.resize(channels * modes.len(), 0.0);
        for (mode, column) in modes.iter().zip(columns.chunks_exact_mut(channels)) {
            direction.clear(potentials);
            for &(index, moved) in &mode.entries {
                match mode.field {
                    Field::LnA | Field::LnB | Field::LnC | Field::LnCompliance => {
                        let change_s = moved * slopes[index as usize].of(mode.field);
                        direction.to_top(potentials, index as usize, change_s);
                    }
                    Field::LnSheetConductance
                    | Field::LnSheetAnisotropy
                    | Field::LeadOhm
                    | Field::ContactOhm
                    | Field::ElectrodeX
                    | Field::ElectrodeY => {
                        let parts = circuit_parts(model, mode.field, index as usize);
                        for r in parts.resistors {
                            let (a, b) = (r.a as usize, r.b as usize);
                            direction.between(potentials, a, b, moved * r.conductance_s);
                        }
                        if let Some(electrode) = parts.lead {
                            direction.lead(electrode, moved);
                        }
                    }
                }
            }
            direction.frame(potentials, &forward.readout, model.circuit(), column);
        }
        columns
    }

    /// Derivative along changes of resistors of the network, as [`circuit_resistors`] lists them:
    /// each with the change of its conductance. Layout as in [`Self::modes`].
    pub(crate) fn resistors(&mut self, changes: &[Vec<Resistor>]) -> &[f64] {
        let JacobianWork { forward, potentials, direction, columns, .. } = &mut *self.work;
        let channels = forward.readout.frame_v().len();
        columns.clear();
        columns.resize(channels * changes.len(), 0.0);
        for (change, column) in changes.iter().zip(columns.chunks_exact_mut(channels)) {
            direction.clear(potentials);
            for r in change {
                direction.between(potentials, r.a as usize, r.b as usize, r.conductance_s);
            }
            direction.frame(potentials, &forward.readout, self.model.circuit(), column);
        }
        columns
    }
}

/// The resistors that change along a mode of the circuit, each once: the same at every load. Leads
/// are not resistors of the network.
pub(crate) fn circuit_resistors(model: &ForwardModel, mode: &Mode) -> Vec<Resistor> {
    let mut resistors: Vec<Resistor> = Vec::new();
    for &(index, moved) in &mode.entries {
        let parts = circuit_parts(model, mode.field, index as usize).resistors;
        resistors.extend(parts.into_iter().map(|r| Resistor {
            a: r.a.min(r.b),
            b: r.a.max(r.b),
            conductance_s: moved * r.conductance_s,
        }));
    }
    resistors.sort_by_key(|r| (r.a, r.b));
    resistors.dedup_by(|from, into| {
        let same = (from.a, from.b) == (into.a, into.b);
        if same {
            into.conductance_s += from.conductance_s;
        }
        same
    });
    resistors
}

/// Changes by one value of a field that is not the foam's, per unit of it.
struct CircuitParts {
    /// Resistors, with the change of their conductance.
    resistors: Vec<Resistor>,
    /// Electrode whose lead changes by 1 ohm.
    lead: Option<usize>,
}

fn circuit_parts(model: &ForwardModel, field: Field, index: usize) -> CircuitParts {
    let mut parts = CircuitParts { resistors: Vec::new(), lead: None };
    let ideal = || model.circuit().electrodes[index].contact_ohm == 0.0;
    match field {
        Field::LnSheetConductance => {
            parts.resistors = sheet_slopes(model, index, [1.0; 2]).to_vec()
        }
        Field::LnSheetAnisotropy => {
            let triangles = 0..model.mesh().triangles.len();
            parts.resistors =
                triangles.flat_map(|index| sheet_slopes(model, index, [0.5, -0.5])).collect();
        }
        Field::LeadOhm => parts.lead = Some(index),
        // In series with the electrode's lead, and without current otherwise.
        Field::ContactOhm if ideal() => parts.lead = Some(index),
        Field::ElectrodeX | Field::ElectrodeY if ideal() => {}
        Field::ContactOhm | Field::ElectrodeX | Field::ElectrodeY => {
            parts.resistors = electrode_slopes(model, field, index).to_vec();
        }
        Field::LnA | Field::LnB | Field::LnC | Field::LnCompliance => {}
    }
    parts
}

/// Slopes of the resistors of a triangle of the sheet, for slopes of ln of its conductance along x and y.
fn sheet_slopes(model: &ForwardModel, triangle: usize, slopes: [f64; 2]) -> [Resistor; 3] {
    let square_s = 1.0 / model.sensor().file.circuit.sheet_ohm_per_sq;
    let factors = model.fields().sheet_factors(triangle);
    let sigma = [0, 1].map(|axis| square_s * slopes[axis] * factors[axis]);
    sheet::of_triangle(model.mesh(), &model.mesh().triangles[triangle], sigma)
}

/// Slopes of the resistors between an electrode that is a separate node and the sheet.
fn electrode_slopes(model: &ForwardModel, field: Field, electrode: usize) -> [Resistor; 3] {
    let (mesh, circuit): (&Mesh, &ReadoutCircuit) = (model.mesh(), model.circuit());
    let site = circuit.electrodes[electrode];
    let at_mm = [site.x_mm, site.y_mm];
    let place = mesh.locate(at_mm);
    let slopes = mesh.weight_slopes(&place, at_mm);
    let own = model.electrode_nodes[electrode];
    std::array::from_fn(|corner| {
        let conductance_s = match field {
            Field::ContactOhm => -place.weights[corner] / site.contact_ohm.powi(2),
            Field::ElectrodeX => slopes[corner][0] / site.contact_ohm,
            _ => slopes[corner][1] / site.contact_ohm,
        };
        Resistor { a: place.nodes[corner], b: own, conductance_s }
    })
}
