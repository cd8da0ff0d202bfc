//! `palpate simulate` as a process: lines in and out, what it refuses, what it writes.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use crate::support::{PALPATE, succeeded, with_responses};

const ONE: &str = r#"{"contacts":[{"x_mm":265.6698729810778,"y_mm":280,"force_n":20}]}"#;
const NONE: &str = r#"{"contacts":[]}"#;

fn data() -> PathBuf {
    let data = Path::new(env!("CARGO_TARGET_TMPDIR")).join("simulate");
    with_responses(&data);
    data
}

fn start(arguments: &[&str]) -> Child {
    Command::new(PALPATE)
        .arg("simulate")
        .args(arguments)
        .env("PALPATE_DATA", data())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// Answers to a whole input.
fn simulate(arguments: &[&str], input: &str) -> Output {
    let mut process = start(arguments);
    let mut stdin = process.stdin.take().unwrap();
    // The process may leave before it has read everything.
    stdin.write_all(input.as_bytes()).ok();
    drop(stdin);
    process.wait_with_output().unwrap()
}

fn voltages(line: &str) -> Vec<f64> {
    let answer: serde_json::Value = serde_json::from_str(line).unwrap();
    answer["voltages_v"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

fn frames(output: &Output) -> Vec<Vec<f64>> {
    succeeded(output).lines().map(voltages).collect()
}

fn size(frame: &[f64]) -> f64 {
    frame.iter().map(|v| v * v).sum::<f64>().sqrt()
}

#[test]
fn each_line_is_answered_before_the_next_one_is_sent() {
    let mut process = start(&[]);
    let mut stdin = process.stdin.take().unwrap();
    let mut answers = BufReader::new(process.stdout.take().unwrap()).lines();
    let mut found = Vec::new();
    for line in [NONE, ONE, NONE] {
        writeln!(stdin, "{line}").unwrap();
        found.push(voltages(&answers.next().unwrap().unwrap()));
    }
    drop(stdin);
    assert!(process.wait().unwrap().success());
    assert!(answers.next().is_none());
    assert!(found.iter().all(|f| f.len() == 784 && f.iter().all(|v| v.is_finite())));
    assert_eq!(found[0], found[2]);
    assert!(size(&found[1]) > 10.0 * size(&found[0]), "a press is seen");
}

#[test]
fn a_line_that_cannot_be_used_ends_the_command_and_is_named() {
    for (bad, words) in [
        (ONE.replace("265.6698729810778", "3"), "contacts[0].x_mm = 3: must be from 10 to 530 mm"),
        (ONE.replace(":20", ":-2"), "contacts[0].force_n = -2: must be from 0 to 1000 N"),
        (ONE.replace(":20", ":NaN"), "contacts[0].force_n = NaN: expected value"),
        (ONE[..40].into(), "the line is cut off after column 40"),
        (
            ONE.replace("y_mm", "y"),
            "contacts[0].y = \"y\": unknown key; the unit is part of the name: y_mm",
        ),
    ] {
        let output = simulate(&["--contacts", "-"], &format!("{NONE}\n{bad}\n{NONE}\n"));
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        // The first command of all tests solves the skin, and names that.
        let error = &told[told.find("error: ").unwrap()..];
        assert!(error.starts_with(&format!("error: standard input line 2: {words}")), "{told}");
        assert_eq!(output.status.code(), Some(2), "{told}");
        let answers = String::from_utf8_lossy(&output.stdout).lines().count();
        assert_eq!(answers, 1, "line 1 is answered");
    }
    let seven = format!("{{\"contacts\":[{}]}}\n", [&ONE[13..ONE.len() - 2]; 7].join(","));
    let told = String::from_utf8(simulate(&[], &seven).stderr).unwrap();
    let words = "contacts = 7 contacts: must be at most 6 contacts";
    assert_eq!(told, format!("error: standard input line 1: {words}\n"));
    assert_eq!(frames(&simulate(&["--max-contacts", "7"], &seven)).len(), 1);
}

#[test]
fn a_missing_file_and_a_second_trial_to_export_are_refused() {
    let output = simulate(&["--contacts", "none.jsonl"], "");
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).starts_with("error: none.jsonl: "));
    let picture = data().join("never.svg");
    let output = simulate(&["--picture", picture.to_str().unwrap()], &format!("{NONE}\n{NONE}\n"));
    assert_eq!(output.status.code(), Some(2));
    assert!(!picture.exists());
}

#[test]
fn a_trial_is_written_as_netlist_deck_and_picture() {
    let folder = data().join("written");
    let [netlist, deck, picture] =
        ["trial.cir", "trial.inp", "trial.svg"].map(|n| folder.join(n).display().to_string());
    let arguments =
        ["--spice", &netlist, "--inject", "27", "--calculix", &deck, "--picture", &picture];
    let frame = frames(&simulate(&arguments, ONE));
    assert_eq!(frame, frames(&simulate(&[], ONE)), "the answer is the same");

    let netlist = std::fs::read_to_string(&netlist).unwrap();
    assert!(netlist.starts_with("* 1 contact, 20.0 N; model sim-"));
    assert!(netlist.contains("\nVsink e27 0 DC 0\n") && netlist.ends_with(".op\n.end\n"));
    assert_eq!(netlist.matches("\nRf").count(), 3503);

    let deck = std::fs::read_to_string(&deck).unwrap();
    assert_eq!(deck.matches(", 3, -3.333333333333e0\n").count(), 6, "six equal point forces");

    let picture = std::fs::read_to_string(&picture).unwrap();
    assert!(picture.starts_with("<svg ") && picture.ends_with("</svg>\n"));
    assert!(picture.contains(">20 N</text>") && picture.contains("5 times as large"));
    assert_eq!(picture.matches("<g ").count(), picture.matches("</g>").count());
    std::fs::remove_dir_all(&folder).unwrap();

    let output = simulate(&["--spice", "x.cir", "--inject", "28"], ONE);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(told, "error: inject = 28: must be from 0 to 27\n");
}
