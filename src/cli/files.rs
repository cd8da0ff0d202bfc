//! Experiment, sensor, rig and calibration files, read and checked; and the files carried in the program.
//! Uses: `schedule`, `rig::config`, sim-core's sensor. Never: the network, motion.

use std::path::{Path, PathBuf};

use sim_core::calibration::{Calibration, CalibrationError};
use sim_core::sensor::{Sensor, SensorError, SensorFile};

use super::error::CliError;
use crate::carried::{self, EXPERIMENTS, RIGS};
use crate::digest::sha256_hex;
use crate::problem::Problem;
use crate::rig::reach::{bench, reach};
use crate::rig::setup::RigSetup;
use crate::schedule::experiment::Experiment;
use crate::schedule::lint::lint;
use crate::schedule::plan::Plan;
use crate::schedule::preflight::Preflight;
use crate::syntax::syntax_problem;

/// Name of the carried rig file in problems.
pub const DEFAULT_RIG_FILE: &str = "experiments/rigs/virtual.toml";
/// The default rig: the virtual one.
pub const DEFAULT_RIG: &str = include_str!("../../experiments/rigs/virtual.toml");
/// Name of the default skin's differences from the model.
pub const DEFAULT_GAP: &str = "gap-a";
/// Name of the carried sensor file in problems.
const DEFAULT_SENSOR_FILE: &str = "experiments/sensors/ert-28.toml";
/// The default skin.
pub const DEFAULT_SENSOR: &str = include_str!("../../experiments/sensors/ert-28.toml");
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
    /// Parsed experiment.
    pub experiment: Experiment,
    /// Parsed sensor.
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
    /// Parsed configuration.
    pub config: RigSetup,
}

impl ExperimentFiles {
    /// Reads an experiment file and its sensor file, and makes the plan. An experiment or a sensor that is
    /// no file is the carried one of that name.
    ///
    /// # Errors
    /// `CliError::Problems` with all problems of the files.
    pub fn read(path: &Path) -> Result<Self, CliError> {
        let file = path.display().to_string();
        let definition = read_or_carried(path, EXPERIMENTS)?;
        let experiment = Experiment::from_toml(&file, &definition).map_err(CliError::Problems)?;
        let sensor_path: PathBuf = path.parent().unwrap_or(Path::new("")).join(&experiment.sensor);
        let sensor_text = match carried::sensor(&experiment.sensor) {
            Some(text) if !sensor_path.exists() => text.to_owned(),
            _ => read_named(&file, "sensor", &experiment.sensor, &sensor_path)?,
        };
        let sensor = parse_sensor(&sensor_path.display().to_string(), &sensor_text)?;
        let plan = Plan::of(&file, &experiment, &sensor).map_err(CliError::Problems)?;
        Ok(Self { file, definition, sensor_text, experiment, sensor, plan })
    }

    /// The preflight on a rig.
    pub fn preflight(&self, rig: &RigFiles) -> Preflight {
        let reach = reach(&rig.file, &rig.config);
        let problems = lint(&self.file, &self.experiment, &self.sensor, &reach);
        Preflight::of(&self.plan, &bench(&rig.config), problems)
    }

    /// sha256 of the definition's text, as runs store it.
    pub fn definition_sha256(&self) -> String {
        sha256_hex(&self.definition)
    }

    /// sha256 of the sensor file's text, as runs store it.
    pub fn sensor_sha256(&self) -> String {
        sha256_hex(&self.sensor_text)
    }
}

impl RigFiles {
    /// Reads a rig file, or the carried one of that name; without either, returns the virtual rig.
    ///
    /// # Errors
    /// `CliError::Problems` with all problems of the file.
    pub fn read(path: Option<&Path>) -> Result<Self, CliError> {
        match path {
            Some(path) => Self::parse(path.display().to_string(), read_or_carried(path, RIGS)?),
            None => Self::parse(DEFAULT_RIG_FILE.into(), DEFAULT_RIG.into()),
        }
    }

    /// Checks a rig file's text.
    ///
    /// # Errors
    /// `CliError::Problems` with all problems of the text.
    pub fn parse(file: String, text: String) -> Result<Self, CliError> {
        let config = RigSetup::from_toml(&file, &text).map_err(CliError::Problems)?;
        Ok(Self { file, text, config })
    }
}

/// Writes a text file, and creates its folders.
///
/// # Errors
/// `CliError::File` if it cannot be written.
pub fn write(path: &Path, text: &str) -> Result<(), CliError> {
    write_bytes(path, text.as_bytes())
}

/// Writes a file, and creates its folders.
///
/// # Errors
/// `CliError::File` if it cannot be written.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), CliError> {
    let failed = |source| CliError::File { path: path.into(), source };
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(failed)?;
    }
    std::fs::write(path, bytes).map_err(failed)
}

