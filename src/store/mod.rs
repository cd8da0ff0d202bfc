//! Placeholder.
//! Filled by the next commits.
