//! The palpate binary: reads the command line, sets up the log, hands over.
//! Uses: `palpate::cli`, and as the only one `virtual_rig`, which it runs as a separate process.
//! Never: anything else.

// The macros of std that print panic on a closed pipe.
#![deny(clippy::print_stdout, clippy::print_stderr)]

use std::fmt::Display;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{ArgMatches, Args, CommandFactory, FromArgMatches, Parser, Subcommand};
use clap_complete::Shell;
use palpate::cli;
use virtual_rig::{OperatorArgs, RigArgs, RigOptions, RunError, operator_main, rig_main};

/// Presses a tactile robot skin with a rig, trains models on the measured trials, and estimates position and
/// force of contacts.
///
/// Start with `palpate run quickstart`: without a rig it starts a virtual one.
#[derive(Debug, Parser)]
#[command(name = "palpate", version = env!("PALPATE_VERSION"), propagate_version = true)]
struct CommandLine {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    log: cli::log::LogArgs,
}

#[derive(Debug, Subcommand)]
enum Command {
    #[command(flatten)]
    Service(cli::Command),
    /// Run a virtual rig behind real wires.
    VirtualRig(VirtualRigArgs),
    /// Run the virtual operator, which mounts tips and places weights on a virtual rig.
    VirtualOperator(VirtualOperatorArgs),
    /// Print the completions of a shell.
    ///
    /// For bash: palpate completions bash > ~/.local/share/bash-completion/completions/palpate
    Completions {
        /// The shell.
        shell: Shell,
    },
    /// Write the manual pages, one for each command.
    ///
    /// For `man palpate`: palpate man ~/.local/share/man/man1
    Man {
        /// Folder to write to.
        #[arg(value_name = "DIR")]
        folder: PathBuf,
    },
}

/// A virtual rig that a person starts; files that are not named are those of the default lab.
#[derive(Debug, Args)]
struct VirtualRigArgs {
    /// Rig file, or the name of a carried one: which devices, on which wires [default: the virtual rig].
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Gap file, or the name of a carried one: how this skin differs from the model [default: gap-a].
    #[arg(long, value_name = "FILE")]
    gap: Option<PathBuf>,
    /// Sensor file, or the name of a carried one: the skin's geometry and materials [default: ert-28].
    #[arg(long, value_name = "FILE")]
    sensor: Option<PathBuf>,
    #[command(flatten)]
    options: RigOptions,
    /// Folder for the default files and the cache [env: PALPATE_DATA] [default: palpate-data].
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
}

/// A virtual operator that a person starts.
#[derive(Debug, Args)]
struct VirtualOperatorArgs {
    /// Sensor file, or the name of a carried one: mistakes are made on its points.
    #[arg(long, value_name = "FILE")]
    sensor: Option<PathBuf>,
    #[command(flatten)]
    options: OperatorArgs,
}

fn main() -> ExitCode {
    palpate::commit::set(option_env!("PALPATE_COMMIT"));
    let (CommandLine { command, log }, output) = match parsed() {
        Ok(parsed) => parsed,
        Err(code) => return code,
    };
    // The log is written out when this value is dropped, at the end.
    let _log = cli::log::start(&log);
    match command {
        Command::Service(command) => cli::main(command, output),
        Command::VirtualOperator(args) => match cli::named_sensor(args.sensor.as_deref()) {
            Ok(sensor) => ended(operator_main(args.options, sensor.as_ref())),
            Err(error) => refused(&error),
        },
        Command::Completions { shell } => {
            let mut text = Vec::new();
            clap_complete::generate(shell, &mut CommandLine::command(), "palpate", &mut text);
            let mut out = io::stdout();
            cli::written(out.write_all(&text).and_then(|()| out.flush()));
            cli::said(ExitCode::SUCCESS, output)
        }
        Command::Man { folder } => ended(write_manual(&folder)),
        Command::VirtualRig(args) => match args.complete() {
            Ok(args) => ended_rig(rig_main(args)),
            Err(error) => refused(&error),
        },
    }
}

/// Reports why a command of the virtual rig does not start.
fn refused(error: &cli::CliError) -> ExitCode {
    cli::report(error, cli::Output::Text);
    error.exit_code()
}

fn write_manual(folder: &Path) -> Result<(), cli::CliError> {
    let write = || {
        std::fs::create_dir_all(folder)?;
        // Before it is completed: a page of each `help` of a command would be a copy.
        let root = CommandLine::command().disable_help_subcommand(true);
        clap_mangen::generate_to(cli::help::complete(root, cli::help::WIDTH), folder)
    };
    write().map_err(cli::CliError::file(folder))
}

