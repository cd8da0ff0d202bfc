//! The life of the service: opens its parts, starts their work, listens, and ends in order.
//! Uses: every part of the service. Never: a route, motion except the end of the campaign.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::Arc;
use std::time::{Duration, Instant};

use jiff::Timestamp;
use tokio::net::TcpListener;
use tokio::runtime;
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinHandle;

use super::lock_file::LockFile;
use super::memory::Memory;
use super::options::{ServeError, ServeOptions};
use super::routes::{self, AllNeeds};
use super::tls::Tls;
use super::turns::Turns;
use super::{
    App, Facts, auth, data_folder, door, edited, finished, gather, guard, limits, live_status,
    once, rates, router, samples,
};
use crate::campaign::run::engine;
use crate::campaign::shown::command::Request;
use crate::campaign::shown::status::RunStatus;
use crate::clock::Clock;
use crate::conductor::{AutoResume, Conductor, RigFile};
use crate::dataset::catalog::Catalog;
use crate::infer::registry::Registry;
use crate::infer::serving::Serving;
use crate::jobs::Jobs;
use crate::journal::error_chain;
use crate::placement::watch::PlacementWatch;
use crate::query::Queries;
use crate::rig::setup::RigSetup;
use crate::simulate::model::sweep_partial;
use crate::store::{KeyRing, Soundness, Store};
use crate::twins::TwinPool;

/// Number of newest trials whose checksums are verified at the start.
const EXAMINED_TRIALS: u32 = 2000;

/// Longest wait for the campaign's thread, which raises the tips, when the service ends.
const LEAVE: Duration = Duration::from_secs(60);

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
        let config = RigSetup::from_toml(&options.rig_file, &options.rig_text)
            .map_err(|problems| ServeError::Rig { problems })?;
        let tls = options.tls.as_ref().map(Tls::acceptor).transpose()?;
        let mut locks = vec![data_folder::open(&options.data)?];
        match options.desk {
            true => locks[0].note_no_rig(),
            false => locks.extend(LockFile::of_rig(&config)?),
        }
        let (database, clock) = (data_folder::database(&options.data), Clock::new(1.0));
        let store = match &options.in_place {
            Some((in_place, sharing)) => {
                Store::read_in_place(in_place, *sharing, &database, clock).await?
            }
            None => Store::open(&database, clock).await?,
        };
        if options.resume == AutoResume::Later {
            store.leave_open_runs();
        }
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
            data: options.data.clone(),
            started_at: Timestamp::now(),
            began: Instant::now(),
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
        // Nothing shows what a broken-off import has left: a rig need not wait for it.
        if options.in_place.is_none()
            && let Err(error) = store.sweep_imports().await
        {
            let error = error_chain(&error);
            tracing::warn!(error, "what an import has left is removed at the next start");
        }
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
            tokio::spawn(rates::keep(app.clone())),
            tokio::spawn(live_status::publish(app.clone())),
            tokio::spawn(after_start(app.clone(), options.resume)),
        ];
        if !options.idle {
            tasks.extend([
                // The preparation of a skin takes most of a minute, and is for answers to frames.
                tokio::spawn(async move { serving.restore().await }),
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

    /// The active run; `None` without one.
    pub fn active_run(&self) -> Option<RunStatus> {
        self.app.campaign.status().run
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
        self.app.conductor.keep_stopped().await;
        gather::ended(&self.app).await;
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
