//! Byte exchanges written from the devices' documents, replayed through the drivers over an
//! in-memory wire, with cut and corrupted frames among them. And every rig file parses.
//!
//! A transcript's lines: `>` the driver must send these bytes, `<` the device answers these,
//! `= close` the device closes the wire, `= reopen` the driver must close it and open it again,
//! `!` bytes that are waiting when the wire is opened, `#` words.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use palpate::clock::Clock;
use palpate::rig::adam_6017::Adam6017;
use palpate::rig::axis::{Drive, ModbusAxis};
use palpate::rig::config::{
    AxisDevice, AxisProfile, CellsConfig, CellsDevice, ErtConfig, Guard, RigConfig,
};
use palpate::rig::error::RigError;
use palpate::rig::ert_stream::ErtStream;
use palpate::rig::iai::Iai;
use palpate::rig::leadshine_em2rs::LeadshineEm2rs;
use palpate::rig::link::{Framing, Line, LinePolicy, MotionGate, Opener, Port, StopLatch};
use palpate::rig::oriental_az::OrientalAz;
use palpate::rig::station::Station;
use palpate::rig::traits::{Axis, AxisStatus, LoadCells, SkinReader};
use palpate::rig::waveshare_8ch::Waveshare8ch;
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

/// Process time runs fast, so that a transcript's axis may be anywhere at its next status.
const RATE: f64 = 1e5;
/// The longest that a whole transcript may take.
const LIMIT: Duration = Duration::from_secs(20);

#[derive(Debug)]
enum Step {
    Sent(Vec<u8>),
    Answer(Vec<u8>),
    Waiting(Vec<u8>),
    Close,
    Reopen,
}

fn read(name: &str) -> VecDeque<Step> {
    let path = format!("{}/tests/transcripts/{name}", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(path).unwrap();
    let lines = text.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with('#'));
    lines
        .map(|line| {
            let (mark, rest) = line.split_once(' ').unwrap();
            let bytes =
                || rest.split_whitespace().map(|b| u8::from_str_radix(b, 16).unwrap()).collect();
            match (mark, rest) {
                (">", _) => Step::Sent(bytes()),
                ("<", _) => Step::Answer(bytes()),
                ("!", _) => Step::Waiting(bytes()),
                ("=", "close") => Step::Close,
                ("=", "reopen") => Step::Reopen,
                other => panic!("{name}: {other:?}"),
            }
        })
        .collect()
}

/// The device's side: plays its part and says at the end that nothing was left over.
async fn play(mut steps: VecDeque<Step>, mut wires: mpsc::Receiver<DuplexStream>) {
    let mut wire = wires.recv().await.expect("the driver opens its wire");
    while let Some(step) = steps.pop_front() {
        match step {
            Step::Sent(expected) => {
                let mut sent = vec![0; expected.len()];
                wire.read_exact(&mut sent).await.expect("the driver sends");
                assert_eq!(hex(&sent), hex(&expected), "with {} steps to go", steps.len());
            }
            Step::Answer(bytes) | Step::Waiting(bytes) => wire.write_all(&bytes).await.unwrap(),
            Step::Close => {
                drop(wire);
                wire = wires.recv().await.expect("the driver opens its wire again");
            }
            Step::Reopen => {
                let mut rest = Vec::new();
                wire.read_to_end(&mut rest).await.unwrap();
                assert_eq!(hex(&rest), "", "sent before the wire was opened again");
                wire = wires.recv().await.expect("the driver opens its wire again");
            }
        }
    }
    let more = tokio::time::timeout(Duration::from_millis(20), wire.read_u8()).await;
    assert!(!matches!(more, Ok(Ok(_))), "the driver sends more than the transcript holds");
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02X}")).collect::<Vec<_>>().join(" ")
}

fn line(name: &str, framing: Framing) -> (Arc<Line>, JoinHandle<()>) {
    let (wires_in, wires) = mpsc::channel(4);
    let opener: Opener = Box::new(move || {
        let wires = wires_in.clone();
        Box::pin(async move {
            let (ours, theirs) = tokio::io::duplex(1024);
            wires.send(theirs).await.map_err(|_| std::io::ErrorKind::ConnectionRefused)?;
            Ok(Box::new(ours) as Box<dyn Port>)
        })
    });
    let policy = LinePolicy {
        timeout: Duration::from_millis(150),
        attempts: 3,
        silence: Duration::ZERO,
        stop_grace: Duration::from_millis(15),
    };
    let device = tokio::spawn(play(read(name), wires));
    let line = Line::spawn("wire", framing, opener, policy, Clock::new(RATE));
    (Arc::new(line), device)
}

fn axis<D: Drive>(
    line: &Arc<Line>,
    unit: u8,
    drive: D,
    device: AxisDevice,
    counts_per_unit: f64,
) -> ModbusAxis<D> {
    guarded_axis(line, unit, drive, device, counts_per_unit, Guard::default())
}

