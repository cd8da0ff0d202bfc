//! The experiment files that ship: each parses, plans and can be done on the virtual rig's bench.
//! And what a file with an invalid value causes: one error that names file, key, value and limit.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use palpate::dataset::definition::Definition;
use palpate::problem::Problem;
use palpate::rig::reach::{bench, reach};
use palpate::rig::setup::RigSetup;
use palpate::schedule::experiment::Experiment;
use palpate::schedule::lint::lint;
use palpate::schedule::plan::Plan;
use palpate::schedule::preflight::Preflight;
use palpate::schedule::reach::{Reach, StageReach};

use crate::support::{sensor, with_extension};

/// The longest that `palpate plan experiments/real-hex.toml` may take.
const PLAN_WITHIN: Duration = Duration::from_secs(2);

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("experiments")
}

fn read(name: &str) -> String {
    std::fs::read_to_string(folder().join(name)).unwrap()
}

/// The experiment files, by name.
fn files() -> Vec<String> {
    let name = |path: PathBuf| path.file_name().unwrap().to_str().unwrap().to_owned();
    with_extension(&folder(), "toml").into_iter().map(name).collect()
}

fn experiment(name: &str) -> Experiment {
    Experiment::from_toml(name, &read(name)).unwrap()
}

fn plan(name: &str) -> Plan {
    Plan::of(name, &experiment(name), &sensor()).unwrap()
}

fn virtual_rig() -> RigSetup {
    RigSetup::from_toml("rigs/virtual.toml", &read("rigs/virtual.toml")).unwrap()
}

fn preflight(name: &str) -> Preflight {
    let rig = virtual_rig();
    let problems = lint(name, &experiment(name), &sensor(), &reach("rigs/virtual.toml", &rig));
    Preflight::of(&plan(name), &bench(&rig), problems)
}

#[test]
fn every_file_can_be_done_on_the_virtual_bench_and_carries_its_own_name() {
    let files = files();
    assert_eq!(files.len(), 11, "{files:?}");
    for name in &files {
        let preflight = preflight(name);
        assert_eq!(preflight.problems, [], "{name}");
        assert_eq!(format!("{}.toml", preflight.experiment), *name);
    }
}

#[test]
fn the_quickstart_is_264_trials() {
    let preflight = preflight("quickstart.toml");
    assert_eq!((preflight.trials, preflight.configurations), (264, 24));
}

#[test]
fn real_hex_is_198_000_trials_of_25_hours_a_setting() {
    let start = Instant::now();
    let preflight = preflight("real-hex.toml");
    let took = start.elapsed();
    assert!(took < PLAN_WITHIN, "{took:?}");
    assert_eq!((preflight.trials, preflight.configurations), (198_000, 18_000));
    assert!(preflight.travel_ratio.unwrap() < 0.35, "{:?}", preflight.travel_ratio);
    assert_eq!(preflight.settings.len(), 6);
    for setting in &preflight.settings {
        let per_trial_s = setting.duration_s / setting.trials as f64;
        assert!((per_trial_s - 2.73).abs() < 0.05, "{per_trial_s}");
    }
}

#[test]
fn a_setting_of_its_own_file_is_that_setting_of_the_whole() {
    let whole = plan("real-hex.toml");
    for tips in 1u8..=6 {
        let alone = plan(&format!("real-hex-{tips}.toml"));
        let of = |plan: &Plan| -> Vec<_> {
            let these = plan.configurations().filter(|c| c.tips == tips);
            these.map(|c| (c.draw, c.stand.clone())).collect()
        };
        assert_eq!(of(&alone), of(&whole));
        assert_eq!(alone.trials(), 33_000);
    }
}

#[test]
fn real_random_is_fifty_of_two_three_and_four_contacts() {
    let plan = plan("real-random.toml");
    for contacts in [2, 3, 4] {
        assert_eq!(plan.placements().filter(|p| p.contacts.len() == contacts).count(), 50);
    }
    assert_eq!(plan.measure.frames_per_trial, 30);
}

#[test]
fn the_readme_names_every_key() {
    let readme = read("README.md");
    let mut keys = Vec::new();
    for name in ["real-hex.toml", "real-random.toml"] {
        let whole = toml::Table::try_from(experiment(name)).unwrap();
        for (key, value) in &whole {
            match value {
                toml::Value::Table(table) => keys.extend(table.keys().cloned()),
                _ => keys.push(key.clone()),
            }
        }
    }
    let missing: Vec<_> = keys.iter().filter(|k| !readme.contains(&format!("| `{k}` |"))).collect();
    assert!(missing.is_empty(), "{missing:?}");
}

/// The one problem of an experiment, with keys added to `[real_hex]`, on a changed bench.
fn unreachable(keys: &str, change: impl FnOnce(&mut Reach)) -> String {
    let text = format!("{}{keys}", read("real-hex.toml"));
    let experiment = Experiment::from_toml("real-hex.toml", &text).unwrap();
    let mut reach = reach("rigs/virtual.toml", &virtual_rig());
    change(&mut reach);
    let found: Vec<Problem> = lint("real-hex.toml", &experiment, &sensor(), &reach);
    assert_eq!(found.len(), 1, "{found:?}");
    found[0].to_string()
}

