//! Folders of work orders, and the worker that knows their queue.
//! Uses: `palpate-worker` as a process, which alone knows queue and store. Never: an address or a key, a wait for
//! a worker that does not answer.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;

use axum::http::StatusCode;
use serde::Deserialize;
use tokio::process::Command;
use tokio::time::timeout;

use super::App;
use super::problem::{ApiError, ApiResult};
use crate::chunk::order::ORDER_FILE;
use crate::program::{Known, Program};

/// The program that makes chunks of bulk work over PostgreSQL.
pub static WORKER: Known = Known {
    name: "palpate-worker",
    variable: "PALPATE_WORKER",
    folder: "worker",
    workspace: "worker",
    about: "the worker",
};
/// Folder of the data folder in which the folders of work orders are.
const ORDERS: &str = "cluster";
/// Variables that name a queue, and those that name a store.
const ADDRESSES: [[&str; 2]; 2] =
    [["PALPATE_QUEUE", "PALPATE_QUEUE_FILE"], ["PALPATE_STORE", "PALPATE_STORE_FILE"]];
/// Digits of the id of an order: at least, and all of them.
const ID_DIGITS: (usize, usize) = (8, 64);

/// Path of a folder with an order.
///
/// # Errors
/// 404 if no folder of this name has an order, 409 if the service knows no queue.
pub fn order_path(app: &App, folder: &str) -> ApiResult<PathBuf> {
    let missing = || ApiError::not_found(format!("{ORDERS}/{folder}: no folder with an order"));
    let path = order_folder(&app.facts.data, folder).ok_or_else(missing)?;
    check_configured()?;
    Ok(path)
}

/// Kind of the order in a folder.
///
/// # Errors
/// 409 if the order cannot be read.
pub fn kind_of(folder: &Path) -> ApiResult<String> {
    let kind = order_in(folder).map(|order| order.kind).filter(|kind| is_name(kind));
    let invalid = || format!("{}: cannot be read", folder.join(ORDER_FILE).display());
    kind.ok_or_else(|| ApiError::new(StatusCode::CONFLICT, invalid()))
}

/// Checks that the service was started with the addresses of a queue and a store.
///
/// # Errors
/// 409 if it was not.
pub fn check_configured() -> ApiResult<()> {
    if is_configured() {
        return Ok(());
    }
    let names = ADDRESSES.map(|names| names[1]).join(" and ");
    let words = format!("the service knows no queue: start it with {names}");
    Err(ApiError::new(StatusCode::CONFLICT, words))
}

/// The error that something outside of this service is missing (503).
pub fn unavailable(why: String) -> ApiError {
    ApiError::new(StatusCode::SERVICE_UNAVAILABLE, why)
}

/// Whether the service was started with the addresses of a queue and a store.
pub fn is_configured() -> bool {
    let is_set = |name: &&str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    ADDRESSES.iter().all(|names| names.iter().any(is_set))
}

/// What the service reads of an order.
#[derive(Deserialize)]
struct OrderFile {
    id: String,
    kind: String,
}

/// The order in a folder; `None` if there is none that can be read.
fn order_in(folder: &Path) -> Option<OrderFile> {
    let text = fs::read(folder.join(ORDER_FILE)).ok()?;
    serde_json::from_slice(&text).ok()
}

/// Names of the folders with an order, by the id of the order.
pub fn folders(data: &Path) -> BTreeMap<String, String> {
    let named = |entry: fs::DirEntry| {
        let name = entry.file_name().into_string().ok().filter(|name| is_name(name))?;
        Some((order_in(&entry.path())?.id, name))
    };
    fs::read_dir(data.join(ORDERS)).into_iter().flatten().flatten().filter_map(named).collect()
}

/// Path of a folder with an order; `None` if the name is none of a folder, or has no order.
fn order_folder(data: &Path, name: &str) -> Option<PathBuf> {
    let path = data.join(ORDERS).join(name);
    (is_name(name) && path.join(ORDER_FILE).is_file()).then_some(path)
}

/// Whether a text may be the name of a folder.
fn is_name(text: &str) -> bool {
    const NAME_MAX_CHARS: usize = 100;
    let is_of_name = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    text.starts_with(|c: char| c.is_ascii_alphanumeric())
        && text.len() <= NAME_MAX_CHARS
        && text.chars().all(is_of_name)
}

/// Whether a text is the id of an order, or its beginning.
pub fn is_id(text: &str) -> bool {
    let (least, most) = ID_DIGITS;
    (least..=most).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_hexdigit())
}

/// Why the worker has not answered.
#[derive(Debug, PartialEq, Eq)]
pub enum Unanswered {
    /// An input is invalid.
    Invalid(String),
    /// It is missing, or its queue or store does not answer.
    Failed(String),
}

