//! A PostgreSQL server in a temporary folder, and ways to end it.

use std::fs;
use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use tempfile::TempDir;

/// Password of the owner of the queue in these tests.
pub const PASSWORD: &str = "owner-hush-1";

/// A running server.
pub struct Server {
    folder: TempDir,
    bin: PathBuf,
    pub port: u16,
    process: Option<Child>,
}

/// A server, or `None` if PostgreSQL is not installed.
pub fn start() -> Option<Server> {
    let Some(bin) = bin() else {
        return left_out("no postgres: install PostgreSQL 12 or later");
    };
    let folder = tempfile::Builder::new().prefix("palpate-pg-").tempdir().unwrap();
    if is_root() {
        // PostgreSQL refuses to run as root.
        run(Command::new("chown").arg("nobody").arg(folder.path()));
    }
    let data = folder.path().join("data");
    let password = folder.path().join("password");
    fs::write(&password, PASSWORD).unwrap();
    fs::set_permissions(&password, fs::Permissions::from_mode(0o644)).unwrap();
    let mut init = as_user(&bin.join("initdb"), folder.path());
    init.arg("-D").arg(&data).arg(format!("--pwfile={}", password.display()));
    run(init.args("-U owner --auth=scram-sha-256 --no-sync -E UTF8 --locale=C".split(' ')));
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let mut server = Server { folder, bin, port, process: None };
    server.begin();
    server.sql("CREATE DATABASE queue");
    Some(server)
}

/// Folder of the programs of PostgreSQL.
fn bin() -> Option<PathBuf> {
    let of_path = std::env::var_os("PATH").unwrap_or_default();
    let mut folders: Vec<PathBuf> = std::env::split_paths(&of_path).collect();
    let versions = fs::read_dir("/usr/lib/postgresql").into_iter().flatten().flatten();
    folders.extend(versions.map(|version| version.path().join("bin")));
    folders
        .into_iter()
        .find(|folder| folder.join("initdb").exists() && folder.join("postgres").exists())
}

fn is_root() -> bool {
    fs::metadata("/proc/self")
        .is_ok_and(|of_self| std::os::unix::fs::MetadataExt::uid(&of_self) == 0)
}

fn as_user(program: &Path, folder: &Path) -> Command {
    let mut command = if is_root() {
        let mut command = Command::new("setpriv");
        command.args(["--reuid=nobody", "--regid=nogroup", "--clear-groups", "--"]).arg(program);
        command
    } else {
        Command::new(program)
    };
    command.current_dir(folder);
    command
}

/// Reports that a test is left out, for what it lacks; fails if `PALPATE_REQUIRE_TOOLS` is set.
pub fn left_out<T>(missing: &str) -> Option<T> {
    assert!(std::env::var_os("PALPATE_REQUIRE_TOOLS").is_none(), "{missing}");
    println!("LEFT OUT: {missing}");
    None
}

/// Options of openssl for a new key.
pub const NEW_KEY: &str = "-newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes";

/// Runs openssl in a folder, with these arguments.
pub fn openssl(folder: &Path, arguments: &str) {
    run(Command::new("openssl").current_dir(folder).args(arguments.split(' ')));
}

/// Runs a command that must succeed.
pub fn run(command: &mut Command) -> Output {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    output
}

impl Server {
    /// Starts the server, and waits until it answers.
    pub fn begin(&mut self) {
        let until = Instant::now() + Duration::from_secs(40);
        while Instant::now() < until {
            if self.process.as_mut().is_none_or(|process| process.try_wait().unwrap().is_some()) {
                let mut command = as_user(&self.bin.join("postgres"), self.folder.path());
                command.arg("-D").arg(self.folder.path().join("data"));
                let socket = format!("unix_socket_directories={}", self.folder.path().display());
                command.args(["-p", &self.port.to_string(), "-c", &socket]);
                command.args(["-c", "listen_addresses=127.0.0.1"]);
                let log = fs::File::options()
                    .create(true)
                    .append(true)
                    .open(self.folder.path().join("log"))
                    .unwrap();
                self.process = Some(command.stdout(Stdio::null()).stderr(log).spawn().unwrap());
            }
            if self.psql("owner", "postgres", PASSWORD, "SELECT 1").status.success() {
                return;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
        panic!("no answer: {}", fs::read_to_string(self.folder.path().join("log")).unwrap());
    }

    /// Kills the server as a failing machine would.
    pub fn kill(&mut self) {
        if let Some(mut process) = self.process.take() {
            process.kill().unwrap();
            process.wait().unwrap();
        }
    }

    /// Ends all connections.
    pub fn cut(&self) {
        self.psql("owner", "postgres", PASSWORD,
            "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE pid <> pg_backend_pid() AND datname = 'queue'");
    }

    /// Address of the queue for a login.
    pub fn address(&self, user: &str, password: &str, port: u16) -> String {
        format!("postgres://{user}:{password}@127.0.0.1:{port}/queue")
    }

    /// Runs a statement as the owner of the server in the database `postgres`.
    pub fn sql(&self, statement: &str) {
        let output = self.psql("owner", "postgres", PASSWORD, statement);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }

    /// Runs a statement as a login.
    pub fn psql(&self, user: &str, database: &str, password: &str, statement: &str) -> Output {
        let mut command = Command::new("psql");
        command.env("PGPASSWORD", password).env("PGCONNECT_TIMEOUT", "5");
        command.args("-X -At -v ON_ERROR_STOP=1 -h 127.0.0.1".split(' '));
        command.args(["-U", user, "-d", database]);
        command.args(["-p", &self.port.to_string(), "-c", statement]).output().unwrap()
    }

    /// The folder of the server, which the tests may write to.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Makes a file readable for the server alone.
    pub fn own(&self, path: &Path) {
        if is_root() {
            run(Command::new("chown").arg("nobody").arg(path));
        }
        fs::set_permissions(path, fs::Permissions::from_mode(0o600)).unwrap();
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.kill();
        // Its processes end by themselves once their parent is gone; their folder is removed after them.
        std::thread::sleep(Duration::from_millis(300));
    }
}
