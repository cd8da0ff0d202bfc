//! One bulk work and its chunks, with their keys.
//! PURE. Never: how a chunk is made; a key that another definition or version of the program has.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use sha2::{Digest, Sha256};

use crate::{WorkerError, WorkerResult};

/// Version of the form of `order.json`.
pub const ORDER_VERSION: u32 = 1;
/// Name of the file that defines an order.
pub const ORDER_FILE: &str = "order.json";
/// Most chunks of an order: a larger work has larger chunks.
pub const CHUNKS_MAX: u64 = 100_000;

/// Endings of the files with the bytes of chunks, by kind, as the program names them.
const ENDINGS: [(&str, &str); 2] = [("readings", "jsonl"), ("trainings", "net")];
/// Ending for all other kinds.
const COMMON_ENDING: &str = "parquet";

/// A bulk work, as its `order.json` states it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Order {
    version: u32,
    kind: String,
    /// sha256 of kind, code and definition, in hexadecimal digits.
    pub id: String,
    code: Value,
    definition: Value,
    /// sha256 of each file that its chunks need, in hexadecimal digits.
    #[serde(default)]
    pub files: Vec<String>,
    /// Number of chunks.
    pub chunks: u64,
}

/// A result, as its `KEY.json` states it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Done {
    /// Key of the chunk.
    pub key: String,
    /// Its place in the order, from 0.
    pub index: u64,
    /// sha256 of its bytes, in hexadecimal digits.
    pub sha256: String,
    /// Length of its bytes.
    pub bytes: u64,
    /// What else the program states of it, such as its rows, its host and its commit.
    #[serde(flatten)]
    pub about: Map<String, Value>,
}

/// The last error of a chunk that is set aside, as `failed/KEY.json` states it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failed {
    /// Key of the chunk.
    pub key: String,
    /// Its place in the order, from 0.
    pub index: u64,
    /// Number of attempts.
    pub attempts: u32,
    /// The last error.
    pub error: String,
}

impl Order {
    /// Reads an order, and checks that its id is that of its content.
    ///
    /// # Errors
    /// `WorkerError::Invalid` if it is no order, of another version, too large, or if its id differs.
    pub fn parse(text: &[u8], from: &str) -> WorkerResult<Self> {
        let invalid = |what: String| WorkerError::Invalid(format!("{from}: {what}"));
        let order: Self =
            serde_json::from_slice(text).map_err(|error| invalid(error.to_string()))?;
        if order.version != ORDER_VERSION {
            let what = format!("version = {}: must be {ORDER_VERSION}", order.version);
            return Err(invalid(format!("{what}; use the palpate-worker of this palpate")));
        }
        if !(1..=CHUNKS_MAX).contains(&order.chunks) {
            return Err(invalid(format!("chunks = {}: must be 1 to {CHUNKS_MAX}", order.chunks)));
        }
        if let Some(name) = order.files.iter().find(|name| !is_hash(name)) {
            return Err(invalid(format!("files = {name:?}: must be a sha256")));
        }
        let hash = order.hash();
        if order.id != hash {
            return Err(invalid(format!(
                "id = {}: kind, code and definition have the id {hash}; write the order again",
                order.id
            )));
        }
        Ok(order)
    }

    fn hash(&self) -> String {
        sha256(&canonical(&json!({
            "kind": self.kind, "code": self.code, "definition": self.definition,
        })))
    }

    /// Key of a chunk: a hash of its kind, code, definition and index.
    pub fn key(&self, index: u64) -> String {
        sha256(&canonical(&json!({
            "kind": self.kind, "code": self.code, "definition": self.definition, "index": index,
        })))
    }

    /// Name of the file with the bytes of a chunk.
    pub fn bytes_name(&self, key: &str) -> String {
        let ending = ENDINGS.iter().find(|(kind, _)| *kind == self.kind);
        let ending = ending.map_or(COMMON_ENDING, |(_, ending)| ending);
        format!("{key}.{ending}")
    }

    /// Whether its definition states that its chunks are computed on a GPU.
    pub fn needs_gpu(&self) -> bool {
        let compute = &self.definition["compute"];
        compute.get("cuda").is_some() || compute == "wgpu"
    }

    /// Whether another order has the same definition.
    pub fn is_same(&self, other: &Self) -> bool {
        self.id == other.id && self.chunks == other.chunks
    }
}

/// JSON with sorted keys and without spaces: `serde_json` without `preserve_order`.
fn canonical(value: &Value) -> Vec<u8> {
    value.to_string().into_bytes()
}

/// sha256 of bytes, in hexadecimal digits.
pub fn sha256(bytes: &[u8]) -> String {
    hex::encode(Sha256::digest(bytes))
}

/// Whether a text is a sha256 in lower-case hexadecimal digits.
pub fn is_hash(text: &str) -> bool {
    text.len() == 64
        && text.bytes().all(|byte| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(id: &str) -> String {
        format!(
            r#"{{"version":1,"kind":"k","id":"{id}","code":"c1","sensor_file":"s",
              "definition":{{"b":0.1,"a":[1.0,1e-7]}},"chunks":3}}"#
        )
    }

    #[test]
    fn id_and_keys_are_hashes_of_the_canonical_content() {
        let head = r#"{"code":"c1","definition":{"a":[1.0,1e-7],"b":0.1}"#;
        let id = sha256(format!(r#"{head},"kind":"k"}}"#).as_bytes());
        let order = Order::parse(text(&id).as_bytes(), "order.json").unwrap();
        assert_eq!(order.key(2), sha256(format!(r#"{head},"index":2,"kind":"k"}}"#).as_bytes()));
        assert!(is_hash(&order.key(0)) && order.key(0) != order.key(1));
        assert_eq!(order.bytes_name("a"), "a.parquet");
        let nets = Order { kind: "trainings".into(), ..order };
        assert_eq!(nets.bytes_name("a"), "a.net");
        let on = |compute: Value| {
            let definition = json!({ "compute": compute });
            Order { definition, ..nets.clone() }.needs_gpu()
        };
        assert!(
            on(json!({ "cuda": 0 }))
                && on(json!("wgpu"))
                && !on(json!({ "cpu": { "threads": 1 } }))
        );
        assert!(!nets.needs_gpu());
    }

    #[test]
    fn an_order_that_is_not_what_its_id_names_is_refused() {
        let refused =
            |text: &str| Order::parse(text.as_bytes(), "order.json").unwrap_err().to_string();
        let id = "0".repeat(64);
        let error = refused(&text(&id));
        assert!(
            error.contains("order.json: id = 000") && error.contains("write the order again"),
            "{error}"
        );
        assert!(
            refused(&text(&id).replace("\"version\":1", "\"version\":2")).contains("version = 2")
        );
        assert!(refused(&text(&id).replace("\"chunks\":3", "\"chunks\":0")).contains("chunks = 0"));
        let outside = text(&id).replace("\"chunks\":3", "\"files\":[\"../x\"],\"chunks\":3");
        assert!(refused(&outside).contains("files = \"../x\""));
        assert!(refused("{").contains("order.json: "));
    }

    #[test]
    fn a_hash_has_64_lower_case_digits() {
        assert!(is_hash(&sha256(b"")));
        assert!(!is_hash(&sha256(b"").to_uppercase()) && !is_hash("../x") && !is_hash(""));
    }
}
