//! Results in a folder or a bucket, with the layout of an order folder below the id of the order.
//! Uses: the `object_store` crate. Never: a `KEY.json` before the bytes that it names; a key in an error.
//!
//! ```text
//! ORDER_ID/order.json             ORDER_ID/results/KEY.parquet   (the ending depends on the kind)
//! ORDER_ID/failed/KEY.json        ORDER_ID/results/KEY.json      last
//! inputs/SHA256                   a file that orders name, once for all of them
//! ```

use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use futures::TryStreamExt;
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::local::LocalFileSystem;
use object_store::path::Path as ObjectPath;
use object_store::prefix::PrefixStore;
use object_store::{
    Certificate, ClientOptions, Error, ObjectStore, ObjectStoreExt, PutPayload, WriteMultipart,
};
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};
use tokio::fs;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use url::Url;

use crate::address::{Place, StoreAddress, is_loopback};
use crate::order::{Done, Failed, ORDER_FILE, Order, is_hash, sha256};
use crate::{WorkerError, WorkerResult};

/// Folder of the files that orders name, in a store and in the folder of an order.
pub const INPUTS: &str = "inputs";
/// Bytes of a file that are read at a time, and the parts of it that are on the way to the store.
const UPLOAD: (usize, usize) = (1 << 20, 4);
/// Bytes of a file that one request fetches.
const FETCHED: usize = 5 << 20;
/// Longest time of one request.
const REQUEST: Duration = Duration::from_secs(120);

/// Results and definitions of orders.
#[derive(Debug, Clone)]
pub struct Store {
    objects: Arc<dyn ObjectStore>,
    /// Whether it is a folder, in which an object is written under a temporary name and then renamed.
    is_folder: bool,
    /// Whether it holds one order alone, without a folder for it.
    is_one_order: bool,
}

/// One part of an order, by its folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Chunks that are done.
    Results,
    /// Chunks that are set aside.
    Failed,
}

impl Part {
    fn folder(self) -> &'static str {
        match self {
            Self::Results => "results",
            Self::Failed => "failed",
        }
    }
}

impl Store {
    /// Opens the store of an address.
    ///
    /// # Errors
    /// `WorkerError` if the folder is missing, if the settings are incomplete, or if requests to another
    /// machine would not be encrypted.
    pub fn open(address: StoreAddress) -> WorkerResult<Self> {
        let objects: Arc<dyn ObjectStore> = match &address.place {
            Place::Folder(folder) => Arc::new(local(folder)?),
            Place::Bucket(url) => bucket(url, &address)?,
        };
        let is_folder = matches!(address.place, Place::Folder(_));
        Ok(Self { objects, is_folder, is_one_order: false })
    }

    /// The folder of one order on this machine.
    ///
    /// # Errors
    /// `WorkerError::File` if there is no such folder.
    pub fn order_folder(folder: &Path) -> WorkerResult<Self> {
        Ok(Self { objects: Arc::new(local(folder)?), is_folder: true, is_one_order: true })
    }

    fn path(&self, order: &str, rest: &str) -> ObjectPath {
        if self.is_one_order {
            ObjectPath::from(rest)
        } else {
            ObjectPath::from(format!("{order}/{rest}"))
        }
    }

    fn part(&self, order: &str, part: Part, name: &str) -> ObjectPath {
        self.path(order, &format!("{}/{name}", part.folder()))
    }

    /// Reads the definition of an order, and returns it with its text; `None` if there is none.
    ///
    /// # Errors
    /// `WorkerError` if the store does not answer, or the order is not the named one.
    pub async fn order(&self, id: &str) -> WorkerResult<Option<(Order, Bytes)>> {
        let path = self.path(id, ORDER_FILE);
        let Some(text) = self.get(&path).await? else { return Ok(None) };
        let order = Order::parse(&text, path.as_ref())?;
        if !self.is_one_order && order.id != id {
            return Err(WorkerError::Failed(format!("{path}: has the id {}", order.id)));
        }
        Ok(Some((order, text)))
    }

