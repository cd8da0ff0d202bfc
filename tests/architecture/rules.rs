//! The rules: each is a function from files to findings in words.
//! PURE. Uses: `source`. Never: the disk.

use std::collections::BTreeSet;
use std::path::Path;

use super::flow::{ARROWS, CHAPTERS, SHELVES, VOCABULARY};
use super::source::{File, below, code, has_word, is_name};

/// Crates and macros of the command line, of HTTP, of the database and of the terminal.
pub const OUTSIDE: [&str; 13] = [
    "clap",
    "reqwest",
    "axum",
    "hyper",
    "tokio",
    "rusqlite",
    "sqlx",
    "indicatif",
    "print",
    "println",
    "eprint",
    "eprintln",
    "dbg",
];

/// Files of `src/` that put the others together.
pub const WIRING: [&str; 3] = ["lib", "main", "build"];

/// Longest source file, lines. 400 is the aim; this is where it must be cut.
pub const LONGEST: usize = 500;

/// What the sources rely on and did not derive; cited by path and heading.
pub const REFERENCES: &str = "docs/references.md";

/// Crates and modules that do something, or wait for something.
pub const EFFECTS: [&str; 7] =
    ["async", "tokio", "rusqlite", "sqlx", "axum", "reqwest", "tokio_serial"];

/// Where a module stands in the flow; vocabulary stands nowhere.
pub fn rank(module: &str) -> Option<usize> {
    CHAPTERS[1..].iter().flat_map(|(_, modules)| *modules).position(|m| *m == module)
}

/// Imports of `src/` look back along the flow; vocabulary looks at vocabulary.
pub fn forward_imports(files: &[File]) -> Vec<String> {
    let mut findings = Vec::new();
    for file in files {
        let Some(own) = file.module().filter(|own| !WIRING.contains(own)) else { continue };
        let place = rank(own);
        if place.is_none() && !VOCABULARY.contains(&own) {
            findings.push(format!("{}: {own} is neither stage nor vocabulary", file.path));
            continue;
        }
        let bare = code(&file.text, false);
        let mut named = below(&bare, "crate");
        // A chain of `super` as long as the file is deep stands at the crate's root.
        let up = vec!["super"; file.depth()].join("::");
        named.extend(below(&bare, &up));
        // The store fills its crate, and Cargo lets it name no other module of the flow.
        named.retain(|(_, n)| {
            VOCABULARY.contains(&n.as_str()) || rank(n).is_some() && own != "store"
        });
        for (line, name) in named {
            let allowed = match (place, rank(&name)) {
                (Some(own), Some(other)) => other <= own,
                (None, Some(_)) => false,
                (_, None) => true,
            };
            if !allowed {
                findings.push(format!("{}:{line}: {own} may not use crate::{name}", file.path));
            }
        }
    }
    findings
}

/// A folder of the store imports vocabulary, itself and the folders before it in `SHELVES`. The names that
/// `lib.rs` exports belong to callers outside: they would hide from which folder an item comes.
pub fn shelves_out_of_order(files: &[File]) -> Vec<String> {
    let mut findings = Vec::new();
    for file in files.iter().filter(|f| f.is_rust()) {
        let Some(inside) = file.path.strip_prefix("src/store/") else { continue };
        let Some((folder, _)) = inside.split_once('/').filter(|(f, _)| *f != "tests") else {
            continue;
        };
        let Some(own) = SHELVES.iter().position(|shelf| *shelf == folder) else {
            findings.push(format!("{}: {folder} is no folder of the store", file.path));
            continue;
        };
        let bare = code(&file.text, false);
        let mut named = below(&bare, "crate");
        named.extend(below(&bare, &vec!["super"; inside.split('/').count()].join("::")));
        let allowed = |name: &str| VOCABULARY.contains(&name) || SHELVES[..=own].contains(&name);
        let wrong = named.into_iter().filter(|(_, name)| !allowed(name));
        findings.extend(wrong.map(|(line, name)| {
            format!("{}:{line}: store's {folder} may not use crate::{name}", file.path)
        }));
    }
    findings
}

