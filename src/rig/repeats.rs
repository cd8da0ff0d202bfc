//! For how long each input of a module has given one and the same raw value: what a module that
//! hangs with its link up still shows.
//! PURE (times are handed in). Uses: `config` (arms). Never: what follows from it (trips are the
//! campaign's), volts.
//!
//! A noisy input that is converted anew rarely gives the same value many times in a row. Reading
//! it more often than it is converted proves nothing, and neither does time in which nobody read;
//! so a repeat counts when a whole update period has passed *and* the input was read for it.

use super::config::ARMS;

/// Follows the inputs of arms 1 to 6.
#[derive(Debug, Clone)]
pub struct Repeats {
    update_s: f64,
    inputs: [Option<Held>; ARMS],
}

/// A value, and since when it has been given.
#[derive(Debug, Clone, Copy)]
struct Held {
    raw: u16,
    /// Arrival of its first reading, process s.
    since_s: f64,
    /// Readings of it after the first.
    again: u32,
}

impl Repeats {
    /// Follows a module with this update period, process ms.
    pub fn new(update_ms: f64) -> Self {
        Self { update_s: update_ms * 1e-3, inputs: [None; ARMS] }
    }

    /// Takes a reading of the raw values, asked for and arrived at process times (s). Returns for
    /// each input over how many update periods its value has stayed; 0 after a change.
    pub fn observe(&mut self, raw: [u16; ARMS], asked_s: f64, arrived_s: f64) -> [u32; ARMS] {
        std::array::from_fn(|arm| {
            let held = match self.inputs[arm] {
                Some(held) if held.raw == raw[arm] => {
                    Held { again: held.again.saturating_add(1), ..held }
                }
                Some(_) | None => Held { raw: raw[arm], since_s: arrived_s, again: 0 },
            };
            self.inputs[arm] = Some(held);
            // From the first reply to this request: a reply that came late proves no time.
            let periods = ((asked_s - held.since_s) / self.update_s).max(0.0) as u32;
            periods.min(held.again)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A reading of arm 1 at a time that takes a millisecond; the other arms change each time.
    fn read(repeats: &mut Repeats, raw: u16, at_s: f64) -> u32 {
        let other = (at_s * 1e3) as u16;
        let mut values = [other; ARMS];
        values[0] = raw;
        let counts = repeats.observe(values, at_s, at_s + 1e-3);
        assert_eq!(counts[1..], [0; ARMS - 1]);
        counts[0]
    }

    #[test]
    fn a_value_that_stays_is_counted_in_update_periods_however_often_it_is_read() {
        let mut repeats = Repeats::new(100.0);
        let counts: Vec<u32> = (0..35).map(|n| read(&mut repeats, 7, 0.01 * n as f64)).collect();
        assert_eq!((counts[0], counts[10], counts[11], counts[34]), (0, 0, 1, 3));
        assert_eq!(read(&mut repeats, 8, 0.36), 0, "it has changed");
        assert_eq!(read(&mut repeats, 8, 0.47), 1);
    }

    #[test]
    fn a_pause_in_which_nobody_read_is_one_repeat() {
        let mut repeats = Repeats::new(100.0);
        read(&mut repeats, 7, 0.0);
        assert_eq!(read(&mut repeats, 7, 10.0), 1);
        assert_eq!(read(&mut repeats, 7, 10.01), 2, "read thrice in a hundred periods");
    }

    #[test]
    fn a_reply_that_came_late_proves_no_time() {
        let mut repeats = Repeats::new(100.0);
        repeats.observe([7; ARMS], 0.0, 0.9);
        let counts = repeats.observe([7; ARMS], 0.95, 2.0);
        assert_eq!(counts, [0; ARMS]);
    }
}
