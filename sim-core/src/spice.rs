//! The resistor network of one loaded skin as a netlist, so that ngspice can check the voltages.
//! Uses: `network`, `circuit`. Never: files, the foam's law, solving.
//!
//! `ngspice -b FILE` prints `v(e0) = ..` to `v(e27) = ..` with 15 digits: V_j while electrode K is
//! the sink, before gain. Pitfalls (`docs/references.md`, "Netlists for ngspice"): `print` with
//! `numdgt=15`, since `echo` rounds to 6 digits; gmin=1e-30, since its default 1e-12 S is as large
//! as an untouched foam resistor (6e-13 S); no resistor for a conductance of 0.

use std::fmt::Write as _;

use crate::circuit::ReadoutCircuit;
use crate::network::SheetNetwork;

/// The complete circuit of one loaded skin.
#[derive(Debug, Clone, Copy)]
pub struct LoadedCircuit<'a> {
    /// Comment in the first line.
    pub title: &'a str,
    /// Sheet and electrodes.
    pub network: &'a SheetNetwork,
    /// Source, leads, gain.
    pub circuit: &'a ReadoutCircuit,
    /// Conductance from every node of the network to the top layer, S, >= 0.
    pub to_top_s: &'a [f64],
}

/// Why a netlist cannot be written.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum SpiceError {
    #[error("netlist: sink = {sink}: must be from 0 to {last}")]
    Sink { sink: usize, last: usize },
    #[error("netlist: {found} foam conductances for {needed} nodes")]
    Nodes { found: usize, needed: usize },
    #[error("netlist: foam conductance at node {node} = {conductance_s} S: must be a number >= 0")]
    Conductance { node: usize, conductance_s: f64 },
}

/// The netlist of a loaded skin with electrode `sink` at 0 V and the source at the top layer.
///
/// Nodes: `top`; `e0`, `e1`, .. the electrodes; `n<i>` every other node i of the network. A lead
/// resistance is between the sink's terminal `e<K>` and its position on the sheet, `s<K>`.
///
/// # Errors
/// `SpiceError` if the sink, the number of conductances or a conductance is invalid.
pub fn netlist(skin: &LoadedCircuit<'_>, sink: usize) -> Result<String, SpiceError> {
    check(skin, sink)?;
    let names = node_names(skin, sink);
    let mut out = String::with_capacity(48 * (skin.network.resistors.len() + names.len()));
    let mut line = |text: std::fmt::Arguments<'_>| {
        out.write_fmt(text).expect("a String takes any text");
        out.push('\n');
    };
    line(format_args!("* {}", skin.title.replace('\n', " ")));
    line(format_args!(
        "* Voltages before gain (x {}) with electrode {sink} as the sink;",
        skin.circuit.gain
    ));
    line(format_args!("* frame value j is V(e<j>) - V(e<j+1>). Run: ngspice -b FILE"));
    line(format_args!(".options gmin=1e-30"));
    line(format_args!("Vsource top 0 DC {:e}", skin.circuit.source_v));
    line(format_args!("Vsink e{sink} 0 DC 0"));
    let lead_ohm = skin.circuit.electrodes[sink].lead_ohm;
    if lead_ohm > 0.0 {
        line(format_args!("Rlead s{sink} e{sink} {lead_ohm:e}"));
    }
    line(format_args!("* sheet"));
    for (i, r) in skin.network.resistors.iter().enumerate() {
        let (a, b) = (&names[r.a as usize], &names[r.b as usize]);
        line(format_args!("Rs{i} {a} {b} {:e}", 1.0 / r.conductance_s));
    }
    line(format_args!("* foam; a node without a resistor does not conduct to the top"));
    for (i, (name, g)) in names.iter().zip(skin.to_top_s).enumerate() {
        if *g > 0.0 {
            line(format_args!("Rf{i} {name} top {:e}", 1.0 / g));
        }
    }
    line(format_args!(".control\nset numdgt=15\nrun"));
    for electrode in 0..skin.network.electrodes.len() {
        line(format_args!("print v(e{electrode})"));
    }
    line(format_args!("quit\n.endc\n.op\n.end"));
    Ok(out)
}

