//! An order, a store and workers of one test.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use palpate_worker::order::{Order, sha256};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::server::{self, PASSWORD, Server};

/// Password of the login of workers in these tests.
pub const DESK_PASSWORD: &str = "desk-hush-2";

/// Queue and store of one test.
pub struct Bench {
    pub server: Server,
    pub folder: TempDir,
    pub address: String,
}

/// An order in a folder.
pub struct Made {
    pub order: Order,
    pub folder: PathBuf,
}

/// A worker as a process; killed when dropped.
pub struct Worker {
    pub process: Child,
    log: PathBuf,
}

impl Bench {
    /// A queue that is set up, and an empty store; `None` without PostgreSQL.
    pub fn start() -> Option<Self> {
        let server = server::start()?;
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("store")).unwrap();
        let address = server.address("owner", PASSWORD, server.port);
        let bench = Self { server, folder, address };
        bench.ok(&["setup"]);
        Some(bench)
    }

    /// Address of the queue, at a port, for a login that has the rights of workers alone.
    pub fn desk(&self, port: u16) -> String {
        let login =
            format!("CREATE ROLE desk_1 LOGIN PASSWORD '{DESK_PASSWORD}' IN ROLE palpate_worker");
        self.server.sql(&login);
        self.server.address("desk_1", DESK_PASSWORD, port)
    }

    /// The program with its addresses in the environment.
    pub fn command(&self, arguments: &[&str]) -> Command {
        self.command_at(&self.address, arguments)
    }

    /// The program with another address of the queue.
    pub fn command_at(&self, address: &str, arguments: &[&str]) -> Command {
        // The tests themselves may run under nohup.
        let mut command = Command::new("env");
        command.args(["--default-signal=HUP", env!("CARGO_BIN_EXE_palpate-worker")]);
        command.env("PALPATE_QUEUE", address).env("PALPATE_STORE", self.store());
        command.env("PALPATE_PROGRAM", stand_in()).env_remove("PALPATE_LOG").args(arguments);
        command
    }

    /// Runs a command that must succeed, and returns its standard output.
    pub fn ok(&self, arguments: &[&str]) -> String {
        text(&server::run(&mut self.command(arguments)).stdout)
    }

    /// Runs a command, whatever comes of it.
    pub fn try_run(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().unwrap()
    }

    /// What the owner of the queue reads.
    pub fn asked(&self, statement: &str) -> String {
        let output = self.server.psql("owner", "queue", PASSWORD, statement);
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout).trim().to_owned()
    }

    /// The folder of the store.
    pub fn store(&self) -> PathBuf {
        self.folder.path().join("store")
    }

    /// An order of the stand-in.
    pub fn order(&self, chunks: u64, definition: Value) -> Made {
        self.order_on(chunks, definition, &[])
    }

    /// An order of the stand-in whose chunks depend on these files.
    pub fn order_on(&self, chunks: u64, mut definition: Value, files: &[&[u8]]) -> Made {
        let names: Vec<String> = files.iter().map(|file| sha256(file)).collect();
        if !files.is_empty() {
            definition["files"] = json!(names);
        }
        let content = json!({ "kind": "stand-in", "code": "1", "definition": definition });
        let id = sha256(content.to_string().as_bytes());
        let folder = self.folder.path().join(format!("order-{}", &id[..8]));
        let mut order = content;
        order["version"] = json!(1);
        order["chunks"] = json!(chunks);
        order["id"] = json!(id);
        order["files"] = json!(names);
        fs::create_dir_all(folder.join("inputs")).unwrap();
        for (name, file) in names.iter().zip(files) {
            fs::write(folder.join("inputs").join(name), file).unwrap();
        }
        fs::write(folder.join("order.json"), order.to_string()).unwrap();
        Made { order: Order::parse(order.to_string().as_bytes(), "order.json").unwrap(), folder }
    }

    /// Starts a worker with a short lease.
    pub fn worker(&self, address: &str, arguments: &[&str]) -> Worker {
        let scratch = self.folder.path().join("scratch");
        let log = self.folder.path().join("worker.log");
        let file = fs::File::options().create(true).append(true).open(&log).unwrap();
        let mut command = self.command_at(address, &["work", "--lease-s", "2", "--scratch"]);
        let process = command
            .arg(scratch)
            .args(arguments)
            .stdout(Stdio::null())
            .stderr(file)
            .spawn()
            .unwrap();
        Worker { process, log }
    }

    /// The state of the order, as `status --json` prints it.
    pub fn status(&self, made: &Made) -> Value {
        let found: Value =
            serde_json::from_str(&self.ok(&["status", &made.order.id, "--json"])).unwrap();
        found["orders"][0].clone()
    }
}

