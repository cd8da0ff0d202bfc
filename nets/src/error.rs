//! Why a recipe, samples, a checkpoint or a training is invalid.
//! PURE. Uses: nothing of this crate. Never: a check of a value (the owner of the value does that).

/// Why a recipe is invalid: the field, its value, its limit.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum RecipeError {
    #[error("recipe: {0}")]
    Text(#[from] toml::de::Error),
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

/// Why samples could not be read; samples and their numbers count from 0, a side is `input` or `target`.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum SamplesError {
    #[error("samples: {message}")]
    Source { message: String },
    #[error(
        "sample {sample}: {side} number {number} is not finite; the condition missing_channels=0 excludes rows that lack \
         a channel"
    )]
    NotFinite { sample: u64, side: &'static str, number: usize },
}

/// Why bytes are not a checkpoint of this training.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CheckpointError {
    /// Damaged, or not a checkpoint of this version.
    #[error("checkpoint: {0}")]
    Bytes(&'static str),
    /// A checkpoint of another training: each field that differs, with both values.
    #[error("checkpoint: of another training: {}", .0.join("; "))]
    Other(Vec<String>),
}

/// Why a training failed; epochs and batches count from 0.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum TrainError {
    #[error(transparent)]
    Recipe(#[from] RecipeError),
    #[error(transparent)]
    Samples(#[from] SamplesError),
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    #[error(
        "training: the loss is not finite in epoch {epoch}, batch {batch}: a smaller \
             learning rate may help"
    )]
    Diverged { epoch: u32, batch: u64 },
    #[error("training: the fit has no solution: its rows are all alike, or have no finite numbers")]
    Singular,
    #[error(
        "training: the trainer was not built for {0}: `cargo install --path trainer --features {0}`"
    )]
    Device(&'static str),
    #[error("training: its threads could not be started: {0}")]
    Threads(String),
}
