//! A program of this source tree that the service starts as a process: found, or built when first needed.
//! Uses: std's and tokio's processes. Never: what the program does.
//!
//! `find` is pure; `build` runs cargo; `lines` reads the output of a process; `secrets` are what it does not inherit.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

mod build;
mod find;
mod lines;
mod secrets;

pub use find::{Build, Program};
pub use lines::Lines;
pub use secrets::{withhold, withhold_bulk};

/// Interval at which a stop is noticed while a program is built or works.
pub const STOP_POLL: Duration = Duration::from_millis(100);

/// A program that belongs to this one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Known {
    /// Name of its file.
    pub name: &'static str,
    /// Environment variable that names its path.
    pub variable: &'static str,
    /// Folder of its source, from the root of the source tree.
    pub folder: &'static str,
    /// Folder of its workspace, from there; empty for the root.
    pub workspace: &'static str,
    /// What it is, in messages.
    pub about: &'static str,
}

/// Why a program is not there.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum ProgramError {
    /// It is not installed, and this program was not built from a source that is still there.
    #[error(
        "no {}: it is not next to {}, and {} does not name it; run `cargo install --path {} --locked` \
         in the source of palpate {}, then try again",
        known.name, executable.display(), known.variable, known.folder, env!("CARGO_PKG_VERSION")
    )]
    Missing { known: &'static Known, executable: PathBuf },
    /// Cargo could not be started.
    #[error("building {}: cargo: {source}; run `{}`", known.about, known.command())]
    Cargo { known: &'static Known, source: io::Error },
    /// Cargo could not build the program.
    #[error("building {} with `{}` failed:\n{said}", known.about, known.command())]
    Build { known: &'static Known, said: String },
}

impl Known {
    /// Returns how the program is available to the running one.
    pub fn find(&self) -> Program {
        let stated = std::env::var_os(self.variable).map(PathBuf::from);
        find::find(self, stated, &executable(), source(), Path::exists)
    }

    /// Returns the path of the program, which is built if it must be; `None` if `is_stopped` became
    /// true meanwhile. `seen` receives what cargo does.
    ///
    /// # Errors
    /// `ProgramError` if there is none, and it cannot be built.
    pub async fn path(
        &'static self,
        seen: impl FnMut(&str),
        is_stopped: impl Fn() -> bool,
    ) -> Result<Option<PathBuf>, ProgramError> {
        match self.find() {
            Program::Ready(program) => {
                self.warn_if_old(&program);
                Ok(Some(program))
            }
            Program::Source(build) => {
                let built = build::build(self, &build, seen, is_stopped).await?;
                Ok(built.then_some(build.program))
            }
            Program::Missing => Err(self.missing()),
        }
    }

    /// The error that the program is missing.
    pub fn missing(&'static self) -> ProgramError {
        ProgramError::Missing { known: self, executable: executable() }
    }

    /// The command that builds it in the source.
    fn command(&self) -> String {
        match self.workspace {
            "" => format!("cargo build --bin {}", self.name),
            folder => format!("cargo build --manifest-path {folder}/Cargo.toml"),
        }
    }

    /// Warns if a program of the source tree was built before this one: cargo builds only the program
    /// that is run.
    fn warn_if_old(&self, program: &Path) {
        let without = |path: &Path| path != program && path.exists();
        let found = find::find(self, None, &executable(), source(), without);
        let built = |path: &Path| path.metadata().and_then(|found| found.modified()).ok();
        if matches!(found, Program::Source(_)) && built(program) < built(&executable()) {
            tracing::warn!(
                program = %program.display(),
                "{} is older than this program; if its source has changed since, run `{}`",
                self.about, self.command()
            );
        }
    }
}

fn executable() -> PathBuf {
    std::env::current_exe().unwrap_or_default()
}

/// Root of the source tree from which this program was built.
fn source() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).unwrap_or(Path::new(""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_program_names_what_to_do() {
        let executable = "/usr/bin/palpate".into();
        let error = ProgramError::Missing { known: &find::tests::TRAINER, executable };
        for words in [
            "no palpate-trainer: it is not next to /usr/bin/palpate",
            "PALPATE_TRAINER does not name it",
            "cargo install --path trainer --locked",
        ] {
            assert!(error.to_string().contains(words), "{error}");
        }
    }
}
