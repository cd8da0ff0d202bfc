//! A work order: which chunks there are, what determines their bytes, and their keys.
//! PURE. Uses: `difference`, `digest`, serde_json. Never: files, what a definition means (its kind knows it).

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::difference::{Difference, first_difference};
use crate::digest::{ID_DIGITS, sha256_hex};
use crate::problem::Problem;

/// Name of the file of a work order.
pub const ORDER_FILE: &str = "order.json";
/// The code that makes chunks: this program's version, and the version of the form of keys, which is increased by a
/// change that gives other bytes and is not in the definition of a kind.
pub const CHUNK_CODE: &str = concat!(env!("CARGO_PKG_VERSION"), ", chunk 1");
/// Largest number of chunks of a work order.
pub const CHUNKS_MAX: u64 = 100_000;
/// Version of the form of a work order.
const ORDER_FORM: u32 = 1;
/// Endings of the files with the bytes of chunks, by kind.
const ENDINGS: [(&str, &str); 2] = [("readings", "jsonl"), ("trainings", "net")];
const COMMON_ENDING: &str = "parquet";

/// Bulk work, divided into chunks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorkOrder {
    /// Version of this form.
    pub version: u32,
    /// Kind of the chunks, for example `sim-random`.
    pub kind: String,
    /// sha256 of kind, code and definition.
    pub id: String,
    /// [`CHUNK_CODE`] of the program that wrote the order.
    pub code: String,
    /// Everything that determines the bytes of all chunks.
    pub definition: Value,
    /// Texts of files that the definition identifies, such as the sensor file, by name.
    pub inputs: BTreeMap<String, String>,
    /// sha256 of the files that the definition identifies and that are too large for this text, such as datasets; they
    /// are in the order's folder.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub files: BTreeSet<String>,
    /// Number of chunks.
    pub chunks: u64,
}

/// A definition as JSON.
pub fn value_of(definition: &impl Serialize) -> Value {
    serde_json::to_value(definition).expect("a definition is JSON")
}

/// A problem with a value of a work order that is too long to show.
pub fn invalid(key: &str, why: impl Display) -> Problem {
    Problem::new(ORDER_FILE, key, "..", why.to_string())
}

/// Checks that this machine would order the same; `limit` says what is possible here.
///
/// # Errors
/// The first value of the definition that differs.
pub fn check_here<D: Serialize>(
    ordered: &D,
    here: &D,
    limit: impl FnOnce(&Difference) -> String,
) -> Result<(), Problem> {
    first_difference(&value_of(ordered), &value_of(here)).map_or(Ok(()), |found| {
        let (key, limit) = (format!("definition.{}", found.field), limit(&found));
        Err(Problem::new(ORDER_FILE, &key, found.there, limit))
    })
}

/// Inputs that contain a text for each chunk.
pub fn chunk_inputs(what: &str, texts: Vec<String>) -> impl Iterator<Item = (String, String)> {
    (0..).zip(texts).map(move |(index, text)| (chunk_input(what, index), text))
}

/// Name of the input of a chunk.
pub fn chunk_input(what: &str, index: u64) -> String {
    format!("{what}-{index:05}")
}

/// The input of a chunk, and its sha256, which must be that in the definition.
///
/// # Errors
/// As text: an input that is not in the definition, or that cannot be read.
pub fn read_input<'a, T>(
    what: &str,
    index: u64,
    inputs: &BTreeMap<String, String>,
    stated: &'a [String],
    read: impl FnOnce(&str) -> Result<T, String>,
) -> Result<(T, &'a str), String> {
    let name = chunk_input(what, index);
    let text = inputs.get(&name).map_or("", String::as_str);
    let stated = usize::try_from(index).ok().and_then(|at| stated.get(at));
    let stated = stated.ok_or_else(|| format!("{name}: the order has no such chunk"))?;
    if sha256_hex(text) != *stated {
        return Err(format!("{name}: has other {what} than the definition; order again"));
    }
    Ok((read(text).map_err(|error| format!("{name} {error}"))?, stated))
}