    /// Writes the definition of an order.
    ///
    /// # Errors
    /// `WorkerError::Store` if the store does not take it.
    pub async fn put_order(&self, id: &str, text: Bytes) -> WorkerResult<()> {
        self.put(&self.path(id, ORDER_FILE), text).await
    }

    /// The orders of which the store has a folder.
    ///
    /// # Errors
    /// `WorkerError::Store` if the store does not answer.
    pub async fn orders(&self) -> WorkerResult<Vec<String>> {
        let listed = self.objects.list_with_delimiter(None).await?;
        let names =
            listed.common_prefixes.iter().filter_map(|path| path.filename().map(str::to_owned));
        Ok(names.filter(|name| is_hash(name)).collect())
    }

    /// Keys of a part of an order, with the time at which each was written.
    ///
    /// # Errors
    /// `WorkerError::Store` if the store does not answer.
    pub async fn keys(
        &self,
        order: &str,
        part: Part,
    ) -> WorkerResult<BTreeMap<String, SystemTime>> {
        let folder = self.path(order, part.folder());
        let found = self.objects.list(Some(&folder)).try_filter_map(|object| async move {
            let key = object.location.filename().and_then(|name| name.strip_suffix(".json"));
            Ok(key.map(|key| (key.to_owned(), object.last_modified.into())))
        });
        let found: Result<BTreeMap<String, SystemTime>, Error> = found.try_collect().await;
        match found {
            Err(Error::NotFound { .. }) => Ok(BTreeMap::new()),
            found => Ok(found?),
        }
    }

    /// Whether a chunk is done.
    ///
    /// # Errors
    /// `WorkerError::Store` if the store does not answer.
    pub async fn is_done(&self, order: &str, key: &str) -> WorkerResult<bool> {
        self.has(&self.part(order, Part::Results, &format!("{key}.json"))).await
    }

    /// Writes a file that an order names by its sha256, unless the store has it.
    ///
    /// # Errors
    /// `WorkerError::File` if the file cannot be read, `Invalid` if it is another one, `Store` if the store does not
    /// take it.
    pub async fn put_input(&self, sha256: &str, from: &Path) -> WorkerResult<()> {
        let path = input(sha256);
        if self.has(&path).await? {
            return Ok(());
        }
        let mut file = fs::File::open(from).await.map_err(WorkerError::file(from))?;
        let mut upload = WriteMultipart::new(self.objects.put_multipart(&path).await?);
        match pour(&mut file, &mut upload, from).await {
            Ok(found) if found == sha256 => {
                upload.finish().await?;
                Ok(())
            }
            other => {
                // What remains of it is never under its name.
                drop(upload.abort().await);
                let what = format!("{}: sha256 {}: order again", from.display(), other?);
                Err(WorkerError::Invalid(what))
            }
        }
    }

    /// Fetches a file that an order names by its sha256; in parts, since one request has a longest time. After an error,
    /// what remains of it is of no use.
    ///
    /// # Errors
    /// `WorkerError::Failed` if the store does not have it, or has other bytes; `Store` if it does not answer; `File` if
    /// the file cannot be written.
    pub async fn fetch_input(&self, sha256: &str, to: &Path) -> WorkerResult<()> {
        let path = input(sha256);
        let bytes = match self.objects.head(&path).await {
            Err(Error::NotFound { .. }) => {
                let what = format!("{path}: not in the store: submit the order again");
                return Err(WorkerError::Failed(what));
            }
            found => found?.size,
        };
        let failed = || WorkerError::file(to);
        let mut file = fs::File::create(to).await.map_err(failed())?;
        let mut hash = Sha256::new();
        for first in (0..bytes).step_by(FETCHED) {
            let part = first..bytes.min(first + FETCHED as u64);
            let piece = self.objects.get_range(&path, part).await?;
            hash.update(&piece);
            file.write_all(&piece).await.map_err(failed())?;
        }
        file.flush().await.map_err(failed())?;
        let found = hex::encode(hash.finalize());
        if found != sha256 {
            let what = format!("{path}: sha256 {found}: remove it, and submit the order again");
            return Err(WorkerError::Failed(what));
        }
        Ok(())
    }

