//! Byte exchanges written from the devices' documents, replayed through the drivers over an
//! in-memory wire, with cut and corrupted frames among them. A transcript with a script is run by
//! `scripts`; those here need more than a script can state. `complete` checks that no driver lacks one.
//!
//! A transcript's lines: `>` the driver must send these bytes, `<` the device answers these,
//! `= close` the device closes the wire, `= reopen` the driver must close it and open it again,
//! `!` bytes that are waiting when the wire is opened, `:` a call of the driver, `#` words.

mod complete;
mod play;
mod scripts;

use std::sync::Arc;
use std::time::Duration;

use palpate::clock::Clock;
use palpate::rig::config::{AxisDevice, AxisProfile, CellsConfig, CellsDevice, ErtConfig, Guard};
use palpate::rig::device::AxisParts;
use palpate::rig::drives::{iai, oriental_az};
use palpate::rig::error::RigError;
use palpate::rig::ert_stream::ErtStream;
use palpate::rig::input_modules::adam_6017;
use palpate::rig::link::{Framing, Line, MotionGate, StopLatch};
use palpate::rig::station::Station;
use palpate::rig::traits::{Axis, AxisStatus, SkinReader};
use tokio::io::AsyncWriteExt;

use play::{LIMIT, RATE, Step, line, read};

fn axis(
    line: &Arc<Line>,
    unit: u8,
    device: AxisDevice,
    counts_per_unit: f64,
    guard: Guard,
) -> Arc<dyn Axis> {
    let profile = AxisProfile {
        line: "wire".into(),
        address: unit,
        counts_per_unit,
        travel: [0.0, 500.0],
        speed: 100.0,
        acceleration: 1500.0,
        tolerance: 0.05,
        guard,
    };
    let station = Station::new(Arc::clone(line), unit, "x");
    let (gate, clock) = (MotionGate::new(StopLatch::default()), Clock::new(RATE));
    device.open(AxisParts { name: "x", station, profile, gate, clock })
}

fn iai(line: &Arc<Line>, unit: u8) -> Arc<dyn Axis> {
    axis(line, unit, iai::DRIVE, 100.0, Guard::default())
}

fn cells(device: CellsDevice) -> CellsConfig {
    CellsConfig {
        device,
        line: "wire".into(),
        unit: 1,
        channels: [0, 1, 2, 3, 4, 5],
        update_ms: 100.0,
        supply_v: 5.0,
        full_scale_n: 111.2,
        force_noise_n: 0.1,
        repeats_max: None,
        in_air_n: None,
        calibrated_on: None,
    }
}

async fn within<T>(what: impl Future<Output = T>) -> T {
    tokio::time::timeout(LIMIT, what).await.expect("the transcript takes too long")
}

#[tokio::test]
async fn a_damaged_or_late_reply_never_passes_as_a_position() {
    within(async {
        let (line, device) = line(read("iai_rtu_faults.txt"), Framing::Rtu);
        let x = iai(&line, 2);
        for _ in 0..6 {
            assert_eq!(x.status().await.unwrap().position, 10.0);
        }
        device.await.unwrap();
        let counts = line.counts();
        assert_eq!((counts.answered, counts.retries, counts.reconnects), (6, 4, 4));
        assert_eq!(counts.timeouts + counts.garbled, 4);
    })
    .await;
}

#[tokio::test]
async fn a_move_whose_reply_was_lost_is_sent_again_only_if_the_axis_stands() {
    within(async {
        let (line, device) = line(read("iai_tcp_lost_moves.txt"), Framing::Tcp);
        let x = iai(&line, 1);
        assert!(!status_of(&x).await.moving);
        x.start_move(12.34, 100.0).await.unwrap();
        assert_eq!(status_of(&x).await.position, 12.34);
        x.start_move(20.0, 100.0).await.unwrap();
        assert_eq!(status_of(&x).await.position, 13.0);
        assert_eq!(status_of(&x).await.position, 13.2, "0x4000 in the high word is no place");
        device.await.unwrap();
    })
    .await;
}

async fn status_of(x: &Arc<dyn Axis>) -> AxisStatus {
    x.status().await.unwrap()
}

#[tokio::test]
async fn an_iai_is_identified_without_a_write() {
    within(async {
        let (line, device) = line(read("iai_tcp_identify.txt"), Framing::Tcp);
        let x = iai(&line, 1);
        let off = x.identify().await.unwrap();
        assert_eq!(off.to_string(), "IAI, servo off, not homed");
        assert_eq!((off.faults().len(), off.untried().len()), (0, 2), "{:?}", off.untried());
        let on = x.identify().await.unwrap();
        assert_eq!(on.to_string(), "IAI, servo on, homed");
        assert_eq!((on.faults().len(), on.untried().len()), (0, 0));
        let stopped = x.identify().await.unwrap();
        assert_eq!(stopped.faults(), ["its emergency stop is pressed", "alarm 0xCC"]);
        device.await.unwrap();
    })
    .await;
}

