//! Experiment, sensor, rig and calibration files, read and checked; and the files carried in the program.
//! Uses: `schedule`, `rig::config`, sim-core's sensor. Never: the network, motion.

use std::io;
use std::path::{Path, PathBuf};

use sim_core::calibration::{Calibration, CalibrationError};
use sim_core::sensor::{Sensor, SensorError, SensorFile};

use super::error::{CliError, CliResult, io_words};
use crate::carried::{self, EXPERIMENTS, FAULTS, RECIPES, RIGS, SENSORS};
use crate::file_kind::FileKind;
use crate::near::did_you_mean;
use crate::new_file;
use crate::problem::Problem;
use crate::rig::reach::{bench, reach};
use crate::rig::setup::RigSetup;
use crate::schedule::experiment::Experiment;
use crate::schedule::lint::lint;
use crate::schedule::plan::Plan;
use crate::schedule::preflight::Preflight;
use crate::syntax::parse_toml;

/// Name of the carried rig file in problems.
const DEFAULT_RIG_FILE: &str = "experiments/rigs/virtual.toml";
/// The default rig: the virtual one.
pub const DEFAULT_RIG: &str = include_str!("../../experiments/rigs/virtual.toml");
/// Name of the default skin's differences from the model.
pub const DEFAULT_GAP: &str = "gap-a";
/// Name of the carried sensor file in problems.
const DEFAULT_SENSOR_FILE: &str = "experiments/sensors/ert-28.toml";
/// The default skin.
pub const DEFAULT_SENSOR: &str = include_str!("../../experiments/sensors/ert-28.toml");
/// Carried files of a kind: name and text.
pub type CarriedFiles = &'static [(&'static str, &'static str)];
/// The default skin's seed.
pub const DEFAULT_SKIN_SEED: u64 = 3;

/// An experiment with all files that it names, checked.
pub struct ExperimentFiles {
    /// Path or name, as given.
    pub file: String,
    /// Text of the experiment file.
    pub definition: String,
    /// Text of its sensor file.
    pub sensor_text: String,
    /// Experiment, parsed and checked.
    pub experiment: Experiment,
    /// Sensor that the experiment names, parsed and checked.
    pub sensor: Sensor,
    /// Plan of the experiment.
    pub plan: Plan,
}

/// A rig file, checked.
#[derive(Debug, Clone)]
pub struct RigFiles {
    /// Path as given.
    pub file: String,
    /// Text of the rig file.
    pub text: String,
    /// Devices, wires and limits that the file states.
    pub config: RigSetup,
}

impl ExperimentFiles {
    /// Reads an experiment file and its sensor file, and makes the plan. An experiment or a sensor that is
    /// no file is the carried one of that name.
    ///
    /// # Errors
    /// `CliError::Problems` with all problems of the files.
    pub fn read(path: &Path) -> CliResult<Self> {
        let file = path.display().to_string();
        let definition = read_or_carried(FileKind::Experiment, path, EXPERIMENTS)?;
        let experiment = Experiment::from_toml(&file, &definition)
            .map_err(|problems| of_kind(FileKind::Experiment, &file, &definition, problems))?;
        let sensor_path: PathBuf = path.parent().unwrap_or(Path::new("")).join(&experiment.sensor);
        let sensor_text = match carried::sensor(&experiment.sensor) {
            Some(text) if !sensor_path.exists() => text.to_owned(),
            _ => std::fs::read_to_string(&sensor_path).map_err(|error| {
                let limit = format!("{}: {}", sensor_path.display(), io_words(&error));
                Problem::new(&file, "sensor", &experiment.sensor, limit)
            })?,
        };
        let sensor = parse_sensor(&sensor_path.display().to_string(), &sensor_text)?;
        let plan = Plan::of(&file, &experiment, &sensor)?;
        Ok(Self { file, definition, sensor_text, experiment, sensor, plan })
    }

    /// The preflight on a rig.
    pub fn preflight(&self, rig: &RigFiles) -> Preflight {
        let reach = reach(&rig.file, &rig.config);
        let problems = lint(&self.file, &self.experiment, &self.sensor, &reach);
        Preflight::of(&self.plan, &bench(&rig.config), problems)
    }
}

impl RigFiles {
    /// Reads a rig file, or the carried one of that name; without either, returns the virtual rig.
    ///
    /// # Errors
    /// `CliError::Problems` with all problems of the file.
    pub fn read(path: Option<&Path>) -> CliResult<Self> {
        match path {
            Some(path) => {
                Self::parse(path.display().to_string(), read_or_carried(FileKind::Rig, path, RIGS)?)
            }
            None => Self::parse(DEFAULT_RIG_FILE.into(), DEFAULT_RIG.into()),
        }
    }