    /// What a result states of itself; `None` if the chunk is not done.
    ///
    /// # Errors
    /// `WorkerError` if the store does not answer, or if it is damaged.
    pub async fn done(&self, order: &str, key: &str) -> WorkerResult<Option<Done>> {
        self.json(&self.part(order, Part::Results, &format!("{key}.json"))).await
    }

    /// Why a chunk is set aside; `None` if it is not.
    ///
    /// # Errors
    /// `WorkerError` if the store does not answer, or if it is damaged.
    pub async fn failed(&self, order: &str, key: &str) -> WorkerResult<Option<Failed>> {
        self.json(&self.part(order, Part::Failed, &format!("{key}.json"))).await
    }

    /// The bytes of a result, checked by length and hash; `None` if there are none.
    ///
    /// # Errors
    /// `WorkerError::Failed` if they are not those that `done` names, `Store` if the store does not answer.
    pub async fn bytes(&self, order: &Order, done: &Done) -> WorkerResult<Option<Bytes>> {
        let path = self.part(&order.id, Part::Results, &order.bytes_name(&done.key));
        let Some(bytes) = self.get(&path).await? else { return Ok(None) };
        check(&bytes, done).map_err(|what| WorkerError::Failed(format!("{path}: {what}")))?;
        Ok(Some(bytes))
    }

    /// Writes a result: its bytes, and then what it states of itself.
    ///
    /// # Errors
    /// `WorkerError::Store` if the store does not take it; the chunk is then not done.
    pub async fn put_result(&self, order: &Order, done: &Done, bytes: Bytes) -> WorkerResult<()> {
        let part = |name: &str| self.part(&order.id, Part::Results, name);
        self.put(&part(&order.bytes_name(&done.key)), bytes).await?;
        self.put_json(&part(&format!("{}.json", done.key)), done).await
    }

    /// Sets a chunk aside.
    ///
    /// # Errors
    /// `WorkerError::Store` if the store does not take it.
    pub async fn put_failed(&self, order: &str, failed: &Failed) -> WorkerResult<()> {
        self.put_json(&self.part(order, Part::Failed, &format!("{}.json", failed.key)), failed)
            .await
    }

