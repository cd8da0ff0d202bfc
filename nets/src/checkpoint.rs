//! A training between two steps, as bytes: what goes on from it gives what would have come.
//! PURE. Uses: toml for the head. Never: files.
//!
//! `palpate-nets`, a version, the length of the head (both u32, little-endian), the head as TOML,
//! then f32 little-endian: the numbers of the network, of the best one so far, and the moments.
//! Chance needs no state: order and noise are functions of seed, epoch and sample.

use serde::{Deserialize, Serialize};

use crate::network::Network;
use crate::recipe::Recipe;

const MAGIC: &[u8; 12] = b"palpate-nets";
const VERSION: u32 = 1;

/// Losses of an epoch, in the loss's own unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct EpochLoss {
    /// Number of the epoch, from 0.
    pub epoch: u32,
    /// Mean over the epoch's batches while they were learned.
    pub train: f64,
    /// Over the validation samples after it.
    pub validation: f64,
}

/// What a training is of: what must agree for a checkpoint to go on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Subject {
    /// What it follows.
    pub recipe: Recipe,
    /// Names of its data, as the caller gives them.
    pub data: String,
    /// Channels of an input.
    pub channels: usize,
    /// Numbers of a target.
    pub target: usize,
    /// Training samples in an epoch.
    pub samples: u64,
    /// Validation samples.
    pub validation_samples: u64,
}

/// Where a training is.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Place {
    /// The epoch under way, and the batches of it that are learned.
    pub epoch: u32,
    /// Of this epoch.
    pub batches: u64,
    /// Sum over them of their loss, minimised unit.
    pub loss_sum: f64,
    /// Losses of the epochs before.
    pub curve: Vec<EpochLoss>,
}

#[derive(Serialize, Deserialize)]
struct Head {
    place: Place,
    subject: Subject,
    numbers: u64,
    steps: u64,
    moments: Vec<u64>,
}

/// Numbers of a training between two steps.
pub(crate) struct State {
    /// Where it is.
    pub place: Place,
    /// Of the network.
    pub network: Vec<f32>,
    /// Of the network with the least validation loss.
    pub best: Vec<f32>,
    /// Steps that the optimiser took.
    pub steps: u64,
    /// Its moments.
    pub moments: Vec<Vec<f32>>,
}

/// Bytes that are no checkpoint, or one of something else.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CheckpointError {
    /// Cut short, or not a checkpoint of this version.
    #[error("checkpoint: {0}")]
    Bytes(&'static str),
    /// Of another training.
    #[error("checkpoint: of another training: {}", .0.join("; "))]
    Other(
        /// Each field that differs, with both values.
        Vec<String>,
    ),
}

/// Writes a checkpoint.
pub(crate) fn write(subject: &Subject, state: &State) -> Vec<u8> {
    let head = Head {
        place: state.place.clone(),
        subject: subject.clone(),
        numbers: state.network.len() as u64,
        steps: state.steps,
        moments: state.moments.iter().map(|m| m.len() as u64).collect(),
    };
    let head = toml::to_string(&head).expect("a head is plain numbers and names");
    let mut bytes = Vec::new();
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&VERSION.to_le_bytes());
    bytes.extend_from_slice(&(head.len() as u32).to_le_bytes());
    bytes.extend_from_slice(head.as_bytes());
    for numbers in [&state.network, &state.best].into_iter().chain(&state.moments) {
        bytes.extend(numbers.iter().flat_map(|x| x.to_le_bytes()));
    }
    bytes
}

/// Reads a checkpoint of this training.
pub(crate) fn read(bytes: &[u8], subject: &Subject) -> Result<State, CheckpointError> {
    let (head, numbers) = split(bytes)?;
    let differences = differences(subject, &head.subject);
    if !differences.is_empty() {
        return Err(CheckpointError::Other(differences));
    }
    let mut numbers = numbers.into_iter();
    let mut take = |len: u64| numbers.by_ref().take(len as usize).collect::<Vec<f32>>();
    Ok(State {
        network: take(head.numbers),
        best: take(head.numbers),
        moments: head.moments.iter().map(|&len| take(len)).collect(),
        steps: head.steps,
        place: head.place,
    })
}

/// Refuses numbers that are not as many as a network has.
pub(crate) fn fits(state: &State, network: &Network) -> Result<(), CheckpointError> {
    let fits = state.network.len() == network.numbers().len();
    if fits { Ok(()) } else { Err(CheckpointError::Bytes("its network is of another size")) }
}

/// Head and numbers, as many as the head says.
fn split(bytes: &[u8]) -> Result<(Head, Vec<f32>), CheckpointError> {
    use CheckpointError::Bytes;
    let rest = bytes.strip_prefix(MAGIC).ok_or(Bytes("these bytes are none"))?;
    let (version, rest) = word(rest)?;
    if version != VERSION {
        return Err(Bytes("written by another version"));
    }
    let (len, rest) = word(rest)?;
    let (head, rest) = rest.split_at_checked(len as usize).ok_or(CUT)?;
    let head = std::str::from_utf8(head).map_err(|_| Bytes("its head is no text"))?;
    let head: Head = toml::from_str(head).map_err(|_| Bytes("its head lacks a field"))?;
    let moments: u64 = head.moments.iter().sum();
    if rest.len() as u64 != 4 * (2 * head.numbers + moments) {
        return Err(CUT);
    }
    let numbers = rest.as_chunks().0.iter().map(|&x| f32::from_le_bytes(x)).collect();
    Ok((head, numbers))
}

const CUT: CheckpointError = CheckpointError::Bytes("it was cut short");

fn word(bytes: &[u8]) -> Result<(u32, &[u8]), CheckpointError> {
    let (word, rest) = bytes.split_first_chunk().ok_or(CUT)?;
    Ok((u32::from_le_bytes(*word), rest))
}

/// Fields that are not the same, with the value wanted and the one found.
fn differences(wanted: &Subject, found: &Subject) -> Vec<String> {
    let table = |s: &Subject| {
        let mut fields = Vec::new();
        let value = toml::Value::try_from(s).expect("a subject is plain numbers and names");
        flatten("", &value, &mut fields);
        fields
    };
    let (wanted, found) = (table(wanted), table(found));
    let absent = "absent";
    let value = |of: &[(String, String)], key: &str| {
        of.iter().find(|(k, _)| k == key).map_or(absent.to_string(), |(_, v)| v.clone())
    };
    let mut keys: Vec<&String> = wanted.iter().chain(&found).map(|(k, _)| k).collect();
    keys.sort_unstable();
    keys.dedup();
    let differing = keys.into_iter().filter(|k| value(&wanted, k) != value(&found, k));
    differing
        .map(|k| format!("{k} is {}, the checkpoint has {}", value(&wanted, k), value(&found, k)))
        .collect()
}

fn flatten(path: &str, value: &toml::Value, into: &mut Vec<(String, String)>) {
    match value {
        toml::Value::Table(table) => {
            for (key, value) in table {
                let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                flatten(&path, value, into);
            }
        }
        value => into.push((path.to_string(), value.to_string())),
    }
}
