//! `palpate lock` and `palpate key`: rights to start and edit, and to send requests at all.
//! Uses: `client`; without a service `api::Offline`. Never: a key's text except in the answer that creates
//! it; the rig.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};
use reqwest::Method;
use serde_json::{Value, json};

use super::client::{Client, who};
use super::error::{CliError, CliResult};
use super::output::{say, say_json};
use super::table::Table;
use super::times::local;
use super::{At, embed};
use crate::api::{CreatedKey, Offline};
use crate::store::{KeyRow, LockRow, Role};

/// Options of `lock`.
#[derive(Debug, Clone, Args)]
pub struct LockArgs {
    /// Take the lock with this note; without it the lock is shown.
    #[arg(conflicts_with = "clear", value_parser = note_of)]
    pub note: Option<String>,
    /// Release the lock.
    #[arg(long)]
    pub clear: bool,
    #[command(flatten)]
    pub at: At,
}

/// Options of `key`.
#[derive(Debug, Clone, Args)]
pub struct KeyArgs {
    /// Action on the keys; lists them if absent.
    #[command(subcommand)]
    pub command: Option<KeyCommand>,
    #[command(flatten)]
    pub at: At,
}

/// Actions on the keys.
#[derive(Debug, Clone, Subcommand)]
pub enum KeyCommand {
    /// Create a key; its text is shown only once.
    Create {
        /// Name of the holder or purpose.
        name: String,
        /// Rights of the holder.
        #[arg(long, default_value = Role::Operator.as_str(), value_parser = roles())]
        role: Role,
    },
    /// Show the keys, without their texts.
    List,
    /// Show the name of the key that this terminal uses, and its role.
    Whoami,
    /// Revoke a key.
    Revoke {
        /// Number of the key.
        id: i64,
    },
}

/// Words for which the lock is not taken: who types one of them wants something else of it.
const NO_NOTES: [&str; 8] =
    ["release", "clear", "remove", "free", "unlock", "delete", "show", "status"];

/// Reads the note of a lock.
fn note_of(text: &str) -> Result<String, String> {
    if NO_NOTES.contains(&text.trim().to_lowercase().as_str()) {
        let limit = "would be the note of a lock that is taken";
        return Err(format!(
            "{limit}; `palpate lock --clear` releases the lock, `palpate lock` shows it"
        ));
    }
    Ok(text.to_owned())
}

/// Parser of the name of a role; the help lists the roles.
fn roles() -> impl TypedValueParser<Value = Role> {
    let of = |role: Role| PossibleValue::new(role.as_str()).help(role.about());
    let named = |name: String| Role::ALL.into_iter().find(|role| role.as_str() == name);
    PossibleValuesParser::new(Role::ALL.map(of))
        .try_map(move |name| named(name).ok_or("must be the name of a role"))
}

/// Runs `palpate lock`.
///
/// # Errors
/// `CliError` if the service or the data folder cannot be used, or refuses the request.
pub async fn lock(args: LockArgs) -> CliResult<()> {
    with_people(&args.at, async |people| lock_of(people, &args).await).await
}

async fn lock_of(people: &People, args: &LockArgs) -> CliResult<()> {
    let json = args.at.json;
    if args.clear {
        people.clear_lock().await?;
    } else if let Some(note) = &args.note {
        let lock = people.take_lock(note).await?;
        if lock.is_keyless() && !json {
            say("taken without a key, it holds for every caller until `palpate lock --clear`");
        }
    }
    match people.lock().await? {
        lock if json => say_json(&lock),
        Some(l) => say(format_args!("locked by {} since {}: {}", l.holder, local(l.since), l.note)),
        None => say("not locked"),
    }
    Ok(())
}

/// Runs `palpate key`.
///
/// # Errors
/// `CliError` if the service or the data folder cannot be used, or refuses the request.
pub async fn key(args: KeyArgs) -> CliResult<()> {
    let at = &args.at;
    match args.command.unwrap_or(KeyCommand::List) {
        KeyCommand::Create { name, role } => {
            with_people(at, async |people| create(people, at, &name, role).await).await
        }
        KeyCommand::List => with_people(at, async |people| list(people, at).await).await,
        KeyCommand::Revoke { id } => {
            with_people(at, async |people| {
                people.revoke_key(id).await?;
                list(people, at).await
            })
            .await
        }
        KeyCommand::Whoami => whoami(at).await,
    }
}

