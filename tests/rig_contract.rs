//! One contract for every driver, kept against the virtual rig, which shares no codec with it:
//! take control, home, move there, stop short, be refused beyond the limits, weigh, take frames.
//! Each rig file's own devices and wires are served: Modbus TCP, or RTU on pseudo-terminals.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use palpate::clock::Clock;
use palpate::rig::check::check;
use palpate::rig::config::RigConfig;
use palpate::rig::error::RigError;
use palpate::rig::link::StopLatch;
use palpate::rig::registry::{OpenBench, open};
use palpate::rig::traits::{Axis, AxisStatus};
use virtual_rig::run::{RigArgs, VirtualRig};

/// Process seconds in a wall second.
const SPEED: f64 = 20.0;
/// The longest that a motion or a homing of the virtual rig takes, wall time.
const LIMIT: Duration = Duration::from_secs(20);

fn file(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("experiments").join(path)
}

async fn rig(name: &str, latch: &StopLatch) -> (VirtualRig, RigConfig, OpenBench, Clock) {
    let args = RigArgs {
        rig: file(&format!("rigs/{name}.toml")),
        gap: file("gaps/gap-a.toml"),
        sensor: file("sensors/ert-28.toml"),
        seed: 1,
        speed: Some(SPEED),
        ephemeral: true,
        out_rig: None,
        fault: None,
        control: "127.0.0.1:0".into(),
        cache: Some(Path::new(env!("CARGO_TARGET_TMPDIR")).join("skin")),
        ready_file: None,
        with_parent: false,
    };
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

async fn keeps_the_contract(name: &str) {
    let latch = StopLatch::new();
    let (_rig, config, open, clock) = rig(name, &latch).await;
    let report = check(&config, &open, &clock).await;
    println!("{report}");
    assert!(report.is_sound(), "{report}");
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
}

async fn moves_and_stops(axis: &Arc<dyn Axis>, latch: &StopLatch) {
    let (name, [_, max]) = (axis.name(), axis.travel());
    // There and back.
    for target in [0.3 * max, 0.1 * max] {
        axis.start_move(target, f64::INFINITY).await.unwrap();
        let there = until(axis, "move", |s| !s.moving).await;
        assert!((there.position - target).abs() < 0.06, "{name}: {there:?}, not {target}");
    }
    // A stop on the way holds, and the next move goes where it is told.
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

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn iai_and_adam_over_tcp() {
    keeps_the_contract("virtual").await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn oriental_az_and_waveshare_over_rtu() {
    keeps_the_contract("oriental-az-rtu").await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn leadshine_and_waveshare_over_rtu() {
    keeps_the_contract("leadshine-rtu").await;
}
