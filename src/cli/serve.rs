//! `palpate serve`: the service until a signal ends it; without a rig file with a virtual bench.
//! Uses: `api`, `virtual_bench`, `browser`, and `client` and `trust` for the name of a service that has its port. Never:
//! anything else that a client could do.

use std::io::{ErrorKind, IsTerminal};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use sd_notify::NotifyState;

use super::bench_args::BenchArgs;
use super::browser;
use super::client::{Client, Found};
use super::data_or_default;
use super::embed::TWIN_WORKERS;
use super::error::{CliError, CliResult};
use super::files::{RigFiles, parse_calibration, read_sensor};
use super::key::key;
use super::output::{note, say};
use super::progress::shown_wait;
use super::running::Running;
use super::signals::{Asked, Signals};
use super::trust::Certificates;
use super::virtual_bench::VirtualBench;
use crate::api::{ServeError, ServeOptions, Service, Tls};
use crate::conductor::AutoResume;
use crate::state::StoredState;

/// Longest wait for the status of a service that has the port of another one, after it answered a probe.
const HOLDER_WAIT: Duration = Duration::from_secs(5);

/// Options of `serve`.
#[derive(Debug, Clone, Args)]
pub struct ServeArgs {
    /// Address to listen on.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8080")]
    pub bind: SocketAddr,
    /// Folder of the database [env: PALPATE_DATA] [default: palpate-data].
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    #[command(flatten)]
    pub bench: BenchArgs,
    /// Open the page in the browser.
    #[arg(long)]
    pub open: bool,
    /// Certificate of the service, PEM, for https; with --tls-key.
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    pub tls_cert: Option<PathBuf>,
    /// Private key of the certificate, PEM.
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    pub tls_key: Option<PathBuf>,
    /// Demand a key from callers on this machine, too; the emergency stop needs none there. The virtual
    /// operator's is in PALPATE_KEY.
    #[arg(long)]
    pub require_key: bool,
    /// Let callers on this machine make and revoke keys without having one.
    #[arg(long, conflicts_with = "require_key")]
    pub local_admin: bool,
    /// Do not resume interrupted runs automatically.
    #[arg(long)]
    pub no_resume: bool,
    /// Calibration for simulated twins [default: the sensor file's values].
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// Sensor file of the skin under the rig, or the name of a carried one [default: ert-28].
    #[arg(long, value_name = "FILE")]
    pub sensor: Option<PathBuf>,
    /// Number of threads that compute simulated twins; 0 for none.
    #[arg(long, value_name = "N", default_value_t = TWIN_WORKERS)]
    pub twin_workers: usize,
    /// Leave the terminal: the service continues when it is closed.
    #[arg(long, hide = true)]
    pub own_session: bool,
    /// Read and compute only, without a rig.
    #[arg(long)]
    pub desk: bool,
}

/// Runs `palpate serve`.
///
/// # Errors
/// `CliError` if a file is invalid, or the virtual bench or the service cannot start.
pub async fn serve(args: ServeArgs) -> CliResult<()> {
    args.bench.check()?;
    if args.own_session {
        let left = rustix::process::setsid().map_err(std::io::Error::from);
        left.map_err(CliError::system("leaving the terminal"))?;
    }
    let mut signals = Signals::catch()?;
    let rig = RigFiles::read(args.bench.rig.as_deref())?;
    if args.desk || !args.bench.is_virtual() {
        return serve_rig(&args, rig, None, &mut signals).await;
    }
    let (_, sensor_text) = read_sensor(args.sensor.as_deref())?;
    let data = data_or_default(args.data.clone());
    let mut bench = tokio::select! {
        bench = VirtualBench::switch_on(&args.bench, &data, &rig, &sensor_text) => bench?,
        _ = signals.next() => return Ok(()),
    };
    let served = serve_rig(&args, bench.rig.clone(), Some(&mut bench), &mut signals).await;
    bench.switch_off().await;
    served
}

