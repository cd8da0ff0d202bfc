//! `palpate lock` and `palpate key`: rights to start and edit, and to send requests at all.
//! Uses: `client`. Never: a key's text except in the answer that creates it.

use clap::{Args, Subcommand, ValueEnum};
use reqwest::Method;
use serde_json::{Value, json};

use super::client::Client;
use super::error::CliError;
use super::output::{say, say_json};
use super::{At, embed};
use crate::store::{KeyRow, LockRow};

/// Options of `lock`.
#[derive(Debug, Clone, Args)]
pub struct LockArgs {
    /// Take the lock with this note; without it the lock is shown.
    #[arg(conflicts_with = "clear")]
    pub note: Option<String>,
    /// Release the lock.
    #[arg(long)]
    pub clear: bool,
    /// Server, or data folder.
    #[command(flatten)]
    pub at: At,
}

/// Options of `key`.
#[derive(Debug, Clone, Args)]
pub struct KeyArgs {
    /// Action on the keys; lists them if absent.
    #[command(subcommand)]
    pub command: Option<KeyCommand>,
    /// Server, or data folder.
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
        #[arg(long, value_enum, default_value_t = RoleName::Operator)]
        role: RoleName,
    },
    /// Show the keys, without their texts.
    List,
    /// Revoke a key.
    Revoke {
        /// Number of the key.
        id: i64,
    },
}

/// Rights of a key; each role includes the ones before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum RoleName {
    /// Read, and stop.
    Viewer,
    /// Start runs and move the rig.
    Operator,
    /// Manage keys, release another person's lock.
    Admin,
}

impl RoleName {
    fn as_str(self) -> &'static str {
        match self {
            RoleName::Viewer => "viewer",
            RoleName::Operator => "operator",
            RoleName::Admin => "admin",
        }
    }
}

/// Runs `palpate lock`.
///
/// # Errors
/// `CliError` if the service cannot be reached or started, or refuses the request.
pub async fn lock(args: LockArgs) -> Result<(), CliError> {
    let LockArgs { note, clear, at } = args;
    let json = at.json;
    embed::with_admin(&at, move |client| async move {
        if clear {
            client.delete("/api/v1/lock").await?;
        } else if let Some(note) = note {
            let body = json!({ "holder": client.who(), "note": note });
            let lock: LockRow = client.ask(Method::PUT, "/api/v1/lock", Some(&body)).await?;
            if lock.is_keyless() && !json {
                say("taken without a key, it holds for everybody until `palpate lock --clear`");
            }
        }
        let lock: Option<LockRow> = client.get("/api/v1/lock").await?;
        match lock {
            lock if json => say_json(&lock),
            Some(l) => say(format_args!("locked by {} since {}: {}", l.holder, l.since, l.note)),
            None => say("not locked"),
        }
        Ok(())
    })
    .await
}

/// Runs `palpate key`.
///
/// # Errors
/// `CliError` if the service cannot be reached or started, or refuses the request.
pub async fn key(args: KeyArgs) -> Result<(), CliError> {
    let (json, command) = (args.at.json, args.command.unwrap_or(KeyCommand::List));
    embed::with_admin(&args.at, move |client| async move {
        match command {
            KeyCommand::Create { name, role } => create(&client, &name, role, json).await,
            KeyCommand::List => list(&client, json).await,
            KeyCommand::Revoke { id } => {
                client.delete(&format!("/api/v1/keys/{id}")).await?;
                list(&client, json).await
            }
        }
    })
    .await
}

async fn create(client: &Client, name: &str, role: RoleName, json: bool) -> Result<(), CliError> {
    let body = json!({ "name": name, "role": role.as_str() });
    let made: Value = client.post("/api/v1/keys", &body).await?;
    if json {
        say_json(&made);
        return Ok(());
    }
    let (id, role) = (&made["key"]["id"], role.as_str());
    say(format_args!("key {id}, {name}, {role}; it is shown this once:"));
    say(made["secret"].as_str().unwrap_or_default());
    Ok(())
}

async fn list(client: &Client, json: bool) -> Result<(), CliError> {
    let keys: Vec<KeyRow> = client.all("/api/v1/keys?").await?;
    if json {
        say_json(&keys);
        return Ok(());
    }
    if keys.is_empty() {
        say("no keys");
    }
    for key in keys {
        let state = match (key.revoked_at, key.last_used_at) {
            (Some(at), _) => format!("revoked {at}"),
            (None, Some(at)) => format!("last used {at}"),
            (None, None) => "never used".into(),
        };
        let role = format!("{:?}", key.role).to_lowercase();
        say(format_args!("{:>4}  {:<20} {role:<9} {state}", key.id, key.name));
    }
    Ok(())
}
