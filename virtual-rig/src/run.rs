//! The process of the rig: reads its files, opens every wire, reports that it is ready, and ends on
//! a signal or with its parent.
//! Uses: everything of this crate except the operator. Never: physics, registers.

use std::collections::BTreeMap;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use serde::Serialize;
use sim_core::sensor::{Sensor, SensorError};
use tokio::net::{TcpListener, TcpSocket, lookup_host};
use tokio::task::JoinSet;
use tokio_serial::{SerialPort, SerialStream};

use crate::bench::Bench;
use crate::clock::RigClock;
use crate::config::{ConfigError, ErtPort, Line, RigFile};
use crate::ert::packet::Amplifier;
use crate::ert::sinks::{PtySink, Sinks};
use crate::ert::stream::Stream;
use crate::fault::{self, FaultError};
use crate::lab::Lab;
use crate::skin::{AnyMechanics, AnyReadout, AnySkin, GapError, GapFile, SkinError};
use crate::solver::Solver;
use crate::{control, wire};

/// Send buffer of a reader of the stream, bytes; data beyond it are dropped, not queued.
const STREAM_BUFFER: u32 = 64 * 1024;
/// Largest number of connections that wait to be accepted.
const BACKLOG: u32 = 64;
/// Number of threads for the wires.
const WORKERS: usize = 2;

/// A virtual rig behind real wires: its files and options.
#[derive(Debug, Clone)]
pub struct RigArgs {
    /// Rig file: devices and their wires.
    pub rig: PathBuf,
    /// Gap file: difference between this skin and the model.
    pub gap: PathBuf,
    /// Sensor file: geometry and materials of the skin.
    pub sensor: PathBuf,
    /// All else.
    pub options: RigOptions,
}

/// Options of `palpate virtual-rig`.
#[derive(Debug, Clone, Args)]
pub struct RigOptions {
    /// Seed of the skin: each seed is a different skin.
    #[arg(long, value_name = "N", default_value_t = 3)]
    pub seed: u64,
    /// Process seconds per wall second [default: clock_rate of the rig file]. Start the service with
    /// the rig file that --out-rig writes: it contains this rate.
    #[arg(long, value_name = "N")]
    pub speed: Option<f64>,
    /// Days since the readout was first switched on: its offsets have drifted since.
    #[arg(long, value_name = "DAYS", default_value_t = 0.0)]
    pub age_days: f64,
    /// Serve every wire at a free port or a new pseudo-terminal, independent of the rig file.
    #[arg(long)]
    pub ephemeral: bool,
    /// Write the rig file with the addresses that are served.
    #[arg(long, value_name = "FILE")]
    pub out_rig: Option<PathBuf>,
    /// Fault script, or the name of a carried one: which faults occur, and when.
    #[arg(long, value_name = "SCRIPT")]
    pub fault: Option<PathBuf>,
    /// Address of the control socket.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:0")]
    pub control: String,
    /// Folder in which solved response fields are cached [default: DATA/cache].
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// Write the line that reports readiness to this file, too.
    #[arg(long, value_name = "FILE")]
    pub ready_file: Option<PathBuf>,
    /// End when standard input closes, that is when the parent process ends.
    #[arg(long)]
    pub with_parent: bool,
}

