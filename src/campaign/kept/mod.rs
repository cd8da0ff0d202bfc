//! What a run leaves behind: records, what a store must do with them, and the diary that writes them.
//! Uses: `ids`. Never: SQL, motion.
//!
//! PURE: `record`.

pub mod journal;
pub mod diary;
pub mod record;
