//! A running service, or one in this process for the duration of a command.
//! Uses: `api`, `client`, `read_only`. Never: a second process that writes into a data folder (prevented by the
//! service's lock); a command that only reads needs no lock.

use std::net::{Ipv4Addr, SocketAddr};
use std::panic::{AssertUnwindSafe, resume_unwind};
use std::path::{Path, PathBuf};

use futures::FutureExt;

use super::client::{Client, Found};
use super::error::{CliError, CliResult};
use super::files::{RigFiles, read_sensor};
use super::key::key;
use super::progress::shown_wait;
use super::read_only::View;
use super::running::Running;
use super::trust::Certificates;
use super::{At, DEFAULT_URL};
use crate::api::{ServeError, ServeOptions, Service};
use crate::conductor::AutoResume;

/// Default number of threads for simulated twins: one keeps up with a rig at a hundred times real
/// speed, and leaves the other processors idle.
pub const TWIN_WORKERS: usize = 1;

/// What is shown while an answer takes long, if a command names nothing more specific.
const WAITING: &str = "waiting for the service";

/// Returns clients of the services that the options may mean, the most likely one first: the named one;
/// otherwise the one that serves the data folder, then the one at the default address.
///
/// # Errors
/// As [`Client::new`]; `CliError::Problems` if the file of `--ca` cannot be read.
pub fn clients(at: &At, key: Option<String>) -> CliResult<Vec<Client>> {
    let ca = at.ca().as_deref().map(Certificates::read).transpose()?;
    let ca = ca.as_ref();
    if let Some(url) = at.url() {
        return Ok(vec![Client::new(&url, ca, key)?]);
    }
    let recorded = Running::read(&at.data()).and_then(|running| {
        let shown = running
            .certificate
            .map(|pem| Certificates { name: running.url.clone(), pem: pem.into_bytes() });
        Client::new(&running.url, ca.or(shown.as_ref()), key.clone()).ok()
    });
    Ok(recorded.into_iter().chain([Client::new(DEFAULT_URL, ca, key)?]).collect())
}

/// Returns the service that the options name, or the one on this machine, if it answers. The service at the default
/// address is none for a command that names another data folder.
///
/// # Errors
/// As [`server`], if a service is named.
pub async fn find(at: &At) -> CliResult<Option<Client>> {
    match server(at).await {
        Ok(client) => Ok(Some(client)),
        // Without a named service, one is started at another address.
        Err(CliError::NoServer { .. } | CliError::Stranger { .. }) if at.url().is_none() => {
            Ok(None)
        }
        Err(error) => Err(error),
    }
}

/// Returns the service, which must be running.
///
/// # Errors
/// `CliError::NoServer` if it does not answer, `Stranger` if something else does; otherwise as [`key`], [`clients`] and
/// [`Client::look`].
pub async fn server(at: &At) -> CliResult<Client> {
    let (mut untrusted, mut stranger) = (None, None);
    for client in clients(at, key()?)? {
        match client.look().await {
            Ok(Found::Palpate) if serves(&client, at).await => return Ok(client),
            Ok(Found::Stranger) => {
                stranger = Some(CliError::Stranger { url: client.url().to_owned() });
            }
            Ok(Found::Palpate | Found::Nothing) => {}
            // A killed service may have left the address of what is now another program.
            Err(error) => untrusted = untrusted.or(Some(error)),
        }
    }
    let none = || CliError::NoServer { url: at.url().unwrap_or_else(|| DEFAULT_URL.into()) };
    Err(untrusted.or(stranger).unwrap_or_else(none))
}

/// Whether a service that was found serves the data folder that a command names.
async fn serves(client: &Client, at: &At) -> bool {
    let folder = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    if at.url().is_some() || !at.names_data() {
        return true;
    }
    // A service that does not tell is asked: it will refuse for a better reason.
    let Ok(status) = client.status().await else { return true };
    let database = folder(Path::new(&status.service.database));
    database.parent() == Some(folder(&at.data()).as_path())
}

/// Options of a service in this process that reads and computes, on a free port of the loopback.
///
/// # Errors
/// `CliError` if the carried sensor file is invalid.
fn options(data: PathBuf, rig: &RigFiles, purpose: Purpose) -> CliResult<ServeOptions> {
    let (sensor, sensor_text) = read_sensor(None)?;
    Ok(ServeOptions {
        tls: None,
        require_key: false,
        desk: true,
        idle: purpose == Purpose::Reads,
        local_admin: false,
        bind: SocketAddr::from((Ipv4Addr::LOCALHOST, 0)),
        data,
        in_place: None,
        rig_file: rig.file.clone(),
        rig_text: rig.text.clone(),
        // The next `serve` finds the runs as they are stored.
        resume: AutoResume::Later,
        twin_workers: TWIN_WORKERS,
        calibration: None,
        sensor,
        sensor_text,
    })
}

