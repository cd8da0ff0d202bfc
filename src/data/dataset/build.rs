//! Makes a dataset: surveys its runs, then reads, encodes, hashes and stores the selected rows.
//! Uses: `store`, `dataset::{survey, shards, begun, encoder}`, `new_file`. Never: HTTP; all rows at once.
//!
//! ```text
//! runs -> survey (no frames) -> selected ids, parts -> pages of 1000 with frames ---+
//! shards, each checked --------------------------------------------------------> encoder thread
//!                                           Parquet file <- row group, sha256 of the rows <-+
//! ```
//! The id is known after the last row; the file is then renamed to it. The first rows of a run's dataset
//! may have been written while the run was active (`begun`).

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use arrow_schema::SchemaRef;
use futures::StreamExt;
use jiff::Timestamp;
use serde_json::{Value, json};
use tokio::sync::mpsc;

use super::background::background;
use super::batch::Row;
use super::begun::Begun;
use super::card;
use super::definition::{Definition, SplitBy};
use super::encoder::{Encoder, Tally};
use super::error::{DatasetError, DatasetResult};
use super::inputs::Inputs;
use super::schema::{self, BATCH_ROWS};
use super::shards::ShardFolder;
use super::split::{Group, Part, divide, place};
use super::survey::{NO_PART, NO_TAG, Survey, Surveyed, label};
use crate::ids::{DatasetId, TrialId};
use crate::new_file;
use crate::store::{DatasetRow, RunRow, Store, TrialQuery};

/// Largest number of pages that wait for the encoder.
const PAGES_AHEAD: usize = 2;
/// Number of trials per page of the survey, which reads no frames.
const SURVEY_ROWS: u32 = 2000;
/// Number of pages that are read concurrently.
const PAGES_AT_ONCE: usize = 2;

/// Progress of writing a dataset or an export; shared between threads.
#[derive(Debug, Default)]
pub struct Progress {
    /// Number of rows written.
    pub done: AtomicU64,
    /// Number of rows to write; 0 until they are counted.
    pub total: AtomicU64,
}

/// A folder of shards with its split.
struct SplitShards {
    folder: ShardFolder,
    /// Part of each trial, in the order of the shards; `None` without a split. With a split by run they
    /// are train or validation.
    parts: Vec<Option<Part>>,
}

/// Makes the dataset of `inputs` in `folder`, with its card, and stores its row. `begun`: the begun file of
/// this dataset, which is continued if its rows are still those of the dataset.
///
/// # Errors
/// `DatasetError::Channels` or `Models` if runs or shards do not fit each other, `Changed` if
/// trials are removed meanwhile, `Shards` if a shard is damaged, `File` or `Store` if writing
/// fails.
pub async fn build(
    store: &Store,
    folder: &Path,
    inputs: Inputs,
    begun: Option<Begun>,
    at: Timestamp,
    progress: Arc<Progress>,
) -> DatasetResult<DatasetRow> {
    let channels = inputs.channels(store).await?;
    let definition = &inputs.definition;
    let columns = schema::of_dataset(definition, channels);
    let (mut surveyed, rows_of_run) = survey(store, &inputs).await?;
    let rows: u64 = rows_of_run.values().sum();
    let none_has = [
        (
            NO_PART,
            "split.by is imported, and no trial of its runs has a part: the imported file needs a column \
             split with train, validation or test",
        ),
        (
            NO_TAG,
            "split.by is tag, and no trial of its runs has one: the imported file needs a column tag",
        ),
    ];
    if let Some((_, why)) =
        none_has.iter().find(|(lacks, _)| rows > 0 && surveyed.excluded.get(*lacks) == Some(&rows))
    {
        return Err(DatasetError::Empty { name: definition.name.clone(), why: (*why).into() });
    }
    let shards = divide_shards(&inputs, &mut surveyed)?;
    let shard_rows: u64 = shards.iter().map(|shards| shards.folder.trials()).sum();
    progress.total.store(surveyed.kept.len() as u64 + shard_rows, Ordering::Relaxed);
    let lineage = lineage(store, &inputs, &rows_of_run, &shards).await?;
    let footer = footer(definition, &inputs, &shards, &lineage)?;

    let mut start = None;
    if let (Some(begun), Some((run, _))) = (begun, inputs.runs.first()) {
        let stored = store.newest_twins(run.uid, TrialId(0), u32::MAX).await?;
        start = begun.start_of(&columns, &surveyed.kept, &stored);
    }
    let encoder = match start {
        Some(begun) => begun,
        None => Encoder::new(folder, definition, &columns)?,
    };
    let rest = &surveyed.kept[encoder.tally().rows as usize..];

    let (pages, waiting) = mpsc::channel(PAGES_AHEAD);
    let shown = progress.clone();
    let encoding = background(move || encode(encoder, waiting, shards, &shown));
    // If the encoder fails, reading ends without an error; the encoder returns the cause.
    let reading = read_pages(store, &inputs, rest, pages);
    let (encoded, read) = futures::join!(encoding, reading);
    read?;
    let mut encoder = encoded??;

    let report = report(definition, &columns, channels, &surveyed, encoder.tally());
    let (id, rows) = (encoder.id()?, encoder.tally().rows);
    // Equal rows of other inputs: the file with its sha256 stays as it is.
    let existing = store.dataset(&id).await?;
    if let Some(row) = existing.filter(|row| data_file(folder, &row.id).is_file()) {
        return Ok(store.insert_dataset(row, &inputs.key).await?);
    }
    let name = id.clone();
    let finished = background(move || encoder.finish(&name, footer)).await??;
    let row = DatasetRow {
        name: definition.name.clone(),
        definition: serde_json::to_value(definition).map_err(DatasetError::Json)?,
        rows,
        bytes: finished.bytes,
        sha256: finished.sha256,
        report,
        lineage,
        created_at: at,
        id,
    };
    let row = store.insert_dataset(row, &inputs.key).await?;
    write_card(folder, &row)?;
    Ok(row)
}

