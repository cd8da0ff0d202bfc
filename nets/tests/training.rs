//! What a training must do, whichever net it trains: learn, end, go on, refuse.

use nets::checkpoint::CheckpointError;
use nets::device::Compute;
use nets::network::{Layer, Network};
use nets::recipe::Recipe;
use nets::samples::{Samples, SamplesError};
use nets::train::{End, Flow, Observer, Plan, Progress, TrainError, Trained, answer, train};

const CHANNELS: usize = 12;

/// Rows in memory.
struct Rows {
    inputs: Vec<Vec<f32>>,
    targets: Vec<Vec<f32>>,
}

impl Samples for Rows {
    fn len(&self) -> u64 {
        self.inputs.len() as u64
    }
    fn input_len(&self) -> usize {
        self.inputs[0].len()
    }
    fn target_len(&self) -> usize {
        self.targets[0].len()
    }
    fn read(&self, samples: &[u64], x: &mut [f32], y: &mut [f32]) -> Result<(), SamplesError> {
        for (nth, &sample) in samples.iter().enumerate() {
            let (input, target) = (&self.inputs[sample as usize], &self.targets[sample as usize]);
            x[nth * input.len()..][..input.len()].copy_from_slice(input);
            y[nth * target.len()..][..target.len()].copy_from_slice(target);
        }
        Ok(())
    }
}

/// Frames of a few hundredths of a volt, and what `target` makes of each.
fn rows(count: usize, target: impl Fn(&[f32], usize) -> Vec<f32>) -> Rows {
    let wave = |row: usize, c: usize| ((row * 7 + c * 3) as f32 * 0.71).sin() * 0.03;
    let inputs: Vec<Vec<f32>> =
        (0..count).map(|row| (0..CHANNELS).map(|c| wave(row, c)).collect()).collect();
    let targets = inputs.iter().enumerate().map(|(row, x)| target(x, row)).collect();
    Rows { inputs, targets }
}

/// What a skin whose sensitivity differs from channel to channel would do.
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

fn plan(toml: &str) -> Plan {
    let recipe = Recipe::from_toml(toml).unwrap();
    let compute = Compute::Cpu { threads: 1 };
    Plan { recipe, data: "ds-test".into(), noise_sd_v: None, start: None, compute }
}

const TRANSFER: &str = "seed = 1\nepochs = 300\nbatch = 5\n[net]\nkind = 'transfer-net'\nhidden = 2\n\
                        width = 64\nform = 'residual'\n";
const PLAIN: &str = "seed = 1\nepochs = 300\nbatch = 5\n[net]\nkind = 'transfer-net'\nhidden = 2\n\
                     width = 64\n";
const RECON: &str = "seed = 2\nepochs = 600\nbatch = 5\n[net]\nkind = 'recon-net'\nside = 8\n\
                     channels = [16, 8]\nhidden = 64\ninput.whitened.components = 6\n";
const POINTS: &str = "seed = 3\nepochs = 300\nbatch = 5\n[net]\nkind = 'point-net'\nhidden = 2\n\
                      width = 64\ncomponents = 6\n";

/// Stops where told, keeps what it is given.
#[derive(Default)]
struct Watch {
    checkpoint_at: Option<u64>,
    stop: bool,
    seen: u64,
    kept: Vec<Vec<u8>>,
    losses: Vec<f64>,
}

impl Observer for Watch {
    fn see(&mut self, progress: &Progress) -> Flow {
        self.seen += 1;
        self.losses.extend(progress.validation_loss);
        match (self.checkpoint_at == Some(self.seen), self.stop) {
            (false, _) => Flow::Continue,
            (true, false) => Flow::Checkpoint,
            (true, true) => Flow::Stop,
        }
    }
    fn keep(&mut self, checkpoint: Vec<u8>) {
        self.kept.push(checkpoint);
    }
}

fn run(plan: &Plan, rows: &Rows) -> Trained {
    train(plan, rows, rows, None, &mut Watch::default()).unwrap()
}

#[test]
fn every_net_learns_ten_rows_by_heart() {
    let cases: [(&str, Rows, f64); 4] = [
        (TRANSFER, rows(10, bent), 1e-3),
        (PLAIN, rows(10, bent), 1e-6),
        (RECON, rows(10, map), 0.01),
        (POINTS, rows(10, points), 0.1),
    ];
    for (toml, rows, limit) in cases {
        let trained = run(&plan(toml), &rows);
        let (first, last) = (trained.curve[0].validation, trained.curve.last().unwrap().validation);
        assert!(last < limit && last < first / 20.0, "{toml}: from {first} to {last}");
        assert_eq!(trained.end, End::Epochs);
    }
}
