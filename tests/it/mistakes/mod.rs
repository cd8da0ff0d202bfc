//! Mistakes that people make, each with the whole answer to it: tables of files, of command lines, and of
//! requests to a service. `UPDATE=1` rewrites the answers.
//!
//! In a table, `## ` starts a mistake, and `< ` states what the first version answered, as a review quotes it.
//! `> file NAME = BASE` writes a file, a copy of one of `experiments/`; `> change OLD => NEW` changes it, `> with TEXT`
//! appends a line, `> until STATE` waits for the state of the run. `$ ` is a line for the shell; its output and exit
//! code follow, up to `[exit N]`.

use std::fmt::Write;
use std::io::{Read, Write as _};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::support::{Folder, PALPATE, copy_folder, served, with_responses};

/// Longest wait for the service, and for a state of a run.
const LIMIT: Duration = Duration::from_secs(120);
/// Where nothing listens.
const NOBODY: &str = "http://127.0.0.1:9";
/// Fewest mistakes of all tables.
const MISTAKES: usize = 80;
static TABLES: [&str; 3] =
    [include_str!("files.txt"), include_str!("commands.txt"), include_str!("service.txt")];

/// A place in which the lines of a table are carried out.
struct Lab {
    folder: Folder,
    url: String,
    /// Texts that differ between runs, and what replaces them in a table.
    masks: Vec<(String, &'static str)>,
}

impl Lab {
    fn new(name: &str, url: &str) -> Self {
        let folder = Folder::new(&format!("mistakes-{name}"));
        copy_folder(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/experiments/.")), &folder);
        let masks = vec![(folder.display().to_string(), "HERE")];
        Self { folder, url: url.into(), masks }
    }

    /// `palpate` with this folder and server, and nothing else of the environment.
    fn command(&self, program: &str) -> Command {
        let programs = Path::new(PALPATE).parent().unwrap().display();
        let mut command = Command::new(program);
        command.env_clear().current_dir(&*self.folder).env("HOME", &*self.folder);
        command.env("PATH", format!("{programs}:/usr/bin:/bin")).env("USER", "ada");
        command.env("PALPATE_DATA", "data").env("PALPATE_URL", &self.url);
        command
    }

    /// Output of a line for the shell, with its exit code.
    fn answer(&self, line: &str) -> String {
        let mut shell = self.command("bash");
        shell.args(["-o", "pipefail", "-c", &format!("{{ {line}\n}} 2>&1")]);
        let done = shell.stdin(Stdio::null()).output().unwrap();
        // On a busy machine more of the work takes longer than a moment, and is named.
        let names_work =
            |line: &&str| line.ends_with(" ..") || line.contains(" .. ") && line.ends_with(" s");
        let text = String::from_utf8_lossy(&done.stdout);
        let lines = text.lines().filter(|line| !names_work(line));
        let mut text: String = lines.map(|line| format!("{line}\n")).collect();
        for (found, shown) in &self.masks {
            text = text.replace(found, shown);
        }
        let code = done.status.code().map_or("signal".into(), |code| code.to_string());
        format!("{text}[exit {code}]\n")
    }

    /// Carries out a line of a table that prepares a mistake.
    fn prepare(&self, line: &str, file: &mut String) {
        let path = |name: &str| self.folder.join(name);
        match line.split_once(' ').unwrap() {
            ("file", rest) => {
                let (name, base) = rest.split_once(" = ").unwrap();
                *file = name.into();
                let base = Path::new(env!("CARGO_MANIFEST_DIR")).join("experiments").join(base);
                std::fs::write(path(name), std::fs::read(base).unwrap_or_default()).unwrap();
            }
            ("change", rest) => {
                let (old, new) =
                    rest.split_once(" => ").unwrap_or((rest.trim_end_matches(" =>"), ""));
                let text = std::fs::read_to_string(path(file)).unwrap();
                assert!(text.contains(old), "{file} has no {old}");
                std::fs::write(path(file), text.replacen(old, new, 1)).unwrap();
            }
            ("with", rest) => {
                let text = std::fs::read_to_string(path(file)).unwrap();
                std::fs::write(path(file), format!("{text}{rest}\n")).unwrap();
            }
            ("until", state) => {
                let start = Instant::now();
                let line = format!("palpate status --json | grep -q '\"run\":{state}'");
                while !self.answer(&line).contains("[exit 0]") {
                    let shown = || self.answer("palpate status; cat run.log");
                    assert!(start.elapsed() < LIMIT, "not {state}: {}", shown());
                    std::thread::sleep(Duration::from_millis(50));
                }
            }
            (other, _) => panic!("{other}: not a word of a table"),
        }
    }

    /// Carries out a table; returns it with the answers as they are, and the number of its mistakes.
    fn carry_out(&self, table: &str) -> (String, usize) {
        let (mut found, mut file, mut count, mut is_answer) =
            (String::new(), String::new(), 0, false);
        for line in table.lines() {
            if is_answer {
                is_answer = !(line.starts_with("[exit ") && line.ends_with(']'));
                continue;
            }
            writeln!(found, "{line}").unwrap();
            if line.starts_with("## ") {
                count += 1;
            } else if let Some(line) = line.strip_prefix("> ") {
                self.prepare(line, &mut file);
            } else if let Some(line) = line.strip_prefix("$ ") {
                found += &self.answer(line);
                is_answer = true;
            }
        }
        (found, count)
    }
}

/// Compares a table with what happens, or with `UPDATE=1` rewrites it.
fn check(lab: &Lab, name: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/mistakes").join(name);
    let table = std::fs::read_to_string(&path).unwrap();
    let (found, _) = lab.carry_out(&table);
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(&path, &found).unwrap();
    } else if let Some((line, (found, kept))) =
        found.lines().zip(table.lines()).enumerate().find(|(_, (a, b))| a != b)
    {
        panic!(
            "{name}, line {}:\n  {found}\nbut the table has\n  {kept}\nUPDATE=1 rewrites it",
            line + 1
        );
    } else {
        assert_eq!(found, table, "{name}");
    }
}

#[test]
fn mistakes_in_files_are_answered_as_the_table_says() {
    check(&Lab::new("files", NOBODY), "files.txt");
}

#[test]
fn mistakes_in_command_lines_are_answered_as_the_table_says() {
    let mut lab = Lab::new("commands", NOBODY);
    // Another web server.
    let other = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = other.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        for mut stream in other.incoming().flatten() {
            let _ = stream.read(&mut [0; 1024]);
            let page = "HTTP/1.1 200 OK\r\ncontent-length: 5\r\nconnection: close\r\n\r\nhello";
            let _ = stream.write_all(page.as_bytes());
        }
    });
    std::fs::write(lab.folder.join("other"), format!("http://{address}")).unwrap();
    lab.masks.push((address, "127.0.0.1:PORT"));
    check(&lab, "commands.txt");
}

