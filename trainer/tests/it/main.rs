//! Training, of every kind of net and as a process.

use nets::compute::Compute;
use nets::error::SamplesResult;
use nets::progress::{Flow, Observer, Plan, Progress};
use nets::recipe::Recipe;
use nets::samples::Samples;

mod process;
mod quantity;
mod streamed;
mod training;

const ONE_THREAD: Compute = Compute::Cpu { threads: 1 };

/// The plan of a recipe, on one thread.
fn plan(toml: &str) -> Plan {
    let recipe = Recipe::from_toml(toml).unwrap();
    Plan { recipe, data: "ds-test".into(), noise_sd_v: None, compute: ONE_THREAD }
}

/// Requests a checkpoint, or stops, at a given call; stores what it receives.
#[derive(Default)]
struct Watch {
    checkpoint_at: Option<u64>,
    stop: bool,
    seen: u64,
    kept: Vec<Vec<u8>>,
    losses: Vec<f64>,
    warnings: Vec<String>,
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
    fn warn(&mut self, message: String) {
        self.warnings.push(message);
    }
    fn keep(&mut self, checkpoint: Vec<u8>) {
        self.kept.push(checkpoint);
    }
}

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
    fn read(&self, samples: &[u64], x: &mut [f32], y: &mut [f32]) -> SamplesResult<()> {
        for (nth, &sample) in samples.iter().enumerate() {
            let (input, target) = (&self.inputs[sample as usize], &self.targets[sample as usize]);
            x[nth * input.len()..][..input.len()].copy_from_slice(input);
            y[nth * target.len()..][..target.len()].copy_from_slice(target);
        }
        Ok(())
    }
}
