//! Which datasets can go: the older ones of a name, unless something refers to them.
//! PURE. Uses: `store`'s rows. Never: a file, a dataset that a model, a job or an export that waits needs.

use std::collections::BTreeMap;

use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use crate::ids::DatasetId;
use crate::store::DatasetRow;

/// A dataset, and what becomes of it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct Pruned {
    /// Id of the dataset, `ds-..`.
    pub id: DatasetId,
    /// Name of its definition.
    pub name: String,
    /// Length of its Parquet file, bytes.
    pub bytes: u64,
    /// Wall time of its creation.
    pub created_at: Timestamp,
    /// Wall time at which its rows were last read; absent if unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub last_used_at: Option<Timestamp>,
    /// Why it stays; absent if it goes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stays: Option<String>,
}

/// Decides which datasets go. `rows`: all datasets, newest first; `keep`: how many of each name stay;
/// `needed`: what refers to a dataset, as text.
pub fn decide(
    rows: &[DatasetRow],
    keep: usize,
    needed: &BTreeMap<DatasetId, String>,
    last_used_at: impl Fn(&DatasetId) -> Option<Timestamp>,
) -> Vec<Pruned> {
    let mut seen: BTreeMap<&str, usize> = BTreeMap::new();
    rows.iter()
        .map(|row| {
            let newer = seen.entry(&row.name).or_default();
            *newer += 1;
            let stays = match needed.get(&row.id) {
                Some(what) => Some(format!("{what} refers to it")),
                None if *newer <= keep => Some(format!("one of the {keep} newest of its name")),
                None => None,
            };
            Pruned {
                id: row.id.clone(),
                name: row.name.clone(),
                bytes: row.bytes,
                created_at: row.created_at,
                last_used_at: last_used_at(&row.id),
                stays,
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    fn row(id: &str, name: &str) -> DatasetRow {
        DatasetRow {
            id: DatasetId::unchecked(id),
            name: name.into(),
            definition: Value::Null,
            rows: 1,
            bytes: 10,
            sha256: String::new(),
            report: Value::Null,
            lineage: Value::Null,
            created_at: Timestamp::UNIX_EPOCH,
        }
    }

    #[test]
    fn the_newest_of_each_name_and_what_is_needed_stay() {
        let rows =
            [row("ds-4", "real"), row("ds-3", "run-1"), row("ds-2", "real"), row("ds-1", "real")];
        let needed = BTreeMap::from([(DatasetId::unchecked("ds-1"), "model mdl-7".to_owned())]);
        let of = |keep| -> Vec<(String, Option<String>)> {
            let decided = decide(&rows, keep, &needed, |_| None);
            decided.into_iter().map(|one| (one.id.to_string(), one.stays)).collect()
        };
        let stays = |words: &str| Some(words.to_owned());
        assert_eq!(
            of(1),
            [
                ("ds-4".into(), stays("one of the 1 newest of its name")),
                ("ds-3".into(), stays("one of the 1 newest of its name")),
                ("ds-2".into(), None),
                ("ds-1".into(), stays("model mdl-7 refers to it")),
            ]
        );
        assert_eq!(of(0).iter().filter(|(_, stays)| stays.is_none()).count(), 3);
        assert_eq!(of(2).iter().filter(|(_, stays)| stays.is_none()).count(), 0);
    }
}
