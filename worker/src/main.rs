//! The program `palpate-worker`: its commands are in `palpate_worker::options`.
//! Uses: `palpate_worker`. Never: a secret in what it prints.

use std::io::{IsTerminal, Write, stderr};
use std::process::ExitCode;

use clap::Parser;
use palpate_worker::options::Options;
use tracing_subscriber::EnvFilter;

/// The log without PALPATE_LOG: what the queue reports of each job stays out.
const LOG: &str = "warn,palpate_worker=info";

fn main() -> ExitCode {
    let options = Options::parse();
    let filter = EnvFilter::try_from_env("PALPATE_LOG").unwrap_or_else(|_| EnvFilter::new(LOG));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(stderr)
        .with_ansi(stderr().is_terminal())
        // The report of a failed write would go to the closed terminal, too, and panic.
        .log_internal_errors(false)
        .init();
    // A second provider could only have been installed before.
    drop(rustls::crypto::ring::default_provider().install_default());
    let runtime = match tokio::runtime::Builder::new_multi_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => {
            drop(writeln!(stderr(), "error: starting threads: {error}"));
            return ExitCode::FAILURE;
        }
    };
    let ended = runtime.block_on(options.run());
    // A DNS query or a write of a slow disk may still run.
    runtime.shutdown_background();
    match ended {
        Ok(code) => code,
        Err(error) => {
            drop(writeln!(stderr(), "error: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}
