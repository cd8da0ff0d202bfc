//! A training between two steps, as bytes: a resumed training has the same result.
//! PURE. Uses: toml for the head. Never: files.
//!
//! `palpate-nets`, a version, the length of the head (both u32, little-endian), the head as TOML,
//! then f32 little-endian: the numbers of the network, of the best one so far, and the moments.
//! Chance needs no state: order and noise are functions of seed, epoch and sample.

use serde::{Deserialize, Serialize};

use crate::error::CheckpointError;
use crate::network::Network;
use crate::recipe::Recipe;

const CHECKPOINT_MAGIC: &[u8; 12] = b"palpate-nets";
const CHECKPOINT_VERSION: u32 = 1;

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

/// Identity of a training: a checkpoint can be resumed only if all of this is equal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Subject {
    /// Recipe of the training.
    pub recipe: Recipe,
    /// Names of its data, as the caller states them.
    pub data: String,
    /// Number of channels of an input.
    pub channels: usize,
    /// Length of a target.
    pub target: usize,
    /// Number of training samples in an epoch.
    pub samples: u64,
    /// Number of validation samples.
    pub validation_samples: u64,
}

/// Position of a training.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// Number of the current epoch, from 0.
    pub epoch: u32,
    /// Number of batches of this epoch that are learned.
    pub batches: u64,
    /// Sum of their losses, as minimised.
    pub loss_sum: f64,
    /// Losses of the earlier epochs.
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

/// State of a training between two steps.
pub struct State {
    /// Position in the recipe's epochs.
    pub place: Place,
    /// Numbers of the network.
    pub network: Vec<f32>,
    /// Numbers of the network with the least validation loss.
    pub best: Vec<f32>,
    /// Number of steps of the optimiser.
    pub steps: u64,
    /// Moments of the optimiser.
    pub moments: Vec<Vec<f32>>,
}

/// Writes a checkpoint.
pub fn write(subject: &Subject, state: &State) -> Vec<u8> {
    let head = Head {
        place: state.place.clone(),
        subject: subject.clone(),
        numbers: state.network.len() as u64,
        steps: state.steps,
        moments: state.moments.iter().map(|m| m.len() as u64).collect(),
    };
    let head = toml::to_string(&head).expect("a head is plain numbers and names");
    let mut bytes = Vec::new();
    bytes.extend_from_slice(CHECKPOINT_MAGIC);
    bytes.extend_from_slice(&CHECKPOINT_VERSION.to_le_bytes());
    bytes.extend_from_slice(&(head.len() as u32).to_le_bytes());
    bytes.extend_from_slice(head.as_bytes());
    for numbers in [&state.network, &state.best].into_iter().chain(&state.moments) {
        bytes.extend(numbers.iter().flat_map(|x| x.to_le_bytes()));
    }
    bytes
}

/// Reads a checkpoint of this training.
///
/// # Errors
/// `CheckpointError` if the bytes are damaged, or of another training.
pub fn read(bytes: &[u8], subject: &Subject) -> Result<State, CheckpointError> {
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

/// Checks that the lengths match those of a network.
///
/// # Errors
/// `CheckpointError::Bytes` if they do not.
pub fn fits(state: &State, network: &Network) -> Result<(), CheckpointError> {
    let fits = state.network.len() == network.numbers().len();
    if fits { Ok(()) } else { Err(CheckpointError::Bytes("the size of its network differs")) }
}

/// Splits into the head and the numbers that it announces.
fn split(bytes: &[u8]) -> Result<(Head, Vec<f32>), CheckpointError> {
    use CheckpointError::Bytes;
    let rest =
        bytes.strip_prefix(CHECKPOINT_MAGIC).ok_or(Bytes("the bytes are not a checkpoint"))?;
    let (version, rest) = word(rest)?;
    if version != CHECKPOINT_VERSION {
        return Err(Bytes("it was written by another version"));
    }
    let (len, rest) = word(rest)?;
    let (head, rest) = rest.split_at_checked(len as usize).ok_or(CUT)?;
    let head = std::str::from_utf8(head).map_err(|_| Bytes("its head is not text"))?;
    let head: Head = toml::from_str(head).map_err(|_| Bytes("its head lacks a field"))?;
    let moments: u64 = head.moments.iter().sum();
    if rest.len() as u64 != 4 * (2 * head.numbers + moments) {
        return Err(CUT);
    }
    let numbers = rest.as_chunks().0.iter().map(|&x| f32::from_le_bytes(x)).collect();
    Ok((head, numbers))
}

const CUT: CheckpointError = CheckpointError::Bytes("it is truncated");

fn word(bytes: &[u8]) -> Result<(u32, &[u8]), CheckpointError> {
    let (word, rest) = bytes.split_first_chunk().ok_or(CUT)?;
    Ok((u32::from_le_bytes(*word), rest))
}

/// Fields that differ, with the expected and the found value.
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
