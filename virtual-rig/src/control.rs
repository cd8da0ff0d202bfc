//! The control socket for operators and tests, with one JSON object per line.
//! Uses: `lab`, `fault`. Never: Modbus; nothing here is possible over the wires of a real rig.
//!
//! `{"cmd":"mount","tips":4}` (with `"powered":6` the cells of arms 5 and 6 stay connected),
//! `{"cmd":"place","weights":[{"x_mm":..,"y_mm":..,"force_n":..}]}`,
//! `{"cmd":"clear"}` (removes the weights), `{"cmd":"fault","kind":..}` (as in a script; without a
//! start it begins immediately), `{"cmd":"mend"}` (removes all faults), `{"cmd":"status"}`,
//! `{"cmd":"clear_peaks"}` (resets the largest force and the deepest z). The reply is
//! `{"ok":true,..}` or
//! `{"ok":false,"error":".."}`.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use serde::Deserialize;
use serde_json::{Value, json};
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;

use crate::bench::Weight;
use crate::fault;
use crate::lab::Lab;

/// Longest accepted line, bytes.
const LINE_MAX: u64 = 64 * 1024;
/// Largest number of simultaneous connections.
const CONNECTIONS_MAX: usize = 32;
/// Pause after a failed accept.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

#[derive(Debug, Deserialize)]
#[serde(tag = "cmd", rename_all = "snake_case")]
enum Command {
    Mount { tips: usize, powered: Option<usize> },
    Place { weights: Vec<Weight> },
    Clear,
    Mend,
    ClearPeaks,
    Status,
}

/// Serves the control socket until the task is aborted.
pub async fn serve(lab: Arc<Lab>, listener: TcpListener) {
    let seats = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            tokio::time::sleep(ACCEPT_PAUSE).await;
            continue;
        };
        let Ok(seat) = Arc::clone(&seats).try_acquire_owned() else { continue };
        let lab = Arc::clone(&lab);
        tokio::spawn(async move {
            if let Err(error) = converse(&lab, stream).await {
                tracing::debug!(%error, "control connection ended");
            }
            drop(seat);
        });
    }
}

async fn converse(lab: &Lab, mut stream: TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let (reader, mut writer) = stream.split();
    let mut reader = BufReader::new(reader);
    loop {
        let mut line = String::new();
        if (&mut reader).take(LINE_MAX).read_line(&mut line).await? == 0 {
            return Ok(());
        }
        let mut reply = answer(lab, &line).to_string();
        reply.push('\n');
        writer.write_all(reply.as_bytes()).await?;
    }
}

/// Returns the reply to one line.
fn answer(lab: &Lab, line: &str) -> Value {
    match carry_out(lab, line) {
        Ok(mut reply) => {
            if let Value::Object(fields) = &mut reply {
                fields.insert("ok".into(), Value::Bool(true));
            }
            reply
        }
        Err(error) => json!({ "ok": false, "error": error }),
    }
}

/// Executes a command. The error is the text of the reply.
fn carry_out(lab: &Lab, line: &str) -> Result<Value, String> {
    let mut object: Value = serde_json::from_str(line).map_err(|e| e.to_string())?;
    if object.get("cmd").and_then(Value::as_str) == Some("fault") {
        if let Some(fields) = object.as_object_mut() {
            fields.remove("cmd");
        }
        let fault = fault::from_json(object, &lab.rig).map_err(|e| e.to_string())?;
        let mut bench = lab.bench();
        bench.advance(lab.clock.process_s());
        bench.add_fault(fault);
        return Ok(json!({}));
    }
    let command: Command = serde_json::from_value(object).map_err(|e| e.to_string())?;
    let mut bench = lab.bench();
    bench.advance(lab.clock.process_s());
    match command {
        Command::Mount { tips, powered } => {
            bench.mount(tips, powered).map_err(|e| e.to_string())?;
            Ok(json!({ "tips": tips, "powered": powered.unwrap_or(tips) }))
        }
        Command::Place { weights } => {
            let count = weights.len();
            bench.place(weights).map_err(|e| e.to_string())?;
            Ok(json!({ "weights": count }))
        }
        Command::Clear => {
            bench.place(Vec::new()).map_err(|e| e.to_string())?;
            Ok(json!({}))
        }
        Command::Mend => {
            bench.clear_faults();
            Ok(json!({}))
        }
        Command::ClearPeaks => {
            bench.clear_peaks();
            Ok(json!({}))
        }
        Command::Status => {
            let report = bench.report(lab.clock.process_s());
            drop(bench);
            let mut reply = serde_json::to_value(report).map_err(|e| e.to_string())?;
            reply["stream"] = json!(lab.stream);
            reply["clock_rate"] = json!(lab.clock.rate());
            Ok(reply)
        }
    }
}
