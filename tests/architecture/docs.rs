//! The rules of documentation comments: a public function that can fail states its errors, and no comment says
//! nothing.
//! PURE. Uses: `source`. Never: the disk.

use super::source::{File, code};

/// Comments that say nothing about any item.
const EMPTY: [&str; 12] = [
    "Why.",
    "When.",
    "Who.",
    "What.",
    "How.",
    "Where.",
    "Its name.",
    "Its value.",
    "Its id.",
    "Its kind.",
    "The name.",
    "The value.",
];

/// A public function outside of tests returns a `Result` and has no section `# Errors`.
///
/// Not checked: an operation of the API, whose `responses` state every error and whose comment is its description.
pub fn silent_errors(files: &[File]) -> Vec<String> {
    files.iter().filter(|f| f.is_rust() && !is_test(&f.path)).flat_map(silent_in).collect()
}

fn silent_in(file: &File) -> Vec<String> {
    let source = file.text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    let bare = code(source, false);
    let lines: Vec<&str> = source.lines().collect();
    let (mut at, mut findings) = (0, Vec::new());
    for (number, line) in bare.split_inclusive('\n').enumerate() {
        let words: Vec<&str> = line.split_whitespace().collect();
        let name = words.iter().position(|word| *word == "fn").and_then(|fn_at| {
            let modifiers = words.get(1..fn_at)?;
            let is_modifier = |word: &&str| ["const", "async", "unsafe"].contains(word);
            let is_public = words[0] == "pub" && modifiers.iter().all(is_modifier);
            words.get(fn_at + 1).filter(|_| is_public)
        });
        if let Some(name) = name
            && can_fail(&bare[at..])
            && !states_errors(&lines[..number])
        {
            let name = name.split(['(', '<']).next().unwrap_or_default();
            findings.push(format!("{}:{}: {name} has no # Errors", file.path, number + 1));
        }
        at += line.len();
    }
    findings
}

/// Whether the function with which code begins returns a `Result`.
fn can_fail(function: &str) -> bool {
    let (mut depth, mut before) = (0, ' ');
    for (at, c) in function.char_indices() {
        match c {
            '(' | '[' | '<' => depth += 1,
            ')' | ']' => depth -= 1,
            '>' if before != '-' => depth -= 1,
            '>' if depth == 0 => {
                let kind = function[at + 1..].split(['<', '{', ';']).next().unwrap_or_default();
                return kind.trim().ends_with("Result");
            }
            '{' | ';' if depth == 0 => return false,
            _ => {}
        }
        before = c;
    }
    false
}

/// Whether the comment and the attributes above an item state its errors, or are those of an operation.
fn states_errors(above: &[&str]) -> bool {
    let mut own = above.iter().rev().take_while(|line| is_above_item(line));
    own.any(|line| line.contains("/// # Errors") || line.contains("#[utoipa::path"))
}

/// Whether a line belongs to the comment or the attributes of the next item, not to another item.
fn is_above_item(line: &str) -> bool {
    let is_other = line.is_empty() || line.ends_with(['{', '}', ';']);
    line.trim_start().starts_with("///") || !is_other
}

fn is_test(path: &str) -> bool {
    path.starts_with("tests/") || path.contains("/tests/") || path.ends_with("tests.rs")
}

/// The only line of a comment says nothing about its item.
pub fn empty_comments(files: &[File]) -> Vec<String> {
    let mut findings = Vec::new();
    for file in files.iter().filter(|f| f.is_rust() && !f.path.starts_with("tests/architecture/")) {
        let comments: Vec<Option<&str>> =
            file.text.lines().map(|line| line.trim().strip_prefix("/// ")).collect();
        for (at, comment) in comments.iter().enumerate() {
            let is_alone = (at == 0 || comments[at - 1].is_none())
                && comments.get(at + 1).is_none_or(Option::is_none);
            if let Some(words) = comment.filter(|words| is_alone && EMPTY.contains(words)) {
                findings.push(format!("{}:{}: \"{words}\" says nothing", file.path, at + 1));
            }
        }
    }
    findings
}
