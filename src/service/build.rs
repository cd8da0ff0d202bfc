//! Rebuilds the service when a file of `web/` is added or removed.

fn main() {
    println!("cargo:rerun-if-changed=../../web");
}
