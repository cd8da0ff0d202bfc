//! One contract for every driver, kept against the virtual rig, whose messages are encoded without the drivers' code:
//! be looked at without a write, take control, home, move there, stop short, be refused beyond the
//! limits, read the cells, take frames, come back after an alarm and a power loss. Each rig file's own devices
//! and wires are served: Modbus TCP, or RTU on pseudo-terminals; each device that the virtual
//! rig's file does not name is put into it. Every test that starts a rig takes its turn.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use palpate::api::LockFile;
use palpate::campaign::bench::estop::StopSwitch;
use palpate::campaign::check::{Scope, check, run_on};
use palpate::clock::Clock;
use palpate::rig::config::{Guard, RigConfig};
use palpate::rig::drives::DRIVES;
use palpate::rig::error::RigError;
use palpate::rig::input_modules::MODULES;
use palpate::rig::link::StopLatch;
use palpate::rig::registry::{OpenBench, open};
use palpate::rig::setup::RigSetup;
use palpate::rig::traits::{Axis, AxisStatus};
use serde_json::{Value, json};
use virtual_rig::run::{RigArgs, VirtualRig};

use super::bench::{WHOLE, fault, file, rig_args, tell, turn, with_extension};

/// Process seconds in a wall second.
const SPEED: f64 = 20.0;
/// The longest that a motion or a homing of the virtual rig takes, wall time.
const LIMIT: Duration = Duration::from_secs(20);
/// Axes of a rig.
const AXES: usize = 4;

async fn rig_of(
    name: &str,
    rig: PathBuf,
    latch: &StopLatch,
) -> (VirtualRig, RigConfig, OpenBench, Clock) {
    let mut args = RigArgs { rig, ..rig_args("virtual", SPEED) };
    args.options.seed = 1;
    let rig = VirtualRig::switch_on(&args).await.unwrap();
    let config = RigConfig::from_toml(name, &rig.rig_text).unwrap();
    assert_eq!(config.clock_rate, SPEED);
    let clock = Clock::new(config.clock_rate);
    let bench = open(&config, &clock, latch).unwrap();
    (rig, config, bench, clock)
}

