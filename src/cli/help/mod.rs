//! The help of all commands: groups, examples, exit codes, and lines that fit a terminal.
//! Uses: clap, `examples.txt`, `output` (the width of the terminal). Never: what a command does; the options (their doc
//! comments state them).

use clap::{Arg, Command};

use super::output::{fitted, terminal_width, wrapped};

/// Examples, one per line, as they are typed: each is shown by the command that it calls. A test parses each.
const EXAMPLES: &str = include_str!("examples.txt");
/// Number of examples of a command that has only those of its subcommands.
const GROUP_EXAMPLES: usize = 4;

/// Commands of the root by what they are for; a test demands each command once.
const GROUPS: &[(&str, &[&str])] = &[
    ("Runs", &["plan", "run", "serve", "queue", "init"]),
    ("The active run", &["status", "attach", "pause", "resume", "stop", "abort", "estop"]),
    ("The morning after", &["runs", "trials", "events", "actions", "show", "report", "diff"]),
    ("Manual trials", &["placement", "confirm", "repeat", "sensor"]),
    ("Rig and people", &["rig", "lock", "key", "metrics"]),
    ("Simulation and calibration", &["simulate", "cluster", "worker", "calibrate"]),
    ("Data", &["dataset", "query", "plot"]),
    ("Nets", &["train", "job", "model", "infer", "live", "evaluate"]),
    ("Virtual rig", &["virtual-rig", "virtual-operator"]),
    ("This program", &["vocabulary", "completions", "man"]),
];

/// Environment of all commands; a test demands every variable that the program reads.
const ENVIRONMENT: &str = "\
Environment:
  PALPATE_URL, PALPATE_CA          service, and its certificate, as --url and --ca
  PALPATE_KEY, PALPATE_KEY_FILE    API key, or the file that has it in its first line
  PALPATE_DATA                     folder of the database, as --data
  PALPATE_LOG, PALPATE_LOG_FORMAT, PALPATE_LOG_FILE
                                   level, format and file of the log, as --log and its like
  PALPATE_TRAINER, PALPATE_QUERY   programs that a service starts for trainings and for queries
  PALPATE_WORKER, PALPATE_PROGRAM  program of `worker`, and the palpate that it starts for chunks
  PALPATE_QUEUE, PALPATE_QUEUE_FILE, PALPATE_STORE, PALPATE_STORE_FILE
                                   queue and store of bulk work, for `serve` and `worker`
  NO_COLOR                         no colours, if it is not empty";

/// Exit codes of all commands, as in `docs/commands.md`.
pub const EXIT_CODES: &str = "\
Exit codes:
  0  success
  1  failed: the cause is on standard error; a run was stopped, aborted or has failed
  2  invalid input: a file, an option or a value; nothing was started or changed
With --json an error is one line of JSON on standard error: title, detail, exit_code and errors,
each with file, key, value, limit and, if known, its place.";

/// Columns of a help on a wide terminal, and without one.
pub const WIDTH: usize = 100;
/// Columns of a help on a narrower terminal.
const NARROWEST: usize = 60;
/// Indentation of a help below its option.
const BELOW: usize = 10;
/// Widest column of options with their helps next to them.
const SIDE: usize = 42;
/// Start and end of a heading on a terminal; clap removes them elsewhere.
const HEADING: [&str; 2] = ["\u{1b}[1m\u{1b}[4m", "\u{1b}[0m"];

/// Columns of a help on the terminal behind standard output.
pub fn width() -> usize {
    terminal_width().unwrap_or(WIDTH).clamp(NARROWEST, WIDTH)
}

/// Completes the command line: what it prints as help, for every command. `width`: columns of its lines.
pub fn complete(mut root: Command, width: usize) -> Command {
    // Options that hold for subcommands, too, reach them here.
    root.build();
    let groups = groups(&root, width);
    let after = format!("{ENVIRONMENT}\n\n{EXIT_CODES}");
    let root = root.after_help(fitted(&after, Some(width)).into_owned());
    let template = format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{groups}{}\n{{options}}{{after-help}}",
        heading("Options")
    );
    tidy(root, "", width).help_template(template)
}

/// The commands in their groups, as text.
fn groups(root: &Command, width: usize) -> String {
    let mut text = String::new();
    for (name, commands) in GROUPS {
        text += &format!("{}\n", heading(name));
        for command in commands.iter().filter_map(|name| root.find_subcommand(name)) {
            let about = command.get_about().map(ToString::to_string).unwrap_or_default();
            let about = wrapped(&about, width - 20).replace('\n', &format!("\n{:20}", ""));
            text += &format!("  {:<16}  {about}\n", command.get_name());
        }
        text.push('\n');
    }
    text
}

