//! Training of every kind of net: it learns, ends, resumes, rejects.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use nets::error::{CheckpointError, SamplesError, SamplesResult, TrainError};
use nets::network::Layer;
use nets::progress::{End, Flow, Observer, Plan, Progress, Trained};
use nets::samples::Samples;
use palpate_trainer::answer::answer;
use palpate_trainer::train::train;

use super::{Rows, Watch, plan};

const CHANNELS: usize = 12;

/// Frames of a few hundredths of a volt, and `target` of each.
fn rows(count: usize, target: impl Fn(&[f32], usize) -> Vec<f32>) -> Rows {
    let wave = |row: usize, c: usize| ((row * 7 + c * 3) as f32 * 0.71).sin() * 0.03;
    let inputs: Vec<Vec<f32>> =
        (0..count).map(|row| (0..CHANNELS).map(|c| wave(row, c)).collect()).collect();
    let targets = inputs.iter().enumerate().map(|(row, x)| target(x, row)).collect();
    Rows { inputs, targets }
}

/// Response of a skin whose sensitivity differs from channel to channel.
fn bent(x: &[f32], _: usize) -> Vec<f32> {
    x.iter().enumerate().map(|(c, v)| v * (1.0 + 0.2 * (c as f32).sin()) + 3.0 * v * v).collect()
}

/// A contact of 10 N on four pixels of 8 x 8.
fn map(_: &[f32], row: usize) -> Vec<f32> {
    let (top, left) = (row % 7, (row * 3) % 7);
    let mut map = vec![0.0; 64];
    for (y, x) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        map[(top + y) * 8 + left + x] = 2.5;
    }
    map
}

/// Two of nine points pressed.
fn points(_: &[f32], row: usize) -> Vec<f32> {
    let mut forces = vec![0.0; 9];
    forces[row % 9] = 5.0 + row as f32;
    forces[(row * 4 + 1) % 9] = 20.0;
    forces
}

const TRANSFER: &str = "seed = 1\nepochs = 300\nbatch = 5\n[net]\nkind = 'transfer-net'\nhidden = 2\n\
                        width = 64\nform = 'residual'\n";
const PLAIN: &str = "seed = 1\nepochs = 300\nbatch = 5\n[net]\nkind = 'transfer-net'\nhidden = 2\n\
                     width = 64\n";
const RECON: &str = "seed = 2\nepochs = 600\nbatch = 5\n[net]\nkind = 'recon-net'\nside = 8\n\
                     channels = [16, 8]\nhidden = 64\ninput.whitened.components = 6\n";
const POINTS: &str = "seed = 3\nepochs = 300\nbatch = 5\n[net]\nkind = 'point-net'\nhidden = 2\n\
                      width = 64\ncomponents = 6\n";

fn run(plan: &Plan, rows: &Rows) -> Trained {
    train(plan, rows, rows, None, &mut Watch::default()).unwrap()
}

#[test]
fn every_net_learns_ten_rows_by_heart() {
    let cases: [(&str, Rows, f64); 4] = [
        (TRANSFER, rows(10, bent), 1e-3),
        (PLAIN, rows(10, bent), 1e-6),
        (RECON, rows(10, map), 0.01),
        (POINTS, rows(10, points), 0.3),
    ];
    for (toml, rows, limit) in cases {
        let trained = run(&plan(toml), &rows);
        let (first, last) = (trained.curve[0].validation, trained.curve.last().unwrap().validation);
        assert!(last < limit && last < first / 20.0, "{toml}: from {first} to {last}");
        assert_eq!(trained.end, End::Epochs);
    }
}

/// A short training of each kind, with noise and early stopping.
fn short() -> Vec<(Plan, Rows)> {
    let short = |toml: &str, rows| {
        let toml = toml.replace("epochs = 300", "epochs = 4\npatience = 3");
        let toml = toml.replace("epochs = 600", "epochs = 4\npatience = 3");
        let mut plan = plan(&format!("{toml}\n[noise]\nlevel = 0.5\nwhite_v = 0.001\n"));
        plan.noise_sd_v = Some((0..CHANNELS).map(|c| 0.001 * c as f32).collect());
        (plan, rows)
    };
    let normed = RECON.replace("hidden = 64", "hidden = 64\nbatch_norm = true");
    vec![
        short(TRANSFER, rows(13, bent)),
        short(&normed, rows(13, map)),
        short(POINTS, rows(13, points)),
    ]
}

