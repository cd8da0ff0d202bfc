//! Batches of an epoch, read ahead by a thread: their order, their noise, nothing that is not
//! finite.
//! Uses: `samples`, `noise`, `chance`. Never: burn, more than a few batches in memory.

use std::sync::mpsc::{Receiver, sync_channel};

use rand::seq::SliceRandom;

use crate::chance::{Purpose, generator};
use crate::noise::NoiseSource;
use crate::samples::{Samples, SamplesError, read_finite};

/// Batches that wait for the trainer; as many as one that is read and one that is learned come
/// besides.
const AHEAD: usize = 2;

/// Some samples.
pub(crate) struct Batch {
    /// How many.
    pub len: usize,
    /// `[len, channels]`.
    pub inputs: Vec<f32>,
    /// `[len, numbers of a target]`.
    pub targets: Vec<f32>,
}

/// Which samples, and in what order.
#[derive(Clone, Copy)]
pub(crate) struct Pass<'a> {
    /// Where samples come from.
    pub from: &'a dyn Samples,
    /// Noise that is added.
    pub noise: &'a NoiseSource,
    /// Samples in a batch; the last one of an epoch may have fewer.
    pub batch: usize,
    /// Seed of the order; none: as they are numbered.
    pub shuffle: Option<u64>,
    /// Which epoch: decides order and noise.
    pub epoch: u64,
    /// Batches that are left out at the start.
    pub skip: u64,
}

impl Pass<'_> {
    /// Numbers of all samples. A dataset's are shuffled (8 bytes a sample are all that is held
    /// of them); a stream's go on where the last epoch ended.
    fn order(&self) -> Vec<u64> {
        let len = self.from.len();
        if self.from.is_stream() && self.shuffle.is_some() {
            return (self.epoch * len..(self.epoch + 1) * len).collect();
        }
        let mut order: Vec<u64> = (0..len).collect();
        if let Some(seed) = self.shuffle {
            order.shuffle(&mut generator(seed, Purpose::Order, self.epoch, 0));
        }
        order
    }

    fn read(&self, samples: &[u64]) -> Result<Batch, SamplesError> {
        let channels = self.from.input_len();
        let mut inputs = vec![0.0; samples.len() * channels];
        let mut targets = vec![0.0; samples.len() * self.from.target_len()];
        read_finite(self.from, samples, &mut inputs, &mut targets)?;
        for (&sample, frame) in samples.iter().zip(inputs.chunks_exact_mut(channels)) {
            self.noise.add(self.epoch, sample, frame);
        }
        Ok(Batch { len: samples.len(), inputs, targets })
    }

    /// Hands each batch to `learn`, in order, while a thread reads the next ones. Ends with the
    /// first error, of either, or when `learn` says `false`.
    pub fn each<E: From<SamplesError>>(
        self,
        mut learn: impl FnMut(Batch) -> Result<bool, E>,
    ) -> Result<bool, E> {
        let (send, receive) = sync_channel(AHEAD);
        std::thread::scope(|scope| {
            // The receiver goes with this closure: a reader that waits to send then ends.
            let receive: Receiver<Result<Batch, SamplesError>> = receive;
            scope.spawn(move || {
                let order = self.order();
                for samples in order.chunks(self.batch).skip(self.skip as usize) {
                    let batch = self.read(samples);
                    let failed = batch.is_err();
                    if send.send(batch).is_err() || failed {
                        return;
                    }
                }
            });
            for batch in &receive {
                if !learn(batch?)? {
                    return Ok(false);
                }
            }
            Ok(true)
        })
    }
}
