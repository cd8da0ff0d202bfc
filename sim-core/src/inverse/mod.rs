//! The model turned around: what skin, and which contacts, made these frames.

pub mod skin;