fn check(skin: &LoadedCircuit<'_>, sink: usize) -> Result<(), SpiceError> {
    let electrodes = skin.network.electrodes.len();
    if sink >= electrodes {
        return Err(SpiceError::Sink { sink, last: electrodes.saturating_sub(1) });
    }
    let (found, needed) = (skin.to_top_s.len(), skin.network.places_mm.len());
    if found != needed {
        return Err(SpiceError::Nodes { found, needed });
    }
    match skin.to_top_s.iter().position(|g| !(*g >= 0.0 && g.is_finite())) {
        Some(node) => Err(SpiceError::Conductance { node, conductance_s: skin.to_top_s[node] }),
        None => Ok(()),
    }
}

fn node_names(skin: &LoadedCircuit<'_>, sink: usize) -> Vec<String> {
    let mut names: Vec<String> =
        (0..skin.network.places_mm.len()).map(|i| format!("n{i}")).collect();
    for (electrode, &node) in skin.network.electrodes.iter().enumerate() {
        let behind_a_lead = electrode == sink && skin.circuit.electrodes[sink].lead_ohm > 0.0;
        let prefix = if behind_a_lead { 's' } else { 'e' };
        names[node as usize] = format!("{prefix}{electrode}");
    }
    names
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::circuit::ElectrodeSite;
    use crate::network::Resistor;

    fn two_electrodes(lead_ohm: f64) -> (SheetNetwork, ReadoutCircuit) {
        let network = SheetNetwork {
            places_mm: vec![[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]],
            resistors: vec![
                Resistor { a: 0, b: 1, conductance_s: 2e-3 },
                Resistor { a: 1, b: 2, conductance_s: 2e-3 },
            ],
            electrodes: vec![0, 2],
        };
        let site = ElectrodeSite { x_mm: 0.0, y_mm: 0.0, contact_ohm: 0.0, lead_ohm };
        (network, ReadoutCircuit { electrodes: vec![site; 2], source_v: 12.0, gain: 1.0 })
    }

    #[test]
    fn a_netlist_names_every_part_once_and_leaves_out_what_does_not_conduct() {
        let (network, circuit) = two_electrodes(50.0);
        let to_top_s = [0.0, 1e-9, 5e-4];
        let skin = LoadedCircuit {
            title: "a\nb",
            network: &network,
            circuit: &circuit,
            to_top_s: &to_top_s,
        };
        let text = netlist(&skin, 1).unwrap();
        for part in [
            "* a b\n",
            "Vsource top 0 DC 1.2e1\nVsink e1 0 DC 0\nRlead s1 e1 5e1\n",
            "Rs0 e0 n1 5e2\nRs1 n1 s1 5e2\n",
            "Rf1 n1 top 9.999999999999999e8\nRf2 s1 top 2e3\n",
            "set numdgt=15\nrun\nprint v(e0)\nprint v(e1)\nquit\n",
        ] {
            assert!(text.contains(part), "{part} is not in\n{text}");
        }
        assert!(!text.contains("Rf0"));
        assert!(text.ends_with(".op\n.end\n"));
    }

    #[test]
    fn what_is_no_circuit_is_refused() {
        let (network, circuit) = two_electrodes(0.0);
        let skin =
            |to_top_s| LoadedCircuit { title: "", network: &network, circuit: &circuit, to_top_s };
        assert_eq!(netlist(&skin(&[0.0; 3]), 2), Err(SpiceError::Sink { sink: 2, last: 1 }));
        assert_eq!(netlist(&skin(&[0.0; 2]), 0), Err(SpiceError::Nodes { found: 2, needed: 3 }));
        let error = netlist(&skin(&[0.0, -1.0, 0.0]), 0).unwrap_err();
        assert_eq!(error, SpiceError::Conductance { node: 1, conductance_s: -1.0 });
    }
}
