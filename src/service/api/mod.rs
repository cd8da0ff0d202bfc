//! The service: HTTP over the conductor, the campaign and the store; wiring and life cycle.
//! Uses: everything before it. Never: motion, SQL, a read that a motion waits for.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use axum::http::Method;
use axum::middleware::{from_fn, from_fn_with_state};
use axum::routing::post;
use jiff::Timestamp;
use tokio::net::TcpListener;
use tokio::runtime;
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinHandle;
use utoipa::OpenApi;
use utoipa_axum::router::OpenApiRouter;

use crate::campaign::run::engine;
use crate::campaign::shown::command::{Handle, Request};
use crate::clock::Clock;
use crate::conductor::{AutoResume, Conductor, RigFile};
use crate::dataset::catalog::Catalog;
use crate::infer::registry::Registry;
use crate::infer::serving::Serving;
use crate::jobs::Jobs;
use crate::journal::error_chain;
use crate::placement::watch::PlacementWatch;
use crate::query::Queries;
use crate::schedule::experiment::Experiment;
use crate::simulate::model::sweep_partial;
use crate::store::{KeyRing, Soundness, Store};
use crate::twins::TwinPool;

mod audit;
mod auth;
mod data_folder;
mod datasets;
mod describe;
mod door;
mod edited;
mod envelope;
mod estop;
mod evaluation;
mod events;
mod examples;
mod experiments;
mod exports;
mod finished;
mod form;
mod guard;
mod health;
mod history;
mod imports;
mod infer;
mod jobs;
mod kept;
mod limits;
mod line;
mod live;
mod live_status;
mod lock_file;
mod memory;
mod models;
mod once;
mod overlay;
mod offline;
mod options;
mod pages;
mod params;
mod people;
mod placement;
mod problem;
mod progress;
mod query;
mod quantities;
mod queue;
mod ranges;
mod recipes;
mod rig;
mod rig_limits;
mod routes;
mod runs;
mod samples;
mod seat;
mod send;
mod simulations;
mod sensor;
mod socket;
mod spans;
mod sql;
mod status;
mod suspenders;
mod tls;
mod tour;
mod trace;
mod trials;
mod twins;
mod web;
mod untouched;
mod wear;
mod work;

pub use edited::Edited;
pub use infer::{FrameAnswer, InferOptions, InferRequest, LiveAnswer, Turns};
pub use jobs::JobOut;
pub use lock_file::{LockFile, LockFileError};
pub use models::{ModelOut, PromotionRequest, RollBackRequest, ServesOut, ServingOut};
pub use offline::Offline;
pub use options::{ServeError, ServeOptions};
pub use pages::Page;
pub use people::CreatedKey;
pub use placement::{FeltOut, LastPlacement, PlacementOut, Stage};
pub use quantities::QuantityRequest;
pub use routes::{Access, Lock, Needs};
pub use runs::Summary;
pub use tls::{Tls, TlsCause, TlsError, warn_if_others_may_read};

use memory::Memory;
use routes::AllNeeds;

/// Number of newest trials whose checksums are verified at the start.
const EXAMINED_TRIALS: u32 = 2000;

/// Longest wait for the campaign's thread, which raises the tips, when the service ends.
const LEAVE: Duration = Duration::from_secs(60);

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
    started_at: Timestamp,
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

impl App {
    fn loopback(&self) -> bool {
        self.facts.bind.ip().is_loopback()
    }
}

/// Description of all routes; `openapi.yaml` is generated from it.
#[derive(OpenApi)]
#[openapi(
    components(schemas(Experiment)),
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

/// A running service.
pub struct Service {
    address: SocketAddr,
    secure: bool,
    app: App,
    ending: watch::Sender<bool>,
    door: std::thread::JoinHandle<()>,
    tasks: Vec<JoinHandle<()>>,
    engine: std::thread::JoinHandle<()>,
    _locks: Vec<LockFile>,
}

