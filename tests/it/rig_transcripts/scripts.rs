//! Transcripts with a script: the lines that begin with `:` are the calls of the driver, in order, and
//! what they must return. The name of the file is the device, `_`, `tcp` or `rtu`, and any text, so
//! that a driver's transcript needs no line of code:
//!
//! ```text
//! : open unit 1, 1000 counts       counts per unit for a drive, absent for an input module
//! : prepare "TEXT"                 `identify "TEXT"` likewise
//! : home                           `stop`, `reset` likewise
//! : move 12.5 at 100               `refused 12.5 at 100`: outside the travel of 0 to 500
//! : status ready !moving at 12.5   a word that is not there is not checked; `alarm 0x30`
//! : read 0.5 1 1.5 2 2.5 3, repeats 0
//! ```

use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use palpate::clock::Clock;
use palpate::rig::config::Guard;
use palpate::rig::drives::DRIVES;
use palpate::rig::error::RigError;
use palpate::rig::input_modules::MODULES;
use palpate::rig::link::Framing;
use palpate::rig::station::Station;
use palpate::rig::traits::{Axis, AxisStatus, LoadCells};

use super::play::{RATE, files, line, steps};
use super::{axis, cells, within};

/// Names of the supported devices.
pub fn devices() -> Vec<&'static str> {
    let drives = DRIVES.iter().map(|device| device.as_str());
    drives.chain(MODULES.iter().map(|device| device.as_str())).collect()
}

/// The device whose transcript has this name; the longest of several.
pub fn device_of(name: &str) -> Option<&'static str> {
    let begins = |device: &&str| name.strip_prefix(*device).is_some_and(|r| r.starts_with('_'));
    devices().into_iter().filter(begins).max_by_key(|device| device.len())
}

/// The calls of a transcript; none of one without a script.
pub fn script(text: &str) -> Vec<&str> {
    text.lines().filter_map(|line| line.strip_prefix(": ")).map(str::trim).collect()
}

fn number<T: FromStr>(text: &str, call: &str) -> T {
    text.trim().parse().unwrap_or_else(|_| panic!("{call}: {text}: must be a number"))
}

fn target_and_speed(rest: &str, call: &str) -> (f64, f64) {
    let (target, speed) = rest.split_once(" at ").unwrap_or_else(|| panic!("{call}: at which?"));
    (number(target, call), number(speed, call))
}

fn agrees(status: &AxisStatus, call: &str) {
    let mut words = call.split_whitespace().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().unwrap_or_else(|| panic!("{call}: {word} what?"));
        match word {
            "at" => assert_eq!(status.position, number::<f64>(value(), call), "{call}"),
            "alarm" => {
                let code = u32::from_str_radix(value().trim_start_matches("0x"), 16).unwrap();
                assert_eq!(status.alarm, Some(code), "{call}");
            }
            _ => {
                let found = match word.trim_start_matches('!') {
                    "homed" => status.homed,
                    "moving" => status.moving,
                    "ready" => status.ready,
                    other => panic!("{call}: {other}: must be homed, moving, ready, at or alarm"),
                };
                assert_eq!(found, !word.starts_with('!'), "{call}: {status:?}");
            }
        }
    }
}

async fn axis_does(axis: &Arc<dyn Axis>, call: &str) {
    let (what, rest) = call.split_once(' ').unwrap_or((call, ""));
    match what {
        "identify" => {
            let found = axis.identify().await.unwrap().to_string();
            assert_eq!(found, rest.trim_matches('"'), "{call}");
        }
        "prepare" => assert_eq!(axis.prepare().await.unwrap(), rest.trim_matches('"'), "{call}"),
        "home" => axis.start_home().await.unwrap(),
        "move" => {
            let (target, speed) = target_and_speed(rest, call);
            axis.start_move(target, speed).await.unwrap();
        }
        "refused" => {
            let (target, speed) = target_and_speed(rest, call);
            let outside = axis.start_move(target, speed).await.unwrap_err();
            assert!(matches!(outside, RigError::OutsideTravel { .. }), "{call}: {outside}");
        }
        "status" => agrees(&axis.status().await.unwrap(), call),
        "stop" => axis.stop().await.unwrap(),
        "reset" => axis.reset_alarm().await.unwrap(),
        _ => panic!("{call}: no call of a drive"),
    }
}