/// What a command does with a data folder, if no service runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// It only reads: the service that is started for it makes nothing by itself, so that a look at the data does
    /// not resume a training. If another process without a rig uses the folder, its database is read meanwhile.
    Reads,
    /// Its result leaves the folder. If the folder cannot be written, it works on a copy: it stores what it computes.
    Computes,
    /// It changes the folder, which must be writable.
    Stores,
}

/// Runs `work` with a running service, or with one started for it, which needs no rig.
///
/// # Errors
/// `CliError` if no service can be reached or started, or the error of `work`; `Serve` if another command uses the
/// folder and this one computes or stores; `Problems` if it reads and the folder that was named does not exist, or
/// stores and the folder cannot be written; `File` if a database of a folder that cannot be written was changed
/// meanwhile.
pub async fn with_purpose<T>(
    at: &At,
    purpose: Purpose,
    work: impl AsyncFnOnce(&Client) -> CliResult<T>,
) -> CliResult<T> {
    let (client, own) = opened(at, purpose).await?;
    let client = client.showing(WAITING);
    let outcome = AssertUnwindSafe(work(&client)).catch_unwind().await;
    let mut changed = None;
    // It ends whatever the result, also if the work panics.
    if let Some((service, view)) = own {
        service.shutdown().await;
        changed = view.and_then(|view| view.changed());
    }
    let outcome = outcome.unwrap_or_else(|panic| resume_unwind(panic));
    match changed {
        Some(path) => {
            let words = "was used by another process meanwhile, and the answer may be wrong: repeat the command";
            Err(CliError::File { path, source: std::io::Error::other(words) })
        }
        None => outcome,
    }
}

/// Carries out a command with its options, as [`with_purpose`].
///
/// # Errors
/// As [`with_purpose`].
pub async fn command<A>(
    at: &At,
    purpose: Purpose,
    args: &A,
    command: impl AsyncFnOnce(&Client, &A) -> CliResult<()>,
) -> CliResult<()> {
    with_purpose(at, purpose, async |client| command(client, args).await).await
}

/// A service in this process, with the view of a data folder that it only reads.
type OwnService = (Service, Option<View>);

/// A running service, or one without a rig in this process.
async fn opened(at: &At, purpose: Purpose) -> CliResult<(Client, Option<OwnService>)> {
    if let Some(client) = find(at).await? {
        return Ok((client, None));
    }
    let data = at.data();
    if purpose == Purpose::Reads && at.names_data() && !data.exists() {
        let limit = "there is no such folder: --data and PALPATE_DATA name the folder of the runs";
        return Err(CliError::in_file(&data, limit));
    }
    let (client, own) = own_service(data, purpose).await?;
    Ok((client, Some(own)))
}

/// A service without a rig in this process, on a data folder or on the view of it.
async fn own_service(data: PathBuf, purpose: Purpose) -> CliResult<(Client, OwnService)> {
    if purpose == Purpose::Stores && View::is_needed(&data) {
        let limit = "cannot be written, and this command changes it: name a copy of it with --data, \
                     or a service with --url";
        return Err(CliError::in_file(&data, limit));
    }
    let view = match View::is_needed(&data) {
        true => {
            let view = View::of(&data, purpose == Purpose::Reads).await;
            Some(view.map_err(CliError::file(&data))?)
        }
        false => None,
    };
    let begun = started(data.clone(), view.as_ref(), purpose).await;
    // The folder of a service with a rig is read through it, or not at all: only it knows which of its runs is driven.
    if purpose == Purpose::Reads && begun.as_ref().is_err_and(is_held_without_rig) {
        let view = View::beside(&data).await.map_err(CliError::file(&data))?;
        if let Some(view) = view {
            let (client, service) = started(data, Some(&view), purpose).await?;
            return Ok((client, (service, Some(view))));
        }
    }
    let (client, service) = begun?;
    Ok((client, (service, view)))
}

/// Whether a process without a rig has the lock of the data folder.
fn is_held_without_rig(error: &CliError) -> bool {
    matches!(error, CliError::Serve(ServeError::Locked(lock)) if lock.is_held_without_rig())
}

