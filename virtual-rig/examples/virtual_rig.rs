//! The rig as a separate process:
//! `cargo run -p virtual-rig --example virtual_rig -- --rig FILE ..`.
//! Uses: the crate's entry point. Never: the service.

use clap::Parser;
use virtual_rig::{RigArgs, RunError, rig_main};

#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    args: RigArgs,
}

fn main() -> Result<(), RunError> {
    rig_main(Cli::parse().args)
}
