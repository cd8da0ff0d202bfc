//! Voltage channels that return the same count in trial after trial.
//! PURE. Never: consequences (a channel may be constant for good reasons).

/// Consecutive trials with one count after which a channel is called stuck: more than the 11 depths
/// of a configuration, so that the skin was touched in at least two positions.
const STUCK_AFTER: u32 = 12;

/// Last counts of each channel and the number of their repetitions.
#[derive(Debug, Clone, Default)]
pub struct StuckChannels {
    last: Vec<i16>,
    repeats: Vec<u32>,
}

impl StuckChannels {
    /// Adds the first frame of a trial. Returns the number of channels that are stuck.
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

    /// Indices of the channels that returned one count in the last `frames` frames.
    pub fn unchanged_in(&self, frames: u32) -> Vec<usize> {
        let unchanged = |(channel, repeats): (usize, &u32)| (*repeats >= frames).then_some(channel);
        self.repeats.iter().enumerate().filter_map(unchanged).collect()
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
        assert_eq!(channels.unchanged_in(STUCK_AFTER), [0]);
        assert_eq!(channels.push(&[8, 0]), 0);
        assert_eq!((channels.unchanged_in(2), channels.unchanged_in(1)), (vec![1], vec![0, 1]));
    }
}
