//! Findings and the page, on facts that are made up.

use serde_json::{Value, json};

use super::super::answers::{TrialFacts, TwinsOf};
use super::facts::{Facts, Reference, ReferenceArm, Tare, Told};
use super::findings::{findings, outliers};
use super::html;
use crate::api::StateSpan;
use crate::cli::summary::tests::{summary, time};
use crate::evaluate::simulation::report;
use crate::event::Importance;
use crate::state::{PausedWhy, StoredState};

/// A run without findings: 20 configurations with two tips at two depths.
fn sound() -> Facts {
    let trial = |n: u32| {
        let depth_mm = f64::from(n % 2) + 1.0;
        let force_n = 10.0 * depth_mm + 0.1 * f64::from(n / 2 % 5);
        TrialFacts {
            trial_id: i64::from(n) + 1,
            configuration: n / 2,
            depth_index: n % 2,
            depth_mm: Some(depth_mm),
            tips: 2,
            contact_count: 2,
            max_force_n: Some(force_n),
            forces_n: vec![Some(force_n), Some(force_n + 0.05), None, None, None, None],
            fvu: Some(0.1 + 0.002 * f64::from(n % 7)),
            rmse_v: Some(0.001),
            measured_at: Some(time(i64::from(n))),
            ..TrialFacts::default()
        }
    };
    let press = |minutes: i64, force_n: f64| Reference {
        at: time(minutes),
        depth_mm: 4.0,
        arms: vec![ReferenceArm { arm: 1, force_n }],
    };
    let tare = |minutes: i64| Tare { at: time(minutes), volts: vec![(1, 0.5), (2, 0.52)] };
    Facts {
        summary: summary(|_| {}),
        twins: TwinsOf { trials: 40, twins: 40, failures: 0, pending: 0 },
        fit: report(&[]),
        trials: (0..40).map(trial).collect(),
        states: Vec::new(),
        events: Vec::new(),
        tares: vec![tare(0), tare(30)],
        references: vec![press(0, 6.0), press(50, 6.1)],
        outline: None,
    }
}

fn words(facts: &Facts) -> Vec<String> {
    findings(facts).into_iter().map(|finding| finding.words).collect()
}

fn one(facts: &Facts) -> String {
    let words = words(facts);
    assert_eq!(words.len(), 1, "{words:?}");
    words[0].clone()
}

#[test]
fn nothing_stands_out_in_a_sound_run() {
    assert_eq!(words(&sound()), [""; 0]);
}

#[test]
fn a_run_that_ended_short_or_has_not_ended_says_so() {
    let mut facts = sound();
    facts.summary = summary(|s| {
        s["trials_stored"] = 12.into();
        s["run"]["reason"] = "asked for".into();
    });
    let said = one(&facts);
    assert!(said.contains("short of its plan") && said.contains("12 of 40"), "{said}");
    facts.summary = summary(|s| {
        s["trials_stored"] = 12.into();
        s["run"]["exit_status"] = "stopped".into();
        s["run"]["reason"] = "stopped at 12 of 40 trials".into();
    });
    assert!(one(&facts).ends_with("The run ended short of its plan: stopped at 12 of 40 trials."));
    facts.summary = summary(|s| {
        s["run"]["exit_status"] = Value::Null;
        s["run"]["state"] = "interrupted".into();
        s["trials_stored"] = 12.into();
    });
    let said = one(&facts);
    assert!(said.contains("has not ended: it is interrupted"), "{said}");
}

#[test]
fn skipped_configurations_are_counted_with_the_first_reason_and_come_first() {
    let mut facts = sound();
    facts.twins.pending = 4;
    facts.summary = summary(|s| {
        s["trials_skipped"] = 2.into();
        s["trials_stored"] = 38.into();
        s["skips"] = json!([{ "configuration": 7, "reason": "cell 3 is silent", "at": time(5) }]);
    });
    let all = findings(&facts);
    assert_eq!((all.len(), all[0].level), (2, Importance::Act));
    assert!(all[0].words.contains("1 configuration was skipped; 2 trials are missing"));
    assert!(all[0].words.contains("configuration 7: cell 3 is silent"), "{}", all[0].words);
    assert!(all[1].words.contains("4 trials have no twin yet"), "{}", all[1].words);
}

#[test]
fn trips_pauses_and_retries_have_numbers_and_times() {
    let mut facts = sound();
    let trip = "trip (force): arm 2: 81.0 N over 80.0 N".to_owned();
    facts.events.push(Told { at: time(9), kind: "trip".into(), words: trip });
    assert!(one(&facts).contains("tripped 1 time; the last at"), "{}", one(&facts));
    facts.events.clear();
    let pause = |why, from, to| StateSpan {
        state: StoredState::Paused,
        why: Some(why),
        from: time(from),
        to: Some(time(to)),
    };
    facts.states = vec![pause(PausedWhy::TipChange, 0, 30), pause(PausedWhy::Suspender, 31, 44)];
    assert!(one(&facts).contains("1 time, 13 min 0 s in all"), "{}", one(&facts));
    facts.states.truncate(1);
    assert!(words(&facts).is_empty(), "mounting tips is no pause");
    facts.summary = summary(|s| s["retries"] = 2.into());
    assert!(one(&facts).contains("2 attempts failed"));
}

