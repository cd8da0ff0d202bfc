//! The `palpate evaluate` commands, run as a person runs them, on few trials with made-up frames: what each
//! trains and scores, the form of its table, and its files. The scores themselves mean nothing here.

use std::fs::{self, DirEntry};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use palpate::store::{Contact, ImportedTrial, Label, NewRun, RunKind};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use tokio::sync::OnceCell;

use crate::datasets::filled::{copied, copy_filled, folder, new_run, press_run, store, twins_but};
use crate::support::{PALPATE, Process, VIRTUAL_RIG, done, succeeded};

/// Columns of a table of scores of contacts.
const SCORES: [&str; 10] = [
    "method",
    "trials",
    "number %",
    "location mm",
    "closest mm",
    "force %",
    "median abs. force %",
    "diameter %",
    "exact %",
    "ghosts/trial",
];
/// Numbers of tips of further runs, and their configurations: some are in each part.
const TIPS: [u8; 2] = [1, 3];
const CONFIGURATIONS: u32 = 15;

/// The trials of `fill`, and runs of one and of three tips.
pub(super) async fn trials(data: &Path) {
    static KEPT: OnceCell<PathBuf> = OnceCell::const_new();
    copied(data, &KEPT, "evaluate-kept", made_up).await;
}

async fn made_up(data: &Path) {
    copy_filled(data).await;
    let store = store(data).await;
    let mut chance = ChaCha8Rng::seed_from_u64(6);
    for tips in TIPS {
        let new = new_run(RunKind::RealHex, "made-up-tips");
        let run = press_run(&store, new, tips, CONFIGURATIONS, 0..11, &mut chance).await;
        twins_but(0, &store, run, "sim-0000000000000001", &mut chance).await;
    }
    store.close().await;
}

/// Runs a command on a data folder, in it.
pub(super) fn palpate(data: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(PALPATE);
    command.args(arguments).env("PALPATE_DATA", data).current_dir(data).output().unwrap()
}