/// The first pass. Returns the selected trials, and the number of trials by scan id.
async fn survey(store: &Store, inputs: &Inputs) -> DatasetResult<(Surveyed, BTreeMap<i64, u64>)> {
    let mut survey = Survey::new(&inputs.definition, schema::scalars(), inputs.model());
    let mut rows = BTreeMap::new();
    for (run, _) in &inputs.runs {
        let mut query =
            TrialQuery { run: Some(run.uid), limit: SURVEY_ROWS, ..TrialQuery::default() };
        loop {
            let page = store.trials(&query).await?;
            let Some(last) = page.last().map(|trial| trial.trial_id) else { break };
            query.after = Some(last);
            *rows.entry(run.scan_id).or_default() += page.len() as u64;
            survey.push(run, page)?;
        }
    }
    let mut surveyed = survey.finish();
    surveyed.kept.sort_by_key(|(trial, _)| *trial);
    Ok((surveyed, rows))
}

/// Splits the trials of each folder of shards of the dataset's model. Folders of other models are
/// excluded and counted in the report; an excluded folder that the definition names is an error.
fn divide_shards(inputs: &Inputs, surveyed: &mut Surveyed) -> DatasetResult<Vec<SplitShards>> {
    let split = &inputs.definition.split;
    let mut divided = Vec::new();
    let first = inputs.folders.first().map(|f| f.manifest.definition.model.as_str());
    let model = inputs.model().or(first);
    for folder in &inputs.folders {
        let definition = &folder.manifest.definition;
        if Some(definition.model.as_str()) != model {
            if inputs.definition.sim_random.contains(&folder.name) {
                return Err(DatasetError::Models {
                    folder: folder.name.clone(),
                    there: definition.model.clone(),
                    here: model.unwrap_or_default().into(),
                });
            }
            let why = format!("Sim-Random {} of another model: {}", folder.name, definition.model);
            surveyed.excluded.insert(why, folder.trials());
            continue;
        }
        let numbers = folder.manifest.shards.iter().flat_map(|s| s.first..s.first + s.trials);
        let seed = definition.draws.seed;
        let groups: Vec<Group> = numbers
            .map(|number| Group {
                place: place(split.seed, format!("sim-random {seed} {number}").as_bytes()),
                rows: 1,
                stratum: 0,
            })
            .collect();
        let parts = match split.by {
            SplitBy::None | SplitBy::Imported | SplitBy::Tag => vec![None; groups.len()],
            SplitBy::Configuration | SplitBy::Trial | SplitBy::Run => {
                divide(&groups, split).into_iter().map(Some).collect()
            }
        };
        divided.push(SplitShards { folder: folder.clone(), parts });
    }
    Ok(divided)
}

/// The second pass: sends the selected trials with their frames, page by page.
async fn read_pages(
    store: &Store,
    inputs: &Inputs,
    kept: &[(TrialId, Option<Part>)],
    pages: mpsc::Sender<Vec<Row>>,
) -> DatasetResult<()> {
    let by_scan_id: BTreeMap<i64, &RunRow> =
        inputs.runs.iter().map(|(run, _)| (run.scan_id, run)).collect();
    let chunks: Vec<Vec<_>> = kept.chunks(BATCH_ROWS).map(<[_]>::to_vec).collect();
    let reads = chunks.into_iter().map(|chunk| {
        let store = store.clone();
        async move {
            let ids: Vec<_> = chunk.iter().map(|(trial, _)| *trial).collect();
            store.trials_with_voltages(&ids).await.map(|trials| (chunk, trials))
        }
    });
    let mut reads = futures::stream::iter(reads).buffered(PAGES_AT_ONCE);
    while let Some(read) = reads.next().await {
        let (chunk, trials) = read?;
        if trials.len() != chunk.len() {
            return Err(DatasetError::Changed);
        }
        let rows = trials.into_iter().zip(&chunk).map(|(mut trial, (_, part))| {
            if let Some(run) = by_scan_id.get(&trial.scan_id) {
                label(&mut trial, &inputs.definition, run);
            }
            Row { trial, part: *part }
        });
        if pages.send(rows.collect()).await.is_err() {
            return Ok(());
        }
    }
    Ok(())
}