/// The command line, and the form in which it prints errors; otherwise the exit code.
fn parsed() -> Result<(CommandLine, cli::Output), ExitCode> {
    let line = cli::help::complete(CommandLine::command(), cli::help::width());
    let matches = line.try_get_matches();
    let read = matches.and_then(|matches| {
        let line = CommandLine::from_arg_matches(&matches)?;
        let json = wants_json(&matches);
        Ok((line, if json { cli::Output::Json } else { cli::Output::Text }))
    });
    read.map_err(|error| {
        let is_help = !error.use_stderr()
            || error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand;
        let json = std::env::args().any(|word| word == "--json");
        match is_help {
            true => {
                cli::written(error.print().and_then(|()| io::stdout().flush()));
            }
            false if json => cli::report_usage(&error, cli::Output::Json),
            false => cli::report_usage(&error, cli::Output::Text),
        }
        cli::said(ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2)), cli::Output::Text)
    })
}

/// Whether the option `--json` of a command or its subcommand was given.
fn wants_json(matches: &ArgMatches) -> bool {
    let here = matches.try_get_one::<bool>("json").ok().flatten().copied().unwrap_or(false);
    here || matches.subcommand().is_some_and(|(_, inner)| wants_json(inner))
}

impl VirtualRigArgs {
    fn complete(self) -> Result<RigArgs, cli::CliError> {
        let data = cli::data_or_default(self.data);
        let named = [self.rig, self.gap, self.sensor];
        let folder = data.join("virtual-rig");
        let mut options = self.options;
        let script = |named: PathBuf| cli::fault_script(&folder, &named);
        options.fault = options.fault.map(script).transpose()?;
        options.cache.get_or_insert_with(|| data.join("cache"));
        let [rig, gap, sensor] = cli::virtual_rig_files(&folder, named)?;
        Ok(RigArgs { rig, gap, sensor, options })
    }
}

/// As [`ended`], with the exit code of invalid input.
fn ended_rig(outcome: Result<(), RunError>) -> ExitCode {
    let is_input = matches!(
        outcome,
        Err(RunError::Rig { .. }
            | RunError::Sensor { .. }
            | RunError::Gap { .. }
            | RunError::Fault { .. }
            | RunError::Electrodes { .. }
            | RunError::Speed(_))
    );
    let code = ended(outcome);
    if is_input { ExitCode::from(2) } else { code }
}