async fn until(axis: &Arc<dyn Axis>, what: &str, done: impl Fn(&AxisStatus) -> bool) -> AxisStatus {
    let wait = async {
        loop {
            let status = axis.status().await.unwrap();
            assert_eq!(status.alarm, None, "{} in {what}", axis.name());
            if done(&status) {
                return status;
            }
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    };
    let ended = tokio::time::timeout(LIMIT, wait).await;
    ended.unwrap_or_else(|_| panic!("{}: {what} does not end", axis.name()))
}

async fn keeps_the_contract(name: &str, file: PathBuf) {
    let _turn = turn(WHOLE).await;
    let latch = StopLatch::default();
    let (rig, config, open, clock) = rig_of(name, file, &latch).await;
    let seen = check(&config, &open, &clock, Scope::Look).await;
    assert!(seen.is_sound() && !seen.enabled, "{seen}");
    let truth = tell(&rig, json!({ "cmd": "status" })).await;
    assert_eq!(truth["wires"]["writes"], 0, "a look writes nothing");
    let off = truth["axes"].as_array().unwrap().iter().filter(|a| a["servo"] == false).count();
    let words = |what: &str| seen.unchecked.iter().filter(|w| w.contains(what)).count();
    assert_eq!(words("servo is off"), off, "{seen}");
    let report = check(&config, &open, &clock, Scope::Enable).await;
    println!("{report}");
    assert!(report.is_sound() && report.enabled && report.unchecked.is_empty(), "{report}");
    for axis in open.bench.axes() {
        let unhomed = axis.status().await.unwrap();
        assert!(unhomed.ready && !unhomed.homed, "{}: {unhomed:?}", axis.name());
        axis.start_home().await.unwrap();
        let home = until(axis, "homing", |s| s.homed && !s.moving).await;
        assert!(home.position.abs() < 0.05, "{}: {home:?}", axis.name());
    }
    for axis in open.bench.axes() {
        moves_and_stops(axis, &latch).await;
    }
    let before = open.bench.cells.read().await.unwrap();
    assert!(before.volts.iter().all(|v| (0.3..0.8).contains(v)), "{before:?}");
    let frames = open.bench.skin.take(clock.now(), 3).await.unwrap();
    assert_eq!(frames.len(), 3);
    assert!(frames.windows(2).all(|w| w[0].sequence < w[1].sequence));
    assert_eq!(frames[0].counts.len(), 784);
    for (wire, line) in &open.lines {
        let counts = line.counts();
        // A loaded machine may miss a deadline now and then; a sound wire garbles and refuses none.
        assert_eq!((counts.garbled, counts.exceptions), (0, 0), "{wire}: {counts:?}");
    }
    comes_back(&rig, &open.bench.x).await;
}

async fn home(axis: &Arc<dyn Axis>) {
    axis.start_home().await.unwrap();
    until(axis, "homing", |s| s.homed && !s.moving).await;
}

/// After an alarm, a loss of power and a motor that is off: reset, prepare, home, and it moves to its target.
async fn comes_back(rig: &VirtualRig, x: &Arc<dyn Axis>) {
    for kind in ["alarm", "power_loss", "motor_off"] {
        tell(rig, fault(kind, "x", json!({ "count": 1 }))).await;
        if kind == "motor_off" {
            let off = x.status().await.unwrap();
            assert!(!off.ready && off.homed && off.alarm.is_none(), "{off:?}");
        }
        if kind == "alarm" {
            let refused = x.prepare().await.unwrap_err();
            assert!(matches!(refused, RigError::NotReady { .. }), "{refused}");
            assert!(!x.identify().await.unwrap().faults().is_empty());
        }
        x.reset_alarm().await.unwrap();
        let found = x.prepare().await.unwrap();
        assert!(kind != "power_loss" || found.contains("not homed"), "{kind}: {found}");
        let back = x.status().await.unwrap();
        assert!(back.ready && back.alarm.is_none(), "{kind}: {back:?}");
        home(x).await;
        x.start_move(20.0, f64::INFINITY).await.unwrap();
        let there = until(x, "move", |s| !s.moving).await;
        assert!((there.position - 20.0).abs() < 0.06, "{kind}: {there:?}");
    }
}

async fn moves_and_stops(axis: &Arc<dyn Axis>, latch: &StopLatch) {
    let (name, [_, max]) = (axis.name(), axis.travel());
    // There and back.
    for target in [0.3 * max, 0.1 * max] {
        axis.start_move(target, f64::INFINITY).await.unwrap();
        let there = until(axis, "move", |s| !s.moving).await;
        assert!((there.position - target).abs() < 0.06, "{name}: {there:?}, not {target}");
    }
    // A stop on the way holds, and the next move reaches its target.
    axis.start_move(0.9 * max, 0.1 * max).await.unwrap();
    until(axis, "way", |s| s.position > 0.15 * max).await;
    axis.stop().await.unwrap();
    let short = until(axis, "stop", |s| !s.moving).await;
    assert!(short.position < 0.8 * max, "{name}: {short:?}");
    tokio::time::sleep(Duration::from_millis(30)).await;
    let held = axis.status().await.unwrap();
    assert!((held.position - short.position).abs() < 0.06 && !held.moving, "{name}: {held:?}");
    axis.start_move(0.05 * max, f64::INFINITY).await.unwrap();
    let back = until(axis, "move after a stop", |s| !s.moving).await;
    assert!((back.position - 0.05 * max).abs() < 0.06, "{name}: {back:?}");
    // Beyond the soft limits and under a latched stop nothing is sent.
    let beyond = axis.start_move(max + 0.01, 1.0).await.unwrap_err();
    assert!(matches!(beyond, RigError::OutsideTravel { .. }), "{beyond}");
    latch.latch();
    let latched = axis.start_move(0.1 * max, 1.0).await.unwrap_err();
    assert!(matches!(latched, RigError::Latched { .. }), "{latched}");
    latch.clear();
}

/// Names of the rig files in `experiments/rigs/` that describe a bench, not a skin alone.
fn rig_files() -> Vec<String> {
    let has_bench = |path: &PathBuf| {
        let text = std::fs::read_to_string(path).unwrap();
        RigSetup::from_toml("rig", &text).unwrap().bench().is_some()
    };
    let name = |path: PathBuf| path.file_stem().unwrap().to_str().unwrap().to_owned();
    with_extension(&file("rigs"), "toml").into_iter().filter(has_bench).map(name).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_devices_of_every_rig_file_keep_the_contract() {
    let names = rig_files();
    assert!(names.iter().any(|name| name == "virtual"), "{names:?}");
    for name in names {
        println!("{name}");
        keeps_the_contract(&name, file(&format!("rigs/{name}.toml"))).await;
    }
}

/// The other devices than `named`, again and again, beginning with the `nth`.
fn others<'a>(all: &[&'a str], named: &str, nth: usize) -> impl Iterator<Item = &'a str> {
    let others: Vec<&str> = all.iter().copied().filter(|name| *name != named).collect();
    others.into_iter().cycle().skip(nth)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_other_device_keeps_the_contract_in_the_virtual_rigs_file() {
    let text = std::fs::read_to_string(file("rigs/virtual.toml")).unwrap();
    let named = RigConfig::from_toml("virtual.toml", &text).unwrap();
    let drives: Vec<&str> = DRIVES.iter().map(|drive| drive.as_str()).collect();
    let modules: Vec<&str> = MODULES.iter().map(|module| module.as_str()).collect();
    let (drive, module) = (named.axes.x.device.as_str(), named.cells.device.as_str());
    // Each of them drives x once, or reads the cells.
    for nth in 0..drives.len().max(modules.len()) - 1 {
        let mut changed = text.clone();
        for other in others(&drives, drive, nth).take(AXES) {
            changed = changed.replacen(&format!("\"{drive}\""), &format!("\"{other}\""), 1);
        }
        let cells = others(&modules, module, nth).next().unwrap();
        changed = changed.replacen(&format!("\"{module}\""), &format!("\"{cells}\""), 1);
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("others-{nth}.toml"));
        std::fs::write(&path, changed).unwrap();
        keeps_the_contract(&format!("others-{nth}"), path).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_drive_with_a_watchdog_stops_when_the_service_falls_silent() {
    let _turn = turn(WHOLE).await;
    let text = std::fs::read_to_string(file("rigs/oriental-az-rtu.toml")).unwrap();
    let guard = "[axes.z]\nguard = { watchdog_ms = 500, torque_percent = 60 }";
    let guarded = Path::new(env!("CARGO_TARGET_TMPDIR")).join("guarded.toml");
    std::fs::write(&guarded, text.replacen("[axes.z]", guard, 1)).unwrap();
    let (_rig, _config, open, _clock) = rig_of("guarded", guarded, &StopLatch::default()).await;
    let (x, z) = (&open.bench.x, &open.bench.z);
    assert_eq!(z.guard(), Guard { watchdog_ms: Some(500), torque_percent: Some(60) });
    assert!(z.prepare().await.unwrap().ends_with("watchdog 500 ms, torque 60 %"));
    x.prepare().await.unwrap();
    home(z).await;
    home(x).await;
    // Two wall seconds of motion each, on the rig's clock.
    z.start_move(40.0, 1.0).await.unwrap();
    x.start_move(40.0, 1.0).await.unwrap();
    let asked = Instant::now();
    while asked.elapsed() < Duration::from_millis(800) {
        assert!(z.status().await.unwrap().moving, "asked often enough");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    tokio::time::sleep(Duration::from_millis(1500)).await;
    let (z, x) = (z.status().await.unwrap(), x.status().await.unwrap());
    assert!(!z.moving && z.position < 35.0 && z.alarm.is_none(), "{z:?}");
    assert!((x.position - 40.0).abs() < 0.06, "without one it continues to its target: {x:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_check_ends_with_stops_when_the_emergency_stop_is_latched() {
    let _turn = turn(WHOLE).await;
    let (estop, latch) = (StopSwitch::default(), StopLatch::default());
    let (rig, config, _open, _clock) = rig_of("virtual", file("rigs/virtual.toml"), &latch).await;
    let setup = config.into();
    let pressed = async {
        tokio::time::sleep(Duration::from_millis(400)).await;
        estop.press("hands");
    };
    let (checked, ()) = tokio::join!(run_on(&setup, &estop, Scope::Look), pressed);
    assert!(matches!(checked, Err(RigError::Latched { .. })), "{checked:?}");
    let stops = estop.pressed().expect("it is latched").stops();
    assert!(stops.len() == 4 && stops.iter().all(|stop| stop.stood_ms.is_some()), "{stops:?}");
    assert_eq!(tell(&rig, json!({ "cmd": "status" })).await["stops"], 4);
    let again = run_on(&setup, &estop, Scope::Look).await;
    assert!(matches!(again, Err(RigError::Latched { .. })), "{again:?}");
}

#[test]
fn a_rig_that_somebody_has_is_not_checked_by_another_process() {
    let text = std::fs::read_to_string(file("rigs/virtual.toml")).unwrap();
    let text = text.replace("127.0.0.1:50", &format!("127.0.0.1:9/{}-", std::process::id()));
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("held.toml");
    std::fs::write(&path, &text).unwrap();
    let config = RigConfig::from_toml("held.toml", &text).unwrap();
    let _held = LockFile::of_rig(&config.into()).unwrap();
    let palpate = env!("CARGO_BIN_EXE_palpate");
    let refused = Command::new(palpate).args(["rig", "check"]).arg(&path).output().unwrap();
    let said = String::from_utf8_lossy(&refused.stderr);
    let holder = format!("the rig virtual is in use by process {}", std::process::id());
    assert!(!refused.status.success() && said.contains(&holder), "{said}");
}

/// A rig as `palpate run` starts it, in a separate data folder.
fn child(data: &Path) -> Child {
    Command::new(env!("CARGO_BIN_EXE_palpate"))
        .args(["virtual-rig", "--ephemeral", "--speed", "200", "--with-parent", "--data"])
        .arg(data)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

fn ends_when_its_parent_goes(mut child: Child) {
    drop(child.stdin.take());
    let gone = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if gone.elapsed() > Duration::from_secs(2) {
            child.kill().unwrap();
            panic!("an orphan is still there after two seconds");
        }
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[tokio::test]
async fn a_rig_whose_parent_is_gone_ends_while_it_starts_and_while_it_streams() {
    let _turn = turn(WHOLE).await;
    let data =
        Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("orphan-{}", std::process::id()));
    let starting = child(&data);
    std::thread::sleep(Duration::from_millis(300));
    ends_when_its_parent_goes(starting);
    let mut streaming = child(&data);
    let mut line = String::new();
    let mut said = std::io::BufReader::new(streaming.stdout.take().unwrap());
    std::io::BufRead::read_line(&mut said, &mut line).unwrap();
    let ready: Value = serde_json::from_str(&line).unwrap();
    let _reader = std::net::TcpStream::connect(ready["ert"].as_str().unwrap()).unwrap();
    // At this speed a slow machine falls thousands of frames behind.
    std::thread::sleep(Duration::from_secs(2));
    ends_when_its_parent_goes(streaming);
    std::fs::remove_dir_all(&data).ok();
}
