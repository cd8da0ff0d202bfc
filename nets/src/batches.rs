//! Batches of an epoch, read ahead by a thread: their order, their noise, the check that all
//! numbers are finite.
//! Uses: `samples`, `noise`, `chance`. Never: more than a few batches in memory.

use std::sync::mpsc::{Receiver, sync_channel};

use rand::seq::SliceRandom;

use crate::chance::{Purpose, generator};
use crate::error::{SamplesError, SamplesResult};
use crate::noise::NoiseSource;
use crate::samples::{Samples, read_finite};

/// Number of batches that wait for the trainer, in addition to the one being read and the one being
/// learned.
const BATCHES_AHEAD: usize = 2;

/// A batch of samples.
pub struct Batch {
    /// Number of samples.
    pub len: usize,
    /// Voltages, V, `[len, channels]`, row-major.
    pub inputs: Vec<f32>,
    /// `[len, numbers of a target]`.
    pub targets: Vec<f32>,
}

/// Selection and order of the samples of an epoch.
#[derive(Clone, Copy)]
pub struct Pass<'a> {
    /// Source of the samples.
    pub from: &'a dyn Samples,
    /// Noise that is added.
    pub noise: &'a NoiseSource,
    /// Samples in a batch; the last one of an epoch may have fewer.
    pub batch: usize,
    /// Seed of the order; `None`: in the order of their numbers.
    pub shuffle: Option<u64>,
    /// Number of the epoch, from 0: determines order and noise.
    pub epoch: u64,
    /// Number of batches that are skipped at the start.
    pub skip: u64,
}

impl Pass<'_> {
    /// Numbers of all samples. Those of a dataset are shuffled (8 bytes per sample are held in
    /// memory); those of a stream continue where the last epoch ended.
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

    fn read(&self, samples: &[u64]) -> SamplesResult<Batch> {
        let channels = self.from.input_len();
        let mut inputs = vec![0.0; samples.len() * channels];
        let mut targets = vec![0.0; samples.len() * self.from.target_len()];
        read_finite(self.from, samples, &mut inputs, &mut targets)?;
        for (&sample, frame) in samples.iter().zip(inputs.chunks_exact_mut(channels)) {
            self.noise.add(self.epoch, sample, frame);
        }
        Ok(Batch { len: samples.len(), inputs, targets })
    }

    /// Passes each batch to `learn`, in order, while a thread reads the next ones. Ends with the
    /// first error, of either, or when `learn` returns `false`.
    ///
    /// # Errors
    /// The error of `learn`, or that of the first batch that could not be read.
    pub fn each<E: From<SamplesError>>(
        self,
        mut learn: impl FnMut(Batch) -> Result<bool, E>,
    ) -> Result<bool, E> {
        let (send, receive) = sync_channel(BATCHES_AHEAD);
        std::thread::scope(|scope| {
            // The receiver is dropped with this closure: a reader blocked in a send then ends.
            let receive: Receiver<SamplesResult<Batch>> = receive;
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
