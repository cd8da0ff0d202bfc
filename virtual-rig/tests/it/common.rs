//! A rig for tests, and clients of its wires.

use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;
use tokio_modbus::client::{Client, Context, rtu, tcp};
use tokio_modbus::prelude::{Reader, Slave, Writer};
use tokio_modbus::{Request, Response};
use tokio_serial::SerialStream;
use virtual_rig::{RigArgs, RigOptions, RunError, VirtualRig};

pub const IAI_TCP: &str = include_str!("../../../experiments/rigs/virtual.toml");
const SENSOR: &str = include_str!("../../../experiments/sensors/ert-28.toml");

/// Longest wait for an event.
pub const PATIENCE: Duration = Duration::from_secs(20);

static SERIAL: AtomicU32 = AtomicU32::new(0);

/// Rigs are started one after the other: the first caches its response fields for the others.
static SWITCH: tokio::sync::Mutex<()> = tokio::sync::Mutex::const_new(());

fn experiments() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../experiments")
}

/// A separate directory for each test.
fn scratch() -> PathBuf {
    let name = format!("it-{}-{}", std::process::id(), SERIAL.fetch_add(1, Ordering::Relaxed));
    let dir = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::create_dir_all(&dir).unwrap();
    dir
}

/// The rig file with axes of another make, all on one RTU line, cells on a Waveshare module.
pub fn on_one_bus(device: &str, counts_per_mm: f64, counts_per_deg: f64) -> String {
    IAI_TCP
        .replace("kind = \"modbus-tcp\"\naddress = \"127.0.0.1:5020\"", BUS)
        .replace("[lines.cells]\nkind = \"modbus-tcp\"\naddress = \"127.0.0.1:5021\"\n", "")
        .replace("device = \"iai\"", &format!("device = \"{device}\""))
        .replace("counts_per_mm = 100.0", &format!("counts_per_mm = {counts_per_mm:?}"))
        .replace("counts_per_deg = 100.0", &format!("counts_per_deg = {counts_per_deg:?}"))
        .replace("device = \"adam_6017\"\nline = \"cells\"\nunit = 1", CELLS)
        .replace("kind = \"tcp\"\naddress = \"127.0.0.1:5030\"", ERT)
}

const BUS: &str = "kind = \"modbus-rtu\"\npath = \"unused\"\nbaud = 115200";
const CELLS: &str = "device = \"waveshare_8ch\"\nline = \"stage\"\nunit = 9";
const ERT: &str = "kind = \"serial\"\npath = \"unused\"\nbaud = 921600";

pub async fn switch_on(rig: &str, speed: f64, faults: &str) -> VirtualRig {
    serve(rig, speed, faults, true).await.unwrap()
}

pub async fn serve(
    rig: &str,
    speed: f64,
    faults: &str,
    ephemeral: bool,
) -> Result<VirtualRig, RunError> {
    let dir = scratch();
    let (rig_file, sensor, fault) =
        (dir.join("rig.toml"), dir.join("sensor.toml"), dir.join("faults.toml"));
    std::fs::write(&rig_file, rig).unwrap();
    std::fs::write(&sensor, SENSOR).unwrap();
    std::fs::write(&fault, faults).unwrap();
    let options = RigOptions {
        seed: 3,
        speed: Some(speed),
        age_days: 0.0,
        ephemeral,
        out_rig: Some(dir.join("served.toml")),
        fault: Some(fault),
        control: "127.0.0.1:0".into(),
        cache: Some(PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("skin")),
        ready_file: None,
        with_parent: false,
    };
    let gap = experiments().join("gaps/gap-a.toml");
    let args = RigArgs { rig: rig_file, gap, sensor, options };
    let _alone = SWITCH.lock().await;
    VirtualRig::switch_on(&args).await
}

/// A rig with its control connection and a client of its axes.
pub async fn bench(speed: f64) -> (VirtualRig, Control, Iai) {
    let rig = switch_on(IAI_TCP, speed, "").await;
    let (control, stage) = (Control::open(&rig).await, tcp_client(&rig, "stage").await);
    (rig, control, Iai(stage))
}