/// Runs the service on a rig until a signal; `bench`: the virtual one behind this rig.
async fn serve_rig(
    args: &ServeArgs,
    rig: RigFiles,
    bench: Option<&mut VirtualBench>,
    signals: &mut Signals,
) -> CliResult<()> {
    let (sensor, sensor_text) = read_sensor(args.sensor.as_deref())?;
    let tls = args.tls_cert.clone().zip(args.tls_key.clone());
    let tls = tls.map(|(certificate, key)| Tls { certificate, key });
    let options = ServeOptions {
        tls: tls.clone(),
        require_key: args.require_key,
        desk: args.desk,
        idle: false,
        bind: args.bind,
        local_admin: args.local_admin,
        data: data_or_default(args.data.clone()),
        in_place: None,
        rig_file: rig.file,
        rig_text: rig.text,
        // At a desk there is no rig to resume on, but a person may hold the runs: none resumes afterwards, either.
        resume: if args.no_resume || args.desk { AutoResume::Off } else { AutoResume::Allowed },
        twin_workers: args.twin_workers,
        calibration: args.calibration.as_deref().map(parse_calibration).transpose()?,
        sensor,
        sensor_text,
    };
    let data = options.data.clone();
    let start = Service::start(options);
    // Elsewhere the first line that it prints states that it listens.
    let started = match std::io::stderr().is_terminal() {
        true => shown_wait("opening the data folder", start).await,
        false => start.await,
    };
    let service = match started {
        Err(ServeError::Bind { bind, source }) if source.kind() == ErrorKind::AddrInUse => {
            return Err(taken(bind, tls.as_ref()).await);
        }
        started => started?,
    };
    announce(&data, &service, tls.as_ref());
    let operator = bench.map_or(Ok(()), |bench| send_operator(args, bench, &service));
    if operator.is_ok() {
        let (url, name, label) = (service.url(), rig.config.name(), rig.config.label().as_str());
        let (version, folder) = (env!("CARGO_PKG_VERSION"), data.display());
        let rig = if args.desk { "no rig".into() } else { format!("rig {name} ({label})") };
        say(format_args!("palpate {version} at {url}, data in {folder}, {rig}"));
        // Units that are ordered after this one begin now.
        if let Err(error) = sd_notify::notify(&[NotifyState::Ready]) {
            tracing::warn!(%error, "systemd does not know that the service is ready");
        }
        if args.open {
            browser::open(&service.local_url());
        }
        let asked = signals.next().await;
        if let Some(run) = service.active_run() {
            // A manual run moves nothing; of a paused one the tips are up, or an e-stop holds them.
            let raises = !run.is_manual && run.state != StoredState::Paused;
            let words = ending_words(run.scan_id, raises, asked);
            // Neither a terminal that takes no text nor a system without threads must delay the end.
            let _ = std::thread::Builder::new().spawn(move || note(words));
        }
    }
    service.shutdown().await;
    Running::remove(&data);
    operator
}

/// What the end of the service does to the active run, and how the run resumes. `raises`: it raises the tips.
fn ending_words(scan_id: i64, raises: bool, asked: Asked) -> String {
    let raises = if raises { "raises the tips and " } else { "" };
    let again = match asked {
        Asked::Interrupt => "; Ctrl-C again changes nothing",
        Asked::Terminate | Asked::HangUp => "",
    };
    format!(
        "the service {raises}leaves run {scan_id} to be resumed: the next `palpate serve` resumes it or states why not, \
         and then `palpate resume {scan_id}` does{again}"
    )
}

/// Starts the virtual operator, if it can reach the service.
fn send_operator(args: &ServeArgs, bench: &mut VirtualBench, service: &Service) -> CliResult<()> {
    let needs_key = args.require_key || !args.bind.ip().is_loopback();
    let key = if needs_key { key()? } else { None };
    match without_operator(args.tls_cert.is_some(), needs_key && key.is_none()) {
        Some(cause) => {
            note(format_args!("no virtual operator: {cause}; a person must mount tips"));
            Ok(())
        }
        None => bench.send_operator(&service.local_url(), key.as_deref()),
    }
}