/// Reads a file named on the command line.
///
/// # Errors
/// `CliError::Problems` if it cannot be read: that is bad input.
pub fn read_input(path: &Path) -> Result<String, CliError> {
    std::fs::read_to_string(path).map_err(|e| {
        CliError::Problems(vec![Problem::whole(&path.display().to_string(), e.to_string())])
    })
}

/// Reads a file named on the command line, or returns the carried file of that name if there is none.
///
/// # Errors
/// `CliError::Problems` if there is neither, with the carried names.
pub fn read_or_carried(path: &Path, files: &[(&str, &'static str)]) -> Result<String, CliError> {
    let name = path.to_str().filter(|_| !path.exists());
    match name.and_then(|name| carried::text(files, name)) {
        Some(text) => Ok(text.to_owned()),
        None if path.exists() => read_input(path),
        None => {
            let names: Vec<&str> = files.iter().map(|(name, _)| *name).collect();
            let words = format!(
                "there is no such file, and none is carried by this name: {}",
                names.join(", ")
            );
            Err(CliError::Problems(vec![Problem::whole(&path.display().to_string(), words)]))
        }
    }
}

/// Reads a file named in another file.
fn read_named(file: &str, key: &str, value: &str, path: &Path) -> Result<String, CliError> {
    std::fs::read_to_string(path).map_err(|e| {
        let limit = format!("{}: {e}", path.display());
        CliError::Problems(vec![Problem::new(file, key, value, limit)])
    })
}

/// Reads a sensor file, or returns the carried one.
///
/// # Errors
/// `CliError::Problems` if the file cannot be read or is invalid.
pub fn read_sensor(path: Option<&Path>) -> Result<Sensor, CliError> {
    read_sensor_text(path).map(|(sensor, _)| sensor)
}

/// As [`read_sensor`], with the text.
///
/// # Errors
/// `CliError::Problems` if the file cannot be read or is invalid.
pub fn read_sensor_text(path: Option<&Path>) -> Result<(Sensor, String), CliError> {
    let (file, text) = match path {
        Some(path) => (path.display().to_string(), read_input(path)?),
        None => (DEFAULT_SENSOR_FILE.into(), DEFAULT_SENSOR.into()),
    };
    Ok((parse_sensor(&file, &text)?, text))
}

fn parse_sensor(file: &str, text: &str) -> Result<Sensor, CliError> {
    Sensor::from_toml(text).map_err(|error| {
        let problem = match error {
            SensorError::Value { key, value, limit } => Problem::new(file, &key, value, limit),
            SensorError::Syntax(words) => match toml::from_str::<SensorFile>(text) {
                Err(e) => syntax_problem(file, text, &e),
                Ok(_) => Problem::whole(file, words),
            },
        };
        CliError::Problems(vec![problem])
    })
}

/// Reads a calibration file and checks that it fits the sensor.
///
/// # Errors
/// `CliError::Problems` if the file is invalid or of another sensor.
pub fn read_calibration(path: &Path, sensor: &Sensor) -> Result<Calibration, CliError> {
    let calibration = parse_calibration(path)?;
    calibration.apply(sensor).map_err(|e| calibration_problem(path, e))?;
    Ok(calibration)
}

/// Reads a calibration file of any sensor.
///
/// # Errors
/// `CliError::Problems` if the file cannot be read or is invalid.
pub fn parse_calibration(path: &Path) -> Result<Calibration, CliError> {
    Calibration::from_toml(&read_input(path)?).map_err(|e| calibration_problem(path, e))
}

/// The problem of a calibration file.
pub fn calibration_problem(path: &Path, error: CalibrationError) -> CliError {
    let file = path.display().to_string();
    let problem = match error {
        CalibrationError::Value { key, value, limit } => Problem::new(&file, &key, value, limit),
        other => Problem::whole(&file, other.to_string()),
    };
    CliError::Problems(vec![problem])
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
    fn a_missing_sensor_file_is_named_with_the_key_that_names_it() {
        let folder = std::env::temp_dir().join(format!("palpate-files-{}", std::process::id()));
        let path = folder.join("e.toml");
        let text = "name = \"e\"\nseed = 1\nsensor = \"none.toml\"\n[real_hex]\ntips = [1]\n\
                    configurations = 1\n";
        write(&path, text).unwrap();
        let error = ExperimentFiles::read(&path).err().unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
        let shown = error.to_string();
        assert!(shown.contains("sensor = none.toml"), "{shown}");
        assert_eq!(error.exit_code(), std::process::ExitCode::from(2));
    }

    #[test]
    fn a_sensor_key_outside_its_shape_is_named() {
        let error = parse_sensor("s.toml", "name = 3\n").err().unwrap().to_string();
        assert!(error.starts_with("s.toml: name = 3"), "{error}");
    }
}
