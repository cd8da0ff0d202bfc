//! The names that requests and answers use, with what they mean, and the limits of a simulation.
//! Uses: the lists of the other chapters. Never: what serves, what is stored, a copy of a list.

use axum::Json;
use serde::Serialize;
use utoipa::ToSchema;

use super::limits::SIMULATED_CONTACTS;
use crate::campaign::bench::interlock::TripKind;
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::shown::status::Phase;
use crate::dataset::force_map::TABLE_IV_MAPS;
use crate::dataset::format::Format;
use crate::evaluate::request::Scored;
use crate::event::{Importance, KINDS};
use crate::infer::methods::Method;
use crate::infer::slot::Slot;
use crate::learn::task::NetTask;
use crate::record::Flag;
use crate::simulate::contacts::FORCE_MAX_N;
use crate::state::PausedWhy;
use crate::store::Role;

/// The names that requests and answers use, with what they mean.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Vocabulary {
    /// Methods from a frame to contacts that serve, the best last.
    pub methods: Vec<MethodWord>,
    /// What an evaluation can score.
    pub scored: Vec<ScoredWord>,
    /// Slots for promotions.
    pub slots: Vec<SlotWord>,
    /// Tasks of nets.
    pub tasks: Vec<Word>,
    /// File formats of datasets and exports.
    pub formats: Vec<FormatWord>,
    /// Force maps of the paper's Table IV.
    pub maps: Vec<MapWord>,
    /// Flags of trials.
    pub flags: Vec<Word>,
    /// Kinds of events.
    pub events: Vec<EventWord>,
    /// Kinds of trips, with what to do.
    pub trips: Vec<Word>,
    /// Reasons why a run waits, as clauses.
    pub pauses: Vec<Word>,
    /// Activities of a run.
    pub phases: Vec<Word>,
    /// States of the rig, as sentences.
    pub rig_states: Vec<Word>,
    /// Roles of keys; each has the rights of the previous ones.
    pub roles: Vec<Word>,
    /// Limits of a simulation.
    pub simulation: SimulationLimits,
}

/// A name and what it means.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct Word {
    /// Name in requests and answers.
    pub name: &'static str,
    /// What it means, in one line.
    pub about: &'static str,
}

/// A method from a frame to contacts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct MethodWord {
    /// Name in requests.
    pub name: &'static str,
    /// What it does, in one line.
    pub about: &'static str,
    /// Slots that it uses.
    pub uses: Vec<Slot>,
    /// Slots without which it has no answer.
    pub needs: Vec<Slot>,
}

/// What an evaluation can score.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct ScoredWord {
    /// Name in requests.
    pub name: &'static str,
    /// What is scored, in one line.
    pub about: &'static str,
    /// Slots that it uses.
    pub uses: Vec<Slot>,
    /// Keys of a request that name its models.
    pub models: Vec<ModelKey>,
    /// Whether it states the standard deviation of each contact, which `place_sd_mm` of a request limits.
    pub states_sd: bool,
    /// Name of the dataset on which the paper scores it; null if it does not.
    pub dataset: Option<&'static str>,
}

/// A key of a request for an evaluation that names a model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct ModelKey {
    /// Name of the key.
    pub key: &'static str,
    /// Slots of the models that it can name.
    pub slots: Vec<Slot>,
    /// Whether a request must have it.
    pub required: bool,
}

/// A slot for promotions.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct SlotWord {
    /// Name in requests.
    pub name: Slot,
    /// What it holds.
    pub title: &'static str,
    /// What it is used for, in one line.
    pub about: &'static str,
    /// Methods that use it and serve.
    pub methods: Vec<&'static str>,
    /// Tasks of the nets that it takes; empty for the skin, which is a calibration.
    pub tasks: Vec<&'static str>,
}

/// A file format.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct FormatWord {
    /// Name in requests.
    pub name: &'static str,
    /// Name for people.
    pub title: &'static str,
    /// Extension of file names, without the dot.
    pub extension: &'static str,
    /// What it is, in one line.
    pub about: &'static str,
    /// Whether it is written row by row: pages, answers to queries, and recordings may be in it.
    pub streams: bool,
    /// Whether numbers are written as text: a cut file has whole rows up to its last line.
    pub is_text: bool,
}

/// A force map.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct MapWord {
    /// Name in requests: pixel and diameter, mm, as `4x20`.
    pub name: String,
    /// Side of a pixel, mm.
    pub pixel_mm: f64,
    /// Diameter over which the force of a contact is distributed, mm.
    pub diameter_mm: f64,
}

/// A kind of events.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct EventWord {
    /// Name of the kind.
    pub name: &'static str,
    /// What it reports, in one line.
    pub about: &'static str,
    /// Largest importance of such an event; each event states its own.
    pub importance: Importance,
}

/// Limits of a simulation of contacts; a depth is at most the thickness of the foam.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct SimulationLimits {
    /// Largest number of contacts.
    pub contacts_max: usize,
    /// Largest force of a contact, N.
    pub force_max_n: f64,
}

/// Returns the names that requests and answers use, with what they mean.
#[utoipa::path(get, operation_id = "vocabulary", path = "/api/v1/vocabulary", tag = "health",
    responses((status = 200, body = Vocabulary)))]