#[test]
fn the_same_plan_gives_the_same_bytes_and_another_seed_others() {
    for (mut plan, rows) in short() {
        let bits = |trained: Trained| -> Vec<u32> {
            trained.network.numbers().iter().map(|x| x.to_bits()).collect()
        };
        let one = bits(run(&plan, &rows));
        assert_eq!(one, bits(run(&plan, &rows)));
        plan.recipe.seed += 1;
        assert_ne!(one, bits(run(&plan, &rows)));
    }
}

#[test]
fn going_on_from_any_checkpoint_gives_what_would_have_come() {
    for (plan, rows) in short() {
        let whole = run(&plan, &rows);
        // Of 4 epochs, 3 batches each and one call after each epoch: the first batch, an epoch's
        // last batch, an epoch's end, in the middle of the last epoch.
        for at in [1, 3, 4, 14] {
            let mut watch = Watch { checkpoint_at: Some(at), stop: true, ..Watch::default() };
            let stopped = train(&plan, &rows, &rows, None, &mut watch).unwrap();
            assert_eq!((stopped.end, watch.kept.len()), (End::Stopped, 1));
            let mut rest = Watch::default();
            let resumed = train(&plan, &rows, &rows, Some(&watch.kept[0]), &mut rest).unwrap();
            assert_eq!(resumed.network, whole.network, "from {at}");
            assert_eq!(resumed.curve, whole.curve);
            // A batch that was learned is not learned again.
            assert!(rest.seen <= 16 - at + 1, "{} after {at}", rest.seen);
        }
    }
}

#[test]
fn a_checkpoint_of_another_training_is_refused_by_the_fields_that_differ() {
    let (plan, rows) = short().remove(0);
    let mut watch = Watch { checkpoint_at: Some(2), ..Watch::default() };
    train(&plan, &rows, &rows, None, &mut watch).unwrap();
    let bytes = &watch.kept[0];
    let mut other = plan.clone();
    other.data = "ds-other".into();
    other.recipe.optimiser.learning_rate = 0.5;
    other.recipe.patience = None;
    let refused = |plan: &Plan, bytes: &[u8]| {
        train(plan, &rows, &rows, Some(bytes), &mut Watch::default()).unwrap_err()
    };
    let TrainError::Checkpoint(CheckpointError::Other(fields)) = refused(&other, bytes) else {
        panic!("it was accepted");
    };
    let names: Vec<&str> = fields.iter().map(|f| f.split(' ').next().unwrap()).collect();
    assert_eq!(names, ["data", "recipe.optimiser.learning_rate", "recipe.patience"], "{fields:?}");
    assert!(fields[1].contains("0.5") && fields[1].contains("0.001"), "{}", fields[1]);
    for cut in [0, 5, 19, 300, bytes.len() - 1] {
        let error = refused(&plan, &bytes[..cut]);
        assert!(matches!(error, TrainError::Checkpoint(CheckpointError::Bytes(_))), "{error}");
    }
}

#[test]
fn training_ends_when_nothing_gets_better_and_keeps_the_best() {
    let mut plan = plan(&TRANSFER.replace("epochs = 300", "epochs = 300\npatience = 4"));
    plan.recipe.optimiser.learning_rate = 0.3;
    let (rows, other) = (rows(10, bent), rows(10, bent));
    let mut watch = Watch::default();
    let trained = train(&plan, &rows, &other, None, &mut watch).unwrap();
    assert_eq!(trained.end, End::Patience);
    let losses: Vec<f64> = trained.curve.iter().map(|e| e.validation).collect();
    assert_eq!(losses, watch.losses);
    let best = losses.iter().copied().fold(f64::INFINITY, f64::min);
    let at = losses.iter().position(|&l| l == best).unwrap();
    assert_eq!(losses.len(), at + 1 + 4, "{losses:?}");
    // The returned network is the one of that epoch.
    let frames: Vec<f32> = other.inputs.concat();
    let answers = answer(&trained.network, &frames, plan.compute).unwrap();
    let relative = |(p, y): (&[f32], &Vec<f32>)| -> f64 {
        let square =
            |x: &mut dyn Iterator<Item = f32>| x.map(|d| f64::from(d).powi(2)).sum::<f64>();
        square(&mut p.iter().zip(y).map(|(p, y)| p - y)) / square(&mut y.iter().copied())
    };
    let pairs = answers.chunks_exact(CHANNELS).zip(&other.targets);
    let loss = pairs.map(relative).sum::<f64>() / 10.0;
    assert!((loss / best - 1.0).abs() < 1e-4, "{loss}, {best}");
}

