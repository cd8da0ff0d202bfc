//! A new migration is a reason to build again. Uses: nothing. Never: a failure of the build.

fn main() {
    println!("cargo::rerun-if-changed=../../migrations");
}
