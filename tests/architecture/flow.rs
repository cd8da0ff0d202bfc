//! The flow: chapters, their modules and the shelves of the store, in the order in which imports look back.
//! PURE. Never: a rule.

/// Chapters of `src/`, and the studies next to it, each a crate, with their modules in the order in which
/// data flows; imports only look back along it. `store` is a module that fills its chapter; `cli` is in
/// the root's crate.
pub const CHAPTERS: [(&str, &[&str]); 9] = [
    ("words", &VOCABULARY),
    ("bench", &["schedule", "rig", "campaign"]),
    ("store", &["store"]),
    ("model", &["figure", "calibrate", "chunk", "simulate", "overlay"]),
    ("data", &["dataset", "query"]),
    ("touch", &["learn", "infer", "evaluate", "jobs"]),
    ("service", &["conductor", "twins", "placement", "api"]),
    ("studies", &STUDIES),
    ("cli", &["cli"]),
];

/// The studies, after what they have in common.
pub const STUDIES: [&str; 12] = [
    "lab",
    "budget",
    "sheet",
    "rows",
    "simulation",
    "method",
    "quantity",
    "transfer",
    "maps",
    "noise",
    "factorial",
    "unseen",
];

/// What everything may use and what uses nothing but each other.
pub const VOCABULARY: [&str; 23] = [
    "carried",
    "chance",
    "clock",
    "commit",
    "difference",
    "digest",
    "event",
    "file_kind",
    "ids",
    "journal",
    "locate",
    "near",
    "new_file",
    "plain",
    "priority",
    "problem",
    "program",
    "query_lines",
    "record",
    "state",
    "suspension",
    "syntax",
    "toml_words",
];

/// Which chapters a chapter's `Cargo.toml` may name. What the stage does is known to the service alone: a
/// change of the campaign does not build the nets again. No chapter of `src/` may name the studies: only
/// the command line, in the root's crate, uses them.
pub const ARROWS: [(&str, &[&str]); 8] = [
    ("words", &[]),
    ("bench", &["words"]),
    ("store", &["words"]),
    ("model", &["words"]),
    ("data", &["words", "store", "model"]),
    ("touch", &["words", "store", "model", "data"]),
    ("service", &["words", "bench", "store", "model", "data", "touch"]),
    ("studies", &["words", "bench", "store", "model", "data", "touch"]),
];

/// Folders of `src/store/`, in the order in which their imports look back.
pub const SHELVES: [&str; 4] = ["core", "table", "bench", "lab"];
