//! The metrics against tools that we did not write: peaks, matching, means, RMSE, FVU and the
//! analysis of variance, recomputed by scipy, scikit-learn and numpy from the same random inputs.
//! Without them the test reports that it was skipped, or fails with `PALPATE_REQUIRE_TOOLS=1`.

use std::io::Write;
use std::process::{Command, Output, Stdio};

use palpate::chance::Chance;
use palpate::dataset::force_map::{ForceMap, TABLE_IV_MAPS};
use palpate::dataset::pressed::as_pressed;
use palpate::evaluate::anova::{Factor, Factorial};
use palpate::evaluate::distances::Distances;
use palpate::evaluate::score::Scores;
use palpate::evaluate::touch::Touch;
use palpate::infer::matching::matched;
use palpate::simulate::compare::Compared;
use palpate::store::Contact;
use serde_json::{Value, json};

use crate::support;

mod chunks;
mod commands;
mod readings;
mod skins;

fn uniform(chance: &mut Chance, low: f64, high: f64) -> f64 {
    low + (high - low) * f64::from(chance.below(1 << 24)) / f64::from((1 << 24) - 1)
}

/// About normal, mean 0, standard deviation 1.
fn normal(chance: &mut Chance) -> f64 {
    (0..12).map(|_| uniform(chance, -0.5, 0.5)).sum()
}

/// Up to six contacts on the skin.
fn contacts(chance: &mut Chance, fewest: u32) -> Vec<Contact> {
    let count = fewest + chance.below(7 - fewest);
    let mut draw = |low, high| Some(uniform(chance, low, high));
    (0..count)
        .map(|_| Contact {
            x_mm: draw(10.0, 530.0),
            y_mm: draw(10.0, 550.0),
            force_n: draw(4.0, 40.0),
            diameter_mm: draw(10.0, 60.0),
        })
        .collect()
}

fn pressed(contacts: &[Contact]) -> Vec<sim_core::forward::Contact> {
    contacts.iter().filter_map(as_pressed).collect()
}

/// Labels as they are drawn (flat discs, which tie), blurred ones under noise as nets answer, and
/// noise alone with pixels that are no numbers; on each of the paper's twelve maps.
fn peaks(chance: &mut Chance) -> Vec<Value> {
    let mut cases = Vec::new();
    for (spec, kind) in TABLE_IV_MAPS.iter().flat_map(|spec| (0..3).map(move |kind| (spec, kind))) {
        let map = ForceMap::new(*spec, [540.0, 560.0]).unwrap();
        let mut pixels = vec![0.0; map.pixels() * map.pixels()];
        if kind < 2 {
            map.render(&pressed(&contacts(chance, 1)), &mut pixels).unwrap();
        }
        if kind > 0 {
            let largest = pixels.iter().copied().fold(0.05, f32::max);
            for pixel in &mut pixels {
                *pixel += 0.1 * largest * normal(chance) as f32;
            }
        }
        if kind == 2 {
            for lost in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -50.0] {
                let at = chance.below(pixels.len() as u32) as usize;
                pixels[at] = lost;
            }
        }
        let threshold_n = [5.0, 2.5][chance.below(2) as usize];
        let found = map.peaks(&pixels, threshold_n);
        let found = found.iter().map(|p| [p.x_mm, p.y_mm, p.force_n, p.diameter_mm]);
        // JSON has no NaN; what is not finite travels as null.
        cases.push(json!({
            "pixel_mm": spec.pixel_mm,
            "map": pixels,
            "threshold_n": threshold_n,
            "peaks": found.collect::<Vec<_>>(),
        }));
    }
    cases
}

fn places(contacts: &[Contact]) -> Vec<[f64; 2]> {
    contacts.iter().map(|c| [c.x_mm.unwrap(), c.y_mm.unwrap()]).collect()
}

fn matchings(chance: &mut Chance) -> Vec<Value> {
    (0..200)
        .map(|_| {
            let (truths, found) = (places(&contacts(chance, 0)), places(&contacts(chance, 0)));
            let pairs: Vec<(usize, usize)> =
                matched(&truths, &found).iter().map(|pair| (pair.truth, pair.estimate)).collect();
            json!({ "truths": truths, "estimates": found, "pairs": pairs })
        })
        .collect()
}

