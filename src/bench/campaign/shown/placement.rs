//! The confirmation of a placement of weights: who placed them, and the verdict.
//! PURE. Uses: nothing of the rig. Never: the judgement itself (the service makes it).

use serde::{Deserialize, Serialize};
use serde_json::json;
use strum::IntoStaticStr;
use utoipa::ToSchema;

/// Whether the estimated contacts agree with the requested weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, IntoStaticStr)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum VerdictKind {
    /// Every weight is felt near its point, with about its force, and nothing else is felt.
    Right,
    /// The skin contradicts the placement.
    Wrong,
    /// The skin is not at rest, or what it feels is not certain enough for a judgement.
    Unsure,
    /// No model serves: the placement is not judged.
    Unknown,
}

impl VerdictKind {
    /// Name of the verdict, as stored and shown.
    pub fn as_str(self) -> &'static str {
        self.into()
    }
}

/// A person's confirmation of what a run waits for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Confirmation {
    /// Name of the person.
    pub who: String,
    /// Verdict on the placement; `Unknown` if it was not judged.
    pub verdict: VerdictKind,
    /// Whether the person asked for it to be stored whatever the verdict.
    pub anyway: bool,
}

impl Confirmation {
    /// A confirmation without a judgement.
    pub fn of(who: String) -> Self {
        Self { who, verdict: VerdictKind::Unknown, anyway: false }
    }

    /// Whether the skin contradicts what is confirmed.
    pub fn is_doubted(&self) -> bool {
        self.verdict == VerdictKind::Wrong
    }

    /// Data of the event `placed`.
    pub fn event(&self, trial: u32) -> serde_json::Value {
        json!({ "trial": trial, "who": self.who, "verdict": self.verdict, "anyway": self.anyway })
    }
}
