//! Voltage channels that have stopped moving: the same count, trial after trial.
//! PURE. Never: what follows from it (a channel may be still for good reasons).

/// Trials in a row with one count before a channel is called stuck: more than the 11 depths of a
/// configuration, so that the skin was touched in at least two places meanwhile.
pub const STUCK_AFTER: u32 = 12;

/// The last counts of a stream of trials.
#[derive(Debug, Clone, Default)]
pub struct StuckChannels {
    last: Vec<i16>,
    repeats: Vec<u32>,
}

impl StuckChannels {
    /// Looks at a trial's first frame, and returns how many channels are stuck by now.
    pub fn push(&mut self, counts: &[i16]) -> u32 {
        if self.last.len() != counts.len() {
            self.last = counts.to_vec();
            self.repeats = vec![1; counts.len()];
            return 0;
        }
        let mut stuck = 0;
        for ((last, repeats), &count) in self.last.iter_mut().zip(&mut self.repeats).zip(counts) {
            *repeats = if *last == count { repeats.saturating_add(1) } else { 1 };
            *last = count;
            stuck += u32::from(*repeats >= STUCK_AFTER);
        }
        stuck
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_channel_is_stuck_after_so_many_equal_counts_and_free_after_another() {
        let mut channels = StuckChannels::default();
        for trial in 1..STUCK_AFTER as i16 {
            assert_eq!(channels.push(&[7, trial]), 0);
        }
        assert_eq!(channels.push(&[7, 0]), 1);
        assert_eq!(channels.push(&[8, 0]), 0);
    }
}
