//! What this process may use: little priority, bounded memory and time, the files of its tables.
//! Uses: rustix, landlock. Never: a bound that is lifted again.

use std::path::PathBuf;

use landlock::{
    ABI, Access, AccessFs, AccessNet, PathBeneath, PathFd, Ruleset, RulesetAttr,
    RulesetCreatedAttr, RulesetError, RulesetStatus, Scope,
};
use rustix::process::{Resource, Rlimit, getrlimit, nice, setrlimit};

/// Nice value: a process at 0 gets about seventy times as much processor time.
const ENGINE_NICE: i32 = 19;
/// Longest processor time of all threads together, s. The service ends a query sooner; this is for
/// a process that no service watches any more.
const TIME_MAX_S: u64 = 300;
/// Newest rights of Landlock that are asked for; an older kernel enforces those that it knows.
const RIGHTS: ABI = ABI::V10;

/// Lowers the priority of this thread and of those that it starts.
pub fn low_priority() {
    // Without it queries only compete more.
    let _ = nice(ENGINE_NICE);
}

/// Bounds the memory and the processor time of this process; what goes beyond ends it.
///
/// # Errors
/// The limit as text, if the system refuses it.
pub fn limits(memory_max_bytes: u64) -> Result<(), String> {
    bound(Resource::Data, memory_max_bytes, "memory")?;
    bound(Resource::Cpu, TIME_MAX_S, "processor time")?;
    // A process that is ended writes no image of its memory.
    bound(Resource::Core, 0, "core file")
}

fn bound(resource: Resource, most: u64, words: &str) -> Result<(), String> {
    let maximum = getrlimit(resource).maximum;
    let bound = maximum.map_or(most, |maximum| maximum.min(most));
    setrlimit(resource, Rlimit { current: Some(bound), maximum: Some(bound) })
        .map_err(|error| format!("palpate-query: its {words} cannot be bounded: {error}"))
}

/// Restricts this thread, and those that it starts, to reading `files`: no other file, no write, no
/// TCP connection, no signal to another process. Returns false if the kernel cannot do it.
///
/// # Errors
/// The cause as text, if a file cannot be opened.
pub fn files<'a>(files: impl Iterator<Item = &'a PathBuf>) -> Result<bool, String> {
    let failed = |error: RulesetError| format!("palpate-query: it cannot be confined: {error}");
    let mut rules = Ruleset::default()
        .handle_access(AccessFs::from_all(RIGHTS))
        .and_then(|rules| rules.handle_access(AccessNet::from_all(RIGHTS)))
        .and_then(|rules| rules.scope(Scope::from_all(RIGHTS)))
        .and_then(Ruleset::create)
        .map_err(failed)?;
    for file in files {
        let opened = PathFd::new(file).map_err(|error| format!("sql: {error}"))?;
        rules = rules.add_rule(PathBeneath::new(opened, AccessFs::ReadFile)).map_err(failed)?;
    }
    let status = rules.restrict_self().map_err(failed)?;
    Ok(status.ruleset != RulesetStatus::NotEnforced)
}

#[cfg(test)]
mod tests {
    use std::fs::{self, File};
    use std::net::{TcpListener, TcpStream};
    use std::thread;

    use super::*;

    #[test]
    fn a_confined_thread_reads_its_files_only_and_writes_and_connects_nowhere() {
        let folder = std::env::temp_dir().join(format!("palpate-confine-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let [mine, other] = ["mine", "other"].map(|name| folder.join(name));
        fs::write(&mine, "mine").unwrap();
        fs::write(&other, "other").unwrap();
        let link = folder.join("link");
        std::os::unix::fs::symlink(&other, &link).unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        TcpStream::connect(address).expect("this works before");
        assert!(File::open(&other).is_ok() && fs::read_dir(&folder).is_ok());

        let denied = |result: std::io::Result<()>| {
            result.is_err_and(|error| error.kind() == std::io::ErrorKind::PermissionDenied)
        };
        let (mine_in, folder_in) = (mine.clone(), folder.clone());
        // The restriction is of a thread and of the threads that it starts.
        let confined = thread::spawn(move || {
            if !files([&mine_in].into_iter()).unwrap() {
                println!("this kernel has no Landlock");
                return;
            }
            let check = move || {
                assert_eq!(fs::read_to_string(&mine_in).unwrap(), "mine");
                let new = folder_in.join("new");
                for path in [&other, &link, &"/etc/passwd".into(), &"/proc/self/environ".into()] {
                    assert!(denied(File::open(path).map(drop)), "{}", path.display());
                }
                assert!(denied(fs::read_dir(&folder_in).map(drop)));
                assert!(denied(fs::write(&mine_in, "changed")));
                assert!(denied(File::options().append(true).open(&mine_in).map(drop)));
                assert!(denied(fs::write(&new, "new")));
                assert!(denied(fs::create_dir(&new)));
                assert!(denied(fs::remove_file(&mine_in)));
                assert!(denied(fs::hard_link(&other, &new)));
                assert!(denied(fs::rename(&other, &new)));
                assert!(denied(TcpStream::connect(address).map(drop)));
                assert!(denied(TcpListener::bind("127.0.0.1:0").map(drop)));
                assert!(denied(std::process::Command::new("/bin/true").status().map(drop)));
            };
            check.clone()();
            thread::spawn(check).join().unwrap();
        });
        confined.join().unwrap();
        assert_eq!(fs::read_to_string(&mine).unwrap(), "mine");
        assert!(files([&folder.join("missing")].into_iter()).is_err());
        fs::remove_dir_all(&folder).unwrap();
    }
}
