//! The whole system over real sockets: the virtual rig's wires, the service's HTTP, SQLite's file.
//! Uses: the crate as a user of its API would. Never: a mock.
//!
//! A separate binary, because the tests measure how soon a rig stops, and an accelerated rig must not be late:
//! they share the machine among themselves (`bench::turn`), and no other test may run at the same time. Most of them
//! wait: with more threads than cores (`RUST_TEST_THREADS=4` on two) they take half the time.

mod begin;
mod bench;
mod browser;
mod campaign;
#[path = "../common/mod.rs"]
mod common;
mod crash;
mod leaving;
mod live;
mod once;
mod placement;
mod rig_contract;
mod safety;
mod stop;
mod take_over;
mod terminal;