/// Starts a service on a data folder, or on the view of it.
async fn started(
    data: PathBuf,
    view: Option<&View>,
    purpose: Purpose,
) -> CliResult<(Client, Service)> {
    let folder = view.map_or(data, |view| view.folder().to_owned());
    let in_place = view.and_then(View::in_place);
    let options = ServeOptions { in_place, ..options(folder, &RigFiles::read(None)?, purpose)? };
    let service = shown_wait("opening the data folder", Service::start(options)).await?;
    match Client::new(&service.url(), None, None) {
        Ok(client) => Ok((client.of_own_service(), service)),
        Err(error) => {
            service.shutdown().await;
            Err(error)
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use serde_json::Value;

    use super::*;
    use crate::api::LockFile;
    use crate::clock::Clock;
    use crate::ids::RunUid;
    use crate::store::{ImportedTrial, Label, NewRun, RunKind, Store};

    async fn opened_store(data: &Path) -> Store {
        Store::open(&data.join("palpate.db"), Clock::new(1.0)).await.unwrap()
    }

    /// Stores a run with one trial.
    async fn add_run(store: &Store) {
        let new = NewRun {
            uid: RunUid::new(),
            experiment: "small".into(),
            kind: RunKind::RealRandom,
            definition: "no experiment".into(),
            seed: Some(1),
            rig: Some("no rig".into()),
            sensor: "no sensor".into(),
            calibration_id: None,
            label: Label::Virtual,
            version: "0.1.0".into(),
            git_commit: None,
            deadband_n: 5.0,
            tip_diameter_mm: None,
            plan: None,
            trials_planned: 1,
            auto_resume: false,
            not_before: None,
            submitted_by: "ada".into(),
        };
        let run = store.create_run(new).await.unwrap().uid;
        let trial = ImportedTrial { voltages_v: vec![0.1; 784], ..ImportedTrial::default() };
        store.import_trials(run, None, vec![trial]).await.unwrap();
    }

    /// Reads a folder as one that cannot be written. Returns the number of its trials, and whether its database was
    /// copied.
    async fn read(data: &Path) -> (usize, bool) {
        let view = View::of(data, true).await.unwrap();
        let (client, service) = started(data.into(), Some(&view), Purpose::Reads).await.unwrap();
        let trials: Value = client.get("/api/v1/trials?limit=9").await.unwrap();
        service.shutdown().await;
        assert_eq!(view.changed(), None);
        let is_copied = view.folder().join("palpate.db").exists();
        (trials["items"].as_array().unwrap().len(), is_copied)
    }

    fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
        let paths = folder.read_dir().unwrap().map(|entry| entry.unwrap().path());
        paths.map(|path| (path.clone(), std::fs::read(path).unwrap())).collect()
    }

    #[tokio::test]
    async fn a_folder_that_cannot_be_written_is_read_in_place_unless_trials_are_in_the_log() {
        let (lab, killed) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let store = opened_store(lab.path()).await;
        add_run(&store).await;
        // As a killed process leaves them.
        for name in ["palpate.db", "palpate.db-wal"] {
            std::fs::copy(lab.path().join(name), killed.path().join(name)).unwrap();
        }
        add_run(&store).await;
        store.close().await;
        let computes = View::of(lab.path(), false).await.unwrap();
        assert_eq!(computes.in_place(), None, "what it computes is stored in a copy");
        for (folder, expected) in [(lab, (2, false)), (killed, (1, true))] {
            let before = files(folder.path());
            assert_eq!(read(folder.path()).await, expected);
            assert!(files(folder.path()) == before, "nothing is written");
        }
    }

    #[tokio::test]
    async fn a_folder_that_another_command_uses_is_read_and_not_changed() {
        let lab = tempfile::tempdir().unwrap();
        let data = lab.path().to_owned();
        let (_, first) = started(data.clone(), None, Purpose::Reads).await.unwrap();
        let store = opened_store(&data).await;
        add_run(&store).await;
        store.close().await;
        // As a command that adds a model leaves it meanwhile.
        let model = data.join("models/mdl-0123456789abcdef");
        std::fs::create_dir_all(&model).unwrap();
        std::fs::write(model.join("_partial-1"), "a part of a net").unwrap();
        let (client, (second, view)) = own_service(data.clone(), Purpose::Reads).await.unwrap();
        let trials: Value = client.get("/api/v1/trials?limit=9").await.unwrap();
        assert_eq!(trials["items"].as_array().unwrap().len(), 1);
        second.shutdown().await;
        assert_eq!(view.unwrap().changed(), None);
        assert!(model.join("_partial-1").exists(), "the first command needs it");
        let refused = async |purpose: Purpose| {
            let refused = own_service(data.clone(), purpose).await.map(|_| ());
            let words = refused.unwrap_err().to_string();
            assert!(words.contains("in use by process"), "{purpose:?}: {words}");
        };
        refused(Purpose::Computes).await;
        refused(Purpose::Stores).await;
        first.shutdown().await;
        // As a service that has a rig, and at whose address nothing answers.
        let _lock = LockFile::of_data(&data).unwrap();
        refused(Purpose::Reads).await;
    }

    #[test]
    fn the_service_of_a_command_takes_no_rig() {
        let rig = RigFiles::read(None).unwrap();
        for purpose in [Purpose::Reads, Purpose::Computes, Purpose::Stores] {
            let options = options("data".into(), &rig, purpose).unwrap();
            assert!(options.desk, "{purpose:?}");
            assert_eq!(options.resume, AutoResume::Later, "{purpose:?}");
            assert_eq!(options.idle, purpose == Purpose::Reads, "{purpose:?}");
        }
    }
}
