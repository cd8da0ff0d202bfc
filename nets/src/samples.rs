//! Where samples come from: a dataset's rows, or simulations made while a net trains.
//! PURE. Never: the order of samples, memory of them.

/// Numbered samples, each an input and a target of fixed lengths. Read by one thread at a time,
/// not always the same.
pub trait Samples: Sync {
    /// Samples in an epoch.
    fn len(&self) -> u64;

    /// Whether there are none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Numbers of an input: channels.
    fn input_len(&self) -> usize;

    /// Numbers of a target.
    fn target_len(&self) -> usize;

    /// Whether samples go on beyond `len`: each epoch then reads new ones, in order.
    fn is_stream(&self) -> bool {
        false
    }

    /// Writes the samples of these numbers, in this order, one after the other.
    fn read(
        &self,
        samples: &[u64],
        inputs: &mut [f32],
        targets: &mut [f32],
    ) -> Result<(), SamplesError>;
}

/// Samples that could not be read, and why.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SamplesError {
    /// Their source failed.
    #[error("samples: {message}")]
    Source {
        /// In the source's words.
        message: String,
    },
    /// A number is not finite.
    #[error("sample {sample}: {side} number {number} is not finite")]
    NotFinite {
        /// Number of the sample.
        sample: u64,
        /// `"input"` or `"target"`.
        side: &'static str,
        /// Its place in the input or target.
        number: usize,
    },
}

/// Reads samples and refuses numbers that are not finite.
pub(crate) fn read_finite(
    from: &dyn Samples,
    samples: &[u64],
    inputs: &mut [f32],
    targets: &mut [f32],
) -> Result<(), SamplesError> {
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
