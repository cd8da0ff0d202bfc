//! Phrases that `docs/style.md` forbids and that are wrong in every sentence.
//! Uses: std alone. Never: a word with a literal use, such as `lies` or `stands`.

use super::source::{File, is_name};

/// Forbidden phrases, in lower case.
pub const PHRASES: [&str; 16] = [
    "so many",
    "of its own",
    "of their own",
    "goes on",
    "gone on",
    "went on",
    "befall",
    "befalls",
    "befallen",
    "whom",
    "anew",
    "whoever",
    "wish",
    "wishes",
    "wished",
    "wishing",
];

/// Ends of the names of the files that people read.
const READ: [&str; 8] = [".rs", ".md", ".py", ".toml", ".html", ".js", ".css", ".yaml"];

/// No comment, text or name in a source, a page, a file of settings or a document has a forbidden phrase, across a
/// line break neither.
///
/// Not checked: the page that lists the phrases, this folder, which makes them up, foreign files, and migrations, which
/// never change.
pub fn forbidden_phrases(files: &[File]) -> Vec<String> {
    let is_prose = |f: &&File| READ.iter().any(|end| f.path.ends_with(end));
    let is_exempt = |f: &&File| {
        let page = f.path == "docs/style.md" || f.path == "THIRD_PARTY.md";
        page || f.path.starts_with("tests/architecture/") || f.path.contains("vendor/")
    };
    files.iter().filter(|f| is_prose(f) && !is_exempt(f)).flat_map(found).collect()
}

fn found(file: &File) -> Vec<String> {
    let (text, starts) = joined(&file.text);
    let mut findings: Vec<(usize, &str)> = Vec::new();
    for phrase in PHRASES {
        let whole = |at: &usize| {
            !text[..*at].ends_with(is_name) && !text[at + phrase.len()..].starts_with(is_name)
        };
        let places = text.match_indices(phrase).map(|(at, _)| at).filter(whole);
        findings.extend(places.map(|at| (starts.partition_point(|start| *start <= at), phrase)));
    }
    findings.sort_unstable();
    let shown = |(line, phrase)| format!("{}:{line}: \"{phrase}\", see docs/style.md", file.path);
    findings.into_iter().map(shown).collect()
}

/// A text in lower case with its lines joined by spaces, paragraphs apart, without the marks of comments;
/// and where each line starts in it.
fn joined(text: &str) -> (String, Vec<usize>) {
    let (mut joined, mut starts) = (String::with_capacity(text.len()), Vec::new());
    for line in text.lines() {
        starts.push(joined.len());
        let bare = line.trim_start().trim_start_matches(['/', '!', '*', '>', '#']);
        for word in bare.trim_end_matches('\\').split_whitespace() {
            joined.push_str(&word.to_lowercase());
            joined.push(' ');
        }
        if joined.len() == starts[starts.len() - 1] {
            joined.push('\n');
        }
    }
    (joined, starts)
}
