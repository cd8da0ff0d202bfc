//! The database's migrations: the files of `migrations/`, embedded.
//! Uses: nothing else of the store. Never: a migration from outside the program.
//!
//! sqlx's own macro does the same, but its crate builds SQLite a second time, for the compiler.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use rust_embed::RustEmbed;
use sqlx::migrate::{Migration, MigrationType, Migrator};
use sqlx::sqlite::SqliteConnection;
use sqlx::{AssertSqlSafe, SqlSafeStr};

#[derive(RustEmbed)]
#[folder = "../../migrations"]
struct Files;

/// All migrations, in order.
pub(crate) static MIGRATIONS: LazyLock<Migrator> = LazyLock::new(|| {
    Migrator::with_migrations(Files::iter().filter_map(|name| migration(&name)).collect())
});

/// Whether a database has all migrations, and no others. Writes nothing, unlike `Migrator::run`.
pub(crate) async fn are_applied(connection: &mut SqliteConnection) -> Result<bool, sqlx::Error> {
    let applied: Vec<(i64, Vec<u8>)> =
        sqlx::query_as("SELECT version, checksum FROM _sqlx_migrations WHERE success")
            .fetch_all(connection)
            .await?;
    let applied: BTreeMap<i64, Vec<u8>> = applied.into_iter().collect();
    let known = MIGRATIONS.iter().map(|known| (known.version, known.checksum.to_vec()));
    let known: BTreeMap<i64, Vec<u8>> = known.collect();
    Ok(applied == known)
}

/// The migration of a file `NNNN_what_it_does.sql`, as sqlx reads it from a folder; `None` for other
/// files.
fn migration(name: &str) -> Option<Migration> {
    let stem = name.strip_suffix(".sql")?;
    let (version, description) = stem.split_once('_').expect("a name as a test checks it");
    let version = version.parse().expect("a name as a test checks it");
    let file = Files::get(name).expect("a listed file");
    let sql = String::from_utf8(file.data.into_owned()).expect("SQL is UTF-8");
    let no_transaction = sql.starts_with("-- no-transaction");
    let (description, sql) = (description.replace('_', " "), AssertSqlSafe(sql).into_sql_str());
    let kind = MigrationType::Simple;
    Some(Migration::new(version, description.into(), kind, sql, no_transaction))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn files_are_embedded_as_sqlx_reads_them_from_the_folder() {
        let folder = std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../migrations"));
        let read = Migrator::new(folder).await.unwrap();
        let both = MIGRATIONS.iter().zip(read.iter());
        assert_eq!(MIGRATIONS.iter().count(), read.iter().count(), "touch this file");
        for (embedded, read) in both {
            assert_eq!(embedded.version, read.version);
            assert_eq!(embedded.description, read.description);
            assert_eq!(embedded.migration_type, read.migration_type);
            assert_eq!(embedded.checksum, read.checksum);
            assert_eq!(embedded.no_tx, read.no_tx);
        }
    }
}
