//! A transcript as a file of `tests/transcripts/`, and the device's part in it, played on an in-memory
//! wire.
//! Uses: `rig::link`. Never: a driver.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use palpate::clock::Clock;
use palpate::rig::link::{Framing, Line, LinePolicy, Opener, Port};
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

use crate::support::with_extension;

/// Process time runs fast, so that a transcript's axis may be anywhere at its next status.
pub const RATE: f64 = 1e5;
/// The longest that a whole transcript may take.
pub const LIMIT: Duration = Duration::from_secs(20);

#[derive(Debug)]
pub enum Step {
    Sent(Vec<u8>),
    Answer(Vec<u8>),
    Waiting(Vec<u8>),
    Close,
    Reopen,
}

/// Files of a folder of the checkout with this extension: name and text, by name.
pub fn files(folder: &str, extension: &str) -> Vec<(String, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let named = |path: PathBuf| {
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        (name, std::fs::read_to_string(path).unwrap())
    };
    with_extension(&folder, extension).into_iter().map(named).collect()
}

/// The device's steps of a transcript.
pub fn steps(name: &str, text: &str) -> VecDeque<Step> {
    let lines = text.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with(['#', ':']));
    lines
        .map(|line| {
            let (mark, rest) = line.split_once(' ').unwrap();
            let bytes =
                || rest.split_whitespace().map(|b| u8::from_str_radix(b, 16).unwrap()).collect();
            match (mark, rest) {
                (">", _) => Step::Sent(bytes()),
                ("<", _) => Step::Answer(bytes()),
                ("!", _) => Step::Waiting(bytes()),
                ("=", "close") => Step::Close,
                ("=", "reopen") => Step::Reopen,
                other => panic!("{name}: {other:?}"),
            }
        })
        .collect()
}

pub fn read(name: &str) -> VecDeque<Step> {
    let path = format!("{}/tests/transcripts/{name}", env!("CARGO_MANIFEST_DIR"));
    steps(name, &std::fs::read_to_string(path).unwrap())
}

/// The device's side: plays its part and reports exchanges that remain at the end.
async fn play(mut steps: VecDeque<Step>, mut wires: mpsc::Receiver<DuplexStream>) {
    let mut wire = wires.recv().await.expect("the driver opens its wire");
    while let Some(step) = steps.pop_front() {
        match step {
            Step::Sent(expected) => {
                let mut sent = vec![0; expected.len()];
                wire.read_exact(&mut sent).await.expect("the driver sends");
                assert_eq!(hex(&sent), hex(&expected), "with {} steps to go", steps.len());
            }
            Step::Answer(bytes) | Step::Waiting(bytes) => wire.write_all(&bytes).await.unwrap(),
            Step::Close => {
                drop(wire);
                wire = wires.recv().await.expect("the driver opens its wire again");
            }
            Step::Reopen => {
                let mut rest = Vec::new();
                wire.read_to_end(&mut rest).await.unwrap();
                assert_eq!(hex(&rest), "", "sent before the wire was opened again");
                wire = wires.recv().await.expect("the driver opens its wire again");
            }
        }
    }
    let more = tokio::time::timeout(Duration::from_millis(20), wire.read_u8()).await;
    assert!(!matches!(more, Ok(Ok(_))), "the driver sends more than the transcript holds");
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02X}")).collect::<Vec<_>>().join(" ")
}

/// A wire with the device of these steps at its end, and the device.
pub fn line(steps: VecDeque<Step>, framing: Framing) -> (Arc<Line>, JoinHandle<()>) {
    let (wires_in, wires) = mpsc::channel(4);
    let opener: Opener = Box::new(move || {
        let wires = wires_in.clone();
        Box::pin(async move {
            let (ours, theirs) = tokio::io::duplex(1024);
            wires.send(theirs).await.map_err(|_| std::io::ErrorKind::ConnectionRefused)?;
            Ok(Box::new(ours) as Box<dyn Port>)
        })
    });
    let policy = LinePolicy {
        timeout: Duration::from_millis(150),
        attempts: 3,
        silence: Duration::ZERO,
        stop_grace: Duration::from_millis(15),
    };
    let device = tokio::spawn(play(steps, wires));
    let line = Line::spawn(framing, "port", opener, policy, Clock::new(RATE));
    (Arc::new(line), device)
}