/// Exit code of the worker for an invalid input.
const INVALID_INPUT: i32 = 2;

/// Path of the worker.
///
/// # Errors
/// Why it is missing; it is not built here, which takes minutes.
pub fn program() -> Result<PathBuf, String> {
    match WORKER.find() {
        Program::Ready(program) => Ok(program),
        Program::Source(_) => {
            Err("the worker is not built yet: run `palpate worker status` once".into())
        }
        Program::Missing => Err(WORKER.missing().to_string()),
    }
}

/// What the worker prints as JSON.
///
/// # Errors
/// Why it has not answered.
pub async fn ask(words: &[&OsStr], within: Duration) -> Result<Vec<u8>, Unanswered> {
    let mut command = Command::new(program().map_err(Unanswered::Failed)?);
    command.args(words).arg("--json").stdin(Stdio::null());
    // Ctrl-C in a terminal is for the service.
    command.process_group(0).kill_on_drop(true);
    answer(command, within).await
}

async fn answer(mut command: Command, within: Duration) -> Result<Vec<u8>, Unanswered> {
    let done = match timeout(within, command.output()).await {
        Ok(done) => done.map_err(|error| Unanswered::Failed(error.to_string()))?,
        Err(_) => {
            let words = format!("{}: no answer within {} s", WORKER.name, within.as_secs());
            return Err(Unanswered::Failed(words));
        }
    };
    if done.status.success() {
        return Ok(done.stdout);
    }
    let said = String::from_utf8_lossy(&done.stderr);
    let error = said.lines().rev().find_map(|line| line.strip_prefix("error: "));
    let words = error.map_or_else(|| format!("{}: {}", WORKER.name, done.status), str::to_owned);
    Err(if done.status.code() == Some(INVALID_INPUT) {
        Unanswered::Invalid(words)
    } else {
        Unanswered::Failed(words)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_folder_with_an_order_has_a_path() {
        let data = std::env::temp_dir().join(format!("palpate-orders-{}", std::process::id()));
        let folder = data.join(ORDERS).join("sim-1");
        fs::create_dir_all(&folder).unwrap();
        assert_eq!(order_folder(&data, "sim-1"), None);
        fs::write(folder.join(ORDER_FILE), r#"{"id": "ab", "kind": "sim-random"}"#).unwrap();
        assert_eq!(order_folder(&data, "sim-1"), Some(folder));
        for other in ["", ".", "..", "../cluster/sim-1", "-sim", "sim 1", "none", &"s".repeat(101)]
        {
            assert_eq!(order_folder(&data, other), None, "{other}");
        }
        let found = folders(&data);
        assert_eq!(found.get("ab").map(String::as_str), Some("sim-1"));
        let kind = |text: &str| {
            fs::write(data.join(ORDERS).join("sim-1").join(ORDER_FILE), text).unwrap();
            kind_of(&data.join(ORDERS).join("sim-1"))
        };
        assert_eq!(kind(r#"{"id": "ab", "kind": "trainings"}"#).unwrap(), "trainings");
        for refused in [r#"{"id": "ab", "kind": "../models"}"#, r#"{"id": "ab"}"#, "{"] {
            assert_eq!(kind(refused).unwrap_err().status(), StatusCode::CONFLICT);
        }
        fs::remove_dir_all(data).unwrap();
    }

    #[test]
    fn an_id_has_8_to_64_hexadecimal_digits() {
        assert!(is_id("0123abcd") && is_id(&"f".repeat(64)));
        assert!(
            !is_id("0123abc")
                && !is_id(&"f".repeat(65))
                && !is_id("../../etc")
                && !is_id("--json-x")
        );
    }

    #[tokio::test]
    async fn the_answer_of_the_worker_is_its_output_or_its_error() {
        let shell = |script: &str| {
            let mut command = Command::new("sh");
            command.args(["-c", script]).kill_on_drop(true);
            command
        };
        let ask = |script| answer(shell(script), Duration::from_secs(1));
        assert_eq!(ask("echo '{}'").await, Ok(b"{}\n".to_vec()));
        let failed = ask("echo 'INFO a'; echo 'error: queue: db: refused' >&2; exit 1").await;
        assert_eq!(failed, Err(Unanswered::Failed("queue: db: refused".into())));
        let invalid = ask("echo 'error: order: not in the store' >&2; exit 2").await;
        assert_eq!(invalid, Err(Unanswered::Invalid("order: not in the store".into())));
        let late = ask("sleep 20").await;
        assert_eq!(late, Err(Unanswered::Failed("palpate-worker: no answer within 1 s".into())));
    }
}
