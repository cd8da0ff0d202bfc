//! One run on one bench: states, safety, the engine that presses and measures.
//! Uses: `schedule`, `rig`, `clock`, `ids`. Never: SQL, HTTP.
//!
//! PURE: `run_state`, `rig_state`, `interlock`, `evidence`, `stopping`, `resume`, `eta`, `record`,
//! `halt`, `job`, `status`, `stuck`.

/// The four stops: what each moves, what is kept, how it goes on, who may. One table for the manual,
/// the API and the terminal.
pub const STOPS: &str = include_str!("stops.txt");

pub mod record;
pub mod journal;
pub mod diary;
pub mod run_state;
pub mod rig_state;
pub mod interlock;
pub mod evidence;
pub mod stopping;
pub mod resume;
pub mod eta;
pub mod job;
pub mod status;
pub mod halt;
pub mod estop;
pub mod command;
pub mod control;
pub mod stuck;
pub mod stage;
pub mod travel;
pub mod safe_end;
pub mod tare;
pub mod touch_off;
pub mod measure;
pub mod press;
pub mod manual;
pub mod show;
pub mod engine;

#[cfg(test)]
mod tests {
    #[test]
    fn the_manual_has_the_four_stops_and_the_states_as_they_are() {
        let manual = include_str!("../../docs/safety.md");
        for table in [super::STOPS, super::rig_state::TABLE, super::run_state::TABLE] {
            assert!(manual.contains(table), "docs/safety.md lacks:\n{table}");
        }
    }
}
