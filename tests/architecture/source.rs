//! The checkout as text files, and Rust source without its comments and strings.
//! Uses: std alone. Never: git, a rule.

use std::fs;
use std::path::Path;

use super::flow::ARROWS;

/// Never looked into, in addition to what `.gitignore` names at the root: history, output, data.
pub const SKIPPED: [&str; 3] = [".git", "target", "palpate-data"];

/// A text file, by its path from the root.
pub struct File {
    pub path: String,
    pub text: String,
}

impl File {
    pub fn is_rust(&self) -> bool {
        self.path.ends_with(".rs")
    }

    /// The chapter of `src/` that it belongs to, or the studies, and its path in there; of the root's
    /// crate the chapter is empty.
    pub fn chapter(&self) -> Option<(&str, &str)> {
        if let Some(inside) = self.path.strip_prefix("studies/") {
            return self.is_rust().then_some(("studies", inside));
        }
        let inside = self.path.strip_prefix("src/").filter(|_| self.is_rust())?;
        let first = inside.split_once('/');
        Some(
            first.filter(|(c, _)| ARROWS.iter().any(|(name, _)| name == c)).unwrap_or(("", inside)),
        )
    }

    /// The module of the flow that it belongs to, or the wiring.
    pub fn module(&self) -> Option<&str> {
        let (chapter, inside) = self.chapter()?;
        let name = inside.split('/').next().unwrap_or(inside).trim_end_matches(".rs");
        Some(if chapter == "store" && name != "build" { "store" } else { name })
    }

    /// Modules between the crate's root and its items: 2 for `src/bench/rig/axis.rs`.
    pub fn depth(&self) -> usize {
        let inside = self.chapter().map_or(self.path.as_str(), |(_, inside)| inside);
        inside.trim_end_matches("/mod.rs").split('/').count()
    }

    /// Its first comment.
    pub fn head(&self) -> String {
        self.text.lines().take_while(|line| line.starts_with("//!")).collect()
    }
}

/// Every text file of the checkout.
pub fn checkout() -> Vec<File> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let ignored = fs::read_to_string(root.join(".gitignore")).expect(".gitignore can be read");
    let at_root: Vec<String> =
        ignored.lines().filter_map(|line| line.strip_prefix('/')).map(str::to_owned).collect();
    let mut files = Vec::new();
    walk(root, root, &at_root, &mut files);
    assert!(files.iter().filter(|f| f.is_rust()).count() > 50, "the walk finds the source");
    files
}

pub fn walk(root: &Path, folder: &Path, ignored: &[String], files: &mut Vec<File>) {
    for entry in fs::read_dir(folder).expect("a folder of the checkout can be listed") {
        let path = entry.expect("a folder's entry can be read").path();
        let relative = path.strip_prefix(root).expect("the walk stays below the root");
        let relative = relative.to_string_lossy().replace('\\', "/");
        let name = relative.rsplit('/').next().unwrap_or_default();
        if SKIPPED.contains(&name) || ignored.contains(&relative) || path.is_symlink() {
            continue;
        }
        if path.is_dir() {
            walk(root, &path, ignored, files);
        } else if let Ok(text) = fs::read_to_string(&path) {
            files.push(File { path: relative, text });
        }
    }
}

/// Source without its comments; without the insides of its strings too, unless `strings`.
/// Line breaks stay, so that a place in it is a place in the file.
pub fn code(text: &str, strings: bool) -> String {
    let chars: Vec<char> = text.chars().collect();
    let at = |i: usize| chars.get(i).copied().unwrap_or('\0');
    let (mut kept, mut i) = (String::with_capacity(text.len()), 0);
    while i < chars.len() {
        let start = i;
        let raw = at(i) == 'r' && (i == 0 || !is_name(at(i - 1)) || at(i - 1) == 'b');
        let hashes = (i + 1..).take_while(|&j| raw && at(j) == '#').count();
        let shown = if at(i) == '/' && at(i + 1) == '/' {
            i += (i..).take_while(|&j| j < chars.len() && at(j) != '\n').count();
            false
        } else if at(i) == '/' && at(i + 1) == '*' {
            i += 2;
            while i < chars.len() && !(at(i) == '*' && at(i + 1) == '/') {
                i += 1;
            }
            i += 2;
            false
        } else if raw && at(i + 1 + hashes) == '"' {
            i += 2 + hashes;
            while i < chars.len() && !(at(i) == '"' && (1..=hashes).all(|h| at(i + h) == '#')) {
                i += 1;
            }
            i += 1 + hashes;
            strings
        } else if at(i) == '"' {
            i += 1;
            while i < chars.len() && at(i) != '"' {
                i += if at(i) == '\\' { 2 } else { 1 };
            }
            i += 1;
            strings
        } else if at(i) == '\'' && (at(i + 1) == '\\' || at(i + 2) == '\'') {
            i += if at(i + 1) == '\\' { 3 } else { 2 };
            while i < chars.len() && at(i) != '\'' {
                i += 1;
            }
            i += 1;
            strings
        } else {
            i += 1;
            true
        };
        let piece = &chars[start..i.min(chars.len())];
        kept.extend(piece.iter().filter(|&&c| shown || c == '\n'));
        if !shown {
            kept.push(' ');
        }
    }
    kept
}

pub fn is_name(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// Whether a whole word stands in code.
pub fn has_word(code: &str, word: &str) -> bool {
    code.match_indices(word).any(|(at, _)| {
        !code[..at].ends_with(is_name) && !code[at + word.len()..].starts_with(is_name)
    })
}

/// What is named directly below `root` (`crate`, `std`), with its line: `root::a`, `root::{a, b}`.
pub fn below(code: &str, root: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for (at, _) in code.match_indices(&format!("{root}::")) {
        if code[..at].ends_with(is_name) {
            continue;
        }
        let line = 1 + code[..at].matches('\n').count();
        let rest = &code[at + root.len() + 2..];
        found.extend(names(rest).into_iter().map(|name| (line, name)));
    }
    found
}

/// The name that code begins with, or those of a group at its outermost level.
pub fn names(code: &str) -> Vec<String> {
    let word = |text: &str| text.trim_start().chars().take_while(|&c| is_name(c)).collect();
    let Some(group) = code.trim_start().strip_prefix('{') else { return vec![word(code)] };
    let mut found: Vec<String> = pieces(group).into_iter().map(word).collect();
    found.retain(|name| !name.is_empty());
    found
}

/// The paths that code begins with: `a::{b, c::D}` begins with two.
pub fn paths(code: &str) -> Vec<Vec<&str>> {
    let code = code.trim_start();
    if let Some(group) = code.strip_prefix('{') {
        return pieces(group).into_iter().flat_map(paths).collect();
    }
    let (name, rest) = code.split_at(code.find(|c: char| !is_name(c)).unwrap_or(code.len()));
    let further = match rest.trim_start().strip_prefix("::") {
        Some(rest) if !name.is_empty() => paths(rest),
        _ => vec![Vec::new()],
    };
    further.into_iter().map(|path| [&[name][..], &path[..]].concat()).collect()
}

/// The pieces of a group, without those of the groups in it; the group is open.
fn pieces(group: &str) -> Vec<&str> {
    let (mut depth, mut start, mut found) = (1, 0, Vec::new());
    for (at, c) in group.char_indices() {
        depth += i32::from(c == '{') - i32::from(c == '}');
        if depth == 0 || depth == 1 && c == ',' {
            found.push(&group[start..at]);
            start = at + 1;
        }
        if depth == 0 {
            break;
        }
    }
    found
}