/// Runs `palpate evaluate`; returns its numbers. Its files are in the folder `tables` of the data.
pub(super) fn evaluate(data: &Path, command: &str, options: &[&str]) -> Value {
    let tables = data.join("tables").display().to_string();
    let out =
        palpate(data, &[&["evaluate", command, "--json", "--out", &tables][..], options].concat());
    let (text, words) =
        (String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
    assert!(out.status.success(), "evaluate {command}: {words}{text}");
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{command}: {error}: {text}"))
}

/// The written table.
pub(super) fn table_text(data: &Path, name: &str) -> String {
    fs::read_to_string(data.join("tables").join(format!("{name}.md"))).unwrap()
}

/// Number of rows of the first table with the columns `head` in a table file.
fn rows(data: &Path, name: &str, head: &[&str]) -> usize {
    let text = table_text(data, name);
    let cells = |line: &str| {
        line.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect::<Vec<_>>()
    };
    let mut lines = text.lines().skip_while(|line| cells(line) != head);
    assert!(lines.next().is_some(), "{name} has no table of {head:?}:\n{text}");
    let body: Vec<&str> = lines.take_while(|line| line.starts_with('|')).collect();
    assert!(body.iter().all(|line| cells(line).len() == head.len()), "{name}:\n{text}");
    // Without the rule below the head.
    body.len() - 1
}

fn is_svg(data: &Path, name: &str, label: &str) {
    let text = fs::read_to_string(data.join("tables").join(name)).unwrap();
    assert!(text.starts_with("<svg") && text.contains(label), "{name}");
}

#[tokio::test]
async fn every_command_trains_scores_and_writes_what_it_is_for() {
    let data = folder("evaluate-commands");
    trials(&data).await;
    // Few passes over few rows, one for every command, so that nets are shared as in a real study.
    let tiny = ["--epochs", "1", "--rows", "40", "--scored", "20"];
    let all = |more: &[&'static str]| [&tiny[..], more].concat();

    let table = evaluate(&data, "transfer", &tiny);
    let rungs = table["rungs"].as_array().unwrap();
    let to: Vec<u64> = rungs.iter().map(|rung| rung["trained_to"].as_u64().unwrap()).collect();
    assert_eq!((&table["table"], to), (&"III".into(), vec![1, 2, 3]));
    assert_eq!(table["not_trained_to"], serde_json::json!([4, 5, 6]), "no trial has as many");
    assert_eq!(table["label"], "virtual");
    let fvu = table["no_net"]["all"]["fvu"].as_f64().unwrap();
    assert!(fvu > 0.5, "frames and twins were drawn apart: FVU {fvu}");
    let head = ["trained on", "train", "I", "II", "III", "IV", "V", "VI"];
    // Measured voltages, three nets of ours, six of the paper, and two regressions.
    assert_eq!(rows(&data, "table-iii", &head), 12);
    assert!(table_text(&data, "table-iii").contains("| kernel ridge, 1 to 3 |"));
    let regressions = table["regressions"].as_array().unwrap();
    let names: Vec<&str> = regressions.iter().map(|r| r["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["ridge", "kernel ridge"]);
    // The same rows of the part test as the nets.
    let trials = |scores: &Value| scores["test"]["all"]["trials"].as_u64().unwrap();
    assert!(regressions.iter().all(|r| trials(r) == trials(&rungs[2])), "{regressions:?}");
    is_svg(&data, "table-iii.svg", "virtual");

    let table = evaluate(&data, "maps", &tiny);
    let maps = table["maps"].as_array().unwrap();
    let names: Vec<&str> = maps.iter().map(|map| map["map"].as_str().unwrap()).collect();
    assert_eq!(names.len(), 12);
    assert!(names.contains(&"4x20") && names.contains(&"20x60"), "{names:?}");
    assert!(maps.iter().all(|map| map["report"]["part"] == "test" && map["report"]["rows"] == 20));
    let compared = |map: &Value| map["regressions"].as_array().unwrap().clone();
    let regressions: Vec<Value> = maps.iter().flat_map(compared).collect();
    let same = |of: &Value| of["report"]["part"] == "test" && of["report"]["rows"] == 20;
    assert!(regressions.len() == 24 && regressions.iter().all(same), "the rows of the nets");
    // Ours, a perfect map's, two regressions' and the paper's of each.
    assert_eq!(rows(&data, "table-iv", &SCORES), 60);
    assert_eq!(table_text(&data, "table-iv").matches("paper's rule").count(), 2, "a verdict each");
    is_svg(&data, "fig-9.svg", "simulated");

    let figure = evaluate(&data, "noise", &tiny);
    assert_eq!(figure["truth"].as_array().unwrap().len(), 3);
    let sds = figure["residuals"]["sd_v"].as_array().unwrap();
    assert!(sds.len() == 784 && sds.iter().all(|sd| sd.as_f64().unwrap() > 0.0));
    assert_eq!(rows(&data, "fig-10", &["noise", "contacts found", "forces, N"]), 3);
    is_svg(&data, "fig-10a.svg", "virtual");
    is_svg(&data, "fig-10b.svg", "virtual");

    let figure = evaluate(&data, "factorial", &tiny);
    let conditions = figure["conditions"].as_array().unwrap();
    let noises: std::collections::BTreeSet<String> =
        conditions.iter().map(|condition| condition["noise"].to_string()).collect();
    // Two pixels, two diameters, three levels of noise, as in the paper.
    assert_eq!((conditions.len(), noises.len()), (12, 3), "{conditions:?}");
    assert_eq!(rows(&data, "fig-11", &SCORES), 4, "a perfect map for each of the four");

    let figure = evaluate(&data, "unseen", &tiny);
    let ours = figure["ours"].as_array().unwrap();
    let names: Vec<&str> = ours.iter().map(|method| method["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["one step, Tikhonov", "one step, NOSER", "exact, 1 frame", "exact, mean"]);
    assert!(ours.iter().all(|method| method["report"]["rows"] == 12), "all of Real-Random");
    let unknown = |note: &Value| note.as_str().unwrap().contains("model are unknown");
    let notes = ours[3]["report"]["notes"].as_array().unwrap();
    assert!(notes.iter().any(unknown), "no trial of one to three contacts fits: {notes:?}");
    // The nets of Fig. 11 again, four baselines, and the best by the paper's Transfer-Net.
    let pipeline = figure["real_to_sim"].as_array().unwrap();
    assert_eq!((pipeline.len(), figure["end_to_end"].as_array().unwrap().len()), (12, 4));
    let regressions = figure["regressions"].as_array().unwrap();
    let of_four = |of: &Value| of["nets"].as_array().unwrap().len() == 4;
    assert!(regressions.len() == 2 && regressions.iter().all(of_four), "{regressions:?}");
    assert_eq!(figure["best_with_published_transfer"]["rows"], 12);
    assert!(pipeline.iter().all(|net| net["report"]["threshold_n"] == 5.0), "the paper's rule");
    // Three of nets, two of regressions, the paper's, four of ours, each also by the number of contacts, and perfect
    // maps.
    assert!(rows(&data, "fig-12", &SCORES) > 2 * 9);
    assert!(rows(&data, "fig-12", &["probability", "answers", "stated %", "right %"]) > 0);
    is_svg(&data, "fig-12.svg", "virtual");

    let scored =
        evaluate(&data, "method", &all(&["tikhonov", "--dataset", "real", "--part", "test"]));
    assert_eq!((&scored["method"], &scored["report"]["rows"]), (&"tikhonov".into(), &20.into()));
    assert!(scored["report"]["perfect"]["all"]["trials"].as_u64() > Some(0));
    assert!(rows(&data, "method", &SCORES) > 2);

    let table = evaluate(&data, "quantity", &all(&["count"]));
    let nets = table["nets"].as_array().unwrap();
    let names: Vec<&str> = nets.iter().map(|net| net["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["ridge", "kernel ridge", "mlp"]);
    let scores: Vec<&Value> = nets.iter().map(|net| &net["scores"]["rows"]).collect();
    assert!(scores.iter().all(|rows| **rows == 20), "the same rows: {scores:?}");
    let verdicts = table["verdicts"].as_array().unwrap();
    let of_mlp = |line: &Value| line.as_str().unwrap().starts_with("mlp ");
    assert_eq!(verdicts.len(), 2, "one of each regression: {verdicts:?}");
    assert!(verdicts.iter().all(of_mlp), "{verdicts:?}");
    assert_eq!((&table["dataset"], &table["split_by"]), (&"real".into(), &"configuration".into()));
    let head = ["net", "rows", "wrong by", "median", "right %", "of ridge"];
    assert_eq!(rows(&data, "quantity-count", &head), 4);
    // Each of two batches is excluded in turn.
    let batches = "name = \"without\"\ntask = \"real\"\nruns = [\"made-up-hex\", \"made-up-tips\"]\n\
                   [split]\nby = \"run\"\nratio = [4, 1, 0]\n";
    fs::write(data.join("batches.toml"), batches).unwrap();
    let made = ["dataset", "make", "batches.toml", "--each-run", "--json"];
    let made = done(&palpate(&data, &made));
    let [hex, tips] = ["without-made-up-hex", "without-made-up-tips"];
    let table = evaluate(&data, "quantity", &all(&["count", "--dataset", hex, "--dataset", tips]));
    let of_each = table["datasets"].as_array().unwrap();
    let names: Vec<&str> = of_each.iter().map(|one| one["dataset"].as_str().unwrap()).collect();
    assert_eq!(names, [hex, tips]);
    let is_whole = |one: &Value| one["split_by"] == "run" && one["verdicts"][1].is_string();
    assert!(of_each.iter().all(is_whole), "{of_each:?}");
    let mean = &table["nets"][2];
    assert_eq!((&mean["name"], &mean["scores"]["rows"]), (&"mlp".into(), &40.into()));
    assert_eq!(mean["scores"]["error"]["n"], 2, "one of each dataset");
    assert!(table["verdicts"][0].as_str().unwrap().ends_with(" of 2 datasets)."), "{table}");
    assert_eq!(rows(&data, "quantity-count", &head), 4 * 3, "the mean, and both datasets");
    let twice = ["evaluate", "quantity", "count", "--dataset", hex, "--dataset", hex];
    let words = String::from_utf8(palpate(&data, &twice).stderr).unwrap();
    assert!(words.contains("dataset = without-made-up-hex: must be named once"), "{words}");
    let id = made["items"][0]["id"].as_str().unwrap();
    let twice = ["evaluate", "quantity", "count", "--dataset", hex, "--dataset", id];
    let words = String::from_utf8(palpate(&data, &twice).stderr).unwrap();
    let refused = format!("dataset = {id}: must be another dataset than {hex}; both are {id}");
    assert!(words.contains(&refused), "{words}");

    let table = evaluate(&data, "quantity", &all(&["force", "--by-trial"]));
    let split = (&table["dataset"], &table["split_by"]);
    assert_eq!(split, (&"real-by-trial".into(), &"trial".into()));
}

/// The service of a killed command is gone, too; that of the next one resumes its training.
#[tokio::test]
async fn a_command_that_was_killed_and_runs_again_trains_no_net_twice() {
    let data = folder("evaluate-killed");
    trials(&data).await;
    let options = ["count", "--epochs", "1000", "--rows", "40", "--scored", "20"];
    let mut command = Command::new(PALPATE);
    command.args(["evaluate", "quantity"]).args(options).env("PALPATE_DATA", &data);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let mut killed = Process(command.spawn().unwrap());
    let is_perceptron = |folder: std::io::Result<DirEntry>| {
        let order = fs::read_to_string(folder.unwrap().path().join("order.json"));
        order.is_ok_and(|order| order.contains("mlp"))
    };
    while !fs::read_dir(data.join("jobs")).is_ok_and(|mut jobs| jobs.any(is_perceptron)) {
        assert!(killed.0.try_wait().unwrap().is_none(), "it trained all nets or failed");
        tokio::time::sleep(std::time::Duration::from_millis(1)).await;
    }
    drop(killed);
    evaluate(&data, "quantity", &options);
    let listed = succeeded(&palpate(&data, &["job", "list", "--json"]));
    let jobs = listed.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let trainings = jobs.filter(|job| job["kind"] == "training");
    let states: Vec<Value> = trainings.map(|mut job| job["state"].take()).collect();
    assert_eq!(states, ["done"; 3], "two regressions and a net");
}

/// Each place of a pad has a separate channel; the file states means alone.
async fn pad(data: &Path) {
    const PAD: &str = "name = \"pad\"\nchannels = 16\nwidth_mm = 100\nheight_mm = 100\n";
    let store = store(data).await;
    let new = NewRun {
        seed: None,
        rig: None,
        sensor: PAD.into(),
        ..new_run(RunKind::Imported, "pad-trials")
    };
    let run = store.begin_import(new).await.unwrap().uid;
    let trial = |n: u32| {
        let (channel, x) = (n as usize % 16, f64::from(n % 4));
        let mut voltages_v = vec![0.0; 16];
        voltages_v[channel] = 0.2;
        let at = Contact {
            x_mm: Some(20.0 + 20.0 * x),
            y_mm: Some(20.0 + 20.0 * f64::from(n / 4 % 4)),
            force_n: Some(9.0),
            diameter_mm: None,
        };
        let (contacts, frame_count) = (vec![at], 8);
        let known = ImportedTrial { configuration: n, contacts, voltages_v, ..Default::default() };
        ImportedTrial { frame_count, ..known }
    };
    store.import_trials(run, None, (0..80).map(trial).collect()).await.unwrap();
    store.end_import(run).await.unwrap();
    store.close().await;
    let split = "name = \"pad\"\ntask = \"real\"\nruns = [\"pad-trials\"]\n\n\
                 [split]\nby = \"trial\"\nratio = [3, 1, 1]\nseed = 1\n";
    fs::write(data.join("pad.toml"), split).unwrap();
    succeeded(&palpate(data, &["dataset", "make", "pad.toml"]));
}

#[tokio::test]
async fn fig_12_is_made_of_imported_trials_of_another_skin() {
    let data = folder("evaluate-imported");
    pad(&data).await;
    let options = ["--dataset", "pad", "--epochs", "1"];
    let figure = evaluate(&data, "unseen", &options);
    assert!(figure["ours"].as_array().unwrap().is_empty(), "{figure}");
    let nets = figure["end_to_end"].as_array().unwrap();
    let names: Vec<&str> = nets.iter().map(|net| net["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["1.8x3.6x115.2", "1.8x10.8x115.2", "3.6x3.6x115.2", "3.6x10.8x115.2"]);
    let of_test = |net: &Value| net["report"]["part"] == "test" && net["report"]["rows"] == 16;
    assert!(nets.iter().all(of_test), "{nets:?}");
    assert!(nets.iter().all(|net| net["report"]["held_out"] == true), "{nets:?}");
    // An eighth of the 9 N of all contacts.
    assert!(nets.iter().all(|net| net["report"]["threshold_n"] == 1.13), "{nets:?}");
    let distances = serde_json::json!({ "ghost_mm": 7.143, "guess_mm": 51.25 });
    assert!(nets.iter().all(|net| net["report"]["distances"] == distances), "{nets:?}");
    let text = table_text(&data, "fig-12");
    let ridge = ["| ridge, best: ", "the best of kernel ridge by the"];
    assert!(ridge.iter().all(|words| text.contains(*words)), "{text}");
    assert!(text.contains("farther than 7.143 mm") && text.contains("as 51.25 mm off"), "{text}");
    assert!(text.contains("end-to-end, best: ") && text.contains("part train of pad"), "{text}");
    assert!(!data.join("tables/fig-12.svg").exists(), "it shows the rig's skin");
    let refused = palpate(&data, &["evaluate", "unseen", "--ours", "--dataset", "pad"]);
    let words = String::from_utf8_lossy(&refused.stderr);
    assert!(!refused.status.success() && words.contains("the rig's sensor"), "{words}");
}

#[tokio::test]
async fn the_map_of_a_carried_recipe_follows_the_skin_and_that_of_a_file_does_not() {
    let data = folder("evaluate-scaled");
    pad(&data).await;
    let warned = "map = 4x20: most of it is beyond the skin of the sensor ";
    let warns = |text: &str| text.matches(warned).count();
    let trained = |recipe: &str| -> (String, usize) {
        let output = palpate(&data, &["train", recipe, "--dataset", "pad", "--json"]);
        let last: Value = done(&output);
        let recipe = last["model"]["manifest"]["recipe"].as_str().unwrap().to_owned();
        (recipe, warns(&String::from_utf8_lossy(&output.stderr)))
    };
    let (recipe, warnings) = trained("end-to-end-ridge");
    assert!(recipe.contains("map = \"0.72x3.6x115.2\""), "{recipe}");
    assert_eq!(warnings, 0);
    let carried = succeeded(&palpate(&data, &["train", "end-to-end-ridge", "--show"]));
    fs::write(data.join("mine.toml"), carried.replace("\"end-to-end-ridge\"", "\"mine\"")).unwrap();
    let (recipe, warnings) = trained("mine.toml");
    assert!(recipe.contains("map = \"4x20\""), "{recipe}");
    // The command that trains states the warning, and so do the job and the model later.
    assert_eq!(warnings, 1);
    for what in [["job", "show", "last"], ["model", "show", "mine"]] {
        let shown = succeeded(&palpate(&data, &what));
        assert_eq!(warns(&shown), 1, "{shown}");
    }
    let job = done(&palpate(&data, &["job", "show", "last", "--json"]));
    assert_eq!(job["result"]["name"], "mine", "{job:#}");
}

#[tokio::test]
async fn an_export_that_fails_is_reported_once() {
    let data = folder("evaluate-export");
    trials(&data).await;
    // The number of channels is known once the dataset is made: the export itself fails.
    let refused = palpate(&data, &["dataset", "export", "real", "--slice", "0:5000"]);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(1), "{said}");
    assert_eq!(said.matches("0:5000").count(), 1, "{said}");
    assert_eq!(said.matches("must be FIRST:END within 0:784").count(), 1, "{said}");
}

#[tokio::test]
async fn a_learning_curve_states_the_labels_of_all_rows() {
    let data = folder("evaluate-labels");
    trials(&data).await;
    let store = store(&data).await;
    let mut chance = ChaCha8Rng::seed_from_u64(8);
    let new = NewRun { label: Label::Measured, ..new_run(RunKind::RealHex, "made-up-measured") };
    let run = press_run(&store, new, 1, CONFIGURATIONS, 0..11, &mut chance).await;
    twins_but(0, &store, run, "sim-0000000000000001", &mut chance).await;
    store.close().await;
    let tiny = ["--map", "20x60", "--rows", "40", "--epochs", "1"];
    succeeded(&palpate(&data, &[&["train", "recon-net"][..], &tiny].concat()));
    succeeded(&palpate(&data, &["job", "losses", "last", "--plot", "losses.svg"]));
    let picture = fs::read_to_string(data.join("losses.svg")).unwrap();
    assert!(picture.contains("measured and virtual, n = 1 "), "{picture}");
}

/// The twins are real: the service of the command makes them.
#[tokio::test]
async fn the_fit_of_twins_and_the_papers_values_are_shown_by_their_commands() {
    let data = folder("evaluate-simulation");
    let store = store(&data).await;
    // Twins need the frames of a rig.
    let new = NewRun { rig: Some(VIRTUAL_RIG.into()), ..new_run(RunKind::RealHex, "made-up-hex") };
    press_run(&store, new, 1, 1, 4..11, &mut ChaCha8Rng::seed_from_u64(7)).await;
    store.close().await;
    let fit = evaluate(&data, "simulation", &["--run", "1"]);
    assert_eq!((&fit["label"], &fit["report"]["trials"]), (&"virtual".into(), &7.into()), "{fit}");
    let fvu = fit["report"]["median_fvu"].as_f64().unwrap();
    assert!(fvu > 0.5, "frames and twins were drawn apart: FVU {fvu}");
    assert!(data.join("tables/simulation.json").exists());
    let shown = palpate(&data, &["evaluate", "published", "--json"]);
    let values: Value = serde_json::from_slice(&shown.stdout).unwrap();
    assert_eq!(values["table_iv"].as_array().unwrap().len(), 12, "{values}");
}

/// The tests above run every command.
#[test]
fn no_command_of_evaluate_is_without_a_test() {
    let mut known = ["transfer", "maps", "noise", "factorial", "unseen", "method", "quantity"]
        .into_iter()
        .chain(["simulation", "published"])
        .collect::<Vec<_>>();
    let help = palpate(Path::new("."), &["evaluate", "-h"]);
    let text = String::from_utf8_lossy(&help.stdout);
    let commands = text.split_once("Commands:").unwrap().1.split_once("\n\n").unwrap().0;
    // The text of a command continues on lines that are further to the right.
    let name = |line: &str| -> Option<String> {
        let word = line.strip_prefix("  ").filter(|rest| !rest.starts_with(' '))?;
        word.split_whitespace().next().map(str::to_owned)
    };
    let mut listed: Vec<String> = commands.lines().filter_map(name).collect();
    listed.retain(|name| name != "help");
    known.sort_unstable();
    listed.sort_unstable();
    assert_eq!(listed, known, "{text}");
}
