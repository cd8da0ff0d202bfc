//! The structure of the source tree: which way imports point, what stays pure, how a
//! file opens, how long it may be, what comments state, and which phrases no text has. `docs/architecture.md` says why.
//! Uses: std alone. Never: git (a checkout without history is enough), the network.
//!
//! Each rule (`rules`, `names`, `docs`, `prose`) is seen to find something in made-up files that break it.

mod circles;
mod docs;
mod flow;
mod names;
mod prose;
mod rules;
mod source;

use std::path::Path;

use circles::import_circles;
use docs::{empty_comments, silent_errors};
use flow::CHAPTERS;
use names::ambiguous_constants;
use prose::{PHRASES, forbidden_phrases};
use rules::{
    LONGEST, REFERENCES, broken_links, contents_out_of_order, dead_citations, entangled_stand_in,
    faceless_folders, folder, forward_imports, headless_or_long, impure_physics, impure_where_pure,
    machine_paths, outgoing_studies, shelves_out_of_order, training_outside_the_trainer,
};
use source::{File, checkout};

// ---------------------------------------------------------------- the checkout

fn none(findings: Vec<String>) {
    assert!(findings.is_empty(), "\n{}\n", findings.join("\n"));
}

#[test]
fn imports_look_back_along_the_flow() {
    none(forward_imports(&checkout()));
    none(contents_out_of_order(&checkout()));
    none(shelves_out_of_order(&checkout()));
}

#[test]
fn files_and_modules_of_a_crate_do_not_import_in_circles() {
    none(import_circles(&checkout()));
}

#[test]
fn what_is_called_pure_is_pure() {
    none(impure_physics(&checkout()));
    none(impure_where_pure(&checkout()));
}

#[test]
fn studies_ask_their_lab_and_return_values() {
    none(outgoing_studies(&checkout()));
}

