//! What Parquet's ways of packing cost on Sim-Random's own data:
//! `cargo run --example shard_encodings -- [TRIALS] [FOLDER]`.
//! Uses: the public face of `simulate`. Never: anything but `FOLDER/shard_encodings.parquet`.
//!
//! Simulates trials (1,000 to a row group, as the shards have), then for every candidate encodes
//! and writes them with one thread, and reads them back. Prints a Markdown table: the best of three
//! rounds, since the machine may be busy with other things.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::Instant;

use arrow_array::RecordBatch;
use palpate::simulate::model::load_or_build;
use palpate::simulate::random::draw::Draws;
use palpate::simulate::random::encode::{Layout, Trials};
use palpate::simulate::random::manifest::{Definition, Order, ROW_GROUP_TRIALS};
use palpate::simulate::schema::{Packing, parquet_properties};
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::basic::{Compression, ZstdLevel};
use sim_core::batch::{BatchModel, BatchWork, Kernel};
use sim_core::forward::ForwardModel;
use sim_core::sensor::Sensor;

type Failure = Box<dyn std::error::Error>;

/// Rounds of every candidate.
const ROUNDS: usize = 3;

/// Row groups of simulated trials.
fn batches(model: &ForwardModel, trials: u64) -> Result<Vec<RecordBatch>, Failure> {
    let sensor = model.sensor();
    let draws = Draws::paper(1);
    let order = Order::new(draws.clone(), trials, trials, sensor.points().len())
        .map_err(|problems| format!("{problems:?}"))?;
    let definition = Definition::new(order, model, Kernel::detect());
    let layout = Layout::new(&definition, sensor.channels(), sensor.file.tip_diameter_mm)?;
    let (frames, mut work) = (BatchModel::new(model, Kernel::detect()), BatchWork::default());
    let mut batches = Vec::new();
    for first in (0..trials).step_by(ROW_GROUP_TRIALS as usize) {
        let (mut contacts, mut ends) = (Vec::new(), Vec::new());
        for index in first..trials.min(first + ROW_GROUP_TRIALS) {
            draws.trial(sensor.points(), index, &mut contacts);
            ends.push(contacts.len());
        }
        let mut voltages_v = vec![0.0; ends.len() * sensor.channels()];
        let trials = Trials { first, contacts, ends, voltages_v: Vec::new() };
        frames.voltages(&trials.each(), &mut voltages_v, &mut work)?;
        batches.push(layout.batch(Trials { voltages_v, ..trials })?);
    }
    Ok(batches)
}

/// Bytes of a file, and seconds to encode and write it, to sync it, to read it.
struct Cost {
    bytes: u64,
    write_s: f64,
    sync_s: f64,
    read_s: f64,
}

fn cost(batches: &[RecordBatch], packing: Packing, path: &Path) -> Result<Cost, Failure> {
    let properties = parquet_properties(packing, Vec::new());
    let started = Instant::now();
    let mut writer =
        ArrowWriter::try_new(File::create(path)?, batches[0].schema(), Some(properties))?;
    for batch in batches {
        writer.write(batch)?;
        writer.flush()?;
    }
    let file = writer.into_inner()?;
    let write_s = started.elapsed().as_secs_f64();
    let started = Instant::now();
    file.sync_all()?;
    let sync_s = started.elapsed().as_secs_f64();
    let started = Instant::now();
    let reader = ParquetRecordBatchReaderBuilder::try_new(File::open(path)?)?.build()?;
    let rows = reader.map(|batch| batch.map(|b| b.num_rows())).sum::<Result<usize, _>>()?;
    let read_s = started.elapsed().as_secs_f64();
    assert_eq!(rows, batches.iter().map(RecordBatch::num_rows).sum::<usize>());
    Ok(Cost { bytes: std::fs::metadata(path)?.len(), write_s, sync_s, read_s })
}

fn main() -> Result<(), Failure> {
    let mut arguments = std::env::args().skip(1);
    let trials: u64 = arguments.next().map_or(Ok(10_000), |text| text.parse())?;
    let folder = arguments.next().map_or_else(std::env::temp_dir, PathBuf::from);
    let sensor = Sensor::from_toml(include_str!("../experiments/sensors/ert-28.toml"))?;
    let model = load_or_build(&sensor, Path::new("palpate-data/cache"))?;
    let batches = batches(&model, trials)?;
    let path = folder.join("shard_encodings.parquet");
    let zstd = |level| ZstdLevel::try_new(level).map(Compression::ZSTD);
    let compressions = [
        ("none", Compression::UNCOMPRESSED),
        ("Snappy", Compression::SNAPPY),
        ("LZ4", Compression::LZ4_RAW),
        ("Zstandard 1", zstd(1)?),
        ("Zstandard 3", zstd(3)?),
        ("Zstandard 9", zstd(9)?),
    ];
    println!("| bytes | compression | bytes a trial | write, us a trial | sync | read |");
    println!("|---|---|---|---|---|---|");
    for (split_bytes, order) in [(false, "plain"), (true, "split")] {
        for (name, compression) in compressions {
            let packing = Packing { compression, split_bytes };
            let costs = (0..ROUNDS)
                .map(|_| cost(&batches, packing, &path))
                .collect::<Result<Vec<_>, _>>()?;
            let best_us = |seconds: fn(&Cost) -> f64| {
                costs.iter().map(seconds).fold(f64::INFINITY, f64::min) * 1e6 / trials as f64
            };
            println!(
                "| {order} | {name} | {} | {:.1} | {:.1} | {:.1} |",
                costs[0].bytes / trials,
                best_us(|c| c.write_s),
                best_us(|c| c.sync_s),
                best_us(|c| c.read_s),
            );
        }
    }
    std::fs::remove_file(&path)?;
    Ok(())
}
