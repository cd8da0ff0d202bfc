//! Training of Palpate's nets (paper V): Transfer-Net, Recon-Net, the end-to-end net, Point-Net.
//! Uses: burn, here alone; sim-core, to simulate trials while Point-Net trains. Never: the store,
//! datasets' files, HTTP.

pub mod network;
pub mod samples;
mod chance;
mod noise;
pub mod input;
pub mod statistics;
pub mod initial;
pub mod transfer_net;
pub mod recon_net;
pub mod point_net;
pub mod recipe;
mod upsample;
mod model;
mod loss;
mod adam;
mod batches;
pub mod checkpoint;
pub mod device;
pub mod train;
pub mod streamed;

#[cfg(test)]
mod against_torch;