fn heading(name: &str) -> String {
    format!("{}{name}:{}", HEADING[0], HEADING[1])
}

/// Adds examples to a command and its subcommands, and wraps their texts.
fn tidy(command: Command, path: &str, width: usize) -> Command {
    let after = command.get_after_help().map(ToString::to_string).unwrap_or_default();
    let mut text = after.trim_end().to_owned();
    let lines = examples(&command, path);
    if !lines.is_empty() {
        if !text.is_empty() {
            text += "\n\n";
        }
        text += &heading("Examples");
        lines.iter().for_each(|line| text += &format!("\n  {line}"));
    }
    let shown = |text: Option<&clap::builder::StyledStr>| text.map(ToString::to_string);
    let (about, long) = (shown(command.get_about()), shown(command.get_long_about()));
    let mut command = command.after_help(text);
    if let Some(about) = about {
        command = command.about(wrapped(&about, width - 22));
    }
    if let Some(long) = long {
        command = command.long_about(wrapped(&long, width));
    }
    let arguments: Vec<&Arg> = command.get_arguments().filter(|arg| !arg.is_hide_set()).collect();
    let column = 8 + arguments.iter().map(|arg| arg.to_string().len()).max().unwrap_or(0);
    let widest = arguments.iter().map(|arg| tail(arg).len()).max().unwrap_or(0);
    let beside = column <= SIDE && widest + column < width;
    let room = if beside { width - column } else { width - BELOW };
    command = command.next_line_help(!beside).mut_args(|arg| {
        let help = shown(arg.get_help()).unwrap_or_default();
        let long = shown(arg.get_long_help()).unwrap_or_else(|| help.clone());
        let short = with_room(wrapped(&help, room), tail(&arg).len(), room);
        arg.help(short).long_help(wrapped(&long, width - BELOW))
    });
    command.mut_subcommands(|inner| {
        let path = format!("{path} {}", inner.get_name());
        tidy(inner, path.trim_start(), width)
    })
}

/// The examples that call a command, or else the first ones of its subcommands. `path`: its words after `palpate`.
fn examples(command: &Command, path: &str) -> Vec<&'static str> {
    let below = EXAMPLES.lines().filter_map(|line| {
        // What is piped into the command is in front of it.
        let typed = line.rsplit(" | ").next()?.strip_prefix("palpate")?.trim_start();
        let rest = typed.strip_prefix(path)?;
        let is_below = path.is_empty() || rest.is_empty() || rest.starts_with(' ');
        is_below.then_some((line, rest.split_whitespace().next().unwrap_or_default()))
    });
    let below: Vec<(&str, &str)> = below.collect();
    let own = below.iter().filter(|(_, next)| command.find_subcommand(next).is_none());
    let own: Vec<&str> = own.map(|(line, _)| *line).collect();
    match own.is_empty() {
        true => below.into_iter().take(GROUP_EXAMPLES).map(|(line, _)| line).collect(),
        false => own,
    }
}

/// What clap writes behind a help: default and values.
fn tail(arg: &Arg) -> String {
    let takes = arg.get_action().takes_values();
    let defaults = arg.get_default_values().iter().map(|value| value.to_string_lossy());
    let default = defaults.collect::<Vec<_>>().join(" ");
    let values = arg.get_possible_values();
    let values: Vec<&str> =
        values.iter().filter(|v| !v.is_hide_set()).map(|v| v.get_name()).collect();
    let mut parts = Vec::new();
    if takes && !default.is_empty() && !arg.is_hide_default_value_set() {
        parts.push(format!("[default: {default}]"));
    }
    if takes && !values.is_empty() && !arg.is_hide_possible_values_set() {
        parts.push(format!("[possible values: {}]", values.join(", ")));
    }
    parts.join(" ")
}

/// The text, ended so that `more` characters after it fit the width.
fn with_room(text: String, more: usize, width: usize) -> String {
    let last = text.lines().last().unwrap_or_default().chars().count();
    if more == 0 || last + 1 + more <= width { text } else { text + "\n" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_default_that_has_no_room_is_in_the_next_line() {
        assert_eq!(with_room("one".into(), 4, 7), "one\n");
        assert_eq!(with_room("one".into(), 3, 7), "one");
    }

    #[test]
    fn the_exit_codes_are_in_the_manual() {
        let manual = include_str!("../../../docs/commands.md");
        for line in EXIT_CODES.lines().filter(|line| line.starts_with("  ")) {
            let (code, words) = line.trim().split_once("  ").unwrap();
            assert!(manual.contains(&format!("| {code} | {words} |")), "docs/commands.md: {line}");
        }
    }
}
