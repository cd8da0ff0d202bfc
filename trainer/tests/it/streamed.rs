//! The stream of simulated samples: a function of seed and number, with the stated distribution. Point-Net learns
//! from it.

use std::collections::BTreeSet;
use std::sync::{Arc, OnceLock};

use nets::points::draws::Draws;
use nets::points::streamed::Streamed;
use nets::samples::Samples;
use palpate_trainer::train::train;
use sim_core::batch::{BatchModel, Kernel};
use sim_core::forward::{Contact, ForwardModel, Workspace};
use sim_core::responses::UnitResponses;
use sim_core::sensor::Sensor;

use super::{Watch, plan};

const POINTS: usize = 804;
const CHANNELS: usize = 784;

/// Model of the paper's skin, solved once.
fn model() -> &'static ForwardModel {
    static MODEL: OnceLock<ForwardModel> = OnceLock::new();
    MODEL.get_or_init(|| {
        let text = include_str!("../../../experiments/sensors/ert-28.toml");
        let sensor = Sensor::from_toml(text).unwrap();
        let responses = Arc::new(UnitResponses::solve(&sensor).unwrap());
        ForwardModel::new(&sensor, responses).unwrap()
    })
}

fn batch() -> Arc<BatchModel> {
    static BATCH: OnceLock<Arc<BatchModel>> = OnceLock::new();
    BATCH.get_or_init(|| Arc::new(BatchModel::new(model(), Kernel::detect()))).clone()
}

fn stream(seed: u64, len: u64) -> Streamed {
    Streamed::new(batch(), model().sensor().points(), Draws::default(), seed, len)
}

#[test]
fn point_net_learns_from_a_stream_that_never_repeats() {
    let toml = "seed = 4\nepochs = 4\nbatch = 64\n[net]\nkind = 'point-net'\nhidden = 2\n\
                width = 128\n[noise]\nwhite_v = 0.0012\n[optimiser]\nbeta1 = 0.9\n";
    let mut watch = Watch::default();
    train(&plan(toml), &stream(5, 4000), &stream(6, 500), None, &mut watch).unwrap();
    let losses = watch.losses;
    let [first, .., last] = losses[..] else { panic!("{losses:?}") };
    // Answer of a net that knows only the mean number of pressed points and their mean force:
    // 3.4 (1 + ln(804 / 3.4)) = 22.0 of entropy, and 3.4 x 0.47 of spread of ln force.
    assert!(first < 24.0 && last < 21.5 && last < first, "{losses:?}");
}

fn read(from: &Streamed, numbers: &[u64]) -> (Vec<f32>, Vec<f32>) {
    let mut frames = vec![0.0; numbers.len() * CHANNELS];
    let mut forces = vec![0.0; numbers.len() * POINTS];
    from.read(numbers, &mut frames, &mut forces).unwrap();
    (frames, forces)
}

#[test]
fn a_sample_depends_on_seed_and_number_alone_and_is_what_the_model_says() {
    let one = stream(1, 10);
    let (frames, forces) = read(&one, &[5, 700_000, 6]);
    let (alone, pressed) = read(&one, &[700_000]);
    assert_eq!(alone, frames[CHANNELS..2 * CHANNELS]);
    assert_eq!(pressed, forces[POINTS..2 * POINTS]);
    assert_ne!(alone, frames[..CHANNELS]);
    assert_ne!(alone, read(&stream(2, 10), &[700_000]).0);
    let points = model().sensor().points();
    let contacts: Vec<Contact> = (0..POINTS)
        .filter(|&p| pressed[p] > 0.0)
        .map(|p| Contact {
            x_mm: points[p].x_mm,
            y_mm: points[p].y_mm,
            force_n: f64::from(pressed[p]),
        })
        .collect();
    let mut work = Workspace::default();
    let exact = model().voltages(&contacts, &mut work).unwrap();
    let apart = alone.iter().zip(exact).map(|(a, b)| (f64::from(*a) - b).abs());
    assert!(apart.fold(0.0, f64::max) < 5e-5);
}

#[test]
fn contacts_are_drawn_as_the_recipe_says() {
    let numbers: Vec<u64> = (0..4000).collect();
    let (_, forces) = read(&stream(3, 1), &numbers);
    let (mut counts, mut light, mut seen) = ([0; 7], 0, BTreeSet::new());
    for sample in forces.chunks_exact(POINTS) {
        let pressed: Vec<usize> = (0..POINTS).filter(|&p| sample[p] > 0.0).collect();
        counts[pressed.len()] += 1;
        let all_light = pressed.iter().all(|&p| (2.5..=12.0).contains(&sample[p]));
        light += u32::from(all_light && !pressed.is_empty());
        assert!(pressed.iter().all(|&p| (2.5..=40.0).contains(&sample[p])));
        let heavy = pressed.iter().any(|&p| sample[p] > 12.0);
        assert!(!heavy || pressed.iter().all(|&p| sample[p] >= 5.0));
        seen.extend(pressed);
    }
    assert_eq!(seen.len(), POINTS);
    // 120 untouched with a standard deviation of 11; 3880 / 6 = 647 of each number, with one of 23.
    assert!((75..=165).contains(&counts[0]), "{counts:?}");
    assert!(counts[1..].iter().all(|c| (555..=740).contains(c)), "{counts:?}");
    // A quarter of the touched, and heavy ones by chance: the sum of (7/35)^n / 6 is 4 % of the
    // others.
    assert!((965..=1220).contains(&light), "{light}");
}