/// Folder of a chapter: the studies are next to `src/`.
pub fn folder(chapter: &str) -> String {
    if chapter == "studies" { chapter.into() } else { format!("src/{chapter}") }
}

/// A chapter's `lib.rs` lists its modules in the order of the flow: it is the table of contents. It
/// alone names other chapters, and its `Cargo.toml` names those that it may use.
pub fn contents_out_of_order(files: &[File]) -> Vec<String> {
    let mut findings = Vec::new();
    for (chapter, modules) in CHAPTERS.iter().filter(|(c, _)| !["store", "cli"].contains(c)) {
        let door = format!("{}/lib.rs", folder(chapter));
        let Some(lib) = files.iter().find(|f| f.path == door) else {
            findings.push(format!("{door} is missing"));
            continue;
        };
        let module = |l: &str| Some(l.strip_prefix("pub mod ")?.strip_suffix(';')?.to_owned());
        let listed: Vec<String> = lib.text.lines().filter_map(module).collect();
        if listed != *modules {
            findings.push(format!("{} lists {listed:?}; the flow is {modules:?}", lib.path));
        }
    }
    let in_a_chapter = |f: &&File| f.path.starts_with("src/") || f.path.starts_with("studies/");
    for file in files.iter().filter(in_a_chapter) {
        let at_the_door = file.path.ends_with("lib.rs") || file.path == "src/main.rs";
        if file.is_rust() && !at_the_door && code(&file.text, false).contains("palpate_") {
            findings.push(format!("{}: names a chapter; its lib.rs does that", file.path));
        }
        for (chapter, allowed) in ARROWS {
            if file.path == format!("{}/Cargo.toml", folder(chapter)) {
                let named = file.text.lines().filter_map(|l| l.strip_prefix("palpate-"));
                let named = named.filter_map(|l| l.split(['.', ' ']).next());
                let wrong = named.filter(|name| !allowed.contains(name));
                findings.extend(wrong.map(|name| format!("{} may not use {name}", file.path)));
            }
        }
    }
    findings
}

/// A study asks its lab and returns values: it knows no command line, no HTTP, no terminal, no files.
pub fn outgoing_studies(files: &[File]) -> Vec<String> {
    let mut findings = Vec::new();
    for file in files.iter().filter(|f| f.path.starts_with("studies/")) {
        if file.is_rust() {
            let bare = code(&file.text, false);
            let words = OUTSIDE.iter().filter(|word| has_word(&bare, word));
            findings.extend(words.map(|word| format!("{} names {word}", file.path)));
            let modules = below(&bare, "std").into_iter().map(|(_, name)| name);
            let modules = modules.filter(|n| ["env", "fs", "io", "net", "process"].contains(&&**n));
            findings.extend(modules.map(|name| format!("{} names std::{name}", file.path)));
        } else if file.path == "studies/Cargo.toml" {
            let name = |line: &str| line.split(['.', ' ']).next().unwrap_or_default().to_owned();
            let named = file.text.lines().map(name).filter(|n| OUTSIDE.contains(&n.as_str()));
            findings.extend(named.map(|name| format!("{} depends on {name}", file.path)));
        }
    }
    findings
}

/// Only the trainer's process learns: nothing else is built with the training library, and no program but
/// the trainer links it. Tests may compare with it.
pub fn training_outside_the_trainer(files: &[File]) -> Vec<String> {
    let mut findings = Vec::new();
    let manifests = files.iter().filter(|f| f.path.ends_with("Cargo.toml"));
    for file in manifests.filter(|f| f.path != "trainer/Cargo.toml") {
        let mut section = "";
        for line in file.text.lines() {
            if line.starts_with('[') {
                section = line;
            }
            let linked = section == "[dependencies]" && line.starts_with("palpate-trainer");
            if linked || line.starts_with("burn") {
                findings.push(format!("{}: {line}: only the trainer trains", file.path));
            }
        }
    }
    findings
}