#[test]
fn mistakes_beside_a_service_are_answered_as_the_table_says() {
    let mut lab = Lab::new("service", "");
    with_responses(&lab.folder.join("data"));
    let mut serve = lab.command(PALPATE);
    serve.args(["serve", "--bind", "127.0.0.1:0", "--speed", "100"]);
    serve.stdin(Stdio::null()).stderr(Stdio::null());
    let (_service, url) = served(&mut serve);
    lab.url = url;
    lab.masks.push((lab.url.trim_start_matches("http://").into(), "127.0.0.1:PORT"));
    check(&lab, "service.txt");
}

#[test]
fn the_tables_hold_all_mistakes_once() {
    let lines = || TABLES.iter().flat_map(|table| table.lines());
    let titles: Vec<&str> = lines().filter(|line| line.starts_with("## ")).collect();
    assert!(titles.len() >= MISTAKES, "{} mistakes", titles.len());
    for (n, title) in titles.iter().enumerate() {
        assert!(!titles[..n].contains(title), "{title} is there twice");
    }
    // Names of the program's own types, and requests that no person typed.
    for word in [
        "/api/v1",
        "u32",
        "u64",
        "f64",
        "expected struct",
        "..=",
        "found in string",
        "os error",
        "panicked",
        "No such file",
        "line 1 column",
    ] {
        let mut now = lines().filter(|line| !line.starts_with("< "));
        assert!(now.all(|line| !line.contains(word)), "an answer has {word}");
    }
}

/// The last table of the document is that of the mistakes with `< `; `UPDATE=1` rewrites it.
#[test]
fn the_document_has_the_answers_of_the_first_version_next_to_those_of_the_tables() {
    const HEAD: &str = "| mistake | before | now |\n|---|---|---|\n";
    let path =
        concat!(env!("CARGO_MANIFEST_DIR"), "/docs/transcripts/mistakes-before-and-after.md");
    let document = std::fs::read_to_string(path).unwrap();
    let (text, _) = document.rsplit_once(HEAD).unwrap();
    let mut whole = format!("{text}{HEAD}");
    for mistake in TABLES.iter().flat_map(|table| table.split("\n## ").skip(1)) {
        let Some(before) = mistake.lines().find_map(|line| line.strip_prefix("< ")) else {
            continue;
        };
        let title = mistake.lines().next().unwrap();
        // The first line of the answer to the last line that is typed.
        let now = mistake.rsplit("\n$ ").next().unwrap().lines().nth(1).unwrap();
        let quote = if now.contains('`') { "``" } else { "`" };
        writeln!(whole, "| {title} | {before} | {quote}{now}{quote} |").unwrap();
    }
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(path, &whole).unwrap();
    }
    assert_eq!(std::fs::read_to_string(path).unwrap(), whole, "UPDATE=1 rewrites it");
}
