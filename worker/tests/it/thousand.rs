//! What 1,000 workers would ask of the queue and the store: a simulation by events, from the costs that decision 21
//! and `docs/figures.md` state. Its table is in decision 21; UPDATE=1 writes it.
//!
//! The queue and the link to the store each serve one request at a time, in the order of arrival. Each worker takes a
//! chunk, makes it, writes its bytes, acknowledges it, and renews its lease. Not in the model: memory and connections
//! of PostgreSQL, which end before its processor does, and a store that is slower with many writers.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::fs;
use std::path::Path;

/// Time that the queue needs for a chunk, s: at most the overhead of a chunk that `tests/cluster/long.py` prints, which
/// has two synced files, too.
const QUEUE_CHUNK_S: f64 = 0.0047;
/// Requests to the queue for a chunk: the orders, take, acknowledge.
const REQUESTS: f64 = 3.0;
/// 10,000 trials of Sim-Random on two cores: a twentieth of 25 s and of 0.53 GB.
const TRIALS_10_000: (f64, f64) = (1.25, 26.5e6);
/// Ten times as many in a chunk.
const TRIALS_100_000: (f64, f64) = (12.5, 265e6);
/// A training of ten minutes, whose result is a net.
const TRAINING: (f64, f64) = (600.0, 1e6);
/// Time that is not counted, and time that is, s.
const RUN_S: (f64, f64) = (700.0, 1400.0);
/// Decision, and the lines around its table.
const PAGE: &str = "../docs/decisions/0021-workers-over-postgresql.md";
const MARKS: [&str; 2] =
    ["<!-- table of worker/tests/it/thousand.rs -->\n", "<!-- end of this table -->\n"];

/// A laboratory.
struct Lab {
    workers: usize,
    /// Time to make a chunk, s, and its bytes.
    chunk: (f64, f64),
    store_bytes_per_s: f64,
    lease_s: f64,
}

/// What it does per second, and which share of the time its parts are busy.
#[derive(Debug, Default)]
struct Found {
    chunks: f64,
    requests: f64,
    queue_busy: f64,
    bytes: f64,
    store_busy: f64,
    workers_busy: f64,
}

/// What a worker does next. Times are in ns, so that events have an order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Step {
    Take,
    Made,
    Stored,
    /// Heartbeat or sweep, which returns after a time.
    Lease(u64),
}

/// Serves one request after the other.
#[derive(Debug, Default)]
struct Served {
    free_at: u64,
    busy: u64,
    count: u64,
}

impl Served {
    /// Time at which a request that comes now is done.
    fn until(&mut self, now: u64, cost: u64, requests: u64) -> u64 {
        self.free_at = self.free_at.max(now) + cost;
        self.busy += cost;
        self.count += requests;
        self.free_at
    }
}

fn ns(seconds: f64) -> u64 {
    (seconds * 1e9) as u64
}

fn simulated(lab: &Lab) -> Found {
    let (make_s, bytes) = lab.chunk;
    let request = ns(QUEUE_CHUNK_S / REQUESTS);
    let (from, to) = (ns(RUN_S.0), ns(RUN_S.0 + RUN_S.1));
    let (mut queue, mut store) = (Served::default(), Served::default());
    let mut events = BinaryHeap::new();
    for worker in 0..lab.workers {
        let share = worker as f64 / lab.workers as f64;
        events.push(Reverse((ns(share * make_s), worker, Step::Take)));
        for every in [lab.lease_s / 4.0, lab.lease_s / 2.0] {
            events.push(Reverse((ns(share * every), worker, Step::Lease(ns(every)))));
        }
    }
    let mut chunks = 0_u64;
    let mut before = None;
    while let Some(Reverse((now, worker, step))) = events.pop() {
        if now >= to {
            break;
        }
        if now >= from && before.is_none() {
            before = Some((chunks, queue.busy, queue.count, store.busy));
        }
        let next = match step {
            Step::Take => {
                // Machines are not alike: 10 % around the time of a chunk.
                let unlike = 0.9 + 0.2 * (worker % 21) as f64 / 20.0;
                (queue.until(now, 2 * request, 2) + ns(make_s * unlike), Step::Made)
            }
            Step::Made => (store.until(now, ns(bytes / lab.store_bytes_per_s), 1), Step::Stored),
            Step::Stored => {
                chunks += 1;
                (queue.until(now, request, 1), Step::Take)
            }
            Step::Lease(every) => {
                queue.until(now, request, 1);
                (now + every, step)
            }
        };
        events.push(Reverse((next.0, worker, next.1)));
    }
    let (chunks_before, queue_before, count_before, store_before) = before.unwrap();
    let over = RUN_S.1;
    let per_s = |count: u64| count as f64 / over;
    let busy = |ns: u64| (ns as f64 / 1e9 / over).min(1.0);
    let done = per_s(chunks - chunks_before);
    Found {
        chunks: done,
        requests: per_s(queue.count - count_before),
        queue_busy: busy(queue.busy - queue_before),
        bytes: done * bytes,
        store_busy: busy(store.busy - store_before),
        workers_busy: (done * make_s / lab.workers as f64).min(1.0),
    }
}