/// Folders of physics: that of the model, and that of the skins which share nothing with it.
const PHYSICS: [&str; 2] = ["sim-core/", LAMINATE];
const LAMINATE: &str = "virtual-rig/laminate/";

/// Physics: nothing that waits, reads, stores or looks at a clock; and nothing of the model in the skins that
/// it is measured against.
pub fn impure_physics(files: &[File]) -> Vec<String> {
    let mut findings = Vec::new();
    for root in PHYSICS {
        for file in files.iter().filter(|f| f.path.starts_with(root)) {
            if file.path.starts_with(&format!("{root}src/")) && file.is_rust() {
                findings.extend(effects(file, &["fs", "time", "net", "process"]));
            } else if file.path == format!("{root}Cargo.toml") {
                let shares = |line: &str| root == LAMINATE && line.starts_with("sim-core");
                let heavy =
                    |line: &&str| EFFECTS.iter().any(|e| line.starts_with(e)) || shares(line);
                let found = file.text.lines().filter(heavy);
                findings.extend(found.map(|line| format!("{}: depends on {line}", file.path)));
            }
        }
    }
    findings
}

/// The words of `EFFECTS` and the modules of std that a file names.
pub fn effects(file: &File, std_modules: &[&str]) -> Vec<String> {
    let bare = code(&file.text, false);
    let words = EFFECTS.iter().filter(|word| has_word(&bare, word)).map(|w| w.to_string());
    let named = below(&bare, "std").into_iter().map(|(_, name)| name);
    let modules = named.filter(|n| std_modules.contains(&n.as_str())).map(|n| format!("std::{n}"));
    words.chain(modules).map(|what| format!("{} names {what}", file.path)).collect()
}

/// The schedule, and whatever calls itself PURE, neither waits nor touches files or sockets.
pub fn impure_where_pure(files: &[File]) -> Vec<String> {
    let mut findings = Vec::new();
    for file in files.iter().filter(|f| f.is_rust()) {
        if file.path.starts_with("src/bench/schedule/") {
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
pub fn entangled_stand_in(files: &[File]) -> Vec<String> {
    let mut findings = Vec::new();
    for file in files {
        let path = &file.path;
        if path.starts_with("virtual-rig/") && file.is_rust() {
            let with_strings = code(&file.text, true);
            let a_chapter = code(&file.text, false).contains("palpate_");
            let the_crate = !below(&with_strings, "palpate").is_empty();
            if a_chapter || the_crate || with_strings.contains("../src/") {
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
pub fn headless_or_long(files: &[File]) -> Vec<String> {
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
pub fn faceless_folders(files: &[File]) -> Vec<String> {
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
        .filter(|folder| {
            let face = |name: &str| paths.contains(format!("{folder}/{name}").as_str());
            !face("mod.rs") && !face("lib.rs")
        })
        .map(|folder| format!("{folder}: several files and no mod.rs"))
        .collect()
}

/// No file names a path of the machine that it was written on.
pub fn machine_paths(files: &[File]) -> Vec<String> {
    let machine = ["/work", "/root"].map(|folder| format!("{folder}/"));
    let names_one = |line: &str| machine.iter().any(|path| line.contains(path));
    let places = |f: &File| -> Vec<String> {
        let lines = f.text.lines().enumerate().filter(|(_, line)| names_one(line));
        lines.map(|(i, line)| format!("{}:{}: {}", f.path, i + 1, line.trim())).collect()
    };
    files.iter().flat_map(places).collect()
}

/// A link between documents leads somewhere.
pub fn broken_links(files: &[File], exists: impl Fn(&Path) -> bool) -> Vec<String> {
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
pub fn dead_citations(files: &[File]) -> Vec<String> {
    let exempt =
        |f: &&File| f.path.starts_with("migrations/0") || f.path == "tests/architecture/main.rs";
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
