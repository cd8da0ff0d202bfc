//! An error as people read it: a value in a file with its line under a caret, everything else as a sentence;
//! and the same error as JSON for scripts.
//! Uses: annotate-snippets, clap, `carried`, `locate`, `near`, `output`. Never: standard output; a text that controls
//! the terminal.

use std::io::{self, IsTerminal, Read};

use annotate_snippets::{AnnotationKind, Group, Level, Renderer, Snippet};
use clap::Subcommand;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use serde_json::{Value, json};

use super::Command;
use super::error::CliError;
use super::output::{Output, error_drawn, error_width, no_color, shown, wrapped};
use crate::carried::{self, EXPERIMENTS};
use crate::locate::locate;
use crate::near::nearest;
use crate::plain::{escaped, in_plain_words};
use crate::problem::{Place, Problem};

/// Largest file that is read again for its lines, bytes.
const FILE_MAX_BYTES: u64 = 1 << 20;
/// Words of Rust's parsers for a value of an option, and what the value must be.
const PARSERS: [(&str, &str); 6] = [
    ("invalid digit found in string", "must be a whole number, 0 or more"),
    ("cannot parse integer from empty string", "must be a whole number, 0 or more"),
    ("number too large to fit in target type", "must be a smaller number"),
    ("invalid float literal", "must be a number"),
    ("cannot parse float from empty string", "must be a number"),
    ("invalid socket address syntax", "must be an address with a port, as 127.0.0.1:8080"),
];

/// Prints an error on standard error: drawn, or as one line of JSON.
pub fn report(error: &CliError, output: Output) {
    if output == Output::Json {
        return error_drawn(body(error));
    }
    let renderer = if is_coloured() { Renderer::styled() } else { Renderer::plain() };
    error_drawn(drawn(error, &renderer, error_width()));
}

/// Whether standard error shows colours: it is a terminal, and they are wanted.
fn is_coloured() -> bool {
    !no_color() && io::stderr().is_terminal()
}

/// Prints an error of the command line itself on standard error: as text, or as one line of JSON.
pub fn report_usage(error: &clap::Error, output: Output) {
    let rendered = error.render();
    if output == Output::Json {
        let words = in_our_words(error, rendered.to_string());
        let detail = words.trim().trim_start_matches("error: ");
        return error_drawn(json!({ "type": "about:blank", "title": "invalid input",
            "exit_code": 2, "detail": shown(detail) }));
    }
    let words = if is_coloured() { rendered.ansi().to_string() } else { rendered.to_string() };
    error_drawn(in_our_words(error, words).trim_end());
}

/// The text of an error of the command line with limits as in files, not in the words of Rust.
fn in_our_words(error: &clap::Error, text: String) -> String {
    let text = PARSERS.iter().fold(text, |text, (theirs, ours)| text.replace(theirs, ours));
    let text = with_tip(error, text);
    let Some(ContextValue::String(value)) = error.get(ContextKind::InvalidValue) else {
        return text;
    };
    match text.split_once(&format!("{value} is not in ")) {
        Some((before, range)) => {
            format!("{before}must be from {}", range.replacen("..=", " to ", 1))
        }
        None => text,
    }
}

/// The text of an error; of an unknown command or option with those that were probably meant, if the parser cannot know
/// them.
fn with_tip(error: &clap::Error, text: String) -> String {
    if let Some(option) = option_meant(error) {
        return in_place_of_tips(error, &text, &option);
    }
    let unknown = match error.get(ContextKind::InvalidSubcommand) {
        Some(ContextValue::String(word)) if error.kind() == ErrorKind::InvalidSubcommand => word,
        _ => return text,
    };
    let Some(meant) = meant_by(unknown) else { return text };
    let is_followed = error.get(ContextKind::SuggestedSubcommand).is_some();
    let end = if is_followed { "\n" } else { "\n\n" };
    text.replacen("\n\n", &format!("\n\n  tip: did you mean {meant}?{end}"), 1)
}

