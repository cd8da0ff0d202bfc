//! Passes its commit to the program; every run stores it. Without git it is not known, and absent.
//! Uses: git, where there is one. Never: a failure of the build.

use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=.git/logs/HEAD");
    let said =
        Command::new("git").args(["describe", "--always", "--dirty", "--abbrev=40"]).output();
    if let Ok(said) = said
        && said.status.success()
        && let Ok(commit) = String::from_utf8(said.stdout)
    {
        println!("cargo::rustc-env=PALPATE_COMMIT={}", commit.trim());
    }
}
