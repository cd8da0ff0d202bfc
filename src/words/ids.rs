//! Ids as types, so that the id of a run cannot be passed as that of a trial.
//! Uses: uuid. Never: storage, the hash that an id contains.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use uuid::Uuid;

/// Id of one execution of an experiment; UUIDv7, so that ids sort by time.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, ToSchema,
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

/// Id of a queued task: `ex-` (an export) or `job-` (a training or an evaluation), and a UUIDv7, so
/// that the ids of one queue sort by time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub enum TaskId {
    /// Id of an export.
    Export(Uuid),
    /// Id of a job.
    Job(Uuid),
}

impl TaskId {
    const EXPORT: &str = "ex-";
    const JOB: &str = "job-";

    /// Creates the id of a new export.
    pub fn new_export() -> Self {
        Self::Export(Uuid::now_v7())
    }

    /// Creates the id of a new job.
    pub fn new_job() -> Self {
        Self::Job(Uuid::now_v7())
    }
}

impl std::fmt::Display for TaskId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (prefix, uuid) = match self {
            Self::Export(uuid) => (Self::EXPORT, uuid),
            Self::Job(uuid) => (Self::JOB, uuid),
        };
        write!(f, "{prefix}{}", uuid.hyphenated())
    }
}

/// The text is not the id of a task.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not the id of a task: ex- or job-, and a UUID")]
pub struct NotATaskId(String);

impl std::str::FromStr for TaskId {
    type Err = NotATaskId;
    fn from_str(s: &str) -> Result<Self, Self::Err> {
        let id = if let Some(uuid) = s.strip_prefix(Self::EXPORT) {
            Uuid::parse_str(uuid).map(Self::Export)
        } else {
            Uuid::parse_str(s.strip_prefix(Self::JOB).unwrap_or_default()).map(Self::Job)
        };
        // One text per id: no upper case, no braces.
        id.ok().filter(|id| id.to_string() == s).ok_or_else(|| NotATaskId(s.into()))
    }
}

impl From<TaskId> for String {
    fn from(id: TaskId) -> Self {
        id.to_string()
    }
}

impl TryFrom<String> for TaskId {
    type Error = NotATaskId;
    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

/// Id of a stored trial.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, ToSchema,
)]
#[serde(transparent)]
pub struct TrialId(pub i64);

/// Key of a trial in its run. At most one accepted trial is stored per key.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, ToSchema,
)]
pub struct TrialKey {
    /// Index of the configuration in the plan of the run.
    pub configuration: u32,
    /// Index of the depth in the configuration.
    pub depth_index: u32,
}

/// Text that is not an id of the needed kind.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{kind} = {text}: must be an id, {start}..")]
pub struct IdError {
    /// Thing that the id denotes.
    kind: &'static str,
    /// Text that was read as an id.
    text: String,
    /// Start of each id of this kind.
    start: &'static str,
}

/// Declares ids that are text: each a type, with the thing that it denotes and the start of its
/// text. JSON, TOML and the database contain the text alone.
macro_rules! text_ids {
    ($($(#[$doc:meta])* $name:ident: $kind:literal, $start:literal;)*) => {$(
        $(#[$doc])*
        #[derive(
            Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema,
        )]
        #[serde(transparent)]
        pub struct $name(String);

        impl $name {
            /// Returns text as an id without a check: for the code that makes the id, and for text
            /// that is checked when the id is looked up.
            pub fn unchecked(text: impl Into<String>) -> Self {
                Self(text.into())
            }

            /// Text of the id.
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.pad(&self.0)
            }
        }

        impl std::str::FromStr for $name {
            type Err = IdError;
            fn from_str(text: &str) -> Result<Self, Self::Err> {
                let (kind, start) = ($kind, $start);
                if text.starts_with(start) {
                    Ok(Self(text.to_owned()))
                } else {
                    Err(IdError { kind, text: text.to_owned(), start })
                }
            }
        }
    )*};
}

text_ids! {
    /// Id of a dataset: `ds-` and the first digits of the sha256 of its contents.
    DatasetId: "dataset", "ds-";
    /// Id of a trained net: `mdl-` and the first digits of the sha256 of its facts and its file.
    ModelId: "model", "mdl-";
    /// Id of a calibration: `cal-` and the first digits of a sha256; sim-core determines it.
    CalibrationId: "calibration", "cal-";
}

/// What a promotion puts into a slot. Its text is that of the id.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub enum PromotedId {
    /// A net, by its id.
    Model(ModelId),
    /// A calibration: the skin of the exact method.
    Calibration(CalibrationId),
}

impl PromotedId {
    /// Text of the id.
    pub fn as_str(&self) -> &str {
        match self {
            Self::Model(id) => id.as_str(),
            Self::Calibration(id) => id.as_str(),
        }
    }
}

impl From<String> for PromotedId {
    fn from(text: String) -> Self {
        match text.parse() {
            Ok(id) => Self::Calibration(id),
            Err(_) => Self::Model(ModelId::unchecked(text)),
        }
    }
}

impl From<PromotedId> for String {
    fn from(id: PromotedId) -> Self {
        id.as_str().to_owned()
    }
}

impl std::fmt::Display for PromotedId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_id_is_its_text_in_json() {
        let id: DatasetId = "ds-1".parse().unwrap();
        assert_eq!(serde_json::to_string(&id).unwrap(), "\"ds-1\"");
        assert_eq!(serde_json::from_str::<DatasetId>("\"ds-1\"").unwrap(), id);
        assert_eq!(format!("{id:<6}|"), "ds-1  |");
    }

    #[test]
    fn text_of_another_kind_is_refused() {
        let error = "mdl-1".parse::<DatasetId>().unwrap_err().to_string();
        assert_eq!(error, "dataset = mdl-1: must be an id, ds-..");
    }

    #[test]
    fn a_promoted_id_is_a_calibration_by_its_start() {
        let of = |text: &str| serde_json::from_value::<PromotedId>(text.into()).unwrap();
        assert_eq!(of("cal-1"), PromotedId::Calibration(CalibrationId::unchecked("cal-1")));
        assert_eq!(of("mdl-1"), PromotedId::Model(ModelId::unchecked("mdl-1")));
        assert_eq!(serde_json::to_string(&of("cal-1")).unwrap(), "\"cal-1\"");
    }

    #[test]
    fn the_id_of_a_task_has_one_text() {
        for id in [TaskId::new_export(), TaskId::new_job()] {
            assert_eq!(id.to_string().parse(), Ok(id));
            let json = serde_json::to_string(&id).unwrap();
            assert_eq!(json, format!("\"{id}\""));
            assert_eq!(serde_json::from_str::<TaskId>(&json).unwrap(), id);
            assert!(id.to_string().to_uppercase().parse::<TaskId>().is_err());
        }
        let uuid = "0190a0a0-0000-7000-8000-00000000000a";
        assert!(format!("ex-{uuid}").parse::<TaskId>().is_ok());
        for text in [
            uuid.to_owned(),
            format!("ex-{}", uuid.to_uppercase()),
            format!("job-{{{uuid}}}"),
            format!("ds-{uuid}"),
            "ex-1".to_owned(),
            "job-".to_owned(),
            String::new(),
        ] {
            assert!(text.parse::<TaskId>().is_err(), "{text}");
        }
    }
}