async fn with_people(at: &At, act: impl AsyncFnOnce(&People) -> CliResult<()>) -> CliResult<()> {
    let people = People::of(at).await?;
    let outcome = act(&people).await;
    people.close().await;
    outcome
}

/// Prints the caller, as the service sees this terminal.
async fn whoami(at: &At) -> CliResult<()> {
    let caller: Value = embed::server(at).await?.get("/api/v1/caller").await?;
    let name = caller["name"].as_str().unwrap_or("without a key");
    let role = caller["role"].as_str().unwrap_or_default();
    at.output().say(&caller, format_args!("{name}, {role}"));
    Ok(())
}

async fn create(people: &People, at: &At, name: &str, role: Role) -> CliResult<()> {
    let made = people.create_key(name, role).await?;
    let CreatedKey { key, secret } = &made;
    let (id, role) = (key.id, key.role.as_str());
    let words = format!("key {id}, {name}, {role}; it is shown this once:\n{secret}");
    at.output().say(&made, words);
    Ok(())
}

async fn list(people: &People, at: &At) -> CliResult<()> {
    let keys = people.keys().await?;
    let mut table =
        Table::new("key> | name | role | state", "there are no keys: palpate key create NAME");
    for key in &keys {
        let state = match (key.revoked_at, key.last_used_at) {
            (Some(at), _) => format!("revoked {}", local(at)),
            (None, Some(at)) => format!("last used {}", local(at)),
            (None, None) => "never used".into(),
        };
        table.push([key.id.to_string(), key.name.clone(), key.role.as_str().into(), state]);
    }
    at.output().say(&keys, table);
    Ok(())
}

/// Keys and lock: of a running service, or of a data folder that no service uses.
enum People {
    Service(Client),
    Folder(Box<Offline>),
}

impl People {
    async fn of(at: &At) -> CliResult<Self> {
        Ok(match embed::find(at).await? {
            Some(client) => Self::Service(client),
            None => Self::Folder(Box::new(Offline::open(&at.data()).await?)),
        })
    }

    async fn close(self) {
        if let Self::Folder(folder) = self {
            folder.close().await;
        }
    }

    async fn lock(&self) -> CliResult<Option<LockRow>> {
        match self {
            Self::Service(client) => client.get("/api/v1/lock").await,
            Self::Folder(folder) => Ok(folder.lock().await?),
        }
    }

    async fn take_lock(&self, note: &str) -> CliResult<LockRow> {
        match self {
            Self::Service(client) => {
                let body = json!({ "holder": client.who(), "note": note });
                client.ask(Method::PUT, "/api/v1/lock", Some(&body)).await
            }
            Self::Folder(folder) => Ok(folder.take_lock(&who(), note).await?),
        }
    }

    async fn clear_lock(&self) -> CliResult<()> {
        match self {
            Self::Service(client) => client.delete("/api/v1/lock").await,
            Self::Folder(folder) => Ok(folder.clear_lock().await.map(drop)?),
        }
    }

    async fn keys(&self) -> CliResult<Vec<KeyRow>> {
        match self {
            Self::Service(client) => client.all("/api/v1/keys?").await,
            Self::Folder(folder) => Ok(folder.keys().await?),
        }
    }

    async fn create_key(&self, name: &str, role: Role) -> CliResult<CreatedKey> {
        match self {
            Self::Service(client) => {
                client.post("/api/v1/keys", &json!({ "name": name, "role": role })).await
            }
            Self::Folder(folder) => Ok(folder.create_key(name, role).await?),
        }
    }

    async fn revoke_key(&self, id: i64) -> CliResult<()> {
        match self {
            Self::Service(client) => client.delete(&format!("/api/v1/keys/{id}")).await,
            Self::Folder(folder) => match folder.revoke_key(id).await? {
                true => Ok(()),
                false => Err(CliError::argument("key", id, "is not the number of a valid key")),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_word_for_a_release_does_not_take_the_lock() {
        let read = |word: &str| {
            let line = LockArgs::augment_args(clap::Command::new("lock"));
            line.try_get_matches_from(["lock", word]).map_err(|error| error.to_string())
        };
        for word in ["release", "clear", "remove", "free", "Unlock", " show "] {
            let refused = read(word).unwrap_err();
            assert!(refused.contains("`palpate lock --clear` releases the lock"), "{refused}");
        }
        assert!(read("--clear").is_ok());
        let taken = read("release the weights at eight").unwrap();
        let note = taken.get_one::<String>("note").map(String::as_str);
        assert_eq!(note, Some("release the weights at eight"));
    }
}