pub async fn vocabulary() -> Json<Vocabulary> {
    Json(Vocabulary {
        methods: Method::served().map(MethodWord::from).collect(),
        scored: Scored::all().map(ScoredWord::from).collect(),
        slots: Slot::ALL.iter().copied().map(SlotWord::from).collect(),
        tasks: words(NetTask::ALL, NetTask::as_str, NetTask::about),
        formats: Format::ALL.map(FormatWord::from).into(),
        maps: TABLE_IV_MAPS
            .map(|map| MapWord {
                name: map.to_string(),
                pixel_mm: map.pixel_mm,
                diameter_mm: map.diameter_mm,
            })
            .into(),
        flags: words(Flag::ALL, Flag::as_str, Flag::about),
        events: KINDS
            .map(|kind| EventWord { name: kind.name, about: kind.about, importance: kind.most })
            .into(),
        trips: words(TripKind::ALL, TripKind::name, TripKind::about),
        pauses: words(PausedWhy::ALL, PausedWhy::as_str, PausedWhy::about),
        phases: words(Phase::ALL, Phase::as_str, Phase::about),
        rig_states: words(RigState::ALL, RigState::as_str, RigState::about),
        roles: words(&Role::ALL, Role::as_str, Role::about),
        simulation: SimulationLimits { contacts_max: SIMULATED_CONTACTS, force_max_n: FORCE_MAX_N },
    })
}

/// The names of a list, each with what it means.
fn words<T: Copy>(
    all: &[T],
    name: fn(T) -> &'static str,
    about: fn(T) -> &'static str,
) -> Vec<Word> {
    all.iter().map(|&one| Word { name: name(one), about: about(one) }).collect()
}

impl From<Method> for MethodWord {
    fn from(method: Method) -> Self {
        Self {
            name: method.name(),
            about: method.about(),
            uses: method.slots().to_vec(),
            needs: method.needs().collect(),
        }
    }
}

impl From<Scored> for ScoredWord {
    fn from(scored: Scored) -> Self {
        Self {
            name: scored.name(),
            about: scored.about(),
            uses: scored.slots().to_vec(),
            models: ModelKey::of(scored),
            states_sd: scored.is_fit(),
            dataset: scored.usual_dataset(),
        }
    }
}

impl ModelKey {
    /// The keys of what is scored: one for each slot that it uses, or `net`.
    fn of(scored: Scored) -> Vec<Self> {
        if scored == Scored::Quantity {
            let slots = Slot::ALL.iter().copied().filter(|slot| slot.is_quantity()).collect();
            return vec![Self { key: "net", slots, required: true }];
        }
        let of_slot = |slot: &Slot| Self {
            key: slot.name(),
            slots: vec![*slot],
            required: scored.named_slots().contains(slot),
        };
        scored.slots().iter().map(of_slot).collect()
    }
}

impl From<Slot> for SlotWord {
    fn from(slot: Slot) -> Self {
        let uses = Method::served().filter(|method| method.slots().contains(&slot));
        let takes = NetTask::ALL.iter().copied().filter(|task| Slot::of(*task) == slot);
        Self {
            name: slot,
            title: slot.title(),
            about: slot.about(),
            methods: uses.map(Method::name).collect(),
            tasks: takes.map(NetTask::as_str).collect(),
        }
    }
}

impl From<Format> for FormatWord {
    fn from(format: Format) -> Self {
        Self {
            name: format.name(),
            title: format.title(),
            extension: format.extension(),
            about: format.about(),
            streams: format.streams(),
            is_text: format.is_text(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn each_list_has_what_its_definition_has() {
        let Json(words) = vocabulary().await;
        let methods: Vec<&str> = words.methods.iter().map(|method| method.name).collect();
        assert_eq!(methods, ["paper", "fast", "exact"]);
        let needs: Vec<&[Slot]> = words.methods.iter().map(|method| &*method.needs).collect();
        assert_eq!(needs, [&[Slot::Map][..], &[Slot::Points], &[Slot::Skin]]);
        let [transfer, map, points, skin, quantities @ ..] = &words.slots[..] else {
            panic!("at least four slots")
        };
        assert_eq!((&*transfer.methods, &*transfer.tasks), (&["paper"][..], &["transfer"][..]));
        assert_eq!(map.tasks, ["recon", "end-to-end"]);
        assert_eq!(points.methods, ["fast", "exact"]);
        assert!(skin.tasks.is_empty());
        let named = |slot: &SlotWord| slot.methods.is_empty() && slot.tasks == [slot.name.name()];
        assert!(quantities.len() == 4 && quantities.iter().all(named));
        let fast = words.scored.iter().find(|scored| scored.name == "fast").unwrap();
        let points = ModelKey { key: "points", slots: vec![Slot::Points], required: true };
        assert_eq!((&*fast.models, fast.dataset), (&[points][..], Some("real-unseen")));
        let exact = words.scored.iter().find(|scored| scored.name == "exact").unwrap();
        assert!(exact.states_sd && !fast.states_sd);
        assert!(exact.models.iter().all(|model| !model.required), "the serving skin is used");
        let quantity = words.scored.iter().find(|scored| scored.name == "quantity").unwrap();
        assert_eq!((quantity.models[0].key, quantity.models[0].slots.len()), ("net", 4));
        assert_eq!((words.maps.len(), words.maps[0].name.as_str()), (12, "4x20"));
        let flags: Vec<&str> = words.flags.iter().map(|flag| flag.name).collect();
        assert!(flags.contains(&"still_cell") && flags.len() == Flag::ALL.len());
        assert_eq!(words.trips[6].name, "stale");
        assert_eq!((words.pauses[1].name, words.pauses.len()), ("tip_change", 6));
        assert_eq!((words.rig_states[1].name, words.rig_states.len()), ("disarmed", 5));
        let named = words.phases.iter().map(|phase| serde_json::json!(phase.name));
        assert!(named.eq(Phase::ALL.iter().map(|phase| serde_json::json!(phase))));
        assert_eq!(
            words.roles.iter().map(|role| role.name).collect::<Vec<_>>(),
            ["viewer", "operator", "admin"]
        );
    }
}