impl Made {
    /// Path of the order for an argument.
    pub fn path(&self) -> &str {
        self.folder.to_str().unwrap()
    }

    /// The bytes of each chunk in a folder of results, by index; `None` if it is not done.
    pub fn results(&self, results: &Path) -> Vec<Option<Vec<u8>>> {
        let one = |index| {
            let key = self.order.key(index);
            let done: Value =
                serde_json::from_slice(&fs::read(results.join(format!("{key}.json"))).ok()?)
                    .unwrap();
            let bytes = fs::read(results.join(format!("{key}.parquet"))).unwrap();
            assert_eq!(done["sha256"], json!(sha256(&bytes)));
            Some(bytes)
        };
        (0..self.order.chunks).map(one).collect()
    }

    /// The folder of its results in a store.
    pub fn stored_in(&self, bench: &Bench) -> PathBuf {
        bench.store().join(&self.order.id).join("results")
    }

    /// The row of a chunk in a store.
    pub fn row(&self, bench: &Bench, index: u64) -> PathBuf {
        self.stored_in(bench).join(format!("{}.json", self.order.key(index)))
    }

    /// The results of a store.
    pub fn stored(&self, bench: &Bench) -> Vec<Option<Vec<u8>>> {
        self.results(&self.stored_in(bench))
    }

    /// The bytes of each chunk as one undisturbed process makes them.
    pub fn undisturbed(&self) -> Vec<Option<Vec<u8>>> {
        use std::io::Write;
        let copy = tempfile::tempdir().unwrap();
        fs::create_dir(copy.path().join("inputs")).unwrap();
        let inputs = self.order.files.iter().map(|name| format!("inputs/{name}"));
        for name in inputs.chain(["order.json".to_owned()]) {
            fs::copy(self.folder.join(&name), copy.path().join(&name)).unwrap();
        }
        let mut command = Command::new(stand_in());
        command
            .args(["cluster", "make", "--lines"])
            .env_clear()
            .env("STAND_IN_QUICK", "1")
            .stdin(Stdio::piped());
        let mut child = command.stdout(Stdio::null()).spawn().unwrap();
        let mut input = child.stdin.take().unwrap();
        for index in 0..self.order.chunks {
            writeln!(input, "{}", json!({ "folder": copy.path(), "index": index })).unwrap();
        }
        drop(input);
        assert!(child.wait().unwrap().success());
        self.results(&copy.path().join("results"))
    }
}

impl Worker {
    /// Sends SIGTERM.
    pub fn terminate(&self) {
        self.signal("TERM");
    }

    /// Sends SIGHUP.
    pub fn hang_up(&self) {
        self.signal("HUP");
    }

    fn signal(&self, name: &str) {
        server::run(Command::new("kill").args(["-s", name, &self.process.id().to_string()]));
    }

    /// Waits for its end, and returns whether it succeeded.
    pub fn ended(&mut self, within: Duration) -> bool {
        let until = Instant::now() + within;
        while Instant::now() < until {
            if let Some(status) = self.process.try_wait().unwrap() {
                return status.success();
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        panic!("has not ended: {}", self.log());
    }

    /// What the workers of the test have logged.
    pub fn log(&self) -> String {
        fs::read_to_string(&self.log).unwrap()
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        drop(self.process.kill());
        drop(self.process.wait());
    }
}

/// Waits until something holds.
pub fn until(what: &str, within: Duration, mut holds: impl FnMut() -> bool) {
    let end = Instant::now() + within;
    while !holds() {
        assert!(Instant::now() < end, "not within {within:?}: {what}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// Path of the stand-in.
pub fn stand_in() -> PathBuf {
    let path =
        Path::new(env!("CARGO_BIN_EXE_palpate-worker")).with_file_name("examples").join("stand-in");
    assert!(path.exists(), "{}: run cargo test without --test", path.display());
    path
}

/// Bytes as text.
pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}
