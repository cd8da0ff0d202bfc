//! Workers and PostgreSQL are killed, and connections cut and stalled, at random: every chunk's bytes equal
//! those of one undisturbed process, none is missing, none is there twice.
//!
//! PALPATE_DISTURBANCES is their number (12), PALPATE_SEED their seed; 100 take 3 to 6 minutes.

use std::fs;
use std::time::{Duration, Instant};

use serde_json::json;

use crate::bench::{Bench, Worker, until};
use crate::proxy::Proxy;

/// Wall time of a chunk, ms, and pauses between two disturbances, ms.
const CHUNK_MS: u64 = 150;
const PAUSE_MS: (u64, u64) = (200, 1500);
/// Chunks for a disturbance: the order must last longer than they do.
const CHUNKS_PER_DISTURBANCE: u64 = 16;

#[test]
fn bytes_are_those_of_one_undisturbed_process() {
    let Some(mut bench) = Bench::start() else { return };
    let number = |name: &str, default: u64| {
        std::env::var(name).map_or(default, |text| text.parse().unwrap())
    };
    let disturbances = number("PALPATE_DISTURBANCES", 12);
    let mut chance = Chance(number("PALPATE_SEED", 19) | 1);
    let made =
        bench.order(disturbances * CHUNKS_PER_DISTURBANCE, json!({ "seed": 19, "ms": CHUNK_MS }));
    bench.ok(&["submit", made.path(), "--attempts", "20"]);

    let proxy = Proxy::start(bench.server.port);
    let address = bench.desk(proxy.port);
    let start = |bench: &Bench| bench.worker(&address, &[]);
    let mut workers: Vec<Worker> = (0..3).map(|_| start(&bench)).collect();
    let began = Instant::now();
    let mut counts = [0_u32; 6];
    for _ in 0..disturbances {
        std::thread::sleep(Duration::from_millis(
            PAUSE_MS.0 + chance.below(PAUSE_MS.1 - PAUSE_MS.0),
        ));
        let kind = [0, 0, 0, 1, 2, 2, 3, 4, 5][chance.below(9) as usize];
        counts[kind] += 1;
        match kind {
            0 => {
                let one = chance.below(workers.len() as u64) as usize;
                workers[one].process.kill().unwrap();
                workers[one].process.wait().unwrap();
                workers[one] = start(&bench);
            }
            1 => {
                bench.server.kill();
                std::thread::sleep(Duration::from_millis(chance.below(1000)));
                bench.server.begin();
            }
            2 => proxy.cut(),
            3 => proxy.stall(Duration::from_millis(500 + chance.below(4000))),
            4 => bench.server.cut(),
            _ => {
                let one = chance.below(workers.len() as u64) as usize;
                workers[one].terminate();
                drop(std::mem::replace(&mut workers[one], start(&bench)));
            }
        }
    }
    until("all chunks are done", Duration::from_secs(240), || {
        let status = bench.status(&made);
        status["done"] == json!(made.order.chunks) && status["running"] == json!(0)
    });
    let seconds = began.elapsed().as_secs_f64();
    for worker in &mut workers {
        worker.terminate();
        assert!(worker.ended(Duration::from_secs(20)), "{}", worker.log());
    }
    let status = bench.status(&made);
    assert_eq!(
        (&status["waiting"], &status["failed"], &status["missing"]),
        (&json!(0), &json!(0), &json!(0))
    );
    assert!(made.stored(&bench) == made.undisturbed());
    let results = fs::read_dir(made.stored_in(&bench)).unwrap().flatten();
    let names: Vec<String> =
        results.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    // A killed worker leaves at most the beginning of a file under a temporary name.
    let whole = names.iter().filter(|name| !name.starts_with("_partial-")).count() as u64;
    assert_eq!(whole, 2 * made.order.chunks, "one KEY.parquet and one KEY.json for each chunk");
    let [killed, servers, cuts, stalls, ended, terminated] = counts;
    println!(
        "{} chunks in {seconds:.0} s: {killed} workers killed, {servers} times PostgreSQL, {cuts} cuts, \
         {stalls} stalls, {ended} times all connections ended, {terminated} workers told to end and killed",
        made.order.chunks
    );
}

/// Numbers that follow from a seed.
struct Chance(u64);

impl Chance {
    fn below(&mut self, end: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 % end
    }
}
