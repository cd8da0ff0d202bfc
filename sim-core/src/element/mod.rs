//! Finite elements, one per file.
//! Uses: nothing. Never: the mesh or the materials' names.

pub mod hex8;
