//! The addresses and keys of the queue and the store of bulk work, and API keys: a process that needs none of them must
//! not inherit them.
//! Uses: the environment. Never: the value of a variable.

use std::ffi::OsStr;
use std::process::Command;

/// Beginnings of the names of the variables that contain or name queue and store. PG: those of PostgreSQL's own clients.
const BULK_SECRETS: [&str; 4] = ["PALPATE_QUEUE", "PALPATE_STORE", "AWS_", "PG"];
/// Beginning of the names of the variables that contain or name an API key.
const KEY_SECRETS: [&str; 1] = ["PALPATE_KEY"];

/// Removes the secrets of this process from what another one inherits. Of all programs that a service starts only
/// `palpate-worker` may have them.
pub fn withhold(command: &mut Command) {
    withhold_bulk(command);
    remove(command, &KEY_SECRETS);
}

/// As [`withhold`], except the API key: for this program as a client of the service that starts it.
pub fn withhold_bulk(command: &mut Command) {
    remove(command, &BULK_SECRETS);
}

fn remove(command: &mut Command, starts: &[&str]) {
    for (name, _) in std::env::vars_os().filter(|(name, _)| begins(name, starts)) {
        command.env_remove(name);
    }
}

fn begins(name: &OsStr, starts: &[&str]) -> bool {
    name.to_str().is_some_and(|name| starts.iter().any(|start| name.starts_with(start)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_and_keys_are_secret_and_programs_are_not() {
        let of = |name: &str| {
            [&BULK_SECRETS[..], &KEY_SECRETS].map(|starts| begins(OsStr::new(name), starts))
        };
        for name in [
            "PALPATE_QUEUE",
            "PALPATE_QUEUE_FILE",
            "PALPATE_STORE_FILE",
            "AWS_SECRET_ACCESS_KEY",
            "PGPASSWORD",
        ] {
            assert_eq!(of(name), [true, false], "{name}");
        }
        for name in ["PALPATE_KEY", "PALPATE_KEY_FILE"] {
            assert_eq!(of(name), [false, true], "{name}");
        }
        for name in ["PALPATE_QUERY", "PALPATE_TRAINER", "PALPATE_DATA", "PATH", "HOME"] {
            assert_eq!(of(name), [false, false], "{name}");
        }
    }
}
