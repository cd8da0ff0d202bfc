//! Options that choose the bench of a service which a command starts: a rig file, or a virtual bench.
//! Uses: `files`. Never: a process, motion.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::Args;

use super::error::{CliError, CliResult};
use super::files::{DEFAULT_GAP, read_or_carried};
use crate::carried::{FAULTS, GAPS};
use crate::file_kind::FileKind;
use crate::problem::Problem;

/// Default speed of the virtual rig.
const DEFAULT_SPEED: f64 = 20.0;

/// The option without a value.
const VIRTUAL: &str = "--virtual";

/// Options of `run` and `serve` on their bench.
#[derive(Debug, Clone, Default, PartialEq, Args)]
pub struct BenchArgs {
    /// Rig file of the bench, or the name of a carried one [default: a virtual rig]; with --virtual, the bench to
    /// simulate.
    #[arg(long, value_name = "FILE")]
    pub rig: Option<PathBuf>,
    /// Use a virtual rig, also with --rig; `run` then starts a separate service.
    #[arg(long = "virtual")]
    pub on_virtual: bool,
    /// Virtual rig: process seconds per wall second [default: 20].
    #[arg(long, value_name = "N")]
    pub speed: Option<f64>,
    /// Virtual rig: differences of its skin from the model, a file or gap-a to gap-d [default: gap-a].
    #[arg(long, value_name = "FILE")]
    pub gap: Option<PathBuf>,
    /// Virtual rig: seed of its skin [default: 3].
    #[arg(long, value_name = "N")]
    pub skin_seed: Option<u64>,
    /// Virtual rig: days since the readout of its skin was first switched on [default: 0].
    #[arg(long, value_name = "DAYS")]
    pub skin_age_days: Option<f64>,
    /// Virtual rig: script of faults with their times, a file or each-kind.
    #[arg(long, value_name = "SCRIPT")]
    pub fault: Option<PathBuf>,
}

impl BenchArgs {
    /// The options that choose a bench and were stated, as problems with this limit; empty without one.
    pub fn refused(&self, limit: &str) -> Vec<Problem> {
        let problem = |(option, value): (&str, OsString)| {
            Problem::new("command line", option, value.display(), limit)
        };
        self.stated().into_iter().map(problem).collect()
    }

    /// The options that choose a bench and were stated, each with its value; empty without one.
    fn stated(&self) -> Vec<(&'static str, OsString)> {
        let path = |path: &Option<PathBuf>| path.clone().map(PathBuf::into_os_string);
        let all = [
            ("--rig", path(&self.rig)),
            (VIRTUAL, self.on_virtual.then(|| "given".into())),
            ("--speed", self.speed.map(|speed| speed.to_string().into())),
            ("--gap", path(&self.gap)),
            ("--skin-seed", self.skin_seed.map(|seed| seed.to_string().into())),
            ("--skin-age-days", self.skin_age_days.map(|days| days.to_string().into())),
            ("--fault", path(&self.fault)),
        ];
        all.into_iter().filter_map(|(option, value)| Some((option, value?))).collect()
    }

    /// Whether the bench is a virtual one, which must be started.
    pub fn is_virtual(&self) -> bool {
        self.on_virtual || self.rig.is_none()
    }

    /// Checks for options that contradict each other, and for files that cannot be read.
    ///
    /// # Errors
    /// `CliError::Problems` with the options.
    pub fn check(&self) -> CliResult<()> {
        let mut wrong = self.refused("must not be combined with --rig, except with --virtual");
        wrong.retain(|problem| problem.key != "--rig");
        if !self.is_virtual() && !wrong.is_empty() {
            return Err(wrong.into());
        }
        let speed = self.speed();
        if !(0.01..=2000.0).contains(&speed) {
            return Err(CliError::argument("--speed", speed, "must be from 0.01 to 2000"));
        }
        let age_days = self.skin_age_days.unwrap_or(0.0);
        if !(0.0..=3650.0).contains(&age_days) {
            return Err(CliError::argument("--skin-age-days", age_days, "must be from 0 to 3650"));
        }
        self.gap_text()?;
        let script = self.fault.as_deref();
        script.map_or(Ok(()), |named| read_or_carried(FileKind::Faults, named, FAULTS).map(drop))
    }

    /// Text of the differences of the virtual skin from the model.
    ///
    /// # Errors
    /// `CliError::Problems` if the file cannot be read.
    pub fn gap_text(&self) -> CliResult<String> {
        let named = self.gap.as_deref().unwrap_or(Path::new(DEFAULT_GAP));
        read_or_carried(FileKind::Gap, named, GAPS)
    }

    /// Process seconds per wall second of the virtual rig.
    pub fn speed(&self) -> f64 {
        self.speed.unwrap_or(DEFAULT_SPEED)
    }

    /// The options as words of a command line.
    pub fn arguments(&self) -> Vec<OsString> {
        let words = self.stated().into_iter().flat_map(|(option, value)| {
            [OsString::from(option)].into_iter().chain((option != VIRTUAL).then_some(value))
        });
        words.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bench_is_virtual_unless_a_rig_file_is_named() {
        assert!(BenchArgs::default().is_virtual());
        let named = BenchArgs { rig: Some("rig.toml".into()), ..BenchArgs::default() };
        assert!(!named.is_virtual());
        assert!(BenchArgs { on_virtual: true, ..named }.is_virtual());
    }

    #[test]
    fn arguments_are_read_back() {
        #[derive(clap::Parser)]
        struct Line {
            #[command(flatten)]
            bench: BenchArgs,
        }
        let all = BenchArgs {
            rig: Some("r.toml".into()),
            on_virtual: true,
            speed: Some(0.5),
            gap: Some("g.toml".into()),
            skin_seed: Some(4),
            skin_age_days: Some(1.0),
            fault: Some("f.txt".into()),
        };
        for bench in [BenchArgs::default(), all] {
            let line = ["palpate".into()].into_iter().chain(bench.arguments());
            assert_eq!(<Line as clap::Parser>::parse_from(line).bench, bench);
        }
    }

    #[test]
    fn options_of_the_virtual_rig_are_for_a_simulated_rig_and_have_limits() {
        let simulated = BenchArgs {
            rig: Some("rig.toml".into()),
            speed: Some(5.0),
            on_virtual: true,
            ..BenchArgs::default()
        };
        let gap = BenchArgs { gap: Some("gap-b".into()), ..BenchArgs::default() };
        let fault = BenchArgs { fault: Some("each-kind".into()), ..BenchArgs::default() };
        for bench in [BenchArgs::default(), simulated, gap, fault] {
            bench.check().unwrap();
        }
        let stopped = BenchArgs { speed: Some(0.0), ..BenchArgs::default() };
        let unknown = BenchArgs { fault: Some("each-kin".into()), ..BenchArgs::default() };
        for bench in [stopped, unknown] {
            assert!(bench.check().is_err(), "{bench:?}");
        }
    }
}
