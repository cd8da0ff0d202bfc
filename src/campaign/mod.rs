//! One run on one bench, made safe: what moves, what trips, what is measured and kept.
//! Uses: `schedule`, `rig`, `clock`, `ids`. Never: SQL, HTTP, a wait for the store while something
//! moves.
//!
//! ```text
//! run: states, plan, engine -> trial: press, settle, measure -> bench: devices under guard
//!         \________________________ safe_end ____________________/
//! kept: records and the diary        shown: status and requests
//! ```

/// The four stops: what each moves, what is kept, how it goes on, who may. One table for the manual,
/// the API and the terminal.
pub const STOPS: &str = include_str!("stops.txt");

pub mod bench;
pub mod kept;
pub mod run;
pub mod safe_end;
pub mod shown;
pub mod trial;

#[cfg(test)]
mod tests {
    #[test]
    fn the_manual_has_the_four_stops_and_the_states_as_they_are() {
        let manual = include_str!("../../docs/safety.md");
        for table in [super::STOPS, super::bench::rig_state::TABLE, super::run::run_state::TABLE] {
            assert!(manual.contains(table), "docs/safety.md lacks:\n{table}");
        }
    }
}
