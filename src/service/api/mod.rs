//! The service: HTTP over the conductor, the campaign and the store; wiring and life cycle.
//! Uses: everything before it. Never: motion, SQL, a read that a motion waits for.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::DefaultBodyLimit;
use axum::middleware::{from_fn, from_fn_with_state};
use axum::routing::{get, post};
use jiff::Timestamp;
use sim_core::calibration::Calibration;
use sim_core::sensor::Sensor;
use tokio::net::TcpListener;
use tokio::runtime;
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinHandle;
use utoipa::OpenApi;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::campaign::run::engine;
use crate::campaign::shown::command::{Handle, Request};
use crate::clock::Clock;
use crate::conductor::{Conductor, RigFile};
use crate::dataset::catalog::Catalog;
use crate::dataset::error::DatasetError;
use crate::infer::error::InferError;
use crate::infer::registry::Registry;
use crate::infer::serving::Serving;
use crate::jobs::Jobs;
use crate::journal::error_chain;
use crate::simulate::model::sweep_partial;
use crate::store::{KeyRing, Soundness, Store, StoreError};
use crate::twins::TwinPool;

mod audit;
mod auth;
mod datasets;
mod door;
mod estop;
mod evaluation;
mod events;
mod exports;
mod finished;
mod health;
mod imports;
mod infer;
mod jobs;
mod line;
mod live;
mod lock_file;
mod models;
mod page;
mod params;
mod people;
mod problem;
mod query;
mod queue;
mod rig;
mod runs;
mod seat;
mod send;
mod status;
mod trace;
mod trials;
mod twins;
mod work;

pub use infer::{FrameAnswer, InferOptions, InferRequest, LiveAnswer, Turns};
pub use jobs::JobOut;
pub use lock_file::{LockFile, LockFileError};
pub use models::{ModelOut, PromotionRequest, RollBackRequest, ServesOut, ServingOut};
pub use runs::Summary;

use auth::Caller;
use problem::ApiError;

/// Number of newest trials whose checksums are verified at the start.
const EXAMINED_TRIALS: u32 = 2000;

/// Longest wait for the campaign's thread, which raises the tips, when the service ends.
const LEAVE: Duration = Duration::from_secs(60);

/// Options of a service.
#[derive(Debug, Clone)]
pub struct ServeOptions {
    /// Address to listen on; port 0 selects a free port.
    pub bind: SocketAddr,
    /// Data folder.
    pub data: PathBuf,
    /// Name of the rig file in messages.
    pub rig_file: String,
    /// Text of the rig file.
    pub rig_text: String,
    /// True: resume an interrupted run automatically, if its policy allows it.
    pub resume: bool,
    /// Number of threads that simulate twins; 0 simulates none.
    pub twin_workers: usize,
    /// Calibration for the twins of runs on its sensor.
    pub calibration: Option<Calibration>,
    /// Sensor of the skin under the rig.
    pub sensor: Sensor,
    /// Text of the sensor file.
    pub sensor_text: String,
}

