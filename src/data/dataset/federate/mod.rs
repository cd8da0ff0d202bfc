//! Datasets of several rigs in one folder: a table for each rig and label, and a manifest of their origins.
//! Uses: `dataset::{read, format}`, `new_file`. Never: HTTP; rows whose file does not have its sha256; rigs whose
//! sensors differ, unless they are to stay apart.
//!
//! ```text
//! FOLDER/fetched/RIG/ds-...parquet  the dataset as the service of the rig has it
//!        fetched/RIG/dataset.json   what the service states of it, address, time at which it was fetched
//!        fetched/RIG/sensor.toml    its sensor file
//!        trials/RIG.LABEL.parquet   its rows, with `rig` and `trial`, an id that no other row has
//!        manifest.json              all of this, with definitions, lineages and sha256
//! ```
//! The bytes of `trials` and of the manifest follow from those of `fetched`.

mod differ;
mod table;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering::Relaxed;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::build::{Progress, data_file};
use super::error::{DatasetError, DatasetResult};
use super::format::Rows;
use super::read::{DatasetRows, sensor_text};
use super::schema::SENSOR_KEY;
use super::select::Wanted;
use crate::digest::{Hashing, sha256_hex};
use crate::ids::DatasetId;
use crate::new_file;
use crate::problem::Problem;
pub use table::LabelFile;

/// Folder of the fetched datasets, in the folder of a federation.
pub const FETCHED: &str = "fetched";
/// Folder of the tables, in the folder of a federation.
pub const TRIALS: &str = "trials";
/// File with the origins of all rows, in the folder of a federation.
pub const MANIFEST: &str = "manifest.json";
/// File with what is known of a fetched dataset.
const RECORD: &str = "dataset.json";
/// Sensor file of a fetched dataset.
const SENSOR: &str = "sensor.toml";

/// A dataset that was fetched from the service of a rig.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Fetched {
    /// Name of the rig.
    pub rig: String,
    /// Address of its service.
    pub url: String,
    /// Name by which the dataset was requested.
    pub requested: String,
    /// Id of the dataset.
    pub dataset: DatasetId,
    /// Number of rows.
    pub rows: u64,
    /// Length of the Parquet file, bytes.
    pub bytes: u64,
    /// sha256 of the Parquet file, in hexadecimal digits.
    pub sha256: String,
    /// Time at which the service made the dataset.
    pub made_at: Timestamp,
    /// Wall time at which it was fetched.
    pub fetched_at: Timestamp,
    /// Definition that selected, labelled and split the trials.
    pub definition: Value,
    /// Runs, models, calibrations, shards and code.
    pub lineage: Value,
}

/// A rig's part of a federation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RigPart {
    /// Its dataset, as it was fetched.
    #[serde(flatten)]
    pub fetched: Fetched,
    /// Path of its sensor file in the folder; `None` if the dataset has none.
    pub sensor_file: Option<String>,
    /// sha256 of the sensor file, in hexadecimal digits.
    pub sensor_sha256: Option<String>,
    /// Calibrations of its runs and of the models of its twins.
    pub calibrations: BTreeSet<String>,
    /// Tables of its rows, one for each label.
    pub files: Vec<LabelFile>,
}

/// Whether the tables of several rigs can be read as one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tables {
    /// They can: sensors, columns and definitions must agree.
    Joint,
    /// Each is read alone: sensors, columns and definitions may differ.
    Apart,
}

/// The manifest of the datasets of several rigs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Federation {
    /// Name by which the datasets were requested.
    pub dataset: String,
    /// Whether sensors, columns and definitions of the rigs may differ.
    pub apart: bool,
    /// Number of rows of all rigs.
    pub rows: u64,
    /// The rigs, by name.
    pub rigs: Vec<RigPart>,
}

/// A fetched dataset whose file is open.
struct Opened<'a> {
    fetched: &'a Fetched,
    sensor: String,
    rows: DatasetRows,
    /// First configuration of each run in the tables.
    offsets: BTreeMap<String, u32>,
}

impl Fetched {
    /// Returns the kept dataset of a rig; `None` if there is none, or its Parquet file was removed.
    ///
    /// # Errors
    /// `DatasetError::File` or `Problems` if what is known of it cannot be read.
    pub fn read(folder: &Path, rig: &str) -> DatasetResult<Option<Self>> {
        let path = place(folder, rig).join(RECORD);
        let text = match std::fs::read_to_string(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            read => read.map_err(DatasetError::file("reading", &path))?,
        };
        let kept: Self = serde_json::from_str(&text).map_err(|error| {
            let limit =
                format!("cannot be used: {error}; remove it, and the dataset is fetched again");
            DatasetError::Problems(vec![Problem::whole(&path.display().to_string(), limit)])
        })?;
        Ok(Some(kept).filter(|kept| kept.rig == rig && kept.file(folder).is_file()))
    }

