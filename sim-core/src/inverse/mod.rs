//! From frames back to their causes: contacts, and skins.
//! Uses: the forward model and its derivative. Never: files, clock, unseeded chance.

pub mod contacts;
pub mod linear;
pub mod skin;
