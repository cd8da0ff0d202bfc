//! Summary of a plan for a person before arming, and for scripts with `--json`.
//! PURE. Uses: `plan`, `estimate`, `problem`, `plain`. Never: the rig, files.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use serde::Serialize;
use utoipa::ToSchema;

use super::estimate::{Bench, Estimate, Estimates, Parts, estimate, fixed_bytes};
use super::order::Place;
use super::plan::{Kind, Plan, PlannedConfiguration, Step};
use crate::plain::{bytes, counted, duration, grouped};
use crate::problem::Problem;

/// Preflight of a plan on a bench.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Preflight {
    /// Name of the experiment.
    pub experiment: String,
    /// Kind of the experiment: `real-hex` or `real-random`.
    pub kind: String,
    /// Seed of all random draws.
    pub seed: u64,
    /// Number of planned trials.
    pub trials: u64,
    /// Number of planned configurations or manual trials.
    pub configurations: u64,
    /// Number of distinct configurations among them.
    pub distinct_configurations: u64,
    /// Likely duration without the time of persons, wall s.
    pub duration_s: f64,
    /// Duration under favourable assumptions, wall s.
    pub duration_low_s: f64,
    /// Duration under unfavourable assumptions, wall s.
    pub duration_high_s: f64,
    /// Parts of the likely duration.
    pub parts: Parts,
    /// Predictions for each setting.
    pub settings: Vec<Estimate>,
    /// Lateral travel in the planned order, mm.
    pub travel_mm: f64,
    /// Lateral travel if the configurations were visited in drawn order, mm.
    pub travel_random_order_mm: f64,
    /// `travel_mm` divided by `travel_random_order_mm`; absent without travel.
    pub travel_ratio: Option<f64>,
    /// Number of reference presses.
    pub reference_presses: u64,
    /// Number of times that the run waits for a person: tip changes or placements.
    pub waits_for_person: u64,
    /// Disk space that the run needs, bytes.
    pub disk_bytes: u64,
    /// Part of it that does not depend on the number of trials: the cache for the twins and the log
    /// of the database.
    pub disk_fixed_bytes: u64,
    /// State in which the tips remain if the service stops during a press; absent without presses.
    pub if_silent: Option<String>,
    /// Problems that forbid the plan on this bench.
    #[schema(value_type = Vec<Object>)]
    pub problems: Vec<Problem>,
}

impl Preflight {
    /// Summarises a plan. `problems` are those of `lint`.
    pub fn of(plan: &Plan, bench: &Bench, problems: Vec<Problem>) -> Self {
        let Estimates { settings, whole } = estimate(plan, bench);
        let disk_fixed_bytes = fixed_bytes(plan);
        let travel_mm = travel_mm(plan, |c| c.stand.place());
        let drawn = in_drawn_order(plan);
        let travel_random_order_mm =
            self::travel_mm(plan, |c| drawn.get(&c.index).copied().unwrap_or(c.stand.place()));
        Self {
            experiment: plan.experiment.clone(),
            kind: match plan.kind {
                Kind::RealHex => "real-hex".into(),
                Kind::RealRandom => "real-random".into(),
            },
            seed: plan.seed,
            trials: plan.trials(),
            configurations: (plan.configurations().count() + plan.placements().count()) as u64,
            distinct_configurations: distinct(plan),
            duration_s: whole.duration_s,
            duration_low_s: whole.low_s,
            duration_high_s: whole.high_s,
            parts: whole.parts,
            settings,
            travel_mm,
            travel_random_order_mm,
            travel_ratio: (travel_random_order_mm > 0.0)
                .then(|| travel_mm / travel_random_order_mm),
            reference_presses: count(plan, |s| matches!(s, Step::Reference(_))),
            waits_for_person: count(plan, |s| {
                matches!(s, Step::TipChange { .. } | Step::Manual(_))
            }),
            disk_bytes: whole.disk_bytes + disk_fixed_bytes,
            disk_fixed_bytes,
            if_silent: (plan.kind == Kind::RealHex).then(|| if_silent(plan, bench)),
            problems,
        }
    }
}

/// Effect of a service that stops: without it, only the drive of z can stop the press.
fn if_silent(plan: &Plan, bench: &Bench) -> String {
    let deepest_mm = plan.depths_mm.iter().copied().fold(0.0, f64::max) - plan.standoff_mm;
    match bench.stage.as_ref().and_then(|stage| stage.z_watchdog_ms) {
        Some(ms) => format!(
            "z stops after {ms} ms (watchdog of its drive); the tips stay pressed up to \
             {deepest_mm:.2} mm below the surface until a person raises them"
        ),
        None => format!(
            "z continues to its target (its drive has no watchdog); the tips stay pressed up to \
             {deepest_mm:.2} mm below the surface until a person raises them"
        ),
    }
}

