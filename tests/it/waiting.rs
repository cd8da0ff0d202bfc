//! A command whose service answers late names what it waits for.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpListener;
use std::process::Stdio;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use crate::support::command;

/// Longest wait of the service for the command's words.
const WORDS_WITHIN: Duration = Duration::from_secs(60);

/// A service without runs, which answers all but the probe only once it is `released`.
fn service(released: mpsc::Receiver<()>) -> String {
    let door = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}", door.local_addr().unwrap());
    thread::spawn(move || {
        for wire in door.incoming() {
            let (mut wire, mut head) = (wire.unwrap(), Vec::new());
            while !head.ends_with(b"\r\n\r\n") {
                let mut byte = [0];
                if wire.read(&mut byte).unwrap() == 0 {
                    break;
                }
                head.push(byte[0]);
            }
            let body = match head.starts_with(b"GET /health/live") {
                true => r#"{"service":"palpate"}"#,
                false => {
                    released.recv_timeout(WORDS_WITHIN).ok();
                    r#"{"items":[]}"#
                }
            };
            let length = body.len();
            let answer = format!(
                "HTTP/1.1 200 OK\r\nconnection: close\r\ncontent-type: application/json\r\n\
                 content-length: {length}\r\n\r\n{body}"
            );
            wire.write_all(answer.as_bytes()).unwrap();
        }
    });
    url
}

#[test]
fn a_command_whose_service_answers_late_names_what_it_waits_for() {
    let (release, released) = mpsc::channel();
    let url = service(released);
    let mut process = command(&["runs", "--url", &url])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut shown = BufReader::new(process.stderr.take().unwrap()).lines().map(Result::unwrap);
    let named = shown.any(|line| line.contains("waiting for the service"));
    drop(release);
    assert!(named && process.wait().unwrap().success());
}
