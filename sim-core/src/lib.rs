//! The electromechanical model of an ERT skin (paper, III): forces deform three bonded layers,
//! compression determines the foam's resistance, a resistor network determines the voltages.
//! Uses: faer for the elastic solve. Never: async, files, clock, database, unseeded chance.
//!
//! Data flows one way: `sensor -> mesh -> (element, material, order, boundary, assemble, solve) ->
//! responses -> fields, piezo, tip -> network -> forward -> jacobian, batch`. `deformation`,
//! `spice` and `calculix` are for comparison, `surface` and `calibration` tie the model to
//! measurements; `inverse` estimates loads and skins from measurements. `stats` has the quantiles.

pub mod sensor;
pub mod mesh;
pub mod material;
pub mod element;
pub mod order;
pub mod boundary;
pub mod assemble;
pub mod solve;
pub mod responses;
pub mod surface;
pub mod deformation;
pub mod piezo;
pub mod fields;
pub mod circuit;
pub mod skin;
pub mod calibrated;
pub mod network;
pub mod tip;
pub mod forward;
pub mod jacobian;
pub mod batch;
pub mod inverse;
pub mod calibration;
pub mod spice;
pub mod calculix;
pub mod stats;
mod digest;
