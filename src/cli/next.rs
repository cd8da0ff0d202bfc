//! The commands to type after a result. They go to standard error: standard output has the result alone.
//! Uses: `output`. Never: anything with `--json`. A test of `main.rs` parses every command that is written in
//! a call of [`Next::suggest`].

use std::fmt::Display;
use std::path::{Path, PathBuf};

use super::At;
use super::output::{columns, error_width, note_drawn, shown};

/// Commands to type next, each with what it does.
#[derive(Debug, Clone, Default)]
pub struct Next {
    /// Options that name the service and the data folder, as they were typed.
    place: String,
    /// Whether the output is for a script.
    json: bool,
    /// Commands, with what they do.
    lines: Vec<[String; 2]>,
}

impl Next {
    /// Commands for the service and the data folder that these options name.
    pub fn of(at: &At) -> Self {
        let path = |path: &PathBuf| path.display().to_string();
        let typed = [
            ("url", at.url.clone()),
            ("ca", at.ca.as_ref().map(path)),
            ("data", at.data.as_ref().map(path)),
        ];
        let typed = typed.into_iter().filter_map(|(option, value)| Some((option, value?)));
        let place = typed.map(|(option, value)| format!(" --{option} {}", word(&value)));
        Self { place: place.collect(), json: at.json, lines: Vec::new() }
    }

    /// Adds a command of `palpate`.
    pub fn suggest(self, command: impl Display, what: impl Display) -> Self {
        let command = format!("{command}{}", self.place);
        self.line(as_typed(&command, is_of_cargo_run()), what)
    }

    /// Adds the command that was typed: `again`, or `with` and `without` an option.
    pub fn same_command(self, how: impl Display, what: impl Display) -> Self {
        self.line(format!("the same command {how}"), what)
    }

    /// Adds a line that is no command of `palpate`.
    pub fn line(mut self, command: impl Display, what: impl Display) -> Self {
        self.lines.push([command.to_string(), what.to_string()]);
        self
    }

    /// Prints the commands; nothing if there is none, or for a script.
    pub fn say(&self) {
        if !self.json && !self.lines.is_empty() {
            note_drawn(shown(self.text(error_width())));
        }
    }

    /// The commands, each with what it does next to it, or below it if that needs more columns than the `terminal` has.
    /// A command is not wrapped: it is copied.
    pub fn text(&self, terminal: Option<usize>) -> String {
        let widest =
            |part: usize| self.lines.iter().map(|line| columns(&line[part])).max().unwrap_or(0);
        let width = widest(0) + 3;
        let fits = terminal.is_none_or(|terminal| 2 + width + widest(1) <= terminal);
        let lines = self.lines.iter().map(|[command, what]| match fits {
            true => format!("\n  {command}{:1$}{what}", "", width - columns(command)),
            false => format!("\n  {command}\n      {what}"),
        });
        format!("\nnext:{}", lines.collect::<String>())
    }
}

/// A command of `palpate` as it can be typed: after `cargo run -- ..` the program may not be installed.
fn as_typed(command: &str, of_cargo: bool) -> String {
    match command.strip_prefix("palpate ") {
        Some(words) if of_cargo => format!("cargo run -- {words}"),
        _ => command.to_owned(),
    }
}

/// Whether `cargo run` started this program, in the folder from which the same can be typed again.
fn is_of_cargo_run() -> bool {
    let program = std::env::args_os().next().map(PathBuf::from);
    std::env::var_os("CARGO").is_some() && program.is_some_and(|path| is_built_here(&path))
}

/// Whether a program was started by a path below this folder, as `cargo run` does for what it has built. `cargo test`
/// sets the same variables, but its tests start the program by its whole path.
fn is_built_here(program: &Path) -> bool {
    program.is_relative() && program.ends_with("palpate") && program.components().count() > 1
}

/// A word of a command line; in single quotes if the shell would read it otherwise.
pub fn word(text: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "-_./:=,@+%".contains(c);
    match !text.is_empty() && text.chars().all(is_plain) {
        true => text.to_owned(),
        false => format!("'{}'", text.replace('\'', r"'\''")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_name_the_service_and_the_folder_as_they_were_typed() {
        let at = At {
            url: Some("http://rig:8080".into()),
            data: Some("my data".into()),
            ..At::default()
        };
        let next = Next::of(&at)
            .same_command("again", "resumes it")
            .suggest("palpate runs", "lists the runs");
        let runs = "palpate runs --url http://rig:8080 --data 'my data'";
        let beside = format!(
            "\nnext:\n  {:<1$}   resumes it\n  {runs}   lists the runs",
            "the same command again",
            runs.len()
        );
        assert_eq!([None, Some(2 + runs.len() + 17)].map(|width| next.text(width)), [&*beside; 2]);
        let below = format!(
            "\nnext:\n  the same command again\n      resumes it\n  {runs}\n      lists the runs"
        );
        assert_eq!(next.text(Some(2 + runs.len() + 16)), below);
        assert_eq!(
            Next::default().suggest("palpate runs", "").text(None),
            "\nnext:\n  palpate runs   "
        );
    }

    #[test]
    fn after_cargo_run_a_command_begins_with_it() {
        assert_eq!(as_typed("palpate show 1", true), "cargo run -- show 1");
        assert_eq!(as_typed("palpate show 1", false), "palpate show 1");
        assert_eq!(as_typed("kill 12", true), "kill 12");
        let is_of_run = |path: &str| is_built_here(Path::new(path));
        assert!(is_of_run("target/debug/palpate") && is_of_run("target/release/palpate"));
        for other in ["/srv/target/debug/palpate", "palpate", "target/debug/deps/palpate-12ab"] {
            assert!(!is_of_run(other), "{other}");
        }
        assert!(!is_of_cargo_run(), "a test is started by another path");
    }

    #[test]
    fn a_word_is_quoted_if_the_shell_would_read_it_otherwise() {
        assert_eq!(word("/srv/palpate"), "/srv/palpate");
        assert_eq!(word("it's"), r"'it'\''s'");
        assert_eq!(word(""), "''");
    }
}