    /// Path of its Parquet file.
    pub fn file(&self, folder: &Path) -> PathBuf {
        data_file(&place(folder, &self.rig), &self.dataset)
    }

    /// Stores what is known of it, after its Parquet file, and removes earlier datasets of the rig.
    ///
    /// # Errors
    /// `DatasetError::File` if a file cannot be written or removed.
    pub fn keep(&self, folder: &Path) -> DatasetResult<()> {
        let place = place(folder, &self.rig);
        let text = serde_json::to_string_pretty(self).map_err(DatasetError::Json)?;
        write(&place, RECORD, &(text + "\n"))?;
        remove_other_tables(&place, &BTreeSet::from([format!("{}.parquet", self.dataset)]))
    }

    /// The problem of a file with another sha256 than the service has stated.
    pub fn mismatch(&self, found: &str, advice: &str) -> Problem {
        let (file, key) = (format!("rig {}", self.rig), format!("sha256 of {}", self.dataset));
        Problem::new(&file, &key, found, format!("must be {}: {advice}", self.sha256))
    }

    /// The problem of its kept file, if its bytes have changed.
    fn damage(&self, folder: &Path) -> DatasetResult<Option<Problem>> {
        let path = self.file(folder);
        let mut hashing = Hashing::default();
        let mut file = File::open(&path).map_err(DatasetError::file("opening", &path))?;
        io::copy(&mut file, &mut hashing).map_err(DatasetError::file("reading", &path))?;
        let found = hashing.finish();
        let advice = format!("remove {}, and it is fetched again", path.display());
        Ok((found != self.sha256).then(|| self.mismatch(&found, &advice)))
    }

    /// Calibrations that its lineage names.
    fn calibrations(&self) -> BTreeSet<String> {
        let of = |part: &str| self.lineage[part].as_array().into_iter().flatten();
        let all = of("runs").chain(of("models"));
        all.filter_map(|one| one["calibration"].as_str()).map(str::to_owned).collect()
    }

    /// A seed of Sim-Random with which several folders of its shards were drawn: their trials have equal ids.
    fn repeated_seed(&self) -> Option<String> {
        let mut seeds = BTreeSet::new();
        let folders = self.lineage["sim_random"].as_array().into_iter().flatten();
        let mut drawn = folders.map(|folder| folder["definition"]["draws"]["seed"].to_string());
        drawn.find(|seed| !seeds.insert(seed.clone()))
    }
}

/// Folder of what was fetched from a rig.
fn place(folder: &Path, rig: &str) -> PathBuf {
    folder.join(FETCHED).join(rig)
}

fn write(folder: &Path, name: &str, text: &str) -> DatasetResult<()> {
    let failed = DatasetError::file("writing", &folder.join(name));
    new_file::write(folder, name, text).map(drop).map_err(failed)
}

/// Makes the folders of a rig, and removes unfinished files of an earlier call.
///
/// # Errors
/// `DatasetError::File` if a folder cannot be made or a file cannot be removed.
pub fn prepare(folder: &Path, rig: &str) -> DatasetResult<()> {
    for place in [place(folder, rig), folder.join(TRIALS)] {
        std::fs::create_dir_all(&place).map_err(DatasetError::file("making", &place))?;
        let failed = DatasetError::file("removing unfinished files in", &place);
        new_file::sweep(&place).map_err(failed)?;
    }
    Ok(())
}

/// Writes the tables and the manifest of fetched datasets, in the order of their rigs. The tables of other rigs
/// are removed. Blocks for the whole duration. `progress`: rows of the tables, once the files are checked.
///
/// # Errors
/// `DatasetError::Problems` if a file does not have its sha256, rigs differ, or a run is of two rigs: nothing is
/// written; `File`, `Parquet`, `Arrow` or `Format` if reading or writing fails.
pub fn join(
    folder: &Path,
    dataset: &str,
    rigs: &[Fetched],
    tables: Tables,
    progress: &Progress,
) -> DatasetResult<Federation> {
    let mut damaged = Vec::new();
    for fetched in rigs {
        damaged.extend(fetched.damage(folder)?);
    }
    refuse(damaged)?;
    let open = |fetched| Opened::open(folder, fetched);
    let opened = rigs.iter().map(open).collect::<DatasetResult<Vec<_>>>()?;
    refuse(repeated(&opened))?;
    if tables == Tables::Joint {
        refuse(differences(&opened))?;
    }
    progress.total.store(rigs.iter().map(|fetched| fetched.rows).sum(), Relaxed);
    let parts = opened.iter().map(|opened| opened.write(folder, progress));
    let parts = parts.collect::<DatasetResult<Vec<_>>>()?;
    let rows = parts.iter().flat_map(|part| &part.files).map(|file| file.rows).sum();
    let apart = tables == Tables::Apart;
    let federation = Federation { dataset: dataset.to_owned(), apart, rows, rigs: parts };
    let text = serde_json::to_string_pretty(&federation).map_err(DatasetError::Json)?;
    write(folder, MANIFEST, &(text + "\n"))?;
    let files = federation.rigs.iter().flat_map(|part| &part.files);
    let names = files.filter_map(|file| Path::new(&file.file).file_name()?.to_str());
    remove_other_tables(&folder.join(TRIALS), &names.map(str::to_owned).collect())?;
    Ok(federation)
}