#[tokio::test]
async fn an_az_takes_its_guards_and_they_are_read_back() {
    within(async {
        let (line, device) = line(read("oriental_az_guard_rtu.txt"), Framing::Rtu);
        let guard = Guard { watchdog_ms: Some(500), torque_percent: Some(60) };
        let x = axis(&line, 1, oriental_az::DRIVE, 1000.0, guard);
        assert_eq!(x.guard(), guard);
        assert_eq!(x.identify().await.unwrap().to_string(), "Oriental Motor AZ, servo on, homed");
        let found = x.prepare().await.unwrap();
        assert_eq!(found, "Oriental Motor AZ, servo on, not homed, watchdog 500 ms, torque 60 %");
        x.start_move(10.0, 100.0).await.unwrap();
        let refused = x.prepare().await.unwrap_err();
        assert!(matches!(refused, RigError::WrongDevice { .. }), "{refused}");
        let words = "x: guard.watchdog_ms reads back as [0, 0], but the rig file needs [0, 500], \
                     as it was written";
        assert_eq!(refused.to_string(), words);
        device.await.unwrap();
    })
    .await;
}

#[tokio::test]
async fn adam_6017_over_tcp() {
    within(async {
        let (line, device) = line(read("adam_6017_tcp.txt"), Framing::Tcp);
        let station = Station::new(Arc::clone(&line), 1, "cells");
        let module =
            adam_6017::MODULE.open(cells(adam_6017::MODULE).parts(station, Clock::new(RATE)));
        let early = module.read().await.unwrap_err();
        assert!(matches!(early, RigError::NotReady { .. }), "ranges are not known yet: {early}");
        assert_eq!(module.prepare().await.unwrap(), "ADAM-6017, 0 to 5 V");
        for n in 0..5 {
            // Longer than an update of the module.
            tokio::time::sleep(Duration::from_millis(1)).await;
            let reading = module.read().await.unwrap();
            let volts = reading.volts;
            assert!((volts[0] - 0.5).abs() < 1e-4, "{volts:?}");
            assert_eq!((volts[3], volts[4]), (0.0, 5.0));
            assert_eq!(reading.repeats, [n; 6], "the flipped bit of the second was not taken");
        }
        device.await.unwrap();
        assert_eq!((line.counts().reconnects, line.counts().garbled), (3, 2));
    })
    .await;
}

#[tokio::test]
async fn another_module_or_another_range_is_refused() {
    within(async {
        let (line, device) = line(read("adam_6017_wrong.txt"), Framing::Tcp);
        let station = Station::new(line, 1, "cells");
        let module =
            adam_6017::MODULE.open(cells(adam_6017::MODULE).parts(station, Clock::new(RATE)));
        let model = module.prepare().await.unwrap_err().to_string();
        assert_eq!(model, "cells: model 6024, but the rig file needs an ADAM-6017 (6017)");
        let range = module.prepare().await.unwrap_err().to_string();
        assert!(range.starts_with("cells: channel 5 has type 0x0180"), "{range}");
        device.await.unwrap();
    })
    .await;
}

/// Sends a transcript's answers to every client that connects, in portions, again and again.
async fn broadcast(listener: tokio::net::TcpListener, portion: usize) {
    let (mut wire, _) = listener.accept().await.unwrap();
    let steps = read("ert_stream.txt");
    let bytes = steps.iter().flat_map(|s| match s {
        Step::Answer(bytes) => bytes.clone(),
        other => panic!("{other:?} in a stream"),
    });
    for piece in bytes.collect::<Vec<u8>>().chunks(portion) {
        wire.write_all(piece).await.unwrap();
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    tokio::time::sleep(LIMIT).await;
}

#[tokio::test]
async fn the_voltage_stream_over_tcp() {
    within(async {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let device = tokio::spawn(broadcast(listener, 23));
        let config = ErtConfig::Tcp { address, electrodes: 4, frame_rate_hz: 30.0 };
        let age = Duration::from_secs(5);
        let stream = ErtStream::open(&config, age, Clock::new(1.0)).unwrap();
        let mut feed = stream.follow();
        let mut frames = Vec::new();
        while frames.last().is_none_or(|f: &Arc<palpate::rig::traits::Frame>| f.sequence < 13) {
            frames.push(feed.recv().await.unwrap());
        }
        let sequences: Vec<u32> = frames.iter().map(|f| f.sequence).collect();
        assert_eq!(sequences, [7, 8, 11, 13]);
        assert!(frames.iter().all(|f| f.counts[0] == f.sequence as i16 && f.counts.len() == 16));
        assert_eq!(stream.latest().unwrap().sequence, 13);
        assert_eq!(stream.latest().unwrap().largest_injection_sum_v(), 0.0);
        assert_eq!(stream.status_line().as_deref(), Some("ert 1.0 ok"));
        let counters = stream.counters();
        assert_eq!((counters.frames, counters.missed, counters.garbled), (4, 3, 3));
        device.abort();
    })
    .await;
}
