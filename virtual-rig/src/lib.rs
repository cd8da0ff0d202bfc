//! The virtual rig: simulated devices and skin behind real wires, with a virtual operator.
//! Register tables and packets follow the documents of the devices, and are encoded and decoded without
//! the service's code: constants of wires and files are written twice on purpose. Uses: sim-core's skin,
//! tokio's sockets. Never: the service's own code.
//!
//! Reading order: `config` (devices and wires), `kinematics` and `drive` (a motor), `device`
//! (register maps), `bench` (the rig as one value), `modbus`, `ert`, `control` (its wires), `fault`
//! (faults), `run` and `operator` (the two processes), `hand` (the operator's mistakes).

pub mod config;
pub mod clock;
pub mod kinematics;
pub mod drive;
pub mod modbus;
pub mod device;
pub mod fault;
pub mod skin;
pub mod bench;
pub mod solver;
pub mod lab;
pub mod wire;
pub mod ert;
pub mod control;
pub mod run;
pub mod hand;
pub mod operator;

pub use operator::{OperatorArgs, OperatorError, operator_main};
pub use run::{Ready, RigArgs, RigOptions, RunError, VirtualRig, rig_main};