/// Lateral travel of all steps if the position of each configuration is `place_of`, mm.
fn travel_mm(plan: &Plan, place_of: impl Fn(&PlannedConfiguration) -> Place) -> f64 {
    let mut here: Option<Place> = None;
    let mut travelled_mm = 0.0;
    let mut go = |to: Place| travelled_mm += here.replace(to).map_or(0.0, |p| p.travel_mm(&to));
    for step in &plan.steps {
        match step {
            Step::TouchOff { places, .. } => places.iter().for_each(|s| go(s.place())),
            Step::Reference(press) => go(press.stand.place()),
            Step::Configuration(configuration) => go(place_of(configuration)),
            Step::TipChange { .. } | Step::Manual(_) => {}
        }
    }
    travelled_mm
}

/// Position of the indenter at each index if every setting kept its drawn order.
fn in_drawn_order(plan: &Plan) -> BTreeMap<u32, Place> {
    plan.configurations()
        .map(|c| (plan.settings[c.setting as usize].first + c.draw, c.stand.place()))
        .collect()
}

/// Number of distinct configurations, or of distinct sets of weights on points.
fn distinct(plan: &Plan) -> u64 {
    let pressed = plan.configurations().filter(|c| c.group == c.index).count();
    let placed: BTreeSet<Vec<[u64; 3]>> = plan
        .placements()
        .map(|p| {
            let bits = |v: f64| v.to_bits();
            let mut set: Vec<[u64; 3]> =
                p.contacts.iter().map(|c| [bits(c.x_mm), bits(c.y_mm), bits(c.force_n)]).collect();
            set.sort_unstable();
            set
        })
        .collect();
    (pressed + placed.len()) as u64
}

fn count(plan: &Plan, what: impl Fn(&Step) -> bool) -> u64 {
    plan.steps.iter().filter(|step| what(step)).count() as u64
}

/// The preflight as text: one item per line, numbers in columns.
impl fmt::Display for Preflight {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{} ({}, seed {})", self.experiment, self.kind, self.seed)?;
        let line = |f: &mut fmt::Formatter<'_>, name: &str, value: String| {
            writeln!(f, "  {name:<20} {value}")
        };
        line(f, "trials", grouped(self.trials))?;
        let distinct = grouped(self.distinct_configurations);
        let configurations = grouped(self.configurations);
        line(f, "configurations", format!("{configurations}, {distinct} distinct"))?;
        line(f, "reference presses", grouped(self.reference_presses))?;
        let (low, high) = (duration(self.duration_low_s), duration(self.duration_high_s));
        line(f, "duration", format!("{} ({low} to {high})", duration(self.duration_s)))?;
        for (name, part_s) in self.parts.named() {
            let share = 100.0 * part_s / self.duration_s.max(f64::MIN_POSITIVE);
            writeln!(f, "    {name:<18} {:>12} {share:>6.1} %", duration(part_s))?;
        }
        let waits = counted(self.waits_for_person, "time", "times");
        line(f, "waits for a person", format!("{waits}, not in the duration"))?;
        for setting in &self.settings {
            let tips = |count: u8| counted(count.into(), "tip", "tips");
            let name = setting.tips.map_or("manual".into(), tips);
            let (time, disk) = (duration(setting.duration_s), bytes(setting.disk_bytes as f64));
            let trials = grouped(setting.trials);
            writeln!(f, "    {name:<18} {time:>12} {trials:>8} trials {disk:>10}")?;
        }
        if let Some(ratio) = self.travel_ratio {
            let (planned, drawn) = (self.travel_mm / 1e3, self.travel_random_order_mm / 1e3);
            let shown = format!("{planned:.1} m, {ratio:.3} of the {drawn:.1} m in drawn order");
            line(f, "lateral travel", shown)?;
        }
        let fixed = bytes(self.disk_fixed_bytes as f64);
        line(f, "disk", format!("{}, {fixed} of it cache and log", bytes(self.disk_bytes as f64)))?;
        if let Some(words) = &self.if_silent {
            line(f, "if service stops", words.clone())?;
        }
        if self.problems.is_empty() {
            return line(f, "problems", "none".into());
        }
        line(f, "problems", self.problems.len().to_string())?;
        self.problems.iter().try_for_each(|problem| writeln!(f, "    {problem}"))
    }
}
