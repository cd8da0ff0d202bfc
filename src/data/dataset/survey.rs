//! The first pass over the trials of a dataset's runs: labels, parts, and reasons of exclusion.
//! PURE. Uses: `store`'s rows, `dataset::{definition, split, filter, batch}`. Never: frames.

use std::collections::{BTreeMap, HashMap};

use arrow_schema::{ArrowError, SchemaRef};

use super::batch::{self, Row};
use super::definition::{Choice, Definition, SplitBy};
use super::filter::mask;
use super::split::{Group, Part, divide, place};
use crate::ids::TrialId;
use crate::store::{Condition, RunKind, RunRow, TipsAsContacts, TrialRow};

/// Why a row is excluded whose file states no part.
pub const NO_PART: &str = "no imported part";
/// Why a row is excluded whose file states no tag.
pub const NO_TAG: &str = "no imported tag";

/// Applies the deadband of a definition, if it has one, to contacts and contact count of a Real-Hex or an
/// imported trial; imported contacts without a force remain. Placed weights are known and remain.
pub fn label(trial: &mut TrialRow, definition: &Definition, run: &RunRow) {
    let Some(deadband_n) = definition.deadband_n else { return };
    match trial.kind {
        RunKind::RealHex => {
            let tips = TipsAsContacts { deadband_n, diameter_mm: run.tip_diameter_mm };
            trial.contacts = tips.of(&trial.arms);
        }
        RunKind::Imported => {
            trial.contacts.retain(|c| c.force_n.is_none_or(|force_n| force_n >= deadband_n));
        }
        RunKind::RealRandom => return,
    }
    trial.contact_count = trial.contacts.len() as u8;
}

/// A selected trial of the first pass.
#[derive(Debug, Clone, Copy)]
struct Selected {
    trial: TrialId,
    /// Index of its group; `None` if its part is fixed, or there are no parts.
    group: Option<usize>,
    /// Part that its run or its file determines.
    fixed: Option<Part>,
}

/// The first pass, page by page.
#[derive(Debug)]
pub struct Survey<'a> {
    definition: &'a Definition,
    filters: Vec<Condition>,
    schema: SchemaRef,
    model: Option<&'a str>,
    selected: Vec<Selected>,
    /// Groups of all trials, excluded ones included: the parts do not depend on what is excluded.
    groups: Vec<Group>,
    by_place: HashMap<u128, usize>,
    excluded: BTreeMap<String, u64>,
}

/// Result of a survey.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Surveyed {
    /// The selected trials in the order in which they were pushed, each with its part.
    pub kept: Vec<(TrialId, Option<Part>)>,
    /// Number of excluded trials by reason.
    pub excluded: BTreeMap<String, u64>,
}

impl<'a> Survey<'a> {
    /// Starts a survey. `schema` holds the columns that conditions need; twins of another model
    /// than `model` count as absent.
    pub fn new(definition: &'a Definition, schema: SchemaRef, model: Option<&'a str>) -> Self {
        Self {
            definition,
            filters: definition.filters(),
            schema,
            model,
            selected: Vec::new(),
            groups: Vec::new(),
            by_place: HashMap::new(),
            excluded: BTreeMap::new(),
        }
    }

    /// Adds trials of a run as they are stored, and labels them.
    ///
    /// # Errors
    /// `ArrowError` if the trials do not fit the columns.
    pub fn push(&mut self, run: &RunRow, trials: Vec<TrialRow>) -> Result<(), ArrowError> {
        // By all positions that were pressed: a deadband removes contacts from the labels, at some depths only.
        let by = self.definition.split.by;
        let key = |trial: &TrialRow| self.is_drawn(trial).then(|| group_key(trial, by));
        let keys: Vec<Option<String>> = trials.iter().map(key).collect();
        let labelled = trials.into_iter().map(|mut trial| {
            label(&mut trial, self.definition, run);
            Row { trial, part: None }
        });
        let rows: Vec<Row> = labelled.collect();
        let batch = batch::of_trials(&self.schema, &rows)?;
        let masks: Vec<_> = self.filters.iter().map(|condition| mask(condition, &batch)).collect();
        for (at, (Row { trial, .. }, key)) in rows.iter().zip(&keys).enumerate() {
            let failed = masks.iter().position(|mask| !mask.value(at));
            let fixed = self.fixed_part(trial);
            let lacks = match self.definition.split.by {
                SplitBy::Imported if fixed.is_none() => Some(NO_PART),
                SplitBy::Tag if trial.imported_tag.is_none() => Some(NO_TAG),
                SplitBy::Imported
                | SplitBy::Tag
                | SplitBy::Configuration
                | SplitBy::Trial
                | SplitBy::Run
                | SplitBy::None => None,
            };
            let why = lacks.map(str::to_owned).or_else(|| self.why_excluded(trial));
            let why = why.or_else(|| {
                failed.map(|condition| format!("not {}", self.definition.conditions[condition]))
            });
            let group = key.as_ref().map(|key| self.group(key, trial));
            match why {
                Some(why) => *self.excluded.entry(why).or_default() += 1,
                None => self.selected.push(Selected { trial: trial.trial_id, group, fixed }),
            }
        }
        Ok(())
    }

