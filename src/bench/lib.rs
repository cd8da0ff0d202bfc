//! From experiment files to plans, and from plans to measured trials on one bench.
//! Uses: `words`. Never: SQL, HTTP.
//!
//! ```text
//! experiment file --> schedule --> Plan ----+
//! rig file ---------> rig -------> Bench ---+--> campaign --+--> Journal of `words`: records of the run
//! requests: pause, stop, e-stop, jog -------+               +--> status, events, samples, frames
//! ```
//! - `schedule` decides everything before the run: each position, depth and wait. Its input is a file and a
//!   seed; equal inputs make equal plans.
//! - `rig` opens the devices of a rig file as capabilities in units: stage, slot, load cells, skin. Only here
//!   are wires and registers known.
//! - `campaign` carries out one plan on one bench: travel, tare, touch-off, press, settle, measure; it checks
//!   the limits on every sample and ends in the safe end.
//!
//! `service` is the only chapter that starts a run: `conductor` hands plan, bench and journal to the campaign;
//! `api` sends requests and shows status and samples. `cli` checks experiments with `schedule` and rig files
//! with `campaign::check`, which moves nothing; all its motion is a request to `api`.

#[cfg(test)]
use palpate_words::carried;
use palpate_words::{
    chance, clock, ids, journal, plain, priority, problem, record, state, suspension, syntax,
};

pub mod schedule;
pub mod rig;
pub mod campaign;
