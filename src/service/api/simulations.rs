//! What the model computes for contacts: the frame and the dent.
//! Uses: `simulate::pressed`, the models that `twins` keeps warm. Never: the rig, a stored frame.

use axum::Json;
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use sim_core::forward::Workspace;
use sim_core::sensor::Sensor;
use sim_core::stats::fvu;
use tracing::Instrument;
use utoipa::ToSchema;

use super::App;
use super::limits::SIMULATED_CONTACTS;
use super::problem::{ApiError, ApiResult, Body};
use super::runs::find;
use super::turns::turn;
use crate::clock::Clock;
use crate::dataset::background::background;
use crate::ids::TrialId;
use crate::problem::Problem;
use crate::simulate::contacts::{Limits, Load, RequestedContact};
use crate::simulate::dent::DentMap;
use crate::simulate::pressed::{Pressed, PressedError, pressed};
use crate::twins::skins::{SkinCalibration, SkinError, Source};

/// Name of the body in problems.
const BODY: &str = "request";

/// Request to simulate contacts.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SimulationRequest {
    /// Contacts; none: the untouched skin.
    #[schema(max_items = 6)]
    pub contacts: Vec<GivenContact>,
    /// uid or scan_id of a run whose sensor and calibration are used; absent or null: the sensor under
    /// the rig, with the promoted calibration of the skin, or else that of the service.
    pub run: Option<String>,
    /// Number of a stored trial whose measured frame the simulated one is compared with (`fvu`).
    pub trial: Option<TrialId>,
}

/// A contact, with exactly one of `depth_mm` and `force_n`.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct GivenContact {
    /// Position on the skin along x, mm; the whole tip is on the skin.
    pub x_mm: f64,
    /// Position on the skin along y, mm; the whole tip is on the skin.
    pub y_mm: f64,
    /// Mean compression of the foam under the rim of the tip, mm, from 0 to the thickness of the foam.
    pub depth_mm: Option<f64>,
    /// Force, N, from 0 to 1000.
    pub force_n: Option<f64>,
}

/// A simulated contact.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PressedContact {
    /// Position on the skin along x, mm.
    pub x_mm: f64,
    /// Position on the skin along y, mm.
    pub y_mm: f64,
    /// Mean compression of the foam under the rim of the tip, mm. Under other contacts it may be
    /// larger than the requested one.
    pub depth_mm: f64,
    /// Normal force of the contact, N.
    pub force_n: f64,
}

/// The skin under contacts, as the model computes it.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Simulation {
    /// Frame, V, 784 for the paper's skin, injection-major.
    pub voltages_v: Vec<f64>,
    /// Frame of the untouched skin, V.
    pub untouched_v: Vec<f64>,
    /// The contacts, in the order of the request.
    pub contacts: Vec<PressedContact>,
    /// Compression of the foam.
    pub dent_mm: DentMap,
    /// Id of the calibration of the model, or `sensor file`.
    pub model: String,
    /// Time of the simulation, ms.
    pub took_ms: f64,
    /// Fraction of variance unexplained of the measured frame of `trial` (paper, Eq. 2); null without `trial`, if
    /// the frame is constant or has missing channels, and for another number of channels.
    pub fvu: Option<f64>,
}

/// Simulates contacts on the skin: the frame, the dent, and the force of a depth or the depth of a force.
///
/// The first request for a skin builds its model, which takes seconds.
#[utoipa::path(post, operation_id = "simulate",
    path = "/api/v1/simulations", tag = "simulation", request_body = SimulationRequest,
    responses((status = 200, body = Simulation),
        (status = 404, description = "no run has this uid or scan_id, or no trial this number"),
        (status = 409, description = "there is no model of the run's skin"),
        (status = 422, description = "a contact is outside its limits"),
        (status = 503, description = "too many simulations are in progress")))]
pub async fn simulate(
    app: App,
    Body(asked): Body<SimulationRequest>,
) -> ApiResult<Json<Simulation>> {
    let skin = Skin::of(&app, asked.run.as_deref()).await?;
    let contacts = requested(&asked.contacts).map_err(ApiError::problems)?;
    Limits::of(&skin.sensor, SIMULATED_CONTACTS)
        .check(BODY, &contacts)
        .map_err(ApiError::problems)?;
    let measured_v = match asked.trial {
        Some(id) => {
            let trial = app.store.trial_by_id(id).await?;
            let none = || ApiError::not_found(format!("no trial {}", id.0));
            trial.ok_or_else(none)?.voltages_v
        }
        None => None,
    };
    let turn = turn(&app.turns.simulations).await?;
    let model = skin.calibration.as_ref().map_or("sensor file".into(), |of| of.id.to_string());
    let (skins, clock) = (app.twins.skins().clone(), Clock::new(1.0));
    let foam_mm = skin.sensor.file.layers.foam.thickness_mm;
    // A separate task: its turn ends with the work, not with a client that does not wait.
    let work = async move {
        let _turn = turn;
        let warm = skins.of(&skin.sensor_text, skin.calibration).await?;
        let simulating = move || {
            let started_s = clock.process_s();
            let found = pressed(&warm.model, &contacts, &mut Workspace::default());
            let took_ms = 1e3 * (clock.process_s() - started_s);
            found.map(|found| answer(found, warm.untouched_v.clone(), model, took_ms))
        };
        // Low priority: the campaign and the live frames come first.
        background(simulating).await.map_err(|_| SkinError::Worker)
    };
    let simulation =
        tokio::spawn(work.in_current_span()).await.map_err(|_| SkinError::Worker)??;
    let mut simulation = simulation.map_err(|error| refused(&error, &asked.contacts))?;
    simulation.fvu = measured_v
        .filter(|measured_v| measured_v.len() == simulation.voltages_v.len())
        .and_then(|measured_v| fvu(&measured_v, simulation.voltages_v.iter().copied()));
    within_foam(&simulation.contacts, &asked.contacts, foam_mm).map_err(ApiError::problems)?;
    Ok(Json(simulation))
}

