//! The palpate binary.
//! Wiring only.
fn main() {}