impl WorkOrder {
    /// A work order of this program, without files.
    pub fn new(
        kind: &str,
        definition: &impl Serialize,
        inputs: BTreeMap<String, String>,
        chunks: u64,
    ) -> Self {
        let (kind, code) = (kind.to_owned(), CHUNK_CODE.to_owned());
        let definition = value_of(definition);
        let (version, id, files) = (ORDER_FORM, String::new(), BTreeSet::new());
        let unnamed = Self { version, kind, id, code, definition, inputs, files, chunks };
        Self { id: sha256_hex(canonical(&unnamed.identity())), ..unnamed }
    }

    /// Reads and checks a work order.
    ///
    /// # Errors
    /// The first value that is wrong: another version of form or code, an id that is not that of the definition, a
    /// number of chunks outside its limits.
    pub fn from_json(text: &[u8]) -> Result<Self, Problem> {
        let problem = |key: &str, value: &dyn std::fmt::Display, limit: String| {
            Problem::new(ORDER_FILE, key, value, limit)
        };
        let unreadable = |error: serde_json::Error| Problem::whole(ORDER_FILE, error.to_string());
        // As a value first: the fields of another version may differ.
        let value: Value = serde_json::from_slice(text).map_err(unreadable)?;
        if value["version"] != json!(ORDER_FORM) {
            let limit = format!("this program reads version {ORDER_FORM}");
            return Err(problem("version", &value["version"], limit));
        }
        if value["code"] != json!(CHUNK_CODE) {
            let limit =
                format!("this program is \"{CHUNK_CODE}\"; use the one that wrote the order");
            return Err(problem("code", &value["code"], limit));
        }
        let order: Self = serde_json::from_value(value).map_err(unreadable)?;
        let needed = sha256_hex(canonical(&order.identity()));
        if order.id != needed {
            let limit = format!("the id of its content is {needed}; order again, do not edit");
            return Err(problem("id", &order.id, limit));
        }
        if !(1..=CHUNKS_MAX).contains(&order.chunks) {
            let limit = format!("must be from 1 to {CHUNKS_MAX}");
            return Err(problem("chunks", &order.chunks, limit));
        }
        Ok(order)
    }

    /// The definition, as its kind reads it.
    ///
    /// # Errors
    /// If it is of another form.
    pub fn read_definition<D: DeserializeOwned>(&self) -> Result<D, Problem> {
        serde_json::from_value(self.definition.clone())
            .map_err(|error| invalid("definition", error))
    }

    /// Checks that the number of chunks is that of the definition.
    ///
    /// # Errors
    /// If it is another.
    pub fn check_chunks(&self, needed: u64) -> Result<(), Problem> {
        if self.chunks == needed {
            return Ok(());
        }
        let limit = format!("its definition has {needed}");
        Err(Problem::new(ORDER_FILE, "chunks", self.chunks, limit))
    }

    /// Returns the text of its file.
    ///
    /// # Errors
    /// If the definition cannot be written as JSON.
    pub fn to_json(&self) -> Result<Vec<u8>, serde_json::Error> {
        let mut text = serde_json::to_vec_pretty(self)?;
        text.push(b'\n');
        Ok(text)
    }

    /// What the id is the hash of.
    pub fn identity(&self) -> Value {
        json!({ "kind": self.kind, "code": self.code, "definition": self.definition })
    }

    /// Start of the id, for people.
    pub fn short_id(&self) -> &str {
        self.id.get(..ID_DIGITS).unwrap_or(&self.id)
    }

    /// Name of the file with the bytes of a chunk.
    pub fn bytes_name(&self, key: &str) -> String {
        let ending = ENDINGS.iter().find(|(kind, _)| *kind == self.kind);
        let ending = ending.map_or(COMMON_ENDING, |(_, ending)| ending);
        format!("{key}.{ending}")
    }

    /// Key of a chunk: sha256 of kind, code, definition and index.
    pub fn key(&self, index: u64) -> String {
        let mut content = self.identity();
        content["index"] = index.into();
        sha256_hex(canonical(&content))
    }
}

/// A finished chunk, as stored next to its bytes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChunkRow {
    /// Key of the chunk.
    pub key: String,
    /// Index of the chunk in its order.
    pub index: u64,
    /// sha256 of its bytes.
    pub sha256: String,
    /// Number of bytes.
    pub bytes: u64,
    /// Number of rows.
    pub rows: u64,
    /// Host that made it.
    pub made_by: String,
    /// Commit of the program that made it, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub commit: Option<String>,
    /// Time that it took, ms of wall time.
    pub wall_ms: u64,
}

