//! Training of Palpate's nets (paper V): Transfer-Net, Recon-Net, the end-to-end net, Point-Net.
//! Uses: burn, here alone; sim-core, to simulate trials while Point-Net trains. Never: the store,
//! datasets' files, HTTP.

pub mod network;