fn ended(outcome: Result<(), impl Display>) -> ExitCode {
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let error = cli::in_plain_words(&error.to_string());
            cli::error_drawn(format_args!("error: {error}"));
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};
    use std::sync::LazyLock;

    use super::*;

    /// As the program completes it. A copy: to complete it takes long without optimisation, and hundreds of lines are
    /// read.
    fn command_line() -> clap::Command {
        static COMPLETE: LazyLock<clap::Command> =
            LazyLock::new(|| cli::help::complete(CommandLine::command(), cli::help::WIDTH));
        COMPLETE.clone()
    }

    #[test]
    fn the_command_line_is_well_formed() {
        command_line().debug_assert();
    }

    #[test]
    fn a_virtual_rig_has_the_skin_of_the_default_lab() {
        let typed = CommandLine::try_parse_from(["palpate", "virtual-rig"]).unwrap();
        let Command::VirtualRig(args) = typed.command else { panic!("another command") };
        assert_eq!(args.options.seed, cli::DEFAULT_SKIN_SEED);
    }

    /// Calls `check` with each command, and its words after `palpate`.
    fn walk(command: &clap::Command, path: &str, check: &mut impl FnMut(&str, &clap::Command)) {
        check(path, command);
        for inner in command.get_subcommands().filter(|inner| inner.get_name() != "help") {
            walk(inner, format!("{path} {}", inner.get_name()).trim_start(), check);
        }
    }

    /// The arguments of a typed command: what single quotes enclose is one.
    fn arguments(typed: &str) -> Vec<&str> {
        let parts = typed.split('\'').enumerate().flat_map(|(n, part)| match n % 2 {
            0 => part.split_whitespace().collect(),
            _ => vec![part],
        });
        parts.collect()
    }

    #[test]
    fn the_help_of_every_command_ends_with_examples_that_can_be_typed() {
        let mut root = command_line();
        root.build();
        let mut count = 0;
        walk(&root, "", &mut |path, command| {
            let help = command.clone().render_long_help().to_string();
            let (_, examples) = help.split_once("Examples:\n").unwrap_or_else(|| {
                panic!("palpate {path}: no example; add it to src/cli/help/examples.txt")
            });
            let lines = examples.lines().map(str::trim).take_while(|line| !line.is_empty());
            let lines: Vec<&str> = lines.collect();
            assert!(!lines.is_empty(), "{path}");
            for line in lines {
                count += 1;
                // What the shell does around the command: pipes and variables of the environment.
                let words =
                    line.split(" | ").find_map(|part| Some(&part[part.find("palpate ")?..]));
                let words = words.unwrap_or_else(|| panic!("{line}: not a command"));
                let read = command_line().try_get_matches_from(arguments(words));
                let error = read.err().map(|error| error.to_string());
                assert_eq!(error, None, "{line}");
                assert!(words.starts_with(format!("palpate {path}").trim()), "{path}: {line}");
            }
        });
        assert!(count > 60, "{count} examples");
    }

    #[test]
    fn a_help_has_no_line_that_a_terminal_of_80_columns_breaks() {
        let help = cli::help::complete(CommandLine::command(), 80).render_long_help().to_string();
        let long: Vec<&str> = help.lines().filter(|line| line.chars().count() > 80).collect();
        assert_eq!(long, [""; 0]);
        assert!(help.contains("PALPATE_DATA") && help.contains("Exit codes:"), "{help}");
    }

    /// The files of a folder and of the folders in it, with their texts.
    fn sources(folder: &Path) -> Vec<(PathBuf, String)> {
        let paths = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        let found = paths.flat_map(|path| match path.is_dir() {
            true => sources(&path),
            false => vec![(path.clone(), std::fs::read_to_string(&path).unwrap())],
        });
        found.collect()
    }

    /// A text for `format!` with a value for each argument.
    fn filled(literal: &str) -> String {
        let parts = literal.split(['{', '}']).enumerate().map(|(n, part)| match (n % 2, part) {
            (0, text) => text,
            (_, "method") => "fast",
            (_, "slot") => "map",
            (_, "task") => "position",
            _ => "1",
        });
        parts.collect()
    }

    #[test]
    fn every_command_that_is_printed_as_the_next_one_can_be_typed() {
        let mut count = 0;
        for (path, text) in sources(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src/cli")) {
            for call in text.split(".suggest(").skip(1).map(str::trim_start) {
                let is_literal = call.starts_with('"') || call.starts_with("format_args!(\"");
                assert!(is_literal, "{}: a command is written at the call: {call}", path.display());
                let typed = filled(call.split('"').nth(1).unwrap_or_default());
                let mut places = vec![""];
                if text.contains("Next::of(") {
                    places.push(" --data d");
                    // It starts a service: none is named.
                    places.extend(
                        (!typed.starts_with("palpate serve")).then_some(" --url http://rig"),
                    );
                }
                for line in places.into_iter().map(|place| format!("{typed}{place}")) {
                    assert!(line.starts_with("palpate "), "{}: {line}", path.display());
                    let read = command_line().try_get_matches_from(arguments(&line));
                    let error = read.err().map(|error| error.to_string());
                    assert_eq!(error, None, "{}: {line}", path.display());
                }
                count += 1;
            }
        }
        assert!(count > 20, "{count} commands");
    }

    #[test]
    fn every_operation_of_the_api_has_a_command_that_can_be_typed() {
        let manual = include_str!("../docs/api-commands.md").lines();
        let rows = manual.filter_map(|line| line.strip_prefix("| `")?.split_once("` | "));
        let rows: BTreeMap<&str, &str> = rows.collect();
        let (mut operations, mut path) = (BTreeSet::new(), "");
        for line in include_str!("../openapi.yaml").lines() {
            let key = line.trim_start().trim_end_matches(':');
            match line.len() - line.trim_start().len() {
                2 if key.starts_with('/') => path = key,
                4 if ["get", "put", "post", "delete"].contains(&key) => {
                    operations.insert(format!("{} {path}", key.to_uppercase()));
                }
                _ => {}
            }
        }
        assert!(operations.len() > 90, "{} operations", operations.len());
        for operation in &operations {
            let row = rows.get(operation.as_str());
            let row = row.unwrap_or_else(|| panic!("docs/api-commands.md lacks {operation}"));
            match row.strip_prefix('`').and_then(|row| row.split('`').next()) {
                None => assert!(row.starts_with("none: "), "{operation}: a command, or why none"),
                Some(command) => {
                    let read = command_line().try_get_matches_from(arguments(command));
                    let error = read.err().map(|error| error.to_string());
                    assert_eq!(error, None, "{operation}: {command}");
                }
            }
        }
        let removed = rows.keys().find(|row| !operations.contains(**row));
        assert_eq!(removed, None, "docs/api-commands.md has what openapi.yaml has not");
    }

    #[test]
    fn no_line_of_a_help_is_wider_than_a_terminal_and_options_state_their_defaults() {
        let mut root = command_line();
        root.build();
        walk(&root, "", &mut |path, command| {
            let pages = [command.clone().render_help(), command.clone().render_long_help()];
            for page in pages.map(|page| page.to_string()) {
                for line in page.lines() {
                    assert!(line.chars().count() <= 100, "palpate {path}: {line}");
                }
            }
            for option in command.get_opts() {
                let help = option.get_help().map(ToString::to_string).unwrap_or_default();
                let name = option.get_long().unwrap_or_default();
                assert!(!help.is_empty(), "palpate {path} --{name}: no help");
                let variables: &[&str] = match name {
                    // Its default differs from that of the other commands.
                    "url" if path == "virtual-operator" => &["PALPATE_KEY"],
                    "url" => &["[env: PALPATE_URL]", "PALPATE_KEY,", "PALPATE_KEY_FILE"],
                    "ca" => &["[env: PALPATE_CA]"],
                    "data" => &["[env: PALPATE_DATA]"],
                    "log" => &["[env: PALPATE_LOG]"],
                    "log-format" => &["[env: PALPATE_LOG_FORMAT]"],
                    "log-file" => &["[env: PALPATE_LOG_FILE]"],
                    "require-key" => &["PALPATE_KEY"],
                    _ => &[],
                };
                let words = help.split_whitespace().collect::<Vec<_>>().join(" ");
                for variable in variables {
                    assert!(words.contains(variable), "palpate {path} --{name}: {words}");
                }
                let values = option.get_value_names().unwrap_or_default();
                let is_model = values.iter().any(|value| value.as_str() == "MODEL");
                let names = !is_model || words.contains("start of the id, or name");
                assert!(names, "palpate {path} --{name}: how a model is named: {words}");
                let hidden = option.is_hide_default_value_set();
                assert!(!hidden || words.contains("[default:"), "palpate {path} --{name}: {words}");
            }
        });
    }

    #[test]
    fn every_variable_of_the_environment_that_is_read_is_on_the_first_page() {
        let page = command_line().render_help().to_string();
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut count = 0;
        for (path, text) in
            ["src", "virtual-rig/src"].into_iter().flat_map(|of| sources(&root.join(of)))
        {
            let is_variable = |word: &&str| {
                let rest = word.strip_prefix("PALPATE_").unwrap_or_default();
                !rest.is_empty() && rest.chars().all(|c| c.is_ascii_uppercase() || c == '_')
            };
            // Those of the build are not of the environment.
            let of_build = |name: &&str| matches!(*name, "PALPATE_COMMIT" | "PALPATE_VERSION");
            for name in text.split('"').filter(is_variable).filter(|name| !of_build(name)) {
                let listed = page.split([' ', ',', '\n']).any(|word| word == name);
                assert!(listed, "{}: {name} is not in ENVIRONMENT, src/cli/help", path.display());
                count += 1;
            }
        }
        assert!(count > 9, "{count} variables");
    }

    #[test]
    fn the_version_states_the_commit() {
        let root = command_line();
        let version = root.get_version().unwrap();
        assert!(version.starts_with(env!("CARGO_PKG_VERSION")), "{version}");
        let commit = option_env!("PALPATE_COMMIT").unwrap_or_default();
        assert!(version.contains(commit), "{version}: {commit}");
    }

    #[test]
    fn every_command_is_in_one_group_of_the_help() {
        let page = command_line().render_help().to_string();
        for command in CommandLine::command().get_subcommands() {
            let row = format!("  {} ", command.get_name());
            let rows = page.lines().filter(|line| line.starts_with(&row)).count();
            assert_eq!(rows, 1, "{}: add it to GROUPS in src/cli/help/mod.rs", command.get_name());
        }
    }

    #[test]
    fn every_shell_gets_completions_and_every_command_a_manual_page() {
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            let mut text = Vec::new();
            clap_complete::generate(shell, &mut CommandLine::command(), "palpate", &mut text);
            assert!(String::from_utf8(text).unwrap().contains("virtual-rig"));
        }
        let temporary = tempfile::tempdir().unwrap();
        let folder = temporary.path().join("man");
        write_manual(&folder).unwrap();
        for page in ["palpate.1", "palpate-run.1", "palpate-rig-home.1"] {
            assert!(std::fs::read_to_string(folder.join(page)).unwrap().contains(".TH"), "{page}");
        }
        for page in ["palpate-help.1", "palpate-help-run.1", "palpate-rig-help.1"] {
            assert!(!folder.join(page).exists(), "{page}");
        }
    }

    #[test]
    fn options_may_stand_behind_the_words_they_belong_to() {
        let parse = |line: &str| CommandLine::try_parse_from(line.split_whitespace());
        for line in [
            "palpate queue add e.toml --json --data d",
            "palpate queue --json",
            "palpate rig jog z -3.5 --url http://127.0.0.1:9",
            "palpate run e.toml --virtual --speed 50 --json -y",
            "palpate virtual-operator --control c --url u --speed 3",
            "palpate virtual-operator --control c --mistakes 0.2 --sensor ert-28",
            "palpate virtual-rig --speed 20",
            "palpate pause --now --why lunch",
        ] {
            assert!(parse(line).is_ok(), "{line}: {:?}", parse(line).err());
        }
        assert!(parse("palpate lock note --clear").is_err());
    }
}