/// The table of the decision.
fn table() -> String {
    let (gigabit, minute, hour) = (125e6, 60.0, 3600.0);
    let row = |workers, chunk, store_bytes_per_s, lease_s| Lab {
        workers,
        chunk,
        store_bytes_per_s,
        lease_s,
    };
    let rows = [
        ("10,000 trials", "1 Gbit/s", row(2, TRIALS_10_000, gigabit, minute)),
        ("10,000 trials", "1 Gbit/s", row(10, TRIALS_10_000, gigabit, minute)),
        ("10,000 trials", "10 Gbit/s", row(50, TRIALS_10_000, 10.0 * gigabit, minute)),
        ("10,000 trials", "10 Gbit/s", row(100, TRIALS_10_000, 10.0 * gigabit, minute)),
        ("10,000 trials", "100 Gbit/s", row(200, TRIALS_10_000, 100.0 * gigabit, minute)),
        ("10,000 trials", "100 Gbit/s", row(1000, TRIALS_10_000, 100.0 * gigabit, minute)),
        ("100,000 trials", "100 Gbit/s", row(1000, TRIALS_100_000, 100.0 * gigabit, minute)),
        ("100,000 trials", "200 Gbit/s", row(1000, TRIALS_100_000, 200.0 * gigabit, hour)),
        ("a training", "1 Gbit/s", row(1000, TRAINING, gigabit, minute)),
        ("a training", "1 Gbit/s", row(1000, TRAINING, gigabit, hour)),
    ];
    let mut text = String::from(
        "| workers | chunk | lease | store | chunks per second | requests to the queue per second | queue busy | GB per second | store busy | workers busy |\n\
         |---|---|---|---|---|---|---|---|---|---|\n",
    );
    for (chunk, store, lab) in rows {
        let found = simulated(&lab);
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        text += &format!(
            "| {} | {chunk} | {} s | {store} | {:.1} | {:.0} | {} | {:.3} | {} | {} |\n",
            lab.workers,
            lab.lease_s,
            found.chunks,
            found.requests,
            percent(found.queue_busy),
            found.bytes / 1e9,
            percent(found.store_busy),
            percent(found.workers_busy),
        );
    }
    text
}

#[test]
fn the_table_of_the_decision_is_what_the_model_computes() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(PAGE);
    let page = fs::read_to_string(&path).unwrap();
    let (head, rest) = page.split_once(MARKS[0]).unwrap();
    let (kept, tail) = rest.split_once(MARKS[1]).unwrap();
    let table = format!("\n{}\n", table());
    if std::env::var_os("UPDATE").is_some() {
        fs::write(&path, [head, MARKS[0], &table, MARKS[1], tail].concat()).unwrap();
        return;
    }
    assert!(kept == table, "the table of decision 21 is old: UPDATE=1 rewrites it");
}

#[test]
fn a_lab_is_limited_by_its_workers_its_store_or_its_queue() {
    let lab = |workers, store_bytes_per_s| Lab {
        workers,
        chunk: TRIALS_10_000,
        store_bytes_per_s,
        lease_s: 60.0,
    };
    let near = |found: f64, expected: f64| (found / expected - 1.0).abs() < 0.02;
    // One worker: the time of a chunk, of its bytes, and of its requests, 10 % less for the first machine.
    let one = simulated(&lab(1, 125e6));
    let expected = 1.0 / (0.9 * 1.25 + 26.5e6 / 125e6 + QUEUE_CHUNK_S);
    assert!(near(one.chunks, expected), "{one:?}");
    // A narrow link: its bytes. Many workers and a wide one: the queue, which serves leases, too.
    let narrow = simulated(&lab(50, 125e6));
    assert!(near(narrow.bytes, 125e6) && narrow.store_busy > 0.98, "{narrow:?}");
    let many = simulated(&lab(1000, 1e12));
    let leases = 1000.0 * (4.0 + 2.0) / 60.0 * QUEUE_CHUNK_S / REQUESTS;
    assert!(near(many.chunks, (1.0 - leases) / QUEUE_CHUNK_S), "{many:?}");
    assert!(many.queue_busy > 0.98 && many.workers_busy < 0.3, "{many:?}");
}
