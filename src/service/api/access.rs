//! What an operation needs before its handler runs: role, lock, largest body, lateness, repetitions, entity tags.
//! Uses: the roles of `store`. Never: an operation (`routes` has their table).

use crate::store::Role;

/// What an operation needs before its handler runs.
#[derive(Debug, Clone, Copy)]
pub struct Needs {
    /// Who may ask for it.
    pub access: Access,
    /// How the operator lock of another person affects it.
    pub lock: Lock,
    /// Its name in the log of actions; `None`: it is not logged.
    pub action: Option<&'static str>,
    /// Largest body, bytes.
    pub body_max_bytes: usize,
    /// Whether it opens a WebSocket, for which a ticket may stand for the key.
    pub socket: bool,
    /// Whether it is carried out once per `Idempotency-Key`: it creates or starts something. Not those
    /// that must not wait for a write (actions on runs, the e-stop), whose responses must not be stored
    /// (keys, tickets), that are uploads, which are refused or without effect when repeated, or that have
    /// the same effect when repeated.
    pub once: bool,
    /// Whether it may move an axis: it is refused if it comes late (`in_time`), or its handler refuses those of its
    /// actions that the operator lock refuses.
    pub moves: bool,
    /// What it shows (GET) or changes (other methods), with an entity tag.
    pub edited: Option<Edited>,
}

/// Who may ask for an operation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// Everybody, without a key.
    Open,
    /// A valid key of any role, checked by the handler before anything else: the e-stop.
    Stop,
    /// This role, or a higher one.
    From(Role),
}

/// How the operator lock of another person affects an operation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lock {
    /// Not at all.
    Ignored,
    /// It refuses the operation.
    Refuses,
    /// It refuses some actions of the operation; the handler decides.
    RefusesSome,
    /// Not at all, nor does the number of requests in progress: it ends a motion.
    Stops,
}

/// A thing that two people may edit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Edited {
    /// The operator lock.
    Lock,
    /// The queue of runs.
    Queue,
    /// The serving models.
    Serving,
}