#[test]
fn what_happened_is_cut_with_a_command_for_the_rest_and_has_no_pause_of_each_placement() {
    let mut facts = sound();
    let pause = |why| StateSpan {
        state: StoredState::Paused,
        why: Some(why),
        from: time(0),
        to: Some(time(30)),
    };
    facts.states = vec![pause(PausedWhy::ManualTrial)];
    let page = html::page(&facts, time(70)).unwrap();
    assert!(page.contains("No stop, trip, pause"), "a run of manual trials pauses for each");
    facts.states = vec![pause(PausedWhy::Operator)];
    for _ in 0..59 {
        facts.events.push(Told { at: time(9), kind: "trip".into(), words: "trip".into() });
    }
    let page = html::page(&facts, time(70)).unwrap();
    let rest = "20 more (20 × trip): <code>palpate events 3 --important --limit 60</code>";
    assert!(page.contains(rest), "{page}");
}

#[test]
fn a_run_of_manual_trials_has_weights_and_all_of_them_are_contacts() {
    let page = html::page(&sound(), time(70)).unwrap();
    assert!(page.contains("40 with 2 tips") && page.contains("Contacts below 5 N"), "a press");
    let mut facts = sound();
    facts.summary = summary(|s| s["run"]["kind"] = "real-random".into());
    let page = html::page(&facts, time(70)).unwrap();
    assert!(page.contains("40 with 2 weights") && page.contains("Each placed weight is a contact"));
    assert!(!page.contains("Contacts below 5 N"), "placed weights are known");
}

#[test]
fn faulty_trials_and_outliers_of_the_fit_are_named() {
    let mut facts = sound();
    facts.trials[4].flags = vec!["unsettled".into(), "depth_missed".into()];
    assert!(
        one(&facts).contains("1 trial is marked as possibly faulty (depth_missed 1, unsettled 1)")
    );
    facts.trials[4].flags.clear();
    facts.trials[9].fvu = Some(1.4);
    assert_eq!(outliers(&facts.trials)[0].trial_id, 10);
    assert!(one(&facts).contains("the worst is t10 with FVU 1.40"), "{}", one(&facts));
    facts.trials[9].contact_count = 0;
    assert!(words(&facts).is_empty(), "without contact a frame is noise");
    facts.fit.median_fvu = Some(0.7);
    assert!(one(&facts).contains("palpate calibrate skin --run 3"));
    facts.summary = summary(|s| s["run"]["kind"] = "real-random".into());
    assert!(one(&facts).ends_with("FVU 0.70 of trials with contacts."), "{}", one(&facts));
}

#[test]
fn a_fit_that_degrades_is_found() {
    let mut facts = sound();
    for trial in &mut facts.trials[27..] {
        trial.fvu = Some(0.4);
    }
    assert!(words(&facts).iter().any(|said| said.contains("fit worse with time")));
}

#[test]
fn a_soft_tip_and_a_reference_that_changes_are_found() {
    let mut facts = sound();
    for trial in &mut facts.trials {
        trial.forces_n[1] = trial.forces_n[1].map(|force_n| 0.4 * force_n);
        trial.forces_n[2] = trial.forces_n[0];
    }
    let said = one(&facts);
    assert!(said.starts_with("Arm 2 differs") && said.contains("at 2.0 mm"), "{said}");
    let mut facts = sound();
    facts.references[1].arms[0].force_n = 4.5;
    assert!(one(&facts).contains("-25 %: arm 1 read 6.00 N first and 4.50 N last"));
}

#[test]
fn the_page_is_whole_escapes_foreign_text_and_loads_nothing() {
    let page = html::page(&sound(), time(70)).unwrap();
    assert!(page.contains("night &lt;1&gt;") && !page.contains("night <1>"));
    assert!(page.contains(" (UTC+") || page.contains(" (UTC-"), "a report leaves the machine");
    for part in ["<h2>Findings", "No findings", "Table I, scaled", "@page", "Reference press"] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("<script") && !page.contains("src=") && !page.contains("@import"));
    assert!(page.matches("<svg").count() >= 5, "{}", page.matches("<svg").count());
    assert!(page.matches("virtual, n = ").count() >= 5);
    let mut empty = sound();
    empty.trials.clear();
    empty.tares.clear();
    empty.references.clear();
    let page = html::page(&empty, time(70)).unwrap();
    assert!(page.contains("No force was measured over depth"));
}

#[test]
fn what_happened_often_hides_nothing_that_happened_once() {
    let mut facts = sound();
    let told = |kind: &str, s: i64, words: String| Told { at: time(s), kind: kind.into(), words };
    for count in 0..60 {
        facts.events.push(told("twins", count, format!("twins {count}")));
    }
    facts.events.push(told("trip", 70, "arm 2: 81.0 N over 80.0 N".into()));
    let page = html::page(&facts, time(90)).unwrap();
    assert!(page.contains("<td>arm 2: 81.0 N over 80.0 N</td>"), "the last one");
    assert!(page.contains("<td>twins 38</td>") && !page.contains("<td>twins 39</td>"));
    assert!(page.contains("21 more (21 × twins): <code>palpate events 3 --important --limit 61"));
}
