//! The service: HTTP over the conductor, the campaign and the store; the state and the routes of all handlers.
//! Uses: everything before it. Never: motion, SQL, a read that a motion waits for.

use std::convert::Infallible;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use axum::extract::FromRequestParts;
use axum::http::Method;
use axum::http::request::Parts;
use axum::middleware::{from_fn, from_fn_with_state};
use axum::routing::post;
use jiff::Timestamp;
use tokio::runtime;
use tokio::sync::{Semaphore, watch};
use utoipa::OpenApi;
use utoipa_axum::router::OpenApiRouter;

use crate::campaign::shown::command::Handle;
use crate::conductor::{Conductor, RigFile};
use crate::dataset::catalog::Catalog;
use crate::infer::registry::Registry;
use crate::infer::serving::Serving;
use crate::jobs::Jobs;
use crate::placement::watch::PlacementWatch;
use crate::query::Queries;
use crate::schedule::experiment::Experiment;
use crate::store::{KeyRing, Store};
use crate::twins::TwinPool;

mod accept;
mod access;
mod audit;
mod auth;
mod body;
mod data_folder;
mod datasets;
mod describe;
mod door;
mod edited;
mod encoder;
mod envelope;
mod estop;
mod evaluation;
mod events;
mod examples;
mod experiments;
mod exports;
mod finished;
mod forces;
mod form;
mod gather;
mod glance;
mod guard;
mod health;
mod history;
mod imports;
mod in_time;
mod infer;
mod jobs;
mod kept;
mod limits;
mod line;
mod live;
mod live_contacts;
mod live_status;
mod lock_file;
mod memory;
mod models;
mod needs;
mod once;
mod orders;
mod overlay;
mod offline;
mod options;
mod pages;
mod params;
mod people;
mod placement;
mod preflight;
mod problem;
mod progress;
mod published;
mod query;
mod quantities;
mod queue;
mod queue_times;
mod ranges;
mod rates;
mod readings;
mod recipes;
mod recording;
mod refusals;
mod rig;
mod rig_limits;
mod routes;
mod runs;
mod samples;
mod seat;
mod send;
mod simulations;
mod sensor;
mod service;
mod socket;
mod spans;
mod sql;
mod status;
mod suspenders;
mod tags;
mod tls;
mod tour;
mod trace;
mod trials;
mod turns;
mod twins;
mod web;
mod untouched;
mod vocabulary;
mod wear;
mod work;
mod workers;

pub use access::{Access, Edited, Lock, Needs};
pub use envelope::SamplesOut;
pub use exports::ExportOut;
pub use forces::{ForcesAtDepth, forces_by_depth};
pub use glance::{Glance, Question, Rating};
pub use history::History;
pub use infer::{FrameAnswer, InferOptions, InferRequest};
pub use jobs::JobOut;
pub use limits::STATUS_AGE_MAX;
pub use live_contacts::LiveAnswer;
pub use lock_file::{LockFile, LockFileError};
pub use models::{ModelOut, PromotionRequest, RollBackRequest, ServesOut, ServingOut};
pub use needs::{Need, NeedKind};
pub use offline::Offline;
pub use options::{ServeError, ServeOptions};
pub use orders::WORKER;
pub use pages::Page;
pub use people::CreatedKey;
pub use placement::{LastPlacement, PlacementOut, Stage};
pub use progress::RunProgress;
pub use quantities::{LiveQuantities, QuantityRequest};
pub use queue_times::QueueTime;
pub use rates::{RigRates, StreamRates, WireRates};
pub use runs::Summary;
pub use sensor::SensorOut;
pub use service::Service;
pub use spans::StateSpan;
pub use status::DiskStatus;
pub use suspenders::Suspender;
pub use tls::{Tls, TlsCause, TlsError, warn_if_others_may_read};
pub use turns::Turns;

use memory::Memory;
use routes::AllNeeds;

/// State of all handlers. Clones share it.
#[derive(Clone)]
pub struct App {
    /// Database of runs, trials, events and tasks.
    pub store: Store,
    /// Valid API keys.
    pub keys: KeyRing,
    /// Status and requests of the campaign.
    pub campaign: Handle,
    /// Queue and arming.
    pub conductor: Conductor,
    /// Pool of simulated twins.
    pub twins: TwinPool,
    /// Datasets and exports.
    pub datasets: Catalog,
    /// Questions in SQL.
    pub queries: Queries,
    /// Models in the data folder, by id and name.
    pub models: Registry,
    /// Slots with the models and calibrations that answer requests.
    pub serving: Serving,
    /// Trainings and evaluations.
    pub jobs: Jobs,
    /// Limits of concurrent inferences.
    pub turns: Turns,
    /// Contacts estimated during manual trials.
    pub placement: PlacementWatch,
    facts: Arc<Facts>,
}

