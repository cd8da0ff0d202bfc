//! Remaining steps of a plan, given what is stored: where a run starts or resumes.
//! PURE. Uses: `schedule::plan`, `journal`. Never: the rig, storage.
//!
//! After any interruption the run resumes at the right trial: none lost, none stored twice.

use crate::ids::TrialKey;
use crate::journal::Progress;
use crate::schedule::plan::{PlannedConfiguration, Step};

/// Depths of a configuration that are not stored, in pressing order; empty if it is complete or
/// skipped.
pub fn pending_depths(
    configuration: &PlannedConfiguration,
    depths: usize,
    progress: &Progress,
) -> Vec<u32> {
    if progress.skipped.contains(&configuration.index) {
        return Vec::new();
    }
    (0..depths as u32)
        .filter(|&depth_index| {
            let key = TrialKey { configuration: configuration.index, depth_index };
            !progress.stored.contains(&key)
        })
        .collect()
}

/// Whether a step has nothing remaining to do.
pub fn is_done(step: &Step, depths: usize, progress: &Progress) -> bool {
    match step {
        Step::Configuration(c) => pending_depths(c, depths, progress).is_empty(),
        Step::Manual(p) => {
            let key = TrialKey { configuration: p.index, depth_index: 0 };
            progress.stored.contains(&key) || progress.skipped.contains(&p.index)
        }
        Step::TipChange { .. } | Step::TouchOff { .. } | Step::Reference(_) => false,
    }
}

/// Entry into the remaining plan: the first step that is not done. Tip changes, touch-offs and
/// reference presses count as done if no trial of their setting remains, and are repeated
/// otherwise, because their results may no longer be valid. Returns none when the plan is complete.
pub fn entry(steps: &[Step], depths: usize, progress: &Progress) -> Option<Entry> {
    let work = |s: &Step| matches!(s, Step::Configuration(_) | Step::Manual(_));
    let mut next = steps.iter().position(|s| work(s) && !is_done(s, depths, progress))?;
    while next > 0 && matches!(steps[next - 1], Step::Reference(_)) {
        next -= 1;
    }
    let setting = setting_of(&steps[next]);
    let prepare = steps[..next]
        .iter()
        .filter(|s| {
            matches!(s, Step::TipChange { .. } | Step::TouchOff { .. }) && setting_of(s) == setting
        })
        .cloned()
        .collect();
    Some(Entry { prepare, next })
}

/// Where to enter a plan.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// Tip change and touch-off of the setting, to be executed first.
    pub prepare: Vec<Step>,
    /// Index of the first step with remaining work, or of the reference press directly before it.
    pub next: usize,
}

/// Setting that a step belongs to; none for manual trials.
fn setting_of(step: &Step) -> Option<u32> {
    match step {
        Step::TipChange { setting, .. } | Step::TouchOff { setting, .. } => Some(*setting),
        Step::Reference(press) => Some(press.setting),
        Step::Configuration(c) => Some(c.setting),
        Step::Manual(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schedule::plan::Plan;
    use crate::schedule::tests::{hex, planned};
    use proptest::prelude::*;

    fn plan() -> Plan {
        planned(&hex(3, "tips = [1, 3]\nconfigurations = 4\ndepths = 3\n"))
    }

    /// Executes the plan with interruptions after the given numbers of trials; returns the keys in
    /// the order of storage.
    fn run(plan: &Plan, interruptions: &[usize]) -> Vec<TrialKey> {
        let depths = plan.depths_mm.len();
        let mut progress = Progress::default();
        let mut stored = Vec::new();
        let mut budgets = interruptions.iter().copied().chain([usize::MAX]);
        let mut budget = budgets.next().unwrap_or(usize::MAX);
        while let Some(entry) = entry(&plan.steps, depths, &progress) {
            'session: for step in &plan.steps[entry.next..] {
                let Step::Configuration(c) = step else { continue };
                for depth_index in pending_depths(c, depths, &progress) {
                    if budget == 0 {
                        budget = budgets.next().unwrap_or(usize::MAX);
                        break 'session;
                    }
                    budget -= 1;
                    let key = TrialKey { configuration: c.index, depth_index };
                    progress.stored.insert(key);
                    stored.push(key);
                }
            }
        }
        stored
    }

    proptest! {
        #[test]
        fn every_trial_once_and_in_the_same_order_whatever_interrupts(
            cuts in proptest::collection::vec(0usize..9, 0..20)
        ) {
            let plan = plan();
            prop_assert_eq!(run(&plan, &cuts), run(&plan, &[]));
        }
    }

    #[test]
    fn going_on_takes_the_settings_tip_change_and_touch_off_again() {
        let plan = plan();
        let mut progress = Progress::default();
        for configuration in 0..5 {
            for depth_index in 0..3 {
                progress.stored.insert(TrialKey { configuration, depth_index });
            }
        }
        let entry = entry(&plan.steps, 3, &progress).expect("work remains");
        assert_eq!(entry.prepare.len(), 2);
        assert!(entry.prepare.iter().all(|s| setting_of(s) == Some(1)));
        let next = plan.steps[entry.next..].iter().find_map(|s| match s {
            Step::Configuration(c) => Some(c.index),
            _ => None,
        });
        assert_eq!(next, Some(5));
    }

    #[test]
    fn a_plan_that_is_done_has_no_entry() {
        let plan = plan();
        let mut progress = Progress { skipped: (0..8).collect(), ..Progress::default() };
        assert_eq!(entry(&plan.steps, 3, &progress), None);
        progress.skipped.remove(&7);
        assert!(entry(&plan.steps, 3, &progress).is_some());
    }
}
