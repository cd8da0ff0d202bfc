//! Sources of samples: a dataset's rows, or simulations made while a net trains.
//! PURE. Never: the order of samples, memory of them.

use crate::error::{SamplesError, SamplesResult};

/// Numbered samples, each an input and a target of fixed lengths. Read by one thread at a time, but
/// not always by the same one.
pub trait Samples: Sync {
    /// Number of samples in an epoch.
    fn len(&self) -> u64;

    /// Whether there are no samples.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Length of an input: the number of channels.
    fn input_len(&self) -> usize;

    /// Length of a target.
    fn target_len(&self) -> usize;

    /// Whether samples continue beyond `len`: each epoch then reads new ones, in order.
    fn is_stream(&self) -> bool {
        false
    }

    /// Writes the samples with these numbers, in this order, one after the other.
    ///
    /// # Errors
    /// `SamplesError::Source` if they cannot be read.
    fn read(&self, samples: &[u64], inputs: &mut [f32], targets: &mut [f32]) -> SamplesResult<()>;
}

/// Reads samples and checks that all values are finite.
pub(crate) fn read_finite(
    from: &dyn Samples,
    samples: &[u64],
    inputs: &mut [f32],
    targets: &mut [f32],
) -> SamplesResult<()> {
    from.read(samples, inputs, targets)?;
    for (side, numbers, len) in
        [("input", &*inputs, from.input_len()), ("target", &*targets, from.target_len())]
    {
        if let Some(at) = numbers.iter().position(|x| !x.is_finite()) {
            return Err(SamplesError::NotFinite {
                sample: samples[at / len],
                side,
                number: at % len,
            });
        }
    }
    Ok(())
}
