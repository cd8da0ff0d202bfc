//! How fast nets answer through tract, and what their plans hold in memory:
//! `cargo run --example infer_speed -- write FOLDER | time MODEL.onnx BATCH SECONDS CALLERS`.
//! Uses: plans, nets of random weights. Never: onnxruntime (`tests/figures/infer.py` compares).
//!
//! `write` makes NAME.onnx for every net that Palpate trains. `time` answers BATCH frames again and
//! again from CALLERS threads and prints one line of JSON: latencies, frames a second, memory.

#[path = "../tests/it/onnx/random_nets.rs"]
mod random_nets;

use std::path::Path;
use std::time::{Duration, Instant};

use palpate::infer::plan::Plan;
use palpate::learn::onnx::OnnxFile;
use palpate::learn::onnx::write::{Description, to_onnx};

type Failure = Box<dyn std::error::Error + Send + Sync>;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        ["write", folder] => write(Path::new(folder)),
        ["time", file, batch, seconds, callers] => {
            time(Path::new(file), batch.parse()?, seconds.parse()?, callers.parse()?)
        }
        _ => Err("write FOLDER | time MODEL.onnx BATCH SECONDS CALLERS".into()),
    }
}

fn write(folder: &Path) -> Result<(), Failure> {
    for (name, network) in random_nets::architectures(&mut random_nets::Draw::new(1)) {
        let says = Description {
            name,
            doc: "random weights",
            input: ["voltages_v", "V"],
            output: ["answer", ""],
            version: "0",
            properties: &[],
        };
        std::fs::write(folder.join(name).with_extension("onnx"), to_onnx(&network, &says)?)?;
    }
    Ok(())
}

fn time(file: &Path, batch: usize, seconds: f64, callers: usize) -> Result<(), Failure> {
    let bytes = std::fs::read(file)?;
    let shape = OnnxFile::read(&bytes)?.output().dimensions.clone();
    let shape: Vec<usize> = shape.into_iter().flatten().collect();
    let before_kib = resident_kib();
    let begun = Instant::now();
    let plan = Plan::load(&bytes, random_nets::CHANNELS, &shape)?;
    let load_s = begun.elapsed().as_secs_f64();
    let plan_kib = resident_kib().zip(before_kib).map(|(after, before)| after - before);

    let frames = random_nets::Draw::new(2).frames(batch, random_nets::CHANNELS);
    let begun = Instant::now();
    let end = begun + Duration::from_secs_f64(seconds);
    let answer_until_end = || {
        let (mut latencies_ms, mut out) = (Vec::new(), Vec::new());
        while Instant::now() < end {
            let asked = Instant::now();
            out.clear();
            plan.answer(&frames, &mut out)?;
            latencies_ms.push(asked.elapsed().as_secs_f64() * 1e3);
        }
        Ok::<_, Failure>(latencies_ms)
    };
    let answered = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..callers).map(|_| scope.spawn(answer_until_end)).collect();
        threads.into_iter().map(|thread| thread.join()).collect::<Vec<_>>()
    });
    let mut latencies_ms = Vec::new();
    for thread in answered {
        latencies_ms.extend(thread.map_err(|_| "a caller panicked")??);
    }
    let frames_per_s = (latencies_ms.len() * batch) as f64 / begun.elapsed().as_secs_f64();
    let report = serde_json::json!({
        "latencies_ms": latencies_ms,
        "frames_per_s": frames_per_s,
        "load_s": load_s,
        "plan_kib": plan_kib,
        "file_kib": bytes.len() / 1024,
    });
    println!("{report}");
    Ok(())
}

/// Memory of this process, if the system reports it.
fn resident_kib() -> Option<i64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.trim().trim_end_matches("kB").trim().parse().ok()
}