struct Facts {
    bind: SocketAddr,
    data: PathBuf,
    started_at: Timestamp,
    /// Process time of `started_at`.
    began: Instant,
    rig: RigFile,
    ending: watch::Receiver<bool>,
    threads: runtime::Handle,
    logged_later: Arc<Semaphore>,
    needs: AllNeeds,
    in_progress: guard::InProgress,
    running: once::Running,
    edits: edited::Edits,
    tickets: auth::Tickets,
    wrong_keys: auth::WrongKeys,
    delayed: Semaphore,
    local_admin: bool,
    require_key: bool,
    desk: bool,
    memory: Memory,
}

/// Handlers take the state as it is.
impl FromRequestParts<App> for App {
    type Rejection = Infallible;

    async fn from_request_parts(_: &mut Parts, app: &Self) -> Result<Self, Infallible> {
        Ok(app.clone())
    }
}

impl App {
    fn loopback(&self) -> bool {
        self.facts.bind.ip().is_loopback()
    }
}

/// Description of all routes; `openapi.yaml` is generated from it.
#[derive(OpenApi)]
#[openapi(
    components(schemas(Experiment, problem::ProblemBody)),
    info(
        title = "Palpate",
        description = "Presses a tactile robot skin with a rig, trains models on the measured trials, \
                   and estimates position and force of contacts. Units are in the names; times are \
                   RFC 3339 in UTC; errors are RFC 9457 problem bodies. What may change within v1, \
                   repetitions, entity tags and limits: docs/api.md of the source."
    )
)]
struct Description;

/// Operations of the table that `of` selects.
fn routes_of(of: impl Fn(&Needs) -> bool) -> OpenApiRouter<App> {
    let all = routes::table().into_iter().filter(|operation| of(&operation.needs));
    let start = OpenApiRouter::with_openapi(Description::openapi());
    all.fold(start, |router, operation| router.routes(operation.route))
}

/// Returns method, path and needs of every operation, in the order of their paths.
pub fn operations() -> Vec<(Method, String, Needs)> {
    let all = AllNeeds::of(&routes::table());
    let row =
        |(method, path, needs): (&Method, &str, &Needs)| (method.clone(), path.into(), *needs);
    let mut rows: Vec<(Method, String, Needs)> = all.iter().map(row).collect();
    rows.sort_by(|a, b| (&a.1, a.0.as_str()).cmp(&(&b.1, b.0.as_str())));
    rows
}

/// Description of all operations.
fn description() -> utoipa::openapi::OpenApi {
    let mut description = routes_of(|_| true).to_openapi();
    describe::complete(&mut description, &AllNeeds::of(&routes::table()));
    description
}

fn router(app: App) -> axum::Router {
    let of =
        |access: fn(Access) -> bool| routes_of(|needs| access(needs.access)).split_for_parts().0;
    of(|access| matches!(access, Access::From(_)))
        .route_layer(from_fn_with_state(app.clone(), guard::admit))
        .merge(of(|access| access == Access::Open))
        .merge(web::routes())
        .fallback(web::unknown)
        .method_not_allowed_fallback(web::wrong_method)
        .layer(from_fn(guard::short_head))
        .layer(from_fn(guard::harden))
        .layer(from_fn(trace::follow))
        // The e-stop has no layer: nothing runs before its handler.
        .merge(of(|access| access == Access::Stop).route("/estop", post(estop::estop)))
        .with_state(app)
}

#[cfg(test)]
mod tests {
    /// The committed description equals the generated one; `UPDATE=1` writes it.
    #[test]
    fn openapi_yaml_is_what_the_code_says() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../openapi.yaml");
        let generated = yaml_serde::to_string(&super::description()).unwrap();
        if std::env::var_os("UPDATE").is_some() {
            std::fs::write(path, &generated).unwrap();
        }
        let committed = std::fs::read_to_string(path).unwrap_or_default();
        assert!(committed == generated, "openapi.yaml is old: UPDATE=1 cargo test openapi_yaml");
    }
}