fn guarded_axis<D: Drive>(
    line: &Arc<Line>,
    unit: u8,
    drive: D,
    device: AxisDevice,
    counts_per_unit: f64,
    guard: Guard,
) -> ModbusAxis<D> {
    let profile = AxisProfile {
        device,
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
    let gate = MotionGate::new(StopLatch::new());
    ModbusAxis::new("x", drive, station, profile, gate, Clock::new(RATE))
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
    }
}

async fn within<T>(what: impl Future<Output = T>) -> T {
    tokio::time::timeout(LIMIT, what).await.expect("the transcript takes too long")
}

async fn iai_life(name: &str, framing: Framing, unit: u8) {
    let (line, device) = line(name, framing);
    let x = axis(&line, unit, Iai, AxisDevice::Iai, 100.0);
    assert_eq!(x.prepare().await.unwrap(), "IAI, servo on, not homed");
    x.start_home().await.unwrap();
    let home = x.status().await.unwrap();
    assert!(home.homed && home.ready && !home.moving && home.position == 0.0);
    x.start_move(12.34, 100.0).await.unwrap();
    let under_way = x.status().await.unwrap();
    assert!(under_way.moving && under_way.position == 5.0);
    x.stop().await.unwrap();
    let outside = x.start_move(500.01, 100.0).await.unwrap_err();
    assert!(matches!(outside, RigError::OutsideTravel { .. }), "and nothing was sent");
    x.start_move(20.0, 900.0).await.unwrap();
    let alarm = x.status().await.unwrap();
    assert_eq!((alarm.alarm, alarm.ready, alarm.moving), (Some(0xCC), false, false));
    x.reset_alarm().await.unwrap();
    device.await.unwrap();
}

#[tokio::test]
async fn iai_over_tcp() {
    within(iai_life("iai_tcp.txt", Framing::Tcp, 1)).await;
}

#[tokio::test]
async fn iai_over_rtu() {
    within(iai_life("iai_rtu.txt", Framing::Rtu, 2)).await;
}

