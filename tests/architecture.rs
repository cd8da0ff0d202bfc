//! The shape of the house, read from its source: which way imports point, what stays pure, how a
//! file opens and how long it may be. `docs/architecture.md` says why.
//! Uses: std alone. Never: git (a checkout without history is enough), the network.
//!
//! Each rule is a function from files to findings in words, and each is seen to find something in
//! made-up files that break it.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// Folders of `src/` in the order in which data flows; imports only look back along it.
const STAGES: [&str; 14] = [
    "schedule",
    "rig",
    "campaign",
    "store",
    "calibrate",
    "simulate",
    "dataset",
    "learn",
    "infer",
    "evaluate",
    "jobs",
    "conductor",
    "api",
    "cli",
];

/// Files of `src/` that everything may use and that use nothing but each other.
const VOCABULARY: [&str; 4] = ["clock", "ids", "problem", "syntax"];

/// Files of `src/` that put the others together.
const WIRING: [&str; 2] = ["lib", "main"];

/// Longest source file, lines. 500 is the aim; this is where it must be cut.
const LONGEST: usize = 620;

/// Never looked into, besides what `.gitignore` names at the root: history, output, data.
const SKIPPED: [&str; 3] = [".git", "target", "palpate-data"];

/// What the sources rely on and did not derive; cited by path and heading.
const REFERENCES: &str = "docs/references.md";

/// Crates and modules that do something, or wait for something.
const EFFECTS: [&str; 6] = ["async", "tokio", "sqlx", "axum", "reqwest", "tokio_serial"];

/// A text file, by its path from the root.
struct File {
    path: String,
    text: String,
}

impl File {
    fn is_rust(&self) -> bool {
        self.path.ends_with(".rs")
    }

    /// The stage (or single file) of `src/` that it belongs to.
    fn module(&self) -> Option<&str> {
        let inside = self.path.strip_prefix("src/").filter(|_| self.is_rust())?;
        Some(inside.split('/').next().unwrap_or(inside).trim_end_matches(".rs"))
    }

    /// Modules between the crate's root and its items: 2 for `src/rig/axis.rs`.
    fn depth(&self) -> usize {
        let inside = self.path.strip_prefix("src/").unwrap_or(&self.path);
        inside.trim_end_matches("/mod.rs").split('/').count()
    }

    /// Its first comment.
    fn head(&self) -> String {
        self.text.lines().take_while(|line| line.starts_with("//!")).collect()
    }
}

// ---------------------------------------------------------------- reading

/// Every text file of the checkout.
fn checkout() -> Vec<File> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let ignored = fs::read_to_string(root.join(".gitignore")).expect(".gitignore can be read");
    let at_root: Vec<String> =
        ignored.lines().filter_map(|line| line.strip_prefix('/')).map(str::to_owned).collect();
    let mut files = Vec::new();
    walk(root, root, &at_root, &mut files);
    assert!(files.iter().filter(|f| f.is_rust()).count() > 50, "the walk finds the source");
    files
}