#[test]
fn a_number_that_is_not_finite_is_refused_by_its_sample() {
    let plan = plan(&TRANSFER.replace("epochs = 300", "epochs = 2"));
    let good = rows(10, bent);
    let mut inputs = rows(10, bent);
    inputs.inputs[6][3] = f32::NAN;
    let mut targets = rows(10, bent);
    targets.targets[4][0] = f32::INFINITY;
    for (train_rows, validation, sample, side, number) in
        [(&inputs, &good, 6, "input", 3), (&good, &targets, 4, "target", 0)]
    {
        let found = train(&plan, train_rows, validation, None, &mut Watch::default()).unwrap_err();
        let wanted = SamplesError::NotFinite { sample, side, number };
        assert!(wanted.to_string().contains("missing_channels=0"), "what to do: {wanted}");
        assert_eq!(found, wanted.into());
    }
}

#[test]
fn whitening_keeps_as_many_components_as_there_are_channels() {
    let mut plan = plan(&POINTS.replace("components = 6", "components = 100"));
    plan.recipe.epochs = 1;
    let rows = rows(10, points);
    let trained = train(&plan, &rows, &rows, None, &mut Watch::default()).unwrap();
    let Layer::Dense { outputs, .. } = &trained.network.layers[1] else { panic!("no whitening") };
    assert_eq!(*outputs, CHANNELS + 1);
}

#[test]
fn data_that_a_net_cannot_be_trained_on_are_named() {
    let field = |plan: &Plan, rows: &Rows, validation: &Rows| {
        let refused = train(plan, rows, validation, None, &mut Watch::default());
        match refused.unwrap_err() {
            TrainError::Recipe(nets::error::RecipeError::Value { field, .. }) => field,
            other => panic!("{other}"),
        }
    };
    let (volts, maps) = (rows(10, bent), rows(10, map));
    assert_eq!(field(&plan(TRANSFER), &maps, &maps), "numbers of a target");
    assert_eq!(field(&plan(RECON), &volts, &volts), "numbers of a target");
    assert_eq!(field(&plan(TRANSFER), &volts, &maps), "validation samples");
    let mut noisy = plan(TRANSFER);
    noisy.recipe.noise.level = 0.1;
    assert_eq!(field(&noisy, &volts, &volts), "noise.level");
    noisy.noise_sd_v = Some(vec![0.1; 3]);
    assert_eq!(field(&noisy, &volts, &volts), "noise standard deviations");
}

/// Counts the samples in memory: those read and not yet learned.
struct Counted<'a> {
    rows: &'a Rows,
    len: u64,
    read: AtomicU64,
}

impl Samples for Counted<'_> {
    fn len(&self) -> u64 {
        self.len
    }
    fn input_len(&self) -> usize {
        self.rows.input_len()
    }
    fn target_len(&self) -> usize {
        self.rows.target_len()
    }
    fn read(&self, samples: &[u64], x: &mut [f32], y: &mut [f32]) -> SamplesResult<()> {
        self.read.fetch_add(samples.len() as u64, Ordering::SeqCst);
        let samples: Vec<u64> = samples.iter().map(|s| s % self.rows.len()).collect();
        self.rows.read(&samples, x, y)
    }
}

#[test]
fn no_more_than_a_few_batches_are_read_ahead() {
    struct Slow<'a>(&'a AtomicU64, u64);
    impl Observer for Slow<'_> {
        fn see(&mut self, progress: &Progress) -> Flow {
            if progress.batches[0] == 1 {
                self.0.store(progress.samples[0], Ordering::SeqCst); // Statistics are read before.
            }
            std::thread::sleep(Duration::from_millis(2));
            let ahead = self.0.load(Ordering::SeqCst).saturating_sub(progress.samples[0]);
            self.1 = self.1.max(ahead);
            if progress.batches[0] < 60 { Flow::Continue } else { Flow::Stop }
        }
        fn keep(&mut self, _: Vec<u8>) {}
    }
    let rows = rows(10, bent);
    let samples = Counted { rows: &rows, len: 1 << 20, read: AtomicU64::new(0) };
    let mut slow = Slow(&samples.read, 0);
    train(&plan(TRANSFER), &samples, &rows, None, &mut slow).unwrap();
    assert!(slow.1 <= 4 * 5, "{} samples of 1,048,576", slow.1);
}