/// Homes every axis and moves the indenter over the middle of the skin, 20 mm above it. Returns the
/// height of the surface, mm.
pub async fn over_the_skin(iai: &mut Iai, control: &mut Control) -> f64 {
    iai.home(1..=4).await;
    iai.go(1, 280.0, 250.0).await;
    iai.go(2, 290.0, 250.0).await;
    iai.go(4, 60.0, 120.0).await;
    let surface_z_mm = control.status().await["surface_z_mm"].as_f64().unwrap();
    iai.go(3, surface_z_mm - 20.0, 60.0).await;
    surface_z_mm
}

pub async fn cells_client(rig: &VirtualRig) -> Context {
    let mut cells = tcp_client(rig, "cells").await;
    tokio_modbus::slave::SlaveContext::set_slave(&mut cells, Slave(1));
    cells
}

/// A reader of the voltage stream.
pub async fn reader(rig: &VirtualRig) -> StreamReader<TcpStream> {
    StreamReader::new(TcpStream::connect(&rig.ready.ert).await.unwrap())
}

pub async fn tcp_client(rig: &VirtualRig, line: &str) -> Context {
    tcp::connect(rig.ready.lines[line].parse().unwrap()).await.unwrap()
}

/// A client on the bus.
pub fn rtu_client(rig: &VirtualRig) -> Context {
    let port = SerialStream::open(&tokio_serial::new(&rig.ready.lines["stage"], 115_200)).unwrap();
    rtu::attach(port)
}

/// A control connection.
pub struct Control(BufReader<TcpStream>);

impl Control {
    pub async fn open(rig: &VirtualRig) -> Self {
        Self(BufReader::new(TcpStream::connect(&rig.ready.control).await.unwrap()))
    }

    pub async fn say(&mut self, command: Value) -> Value {
        self.0.get_mut().write_all(format!("{command}\n").as_bytes()).await.unwrap();
        let mut line = String::new();
        self.0.read_line(&mut line).await.unwrap();
        serde_json::from_str(&line).unwrap()
    }

    pub async fn status(&mut self) -> Value {
        self.say(json!({ "cmd": "status" })).await
    }
}

/// IAI axes controlled directly over any transport.
pub struct Iai(pub Context);

impl Iai {
    pub fn unit(&mut self, unit: u8) -> &mut Context {
        tokio_modbus::slave::SlaveContext::set_slave(&mut self.0, Slave(unit));
        &mut self.0
    }

    /// Modbus in control, servo on, homed.
    pub async fn home(&mut self, units: std::ops::RangeInclusive<u8>) {
        for unit in units.clone() {
            for coil in [0x0427, 0x0403, 0x040B] {
                self.unit(unit).write_single_coil(coil, true).await.unwrap().unwrap();
            }
        }
        for unit in units {
            self.wait(unit, |dss1| dss1 & 1 << 4 != 0).await;
        }
    }

    pub async fn status(&mut self, unit: u8) -> (f64, u16) {
        let block = self.unit(unit).read_holding_registers(0x9000, 10).await.unwrap().unwrap();
        let position = (u32::from(block[0]) << 16 | u32::from(block[1])) as i32;
        (f64::from(position) / 100.0, block[5])
    }

    pub async fn wait(&mut self, unit: u8, done: impl Fn(u16) -> bool) -> f64 {
        let since = Instant::now();
        loop {
            let (position, dss1) = self.status(unit).await;
            if done(dss1) {
                return position;
            }
            assert!(since.elapsed() < PATIENCE, "unit {unit} at {position}, DSS1 {dss1:04x}");
        }
    }

    pub async fn start(&mut self, unit: u8, target: f64, speed: f64) {
        let words = |v: f64| {
            let counts = (v * 100.0).round() as i32 as u32;
            [(counts >> 16) as u16, counts as u16]
        };
        let ([ph, pl], [vh, vl]) = (words(target), words(speed));
        let block = [ph, pl, 0, 1, vh, vl, 10, 0, 0];
        self.unit(unit).write_multiple_registers(0x9900, &block).await.unwrap().unwrap();
    }