/// Why a service did not start.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The rig file is invalid.
    #[error("{}", problems.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Rig {
        /// All invalid values.
        problems: Vec<crate::problem::Problem>,
    },
    /// The data folder cannot be created.
    #[error("data folder {}: {source}", path.display())]
    Data {
        /// The data folder.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// Another process uses the rig or the data folder.
    #[error(transparent)]
    Locked(#[from] LockFileError),
    /// The store cannot be opened.
    #[error("{}", error_chain(.0))]
    Store(#[from] StoreError),
    /// The address is not available.
    #[error("listening at {bind}: {source}")]
    Bind {
        /// The address.
        bind: SocketAddr,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The address is reachable from other machines, and there is no API key.
    #[error(
        "bind = {0}: must be a loopback address while there is no API key; run `palpate key create NAME`"
    )]
    NoKey(SocketAddr),
    /// The folders of datasets cannot be opened.
    #[error(transparent)]
    Datasets(#[from] DatasetError),
    /// The folder of models cannot be opened.
    #[error(transparent)]
    Models(#[from] InferError),
    /// The thread of the campaign or of the door cannot be started.
    #[error("starting a thread: {0}")]
    Thread(#[source] std::io::Error),
}

/// State of all handlers. Clones share it.
#[derive(Clone)]
pub struct App {
    /// Stored records.
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
    /// Stored models.
    pub models: Registry,
    /// Serving models.
    pub serving: Serving,
    /// Trainings and evaluations.
    pub jobs: Jobs,
    /// Limits of concurrent inferences.
    pub turns: Turns,
    facts: Arc<Facts>,
}

struct Facts {
    bind: SocketAddr,
    started_at: Timestamp,
    rig: RigFile,
    ending: watch::Receiver<bool>,
    threads: runtime::Handle,
    logged_later: Arc<Semaphore>,
}

impl App {
    fn loopback(&self) -> bool {
        self.facts.bind.ip().is_loopback()
    }

    /// Checks that no other person holds the operator lock; `who` is the name that the caller
    /// entered.
    async fn unlocked(&self, caller: &Caller, who: Option<&str>) -> Result<(), ApiError> {
        match self.store.lock().await? {
            Some(lock) if lock.holder != caller.identity(who) => Err(ApiError::new(
                axum::http::StatusCode::CONFLICT,
                format!(
                    "{} holds the operator lock ({}): ask the holder to release it",
                    lock.holder, lock.note
                ),
            )),
            _ => Ok(()),
        }
    }
}

/// Description of all routes; `openapi.yaml` is generated from it.
#[derive(OpenApi)]
#[openapi(info(
    title = "Palpate",
    description = "Presses a tactile robot skin with a rig, trains models on the measured trials, \
                   and estimates position and force of contacts. Units are in the names; times are \
                   RFC 3339 in UTC; errors are RFC 9457 problem bodies."
))]
struct Description;

fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::with_openapi(Description::openapi())
        .routes(routes!(status::status))
        .routes(routes!(queue::list, queue::add))
        .routes(routes!(queue::remove))
        .routes(routes!(queue::shift))
        .routes(routes!(queue::preflight))
        .routes(routes!(runs::list))
        .routes(routes!(runs::one))
        .routes(routes!(runs::summary))
        .routes(routes!(runs::preflight))
        .routes(routes!(runs::plan))
        .routes(routes!(runs::arm))
        .routes(routes!(runs::act))
        .routes(routes!(trials::of_run))
        .routes(routes!(trials::all))
        .routes(routes!(trials::one))
        .routes(routes!(trials::frames))
        .routes(routes!(trials::bench_records))
        .routes(routes!(twins::all))
        .routes(routes!(twins::of_run))
        .routes(routes!(evaluation::simulation))
        .routes(routes!(datasets::list, datasets::make))
        .routes(routes!(datasets::one))
        .routes(routes!(datasets::lineage))
        .routes(routes!(datasets::card))
        .routes(routes!(datasets::rows))
        .routes(routes!(datasets::data))
        .routes(routes!(exports::list, exports::request))
        .routes(routes!(exports::one))
        .routes(routes!(exports::file))
        .routes(routes!(jobs::train))
        .routes(routes!(jobs::evaluate))
        .routes(routes!(jobs::list))
        .routes(routes!(jobs::one))
        .routes(routes!(jobs::losses))
        .routes(routes!(jobs::stop))
        .routes(routes!(models::list))
        .routes(routes!(models::one))
        .routes(routes!(models::onnx))
        .routes(routes!(models::losses))
        .routes(routes!(models::residuals))
        .routes(routes!(models::add_calibration))
        .routes(routes!(models::serving, models::promote))
        .routes(routes!(models::roll_back))
        .routes(routes!(infer::live))
        .routes(routes!(events::events))
        .routes(routes!(live::frames))
        .routes(routes!(rig::act))
        .routes(routes!(rig::check))
        .routes(routes!(people::lock, people::take_lock, people::clear_lock))
        .routes(routes!(people::keys, people::create_key))
        .routes(routes!(people::revoke_key))
        .routes(routes!(people::actions))
        .routes(routes!(health::metrics))
        .merge(uploads())
}