    /// Checks a rig file's text.
    ///
    /// # Errors
    /// `CliError::Problems` with all problems of the text.
    pub fn parse(file: String, text: String) -> CliResult<Self> {
        let config = RigSetup::from_toml(&file, &text)
            .map_err(|problems| of_kind(FileKind::Rig, &file, &text, problems))?;
        Ok(Self { file, text, config })
    }
}

/// Writes a file, and creates its folders.
///
/// # Errors
/// `CliError::File` if it cannot be written.
pub fn write(path: &Path, contents: &(impl AsRef<[u8]> + ?Sized)) -> CliResult<()> {
    let failed = |source| CliError::File { path: path.into(), source };
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|error| match error.kind() {
            io::ErrorKind::AlreadyExists => failed(io::ErrorKind::NotADirectory.into()),
            _ => failed(error),
        })?;
    }
    std::fs::write(path, contents).map_err(failed)
}

/// Returns the path of this program.
///
/// # Errors
/// `CliError::System` if the system does not state it.
pub fn this_program() -> CliResult<PathBuf> {
    std::env::current_exe().map_err(CliError::system("finding this program"))
}

/// Reads a file named on the command line.
///
/// # Errors
/// `CliError::Problems` if it cannot be read: that is bad input.
pub fn read_input(path: &Path) -> CliResult<String> {
    std::fs::read_to_string(path).map_err(|error| {
        let words = format!("{}{}", io_words(&error), similar(path, &error));
        CliError::in_file(path, words)
    })
}

/// Reads a file of this kind that is named on the command line, or returns the carried file of that name if there
/// is none.
///
/// # Errors
/// `CliError::Problems` if there is neither, with the carried names, or the file is of another kind.
pub fn read_or_carried(kind: FileKind, path: &Path, files: CarriedFiles) -> CliResult<String> {
    let name = path.to_str().filter(|_| !path.exists());
    if let Some(text) = name.and_then(|name| carried::text(files, name)) {
        return Ok(text.to_owned());
    }
    match name.filter(|name| !name.contains(['.', '/'])) {
        None => read_as(kind, path).map_err(|error| {
            // The path of a carried file in a checkout, typed elsewhere.
            let stem = path.file_stem().filter(|_| !path.exists());
            let carried = carried::names(files).find(|name| stem.is_some_and(|stem| stem == *name));
            match (error, carried) {
                (CliError::Problems(mut problems), Some(name)) => {
                    problems[0].limit += &format!("; palpate carries {name}, without a path");
                    CliError::Problems(problems)
                }
                (error, _) => error,
            }
        }),
        Some(name) => {
            let names: Vec<&str> = carried::names(files).collect();
            let words = format!(
                "is neither a file nor {} that palpate carries: {}{}",
                kind.name(),
                names.join(", "),
                did_you_mean(name, names.iter().copied())
            );
            Err(CliError::in_file(path, words))
        }
    }
}

/// Returns the path of a file of this kind that is named on the command line. A name without a file is that of a carried
/// one, which is written to a folder as `name`.
///
/// # Errors
/// As [`read_or_carried`]; `CliError::File` if the carried file cannot be written.
pub fn on_disk(
    kind: FileKind,
    named: &Path,
    files: CarriedFiles,
    folder: &Path,
    name: &str,
) -> CliResult<PathBuf> {
    let text = read_or_carried(kind, named, files)?;
    if named.exists() { Ok(named.into()) } else { write_in(folder, name, &text) }
}

/// Writes a file into a folder, which only this user can open if it is new. Returns its path.
///
/// # Errors
/// `CliError::File` if it cannot be written.
pub fn write_in(folder: &Path, name: &str, text: &str) -> CliResult<PathBuf> {
    new_file::make_folder(folder).map_err(CliError::file(folder))?;
    let path = folder.join(name);
    write(&path, text).map(|()| path)
}

/// Returns the path of a script of faults; a carried one is written to a folder.
///
/// # Errors
/// `CliError::Problems` if it cannot be read, or is of another kind; `CliError::File` if it cannot be written.
pub fn fault_script(folder: &Path, named: &Path) -> CliResult<PathBuf> {
    on_disk(FileKind::Faults, named, FAULTS, folder, "faults.toml")
}

/// As [`read_input`], for a file of this kind.
///
/// # Errors
/// `CliError::Problems` if it cannot be read, or is of another kind.
pub fn read_as(kind: FileKind, path: &Path) -> CliResult<String> {
    let text = read_input(path)?;
    match kind.instead_of(&text) {
        Some(words) => Err(CliError::in_file(path, words)),
        None => Ok(text),
    }
}