#[tokio::test]
async fn a_damaged_or_late_reply_never_passes_as_a_position() {
    within(async {
        let (line, device) = line("iai_rtu_faults.txt", Framing::Rtu);
        let x = axis(&line, 2, Iai, AxisDevice::Iai, 100.0);
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
        let (line, device) = line("iai_tcp_lost_moves.txt", Framing::Tcp);
        let x = axis(&line, 1, Iai, AxisDevice::Iai, 100.0);
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

async fn status_of<D: Drive>(x: &ModbusAxis<D>) -> AxisStatus {
    x.status().await.unwrap()
}

#[tokio::test]
async fn an_iai_is_identified_without_a_write() {
    within(async {
        let (line, device) = line("iai_tcp_identify.txt", Framing::Tcp);
        let x = axis(&line, 1, Iai, AxisDevice::Iai, 100.0);
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
        let (line, device) = line("oriental_az_guard_rtu.txt", Framing::Rtu);
        let guard = Guard { watchdog_ms: Some(500), torque_percent: Some(60) };
        let drive = AxisDevice::OrientalAz;
        let x = guarded_axis(&line, 1, OrientalAz, drive, 1000.0, guard);
        assert_eq!(x.guard(), guard);
        assert_eq!(x.identify().await.unwrap().to_string(), "Oriental Motor AZ, servo on, homed");
        let found = x.prepare().await.unwrap();
        assert_eq!(found, "Oriental Motor AZ, ready, not homed, watchdog 500 ms, torque 60 %");
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
async fn oriental_az_over_rtu() {
    within(async {
        let (line, device) = line("oriental_az_rtu.txt", Framing::Rtu);
        let x = axis(&line, 1, OrientalAz, AxisDevice::OrientalAz, 1000.0);
        assert_eq!(x.prepare().await.unwrap(), "Oriental Motor AZ, ready, not homed");
        x.start_home().await.unwrap();
        let home = x.status().await.unwrap();
        assert!(home.homed && home.ready && !home.moving);
        x.start_move(123.4, 100.0).await.unwrap();
        let under_way = x.status().await.unwrap();
        assert!(under_way.moving && under_way.ready && under_way.position == 50.0);
        x.stop().await.unwrap();
        x.start_move(10.0, 100.0).await.unwrap();
        assert_eq!(x.status().await.unwrap().alarm, Some(0x30));
        x.reset_alarm().await.unwrap();
        assert_eq!(x.status().await.unwrap().position, 9.0);
        device.await.unwrap();
    })
    .await;
}

#[tokio::test]
async fn leadshine_em2rs_over_rtu() {
    within(async {
        let (line, device) = line("leadshine_em2rs_rtu.txt", Framing::Rtu);
        let drive = LeadshineEm2rs::default();
        let x = axis(&line, 5, drive, AxisDevice::LeadshineEm2rs, 2000.0);
        let found = x.prepare().await.unwrap();
        assert_eq!(found, "Leadshine EM2RS, enabled, 10000 pulses/rev, not homed");
        x.start_home().await.unwrap();
        assert!(x.status().await.unwrap().moving);
        let home = x.status().await.unwrap();
        assert!(home.homed && !home.moving && home.position == 0.0);
        x.start_move(50.0, 100.0).await.unwrap();
        assert_eq!(x.status().await.unwrap().position, 25.0);
        x.stop().await.unwrap();
        let fault = x.status().await.unwrap();
        assert_eq!((fault.alarm, fault.ready), (Some(0x80), false));
        x.reset_alarm().await.unwrap();
        assert_eq!(x.status().await.unwrap().position, 25.05);
        device.await.unwrap();
    })
    .await;
}

#[tokio::test]
async fn adam_6017_over_tcp() {
    within(async {
        let (line, device) = line("adam_6017_tcp.txt", Framing::Tcp);
        let station = Station::new(Arc::clone(&line), 1, "cells");
        let module = Adam6017::new(station, &cells(CellsDevice::Adam6017), Clock::new(RATE));
        let early = module.read().await.unwrap_err();
        assert!(matches!(early, RigError::NotReady { .. }), "ranges are not known yet: {early}");
        assert_eq!(module.prepare().await.unwrap(), "ADAM-6017, Volts0To5");
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
        let (line, device) = line("adam_6017_wrong.txt", Framing::Tcp);
        let station = Station::new(line, 1, "cells");
        let module = Adam6017::new(station, &cells(CellsDevice::Adam6017), Clock::new(RATE));
        let model = module.prepare().await.unwrap_err().to_string();
        assert_eq!(model, "cells: model 6024, but the rig file needs an ADAM-6017 (6017)");
        let range = module.prepare().await.unwrap_err().to_string();
        assert!(range.starts_with("cells: channel 5 has type 0x0180"), "{range}");
        device.await.unwrap();
    })
    .await;
}

#[tokio::test]
async fn waveshare_8ch_over_rtu() {
    within(async {
        let (line, device) = line("waveshare_8ch_rtu.txt", Framing::Rtu);
        let station = Station::new(line, 1, "cells");
        let module =
            Waveshare8ch::new(station, &cells(CellsDevice::Waveshare8ch), Clock::new(RATE));
        let found = module.prepare().await.unwrap();
        assert_eq!(found, "Waveshare 8CH, version 1.00, 0 to 5 V");
        let update_ms = cells(CellsDevice::Waveshare8ch).update_ms;
        let update = Duration::from_secs_f64(update_ms / 1e3 / RATE);
        for n in 0..3 {
            let reading = module.read().await.unwrap();
            assert_eq!(reading.volts, [0.5, 0.512, 1.0, 0.0, 4.5, 2.5]);
            assert_eq!(reading.repeats, [n; 6]);
            // Longer than an update of the module: a reading within one repeats nothing.
            tokio::time::sleep(update).await;
        }
        device.await.unwrap();
    })
    .await;
}

/// Sends a transcript's answers to whoever connects, in portions, again and again.
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
        let mut feed = stream.subscribe();
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

fn rig_files() -> Vec<(String, String)> {
    let folder = format!("{}/experiments/rigs", env!("CARGO_MANIFEST_DIR"));
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "toml"))
        .map(|path| {
            let name = path.file_name().unwrap().to_str().unwrap().to_owned();
            (name, std::fs::read_to_string(path).unwrap())
        })
        .collect();
    files.sort();
    files
}

#[test]
fn every_rig_file_parses() {
    let files = rig_files();
    for needed in ["iai-modbus-tcp", "oriental-az-rtu", "leadshine-rtu", "virtual"] {
        assert!(files.iter().any(|(name, _)| name == &format!("{needed}.toml")), "{needed}");
    }
    for (name, text) in files {
        let config = RigConfig::from_toml(&name, &text).unwrap_or_else(|p| panic!("{p:#?}"));
        let radii = config.slot.radius_mm.map(|r| config.slot.angle_deg(r));
        assert!(radii[0] < radii[1], "{name}");
    }
}

fn problems(from: &str, to: &str) -> String {
    let name = "iai-modbus-tcp.toml";
    let (_, text) = rig_files().into_iter().find(|(n, _)| n == name).unwrap();
    assert!(text.contains(from), "{from}");
    let problems = RigConfig::from_toml(name, &text.replacen(from, to, 1)).unwrap_err();
    problems.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
}

#[test]
fn a_wrong_rig_file_is_told_with_file_key_value_and_limit() {
    let unknown = problems("clock_rate =", "clock_speed =");
    assert!(unknown.starts_with("iai-modbus-tcp.toml"), "{unknown}");
    assert!(unknown.contains("unknown field `clock_speed`"), "{unknown}");
    assert!(unknown.contains("`clock_rate`"), "names what is allowed: {unknown}");
    assert_eq!(
        problems("clock_rate = 1.0", "clock_rate = 0.0"),
        "iai-modbus-tcp.toml: clock_rate = 0: must be from 0.01 to 2000"
    );
    assert_eq!(
        problems("speed_mm_s = 60.0", "speed_mm_s = 9000.0"),
        "iai-modbus-tcp.toml: axes.z.speed_mm_s = 9000: must be from 0.001 to 5000"
    );
    assert_eq!(
        problems("timeout_ms = 300", "timeout_ms = 0"),
        "iai-modbus-tcp.toml: lines.cells.timeout_ms = 0: must be from 5 to 10000"
    );
}
