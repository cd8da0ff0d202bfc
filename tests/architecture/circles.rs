//! Circles of imports: between the files of a crate, and between its modules.
//! PURE. Uses: `source`. Never: the disk.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use super::source::{File, code, is_name, paths};

/// The crates, by their folders.
const CRATES: [&str; 16] = [
    "nets/src/",
    "query/src/",
    "sim-core/src/",
    "src/bench/",
    "src/cli/",
    "src/data/",
    "src/model/",
    "src/service/",
    "src/store/",
    "src/touch/",
    "src/words/",
    "studies/",
    "trainer/src/",
    "virtual-rig/laminate/src/",
    "virtual-rig/src/",
    "worker/src/",
];

/// The files or modules of a crate by their paths in its folder, each with the others that it names.
type Imports = BTreeMap<String, BTreeSet<String>>;

/// Neither the files of a crate import in circles, nor its modules (the files and folders next to its `lib.rs`): each
/// can be read with those that it imports, and nothing that it imports needs it. A file may use the `mod.rs` of its
/// own folder. Tests may import everything. A crate that is not in the list is a finding, too.
pub fn import_circles(files: &[File]) -> Vec<String> {
    let mut findings = unlisted_crates(files);
    for root in CRATES {
        let of_files = imports_of_files(root, files);
        for imports in [imports_of_modules(&of_files), of_files] {
            for start in imports.keys() {
                let Some(circle) = circle_from(start, &imports) else { continue };
                let finding = format!("{root}: {}", circle.join(" -> "));
                if !findings.contains(&finding) {
                    findings.push(finding);
                }
            }
        }
    }
    findings
}

/// Crates whose files no rule would read.
fn unlisted_crates(files: &[File]) -> Vec<String> {
    let folders = files.iter().filter_map(|file| file.path.strip_suffix("/Cargo.toml"));
    let is_listed = |folder: &&str| {
        let roots = [format!("{folder}/"), format!("{folder}/src/")];
        CRATES.iter().any(|listed| roots.iter().any(|root| root == listed))
    };
    let unlisted = folders.filter(|folder| !is_listed(folder));
    unlisted.map(|folder| format!("{folder}: not in CRATES of circles.rs")).collect()
}

fn imports_of_files(root: &str, files: &[File]) -> Imports {
    let mut of_crate: BTreeMap<String, &File> = BTreeMap::new();
    for file in files.iter().filter(|f| f.is_rust()) {
        let Some(inside) = file.path.strip_prefix(root) else { continue };
        let path = inside.trim_end_matches(".rs").trim_end_matches("/mod");
        let is_root = ["lib", "main", "mod"].contains(&path);
        if !is_root && !path.split('/').any(|part| part == "tests") {
            of_crate.insert(path.to_owned(), file);
        }
    }
    let imports = |path: &String, file: &File| {
        let own: Vec<&str> = path.split('/').collect();
        let bare = code(&file.text, false);
        let named = named(without_tests(&bare), root, &own);
        let others = named.iter().filter_map(|path| {
            let mut owners = (1..=path.len()).rev().map(|length| &path[..length]);
            let owner = owners.find(|part| of_crate.contains_key(&part.join("/")))?;
            (!own.starts_with(owner)).then(|| owner.join("/"))
        });
        (path.clone(), others.collect::<BTreeSet<String>>())
    };
    of_crate.iter().map(|(path, &file)| imports(path, file)).collect()
}

fn imports_of_modules(files: &Imports) -> Imports {
    let module = |path: &str| path.split('/').next().unwrap_or(path).to_owned();
    let mut modules = Imports::new();
    for (file, named) in files {
        let own = module(file);
        let others = named.iter().map(|file| module(file)).filter(|other| *other != own);
        modules.entry(own.clone()).or_default().extend(others);
    }
    modules
}

/// Code before the tests at its end.
fn without_tests(code: &str) -> &str {
    let is_tests = |rest: &str| rest.lines().next().is_some_and(|l| l.ends_with("mod tests {"));
    let mut ends = code.match_indices("#[cfg(test)]\n");
    let end = ends.find(|(at, found)| is_tests(&code[at + found.len()..]));
    end.map_or(code, |(at, _)| &code[..at])
}

/// The paths that code of the module `own` names, from the root of its crate. That of `src/cli/` is `crate::cli`.
fn named<'a>(code: &'a str, root: &str, own: &[&'a str]) -> Vec<Vec<&'a str>> {
    let at_root: &[&str] = if root == "src/cli/" { &["cli"] } else { &[] };
    let from_root = |path: Vec<&'a str>, is_use: bool| match path.first() {
        Some(&"crate") => Some(path[1..].strip_prefix(at_root)?.to_vec()),
        Some(&("super" | "self")) => {
            let mut module = own.to_vec();
            for name in path {
                match name {
                    "super" => {
                        module.pop()?;
                    }
                    "self" => {}
                    name => module.push(name),
                }
            }
            Some(module)
        }
        _ => is_use.then(|| [own, &path[..]].concat()),
    };
    let mut found = Vec::new();
    for word in ["crate::", "super::", "self::", "use "] {
        for (at, _) in code.match_indices(word) {
            if code[..at].ends_with(is_name) || code[..at].ends_with("::") {
                continue;
            }
            let is_use = word == "use ";
            let start = if is_use { at + word.len() } else { at };
            found.extend(paths(&code[start..]).into_iter().filter_map(|p| from_root(p, is_use)));
        }
    }
    found
}

/// The shortest way along imports from a module back to itself, through modules later in the
/// alphabet: a circle is found at the first of its modules.
fn circle_from<'a>(start: &'a str, imports: &'a Imports) -> Option<Vec<&'a str>> {
    let mut seen = BTreeSet::new();
    let mut ways = VecDeque::from([vec![start]]);
    while let Some(way) = ways.pop_front() {
        let last = *way.last()?;
        for next in imports.get(last)? {
            let further = [&way[..], &[next.as_str()]].concat();
            if next == start {
                return Some(further);
            }
            if next.as_str() > start && seen.insert(next) {
                ways.push_back(further);
            }
        }
    }
    None
}
