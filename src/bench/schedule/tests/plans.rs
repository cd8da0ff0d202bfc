//! Properties of every plan: valid positions, unique keys, unbiased blocks, reproducible bytes.

use std::collections::BTreeSet;

use proptest::prelude::*;

use super::{hex, planned, references, skin};
use crate::schedule::experiment::Experiment;
use crate::schedule::plan::{Kind, Plan, PlannedConfiguration, Step};

fn bytes(plan: &Plan) -> Vec<u8> {
    serde_json::to_vec(plan).unwrap()
}

prop_compose! {
    fn experiments()(
        seed: u64,
        tips in prop::sample::subsequence(vec![1u8, 2, 3, 4, 5, 6], 1..=3).prop_shuffle(),
        configurations in 1u32..80,
        block in 1u32..40,
        reference_every in 0u32..30,
        low in 2u32..6,
        spread in 0u32..7,
    ) -> Experiment {
        let high = low + spread;
        let radius_pitches = format!("[{low}, {high}]");
        hex(seed % (1 << 53), &format!(
            "tips = {tips:?}\nconfigurations = {configurations}\nblock = {block}\n\
             reference_every = {reference_every}\nradius_pitches = {radius_pitches}\n"
        ))
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn every_tip_stands_on_a_point_of_the_skin(experiment in experiments()) {
        let (sensor, plan) = (skin(), planned(&experiment));
        let [low, high] = experiment.real_hex.unwrap().radius_pitches;
        let mut stands = Vec::new();
        for step in &plan.steps {
            match step {
                Step::TouchOff { places, setting } => {
                    let tips = plan.settings[*setting as usize].tips;
                    stands.extend(places.iter().map(|stand| (stand, tips)));
                }
                Step::Reference(press) => stands.push((&press.stand, press.tips)),
                Step::Configuration(c) => stands.push((&c.stand, c.tips)),
                Step::TipChange { .. } | Step::Manual(_) => {}
            }
        }
        for (stand, tips) in stands {
            prop_assert_eq!(stand.tips_mm.len(), usize::from(tips));
            prop_assert!((low..=high).contains(&stand.radius_pitches));
            for &at_mm in stand.tips_mm.iter().chain([&stand.centre_mm]) {
                prop_assert!(sensor.point_near(at_mm, 1e-9).is_some());
                prop_assert!(sensor.holds_tip(at_mm));
            }
        }
    }

    #[test]
    fn every_key_and_every_draw_comes_once_and_in_its_block(experiment in experiments()) {
        let plan = planned(&experiment);
        let hex = experiment.real_hex.unwrap();
        let all: Vec<&PlannedConfiguration> = plan.configurations().collect();
        prop_assert_eq!(all.len() as u32, hex.configurations * hex.tips.len() as u32);
        for (i, c) in all.iter().enumerate() {
            let setting = &plan.settings[c.setting as usize];
            prop_assert_eq!(c.index, i as u32);
            prop_assert_eq!(c.tips, setting.tips);
            prop_assert_eq!(c.block, c.draw / hex.block);
            prop_assert_eq!(c.block, (c.index - setting.first) / hex.block);
        }
        let keys: BTreeSet<_> = all.iter().map(|c| (c.setting, c.draw)).collect();
        prop_assert_eq!(keys.len(), all.len());
        prop_assert!(all.iter().all(|c| c.draw < hex.configurations));
    }

    #[test]
    fn a_group_is_the_first_equal_configuration(experiment in experiments()) {
        let plan = planned(&experiment);
        let all: Vec<&PlannedConfiguration> = plan.configurations().collect();
        for c in &all {
            let first = all.iter().find(|d| d.tips == c.tips && d.stand == c.stand).unwrap();
            prop_assert_eq!(c.group, first.index);
        }
    }

    #[test]
    fn references_come_before_the_first_and_after_each_so_many(experiment in experiments()) {
        let plan = planned(&experiment);
        let hex = experiment.real_hex.unwrap();
        let settings = hex.tips.len() as u32;
        let each = hex.configurations.checked_div(hex.reference_every).map_or(0, |n| 1 + n);
        prop_assert_eq!(references(&plan) as u32, settings * each);
        let mut next = 0;
        for step in &plan.steps {
            match step {
                Step::Reference(press) => {
                    prop_assert_eq!(press.before_configuration, next);
                    let into = next - plan.settings[press.setting as usize].first;
                    prop_assert_eq!(into % hex.reference_every, 0);
                }
                Step::Configuration(c) => next = c.index + 1,
                _ => {}
            }
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_bytes(experiment in experiments()) {
        let plan = planned(&experiment);
        prop_assert_eq!(bytes(&plan), bytes(&planned(&experiment)));
        let back: Plan = serde_json::from_slice(&bytes(&plan)).unwrap();
        for (read, written) in back.configurations().zip(plan.configurations()) {
            prop_assert_eq!((read.index, read.group), (written.index, written.group));
            let off = read.stand.place().travel_mm(&written.stand.place());
            prop_assert!(off < 1e-9, "serde_json reads floats to the last bit but one: {off}");
        }
    }
}

#[test]
fn another_seed_gives_another_draw() {
    let keys = "tips = [3]\nconfigurations = 50\n";
    let stands = |seed| -> Vec<_> {
        planned(&hex(seed, keys)).configurations().map(|c| c.stand.clone()).collect()
    };
    assert_ne!(stands(1), stands(2));
}

#[test]
fn each_setting_prepares_its_tips_before_anything_is_touched() {
    let plan = planned(&hex(1, "tips = [4, 1]\nconfigurations = 2\nreference_every = 2\n"));
    let kinds: Vec<&str> = plan
        .steps
        .iter()
        .map(|step| match step {
            Step::TipChange { .. } => "tips",
            Step::TouchOff { .. } => "touch-off",
            Step::Reference(_) => "reference",
            Step::Configuration(_) => "configuration",
            Step::Manual(_) => "manual",
        })
        .collect();
    let setting = ["tips", "touch-off", "reference", "configuration", "configuration", "reference"];
    assert_eq!(kinds, [setting, setting].concat());
    assert_eq!(plan.depths_mm, [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0]);
    assert_eq!(plan.trials(), 2 * 2 * 11);
}

#[test]
fn a_setting_alone_is_drawn_as_it_is_among_others() {
    let of = |tips: &str| planned(&hex(9, &format!("tips = {tips}\nconfigurations = 60\n")));
    let (all, alone) = (of("[1, 4, 6]"), of("[4]"));
    let drawn = |plan: &Plan| -> Vec<_> {
        let fours = plan.configurations().filter(|c| c.tips == 4);
        fours.map(|c| (c.draw, c.block, c.stand.clone())).collect()
    };
    assert_eq!(drawn(&all), drawn(&alone));
}

#[test]
fn more_configurations_leave_the_earlier_draws_as_they_were() {
    let of = |n: u32| planned(&hex(9, &format!("tips = [2]\nconfigurations = {n}\n")));
    let drawn = |plan: &Plan| -> Vec<_> {
        let mut all: Vec<_> = plan.configurations().map(|c| (c.draw, c.stand.clone())).collect();
        all.sort_by_key(|(draw, _)| *draw);
        all.into_iter().map(|(_, stand)| stand).collect()
    };
    assert_eq!(drawn(&of(130))[..60], drawn(&of(60)));
}

#[test]
fn a_radius_that_no_centre_allows_is_named() {
    let experiment = hex(1, "tips = [1, 6]\nconfigurations = 5\nradius_pitches = [14, 15]\n");
    let problems = Plan::of("test.toml", &experiment, &skin()).unwrap_err();
    assert_eq!(
        problems.iter().map(ToString::to_string).collect::<Vec<_>>(),
        ["test.toml: real_hex.radius_pitches = [14, 15]: has no position with 6 tips on points"]
    );
}

#[test]
fn real_random_is_placed_by_hand() {
    let text = "name = \"r\"\nseed = 4\nsensor = \"s\"\n[real_random]\ncontacts = [2, 4]\n\
                trials_each = 3\nweights_n = [4.905]\n";
    let experiment = Experiment::from_toml("r.toml", text).unwrap();
    let plan = planned(&experiment);
    assert_eq!(plan.kind, Kind::RealRandom);
    assert_eq!((plan.trials(), plan.steps.len()), (6, 6));
    assert!(plan.steps.iter().all(|s| matches!(s, Step::Manual(_))));
}

#[test]
fn a_name_is_refused_that_is_long_or_controls_a_terminal() {
    let named = |name: &str| {
        let text = format!(
            "name = \"{name}\"\nseed = 1\nsensor = \"s\"\n[real_hex]\ntips = [1]\nconfigurations = 1\n"
        );
        Experiment::from_toml("e.toml", &text).map_err(|problems| problems[0].to_string())
    };
    named(&"n".repeat(200)).unwrap();
    let refused = "e.toml: name = 201 characters: must have at most 200 characters";
    assert_eq!(named(&"n".repeat(201)).unwrap_err(), refused);
    let refused = "e.toml: name = 4 characters: must have no control characters";
    assert_eq!(named(r"n\u001b[m").unwrap_err(), refused);
}

/// One-way analysis of variance: the variance of a quantity between stretches of `size` divided by
/// that inside them. Near 1 if the position is independent of the time.
fn between_stretches(values: &[f64], size: usize) -> f64 {
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let whole = mean(values);
    let groups: Vec<&[f64]> = values.chunks(size).collect();
    let between: f64 = groups.iter().map(|g| g.len() as f64 * (mean(g) - whole).powi(2)).sum();
    let inside: f64 =
        groups.iter().map(|g| g.iter().map(|v| (v - mean(g)).powi(2)).sum::<f64>()).sum();
    let (k, n) = (groups.len() as f64, values.len() as f64);
    (between / (k - 1.0)) / (inside / (n - k))
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (ma, mb) = (mean(a), mean(b));
    let sum = |f: &dyn Fn(f64, f64) -> f64| a.iter().zip(b).map(|(&x, &y)| f(x - ma, y - mb)).sum();
    let (ab, aa, bb): (f64, f64, f64) =
        (sum(&|x, y| x * y), sum(&|x, _| x * x), sum(&|_, y| y * y));
    ab / (aa * bb).sqrt()
}

/// x, y and radius in pressing order.
fn places(block: u32) -> [Vec<f64>; 3] {
    let keys = format!("tips = [2]\nconfigurations = 3000\nblock = {block}\n");
    let plan = planned(&hex(1, &keys));
    let of = |f: fn(&PlannedConfiguration) -> f64| plan.configurations().map(f).collect();
    [of(|c| c.stand.centre_mm[0]), of(|c| c.stand.centre_mm[1]), of(|c| c.stand.radius_mm)]
}

/// 60 blocks of 50: F(59, 2940) has its 99.9 % point at 1.64.
#[test]
fn where_the_indenter_stands_says_nothing_about_when() {
    for values in places(50) {
        let time: Vec<f64> = (0..3000).map(|i| f64::from(i / 50)).collect();
        let f = between_stretches(&values, 50);
        assert!((0.5..1.64).contains(&f), "{f}");
        let r = correlation(&time, &values);
        assert!(r.abs() < 3.3 / 3000f64.sqrt(), "{r}");
    }
}

/// Counterexample: one tour over 1000 configurations correlates position with time, and the test
/// detects it.
#[test]
fn a_tour_over_a_third_of_the_run_would_be_noticed() {
    let [x, y, _] = places(1000);
    assert!(between_stretches(&x, 50) > 5.0);
    assert!(between_stretches(&y, 50) > 5.0);
}
