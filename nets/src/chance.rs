//! Chance of a training: a generator per purpose and number, so that none shifts another.
//! PURE. Never: unseeded chance, state between calls.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Purpose of a generator.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Purpose {
    /// Weights before the first step.
    Weights,
    /// Order of an epoch's samples.
    Order,
    /// Noise on a sample in an epoch.
    Noise,
    /// Samples for the statistics of the data.
    Statistics,
    /// Contacts of a streamed sample.
    Contacts,
}

/// Returns the generator of a purpose; `number` and `part` distinguish its uses.
pub(crate) fn generator(seed: u64, purpose: Purpose, number: u64, part: u64) -> ChaCha8Rng {
    let mut key = [0; 32];
    for (bytes, word) in key.chunks_exact_mut(8).zip([seed, purpose as u64, number, part]) {
        bytes.copy_from_slice(&word.to_le_bytes());
    }
    ChaCha8Rng::from_seed(key)
}
