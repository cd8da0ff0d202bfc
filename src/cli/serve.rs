//! `palpate serve`: the service until a signal ends it.
//! Uses: `api`. Never: anything that a client could do.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use clap::Args;

use super::data_or_default;
use super::embed::TWIN_WORKERS;
use super::error::CliError;
use super::files::{RigFiles, parse_calibration, read_sensor_text};
use super::follow::Signals;
use super::output::say;
use super::running::Running;
use crate::api::{ServeOptions, Service, Tls};

/// Options of `serve`.
#[derive(Debug, Clone, Args)]
pub struct ServeArgs {
    /// Address to listen on.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8080")]
    pub bind: SocketAddr,
    /// Folder of the database [env: PALPATE_DATA] [default: palpate-data].
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Rig file [default: the virtual rig].
    #[arg(long, value_name = "FILE")]
    pub rig: Option<PathBuf>,
    /// Certificate of the service, PEM, for https; with --tls-key.
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    pub tls_cert: Option<PathBuf>,
    /// Private key of the certificate, PEM.
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    pub tls_key: Option<PathBuf>,
    /// Demand a key from callers on this machine, too; the emergency stop needs none there.
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
    /// Sensor file of the skin under the rig, for live answers [default: ert-28].
    #[arg(long, value_name = "FILE")]
    pub sensor: Option<PathBuf>,
    /// Number of threads that compute simulated twins; 0 for none.
    #[arg(long, value_name = "N", default_value_t = TWIN_WORKERS)]
    pub twin_workers: usize,
}

/// Runs `palpate serve`.
///
/// # Errors
/// `CliError` if a file is invalid, or the service cannot start.
pub async fn serve(args: ServeArgs) -> Result<(), CliError> {
    let rig = RigFiles::read(args.rig.as_deref())?;
    let mut signals = Signals::catch()?;
    let (sensor, sensor_text) = read_sensor_text(args.sensor.as_deref())?;
    let tls = args.tls_cert.zip(args.tls_key);
    let tls = tls.map(|(certificate, key)| Tls { certificate, key });
    let options = ServeOptions {
        tls: tls.clone(),
        require_key: args.require_key,
        bind: args.bind,
        local_admin: args.local_admin,
        data: data_or_default(args.data),
        rig_file: rig.file,
        rig_text: rig.text,
        resume: !args.no_resume,
        twin_workers: args.twin_workers,
        calibration: args.calibration.as_deref().map(parse_calibration).transpose()?,
        sensor,
        sensor_text,
    };
    let data = options.data.clone();
    let service = Service::start(options).await?;
    announce(&data, &service, tls.as_ref());
    let (url, name) = (service.url(), rig.config.name().to_owned());
    let (version, folder) = (env!("CARGO_PKG_VERSION"), data.display());
    say(format_args!("palpate {version} at {url}, data in {folder}, rig {name}"));
    service
        .run_until(async {
            let _ = signals.next().await;
        })
        .await;
    Running::remove(&data);
    Ok(())
}

/// Writes where commands on this machine find a service with TLS; removes what an earlier one left.
fn announce(data: &Path, service: &Service, tls: Option<&Tls>) {
    let Some(Tls { certificate, .. }) = tls else {
        return Running::remove(data);
    };
    let written = std::fs::read_to_string(certificate)
        .and_then(|certificate| Running { url: service.local_url(), certificate }.write(data));
    if let Err(error) = written {
        tracing::warn!(%error, "commands on this machine need --url and --ca");
    }
}
