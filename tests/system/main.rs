//! The whole system over real sockets: the virtual rig's wires, the service's HTTP, SQLite's file.
//! Uses: the crate as a user of its API would. Never: a mock.
//!
//! A separate binary, because the tests measure how soon a rig stops, and an accelerated rig needs the
//! machine for itself: they take turns (`bench::turn`), and no other test may run at the same time.

mod bench;
mod browser;
mod campaign;
mod leaving;
mod live;
mod once;
mod placement;
mod rig_contract;
mod safety;
mod stop;
mod take_over;
