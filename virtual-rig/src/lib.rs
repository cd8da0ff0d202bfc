//! Placeholder while the house is laid out.
//! Filled in by the next commits.

pub mod skin;
