//! Palpate's nets (paper V) as plain numbers: Transfer-Net, Recon-Net, the end-to-end net, Point-Net, and
//! those of other skins (perceptron, ridge and kernel ridge regression); their recipes, samples and checkpoints, and what a training reports. The trainer computes.
//! Uses: sim-core, to simulate trials while Point-Net trains. Never: tensors, the store, datasets'
//! files, HTTP.
//!
//! A net is a folder that uses the shared parts before it; training uses the nets only through
//! their list (`net`).

// Shared parts: what a net is made of, and what describes it.
pub mod error;
mod chance;
pub mod quantity;
pub mod samples;
pub mod network;
pub mod initial;
pub mod noise;
pub mod statistics;
pub mod input;
pub mod loss;
pub mod architecture;

// The nets, one folder each, and their list.
pub mod transfer;
pub mod recon;
pub mod points;
pub mod mlp;
pub mod ridge;
pub mod net;

// Of every training.
pub mod optimiser;
pub mod recipe;
pub mod checkpoint;
pub mod batches;
pub mod compute;
pub mod progress;
pub mod closed_form;