/// Routes with larger limits of the body.
fn uploads() -> OpenApiRouter<App> {
    let imports = OpenApiRouter::new()
        .routes(routes!(imports::add))
        .layer(DefaultBodyLimit::max(imports::FILE_MAX_BYTES));
    let models = OpenApiRouter::new()
        .routes(routes!(models::add))
        .layer(DefaultBodyLimit::max(models::MODEL_MAX_BYTES));
    let frames = OpenApiRouter::new()
        .routes(routes!(infer::infer))
        .layer(DefaultBodyLimit::max(infer::FRAMES_MAX_BYTES));
    imports.merge(models).merge(frames)
}

/// Routes without the check of role and key.
fn open_routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(health::live)).routes(routes!(health::ready))
}

/// The e-stop, which checks the key itself and has no layer: nothing runs before its handler.
fn stop_routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(estop::estop))
}

/// Description of all routes.
fn description() -> utoipa::openapi::OpenApi {
    routes().merge(stop_routes()).merge(open_routes()).to_openapi()
}

fn router(app: App) -> axum::Router {
    let (guarded, _) = routes().split_for_parts();
    let (open, _) = open_routes().split_for_parts();
    guarded
        .route_layer(from_fn_with_state(app.clone(), auth::admit))
        .merge(open)
        .route("/", get(page::first))
        .route("/openapi.json", get(page::description))
        .fallback(page::unknown)
        .layer(from_fn(trace::follow))
        .merge(stop_routes().route("/estop", post(estop::estop)))
        .with_state(app)
}

/// A running service.
pub struct Service {
    address: SocketAddr,
    app: App,
    ending: watch::Sender<bool>,
    door: std::thread::JoinHandle<()>,
    tasks: Vec<JoinHandle<()>>,
    engine: std::thread::JoinHandle<()>,
    _locks: [LockFile; 2],
}

impl Service {
    /// Opens the store, starts the campaign's thread and listens.
    ///
    /// # Errors
    /// `ServeError::Rig` if the rig file is invalid, `Data` or `Store` if the data folder cannot be
    /// used, `Locked` if another process uses it or the rig, `NoKey` for a public address without a
    /// key, `Bind` if the address is not available, `Datasets`, `Models` or `Thread` for a failed
    /// start of these parts.
    pub async fn start(options: ServeOptions) -> Result<Self, ServeError> {
        let config = crate::rig::config::RigConfig::from_toml(&options.rig_file, &options.rig_text)
            .map_err(|problems| ServeError::Rig { problems })?;
        let data = |source| ServeError::Data { path: options.data.clone(), source };
        std::fs::create_dir_all(&options.data).map_err(data)?;
        let locks = [LockFile::of_data(&options.data)?, LockFile::of_rig(&config)?];
        let store = Store::open(&options.data.join("palpate.db"), Clock::new(1.0)).await?;
        let keys = KeyRing::load(store.clone()).await?;
        if !options.bind.ip().is_loopback() && keys.is_empty() {
            return Err(ServeError::NoKey(options.bind));
        }
        let bind = |source| ServeError::Bind { bind: options.bind, source };
        door::raise_file_limit();
        door::outlive_file_size_limit();
        let listener = TcpListener::bind(options.bind).await.map_err(bind)?;
        let address = listener.local_addr().map_err(bind)?;
        let journal = Arc::new(store.clone());
        let (campaign, engine) =
            engine::spawn(config.clone(), journal).map_err(ServeError::Thread)?;
        let rig = RigFile { file: options.rig_file, text: options.rig_text, config };
        let conductor = Conductor::new(
            store.clone(),
            campaign.clone(),
            rig.clone(),
            options.calibration.clone(),
        );
        let (ending, ended) = watch::channel(false);
        let facts = Facts {
            bind: address,
            started_at: Timestamp::now(),
            rig,
            ending: ended,
            threads: runtime::Handle::current(),
            logged_later: Arc::new(Semaphore::new(audit::LOGGED_LATER_MAX)),
        };
        let cache = options.data.join("cache");
        sweep_partial(&cache);
        let twins = TwinPool::new(
            store.clone(),
            campaign.clone(),
            options.calibration,
            cache,
            options.twin_workers,
        );
        store.sweep_imports().await?;
        let datasets = Catalog::open(store.clone(), &options.data, Clock::new(1.0))?;
        let models = Registry::open(store.clone(), &options.data, Clock::new(1.0))?;
        let (sensor, text) = (options.sensor, options.sensor_text);
        let serving = Serving::new(store.clone(), models.clone(), sensor, text, &options.data);
        let jobs = Jobs::new(
            store.clone(),
            datasets.clone(),
            models.clone(),
            serving.clone(),
            &options.data,
        );
        let app = App {
            serving: serving.clone(),
            facts: Arc::new(facts),
            store,
            keys,
            campaign,
            conductor,
            twins,
            datasets,
            models,
            jobs,
            turns: Turns::default(),
        };
        let tasks = vec![
            tokio::spawn(app.conductor.clone().follow()),
            tokio::spawn(app.twins.clone().work()),
            tokio::spawn(app.datasets.clone().work()),
            tokio::spawn(app.jobs.clone().work()),
            tokio::spawn(finished::keep(app.clone())),
            tokio::spawn(after_start(app.clone(), options.resume)),
            tokio::spawn(async move { serving.restore().await }),
        ];
        let answering = app.facts.ending.clone();
        let listener = listener.into_std().map_err(bind)?;
        let door =
            door::open(listener, router(app.clone()), answering).map_err(ServeError::Thread)?;
        Ok(Self { address, app, ending, door, tasks, engine, _locks: locks })
    }