    fn is_drawn(&self, trial: &TrialRow) -> bool {
        match self.definition.split.by {
            SplitBy::Configuration | SplitBy::Trial => true,
            SplitBy::Run => self.fixed_part(trial).is_none(),
            SplitBy::Tag => trial.imported_tag.is_some(),
            SplitBy::Imported | SplitBy::None => false,
        }
    }

    /// Part of a trial that its file or its run determines, before anything is drawn.
    fn fixed_part(&self, trial: &TrialRow) -> Option<Part> {
        let split = &self.definition.split;
        match split.by {
            SplitBy::Imported => trial.imported_split.as_deref().and_then(Part::named),
            SplitBy::Run => split
                .tests(&trial.run.to_string(), trial.scan_id, &trial.experiment)
                .then_some(Part::Test),
            SplitBy::Configuration | SplitBy::Trial | SplitBy::Tag | SplitBy::None => None,
        }
    }

    /// Reason of exclusion, as text; these texts are keys of the report.
    fn why_excluded(&self, trial: &TrialRow) -> Option<String> {
        let definition = self.definition;
        match (definition.flagged, trial.flags.is_empty()) {
            (Choice::LeaveOut, false) => {
                let words: Vec<&str> = trial.flags.iter().map(|flag| flag.as_str()).collect();
                return Some(format!("flagged: {}", words.join(", ")));
            }
            (Choice::Only, true) => return Some("not flagged".into()),
            _ => {}
        }
        match (definition.untouched, trial.contact_count) {
            (Choice::LeaveOut, 0) => return Some("no contact".into()),
            (Choice::Only, 1..) => return Some("with contact".into()),
            _ => {}
        }
        let counts = &definition.contact_counts;
        if !counts.is_empty() && !counts.contains(&u32::from(trial.contact_count)) {
            return Some(format!("{} contacts", trial.contact_count));
        }
        if definition.task.needs_twin() {
            match (&trial.sim_model, trial.rmse_v) {
                (None, _) => return Some("no simulated twin yet".into()),
                (Some(_), None) => return Some("the model could not take it".into()),
                (Some(model), _) if Some(model.as_str()) != self.model => {
                    return Some(format!("twin of another model: {model}"));
                }
                _ => {}
            }
        }
        None
    }

    /// Adds a labelled trial to the group with a key and returns the index of the group.
    fn group(&mut self, key: &str, trial: &TrialRow) -> usize {
        let split = &self.definition.split;
        let place = place(split.seed, key.as_bytes());
        let count = if split.stratify { u32::from(trial.contact_count) } else { 0 };
        let at = *self.by_place.entry(place).or_insert_with(|| {
            self.groups.push(Group { place, rows: 0, stratum: count });
            self.groups.len() - 1
        });
        let group = &mut self.groups[at];
        group.rows += 1;
        // The stratum of a configuration is its largest number of contacts.
        group.stratum = group.stratum.max(count);
        at
    }

    /// Divides the groups and returns the result.
    pub fn finish(self) -> Surveyed {
        let divided = divide(&self.groups, &self.definition.split);
        let kept = self.selected.iter().map(|Selected { trial, group, fixed }| {
            (*trial, fixed.or_else(|| group.map(|at| divided[at])))
        });
        Surveyed { kept: kept.collect(), excluded: self.excluded }
    }
}

/// Key of the group of a trial. For a split by configuration or run it is the pressed positions,
/// independent of run and depth; for a split by trial it is unique; for a split by tag it is the tag.
fn group_key(trial: &TrialRow, by: SplitBy) -> String {
    match (by, &trial.imported_tag) {
        (SplitBy::Trial, _) => {
            return format!("{} {} {}", trial.run, trial.configuration, trial.depth_index);
        }
        (SplitBy::Tag, Some(tag)) => return tag.clone(),
        (SplitBy::Tag, None)
        | (SplitBy::Configuration | SplitBy::Imported | SplitBy::Run | SplitBy::None, _) => {}
    }
    let tips = trial.arms.iter().map(|a| (a.x_mm, a.y_mm));
    let placed = trial.contacts.iter().filter_map(|c| Some((c.x_mm?, c.y_mm?)));
    let micrometres = |mm: f64| (mm * 1e3).round() as i64;
    let mut places: Vec<(i64, i64)> = if trial.arms.is_empty() {
        placed.map(|(x, y)| (micrometres(x), micrometres(y))).collect()
    } else {
        tips.map(|(x, y)| (micrometres(x), micrometres(y))).collect()
    };
    if places.is_empty() {
        // Without positions the configuration of the run is the group.
        return format!("{} {}", trial.run, trial.configuration);
    }
    places.sort_unstable();
    format!("{places:?}")
}
