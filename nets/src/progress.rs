//! What determines a training, and how it is followed: its plan, its progress, its result.
//! PURE. Uses: `recipe`, `network`, `checkpoint`. Never: a step of a training (the trainer takes it).

use crate::checkpoint::EpochLoss;
use crate::compute::Compute;
use crate::network::Network;
use crate::recipe::Recipe;

/// Everything that determines a training.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Recipe of the training.
    pub recipe: Recipe,
    /// Names of its data (dataset, model of a stream): a checkpoint of other data is rejected.
    pub data: String,
    /// Standard deviation of each channel, V, that the recipe's noise level multiplies: of a
    /// Transfer-Net's residuals (Fig. 10A).
    pub noise_sd_v: Option<Vec<f32>>,
    /// Device. With one thread, the same plan and data give the same bytes.
    pub compute: Compute,
}

/// Progress of a training.
#[derive(Debug, Clone, PartialEq)]
pub struct Progress {
    /// The current epoch, from 0.
    pub epoch: u32,
    /// Number of epochs of the recipe.
    pub epochs: u32,
    /// Number of learned batches of the epoch, and of all its batches.
    pub batches: [u64; 2],
    /// Number of samples learned since the start, including before checkpoints, and of all epochs.
    pub samples: [u64; 2],
    /// Mean loss of the epoch's learned batches, in its own unit.
    pub train_loss: f64,
    /// Loss on the validation samples; present at the end of an epoch.
    pub validation_loss: Option<f64>,
    /// Losses of the epoch with the least validation loss.
    pub best: Option<EpochLoss>,
}

/// Next step of a training.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Flow {
    /// Train the next batch.
    Continue,
    /// Pass a checkpoint to the observer, then continue.
    Checkpoint,
    /// Pass a checkpoint to the observer, then end.
    Stop,
}

/// Observer of a training.
pub trait Observer {
    /// Called after every batch, and after each epoch with its validation loss.
    fn see(&mut self, progress: &Progress) -> Flow;

    /// Receives a message on something that does not end the training.
    fn warn(&mut self, _message: String) {}

    /// Receives a requested checkpoint, from which a training of the same plan resumes.
    fn keep(&mut self, checkpoint: Vec<u8>);
}

/// Why a training ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// All epochs are done.
    Epochs,
    /// The validation loss did not decrease for the recipe's patience.
    Patience,
    /// The observer requested it.
    Stopped,
}

/// Result of a training.
#[derive(Debug, Clone)]
pub struct Trained {
    /// The network with the least validation loss; the last one if no epoch was completed.
    pub network: Network,
    /// Losses of each completed epoch.
    pub curve: Vec<EpochLoss>,
    /// Why the training ended.
    pub end: End,
}