impl Service {
    /// Opens the store, starts the campaign's thread and listens.
    ///
    /// # Errors
    /// `ServeError::Rig` if the rig file is invalid, `Data` or `Store` if the data folder cannot be
    /// used, `Locked` if another process uses it or the rig, `Tls` if the certificate or its key
    /// cannot be used, `NoKey` for a public address without a key, `NoKeyAtAll` if keys are required
    /// and there is none, `Bind` if the address is not available, `Datasets`, `Models` or `Thread` for
    /// a failed start of these parts.
    pub async fn start(options: ServeOptions) -> Result<Self, ServeError> {
        let config = crate::rig::setup::RigSetup::from_toml(&options.rig_file, &options.rig_text)
            .map_err(|problems| ServeError::Rig { problems })?;
        let tls = options.tls.as_ref().map(Tls::acceptor).transpose()?;
        let mut locks = vec![data_folder::open(&options.data)?];
        if !options.desk {
            locks.push(LockFile::of_rig(&config)?);
        }
        let store = Store::open(&data_folder::database(&options.data), Clock::new(1.0)).await?;
        let keys = KeyRing::load(store.clone()).await?;
        if !options.bind.ip().is_loopback() && keys.is_empty() {
            return Err(ServeError::NoKey(options.bind));
        }
        if options.require_key && keys.is_empty() {
            return Err(ServeError::NoKeyAtAll);
        }
        if !options.bind.ip().is_loopback() && tls.is_none() {
            let bind = options.bind;
            tracing::warn!(%bind, "keys and data are sent unencrypted: use --tls-cert, or a proxy with TLS");
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
            logged_later: Arc::new(Semaphore::new(limits::LOGGED_LATER_MAX)),
            needs: AllNeeds::of(&routes::table()),
            in_progress: guard::InProgress::default(),
            running: once::Running::default(),
            edits: edited::Edits::default(),
            tickets: auth::Tickets::default(),
            wrong_keys: auth::WrongKeys::default(),
            delayed: Semaphore::new(limits::DELAYED),
            local_admin: options.local_admin,
            require_key: options.require_key,
            desk: options.desk,
            memory: Memory::default(),
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
        let queries = Queries::new(store.clone(), datasets.clone(), &options.data);
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
        let placement = PlacementWatch::new(campaign.clone(), serving.clone(), store.clone());
        let app = App {
            serving: serving.clone(),
            facts: Arc::new(facts),
            store,
            keys,
            campaign,
            conductor,
            twins,
            datasets,
            queries,
            models,
            jobs,
            turns: Turns::default(),
            placement,
        };
        let mut tasks = vec![
            tokio::spawn(app.conductor.clone().follow()),
            tokio::spawn(app.conductor.clone().note_estimates()),
            tokio::spawn(app.placement.clone().work()),
            tokio::spawn(samples::keep(app.clone())),
            tokio::spawn(live_status::publish(app.clone())),
            tokio::spawn(after_start(app.clone(), options.resume)),
            tokio::spawn(async move { serving.restore().await }),
        ];
        if !options.idle {
            tasks.extend([
                tokio::spawn(app.twins.clone().work()),
                tokio::spawn(app.datasets.clone().work()),
                tokio::spawn(app.jobs.clone().work()),
                tokio::spawn(finished::keep(app.clone())),
            ]);
        }
        let answering = app.facts.ending.clone();
        let listener = listener.into_std().map_err(bind)?;
        let secure = tls.is_some();
        let door = door::open(listener, router(app.clone()), tls, answering)
            .map_err(ServeError::Thread)?;
        Ok(Self { address, secure, app, ending, door, tasks, engine, _locks: locks })
    }

    /// Address of the service, `http://HOST:PORT`, or `https://` with TLS.
    pub fn url(&self) -> String {
        format!("{}://{}", if self.secure { "https" } else { "http" }, self.address)
    }

    /// Address of the service as clients on this machine reach it.
    pub fn local_url(&self) -> String {
        let mut local = self.address;
        match local.ip() {
            ip if !ip.is_unspecified() => {}
            IpAddr::V4(_) => local.set_ip(Ipv4Addr::LOCALHOST.into()),
            IpAddr::V6(_) => local.set_ip(Ipv6Addr::LOCALHOST.into()),
        }
        self.url().replacen(&self.address.to_string(), &local.to_string(), 1)
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
        if self.app.campaign.stop_switch().pressed().is_some() {
            self.app.conductor.keep_stopped().await;
        }
        self.app.store.close().await;
    }
}

/// Examines the database, and continues the work of the previous process. A run is resumed
/// automatically only after the examination; runs that a person starts do not wait for it.
async fn after_start(app: App, resume: AutoResume) {
    let continue_run = async {
        if let Err(error) = app.conductor.resume_after_restart(resume).await {
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
    if resume == AutoResume::Allowed {
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
