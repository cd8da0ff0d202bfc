//! Where a program is: named, next to this one, to be built from the source, or missing.
//! PURE. Never: the disk (what exists is passed in), a build (`build`).

use std::path::{Path, PathBuf};

use super::Known;

/// How a program is available.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Program {
    /// It is installed at this path.
    Ready(PathBuf),
    /// It can be built, as this program was.
    Source(Build),
    /// It must be installed.
    Missing,
}

/// A build with the profile and the target folder of this program.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Build {
    /// Folder of its workspace.
    pub workspace: PathBuf,
    /// Cargo's target folder.
    pub target: PathBuf,
    /// Cargo's profile.
    pub profile: String,
    /// Path of the built program.
    pub program: PathBuf,
}

/// Finds a program: the stated path, else next to the running executable, else a build if that
/// executable is in a target folder of cargo and its source is there.
///
/// `source` is the root of the source tree from which this program was built; `exists` states which
/// paths exist.
pub fn find(
    known: &Known,
    stated: Option<PathBuf>,
    executable: &Path,
    source: &Path,
    exists: impl Fn(&Path) -> bool,
) -> Program {
    if let Some(stated) = stated {
        return Program::Ready(stated);
    }
    let Some(folder) = executable.parent() else { return Program::Missing };
    // Cargo places tests one folder deeper than programs.
    let above = if folder.ends_with("deps") { folder.parent() } else { None };
    let nearby = [Some(folder), above].into_iter().flatten().map(|folder| folder.join(known.name));
    if let Some(program) = nearby.into_iter().find(|program| exists(program)) {
        return Program::Ready(program);
    }
    let profile_folder = above.unwrap_or(folder);
    let (Some(target), Some(profile)) = (profile_folder.parent(), profile_folder.file_name())
    else {
        return Program::Missing;
    };
    let is_target =
        exists(&target.join("CACHEDIR.TAG")) && exists(&profile_folder.join(".cargo-lock"));
    if !is_target || !exists(&source.join(known.folder).join("Cargo.toml")) {
        return Program::Missing;
    }
    let profile = profile.to_string_lossy();
    Program::Source(Build {
        workspace: source.join(known.workspace),
        target: target.into(),
        profile: if profile == "debug" { "dev".into() } else { profile.into_owned() },
        program: profile_folder.join(known.name),
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A program that may be built.
    pub const TRAINER: Known = Known {
        name: "palpate-trainer",
        variable: "PALPATE_TRAINER",
        folder: "trainer",
        workspace: "",
        about: "the trainer",
    };
    const SOURCE: &str = "/src/palpate";
    const SOURCES: [&str; 1] = ["/src/palpate/trainer/Cargo.toml"];
    const TARGET: [&str; 3] = ["/t/CACHEDIR.TAG", "/t/debug/.cargo-lock", "/t/release/.cargo-lock"];

    fn found(executable: &str, there: &[&[&str]]) -> Program {
        let there = there.concat();
        let exists = |path: &Path| there.iter().any(|one| Path::new(one) == path);
        find(&TRAINER, None, Path::new(executable), Path::new(SOURCE), exists)
    }

    #[test]
    fn a_stated_program_comes_before_all_others() {
        let all = |_: &Path| true;
        let stated = Some(PathBuf::from("/gpu/trainer"));
        let program = find(&TRAINER, stated, Path::new("/t/debug/palpate"), Path::new(SOURCE), all);
        assert_eq!(program, Program::Ready("/gpu/trainer".into()));
    }

    #[test]
    fn the_program_next_to_this_one_is_used_and_a_test_checks_one_folder_up() {
        let ready = Program::Ready("/t/debug/palpate-trainer".into());
        let there: &[&[&str]] = &[&TARGET, &SOURCES, &["/t/debug/palpate-trainer"]];
        assert_eq!(found("/t/debug/palpate", there), ready);
        assert_eq!(found("/t/debug/deps/it-0a1b", there), ready);
        let installed =
            found("/home/a/.cargo/bin/palpate", &[&["/home/a/.cargo/bin/palpate-trainer"]]);
        assert_eq!(installed, Program::Ready("/home/a/.cargo/bin/palpate-trainer".into()));
        assert_eq!(found("/opt/bin/palpate", &[&["/opt/palpate-trainer"]]), Program::Missing);
    }

    #[test]
    fn it_is_built_only_in_a_target_folder_with_its_source() {
        for (executable, profile, folder) in [
            ("/t/debug/palpate", "dev", "debug"),
            ("/t/debug/deps/it-0a1b", "dev", "debug"),
            ("/t/release/palpate", "release", "release"),
        ] {
            let build = Build {
                workspace: Path::new(SOURCE).join(""),
                target: "/t".into(),
                profile: profile.into(),
                program: format!("/t/{folder}/palpate-trainer").into(),
            };
            assert_eq!(found(executable, &[&TARGET, &SOURCES]), Program::Source(build));
        }
        assert_eq!(found("/t/debug/palpate", &[&TARGET]), Program::Missing);
        assert_eq!(found("/t/debug/palpate", &[&SOURCES]), Program::Missing);
        assert_eq!(found("/home/a/.cargo/bin/palpate", &[&TARGET, &SOURCES]), Program::Missing);
    }
}