/// The same with a changed stage, and the words of the problem between the names of both files.
fn is_unreachable(keys: &str, change: impl FnOnce(&mut StageReach), words: &str) {
    let found = unreachable(keys, |reach| change(reach.stage.as_mut().unwrap()));
    assert_eq!(found, format!("real-hex.toml: {words} of rigs/virtual.toml"));
}

#[test]
fn an_unreachable_radius_is_one_error() {
    let words =
        "real_hex.radius_pitches = 12: radius 207.85 mm is outside slot.radius_mm [31, 200]";
    is_unreachable("", |s| s.radius_mm = [31.0, 200.0], words);
    let words = "real_hex.radius_pitches = 2: radius 34.64 mm cannot be approached from \
                 slot.backlash_mm = 4 below within slot.radius_mm [31, 210]";
    is_unreachable("", |s| s.backlash_mm = 4.0, words);
}

#[test]
fn an_unreachable_centre_is_one_error() {
    let stage = |change: fn(&mut StageReach)| {
        unreachable("", |reach| change(reach.stage.as_mut().unwrap()))
    };
    let words = "rigs/virtual.toml: axes.x.travel_mm = [0, 440]: must hold machine x 59.16 to 466.20 mm, \
                 the positions of real-hex.toml: 509 of its 24563 configurations are out of reach";
    assert_eq!(stage(|s| s.x_travel_mm = [0.0, 440.0]), words);
    assert!(stage(|s| s.skin_origin_mm[1] = -80.0).contains("axes.y.travel_mm = [0, 580]"));
}

#[test]
fn an_unreachable_depth_is_one_error() {
    let words = "real_hex.depths = 11: pressing 5 mm where the skin is lowest needs machine z 73.65 mm, \
                 beyond axes.z.travel_mm [0, 73.5]";
    is_unreachable("", |s| s.z_travel_mm = [0.0, 73.5], words);
    let words = "real_hex.reference_depth_mm = 6: pressing 6 mm where the skin is lowest needs machine \
                 z 74.65 mm, beyond axes.z.travel_mm [0, 74.5]";
    is_unreachable("reference_depth_mm = 6.0\n", |s| s.z_travel_mm = [0.0, 74.5], words);
    let words = "real_hex.standoff_mm = 1.35: must not be above skin.clearance_mm = 0.8";
    is_unreachable("", |s| s.clearance_mm = 0.8, words);
}

#[test]
fn every_dataset_file_is_a_definition_of_its_name() {
    let mut found = 0;
    for entry in std::fs::read_dir(folder().join("datasets")).unwrap() {
        let path = entry.unwrap().path();
        let text = std::fs::read_to_string(&path).unwrap();
        let definition = Definition::from_toml(&path.display().to_string(), &text).unwrap();
        assert_eq!(Some(definition.name.as_str()), path.file_stem().and_then(|n| n.to_str()));
        found += 1;
    }
    assert_eq!(found, Definition::built_in_names().count());
}

#[test]
fn a_force_above_the_rigs_limit_is_one_error() {
    let words = "limits.force_n = 90: must not be above limits.force_n = 88";
    is_unreachable("[limits]\nforce_n = 90.0\n", |_| (), words);
}

#[test]
fn a_bench_that_cannot_measure_the_skin_is_one_error() {
    let words = "real-hex.toml: sensor = sensors/ert-28.toml: has 28 electrodes, but ert.electrodes = 16 \
                 in rigs/virtual.toml";
    assert_eq!(unreachable("", |r| r.electrodes = 16), words);
    let words = "measure.settle_max_ms = 5000: must hold two samples of cells.update_ms = 4000";
    is_unreachable("", |s| s.cell_update_ms = 4000.0, words);
}

#[test]
fn a_weight_above_the_experiments_limit_is_one_error() {
    let text = format!("{}[limits]\nforce_n = 9.0\n", read("real-random.toml"));
    let experiment = Experiment::from_toml("real-random.toml", &text).unwrap();
    let reach = reach("rigs/virtual.toml", &virtual_rig());
    let found = lint("real-random.toml", &experiment, &sensor(), &reach);
    let words =
        "real-random.toml: real_random.weights_n = 9.81: must not be above limits.force_n = 9";
    assert_eq!(found.iter().map(ToString::to_string).collect::<Vec<_>>(), [words]);
}

#[test]
fn every_recipe_is_one_and_says_what_it_is_called() {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder().join("recipes")).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let text = std::fs::read_to_string(&path).unwrap();
        let recipe = palpate::learn::recipe::Recipe::from_toml(&name, &text).unwrap();
        assert_eq!(format!("{}.toml", recipe.name), name);
        names.push(name);
    }
    assert_eq!(names.len(), palpate::carried::RECIPES.len(), "{names:?}");
}
