//! Addresses and secrets: from a file or the environment, never from arguments, which every user of a
//! machine can read. Never: an address or a password in an error.
//!
//! | variable | holds |
//! |---|---|
//! | `PALPATE_QUEUE` | `postgres://USER:PASSWORD@HOST/DATABASE?sslrootcert=FILE` |
//! | `PALPATE_QUEUE_FILE` | a file that only its user can read; its first line is the same |
//! | `PALPATE_STORE` | a folder, or `s3://BUCKET/PREFIX`; keys in `AWS_ACCESS_KEY_ID` and the like |
//! | `PALPATE_STORE_FILE` | such a file: the store, then lines `AWS_ACCESS_KEY_ID=..` and the like |
//! | `PALPATE_STORE_CA` | certificates of the authority of the store, PEM |

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use sqlx::postgres::{PgConnectOptions, PgSslMode};
use url::Url;

use crate::{WorkerError, WorkerResult};

/// Where the store is, with the settings that its client needs.
#[derive(Clone)]
pub struct StoreAddress {
    /// The folder, or the bucket with its prefix.
    pub place: Place,
    /// Settings such as `AWS_REGION`, by name.
    pub settings: Vec<(String, String)>,
    /// Certificates of the authority of the store, PEM.
    pub authority: Option<Vec<u8>>,
}

/// Where results are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Place {
    /// A folder that all machines see.
    Folder(PathBuf),
    /// A bucket of an S3 service.
    Bucket(Url),
}

/// Reads the address of the queue.
///
/// # Errors
/// `WorkerError` if there is none, if its file can be read by others, or if it is invalid or not encrypted.
pub fn queue() -> WorkerResult<PgConnectOptions> {
    let Some((address, from)) = value("PALPATE_QUEUE", "PALPATE_QUEUE_FILE")? else {
        return Err(invalid(
            "no queue: PALPATE_QUEUE_FILE names a file with its address, or PALPATE_QUEUE has it",
        ));
    };
    let line = address.lines().next().unwrap_or("").trim();
    queue_of(line).map_err(|what| WorkerError::Invalid(format!("{from}: {what}")))
}

/// Checks an address of a queue; the error has no part of it that could be secret.
fn queue_of(address: &str) -> Result<PgConnectOptions, String> {
    const FORM: &str = "must have the form postgres://USER:PASSWORD@HOST/DATABASE";
    let url = Url::parse(address).map_err(|error| format!("{error}: {FORM}"))?;
    if !matches!(url.scheme(), "postgres" | "postgresql") {
        return Err(FORM.into());
    }
    let options = PgConnectOptions::from_str(address).map_err(|_| FORM.to_owned())?;
    let host = options.get_host().to_owned();
    let is_local = options.get_socket().is_some() || host.starts_with('/') || is_loopback(&host);
    let names_mode = url.query_pairs().any(|(name, _)| name == "sslmode" || name == "ssl-mode");
    match options.get_ssl_mode() {
        _ if is_local => Ok(options),
        PgSslMode::VerifyFull => Ok(options),
        _ if !names_mode => Ok(options.ssl_mode(PgSslMode::VerifyFull)),
        _ => Err(format!("sslmode of {host}: must be verify-full for another machine")),
    }
}

/// Reads the address of the store.
///
/// # Errors
/// `WorkerError` if there is none, if its file can be read by others, or if it is invalid or not encrypted.
pub fn store() -> WorkerResult<StoreAddress> {
    let Some((text, from)) = value("PALPATE_STORE", "PALPATE_STORE_FILE")? else {
        return Err(invalid(
            "no store: PALPATE_STORE names a folder or s3://BUCKET/PREFIX, or PALPATE_STORE_FILE a file",
        ));
    };
    let of_environment = std::env::vars().filter(|(name, _)| name.starts_with("AWS_"));
    let mut address = store_of(&text, of_environment.collect())
        .map_err(|what| WorkerError::Invalid(format!("{from}: {what}")))?;
    if let Some(path) = std::env::var_os("PALPATE_STORE_CA").filter(|path| !path.is_empty()) {
        address.authority = Some(fs::read(&path).map_err(WorkerError::file(path))?);
    }
    Ok(address)
}

