//! A driver against a Modbus server that we did not write (pymodbus). Without Python and pymodbus
//! the test reports that it was skipped; with `PALPATE_REQUIRE_TOOLS=1` it fails instead.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use palpate::clock::Clock;
use palpate::rig::config::RigConfig;
use palpate::rig::link::StopLatch;
use palpate::rig::registry::open;

use crate::support::{self, Process, VIRTUAL_RIG};

/// Starts the server; returns it with its port.
fn server(python: &str) -> (Process, u16) {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/it/independent/adam_6017.py");
    let mut process = Command::new(python)
        .args(["-W", "ignore", script])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(process.stdout.take().unwrap()).read_line(&mut line).unwrap();
    (Process(process), line.trim().parse().unwrap())
}

#[tokio::test]
async fn the_adam_driver_reads_a_server_of_another_make() {
    let Some(python) = support::python("pymodbus.server") else { return };
    let (_server, port) = server(&python);
    let text = VIRTUAL_RIG.replace("127.0.0.1:5021", &format!("127.0.0.1:{port}"));
    let config = RigConfig::from_toml("virtual.toml", &text).unwrap();
    let bench = open(&config, &Clock::new(1.0), &StopLatch::default()).unwrap().bench;
    let found = bench.cells.prepare().await.unwrap();
    assert!(found.contains("ADAM-6017"), "{found}");
    let read = bench.cells.read().await.unwrap();
    for (volts, set) in read.volts.iter().zip([0.5, 0.75, 1.0, 2.5, 4.0, 4.5]) {
        assert!((volts - set).abs() < 5.0 / 65535.0, "{volts} V, set to {set} V");
    }
}