/// The text of an error with a proposal in place of the parser's: to pass the option as a value.
fn in_place_of_tips(error: &clap::Error, text: &str, option: &str) -> String {
    let (first, mut rest) = text.split_once("\n\n").unwrap_or((text, ""));
    if error.get(ContextKind::Suggested).is_some() {
        rest = rest.split_once("\n\n").map_or(rest, |(_, rest)| rest);
    }
    format!("{first}\n\n  tip: did you mean '--{option}'?\n\n{rest}")
}

/// Option that was probably meant by one that the command of the error does not have, if the parser proposes none: its
/// measure does not find two swapped letters of three.
fn option_meant(error: &clap::Error) -> Option<String> {
    let is_open = error.kind() == ErrorKind::UnknownArgument
        && error.get(ContextKind::SuggestedArg).is_none();
    let (Some(ContextValue::String(typed)), Some(ContextValue::StyledStr(usage))) =
        (error.get(ContextKind::InvalidArg), error.get(ContextKind::Usage))
    else {
        return None;
    };
    let typed = typed.strip_prefix("--").filter(|_| is_open)?;
    let mut command = &Command::augment_subcommands(clap::Command::new("palpate"));
    // `Usage: palpate COMMAND ..`
    for word in usage.to_string().split_whitespace().skip(2) {
        let Some(inner) = command.find_subcommand(word) else { break };
        command = inner;
    }
    let options = command.get_arguments().filter(|option| !option.is_hide_set());
    nearest(typed, options.filter_map(clap::Arg::get_long)).map(str::to_owned)
}

/// Commands that were probably meant by a word that is none: `run` of a carried experiment, and the groups of commands
/// that have one of this name.
fn meant_by(word: &str) -> Option<String> {
    let run = carried::text(EXPERIMENTS, word).map(|_| format!("`palpate run {word}`"));
    let all = Command::augment_subcommands(clap::Command::new("palpate"));
    let groups = all.get_subcommands().filter(|group| group.find_subcommand(word).is_some());
    let commands = groups.map(|group| format!("`palpate {} {word}`", group.get_name()));
    let found: Vec<String> = run.into_iter().chain(commands).collect();
    (!found.is_empty()).then(|| found.join(" or "))
}

/// An error as a problem body (RFC 9457), with the exit code of the command.
fn body(error: &CliError) -> Value {
    let code = error.code();
    let title = if code == 2 { "invalid input" } else { "failed" };
    let mut body = json!({ "type": "about:blank", "title": title,
        "detail": in_plain_words(&error.to_string()), "exit_code": code });
    if let CliError::Refused { status, .. } = error {
        body["status"] = (*status).into();
    }
    if let CliError::Problems(problems) = error {
        let located = problems.iter().map(|problem| match in_file(problem) {
            Some(Line { at, .. }) => problem.clone().at(Some(at)),
            None => problem.clone(),
        });
        body["errors"] = json!(located.collect::<Vec<_>>());
    }
    body
}

fn drawn(error: &CliError, renderer: &Renderer, width: Option<usize>) -> String {
    let sentence = |words: &str| match width {
        // Behind `error: `.
        Some(width) => titled(&wrapped(words, width.saturating_sub(8).max(40)), renderer),
        None => titled(words, renderer),
    };
    let CliError::Problems(problems) = error else {
        return sentence(&in_plain_words(&error.to_string()));
    };
    let all = problems.iter().map(|problem| match in_file(problem) {
        Some(line) => line.draw(problem, renderer),
        None => sentence(&in_plain_words(&without_line(problem))),
    });
    all.collect::<Vec<_>>().join("\n")
}

/// A problem that is not drawn: an option or a request needs no name, a missing key no value.
fn without_line(problem: &Problem) -> String {
    let Problem { file, key, value, limit, .. } = problem;
    match (file.as_str(), is_missing(problem)) {
        (_, true) => format!("{file}: {key} is missing"),
        ("command line" | "request", false) if !key.is_empty() => {
            format!("{key} = {value}: {limit}")
        }
        ("command line" | "request", false) => limit.clone(),
        _ => problem.to_string(),
    }
}

fn is_missing(problem: &Problem) -> bool {
    problem.value == "absent" && problem.limit == "must be given" && !problem.key.is_empty()
}

