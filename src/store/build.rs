//! Rebuilds the crate after a new migration. Uses: nothing. Never: a failure of the build.

fn main() {
    println!("cargo::rerun-if-changed=../../migrations");
}