fn walk(root: &Path, folder: &Path, ignored: &[String], files: &mut Vec<File>) {
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
fn code(text: &str, strings: bool) -> String {
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

fn is_name(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// Whether a whole word stands in code.
fn has_word(code: &str, word: &str) -> bool {
    code.match_indices(word).any(|(at, _)| {
        !code[..at].ends_with(is_name) && !code[at + word.len()..].starts_with(is_name)
    })
}

/// What is named directly below `root` (`crate`, `std`), with its line: `root::a`, `root::{a, b}`.
fn below(code: &str, root: &str) -> Vec<(usize, String)> {
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
fn names(code: &str) -> Vec<String> {
    let word = |text: &str| text.trim_start().chars().take_while(|&c| is_name(c)).collect();
    let Some(group) = code.trim_start().strip_prefix('{') else { return vec![word(code)] };
    let (mut depth, mut start, mut found) = (1, 0, Vec::new());
    for (at, c) in group.char_indices() {
        depth += i32::from(c == '{') - i32::from(c == '}');
        if depth == 0 || depth == 1 && c == ',' {
            found.push(word(&group[start..at]));
            start = at + 1;
        }
        if depth == 0 {
            break;
        }
    }
    found.retain(|name: &String| !name.is_empty());
    found
}

// ---------------------------------------------------------------- rules

/// Imports of `src/` look back along the flow; vocabulary looks at vocabulary.
fn forward_imports(files: &[File]) -> Vec<String> {
    let mut findings = Vec::new();
    for file in files {
        let Some(own) = file.module().filter(|own| !WIRING.contains(own)) else { continue };
        let rank = STAGES.iter().position(|&stage| stage == own);
        if rank.is_none() && !VOCABULARY.contains(&own) {
            findings.push(format!("{}: {own} is neither stage nor vocabulary", file.path));
            continue;
        }
        let bare = code(&file.text, false);
        let mut named = below(&bare, "crate");
        // A chain of `super` as long as the file is deep stands at the crate's root.
        let up = vec!["super"; file.depth()].join("::");
        let is_module = |n: &str| STAGES.contains(&n) || VOCABULARY.contains(&n);
        named.extend(below(&bare, &up).into_iter().filter(|(_, n)| is_module(n)));
        for (line, name) in named {
            let back = STAGES.iter().position(|&stage| stage == name);
            let allowed = match (rank, back) {
                (Some(own), Some(other)) => other <= own,
                (None, Some(_)) => false,
                (_, None) => VOCABULARY.contains(&name.as_str()),
            };
            if !allowed {
                let path = &file.path;
                findings.push(format!("{path}:{line}: {own} may not use crate::{name}"));
            }
        }
    }
    findings
}

/// `lib.rs` lists the modules in the order of the flow: it is the table of contents.
fn contents_out_of_order(files: &[File]) -> Vec<String> {
    let Some(lib) = files.iter().find(|f| f.path == "src/lib.rs") else {
        return vec!["src/lib.rs is missing".into()];
    };
    let listed: Vec<&str> = lib
        .text
        .lines()
        .filter_map(|line| line.strip_prefix("pub mod ")?.strip_suffix(';'))
        .collect();
    let modules: BTreeSet<&str> =
        files.iter().filter_map(File::module).filter(|m| !WIRING.contains(m)).collect();
    let order = VOCABULARY.iter().chain(&STAGES).copied();
    let expected: Vec<&str> = order.filter(|m| modules.contains(m)).collect();
    if listed == expected {
        return Vec::new();
    }
    vec![format!("src/lib.rs lists {listed:?}; the flow is {expected:?}")]
}

/// sim-core holds physics: nothing that waits, reads, stores or looks at a clock.
fn impure_physics(files: &[File]) -> Vec<String> {
    let mut findings = Vec::new();
    for file in files.iter().filter(|f| f.path.starts_with("sim-core/")) {
        if file.path.starts_with("sim-core/src/") && file.is_rust() {
            findings.extend(effects(file, &["fs", "time", "net", "process"]));
        } else if file.path == "sim-core/Cargo.toml" {
            let heavy = file.text.lines().filter(|l| EFFECTS.iter().any(|e| l.starts_with(e)));
            findings.extend(heavy.map(|l| format!("sim-core/Cargo.toml: depends on {l}")));
        }
    }
    findings
}

/// The words of `EFFECTS` and the modules of std that a file names.
fn effects(file: &File, std_modules: &[&str]) -> Vec<String> {
    let bare = code(&file.text, false);
    let words = EFFECTS.iter().filter(|word| has_word(&bare, word)).map(|w| w.to_string());
    let named = below(&bare, "std").into_iter().map(|(_, name)| name);
    let modules = named.filter(|n| std_modules.contains(&n.as_str())).map(|n| format!("std::{n}"));
    words.chain(modules).map(|what| format!("{} names {what}", file.path)).collect()
}

/// The schedule, and whatever calls itself PURE, neither waits nor touches files or sockets.
fn impure_where_pure(files: &[File]) -> Vec<String> {
    let mut findings = Vec::new();
    for file in files.iter().filter(|f| f.is_rust()) {
        if file.path.starts_with("src/schedule/") {
            findings.extend(effects(file, &["fs", "net", "process"]));
        } else if file.head().contains("PURE") {
            // An instant that is handed in is a value, even tokio's.
            let values = file.text.replace("tokio::time::Instant", "Instant");
            let file = File { path: file.path.clone(), text: values };
            findings.extend(effects(&file, &["fs", "net", "process"]));
        }
    }
    findings
}

/// The stand-in rig shares no line with the service, and only `main.rs` starts it.
fn entangled_stand_in(files: &[File]) -> Vec<String> {
    let mut findings = Vec::new();
    for file in files {
        let path = &file.path;
        if path.starts_with("virtual-rig/") && file.is_rust() {
            let with_strings = code(&file.text, true);
            if !below(&with_strings, "palpate").is_empty() || with_strings.contains("../src/") {
                findings.push(format!("{path}: the virtual rig uses the service"));
            }
        } else if path == "virtual-rig/Cargo.toml" {
            if file.text.lines().any(|line| line.starts_with("palpate")) {
                findings.push(format!("{path}: the virtual rig depends on the service"));
            }
        } else if file.is_rust() && path != "src/main.rs" && !path.starts_with("tests/") {
            let bare = code(&file.text, false);
            if !below(&bare, "virtual_rig").is_empty() || bare.contains("use virtual_rig") {
                findings.push(format!("{path}: names virtual_rig; only src/main.rs may"));
            }
        }
    }
    findings
}

/// A file opens by saying what it is, and is short enough to hold.
fn headless_or_long(files: &[File]) -> Vec<String> {
    let mut findings = Vec::new();
    for file in files.iter().filter(|f| f.is_rust()) {
        if !file.text.starts_with("//!") {
            findings.push(format!("{}: does not open with //!", file.path));
        }
        let lines = file.text.lines().count();
        if lines > LONGEST {
            findings.push(format!("{}: {lines} lines, at most {LONGEST}", file.path));
        }
    }
    findings
}

/// A folder of source with more than one file has a face.
fn faceless_folders(files: &[File]) -> Vec<String> {
    let in_source = |f: &&File| f.path.contains("src/") && f.is_rust();
    let paths: BTreeSet<&str> = files.iter().filter(in_source).map(|f| f.path.as_str()).collect();
    let folders: BTreeSet<&str> =
        paths.iter().filter_map(|p| Some(p.rsplit_once('/')?.0)).collect();
    let files_in = |folder: &str| {
        paths.iter().filter(|p| p.rsplit_once('/').is_some_and(|(f, _)| f == folder)).count()
    };
    folders
        .into_iter()
        .filter(|folder| !folder.ends_with("src") && files_in(folder) > 1)
        .filter(|folder| !paths.contains(format!("{folder}/mod.rs").as_str()))
        .map(|folder| format!("{folder}: several files and no mod.rs"))
        .collect()
}

/// No file names a path of the machine that it was written on.
fn machine_paths(files: &[File]) -> Vec<String> {
    let machine = ["/work", "/root"].map(|folder| format!("{folder}/"));
    let names_one = |line: &str| machine.iter().any(|path| line.contains(path));
    let places = |f: &File| -> Vec<String> {
        let lines = f.text.lines().enumerate().filter(|(_, line)| names_one(line));
        lines.map(|(i, line)| format!("{}:{}: {}", f.path, i + 1, line.trim())).collect()
    };
    files.iter().flat_map(places).collect()
}

/// A link between documents leads somewhere.
fn broken_links(files: &[File], exists: impl Fn(&Path) -> bool) -> Vec<String> {
    let mut findings = Vec::new();
    for file in files.iter().filter(|f| f.path.ends_with(".md")) {
        let folder = Path::new(&file.path).parent().unwrap_or(Path::new(""));
        for rest in file.text.split("](").skip(1) {
            let target = rest.split([')', '#']).next().unwrap_or_default();
            if !target.is_empty() && !target.contains(':') && !exists(&folder.join(target)) {
                findings.push(format!("{}: links to {target}, which is not there", file.path));
            }
        }
    }
    findings
}

/// A text cites what a checkout holds: documents and decisions that are there, headings of
/// `docs/references.md` (in quotes after its path, on the same line), no issue or law by its number.
/// Not looked at: migrations, which never change, and this file, which makes citations up.
fn dead_citations(files: &[File]) -> Vec<String> {
    let exempt =
        |f: &&File| f.path.starts_with("migrations/0") || f.path == "tests/architecture.rs";
    let is_text = |f: &&File| {
        [".rs", ".toml", ".md", ".sql", ".txt", ".py"].iter().any(|e| f.path.ends_with(e))
    };
    let names: BTreeSet<&str> = files.iter().filter_map(|f| f.path.rsplit('/').next()).collect();
    let headings: BTreeSet<&str> = files
        .iter()
        .filter(|f| f.path == REFERENCES)
        .flat_map(|f| f.text.lines())
        .filter_map(|line| line.strip_prefix("## ").or_else(|| line.strip_prefix("### ")))
        .collect();
    let dead = |line: &str| -> Vec<String> {
        let documents = line.match_indices(".md").filter_map(|(at, end)| {
            let stem = line[..at].rsplit(|c| !is_name(c) && c != '-').next()?;
            let name = format!("{stem}{end}");
            let whole = !stem.is_empty() && !line[at + end.len()..].starts_with(is_name);
            (whole && !names.contains(name.as_str())).then_some(name)
        });
        let cited = line.match_indices(REFERENCES).filter_map(|(at, path)| {
            let rest = line[at + path.len()..].trim_start_matches('`').strip_prefix(',')?;
            let heading = rest.strip_prefix(" \"").and_then(|rest| rest.split('"').next());
            let heading = heading.unwrap_or("no heading in quotes");
            (!headings.contains(heading)).then(|| format!("{path}, {heading}"))
        });
        let decisions = line.match_indices("docs/decisions/").filter_map(|(at, folder)| {
            let number = line[at + folder.len()..].split(|c: char| !c.is_ascii_digit()).next()?;
            let path = format!("{folder}{number}");
            (!files.iter().any(|f| f.path.starts_with(&path))).then_some(path)
        });
        let numbered = line.match_indices(' ').filter_map(|(at, _)| {
            let word = line[..at].rsplit(|c| !is_name(c)).next()?.to_lowercase();
            let next = line[at + 1..].trim_start_matches('#').chars().next()?;
            let counts = ["issue", "issues", "law", "laws"].contains(&word.as_str());
            (counts && next.is_ascii_digit()).then(|| format!("{word} {next}"))
        });
        documents.chain(cited).chain(decisions).chain(numbered).collect()
    };
    let places = |f: &File| -> Vec<String> {
        let lines =
            f.text.lines().enumerate().flat_map(|(i, l)| dead(l).into_iter().map(move |d| (i, d)));
        lines.map(|(i, dead)| format!("{}:{}: cites {dead}", f.path, i + 1)).collect()
    };
    files.iter().filter(|f| is_text(f) && !exempt(f)).flat_map(places).collect()
}

// ---------------------------------------------------------------- the checkout

fn none(findings: Vec<String>) {
    assert!(findings.is_empty(), "\n{}\n", findings.join("\n"));
}

#[test]
fn imports_look_back_along_the_flow() {
    none(forward_imports(&checkout()));
    none(contents_out_of_order(&checkout()));
}

#[test]
fn what_is_called_pure_is_pure() {
    none(impure_physics(&checkout()));
    none(impure_where_pure(&checkout()));
}

#[test]
fn the_stand_in_rig_stands_alone() {
    none(entangled_stand_in(&checkout()));
}

#[test]
fn files_open_with_what_they_are_and_are_short() {
    none(headless_or_long(&checkout()));
    none(faceless_folders(&checkout()));
}

#[test]
fn nothing_names_the_machine_it_was_written_on() {
    none(machine_paths(&checkout()));
}

#[test]
fn links_between_documents_lead_somewhere() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    none(broken_links(&checkout(), |path| root.join(path).exists()));
}

#[test]
fn citations_lead_somewhere() {
    none(dead_citations(&checkout()));
}

// ---------------------------------------------------------------- the rules see what they forbid

fn file(path: &str, text: &str) -> File {
    File { path: path.into(), text: text.into() }
}

#[test]
fn a_forward_import_is_found_however_it_is_written() {
    for text in [
        "use crate::store::Store;",
        "use crate::{clock::Clock, store};",
        "use crate::{\n    rig::{config, traits},\n    store::Store,\n};",
        "fn f() -> crate::store::Store { crate::store::open() }",
        "use super::super::store::Store;",
    ] {
        let found = forward_imports(&[file("src/rig/axis.rs", text)]);
        assert!(!found.is_empty() && found[0].contains("rig may not use crate::store"), "{text}");
    }
    for text in [
        "use crate::schedule::plan::Plan; use crate::rig::traits; use crate::clock::Clock;",
        "/// As [`crate::store`] has it.\nuse super::config;",
        "fn f() { log(\"crate::store\"); let quote = '\"'; /* crate::store */ }",
    ] {
        none(forward_imports(&[file("src/rig/axis.rs", text)]));
    }
    let vocabulary = forward_imports(&[file("src/ids.rs", "use crate::rig::config;")]);
    assert_eq!(vocabulary, ["src/ids.rs:1: ids may not use crate::rig"]);
    let stranger = forward_imports(&[file("src/util/mod.rs", "//! Helpers.")]);
    assert_eq!(stranger, ["src/util/mod.rs: util is neither stage nor vocabulary"]);
}

#[test]
fn a_table_of_contents_out_of_order_is_found() {
    let rest = ["src/clock.rs", "src/schedule/mod.rs", "src/rig/mod.rs"].map(|p| file(p, "//! A."));
    let with = |lib: &str| {
        let mut files = vec![file("src/lib.rs", lib)];
        files.extend(rest.iter().map(|f| file(&f.path, &f.text)));
        contents_out_of_order(&files)
    };
    none(with("pub mod clock;\n\npub mod schedule;\npub mod rig;\n"));
    assert_eq!(with("pub mod clock;\npub mod rig;\npub mod schedule;\n").len(), 1);
    assert_eq!(with("pub mod clock;\npub mod schedule;\n").len(), 1);
}

#[test]
fn effects_in_pure_files_are_found() {
    for text in
        ["use tokio::fs;", "use std::{collections, fs};", "async fn f() {}", "sqlx::query()"]
    {
        assert!(!impure_physics(&[file("sim-core/src/a.rs", text)]).is_empty(), "{text}");
        assert!(!impure_where_pure(&[file("src/schedule/a.rs", text)]).is_empty(), "{text}");
        let claimed = format!("//! A codec.\n//! PURE. Uses: nothing.\n{text}");
        assert!(!impure_where_pure(&[file("src/rig/a.rs", &claimed)]).is_empty(), "{text}");
        none(impure_where_pure(&[file("src/rig/a.rs", text)]));
    }
    assert!(!impure_physics(&[file("sim-core/src/a.rs", "std::time::Instant::now()")]).is_empty());
    assert!(!impure_physics(&[file("sim-core/Cargo.toml", "tokio.workspace = true")]).is_empty());
    none(impure_physics(&[file("sim-core/src/a.rs", "//! Never: async, tokio, std::fs.\n")]));
}

#[test]
fn an_entangled_stand_in_is_found() {
    for (path, text) in [
        ("virtual-rig/src/wire.rs", "use palpate::rig::link::Request;"),
        ("virtual-rig/src/wire.rs", "#[path = \"../../src/rig/words.rs\"] mod words;"),
        ("virtual-rig/Cargo.toml", "palpate = { path = \"..\" }"),
        ("src/cli/run.rs", "use virtual_rig::run::VirtualRig;"),
        ("examples/a.rs", "fn main() { virtual_rig::run() }"),
    ] {
        assert_eq!(entangled_stand_in(&[file(path, text)]).len(), 1, "{path}: {text}");
    }
    none(entangled_stand_in(&[file("src/main.rs", "use virtual_rig::run;")]));
}

#[test]
fn headless_long_and_faceless_files_are_found() {
    assert_eq!(headless_or_long(&[file("tests/it/a.rs", "use std::fs;")]).len(), 1);
    let long = format!("//! A.\n{}", "\n".repeat(LONGEST));
    assert_eq!(headless_or_long(&[file("src/rig/a.rs", &long)]).len(), 1);
    let just_short_enough = &long[..long.len() - 1];
    none(headless_or_long(&[file("src/rig/a.rs", just_short_enough)]));
    let two = [file("src/rig/a.rs", "//! A."), file("src/rig/b.rs", "//! B.")];
    assert_eq!(faceless_folders(&two), ["src/rig: several files and no mod.rs"]);
}

#[test]
fn a_path_of_the_machine_and_a_broken_link_are_found() {
    let text = format!("first line\nsee {}/shared", "/work");
    assert_eq!(machine_paths(&[file("docs/a.md", &text)]).len(), 1);
    let page = [file("docs/a.md", "[b](b.md), [c](../c.md#part), [web](https://example.org)")];
    assert_eq!(broken_links(&page, |path| path.ends_with("b.md")).len(), 1);
}

#[test]
fn a_dead_citation_is_found() {
    let with = |path: &str, text: &str| {
        let references = file(REFERENCES, "# References\n## Devices\n### The AB-12 (RTU)\n");
        dead_citations(&[file(path, text), references, file("docs/decisions/0003-a.md", "")])
    };
    for text in [
        "//! Source: `gone.md` 4.",
        "// `docs/references.md`, \"The AB-13\"",
        "// docs/references.md, Devices",
        "// (`docs/references.md`,",
        "// (`docs/decisions/0004`)",
        "// As issue 12 wants it (Issues #3 and 4).",
        "// Law 1.",
    ] {
        assert!(!with("src/a.rs", text).is_empty(), "{text}");
        assert!(!with("experiments/a.toml", text).is_empty(), "{text}");
        none(with("migrations/0001_a.sql", text));
    }
    let two = with("src/a.rs", "//! A.\n// See gone.md and lost.md.");
    assert_eq!(two, ["src/a.rs:2: cites gone.md", "src/a.rs:2: cites lost.md"]);
    for text in [
        "// (`docs/references.md`, \"The AB-12 (RTU)\"), docs/references.md, \"Devices\".",
        "// `docs/decisions/0003`, docs/decisions/0003-a.md; references.md. An md5, a tissue 4, a.mdx.",
    ] {
        none(with("src/a.rs", text));
    }
}