#[test]
fn only_the_trainer_trains() {
    none(training_outside_the_trainer(&checkout()));
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
fn a_constant_is_named_by_its_use() {
    none(ambiguous_constants(&checkout()));
}

#[test]
fn comments_state_errors_and_say_something() {
    none(silent_errors(&checkout()));
    none(empty_comments(&checkout()));
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

#[test]
fn no_text_has_a_phrase_that_the_style_forbids() {
    none(forbidden_phrases(&checkout()));
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
        let found = forward_imports(&[file("src/bench/rig/axis.rs", text)]);
        assert!(!found.is_empty() && found[0].contains("rig may not use crate::store"), "{text}");
    }
    for text in [
        "use crate::schedule::plan::Plan; use crate::rig::traits; use crate::clock::Clock;",
        "/// As [`crate::store`] has it.\nuse super::config;",
        "fn f() { log(\"crate::store\"); let quote = '\"'; /* crate::store */ }",
    ] {
        none(forward_imports(&[file("src/bench/rig/axis.rs", text)]));
    }
    let vocabulary = forward_imports(&[file("src/words/ids.rs", "use crate::rig::config;")]);
    assert_eq!(vocabulary, ["src/words/ids.rs:1: ids may not use crate::rig"]);
    let stranger = forward_imports(&[file("src/util/mod.rs", "//! Helpers.")]);
    assert_eq!(stranger, ["src/util/mod.rs: util is neither stage nor vocabulary"]);
    none(forward_imports(&[file("studies/maps.rs", "use crate::{budget, evaluate::score};")]));
    let later = forward_imports(&[file("studies/maps.rs", "use super::unseen;")]);
    assert_eq!(later, ["studies/maps.rs:1: maps may not use crate::unseen"]);
}

#[test]
fn a_forward_import_inside_the_store_is_found() {
    for text in ["use crate::lab::twins;", "use crate::{ids, TrialRow};", "super::super::lab::f()"]
    {
        assert_eq!(shelves_out_of_order(&[file("src/store/bench/a.rs", text)]).len(), 1, "{text}");
    }
    for text in ["use crate::table::{a, b}; use crate::ids::RunUid;", "use super::trials;"] {
        none(shelves_out_of_order(&[file("src/store/bench/a.rs", text)]));
        none(shelves_out_of_order(&[file("src/store/tests/a.rs", "use crate::lab::twins;")]));
    }
    assert_eq!(shelves_out_of_order(&[file("src/store/other/a.rs", "")]).len(), 1);
}

#[test]
fn a_table_of_contents_out_of_order_is_found() {
    let with = |path: &str, text: &str| {
        let chapters = CHAPTERS.iter().filter(|(c, _)| !["store", "cli"].contains(c));
        let mut files: Vec<File> = chapters
            .map(|(c, modules)| (format!("{}/lib.rs", folder(c)), modules))
            .filter(|(lib, _)| lib != path)
            .map(|(lib, modules)| {
                let lines: Vec<String> =
                    modules.iter().map(|m| format!("pub mod {m};\n")).collect();
                file(&lib, &lines.concat())
            })
            .collect();
        files.push(file(path, text));
        contents_out_of_order(&files)
    };
    let flow = "pub mod figure;\npub mod calibrate;\npub mod chunk;\npub mod simulate;\n\
        pub mod overlay;\n";
    none(with("src/model/lib.rs", flow));
    assert_eq!(with("src/model/lib.rs", "pub mod simulate;\npub mod calibrate;\n").len(), 1);
    assert_eq!(with("src/model/lib.rs", "pub mod simulate;\n").len(), 1);
    assert_eq!(with("src/model/simulate/a.rs", "use palpate_store::Store;").len(), 1);
    none(with("src/data/Cargo.toml", "palpate-store.workspace = true\n"));
    assert_eq!(with("src/touch/Cargo.toml", "palpate-bench.workspace = true\n").len(), 1);
    assert_eq!(with("src/service/Cargo.toml", "palpate-studies.workspace = true\n").len(), 1);
    assert_eq!(with("studies/Cargo.toml", "palpate-service.workspace = true\n").len(), 1);
    assert_eq!(with("studies/maps.rs", "use palpate_touch::evaluate;").len(), 1);
}

#[test]
fn a_circle_of_imports_is_found() {
    for (root, above) in [("nets/src", "super::super::a::A"), ("sim-core/src", "crate::{a, c}")] {
        let circle = [
            file(&format!("{root}/lib.rs"), "use crate::a::A;"),
            file(&format!("{root}/a.rs"), "//! Uses `crate::c`.\nuse crate::d::D;"),
            file(&format!("{root}/d.rs"), "fn f() -> crate::b::B { crate::b::f() }"),
            file(&format!("{root}/b/mod.rs"), "pub mod inner; use crate::b::inner;"),
            file(&format!("{root}/b/inner.rs"), &format!("use {above};")),
        ];
        let of_modules = format!("{root}/: a -> d -> b -> a");
        let of_files = format!("{root}/: a -> d -> b -> b/inner -> a");
        assert_eq!(import_circles(&circle), [of_modules, of_files]);
        none(import_circles(&circle[..4]));
    }
    let two = [
        file("nets/src/a.rs", "use super::b::B;"),
        file("nets/src/b.rs", "use crate::{a::A, c::C};"),
        file("nets/src/c.rs", "use crate::b;"),
    ];
    assert_eq!(import_circles(&two), ["nets/src/: a -> b -> a", "nets/src/: b -> c -> b"]);
    none(import_circles(&[file("nets/Cargo.toml", ""), file("src/bench/Cargo.toml", "")]));
    let unlisted = import_circles(&[file("src/other/Cargo.toml", "")]);
    assert_eq!(unlisted, ["src/other: not in CRATES of circles.rs"]);
    let through_the_door = |test: &str| {
        [
            file("src/touch/infer/mod.rs", "pub use methods::Method; pub mod methods;"),
            file("src/touch/infer/methods/mod.rs", "mod exact;\npub use exact::{Skin, self};"),
            file("src/touch/infer/methods/exact.rs", "use super::Method; use crate::infer::old;"),
            file(
                "src/touch/infer/old.rs",
                &format!("{test}use super::{{slot, methods::{{Skin}}}};"),
            ),
        ]
    };
    let found = import_circles(&through_the_door(""));
    let circle = "infer/methods -> infer/methods/exact -> infer/old -> infer/methods";
    assert_eq!(found, [format!("src/touch/: {circle}")]);
    none(import_circles(&through_the_door("#[cfg(test)]\npub(super) mod tests {\n")));
    let command = |text| [file("src/cli/ask.rs", text), file("src/cli/run.rs", "use super::ask;")];
    assert_eq!(import_circles(&command("use crate::cli::run;")), ["src/cli/: ask -> run -> ask"]);
    none(import_circles(&command("use crate::run; use super::super::run::Run;")));
}

#[test]
fn effects_in_pure_files_are_found() {
    for text in
        ["use tokio::fs;", "use std::{collections, fs};", "async fn f() {}", "sqlx::query()"]
    {
        assert!(!impure_physics(&[file("sim-core/src/a.rs", text)]).is_empty(), "{text}");
        assert!(!impure_where_pure(&[file("src/bench/schedule/a.rs", text)]).is_empty(), "{text}");
        let claimed = format!("//! A codec.\n//! PURE. Uses: nothing.\n{text}");
        assert!(!impure_where_pure(&[file("src/bench/rig/a.rs", &claimed)]).is_empty(), "{text}");
        none(impure_where_pure(&[file("src/bench/rig/a.rs", text)]));
    }
    assert!(!impure_physics(&[file("sim-core/src/a.rs", "std::time::Instant::now()")]).is_empty());
    assert!(!impure_physics(&[file("sim-core/Cargo.toml", "tokio.workspace = true")]).is_empty());
    let other = |text| impure_physics(&[file("virtual-rig/laminate/Cargo.toml", text)]);
    assert!(!other("sim-core = { path = \"..\" }").is_empty());
    none(other("# Never `sim-core`\nfaer = \"0\""));
    none(impure_physics(&[file("sim-core/src/a.rs", "//! Never: async, tokio, std::fs.\n")]));
}

#[test]
fn an_outgoing_study_is_found() {
    for (path, text) in [
        ("studies/maps.rs", "use clap::Args;"),
        ("studies/maps.rs", "fn f() { eprintln!(\"training\"); }"),
        ("studies/sheet.rs", "std::fs::write(path, text)"),
        ("studies/Cargo.toml", "reqwest.workspace = true\n"),
    ] {
        assert_eq!(outgoing_studies(&[file(path, text)]).len(), 1, "{path}: {text}");
    }
    none(outgoing_studies(&[file("studies/lab.rs", "//! No files, no clap.\nasync fn f() {}")]));
    none(outgoing_studies(&[file("src/cli/train.rs", "use clap::Args;")]));
}

#[test]
fn an_entangled_stand_in_is_found() {
    for (path, text) in [
        ("virtual-rig/src/wire.rs", "use palpate::rig::link::Request;"),
        ("virtual-rig/src/wire.rs", "#[path = \"../../src/rig/words.rs\"] mod words;"),
        ("virtual-rig/Cargo.toml", "palpate = { path = \"..\" }"),
        ("src/cli/run.rs", "use virtual_rig::run::VirtualRig;"),
        ("virtual-rig/src/wire.rs", "use palpate_bench::rig::link::Request;"),
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
    assert_eq!(headless_or_long(&[file("src/bench/rig/a.rs", &long)]).len(), 1);
    let just_short_enough = &long[..long.len() - 1];
    none(headless_or_long(&[file("src/bench/rig/a.rs", just_short_enough)]));
    let two = [file("src/bench/rig/a.rs", "//! A."), file("src/bench/rig/b.rs", "//! B.")];
    assert_eq!(faceless_folders(&two), ["src/bench/rig: several files and no mod.rs"]);
}

#[test]
fn a_constant_of_one_name_in_two_files_is_found() {
    let of = |path: &str, text: &str| file(path, text);
    let poll = of("src/cli/a.rs", "    const LOOK: Duration = Duration::from_secs(1);");
    let other = of("src/words/b.rs", "pub(crate) const LOOK: u8 = 1;");
    let found = ambiguous_constants(&[poll, other]);
    assert_eq!(found, ["LOOK is defined in src/cli/a.rs, src/words/b.rs: name each by its use"]);
    none(ambiguous_constants(&[
        of("src/cli/a.rs", "const PAGE: u8 = 1;\nconst PAGE_ROWS: u8 = 1;"),
        of("src/cli/b.rs", "// const PAGE: u8 = 2;\nconst OTHER: &str = \"const PAGE:\";"),
        of("virtual-rig/src/c.rs", "const PAGE: u8 = 3;"),
    ]));
}

#[test]
fn an_error_without_a_section_is_found() {
    let found = |text: &str| silent_errors(&[file("src/a.rs", text)]);
    let silent = "/// Opens it.\npub async fn open(path: &Path) -> io::Result<File> {\n}\n";
    assert_eq!(found(silent), ["src/a.rs:2: open has no # Errors"]);
    for text in [
        "pub fn f<F: Fn() -> u8>(\n    given: F,\n) -> Result<u8, String>\nwhere F: Send {",
        "/// # Errors\n/// Always.\npub fn a() -> fmt::Result {}\npub const fn f() -> fmt::Result {",
    ] {
        assert_eq!(found(text).len(), 1, "{text}");
    }
    for text in [
        "/// A.\n///\n/// # Errors\n/// `A` if it is open;\n/// `B` if not.\n#[inline]\npub fn f() -> Result<(), A> {",
        "#[utoipa::path(get,\n    path = \"/a\")]\npub async fn f(\n) -> Result<A, B> {",
        "fn f() -> Result<(), A> {",
        "pub fn f(of: impl Fn() -> Result<(), A>) -> Option<A> {",
        "#[cfg(test)]\nmod tests {\n    pub fn f() -> Result<(), A> {}\n}",
    ] {
        none(found(text));
    }
    none(silent_errors(&[file("tests/it/a.rs", silent)]));
}

#[test]
fn a_comment_that_says_nothing_is_found() {
    let found = |text: &str| empty_comments(&[file("src/a.rs", text)]);
    let empty = "struct A {\n    /// Why.\n    why: u8,\n}";
    assert_eq!(found(empty), ["src/a.rs:2: \"Why.\" says nothing"]);
    none(found("/// Why it waits.\n/// A.\n/// Why.\n// Why.\nfn f() {}"));
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

#[test]
fn a_forbidden_phrase_is_found_however_it_is_broken() {
    let in_file = |path: &str, text: &str| forbidden_phrases(&[file(path, text)]);
    for phrase in PHRASES {
        let (first, rest) = phrase.split_once(' ').unwrap_or((phrase, ""));
        for text in [
            format!("//! A.\n/// It is {phrase}."),
            format!("fn f() {{ say(\"{}\"); }}", phrase.to_uppercase()),
            format!("/// It is {first}\n    /// {rest}, here."),
            format!("say(\"{first} \\\n    {rest}\")"),
        ] {
            assert_eq!(in_file("src/a.rs", &text).len(), 1, "{text}");
            assert_eq!(in_file("docs/how-to/a.md", &text).len(), 1, "{text}");
            for path in
                ["web/lib/a.js", "web/a.html", "web/a.css", "experiments/a.toml", "python/a.py"]
            {
                assert_eq!(in_file(path, &text).len(), 1, "{path}: {text}");
            }
            none(in_file("docs/style.md", &text));
            none(in_file("web/vendor/a.js", &text));
            none(in_file("migrations/0001_a.sql", &text));
        }
    }
    let second = in_file("src/a.rs", "//! A.\n// A net of its\n// own.");
    assert_eq!(second, ["src/a.rs:2: \"of its own\", see docs/style.md"]);
    assert_eq!(in_file("python/a.py", "# A net of its\n# own.").len(), 1);
    none(in_file(
        "src/a.rs",
        "//! On its own thread; a canewood; `well_gone_on`.\n// So.\n\n// Many.",
    ));
}

#[test]
fn a_training_outside_the_trainer_is_found() {
    let found = |path: &str, text: &str| training_outside_the_trainer(&[file(path, text)]).len();
    assert_eq!(found("nets/Cargo.toml", "[dependencies]\nburn = \"0.22\"\n"), 1);
    assert_eq!(found("Cargo.toml", "[dependencies]\npalpate-trainer.workspace = true\n"), 1);
    assert_eq!(found("Cargo.toml", "[dev-dependencies]\npalpate-trainer.workspace = true\n"), 0);
    assert_eq!(found("trainer/Cargo.toml", "[dependencies]\nburn = \"0.22\"\n"), 0);
}