/// The error of an address at which another program listens: which one, if it answers as this service does. It is sent
/// no key, since it may be any program. `tls`: the files of this service; one on the same machine may have the same.
async fn taken(bind: SocketAddr, tls: Option<&Tls>) -> CliError {
    let local: SocketAddr = match bind.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => (Ipv4Addr::LOCALHOST, bind.port()).into(),
        IpAddr::V6(ip) if ip.is_unspecified() => (Ipv6Addr::LOCALHOST, bind.port()).into(),
        _ => bind,
    };
    let own = tls.and_then(|tls| Certificates::read(&tls.certificate).ok());
    let (plain, secure) = (format!("http://{local}"), format!("https://{local}"));
    // At the same time: a program that answers neither is waited for once.
    let (plain, secure) = tokio::join!(holder(&plain, None), holder(&secure, own.as_ref()));
    let by = plain.or(secure);
    let by = by.unwrap_or_else(|| "a program that does not answer as palpate over HTTP".into());
    CliError::PortTaken { bind, by, free: SocketAddr::new(bind.ip(), 0) }
}

/// The service at a URL, with its database if it states it; `None` if no palpate answers. `ca`: certificates that are
/// trusted instead of those of the system.
async fn holder(url: &str, ca: Option<&Certificates>) -> Option<String> {
    let client = Client::new(url, ca, None).ok()?.patient(HOLDER_WAIT);
    match client.look().await {
        Ok(Found::Palpate) => {}
        Err(CliError::Untrusted { .. }) => {
            let asks = format!("`palpate status --url {url} --ca FILE` asks whether it is palpate");
            return Some(format!("a program with TLS whose certificate is not trusted ({asks})"));
        }
        Ok(Found::Stranger | Found::Nothing) | Err(_) => return None,
    }
    let database = client.status().await.ok().map(|status| status.service.database);
    let of = database.map_or_else(String::new, |database| format!(" of {database}"));
    Some(format!("the palpate service{of} ({url})"))
}

/// Why the virtual operator cannot reach the service; `None` if it can.
fn without_operator(secure: bool, lacks_key: bool) -> Option<&'static str> {
    match (secure, lacks_key) {
        (true, _) => Some("it has no TLS"),
        (false, true) => Some("it needs the key of an operator, in PALPATE_KEY of the service"),
        (false, false) => None,
    }
}

/// Writes where commands on this machine find the service.
fn announce(data: &Path, service: &Service, tls: Option<&Tls>) {
    let certificate = tls.map(|Tls { certificate, .. }| std::fs::read_to_string(certificate));
    let written = certificate.transpose().and_then(|certificate| {
        let process = std::process::id().cast_signed();
        Running { url: service.local_url(), process, certificate }.write(data)
    });
    if let Err(error) = written {
        tracing::warn!(%error, "commands on this machine need --url and --ca");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_service_that_the_virtual_operator_cannot_reach_has_none() {
        assert_eq!(without_operator(false, false), None);
        assert_eq!(without_operator(true, false), Some("it has no TLS"));
        assert!(without_operator(false, true).unwrap().contains("PALPATE_KEY"));
    }

    #[test]
    fn a_service_that_ends_states_what_becomes_of_its_run() {
        let words = ending_words(3, true, Asked::Interrupt);
        let wanted = "the service raises the tips and leaves run 3 to be resumed: the next `palpate serve` resumes it \
                      or states why not, and then `palpate resume 3` does; Ctrl-C again changes nothing";
        assert_eq!(words, wanted);
        let words = ending_words(3, false, Asked::Terminate);
        assert!(!words.contains("tips") && !words.contains("Ctrl-C"), "{words}");
    }
}