fn refuse(problems: Vec<Problem>) -> DatasetResult<()> {
    if problems.is_empty() { Ok(()) } else { Err(DatasetError::Problems(problems)) }
}

impl<'a> Opened<'a> {
    fn open(folder: &Path, fetched: &'a Fetched) -> DatasetResult<Self> {
        let path = fetched.file(folder);
        let rows = DatasetRows::open(&path, &Wanted::default())?;
        let offsets = table::offsets(&rows)?;
        Ok(Self { fetched, sensor: sensor_text(&path)?, rows, offsets })
    }

    /// Writes its sensor file and its tables.
    fn write(&self, folder: &Path, progress: &Progress) -> DatasetResult<RigPart> {
        let Fetched { rig, dataset, lineage, .. } = self.fetched;
        let mut metadata = HashMap::from([
            ("palpate.rig".to_owned(), rig.clone()),
            ("palpate.dataset".to_owned(), dataset.to_string()),
            ("palpate.lineage".to_owned(), lineage.to_string()),
        ]);
        let has_sensor = !self.sensor.is_empty();
        if has_sensor {
            metadata.insert(SENSOR_KEY.to_owned(), self.sensor.clone());
            write(&place(folder, rig), SENSOR, &self.sensor)?;
        }
        let files = table::write(rig, &self.rows, &self.offsets, &metadata, folder, progress)?;
        Ok(RigPart {
            fetched: self.fetched.clone(),
            sensor_file: has_sensor.then(|| format!("{FETCHED}/{rig}/{SENSOR}")),
            sensor_sha256: has_sensor.then(|| sha256_hex(&self.sensor)),
            calibrations: self.fetched.calibrations(),
            files,
        })
    }
}

/// What would give two rows one id: a run of two rigs, or two folders of shards with one seed.
fn repeated(opened: &[Opened<'_>]) -> Vec<Problem> {
    let mut rig_of: BTreeMap<&str, &str> = BTreeMap::new();
    let mut problems = Vec::new();
    for Opened { fetched, offsets, .. } in opened {
        let rig = fetched.rig.as_str();
        let known = offsets.keys().find_map(|run| Some((run, *rig_of.get(run.as_str())?)));
        if let Some((run, other)) = known {
            let limit = "must be of one rig: a service is named twice, or its database was copied";
            problems.push(Problem::new(&format!("rigs {other} and {rig}"), "run", run, limit));
        }
        rig_of.extend(offsets.keys().map(|run| (run.as_str(), rig)));
        if let Some(seed) = fetched.repeated_seed() {
            let limit = "must be that of one folder of Sim-Random";
            problems.push(Problem::new(&format!("rig {rig}"), "sim_random seed", seed, limit));
        }
    }
    problems
}

/// What differs between the first rig and each of the others.
fn differences(opened: &[Opened<'_>]) -> Vec<Problem> {
    let facts =
        |one: &Opened<'_>| differ::facts(&one.sensor, &one.rows.schema(), &one.fetched.definition);
    let Some((first, others)) = opened.split_first() else { return Vec::new() };
    let wanted = facts(first);
    let differs = |other: &Opened<'_>| {
        let found = differ::first_difference(&wanted, &facts(other))?;
        let rigs = format!("rigs {} and {}", first.fetched.rig, other.fetched.rig);
        let values = format!("{} and {}", found.one, found.other);
        let limit = "must be equal in one table; --apart keeps the rigs apart";
        Some(Problem::new(&rigs, &found.key, values, limit))
    };
    others.iter().filter_map(differs).collect()
}

/// Removes the Parquet files of a folder except these.
fn remove_other_tables(folder: &Path, kept: &BTreeSet<String>) -> DatasetResult<()> {
    let failed = DatasetError::file("removing earlier tables in", folder);
    for entry in std::fs::read_dir(folder).map_err(&failed)? {
        let entry = entry.map_err(&failed)?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.ends_with(".parquet") && !kept.contains(&name) {
            std::fs::remove_file(entry.path()).map_err(&failed)?;
        }
    }
    Ok(())
}
