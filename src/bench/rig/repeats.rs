//! Counts for how long each input of a module has returned the same raw value, which detects a
//! module that hangs while its connection stays open.
//! PURE (times are passed in). Uses: `record` (arms). Never: consequences (the campaign trips),
//! volts.
//!
//! A noisy input that is converted again rarely returns the same value many times in succession.
//! Reading it more often than it is converted is no evidence, and neither is time in which it was
//! not read. A repeat therefore counts only if a whole update period lies between the request and the
//! reply that was counted before: the two are different conversions.

use crate::record::ARMS;

/// Repeat counters of the inputs of arms 1 to 6.
#[derive(Debug, Clone)]
pub struct Repeats {
    update_s: f64,
    inputs: [Option<Held>; ARMS],
}

/// A value and the time since which it has been returned.
#[derive(Debug, Clone, Copy)]
struct Held {
    raw: u16,
    /// Arrival of the reading that was counted last, process s.
    counted_s: f64,
    /// Number of repeats.
    repeats: u32,
}

impl Repeats {
    /// Creates the counters for a module with this update period, process ms.
    pub fn new(update_ms: f64) -> Self {
        Self { update_s: update_ms * 1e-3, inputs: [None; ARMS] }
    }

    /// Adds a reading of the raw values, with the process times of request and reply, s. Returns
    /// for each input the number of further conversions with its value; 0 after a change.
    pub fn observe(&mut self, raw: [u16; ARMS], asked_s: f64, arrived_s: f64) -> [u32; ARMS] {
        std::array::from_fn(|arm| {
            let held = match self.inputs[arm] {
                // From a reply to this request: a late reply is no evidence of time.
                Some(held) if held.raw == raw[arm] && asked_s - held.counted_s < self.update_s => {
                    held
                }
                Some(held) if held.raw == raw[arm] => {
                    Held { counted_s: arrived_s, repeats: held.repeats.saturating_add(1), ..held }
                }
                Some(_) | None => Held { raw: raw[arm], counted_s: arrived_s, repeats: 0 },
            };
            self.inputs[arm] = Some(held);
            held.repeats
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A reading of arm 1 that takes a millisecond; the other arms change each time.
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
        for n in 1..10 {
            let at_s = 10.0 + 0.01 * f64::from(n);
            assert_eq!(read(&mut repeats, 7, at_s), 1, "read often in one update period");
        }
        assert_eq!(read(&mut repeats, 7, 10.11), 2);
    }

    #[test]
    fn a_reply_that_came_late_proves_no_time() {
        let mut repeats = Repeats::new(100.0);
        repeats.observe([7; ARMS], 0.0, 0.9);
        let counts = repeats.observe([7; ARMS], 0.95, 2.0);
        assert_eq!(counts, [0; ARMS]);
    }
}
