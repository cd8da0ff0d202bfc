//! The readout circuit: positions of the electrodes, their series resistances, source and gain.
//! Uses: `sensor`. Never: the foam.

use crate::digest::Digest;
use crate::sensor::Sensor;

/// Position and contact of one electrode on the sheet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ElectrodeSite {
    /// Position on the skin along x, mm.
    pub x_mm: f64,
    /// Position on the skin along y, mm.
    pub y_mm: f64,
    /// Contact (spreading) resistance to the sheet, ohm: shared among the nodes of its triangle by
    /// their weights. 0 only if the electrode is on a node, which then is the electrode.
    pub contact_ohm: f64,
    /// Resistance of the lead, ohm; it carries current only while this electrode is the sink.
    pub lead_ohm: f64,
}

/// The readout circuit (paper III-C), ideal or not.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadoutCircuit {
    /// The electrodes, in measuring order.
    pub electrodes: Vec<ElectrodeSite>,
    /// Source between top layer and sink, V.
    pub source_v: f64,
    /// Gain of the readout.
    pub gain: f64,
}

impl ReadoutCircuit {
    /// The circuit of the sensor file: ideal electrodes on their nodes.
    pub fn nominal(sensor: &Sensor) -> Self {
        let ideal = |&[x_mm, y_mm]: &[f64; 2]| ElectrodeSite {
            x_mm,
            y_mm,
            contact_ohm: 0.0,
            lead_ohm: 0.0,
        };
        Self {
            electrodes: sensor.electrodes_mm().iter().map(ideal).collect(),
            source_v: sensor.file.circuit.source_v,
            gain: sensor.file.circuit.gain,
        }
    }

    pub(crate) fn digest(&self, digest: &mut Digest) {
        digest.numbers(
            self.electrodes.iter().flat_map(|e| [e.x_mm, e.y_mm, e.contact_ohm, e.lead_ohm]),
        );
        digest.numbers([self.source_v, self.gain]);
    }
}
