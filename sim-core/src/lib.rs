//! The electromechanical model of an ERT skin, as the paper builds it (III): forces deform three
//! bonded layers, compression sets the foam's resistance, a resistor network gives the voltages.
//! Uses: faer for the elastic solve. Never: async, files, clock, database, unseeded chance.

pub mod sensor;
