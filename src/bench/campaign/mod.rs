//! One run on one bench, executed safely: motion, trips, measurements and records.
//! Uses: `schedule`, `rig`, `clock`, `ids`. Never: SQL, HTTP, a wait for the store while something
//! moves.
//!
//! ```text
//! run: states, plan, engine -> trial: press, settle, measure -> bench: devices under guard
//!         \________________________ safe_end ____________________/
//! diary: records of what happened       shown: status and requests       spans: of the log
//! check: of the devices, without motion
//! ```

/// The stops: effect on the axes, data kept, how the run resumes, who may stop. One table for
/// the manual, the API and the terminal.
pub const STOPS: &str = include_str!("stops.txt");

pub mod bench;
pub mod check;
pub mod diary;
pub mod run;
pub mod safe_end;
pub mod shown;
pub mod spans;
pub mod trial;

#[cfg(test)]
mod tests {
    #[test]
    fn the_manual_has_the_four_stops_and_the_states_as_they_are() {
        let manual = include_str!("../../../docs/safety.md");
        for table in [super::STOPS, super::bench::rig_state::TABLE, super::run::run_state::TABLE] {
            assert!(manual.contains(table), "docs/safety.md lacks:\n{table}");
        }
    }
}
