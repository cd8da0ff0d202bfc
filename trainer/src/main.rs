//! The program `palpate-trainer FOLDER`: carries out the order in a job's folder.
//! Uses: `palpate_trainer`. Never: anything else.

use std::io::{Write, stderr, stdout};
use std::path::Path;
use std::process::ExitCode;

use palpate_touch::learn::order::ORDER_VERSION;

const USAGE: &str = "palpate-trainer FOLDER\n\
    Trains a net: carries out FOLDER/order.json, and reports one JSON object per line.\n\
    palpate starts it for each training; a line `stop` or the end of standard input ends it.";

fn main() -> ExitCode {
    let arguments: Vec<_> = std::env::args_os().skip(1).collect();
    match arguments.as_slice() {
        // A closed pipe is no error.
        [flag] if flag == "--version" => {
            drop(writeln!(stdout(), "palpate-trainer {ORDER_VERSION}"))
        }
        [flag] if flag == "--help" => drop(writeln!(stdout(), "{USAGE}")),
        [folder] => return palpate_trainer::job::carry_out(Path::new(folder)),
        _ => {
            drop(writeln!(stderr(), "{USAGE}"));
            return ExitCode::from(2);
        }
    }
    ExitCode::SUCCESS
}
