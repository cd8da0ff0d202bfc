//! The rigs of a lab: addresses from the command line or from a file, keys and certificates from files that it names.
//! Uses: `client`, `key`, `trust`. Never: a key in an argument or a message; a key for another address than its own.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use reqwest::Url;
use serde::Deserialize;

use crate::cli::client::{Client, url_limit};
use crate::cli::error::{CliError, CliResult};
use crate::cli::files::read_input;
use crate::cli::key::key_of;
use crate::cli::trust::Certificates;
use crate::problem::Problem;
use crate::syntax::parse_toml;

/// Longest name of a rig, characters.
const RIG_NAME_MAX: usize = 40;

/// A rig with a client of its service.
#[derive(Debug)]
pub struct Rig {
    /// Name, which becomes part of ids and of file names.
    pub name: String,
    /// Client of its service.
    pub client: Client,
}

/// A table of the file of rigs.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    /// Address of the service.
    url: String,
    /// File with the API key in its first line, relative to the file of rigs.
    key_file: Option<PathBuf>,
    /// File with the certificate of the service or of its authority, PEM, relative to the file of rigs.
    ca: Option<PathBuf>,
}

/// The rigs of the command line, each `URL` or `RIG=URL`, and those of a file, by name.
///
/// # Errors
/// `CliError::Problems` with the first name or address that is invalid or occurs twice, or if a file cannot be used; as
/// [`Client::new`].
pub fn rigs(urls: &[String], file: Option<&Path>) -> CliResult<Vec<Rig>> {
    let mut rigs = BTreeMap::new();
    for text in urls {
        let (name, url) = named(text);
        check("command line", "", &name, url)?;
        if rigs.insert(name.clone(), Client::new(url, None, None)?).is_some() {
            return Err(twice("command line", &name));
        }
    }
    if let Some(path) = file {
        let shown = path.display().to_string();
        let entries: BTreeMap<String, Entry> = parse_toml(&shown, &read_input(path)?)?;
        let next_to = |file: &PathBuf| path.parent().unwrap_or(Path::new("")).join(file);
        for (name, entry) in entries {
            check(&shown, &format!("{name}."), &name, &entry.url)?;
            let key = entry.key_file.as_ref().map(|file| key_of(&next_to(file))).transpose()?;
            let ca =
                entry.ca.as_ref().map(|file| Certificates::read(&next_to(file))).transpose()?;
            if rigs.insert(name.clone(), Client::new(&entry.url, ca.as_ref(), key)?).is_some() {
                return Err(twice(&shown, &name));
            }
        }
    }
    Ok(rigs.into_iter().map(|(name, client)| Rig { name, client }).collect())
}

fn twice(file: &str, name: &str) -> CliError {
    let limit = "must be the name of one rig: RIG=URL names a rig";
    Problem::new(file, "rig", name, limit).into()
}

/// Name and address of an argument. Without a name it is the host, with its port if one is stated.
fn named(text: &str) -> (String, &str) {
    match text.split_once('=').filter(|(name, _)| !name.contains(':')) {
        Some((name, url)) => (name.to_owned(), url),
        None => (host(text), text),
    }
}

fn host(url: &str) -> String {
    let Ok(read) = Url::parse(url) else { return String::new() };
    let host = read.host_str().unwrap_or_default();
    let host = read.port().map_or_else(|| host.to_owned(), |port| format!("{host}-{port}"));
    let plain = host.chars().map(|c| if is_of_name(c) { c } else { '-' });
    plain.collect::<String>().trim_matches('-').to_owned()
}

fn is_of_name(c: char) -> bool {
    c.is_ascii_alphanumeric() || "-_.".contains(c)
}

/// Checks name and address of a rig. `table`: prefix of a key in problems.
fn check(file: &str, table: &str, name: &str, url: &str) -> CliResult<()> {
    let refused =
        |key: &str, value: &str, limit: String| Problem::new(file, key, value, limit).into();
    let url_key = format!("{table}url");
    if let Some(limit) = url_limit(url) {
        return Err(refused(&url_key, url, limit));
    }
    let has_secret = |read: Url| !read.username().is_empty() || read.password().is_some();
    if Url::parse(url).is_ok_and(has_secret) {
        let limit = "must have no name and no password: a key is in the file of key_file";
        return Err(refused(&url_key, "an address with a secret", limit.into()));
    }
    let begins_well = name.starts_with(|c: char| c.is_ascii_alphanumeric());
    if !begins_well || name.len() > RIG_NAME_MAX || !name.chars().all(is_of_name) {
        let limit = format!(
            "must begin with a letter or a digit, and have at most {RIG_NAME_MAX} letters, digits, '-', '_' and '.'"
        );
        return Err(refused("rig", name, limit));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(urls: &[&str]) -> Result<Vec<String>, String> {
        let urls: Vec<String> = urls.iter().map(|url| (*url).to_owned()).collect();
        let found = rigs(&urls, None).map_err(|error| error.to_string())?;
        Ok(found.into_iter().map(|rig| format!("{} {}", rig.name, rig.client.url())).collect())
    }

    #[test]
    fn a_rig_is_named_by_a_person_or_by_its_host() {
        let found = names(&["b=http://rig:8080/", "http://10.0.0.5:8081", "http://rig.lab"]);
        let wanted =
            ["10.0.0.5-8081 http://10.0.0.5:8081", "b http://rig:8080", "rig.lab http://rig.lab"];
        assert_eq!(found.unwrap(), wanted);
        assert_eq!(names(&["http://[::1]:9/?a=b"]).unwrap(), ["1--9 http://[::1]:9/?a=b"]);
    }

    #[test]
    fn a_name_twice_or_with_a_slash_and_a_secret_are_refused() {
        for (urls, wanted) in [
            (vec!["a=http://x", "a=http://y"], "rig = a: must be the name of one rig"),
            (vec!["../a=http://x"], "rig = ../a: must begin with a letter or a digit"),
            (vec!["a=x"], "url = x: must start with http:// or https://"),
            (vec!["a=http://me:secret@x"], "url = an address with a secret"),
        ] {
            let found = names(&urls).unwrap_err();
            assert!(found.contains(wanted) && !found.contains("me:secret"), "{found}");
        }
    }

    #[test]
    fn keys_and_certificates_are_in_files_next_to_that_of_the_rigs() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("lab.toml");
        let read = |text: &str| {
            std::fs::write(&file, text).unwrap();
            rigs(&[], Some(&file)).map_err(|error| error.to_string())
        };
        std::fs::write(folder.path().join("a.key"), "palpate_0\n").unwrap();
        let found = read("[b]\nurl = 'http://b'\n[a]\nurl = 'http://a'\nkey_file = 'a.key'\n");
        let found: Vec<String> = found.unwrap().into_iter().map(|rig| rig.name).collect();
        assert_eq!(found, ["a", "b"]);
        let missing = read("[a]\nurl = 'http://a'\nkey_file = 'none.key'\n").unwrap_err();
        assert!(
            missing.contains(&folder.path().join("none.key").display().to_string()),
            "{missing}"
        );
        let wrong = read("[a]\nurl = 'a'\n").unwrap_err();
        assert!(wrong.contains("lab.toml: a.url = a: must start with"), "{wrong}");
        let unknown = read("[a]\nurl = 'http://a'\nkey = 'palpate_0'\n").unwrap_err();
        assert!(unknown.contains("a.key"), "{unknown}");
    }
}
