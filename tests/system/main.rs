//! The whole system over real sockets: the virtual rig's wires, the service's HTTP, SQLite's file.
//! Uses: the crate as a user of its API would. Never: a mock.

mod bench;
mod campaign;
mod live;
mod safety;
mod stop;
