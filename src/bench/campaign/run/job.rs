//! A run as it is passed to the engine, with everything decided.
//! PURE. Uses: `schedule`, `ids`. Never: files, storage.

use tokio::time::Instant;

use crate::ids::RunUid;
use crate::schedule::plan::Plan;

/// A run that is ready to be armed.
#[derive(Debug, Clone)]
pub struct Job {
    /// Id of the run.
    pub run: RunUid,
    /// Number of the run, for people.
    pub scan_id: i64,
    /// All steps of the run.
    pub plan: Plan,
    /// Predicted process time of one trial, s.
    pub predicted_trial_s: f64,
    /// Whether the run may resume without a person after a restart or a transient fault.
    pub auto_resume: bool,
    /// Whether the run begins by itself, after it has waited for its turn.
    pub has_waited: bool,
    /// How the run begins: whether a person starts it now.
    pub beginning: Beginning,
    /// Disk space that one further trial needs, bytes.
    pub bytes_per_trial: u64,
}

/// How a run begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Beginning {
    /// A person starts it: operations of the rig before that do not count.
    OfPerson,
    /// It begins by itself, after it has waited or since an earlier process drove it.
    Unasked {
        /// When a person operated the rig last and started or resumed no run since, as far as it is stored.
        operated: Option<Instant>,
    },
}

impl Beginning {
    /// When a person, who may still be at the rig as the run begins, operated it last. `before`: the last operation
    /// while the runs before it moved in this process.
    pub fn operated(self, before: Option<Instant>) -> Option<Instant> {
        match self {
            Self::OfPerson => None,
            Self::Unasked { operated } => operated.max(before),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn the_last_operation_of_a_person_counts_until_a_person_starts_a_run() {
        let now = Instant::now();
        let [earlier, later] = [Some(now), Some(now + Duration::from_secs(1))];
        for (stored, before) in [(earlier, later), (later, earlier), (None, later), (later, None)] {
            assert_eq!(Beginning::Unasked { operated: stored }.operated(before), later);
        }
        assert_eq!(Beginning::Unasked { operated: None }.operated(None), None);
        assert_eq!(Beginning::OfPerson.operated(later), None);
    }
}
