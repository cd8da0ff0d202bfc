//! Ids as types, so that the id of a run cannot be passed as that of a trial.
//! Uses: uuid. Never: storage.

use serde::{Deserialize, Serialize};
use uuid::Uuid;

/// Id of one execution of an experiment; UUIDv7, so that ids sort by time.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    Hash,
    PartialOrd,
    Ord,
    Serialize,
    Deserialize,
    utoipa::ToSchema,
)]
#[serde(transparent)]
pub struct RunUid(pub Uuid);

impl RunUid {
    /// Creates a new id.
    pub fn new() -> Self {
        Self(Uuid::now_v7())
    }
}

impl Default for RunUid {
    fn default() -> Self {
        Self::new()
    }
}

impl std::fmt::Display for RunUid {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.hyphenated().fmt(f)
    }
}

impl std::str::FromStr for RunUid {
    type Err = uuid::Error;
    fn from_str(s: &str) -> Result<Self, Self::Err> {
        Uuid::parse_str(s).map(Self)
    }
}

/// Id of a stored trial.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    Hash,
    PartialOrd,
    Ord,
    Serialize,
    Deserialize,
    utoipa::ToSchema,
)]
#[serde(transparent)]
pub struct TrialId(pub i64);

/// Key of a trial in its run. At most one accepted trial is stored per key.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    Hash,
    PartialOrd,
    Ord,
    Serialize,
    Deserialize,
    utoipa::ToSchema,
)]
pub struct TrialKey {
    /// Index of the configuration in the plan of the run.
    pub configuration: u32,
    /// Index of the depth in the configuration.
    pub depth_index: u32,
}
