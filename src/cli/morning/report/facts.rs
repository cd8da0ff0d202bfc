//! What a report is made of: everything that the service states about a run, read once.
//! Uses: `client`, `answers`. Never: a conclusion (`findings` draws them).

use jiff::Timestamp;
use serde::Deserialize;
use sim_core::sensor::Sensor;

use super::super::answers::{TrialFacts, TwinsOf, all_trials, fit_of};
use crate::api::{History, StateSpan, Summary};
use crate::cli::client::Client;
use crate::cli::error::CliResult;
use crate::cli::view::EventView;
use crate::evaluate::simulation::SimulationReport;
use crate::event::{self, Importance};
use crate::figure::skin::Outline;
use crate::store::RunRow;

/// Duration of a run below which its time is shown in minutes, s.
const SHORT_S: f64 = 3.0 * 3600.0;
/// Records per request.
const PAGE_RECORDS: u32 = 1000;

/// The facts of a run.
#[derive(Debug, Clone)]
pub struct Facts {
    /// Counts, skips, the run itself.
    pub summary: Summary,
    /// Numbers of twins.
    pub twins: TwinsOf,
    /// Fit of the twins.
    pub fit: SimulationReport,
    /// Every stored trial of the run, oldest first.
    pub trials: Vec<TrialFacts>,
    /// States over time.
    pub states: Vec<StateSpan>,
    /// Events that an operator should see.
    pub events: Vec<Told>,
    /// Outputs of the cells without load.
    pub tares: Vec<Tare>,
    /// Presses at a fixed place.
    pub references: Vec<Reference>,
    /// The skin, for maps; absent if its sensor file cannot be read.
    pub outline: Option<Outline>,
}

/// An event as text.
#[derive(Debug, Clone, PartialEq)]
pub struct Told {
    /// Wall time, as the service recorded it.
    pub at: Timestamp,
    /// Kind of the event, as it is stored.
    pub kind: String,
    /// Text for a person, without the kind.
    pub words: String,
}

/// Outputs of the attached cells without load.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Tare {
    /// Wall time, as the service recorded it.
    pub at: Timestamp,
    /// Arm and output, V.
    pub volts: Vec<(u8, f64)>,
}

/// A press at a fixed place.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Reference {
    /// Wall time, as the service recorded it.
    pub at: Timestamp,
    /// Depth of the press below depth 0, mm.
    pub depth_mm: f64,
    /// Readings of the attached tips.
    pub arms: Vec<ReferenceArm>,
}

/// Reading of a tip at a reference press.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct ReferenceArm {
    /// Number of the arm.
    pub arm: u8,
    /// Force on the tip at that depth, N.
    pub force_n: f64,
}

impl Facts {
    /// Reads the facts of a run.
    ///
    /// # Errors
    /// As [`Client::send`].
    pub async fn read(client: &Client, run: &RunRow) -> CliResult<Self> {
        let uid = run.uid;
        let path = format!("/api/v1/runs/{uid}");
        let summary = client.summary(uid).await?;
        let history: History = client.get(&format!("{path}/history?bins=1")).await?;
        let records = |kind: &str| format!("{path}/records/{kind}?limit={PAGE_RECORDS}");
        let outline = Sensor::from_toml(&run.sensor).ok().map(|sensor| Outline::of(&sensor));
        let (twins, fit) = fit_of(client, uid).await?;
        Ok(Self {
            twins,
            fit,
            trials: all_trials(client, uid, summary.trials_stored).await?,
            states: history.states,
            events: events(client, run).await?,
            tares: client.all(&records("tares")).await?,
            references: client.all(&records("references")).await?,
            outline,
            summary,
        })
    }

    /// Returns the row of the run: experiment, plan, state, label.
    pub fn run(&self) -> &RunRow {
        &self.summary.run
    }

    /// Unit of the time since the start, and its length, s: hours for a long run, otherwise minutes.
    pub fn time_unit(&self) -> (&'static str, f64) {
        match self.summary.duration_s {
            Some(duration_s) if duration_s < SHORT_S => ("min", 60.0),
            _ => ("h", 3600.0),
        }
    }

    /// Time since the start of the run, in that unit; zero before it.
    pub fn since_start(&self, at: Timestamp) -> f64 {
        let start = self.run().started_at.unwrap_or(self.run().created_at);
        (at.duration_since(start).as_secs_f64() / self.time_unit().1).max(0.0)
    }
}

async fn events(client: &Client, run: &RunRow) -> CliResult<Vec<Told>> {
    let kinds = event::notable_kinds().collect::<Vec<_>>().join(",");
    let path = format!("/api/v1/events?run={}&kind={kinds}&limit={PAGE_RECORDS}", run.uid);
    let events: Vec<EventView> = client.all(&path).await?;
    let notable = events
        .into_iter()
        .filter(|event| event.importance() >= Importance::Notable && !event.is_placement());
    let told = notable.filter_map(|event| {
        Some(Told { at: event.at.parse().ok()?, words: event.sentence(), kind: event.kind })
    });
    Ok(told.collect())
}
