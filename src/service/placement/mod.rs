//! Manual trials (paper, II-C): whether the contacts estimated from the skin agree with the weights that a
//! person was asked to place.
//! Uses: `campaign` (its status and its frames), `infer`, `store`. Never: a delay of the campaign; a
//! frame of a trial.
//!
//! ```text
//! frames -> calm (windows at rest) -> mean -> the serving method -> verdict -> page, confirmation
//! ```

mod calm;
pub mod verdict;
pub mod watch;

#[cfg(test)]
mod tests;
