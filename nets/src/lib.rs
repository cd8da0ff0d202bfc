//! Training of Palpate's nets (paper V): Transfer-Net, Recon-Net, the end-to-end net, Point-Net.
//! Uses: burn, here alone; sim-core, to simulate trials while Point-Net trains. Never: the store,
//! datasets' files, HTTP.
//!
//! A net is a folder that uses the shared parts before it; training uses the nets only through
//! their list (`net`).

// Shared parts: what a net is made of, and what describes it.
pub mod error;
mod chance;
pub mod samples;
pub mod network;
pub mod initial;
pub mod noise;
pub mod statistics;
pub mod input;
mod upsample;
mod model;
mod loss;
pub mod architecture;

// The nets, one folder each, and their list.
pub mod transfer;
pub mod recon;
pub mod points;
pub mod net;

// Training, the same for all nets.
pub mod optimiser;
mod adam;
pub mod recipe;
pub mod checkpoint;
mod batches;
pub mod device;
pub mod train;

#[cfg(test)]
mod against_torch;
