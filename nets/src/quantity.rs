//! Quantities that a net may answer in place of a force map or a frame: few numbers for a whole frame.
//! PURE. Never: how they follow from contacts (the owner of the data knows them).

use serde::{Deserialize, Serialize};

/// What a frame is answered with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Quantity {
    /// Position of the one contact, mm: x, y.
    Position,
    /// Which of the known places are pressed: one number for each, above zero if it is.
    Pattern,
    /// Number of contacts.
    Count,
    /// Sum of the contacts' forces, N.
    Force,
}

impl Quantity {
    /// All quantities, in the order of their declaration.
    pub const ALL: [Self; 4] = [Self::Position, Self::Pattern, Self::Count, Self::Force];

    /// Name in recipes, manifests and commands.
    pub fn name(self) -> &'static str {
        match self {
            Self::Position => "position",
            Self::Pattern => "pattern",
            Self::Count => "count",
            Self::Force => "force",
        }
    }

    /// Length of an answer; `places`: the number of known places.
    pub fn len(self, places: usize) -> usize {
        match self {
            Self::Position => 2,
            Self::Pattern => places,
            Self::Count | Self::Force => 1,
        }
    }
}