    /// Removes what states that a chunk is done or set aside; none may be there.
    ///
    /// # Errors
    /// `WorkerError::Store` if the store refuses.
    pub async fn remove(&self, order: &str, part: Part, key: &str) -> WorkerResult<()> {
        match self.objects.delete(&self.part(order, part, &format!("{key}.json"))).await {
            Ok(()) | Err(Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    async fn has(&self, path: &ObjectPath) -> WorkerResult<bool> {
        match self.objects.head(path).await {
            Ok(_) => Ok(true),
            Err(Error::NotFound { .. }) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    async fn get(&self, path: &ObjectPath) -> WorkerResult<Option<Bytes>> {
        match self.objects.get(path).await {
            Ok(found) => Ok(Some(found.bytes().await?)),
            Err(Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    async fn json<T: DeserializeOwned>(&self, path: &ObjectPath) -> WorkerResult<Option<T>> {
        let Some(text) = self.get(path).await? else { return Ok(None) };
        let damaged = |error: serde_json::Error| WorkerError::Failed(format!("{path}: {error}"));
        serde_json::from_slice(&text).map(Some).map_err(damaged)
    }

    async fn put(&self, path: &ObjectPath, bytes: Bytes) -> WorkerResult<()> {
        if !self.is_folder {
            self.objects.put(path, PutPayload::from(bytes)).await?;
            return Ok(());
        }
        // What a kill leaves has a name that `palpate cluster` removes, or passes over.
        let name = path.filename().unwrap_or_default();
        let folder = path.as_ref().strip_suffix(name).unwrap_or_default();
        let partial = ObjectPath::from(format!("{folder}{}", partial_name()));
        self.objects.put(&partial, PutPayload::from(bytes)).await?;
        self.objects.rename(&partial, path).await?;
        Ok(())
    }

    async fn put_json(&self, path: &ObjectPath, value: &impl serde::Serialize) -> WorkerResult<()> {
        let text =
            serde_json::to_vec(value).map_err(|error| WorkerError::Store(error.to_string()))?;
        self.put(path, text.into()).await
    }
}

/// Place of a file that orders name.
fn input(sha256: &str) -> ObjectPath {
    ObjectPath::from(format!("{INPUTS}/{sha256}"))
}

/// Passes a file on, and returns its sha256.
async fn pour(
    file: &mut fs::File,
    upload: &mut WriteMultipart,
    from: &Path,
) -> WorkerResult<String> {
    let (mut piece, mut hash) = (vec![0; UPLOAD.0], Sha256::new());
    loop {
        let count = file.read(&mut piece).await.map_err(WorkerError::file(from))?;
        if count == 0 {
            return Ok(hex::encode(hash.finalize()));
        }
        hash.update(&piece[..count]);
        upload.wait_for_capacity(UPLOAD.1).await?;
        upload.write(&piece[..count]);
    }
}

/// A name that no other process uses, on no other machine either.
fn partial_name() -> String {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let since_1970 = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let (process, count) = (std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
    format!("_partial-{:x}-{process:x}-{count:x}", since_1970.as_nanos())
}

/// Compares bytes with what a result states of them.
///
/// # Errors
/// What differs.
pub fn check(bytes: &[u8], done: &Done) -> Result<(), String> {
    if bytes.len() as u64 != done.bytes {
        return Err(format!("{} bytes: {} were written", bytes.len(), done.bytes));
    }
    let found = sha256(bytes);
    if found != done.sha256 {
        return Err(format!("sha256 {found}: {} was written", done.sha256));
    }
    Ok(())
}

fn local(folder: &Path) -> WorkerResult<LocalFileSystem> {
    // A folder that is missing may be a share that is not mounted.
    let missing = |error: &dyn Display| {
        WorkerError::Invalid(format!("{}: {error}: make the folder first", folder.display()))
    };
    if !folder.is_dir() {
        return Err(missing(&"not a folder"));
    }
    let store = LocalFileSystem::new_with_prefix(folder).map_err(|error| missing(&error))?;
    Ok(store.with_fsync(true))
}

fn bucket(url: &Url, address: &StoreAddress) -> WorkerResult<Arc<dyn ObjectStore>> {
    let invalid = |what: String| WorkerError::Invalid(format!("store {url}: {what}"));
    let mut client = ClientOptions::new().with_timeout(REQUEST);
    if let Some(pem) = &address.authority {
        // One that is not read would be missed only when the store does not answer.
        let certificates = Certificate::from_pem_bundle(pem)
            .map_err(|error| invalid(format!("PALPATE_STORE_CA: {error}")))?;
        if certificates.is_empty() {
            return Err(invalid("PALPATE_STORE_CA: no certificate: must be PEM".into()));
        }
        for certificate in certificates {
            client = client.with_root_certificate(certificate);
        }
    }
    let mut builder = AmazonS3Builder::new().with_client_options(client).with_url(url.as_str());
    for (name, value) in &address.settings {
        if let Ok(key) = name.to_ascii_lowercase().parse::<AmazonS3ConfigKey>() {
            builder = builder.with_config(key, value);
        }
    }
    // AWS_ALLOW_HTTP does not count; of two endpoints the client chooses one.
    let mut allow_http = false;
    for key in [AmazonS3ConfigKey::Endpoint, AmazonS3ConfigKey::S3Endpoint] {
        let Some(text) = builder.get_config_value(&key) else { continue };
        let name = key.as_ref().to_ascii_uppercase();
        let endpoint = Url::parse(&text).map_err(|error| invalid(format!("{name}: {error}")))?;
        let is_here = endpoint.host_str().is_some_and(is_loopback);
        if endpoint.scheme() != "https" && !is_here {
            return Err(invalid(format!("{name}: must be https for another machine")));
        }
        allow_http |= is_here;
    }
    let store =
        builder.with_allow_http(allow_http).build().map_err(|error| invalid(error.to_string()))?;
    Ok(Arc::new(PrefixStore::new(store, ObjectPath::from(url.path()))))
}