/// A sentence after `error: `; further lines follow as they are.
fn titled(words: &str, renderer: &Renderer) -> String {
    let words = shown(words);
    let (first, rest) = words.split_once('\n').unwrap_or((&words, ""));
    let title = renderer.render(&[Group::with_title(Level::ERROR.primary_title(first))]);
    if rest.is_empty() { title } else { format!("{title}\n{rest}") }
}

/// The line of a file with an invalid value.
struct Line {
    text: String,
    at: Place,
    /// Whether the place is that of the key, not only of a table around it.
    is_exact: bool,
}

impl Line {
    fn draw(&self, problem: &Problem, renderer: &Renderer) -> String {
        let Problem { key, value, limit, file, .. } = problem;
        let title = match (key.as_str(), self.is_exact) {
            ("", _) => limit.clone(),
            (key, _) if is_missing(problem) => format!("{key} is missing"),
            (key, true) => format!("{key}: {limit}"),
            (key, false) => format!("{key} = {value}: {limit}"),
        };
        let title = shown(title);
        let text = escaped(&self.text);
        let byte = |chars: usize| text.char_indices().nth(chars).map_or(text.len(), |(at, _)| at);
        let start = self.at.column.saturating_sub(1) as usize;
        let span = match text.len() == self.text.len() {
            true => byte(start)..byte(start + self.at.length as usize),
            false => 0..text.len(),
        };
        let snippet = Snippet::source(text.as_ref())
            .path(escaped(file).into_owned())
            .line_start(self.at.line as usize)
            .annotation(AnnotationKind::Primary.span(span));
        renderer.render(&[Level::ERROR.primary_title(title).element(snippet)])
    }
}

/// The line of a problem with a file on this machine, or with one that the program carries.
fn in_file(problem: &Problem) -> Option<Line> {
    let text = text_of(&problem.file)?;
    let (at, is_exact) = match problem.at {
        Some(at) => (at, problem.value != "absent"),
        None if problem.key.is_empty() => return None,
        None => {
            let found = locate(&text, &problem.key)?;
            let is_unknown = problem.limit.starts_with("unknown key");
            (if is_unknown { found.name } else { found.place }, found.is_exact)
        }
    };
    let line = text.lines().nth(at.line.saturating_sub(1) as usize)?.to_owned();
    Some(Line { text: line, at, is_exact })
}

fn text_of(file: &str) -> Option<String> {
    if let Some(text) = super::files::carried_text(file) {
        return Some(text.to_owned());
    }
    let opened = std::fs::File::open(file).ok()?;
    if !opened.metadata().is_ok_and(|found| found.is_file()) {
        return None;
    }
    let mut text = String::new();
    opened.take(FILE_MAX_BYTES).read_to_string(&mut text).ok()?;
    Some(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The answer to a command line that is none.
    fn answer(line: &str) -> String {
        let all = Command::augment_subcommands(clap::Command::new("palpate"));
        let words = format!("palpate {line}");
        let error = all.try_get_matches_from(words.split_whitespace()).unwrap_err();
        let text = error.render().to_string();
        in_our_words(&error, text)
    }

    #[test]
    fn an_unknown_option_is_answered_with_the_one_that_was_meant() {
        for line in ["run quickstart --rgi x", "plan quickstart --rgi x", "serve --rgi=x"] {
            let words = answer(line);
            let first = "error: unexpected argument '--rgi' found\n\n  tip: did you mean '--rig'?\n\nUsage: ";
            assert!(words.starts_with(first), "{line}: {words}");
        }
        let words = answer("run quickstart --spede 2");
        assert!(words.contains("a similar argument exists: '--speed'"), "{words}");
        assert!(!words.contains("did you mean"), "{words}");
        assert!(!answer("plan quickstart --xyzzy").contains("did you mean"));
    }

    #[test]
    fn an_error_for_scripts_has_its_values_and_exit_code() {
        let body = body(&CliError::argument("--speed", 0, "must be from 0.01 to 2000"));
        assert_eq!((&body["exit_code"], &body["title"]), (&json!(2), &json!("invalid input")));
        assert_eq!(body["errors"][0]["key"], "--speed");
        assert!(body["errors"][0].get("at").is_none());
    }
}
