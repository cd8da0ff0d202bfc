//! The rows of `docs/safety.md`, each tried on the virtual rig's wires: what trips, that every axis is
//! stopped and the tips are up afterwards, that one cause is latched, and that the diary has it all in
//! its order.

mod alone;
mod harness;
mod journal;
mod people;
mod rows;
mod stops;
