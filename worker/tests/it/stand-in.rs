//! A stand-in for `palpate cluster make --lines` in tests of the worker: the same lines, quick bytes.
//! The bytes of a chunk follow from the seed and the files of the order and the index alone; no sensor is simulated.
//!
//! `definition`: `seed`; `ms`, wall time of a chunk unless STAND_IN_QUICK is set; `fails`, indices that report
//! an error; `dies`, indices at which the program ends; `hangs`, indices that are never answered; `refuses`, that this
//! machine makes no chunk.

use std::fs;
use std::io::{BufRead, stdin};
use std::os::unix::process::parent_id;
use std::path::Path;
use std::time::{Duration, Instant};

use palpate_worker::order::{Order, sha256};
use serde_json::{Value, json};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    assert_eq!(arguments[..3], ["cluster", "make", "--lines"]);
    let secret = std::env::vars()
        .find(|(name, _)| name.starts_with("PALPATE_QUEUE") || name.starts_with("AWS_"));
    assert_eq!(secret, None, "a secret reached the program");
    for line in stdin().lock().lines() {
        let request: Value = serde_json::from_str(&line.unwrap()).unwrap();
        let folder = Path::new(request["folder"].as_str().unwrap());
        let answer = make(folder, request["index"].as_u64().unwrap());
        println!("{answer}");
    }
}

fn make(folder: &Path, index: u64) -> Value {
    let began = Instant::now();
    let text = fs::read(folder.join("order.json")).unwrap();
    let order = Order::parse(&text, "order.json").unwrap();
    let order_json: Value = serde_json::from_slice(&text).unwrap();
    let definition = &order_json["definition"];
    let has =
        |list: &str| definition[list].as_array().is_some_and(|list| list.contains(&json!(index)));
    if std::env::var_os("STAND_IN_QUICK").is_none() {
        std::thread::sleep(Duration::from_millis(definition["ms"].as_u64().unwrap_or(0)));
    }
    if definition["refuses"] == true {
        return json!({ "index": index, "error": "this machine has no kernel of the order", "machine": true });
    }
    if has("fails") {
        return json!({ "index": index, "error": format!("index {index} fails by its definition") });
    }
    if has("dies") {
        eprintln!("index {index} ends the program by its definition");
        std::process::exit(7);
    }
    if has("hangs") {
        // Until its worker is gone, as a program that computes for hours and then finds its input closed.
        let worker = parent_id();
        while parent_id() == worker {
            std::thread::sleep(Duration::from_millis(100));
        }
        std::process::exit(1);
    }
    let mut seed = definition["seed"].as_u64().unwrap();
    for name in &order.files {
        let file = fs::read(folder.join("inputs").join(name)).unwrap();
        assert_eq!(sha256(&file), *name);
        seed += file.iter().map(|&byte| u64::from(byte)).sum::<u64>();
    }
    let bytes = bytes(seed, index);
    let (key, hash) = (order.key(index), sha256(&bytes));
    let results = folder.join("results");
    fs::create_dir_all(&results).unwrap();
    fs::write(results.join(format!("{key}.parquet")), &bytes).unwrap();
    let wall_ms = u64::try_from(began.elapsed().as_millis()).unwrap();
    let done = json!({ "key": key, "index": index, "sha256": hash, "bytes": bytes.len(), "rows": 1, "wall_ms": wall_ms });
    let mut row = done.clone();
    row["made_by"] = json!("stand-in");
    row["commit"] = json!("0000000");
    fs::write(results.join(format!("{key}.json")), row.to_string()).unwrap();
    done
}

/// 20 to 60 kB that follow from seed and index.
fn bytes(seed: u64, index: u64) -> Vec<u8> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ index.wrapping_add(1).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    let words = 2500 + next() % 5000;
    (0..words).flat_map(|_| next().to_le_bytes()).collect()
}