    pub async fn go(&mut self, unit: u8, target: f64, speed: f64) {
        self.start(unit, target, speed).await;
        self.wait(unit, |dss1| dss1 & 1 << 3 != 0).await;
    }
}

/// Sends a request to a unit and returns the exception code or the response.
pub async fn call(context: &mut Context, request: Request<'_>) -> Result<Response, u16> {
    context.call(request).await.unwrap().map_err(|exception| u8::from(exception).into())
}

/// One frame, decoded by an independent reader.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    pub sequence: u32,
    pub device_time_us: u64,
    pub voltages_v: Vec<f64>,
}

/// Reads a packet stream.
pub struct StreamReader<R> {
    wire: R,
    pending: Vec<u8>,
    pub garbled: u32,
    pub statuses: Vec<String>,
}

impl<R: AsyncReadExt + Unpin> StreamReader<R> {
    pub fn new(wire: R) -> Self {
        Self { wire, pending: Vec::new(), garbled: 0, statuses: Vec::new() }
    }

    pub async fn frame(&mut self) -> Frame {
        let waited = tokio::time::timeout(PATIENCE, self.next_frame()).await;
        waited.expect("a frame")
    }

    async fn next_frame(&mut self) -> Frame {
        loop {
            while let Some(zero) = self.pending.iter().position(|&b| b == 0) {
                let packet: Vec<u8> = self.pending.drain(..=zero).collect();
                if let Some(frame) = self.decode(&packet[..zero]) {
                    return frame;
                }
            }
            let n = self.wire.read_buf(&mut self.pending).await.unwrap();
            assert!(n > 0, "the stream ended");
        }
    }

    fn decode(&mut self, packet: &[u8]) -> Option<Frame> {
        let raw = uncobs(packet).filter(|raw| {
            raw.len() > 6 && raw[raw.len() - 4..] == crc32(&raw[..raw.len() - 4]).to_le_bytes()
        });
        let Some(raw) = raw else {
            self.garbled += 1;
            return None;
        };
        assert_eq!(raw[0], 1);
        if raw[1] == 2 {
            let text = String::from_utf8(raw[2..raw.len() - 4].to_vec()).unwrap();
            self.statuses.push(text);
            return None;
        }
        assert_eq!((raw[1], &raw[2..4], raw.len()), (1, &[28, 0][..], 20 + 2 * 784 + 4));
        let volts_per_count = f64::from(f32::from_le_bytes(raw[16..20].try_into().unwrap()));
        let counts = raw[20..1588].chunks(2).map(|c| i16::from_le_bytes([c[0], c[1]]));
        Some(Frame {
            sequence: u32::from_le_bytes(raw[4..8].try_into().unwrap()),
            device_time_us: u64::from_le_bytes(raw[8..16].try_into().unwrap()),
            voltages_v: counts.map(|c| f64::from(c) * volts_per_count).collect(),
        })
    }
}

impl Frame {
    /// Largest magnitude, V.
    pub fn largest_v(&self) -> f64 {
        self.voltages_v.iter().fold(0.0, |m, v| m.max(v.abs()))
    }

    /// Largest magnitude of an injection sum, V.
    pub fn largest_sum_v(&self) -> f64 {
        let sums = self.voltages_v.chunks(28).map(|c| c.iter().sum::<f64>().abs());
        sums.fold(0.0, f64::max)
    }
}

fn uncobs(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut out = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        let code = usize::from(bytes[at]);
        out.extend(bytes.get(at + 1..at + code)?);
        at += code;
        if code < 0xFF && at < bytes.len() {
            out.push(0);
        }
    }
    Some(out)
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, &b| {
        (0..8)
            .fold(crc ^ u32::from(b), |c, _| if c & 1 == 1 { c >> 1 ^ 0xEDB8_8320 } else { c >> 1 })
    })
}