/// Reason why the rig cannot be started.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum RunError {
    #[error("{path}: {source}", path = path.display())]
    File { path: PathBuf, source: io::Error },
    #[error("{path}: {source}", path = path.display())]
    Rig { path: PathBuf, source: ConfigError },
    #[error("{path}: {source}", path = path.display())]
    Sensor { path: PathBuf, source: SensorError },
    #[error("{path}: {source}", path = path.display())]
    Gap { path: PathBuf, source: GapError },
    #[error("skin: {0}")]
    Skin(#[from] SkinError),
    #[error("{path}: {source}", path = path.display())]
    Fault { path: PathBuf, source: FaultError },
    #[error("ert.electrodes = {rig}: the sensor has {sensor}")]
    Electrodes { rig: u16, sensor: usize },
    #[error("--speed {0}: must be a positive number")]
    Speed(f64),
    #[error("listening at {address}: {source}")]
    Listen { address: String, source: io::Error },
    #[error("pseudo-terminal: {0}")]
    Pty(#[from] tokio_serial::Error),
    #[error("{0}: exists and is not a link to a pseudo-terminal; use --ephemeral")]
    Occupied(PathBuf),
    #[error("served rig file: {0}")]
    Served(#[from] toml::ser::Error),
    /// A thread or the runtime could not be started.
    #[error("starting: {0}")]
    Start(#[source] io::Error),
    #[error("signals: {0}")]
    Signals(#[source] io::Error),
}

/// Message of the rig when all its sockets listen.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Ready {
    /// Always `true`.
    pub ready: bool,
    /// Address of the control socket.
    pub control: String,
    /// Address or path of each Modbus line.
    pub lines: BTreeMap<String, String>,
    /// Address or path of the voltage stream.
    pub ert: String,
    /// Process seconds per wall second.
    pub speed: f64,
    /// Path of the served rig file, if one was requested.
    pub rig: Option<PathBuf>,
}

/// A running rig; dropping it stops it.
pub struct VirtualRig {
    /// Addresses of its wires.
    pub ready: Ready,
    /// Text of the rig file with the addresses that are served.
    pub rig_text: String,
    _stream: Stream,
    _wires: JoinSet<()>,
    _links: Vec<Link>,
}

/// A link at a configured serial path, removed when the rig ends.
struct Link(PathBuf);

impl Drop for Link {
    fn drop(&mut self) {
        std::fs::remove_file(&self.0).ok();
    }
}

/// Runs the rig until a signal, or until its parent ends. Prints one JSON line when it is ready.
///
/// # Errors
/// `RunError` if a file is not valid, a wire cannot be opened, or the skin cannot be built.
pub fn rig_main(args: RigArgs) -> Result<(), RunError> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(WORKERS)
        .enable_all()
        .build()
        .map_err(RunError::Start)?;
    let outcome = runtime.block_on(async {
        let ended = end_of_life(args.options.with_parent)?;
        tokio::pin!(ended);
        let rig = tokio::select! {
            rig = VirtualRig::switch_on(&args) => rig?,
            () = &mut ended => return Ok(()),
        };
        let line = serde_json::json!(rig.ready).to_string();
        let mut out = io::stdout();
        writeln!(out, "{line}").and_then(|()| out.flush()).map_err(RunError::Start)?;
        if let Some(path) = &args.options.ready_file {
            write_file(path, &line)?;
        }
        ended.await;
        drop(rig);
        Ok(())
    });
    // A skin that is still being built is not needed any more.
    runtime.shutdown_background();
    outcome
}

/// Resolves at SIGTERM, at ctrl-c, or when the pipe of the parent closes.
///
/// # Errors
/// `RunError::Signals` if the signal handlers cannot be installed.
pub(crate) fn end_of_life(with_parent: bool) -> Result<impl Future<Output = ()> + use<>, RunError> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut terminate = signal(SignalKind::terminate()).map_err(RunError::Signals)?;
    let mut interrupt = signal(SignalKind::interrupt()).map_err(RunError::Signals)?;
    let (gone, mut parent) = tokio::sync::mpsc::channel::<()>(1);
    let _watched = with_parent.then(|| {
        // Standard input has no asynchronous read that the runtime could cancel.
        std::thread::spawn(move || {
            let mut scratch = [0; 256];
            while matches!(io::stdin().read(&mut scratch), Ok(1..)) {}
            drop(gone);
        })
    });
    Ok(async move {
        tokio::select! {
            _ = terminate.recv() => {}
            _ = interrupt.recv() => {}
            _ = parent.recv(), if with_parent => {}
        }
    })
}

fn read_file(path: &Path) -> Result<String, RunError> {
    std::fs::read_to_string(path).map_err(|source| RunError::File { path: path.into(), source })
}

/// Writes the whole file or nothing: a reader never reads an incomplete file.
fn write_file(path: &Path, text: &str) -> Result<(), RunError> {
    let half = path.with_extension("part");
    std::fs::write(&half, text)
        .and_then(|()| std::fs::rename(&half, path))
        .map_err(|source| RunError::File { path: path.into(), source })
}

impl VirtualRig {
    /// Reads the files, builds the skin and opens every wire.
    ///
    /// # Errors
    /// `RunError` if a file is not valid, a wire cannot be opened, or the skin cannot be built.
    pub async fn switch_on(args: &RigArgs) -> Result<Self, RunError> {
        let options = &args.options;
        let rig_text = read_file(&args.rig)?;
        let mut rig = RigFile::from_toml(&rig_text)
            .map_err(|source| RunError::Rig { path: args.rig.clone(), source })?;
        let sensor = Sensor::from_toml(&read_file(&args.sensor)?)
            .map_err(|source| RunError::Sensor { path: args.sensor.clone(), source })?;
        let gap = GapFile::from_toml(&read_file(&args.gap)?)
            .map_err(|source| RunError::Gap { path: args.gap.clone(), source })?;
        let faults = match &options.fault {
            Some(path) => fault::script(&read_file(path)?, &rig)
                .map_err(|source| RunError::Fault { path: path.clone(), source })?,
            None => Vec::new(),
        };
        let speed = options.speed.unwrap_or(rig.clock_rate);
        if !(speed.is_finite() && speed > 0.0) {
            return Err(RunError::Speed(speed));
        }
        rig.clock_rate = speed;
        let electrodes = sensor.electrodes_mm().len();
        if usize::from(rig.ert.electrodes) != electrodes {
            return Err(RunError::Electrodes { rig: rig.ert.electrodes, sensor: electrodes });
        }
        let size = [sensor.file.width_mm, sensor.file.height_mm];
        let circuit = &sensor.file.circuit;
        let amplifier = Amplifier { source_v: circuit.source_v * circuit.gain };
        let readout = AnyReadout::new(&sensor, &gap, options.seed, options.age_days);
        let (seed, cache) = (options.seed, options.cache.clone());
        let (solver, mechanics) = tokio::task::spawn_blocking(move || {
            let mechanics = AnyMechanics::new(&sensor, &gap, seed)?;
            let skin = AnySkin::new(sensor, gap, seed, cache.as_deref())?;
            Ok::<_, RunError>((Solver::start(skin).map_err(RunError::Start)?, mechanics))
        })
        .await
        .map_err(|e| RunError::Start(io::Error::other(e)))??;
        let bench = Bench::power_up(&rig, size, mechanics, faults, options.seed);

        let mut doors = Doors::open(&rig, options).await?;
        let clock = RigClock::start(speed);
        let lab = Arc::new(Lab::new(rig, clock, solver, bench));
        let rig_text = served_rig(&rig_text, &doors, speed)?;
        if let Some(path) = &options.out_rig {
            write_file(path, &rig_text)?;
        }
        let ready = Ready {
            ready: true,
            control: doors.control_at.clone(),
            lines: doors.lines_at.clone(),
            ert: doors.ert_at.clone(),
            speed,
            rig: options.out_rig.clone(),
        };
        let links = std::mem::take(&mut doors.links);
        let (wires, sinks) = doors.serve(&lab);
        let stream =
            Stream::start(lab, readout, sinks, amplifier, options.seed).map_err(RunError::Start)?;
        Ok(Self { ready, rig_text, _stream: stream, _wires: wires, _links: links })
    }
}

/// All wires, open and not served yet.
struct Doors {
    control: TcpListener,
    control_at: String,
    tcp: Vec<(String, TcpListener)>,
    rtu: Vec<(String, SerialStream)>,
    lines_at: BTreeMap<String, String>,
    sinks: Sinks,
    ert_at: String,
    links: Vec<Link>,
}

impl Doors {
    async fn open(rig: &RigFile, options: &RigOptions) -> Result<Self, RunError> {
        let mut links = Vec::new();
        let (control, control_at) = listen(&options.control, false, None).await?;
        let (mut tcp, mut rtu, mut lines_at) = (Vec::new(), Vec::new(), BTreeMap::new());
        for (name, line) in &rig.lines {
            let at = match line {
                Line::ModbusTcp { address } => {
                    let (listener, at) = listen(address, options.ephemeral, None).await?;
                    tcp.push((name.clone(), listener));
                    at
                }
                Line::ModbusRtu { path } => {
                    let (master, at) = open_pty(path, options.ephemeral, &mut links)?;
                    rtu.push((name.clone(), master));
                    at
                }
            };
            lines_at.insert(name.clone(), at);
        }
        let (sinks, ert_at) = match &rig.ert.port {
            ErtPort::Tcp { address } => {
                let (listener, at) =
                    listen(address, options.ephemeral, Some(STREAM_BUFFER)).await?;
                let listener = listener.into_std().map_err(RunError::Start)?;
                (Sinks::Tcp { listener, clients: Vec::new() }, at)
            }
            ErtPort::Serial { path } => {
                let (master, at) = open_pty(path, options.ephemeral, &mut links)?;
                (Sinks::Pty(PtySink::new(master)), at)
            }
        };
        Ok(Self { control, control_at, tcp, rtu, lines_at, sinks, ert_at, links })
    }

    fn serve(self, lab: &Arc<Lab>) -> (JoinSet<()>, Sinks) {
        let mut wires = JoinSet::new();
        wires.spawn(control::serve(Arc::clone(lab), self.control));
        for (name, listener) in self.tcp {
            wires.spawn(wire::serve_tcp(Arc::clone(lab), name, listener));
        }
        for (name, master) in self.rtu {
            wires.spawn(wire::serve_rtu(Arc::clone(lab), name, master));
        }
        (wires, self.sinks)
    }
}

async fn listen(
    address: &str,
    ephemeral: bool,
    send_buffer: Option<u32>,
) -> Result<(TcpListener, String), RunError> {
    let failed = |source| RunError::Listen { address: address.to_owned(), source };
    let nothing = || failed(io::Error::new(io::ErrorKind::NotFound, "no such host"));
    // The addresses of a real bench do not belong to this machine.
    let address = if ephemeral { "127.0.0.1:0" } else { address };
    let mut found = lookup_host(address).await.map_err(failed)?;
    let at = found.next().ok_or_else(nothing)?;
    let open = || {
        let socket = if at.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
        socket.set_reuseaddr(true)?;
        if let Some(bytes) = send_buffer {
            socket.set_send_buffer_size(bytes)?;
        }
        socket.bind(at)?;
        let listener = socket.listen(BACKLOG)?;
        let at = listener.local_addr()?.to_string();
        Ok((listener, at))
    };
    open().map_err(failed)
}

/// Opens a pseudo-terminal; unless `ephemeral`, with a link to it at `path`.
fn open_pty(
    path: &str,
    ephemeral: bool,
    links: &mut Vec<Link>,
) -> Result<(SerialStream, String), RunError> {
    // The slave side is closed again, so that the master detects whether another process opens it.
    let (master, slave) = SerialStream::pair()?;
    let name = slave.name().ok_or_else(|| {
        RunError::Start(io::Error::new(io::ErrorKind::NotFound, "pseudo-terminal without a name"))
    })?;
    drop(slave);
    if ephemeral {
        return Ok((master, name));
    }
    let link = PathBuf::from(path);
    let at = |source| RunError::File { path: link.clone(), source };
    match std::fs::symlink_metadata(&link) {
        Ok(found) if found.file_type().is_symlink() => std::fs::remove_file(&link).map_err(at)?,
        Ok(_) => return Err(RunError::Occupied(link)),
        Err(_) => {}
    }
    std::os::unix::fs::symlink(&name, &link).map_err(at)?;
    links.push(Link(link));
    Ok((master, path.to_owned()))
}

/// Text of the rig file with the addresses, the clock rate and the label that are served.
fn served_rig(text: &str, doors: &Doors, speed: f64) -> Result<String, RunError> {
    let mut table: toml::Table = toml::from_str(text).unwrap_or_default();
    table.insert("clock_rate".into(), toml::Value::Float(speed));
    // Whatever rig is imitated: what a service measures on this one is virtual.
    table.insert("label".into(), toml::Value::String("virtual".into()));
    let set = |section: Option<&mut toml::Value>, at: &str| {
        if let Some(section) = section.and_then(toml::Value::as_table_mut) {
            let key = if section.contains_key("path") { "path" } else { "address" };
            section.insert(key.into(), toml::Value::String(at.to_owned()));
        }
    };
    for (name, at) in &doors.lines_at {
        set(table.get_mut("lines").and_then(|lines| lines.get_mut(name)), at);
    }
    set(table.get_mut("ert"), &doors.ert_at);
    Ok(toml::to_string(&table)?)
}