async fn module_does(module: &Arc<dyn LoadCells>, update_ms: f64, call: &str) {
    let (what, rest) = call.split_once(' ').unwrap_or((call, ""));
    match what {
        "prepare" => assert_eq!(module.prepare().await.unwrap(), rest.trim_matches('"'), "{call}"),
        "read" => {
            let (volts, repeats) =
                rest.split_once(", repeats ").unwrap_or_else(|| panic!("{call}: how many?"));
            let volts: Vec<f64> = volts.split_whitespace().map(|v| number(v, call)).collect();
            let reading = module.read().await.unwrap();
            assert_eq!(reading.volts.to_vec(), volts, "{call}");
            assert_eq!(reading.repeats, [number::<u32>(repeats, call); 6], "{call}");
            // Longer than an update of the module: a reading within one repeats nothing.
            tokio::time::sleep(Duration::from_secs_f64(update_ms / 1e3 / RATE)).await;
        }
        _ => panic!("{call}: no call of an input module"),
    }
}

async fn run(name: String, text: String) {
    println!("{name}");
    let device = device_of(&name).unwrap_or_else(|| panic!("{name}: which device?"));
    let framing = match name[device.len() + 1..].get(..3) {
        Some("tcp") => Framing::Tcp,
        Some("rtu") => Framing::Rtu,
        _ => panic!("{name}: must be {device}_tcp or {device}_rtu"),
    };
    let calls = script(&text);
    let (open, calls) = calls.split_first().expect("a script has calls");
    let at = open.strip_prefix("open unit ").unwrap_or_else(|| panic!("{name}: {open}"));
    let (line, player) = line(steps(&name, &text), framing);
    if let Some(drive) = DRIVES.iter().find(|d| d.as_str() == device) {
        let (unit, counts) = at.split_once(", ").unwrap_or_else(|| panic!("{name}: {open}"));
        let counts = number(counts.trim_end_matches(" counts"), open);
        let axis = axis(&line, number(unit, open), *drive, counts, Guard::default());
        for call in calls {
            axis_does(&axis, call).await;
        }
    } else {
        let module = MODULES.iter().find(|d| d.as_str() == device).expect("a supported device");
        let cells = cells(*module);
        let station = Station::new(Arc::clone(&line), number(at, open), "cells");
        let module = module.open(cells.parts(station, Clock::new(RATE)));
        for call in calls {
            module_does(&module, cells.update_ms, call).await;
        }
    }
    // A device that still waits for a request finds its wire closed.
    drop(line);
    player.await.unwrap();
}

#[tokio::test]
async fn every_script_is_what_its_driver_does() {
    let transcripts = files("tests/transcripts", "txt");
    let scripted: Vec<_> = transcripts.into_iter().filter(|(_, t)| !script(t).is_empty()).collect();
    assert!(scripted.len() >= 5, "{scripted:?}");
    for (name, text) in scripted {
        within(run(name, text)).await;
    }
}

#[tokio::test]
async fn a_script_that_is_not_what_the_driver_does_fails() {
    let transcripts = files("tests/transcripts", "txt");
    for (file, from, to) in [
        ("waveshare_8ch_rtu.txt", "repeats 1", "repeats 2"),
        ("waveshare_8ch_rtu.txt", ": read 0.5 ", ": read 0.6 "),
        ("oriental_az_rtu.txt", ": status moving", ": status !moving"),
        ("oriental_az_rtu.txt", ": status alarm 0x30", ": status alarm 0x31"),
        ("oriental_az_rtu.txt", ": move 10 at", ": move 11 at"),
        ("leadshine_em2rs_rtu.txt", ": status at 25.05\n", ""),
        ("leadshine_em2rs_rtu.txt", ": status at 25\n", ": status at 25.5\n"),
    ] {
        let (_, text) = transcripts.iter().find(|(name, _)| name == file).unwrap();
        assert!(text.contains(from), "{file}: {from}");
        let changed = run(file.into(), text.replacen(from, to, 1));
        assert!(within(tokio::spawn(changed)).await.is_err(), "{file}: {to}");
    }
}