    /// Address of the service, `http://HOST:PORT`.
    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Serves until `end` completes, then shuts down.
    pub async fn run_until(self, end: impl Future<Output = ()>) {
        end.await;
        self.shutdown().await;
    }

    /// Raises the tips, leaves an active run resumable, and closes the database.
    pub async fn shutdown(self) {
        for task in &self.tasks {
            task.abort();
        }
        // A moving engine reads this request at its next poll; its end is awaited in any case.
        let _ = self.app.campaign.ask(Request::Shutdown).await;
        let engine = tokio::task::spawn_blocking(move || self.engine.join());
        if tokio::time::timeout(LEAVE, engine).await.is_err() {
            tracing::error!("the campaign's thread did not end in time");
        }
        // Streams of events and frames must end before the door can.
        self.ending.send_replace(true);
        let door = tokio::task::spawn_blocking(move || self.door.join());
        if !matches!(door.await, Ok(Ok(()))) {
            tracing::error!("the door's thread panicked");
        }
        self.app.store.close().await;
    }
}

/// Examines the database, and continues the work of the previous process. A run is resumed
/// automatically only after the examination; runs that a person starts do not wait for it.
async fn after_start(app: App, resume: bool) {
    let continue_run = async {
        if let Err(error) = app.conductor.go_on(resume).await {
            tracing::warn!(error = error_chain(&error), "no run was resumed");
        }
    };
    let examine = async {
        match app.store.examine(EXAMINED_TRIALS).await {
            Ok(Soundness::Damaged(findings)) => {
                tracing::error!(?findings, "the database is damaged")
            }
            Ok(Soundness::Sound | Soundness::Unchecked) => {}
            Err(error) => {
                tracing::warn!(error = error_chain(&error), "the database was not examined")
            }
        }
    };
    if resume {
        examine.await;
        continue_run.await;
    } else {
        continue_run.await;
        examine.await;
    }
}

#[cfg(test)]
mod tests {
    /// The committed description equals the generated one; `UPDATE=1` writes it.
    #[test]
    fn openapi_yaml_is_what_the_code_says() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../openapi.yaml");
        let generated = super::description().to_yaml().unwrap();
        if std::env::var_os("UPDATE").is_some() {
            std::fs::write(path, &generated).unwrap();
        }
        let committed = std::fs::read_to_string(path).unwrap_or_default();
        assert!(committed == generated, "openapi.yaml is old: UPDATE=1 cargo test openapi_yaml");
    }
}