/// A proposal for a file that does not exist: one of its folder with a similar name.
fn similar(path: &Path, error: &io::Error) -> String {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let entries = std::fs::read_dir(folder.unwrap_or(Path::new("."))).ok();
    let (Some(name), Some(entries), io::ErrorKind::NotFound) =
        (path.file_name().and_then(|name| name.to_str()), entries, error.kind())
    else {
        return String::new();
    };
    let files = entries.flatten().filter(|entry| entry.path().is_file());
    let names: Vec<String> =
        files.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    did_you_mean(name, names.iter().map(String::as_str))
}

/// Reads a sensor file, or the carried one of that name; without either the default one. Also returns its text.
///
/// # Errors
/// `CliError::Problems` if the file cannot be read or is invalid.
pub fn read_sensor(path: Option<&Path>) -> CliResult<(Sensor, String)> {
    let (file, text) = match path {
        Some(path) => {
            let text = read_or_carried(FileKind::Sensor, path, SENSORS)?;
            (path.display().to_string(), text)
        }
        None => (DEFAULT_SENSOR_FILE.into(), DEFAULT_SENSOR.into()),
    };
    Ok((parse_sensor(&file, &text)?, text))
}

/// Returns the sensor of a file, or of the carried one of that name; `None` without a name.
///
/// # Errors
/// `CliError::Problems` if the file cannot be read or is invalid.
pub fn named_sensor(named: Option<&Path>) -> CliResult<Option<Sensor>> {
    let read = |path| read_sensor(Some(path)).map(|(sensor, _)| sensor);
    named.map(read).transpose()
}

fn parse_sensor(file: &str, text: &str) -> CliResult<Sensor> {
    Sensor::from_toml(text).map_err(|error| {
        let problems = match error {
            SensorError::Value { key, value, limit } => {
                vec![Problem::new(file, &key, value, limit)]
            }
            SensorError::Syntax(words) => match parse_toml::<SensorFile>(file, text) {
                Err(problems) => problems,
                Ok(_) => vec![Problem::whole(file, words)],
            },
        };
        of_kind(FileKind::Sensor, file, text, problems)
    })
}

/// The error of a file with problems; of a file of another kind only this is reported.
fn of_kind(kind: FileKind, file: &str, text: &str, problems: Vec<Problem>) -> CliError {
    CliError::Problems(match kind.instead_of(text) {
        Some(words) => vec![Problem::whole(file, words)],
        None => problems,
    })
}

/// Text of a carried file, by the name that it has in problems.
pub fn carried_text(file: &str) -> Option<&'static str> {
    match file {
        DEFAULT_RIG_FILE => Some(DEFAULT_RIG),
        DEFAULT_SENSOR_FILE => Some(DEFAULT_SENSOR),
        name => {
            [RECIPES, EXPERIMENTS, RIGS].into_iter().find_map(|files| carried::text(files, name))
        }
    }
}

/// Reads a calibration file and checks that it fits the sensor.
///
/// # Errors
/// `CliError::Problems` if the file is invalid or of another sensor.
pub fn read_calibration(path: &Path, sensor: &Sensor) -> CliResult<Calibration> {
    let calibration = parse_calibration(path)?;
    calibration.apply(sensor).map_err(|e| calibration_problem(path, e))?;
    Ok(calibration)
}

/// Reads a calibration file of any sensor.
///
/// # Errors
/// `CliError::Problems` if the file cannot be read or is invalid.
pub fn parse_calibration(path: &Path) -> CliResult<Calibration> {
    Calibration::from_toml(&read_input(path)?).map_err(|e| calibration_problem(path, e))
}

/// The problem of a calibration file.
pub fn calibration_problem(path: &Path, error: CalibrationError) -> CliError {
    let file = path.display().to_string();
    match error {
        CalibrationError::Value { key, value, limit } => Problem::new(&file, &key, value, limit),
        other => Problem::whole(&file, other.to_string()),
    }
    .into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_carried_files_are_sound() {
        let rig = RigFiles::read(None).unwrap();
        assert_eq!(rig.config.label().as_str(), "virtual");
        assert_eq!(parse_sensor("s", DEFAULT_SENSOR).unwrap().electrodes_mm().len(), 28);
    }

    #[test]
    fn a_sensor_is_named_as_its_default() {
        let named = |name: &str| read_sensor(Some(Path::new(name))).map(|(_, text)| text);
        assert_eq!(named("ert-28").unwrap(), DEFAULT_SENSOR);
        assert!(named_sensor(None).unwrap().is_none());
        let sensor = named_sensor(Some(Path::new("ert-28"))).unwrap().unwrap();
        assert_eq!(sensor.electrodes_mm().len(), 28);
        let unknown = named("ert-29").unwrap_err().to_string();
        assert!(unknown.contains("did you mean `ert-28`?"), "{unknown}");
    }
}
