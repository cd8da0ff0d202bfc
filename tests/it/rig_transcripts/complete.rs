//! What a driver must have, found by its name: a transcript, its registers among the references, a file with
//! its reference, a register map in the virtual rig. And every rig file parses.

use std::path::Path;

use palpate::rig::config::RigConfig;
use palpate::rig::input_modules::MODULES;
use palpate::rig::setup::RigSetup;

use super::play::files;
use super::scripts::{device_of, devices, script};

/// Damaged frames that a device's transcripts must hold: one that is cut, one that is corrupted.
const DAMAGED: usize = 2;
/// What drivers are written from.
const REFERENCES: &str = "docs/references.md";

/// The parts of the checkout in which a driver is searched.
struct Checkout {
    /// Transcripts: name and text.
    transcripts: Vec<(String, String)>,
    /// The text of [`REFERENCES`].
    references: String,
    /// Register maps of the virtual rig.
    twins: Vec<&'static str>,
}

impl Checkout {
    fn read() -> Self {
        let drives = virtual_rig::device::drives::DRIVES.iter().map(|device| device.name);
        let modules = virtual_rig::device::input_modules::MODULES.iter().map(|device| device.name);
        Self {
            transcripts: files("tests/transcripts", "txt"),
            references: text(REFERENCES).expect("the references are there"),
            twins: drives.chain(modules).collect(),
        }
    }

    fn lacks(&self, device: &str) -> Vec<String> {
        let own = |(name, _): &&(String, String)| device_of(name) == Some(device);
        let damaged = |text: &str| text.lines().filter(|l| l.starts_with("= ")).count();
        let damaged: usize =
            self.transcripts.iter().filter(own).map(|(_, text)| damaged(text)).sum();
        let heading = format!("`device = \"{device}\"`");
        let is_module = MODULES.iter().any(|module| module.as_str() == device);
        let kind = if is_module { "input_modules" } else { "drives" };
        let own_file = format!("src/bench/rig/{kind}/{device}.rs");
        let head = text(&own_file);
        let cites = head.is_some_and(|text| text.contains(&format!("`{REFERENCES}`, \"")));
        let found = [
            (
                self.transcripts.iter().any(|t| own(&t)),
                format!("no tests/transcripts/{device}_tcp.txt or {device}_rtu.txt"),
            ),
            (
                damaged >= DAMAGED,
                format!("{damaged} damaged frames in its transcripts, at least {DAMAGED}"),
            ),
            (
                self.references.contains(&heading),
                format!("no section of {REFERENCES} that states {heading}"),
            ),
            (cites, format!("no {own_file} that cites its references")),
            (
                self.twins.contains(&device),
                format!("no register map in virtual-rig/src/device/{kind}"),
            ),
        ];
        found.into_iter().filter(|(has, _)| !has).map(|(_, what)| what).collect()
    }
}

fn text(path: &str) -> Option<String> {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).ok()
}

/// The carried rig files with a bench.
fn rigs() -> Vec<(String, RigConfig)> {
    let parsed = |(name, text): (String, String)| {
        let setup = RigSetup::from_toml(&name, &text).unwrap_or_else(|p| panic!("{p:#?}"));
        setup.bench().cloned().map(|config| (name, config))
    };
    files("experiments/rigs", "toml").into_iter().filter_map(parsed).collect()
}

#[test]
fn every_driver_is_complete() {
    let checkout = Checkout::read();
    let mut lacking = Vec::new();
    for device in devices() {
        let lacks = checkout.lacks(device);
        lacking.extend(lacks.into_iter().map(|what| format!("{device}: {what}")));
    }
    assert!(lacking.is_empty(), "\n{}\n", lacking.join("\n"));
    let mut twins = checkout.twins.clone();
    let mut drivers = devices();
    twins.sort_unstable();
    drivers.sort_unstable();
    assert_eq!(twins, drivers, "each name is used once, here and in the virtual rig");
}

#[test]
fn a_driver_that_lacks_something_is_found() {
    let mut checkout = Checkout::read();
    assert_eq!(checkout.lacks("no_such_device").len(), 5);
    checkout.twins.retain(|name| *name != "iai");
    assert_eq!(checkout.lacks("iai"), ["no register map in virtual-rig/src/device/drives"]);
    for (_, text) in &mut checkout.transcripts {
        *text = text.replacen("= reopen\n", "", 1);
    }
    let lacks = checkout.lacks("oriental_az");
    assert_eq!(lacks, ["1 damaged frames in its transcripts, at least 2"]);
}

#[test]
fn every_transcript_is_played() {
    let coded = include_str!("mod.rs");
    for (name, text) in files("tests/transcripts", "txt") {
        let played = !script(&text).is_empty() || coded.contains(&format!("\"{name}\""));
        assert!(played, "{name}: has no script, and no test reads it");
    }
}

#[test]
fn every_rig_file_parses() {
    let rigs = rigs();
    assert!(rigs.iter().any(|(name, _)| name == "virtual.toml"));
    for (name, config) in rigs {
        let radii = config.slot.radius_mm.map(|r| config.slot.angle_deg(r));
        assert!(radii[0] < radii[1], "{name}");
    }
}

fn problems(from: &str, to: &str) -> String {
    let name = "iai-modbus-tcp.toml";
    let (_, text) = files("experiments/rigs", "toml").into_iter().find(|(n, _)| n == name).unwrap();
    assert!(text.contains(from), "{from}");
    let problems = RigConfig::from_toml(name, &text.replacen(from, to, 1)).unwrap_err();
    problems.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
}

#[test]
fn a_wrong_rig_file_is_told_with_file_key_value_and_limit() {
    let unknown = problems("clock_rate =", "clock_speed =");
    assert!(unknown.starts_with("iai-modbus-tcp.toml"), "{unknown}");
    assert!(unknown.contains("clock_speed = ") && unknown.contains("unknown key"), "{unknown}");
    assert!(unknown.contains("`clock_rate`"), "names what is allowed: {unknown}");
    for (from, to, words) in [
        ("clock_rate = 1.0", "0.0", "clock_rate = 0: must be 1 on a bench (label = \"measured\")"),
        ("speed_mm_s = 60.0", "9000.0", "axes.z.speed_mm_s = 9000: must be from 0.001 to 5000"),
        ("timeout_ms = 300", "0", "lines.cells.timeout_ms = 0: must be from 5 to 10000"),
    ] {
        let key = from.split_once(" = ").unwrap().0;
        let found = problems(from, &format!("{key} = {to}"));
        assert_eq!(found, format!("iai-modbus-tcp.toml: {words}"));
    }
}
