//! What several tests need: the sensor, a folder and its files, commands, a service as a process, a false one, Python.

use std::collections::BTreeMap;
use std::fmt::Debug;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpListener;
use std::ops::Deref;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use palpate::digest::sha256_hex;
use serde_json::Value;
use sim_core::sensor::Sensor;
use tempfile::TempDir;

pub use crate::common::{
    Process, SENSOR, answered, database, execute, http, is_refused, left_out, serve_options,
    signal, skin_cache, until, with_extension, with_responses,
};

pub const PALPATE: &str = env!("CARGO_BIN_EXE_palpate");

/// Text of the virtual rig's file.
pub const VIRTUAL_RIG: &str = include_str!("../../experiments/rigs/virtual.toml");

/// The sensor of 28 electrodes.
pub fn sensor() -> Sensor {
    Sensor::from_toml(SENSOR).unwrap()
}

/// A folder in the system's temporary folder, removed at the end of its test.
pub struct Folder(TempDir);

impl Folder {
    /// Creates the folder, empty.
    pub fn new(name: &str) -> Self {
        Self(TempDir::with_prefix(format!("palpate-{name}-")).unwrap())
    }

    /// Path of a file in it, as an argument of a command.
    pub fn path(&self, name: &str) -> String {
        self.join(name).display().to_string()
    }
}

impl Deref for Folder {
    type Target = Path;

    fn deref(&self) -> &Path {
        self.0.path()
    }
}

/// Starts a service as a process; returns it with its URL.
pub fn served(serve: &mut Command) -> (Process, String) {
    let mut served = Process(serve.stdout(Stdio::piped()).spawn().unwrap());
    let mut output = BufReader::new(served.0.stdout.take().unwrap());
    let mut line = String::new();
    output.read_line(&mut line).unwrap();
    // The pipe stays open.
    served.0.stdout = Some(output.into_inner());
    let url = line.split_whitespace().find(|word| word.starts_with("http")).unwrap();
    let url = url.trim_end_matches(',').to_owned();
    (served, url)
}

/// A false service: `body` makes the answer of a request, whose first line it gets in lower case. Returns its URL.
pub fn false_service(body: impl Fn(&str) -> Value + Send + 'static) -> String {
    let door = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}", door.local_addr().unwrap());
    std::thread::spawn(move || {
        for wire in door.incoming() {
            let mut wire = BufReader::new(wire.unwrap());
            let lines = wire.by_ref().lines().map(|line| line.unwrap().to_lowercase());
            let head: Vec<String> = lines.take_while(|line| !line.is_empty()).collect();
            let Some(first) = head.first() else { continue };
            let length = head.iter().find_map(|line| line.strip_prefix("content-length: "));
            let mut sent = vec![0; length.map_or(0, |length| length.parse().unwrap())];
            wire.read_exact(&mut sent).unwrap();
            let body = body(first).to_string();
            let head = "HTTP/1.1 200 OK\r\nconnection: close\r\ncontent-type: application/json";
            let answer = format!("{head}\r\ncontent-length: {}\r\n\r\n{body}", body.len());
            wire.get_mut().write_all(answer.as_bytes()).unwrap();
        }
    });
    url
}

/// A command of the program, without the environment of the tests.
pub fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(PALPATE);
    for name in ["URL", "CA", "KEY", "KEY_FILE", "DATA"] {
        command.env_remove(format!("PALPATE_{name}"));
    }
    command.args(arguments).stdin(Stdio::null());
    command
}

/// Runs a command to its end, while the test's own service answers it.
pub async fn finished(mut command: Command) -> Output {
    tokio::task::spawn_blocking(move || command.output()).await.unwrap().unwrap()
}

/// What a Python script of this folder prints; it must succeed.
pub async fn printed(python: String, script: &str, arguments: &[&Path]) -> String {
    let mut command = Command::new(python);
    command.env("PYTHONDONTWRITEBYTECODE", "1");
    command.arg(format!("{}/tests/it/{script}", env!("CARGO_MANIFEST_DIR"))).args(arguments);
    succeeded(&finished(command).await)
}

/// Standard output of a command that must succeed.
pub fn succeeded(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// The last line of a command that must succeed, JSON.
pub fn done(output: &Output) -> Value {
    serde_json::from_str(succeeded(output).lines().last().unwrap()).unwrap()
}

/// A command that must be refused with this exit code, in these words.
pub fn not_done(output: &Output, code: i32, words: &str) {
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(code) && said.contains(words), "{words}: {said}");
}

/// Waits until a value is there.
pub async fn eventually<T: Debug>(
    what: &str,
    limit: Duration,
    look: impl AsyncFnMut() -> Option<T>,
) -> T {
    until(what, limit, look, Option::is_some).await.unwrap()
}

pub fn copy_folder(from: &Path, to: &Path) {
    assert!(Command::new("cp").arg("-r").arg(from).arg(to).status().unwrap().success());
}

/// Name and sha256 of every file of a folder and of those below, in order.
pub fn files(folder: &Path) -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if path.is_dir() {
            found.extend(files(&path).into_iter().map(|(of, sha)| (format!("{name}/{of}"), sha)));
        } else {
            found.insert(name.to_owned(), sha256_hex(std::fs::read(&path).unwrap()));
        }
    }
    found
}

/// A Python that can import these modules (`PALPATE_PYTHON`, otherwise `python3`). Without one the test
/// is left out.
pub fn python(modules: &str) -> Option<String> {
    let python = std::env::var("PALPATE_PYTHON").unwrap_or_else(|_| "python3".into());
    let found = Command::new(&python)
        .args(["-c", &format!("import {modules}")])
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success());
    if found {
        return Some(python);
    }
    left_out(&format!("no Python that has {modules} (set PALPATE_PYTHON)"))
}
