//! The addresses and keys of the queue and the store of bulk work, and API keys: a process that needs none of them must
//! not inherit them.
//! Uses: the environment. Never: the value of a variable.

use std::ffi::OsStr;
use std::process::Command;

/// Beginnings of the names of the variables that contain or name them. PG: those of PostgreSQL's own clients.
const SECRET: [&str; 5] = ["PALPATE_QUEUE", "PALPATE_STORE", "PALPATE_KEY", "AWS_", "PG"];

/// Removes the secrets of this process from what another one inherits. Of all programs that a service starts only
/// `palpate-worker` may have them.
pub fn withhold(command: &mut Command) {
    for (name, _) in std::env::vars_os().filter(|(name, _)| is_secret(name)) {
        command.env_remove(name);
    }
}

fn is_secret(name: &OsStr) -> bool {
    name.to_str().is_some_and(|name| SECRET.iter().any(|start| name.starts_with(start)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_and_keys_are_secret_and_programs_are_not() {
        for name in [
            "PALPATE_QUEUE",
            "PALPATE_QUEUE_FILE",
            "PALPATE_STORE_FILE",
            "PALPATE_KEY",
            "AWS_SECRET_ACCESS_KEY",
            "PGPASSWORD",
        ] {
            assert!(is_secret(OsStr::new(name)), "{name}");
        }
        for name in ["PALPATE_QUERY", "PALPATE_TRAINER", "PALPATE_DATA", "PATH", "HOME"] {
            assert!(!is_secret(OsStr::new(name)), "{name}");
        }
    }
}