/// Refuses forces that would press the foam by more than its thickness: the model has no such state.
fn within_foam(
    found: &[PressedContact],
    asked: &[GivenContact],
    foam_mm: f64,
) -> Result<(), Vec<Problem>> {
    let beyond = |(index, (found, asked)): (usize, (&PressedContact, &GivenContact))| {
        let force_n = asked.force_n.filter(|_| found.depth_mm > foam_mm)?;
        let limit = format!(
            "must press the foam by at most its thickness, {foam_mm} mm; it would be {:.1} mm",
            found.depth_mm
        );
        Some(Problem::new(BODY, &format!("contacts[{index}].force_n"), force_n, limit))
    };
    let problems: Vec<Problem> = found.iter().zip(asked).enumerate().filter_map(beyond).collect();
    if problems.is_empty() { Ok(()) } else { Err(problems) }
}

/// The skin of a request.
struct Skin {
    sensor: Sensor,
    sensor_text: String,
    calibration: Option<SkinCalibration>,
}

impl Skin {
    async fn of(app: &App, run: Option<&str>) -> ApiResult<Self> {
        let Some(run) = run else {
            let (sensor, text) = (app.serving.sensor().clone(), app.serving.sensor_text());
            let calibration = match app.serving.promoted_skin().await? {
                Some(id) => {
                    let file = app.serving.skins().stored(&id)?;
                    Some(SkinCalibration { id, source: Source::Stored(file) })
                }
                None => app.twins.calibration_of(&sensor.file.name),
            };
            return Ok(Self { sensor, sensor_text: text.into(), calibration });
        };
        let run = find(app, run).await?;
        let sensor = Sensor::from_toml(&run.sensor).map_err(|error| {
            let words = format!("run {}: there is no model of its skin: {error}", run.scan_id);
            ApiError::new(StatusCode::CONFLICT, words)
        })?;
        let own = app.twins.calibration_of(&sensor.file.name);
        let calibration = match run.calibration_id {
            Some(id) if own.as_ref().is_some_and(|own| own.id == id) => own,
            // Without its file the answer states that it is the sensor file's.
            Some(id) => app
                .serving
                .skins()
                .stored(&id)
                .ok()
                .map(|file| SkinCalibration { id, source: Source::Stored(file) }),
            None => None,
        };
        Ok(Self { sensor, sensor_text: run.sensor, calibration })
    }
}

/// Reads the loads of contacts: each has exactly one. Of many problems the first ones are stated.
fn requested(contacts: &[GivenContact]) -> Result<Vec<RequestedContact>, Vec<Problem>> {
    let (mut read, mut found) = (Vec::new(), Vec::new());
    for (index, contact) in contacts.iter().enumerate() {
        let load = match (contact.depth_mm, contact.force_n) {
            (Some(depth_mm), None) => Load::DepthMm(depth_mm),
            (None, Some(force_n)) => Load::ForceN(force_n),
            (given, _) => {
                let given = if given.is_some() { "both" } else { "none" };
                let limit = "must have exactly one of depth_mm and force_n";
                found.push(Problem::new(BODY, &format!("contacts[{index}]"), given, limit));
                continue;
            }
        };
        read.push(RequestedContact { x_mm: contact.x_mm, y_mm: contact.y_mm, load });
    }
    found.truncate(SIMULATED_CONTACTS);
    if found.is_empty() { Ok(read) } else { Err(found) }
}

fn answer(found: Pressed, untouched_v: Vec<f64>, model: String, took_ms: f64) -> Simulation {
    let contacts = found.contacts.iter().zip(&found.depths_mm).map(|(c, &depth_mm)| {
        PressedContact { x_mm: c.x_mm, y_mm: c.y_mm, depth_mm, force_n: c.force_n }
    });
    Simulation {
        voltages_v: found.voltages_v,
        untouched_v,
        contacts: contacts.collect(),
        dent_mm: found.dent,
        model,
        took_ms,
        fvu: None,
    }
}

/// The refusal of contacts that the model rejects; positions and forces were checked before.
fn refused(error: &PressedError, asked: &[GivenContact]) -> ApiError {
    match error {
        PressedError::Contact(error) => {
            ApiError::problems(vec![Problem::whole(BODY, error.to_string())])
        }
        PressedError::TooDeep { contact, deepest_mm } => {
            let depth_mm = asked.get(*contact).and_then(|c| c.depth_mm).unwrap_or_default();
            let limit = format!(
                "must be at most {deepest_mm:.3} mm here, where {} N press to",
                crate::simulate::contacts::FORCE_MAX_N
            );
            let key = format!("contacts[{contact}].depth_mm");
            ApiError::problems(vec![Problem::new(BODY, &key, depth_mm, limit)])
        }
    }
}

impl From<SkinError> for ApiError {
    fn from(error: SkinError) -> Self {
        match error {
            SkinError::Stored(error) => error.into(),
            SkinError::Sensor(_) | SkinError::Calibration(_) => {
                Self::new(StatusCode::CONFLICT, format!("there is no model of this skin: {error}"))
            }
            SkinError::Model(_) | SkinError::Untouched(_) | SkinError::Worker => {
                Self::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string())
            }
        }
    }
}
