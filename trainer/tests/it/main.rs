//! Training, of every kind of net and as a process.

use nets::error::SamplesError;
use nets::samples::Samples;

mod process;
mod quantity;
mod streamed;
mod training;

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
