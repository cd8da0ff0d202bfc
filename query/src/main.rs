//! The program `palpate-query`: evaluates the statement that it reads from standard input.
//! Uses: `palpate_query`. Never: anything else.

use std::io::{Write, stderr, stdout};
use std::process::ExitCode;

use palpate_words::query_lines::LINES_VERSION;

const USAGE: &str = "palpate-query\n\
    Evaluates a SELECT statement over Parquet files. palpate starts it for each query, and names the\n\
    files in lines of JSON on standard input; the result goes to standard output.";

fn main() -> ExitCode {
    let arguments: Vec<_> = std::env::args_os().skip(1).collect();
    match arguments.as_slice() {
        [] => return palpate_query::talk::serve(),
        // A closed pipe is no error.
        [flag] if flag == "--version" => drop(writeln!(stdout(), "palpate-query {LINES_VERSION}")),
        [flag] if flag == "--help" => drop(writeln!(stdout(), "{USAGE}")),
        _ => {
            drop(writeln!(stderr(), "{USAGE}"));
            return ExitCode::from(2);
        }
    }
    ExitCode::SUCCESS
}