/// Contacts found more or less well, some not at all, some that are not there.
fn scores(chance: &mut Chance) -> Value {
    let frames: Vec<(Vec<Contact>, Vec<Contact>)> = (0..300)
        .map(|_| {
            let truths = contacts(chance, 0);
            let mut found: Vec<Contact> = truths
                .iter()
                .filter_map(|truth| {
                    let mut near = |value: Option<f64>, sd| value.map(|v| v + sd * normal(chance));
                    let found = Contact {
                        x_mm: near(truth.x_mm, 12.0),
                        y_mm: near(truth.y_mm, 12.0),
                        force_n: near(truth.force_n, 4.0),
                        diameter_mm: near(truth.diameter_mm, 5.0),
                    };
                    (chance.below(5) > 0).then_some(found)
                })
                .collect();
            if chance.below(4) == 0 {
                found.extend(contacts(chance, 1).into_iter().take(1));
            }
            (truths, found)
        })
        .collect();
    let distances = Distances::on_skin([540.0, 560.0]);
    let touch = |(truths, found): &(Vec<Contact>, Vec<Contact>)| {
        Touch::of(truths, found, distances.ghost_mm).unwrap()
    };
    let touches: Vec<Touch> = frames.iter().map(touch).collect();
    json!({ "frames": frames, "scores": Scores::of(&touches, &distances, 11) })
}

fn differences(chance: &mut Chance) -> Vec<Value> {
    (0..20)
        .map(|_| {
            let measured: Vec<f32> = (0..784).map(|_| 0.1 * normal(chance) as f32).collect();
            let simulated: Vec<f32> =
                measured.iter().map(|v| 0.9 * v + 0.02 * normal(chance) as f32).collect();
            let pair = Compared { measured_v: &measured, simulated_v: &simulated };
            let found = pair.difference();
            json!({
                "measured": measured, "simulated": simulated,
                "rmse_v": found.rmse_v, "fvu": found.fvu,
            })
        })
        .collect()
}

/// The paper's 2 x 2 x 3 with very unequal cells, and as many samples as it has.
fn anova(chance: &mut Chance, samples: usize) -> Value {
    let factor = |name: &str, levels: &[&str]| Factor {
        name: name.into(),
        levels: levels.iter().map(|level| level.to_string()).collect(),
    };
    let mut factorial = Factorial::new(vec![
        factor("pixel", &["4", "20"]),
        factor("diameter", &["20", "60"]),
        factor("noise", &["0", "10", "50"]),
    ])
    .unwrap();
    let mut rows = Vec::new();
    for row in 0..samples {
        let skewed = |chance: &mut Chance, n| chance.below(n).min(chance.below(n)) as usize;
        let at = match row {
            0..12 => [row % 2, row / 2 % 2, row / 4],
            _ => [skewed(chance, 2), skewed(chance, 2), skewed(chance, 3)],
        };
        let [pixel, diameter, noise] = at.map(|level| level as f64);
        let effect = 0.6 * pixel - 0.02 * diameter + 0.1 * noise * pixel;
        let value = 20.0 + effect + 2.0 * normal(chance);
        factorial.add(&at, value).unwrap();
        rows.push(json!([at, value]));
    }
    json!({ "rows": rows, "anova": factorial.analyse().unwrap() })
}

fn answers() -> Value {
    let mut chance = Chance::named(7, "metrics");
    json!({
        "peaks": peaks(&mut chance),
        "matchings": matchings(&mut chance),
        "score": scores(&mut chance),
        "differences": differences(&mut chance),
        "anovas": [anova(&mut chance, 60), anova(&mut chance, 40_000)],
    })
}

fn checked(python: &str, answers: &Value) -> Output {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/it/evaluate/python/metrics.py");
    let mut child = Command::new(python)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .arg(script)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The script reads all before it writes.
    child.stdin.take().unwrap().write_all(answers.to_string().as_bytes()).unwrap();
    child.wait_with_output().unwrap()
}

/// The script also changes single answers and sees to it that its own checks then fail.
#[test]
fn metrics_are_those_of_scipy_and_scikit_learn() {
    let modules = "numpy, scipy.ndimage, sklearn.metrics";
    let Some(python) = support::python(modules) else { return };
    let found = checked(&python, &answers());
    print!("{}", String::from_utf8_lossy(&found.stdout));
    assert!(found.status.success(), "{}", String::from_utf8_lossy(&found.stderr));
}