/// Encodes pages of trials as they arrive, then the shards. Runs on a dedicated thread.
fn encode(
    mut encoder: Encoder,
    mut pages: mpsc::Receiver<Vec<Row>>,
    shards: Vec<SplitShards>,
    progress: &Progress,
) -> DatasetResult<Encoder> {
    let show = |encoder: &Encoder| progress.done.store(encoder.tally().rows, Ordering::Relaxed);
    while let Some(page) = pages.blocking_recv() {
        encoder.push_trials(&page)?;
        show(&encoder);
    }
    for SplitShards { folder, parts } in shards {
        let mut parts = parts.as_slice();
        for shard in &folder.manifest.shards {
            for rows in folder.read(shard)? {
                let (own, rest) = parts.split_at(rows.num_rows().min(parts.len()));
                parts = rest;
                encoder.push_shard(&rows, own)?;
                show(&encoder);
            }
        }
    }
    Ok(encoder)
}

/// Lineage of the rows: runs, models, folders of shards, and the version of the code.
async fn lineage(
    store: &Store,
    inputs: &Inputs,
    rows_of_run: &BTreeMap<i64, u64>,
    shards: &[SplitShards],
) -> DatasetResult<Value> {
    let runs: Vec<Value> = inputs
        .runs
        .iter()
        .map(|(run, extent)| {
            json!({
                "uid": run.uid, "scan_id": run.scan_id, "experiment": run.experiment,
                "kind": run.kind, "label": run.label, "seed": run.seed,
                "definition_sha256": run.definition_sha256, "rig_sha256": run.rig_sha256,
                "sensor_sha256": run.sensor_sha256, "calibration": run.calibration_id,
                "version": run.version, "git_commit": run.git_commit,
                "started_at": run.started_at, "ended_at": run.ended_at,
                "deadband_n": inputs.definition.deadband_n.unwrap_or(run.deadband_n),
                "trials": rows_of_run.get(&run.scan_id), "taken_back": extent.taken_back,
            })
        })
        .collect();
    let mut models = Vec::new();
    if inputs.definition.task.has_simulated()
        && let Some(hash) = inputs.model()
        && let Some(model) = store.twin_model_of(hash).await?
    {
        models.push(json!({
            "model": model.hash, "sensor_sha256": model.sensor_sha256,
            "calibration": model.calibration_id, "version": model.version,
            "git_commit": model.git_commit,
        }));
    }
    let sim_random: Vec<Value> = shards
        .iter()
        .map(|SplitShards { folder, .. }| {
            json!({ "folder": folder.name, "definition": folder.manifest.definition,
                "shards": folder.manifest.shards })
        })
        .collect();
    Ok(json!({
        "runs": runs, "models": models, "sim_random": sim_random,
        "code": {
            "version": env!("CARGO_PKG_VERSION"),
            "git_commit": crate::commit::known(),
        },
    }))
}

/// Key-value metadata of the Parquet file: definition, lineage and sensor file, of the first run or shards.
fn footer(
    definition: &Definition,
    inputs: &Inputs,
    shards: &[SplitShards],
    lineage: &Value,
) -> DatasetResult<HashMap<String, String>> {
    let definition = serde_json::to_string(definition).map_err(DatasetError::Json)?;
    let mut footer = HashMap::from([
        ("palpate.definition".to_owned(), definition),
        ("palpate.lineage".to_owned(), lineage.to_string()),
    ]);
    let of_run = inputs.runs.first().map(|(run, _)| run.sensor.clone());
    let of_shards = || toml::to_string(&shards.first()?.folder.manifest.sensor_file).ok();
    if let Some(sensor) = of_run.or_else(of_shards) {
        footer.insert(schema::SENSOR_KEY.into(), sensor);
    }
    Ok(footer)
}

fn report(
    definition: &Definition,
    columns: &SchemaRef,
    channels: i32,
    surveyed: &Surveyed,
    tally: &Tally,
) -> Value {
    let columns: Vec<Value> = columns
        .fields()
        .iter()
        .map(|field| {
            json!({ "name": field.name(), "type": schema::type_words(field.data_type()),
                "unit": field.metadata().get(crate::simulate::schema::UNIT),
                "filterable": schema::is_comparable(field.name()) })
        })
        .collect();
    json!({
        "task": definition.task, "channels": channels, "parts": tally.parts,
        "contact_counts": tally.contact_counts, "left_out": surveyed.excluded,
        "columns": columns,
    })
}

/// Writes the card next to the file.
fn write_card(folder: &Path, row: &DatasetRow) -> DatasetResult<()> {
    let name = format!("{}.md", row.id);
    let failed = DatasetError::file("writing", &folder.join(&name));
    new_file::write(folder, &name, card::text(row)).map(|_| ()).map_err(failed)
}

/// Path of the Parquet file of a dataset.
pub fn data_file(folder: &Path, id: &DatasetId) -> PathBuf {
    folder.join(format!("{id}.parquet"))
}

/// Path of the card of a dataset.
pub fn card_file(folder: &Path, id: &DatasetId) -> PathBuf {
    folder.join(format!("{id}.md"))
}