/// The last failure of a chunk.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FailedChunk {
    /// Key of the chunk.
    pub key: String,
    /// Index of the chunk in its order.
    pub index: u64,
    /// Number of failures until now.
    pub attempts: u64,
    /// The last error, as text.
    pub error: String,
}

/// A JSON value as its one canonical text: keys in order, no spaces.
pub fn canonical(value: &Value) -> String {
    let mut value = value.clone();
    value.sort_all_objects();
    value.to_string()
}

/// Ascending numbers as ranges: `0-3,7`.
pub fn ranges(numbers: &[u64]) -> String {
    let mut runs: Vec<[u64; 2]> = Vec::new();
    for &number in numbers {
        match runs.last_mut() {
            Some([_, last]) if *last + 1 == number => *last = number,
            _ => runs.push([number, number]),
        }
    }
    let shown = runs.iter().map(|[first, last]| match first == last {
        true => first.to_string(),
        false => format!("{first}-{last}"),
    });
    shown.collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn order() -> WorkOrder {
        let inputs = [("sensor_file".to_owned(), "name = 1".to_owned())].into();
        WorkOrder::new("numbers", &json!({ "b": 1, "a": [1.5, "x"] }), inputs, 3)
    }

    #[test]
    fn a_value_has_one_text() {
        let text = r#"{"b": {"z": null, "y": [1, 2.5, "ä\"\n"]}, "a": true}"#;
        let value: Value = serde_json::from_str(text).unwrap();
        let shown = canonical(&value);
        assert_eq!(shown, r#"{"a":true,"b":{"y":[1,2.5,"ä\"\n"],"z":null}}"#);
        // sha256sum of this text.
        assert_eq!(
            sha256_hex(shown),
            "8f2d37f2b09b0a95b12b1b06376cf2c2ce8a0b878ba0a22b071b636dff7645c2"
        );
    }

    #[test]
    fn keys_differ_by_kind_code_definition_and_index_and_by_nothing_else() {
        let order = order();
        let key = order.key(0);
        assert_ne!(key, order.key(1));
        for other in [
            WorkOrder { kind: "letters".into(), ..order.clone() },
            WorkOrder { code: "0.0.0, chunk 1".into(), ..order.clone() },
            WorkOrder { definition: json!({ "b": 2, "a": [1.5, "x"] }), ..order.clone() },
        ] {
            assert_ne!(key, other.key(0), "{other:?}");
        }
        let files = ["0".repeat(64)].into();
        let same = WorkOrder { chunks: 9, inputs: BTreeMap::new(), files, ..order.clone() };
        assert_eq!(key, same.key(0));
        assert_eq!(order.short_id().len(), ID_DIGITS);
        assert_eq!(order.bytes_name("a"), "a.parquet");
        let nets = WorkOrder { kind: "trainings".into(), ..order };
        assert_eq!(nets.bytes_name("a"), "a.net");
        let readings = WorkOrder { kind: "readings".into(), ..nets };
        assert_eq!(readings.bytes_name("a"), "a.jsonl");
    }

    #[test]
    fn an_order_is_read_as_it_was_written_and_refused_if_it_was_changed() {
        let order = order();
        let text = order.to_json().unwrap();
        assert_eq!(WorkOrder::from_json(&text), Ok(order.clone()));
        let value = serde_json::to_value(&order).unwrap();
        for (key, changed) in [
            ("version", json!(2)),
            ("code", json!("9.9.9, chunk 1")),
            ("id", json!("0")),
            ("chunks", json!(0)),
        ] {
            let mut value = value.clone();
            value[key] = changed;
            let text = serde_json::to_vec(&value).unwrap();
            assert_eq!(WorkOrder::from_json(&text).unwrap_err().key, key);
        }
        let mut edited = value;
        edited["definition"]["b"] = json!(2);
        let text = serde_json::to_vec(&edited).unwrap();
        assert_eq!(WorkOrder::from_json(&text).unwrap_err().key, "id");
        assert_eq!(WorkOrder::from_json(b"{").unwrap_err().key, "");
    }

    #[test]
    fn numbers_are_shown_as_ranges() {
        assert_eq!(ranges(&[]), "");
        assert_eq!(ranges(&[0, 1, 2, 3, 7, 9, 10]), "0-3,7,9-10");
    }
}