fn store_of(text: &str, mut settings: Vec<(String, String)>) -> Result<StoreAddress, String> {
    let mut lines =
        text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    let first = lines.next().unwrap_or("");
    for (number, line) in lines.enumerate() {
        let Some((name, value)) = line.split_once('=') else {
            return Err(format!("line {}: must have the form AWS_NAME=VALUE", number + 2));
        };
        settings.push((name.trim().to_owned(), value.trim().to_owned()));
    }
    let place = if first.starts_with('/') {
        Place::Folder(first.into())
    } else {
        let url = Url::parse(first)
            .map_err(|error| format!("{error}: must be an absolute path or s3://BUCKET/PREFIX"))?;
        if !url.username().is_empty() || url.password().is_some() {
            return Err("keys must be in AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY".into());
        }
        match url.scheme() {
            "file" => Place::Folder(
                url.to_file_path().map_err(|()| "must name a folder of this machine")?,
            ),
            "s3" => Place::Bucket(url),
            other => {
                return Err(format!("{other}: must be an absolute path or s3://BUCKET/PREFIX"));
            }
        }
    };
    Ok(StoreAddress { place, settings, authority: None })
}

/// Whether a name or an address is this machine.
pub fn is_loopback(host: &str) -> bool {
    let host = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost"
        || host.parse::<std::net::IpAddr>().is_ok_and(|address| address.is_loopback())
}

/// The value of a variable, or the content of the file that another one names, and which of them it was.
fn value(variable: &str, file: &str) -> WorkerResult<Option<(String, String)>> {
    let set = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
    match (set(variable), set(file)) {
        (Some(_), Some(_)) => {
            Err(WorkerError::Invalid(format!("{variable} and {file}: set one of them")))
        }
        (Some(value), None) => Ok(Some((value, variable.to_owned()))),
        (None, Some(path)) => Ok(Some((secret(Path::new(&path))?, path))),
        (None, None) => Ok(None),
    }
}

/// Content of a file that only its user can read.
fn secret(path: &Path) -> WorkerResult<String> {
    let mode = fs::metadata(path).map_err(WorkerError::file(path))?.permissions().mode();
    if mode & 0o077 != 0 {
        let (path, mode) = (path.display(), mode & 0o777);
        return Err(WorkerError::Invalid(format!(
            "{path}: mode {mode:o}: others can read it; run `chmod 600 {path}`"
        )));
    }
    fs::read_to_string(path).map_err(WorkerError::file(path))
}

fn invalid(what: &str) -> WorkerError {
    WorkerError::Invalid(what.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_queue_on_another_machine_is_encrypted_and_its_name_checked() {
        let mode = |address: &str| queue_of(address).unwrap().get_ssl_mode();
        assert!(matches!(mode("postgres://a:b@db.lab/q"), PgSslMode::VerifyFull));
        assert!(matches!(
            mode("postgres://a:b@db.lab/q?sslmode=verify-full"),
            PgSslMode::VerifyFull
        ));
        assert!(
            queue_of("postgres://a@localhost/q").is_ok()
                && queue_of("postgres:///q?host=/run/pg").is_ok()
        );
        for lower in ["disable", "prefer", "require", "verify-ca"] {
            let error =
                queue_of(&format!("postgres://a:hush@db.lab/q?sslmode={lower}")).unwrap_err();
            assert!(error.contains("verify-full") && !error.contains("hush"), "{error}");
        }
    }

    #[test]
    fn an_error_has_no_password() {
        for address in [
            "mysql://a:hush@db/q",
            "a:hush@db",
            "postgres://a:hush@db:port/q",
            "postgres://a:hush@db/q?sslmode=hush",
        ] {
            let error = queue_of(address).unwrap_err();
            assert!(!error.contains("hush"), "{error}");
        }
        let error = store_of("s3://id:hush@bucket", Vec::new()).err().unwrap();
        assert!(error.contains("AWS_ACCESS_KEY_ID") && !error.contains("hush"), "{error}");
        let error = store_of("/data\nhush", Vec::new()).err().unwrap();
        assert!(error.contains("line 2") && !error.contains("hush"), "{error}");
    }

    #[test]
    fn a_store_is_a_folder_or_a_bucket() {
        let place = |text: &str| store_of(text, Vec::new()).map(|address| address.place);
        assert_eq!(place("/shared/palpate").unwrap(), Place::Folder("/shared/palpate".into()));
        assert_eq!(
            place("file:///shared/palpate").unwrap(),
            Place::Folder("/shared/palpate".into())
        );
        assert!(matches!(place("s3://bucket/prefix"), Ok(Place::Bucket(_))));
        assert!(place("shared").is_err() && place("ftp://a/b").is_err() && place("").is_err());
        let address = store_of(
            "s3://b\n# keys\nAWS_REGION = lab\n",
            vec![("AWS_REGION".into(), "other".into())],
        );
        assert_eq!(
            address.ok().unwrap().settings.last().unwrap(),
            &("AWS_REGION".to_owned(), "lab".to_owned())
        );
    }
}
