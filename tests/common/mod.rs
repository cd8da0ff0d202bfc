//! What the tests of both binaries need: the sensor, a client and its requests, a process that ends with its test, a
//! service and its database, the skin, a wait.

use std::fmt::Debug;
use std::fs::DirBuilder;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::process::Child;
use std::sync::Once;
use std::time::{Duration, Instant};

use palpate::api::ServeOptions;
use palpate::cli::trust;
use palpate::conductor::AutoResume;
use palpate::simulate::model::unit_responses;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use sim_core::sensor::Sensor;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{ConnectOptions, Connection};

/// Text of the sensor file of 28 electrodes.
pub const SENSOR: &str = include_str!("../../experiments/sensors/ert-28.toml");

/// A client without TLS.
pub fn http() -> reqwest::Client {
    trust::http(trust::tls("http:", None).unwrap()).unwrap()
}

/// Sends a request: the status, and the body; null for one that is not JSON.
pub async fn answered(request: reqwest::RequestBuilder) -> (u16, Value) {
    let answer = request.send().await.unwrap();
    let status = answer.status().as_u16();
    (status, answer.json().await.unwrap_or(Value::Null))
}

/// An answer that must be a refusal with this status and these words.
pub fn is_refused((status, problem): (u16, Value), expected: u16, words: &str) {
    let detail = problem["detail"].as_str().unwrap_or_default();
    let is_so = status == expected && detail.contains(words);
    assert!(is_so, "{expected} {words}: {status} {problem:#}");
}

/// Reports that a test is left out, for what it lacks; fails if `PALPATE_REQUIRE_TOOLS` is set.
pub fn left_out<T>(missing: &str) -> Option<T> {
    assert!(std::env::var_os("PALPATE_REQUIRE_TOOLS").is_none(), "{missing}");
    println!("LEFT OUT: {missing}");
    None
}

/// A process that is killed, at the latest, at the end of its test.
pub struct Process(pub Child);

impl Drop for Process {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

/// Sends a signal to a process that a test has started.
pub fn signal(process: &Child, signal: Signal) {
    kill_process(Pid::from_child(process), signal).unwrap();
}

/// Options of a service on a folder and a rig, at a free port. It makes no twins, and resumes no run automatically.
pub fn serve_options(data: &Path, rig_text: String) -> ServeOptions {
    ServeOptions {
        tls: None,
        require_key: false,
        desk: false,
        idle: false,
        local_admin: true,
        bind: "127.0.0.1:0".parse().unwrap(),
        data: data.into(),
        in_place: None,
        rig_file: "rig.toml".into(),
        rig_text,
        resume: AutoResume::Off,
        twin_workers: 0,
        calibration: None,
        sensor: Sensor::from_toml(SENSOR).unwrap(),
        sensor_text: SENSOR.into(),
    }
}

/// Folder of the sensor's unit responses, which services, commands and rigs share. It stays: they are solved once, in
/// seconds on all cores.
pub fn skin_cache() -> PathBuf {
    static SOLVED: Once = Once::new();
    let cache = Path::new(env!("CARGO_TARGET_TMPDIR")).join("skin");
    SOLVED.call_once(|| {
        unit_responses(&Sensor::from_toml(SENSOR).unwrap(), &cache).unwrap();
    });
    cache
}

/// The files of a folder with this extension, by name.
pub fn with_extension(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let paths = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let has = |path: &PathBuf| path.extension().is_some_and(|found| found == extension);
    let mut found: Vec<PathBuf> = paths.filter(has).collect();
    found.sort();
    found
}

/// Puts the unit responses into the cache of a data folder.
pub fn with_responses(data: &Path) {
    let cache = data.join("cache");
    DirBuilder::new().recursive(true).mode(0o700).create(&cache).unwrap();
    for file in with_extension(&skin_cache(), "bin") {
        let to = cache.join(file.file_name().unwrap());
        // On another file system a link is not possible.
        if std::fs::hard_link(&file, &to).is_err() && !to.exists() {
            std::fs::copy(&file, &to).unwrap();
        }
    }
}

/// The database of a data folder, opened next to its service.
pub async fn database(data: &Path) -> SqliteConnection {
    let options = SqliteConnectOptions::new().filename(data.join("palpate.db"));
    options.connect().await.unwrap()
}

/// Carries out statements in the database of a data folder, next to its service.
pub async fn execute(data: &Path, statements: &'static str) {
    let mut database = database(data).await;
    sqlx::raw_sql(statements).execute(&mut database).await.unwrap();
    database.close().await.unwrap();
}

/// Reads again and again until what is read satisfies this; returns it.
pub async fn until<T: Debug>(
    what: &str,
    limit: Duration,
    mut read: impl AsyncFnMut() -> T,
    done: impl Fn(&T) -> bool,
) -> T {
    let start = Instant::now();
    loop {
        let found = read().await;
        if done(&found) {
            return found;
        }
        assert!(start.elapsed() < limit, "{what} does not come: {found:#?}");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}
