//! Why a recipe, samples, a checkpoint or a training is invalid.
//! PURE. Uses: nothing of this crate. Never: a check of a value (the owner of the value does that).

/// Why a recipe is invalid: the field, its value, its limit.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum RecipeError {
    /// The text is not TOML, or does not have these fields.
    #[error("recipe: {0}")]
    Text(#[from] toml::de::Error),
    /// A value is outside its limits.
    #[error("recipe: {field} is {found}, must be {limit}")]
    Value { field: &'static str, found: String, limit: &'static str },
}

/// Returns an error for a value unless a condition holds.
///
/// # Errors
/// `RecipeError::Value` if it does not.
pub fn require(
    holds: bool,
    field: &'static str,
    found: impl ToString,
    limit: &'static str,
) -> Result<(), RecipeError> {
    let found = || found.to_string();
    if holds { Ok(()) } else { Err(RecipeError::Value { field, found: found(), limit }) }
}

/// Result of reading samples.
pub type SamplesResult<T> = Result<T, SamplesError>;

/// Why samples could not be read.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum SamplesError {
    /// The source failed.
    #[error("samples: {message}")]
    Source { message: String },
    /// A value is not finite.
    #[error(
        "sample {sample}: {side} number {number} is not finite; the condition missing_channels=0 excludes rows that lack \
         a channel"
    )]
    NotFinite {
        /// Number of the sample, from 0.
        sample: u64,
        /// `"input"` or `"target"`.
        side: &'static str,
        /// Index of the value in the input or target.
        number: usize,
    },
}

/// Why bytes are not a checkpoint of this training.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CheckpointError {
    /// Damaged, or not a checkpoint of this version.
    #[error("checkpoint: {0}")]
    Bytes(&'static str),
    /// A checkpoint of another training.
    #[error("checkpoint: of another training: {}", .0.join("; "))]
    Other(
        /// Each field that differs, with both values.
        Vec<String>,
    ),
}

/// Why a training failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrainError {
    /// The recipe is invalid, also for these data.
    #[error(transparent)]
    Recipe(#[from] RecipeError),
    /// The data cannot be read, or a value is not finite.
    #[error(transparent)]
    Samples(#[from] SamplesError),
    /// The checkpoint is not one of this training.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The loss is not finite.
    #[error(
        "training: the loss is not finite in epoch {epoch}, batch {batch}: a smaller \
             learning rate may help"
    )]
    Diverged {
        /// Number of the epoch, from 0.
        epoch: u32,
        /// Number of the batch, from 0.
        batch: u64,
    },
    /// A closed-form fit has no solution.
    #[error("training: the fit has no solution: its rows are all alike, or have no finite numbers")]
    Singular,
    /// The trainer was not built for a device.
    #[error(
        "training: the trainer was not built for {0}: `cargo install --path trainer --features {0}`"
    )]
    Device(&'static str),
    /// The threads could not be started.
    #[error("training: its threads could not be started: {0}")]
    Threads(String),
}
