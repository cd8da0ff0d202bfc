//! `palpate diff`: two runs side by side, and how their measurements differ at the same place and depth.
//! Uses: `client`, `compare`, `table`. Never: a change.

use std::collections::HashMap;

use serde::Serialize;
use serde_json::json;
use sim_core::stats::fvu;

use super::DiffArgs;
use super::answers::{TrialFacts, TwinsOf, all_trials, fit_of, state_words, stored_words};
use super::compare::{
    Change, Difference, Pair, by_depth, by_place, changes, difference, pairs, sampled,
};
use crate::api::{Page, Summary};
use crate::cli::client::Client;
use crate::cli::error::CliResult;
use crate::cli::find::find_run;
use crate::cli::next::Next;
use crate::cli::output::grouped;
use crate::cli::table::{Table, or_dash};
use crate::cli::watch::answers::Tour;
use crate::store::{RunKind, RunRow, TrialRow};

/// Largest number of pairs whose frames are compared.
const PAIRS_MAX: usize = 300;
/// Trials with frames per request.
const DIFF_PAGE_TRIALS: usize = 50;

/// A run with all that is compared.
struct Side {
    summary: Summary,
    twins: TwinsOf,
    median_fvu: Option<f64>,
    tour: Option<Tour>,
    trials: Vec<TrialFacts>,
}

impl Side {
    async fn read(client: &Client, what: &str) -> CliResult<Self> {
        let run = find_run(client, what).await?;
        let path = format!("/api/v1/runs/{}", run.uid);
        let summary = client.summary(run.uid).await?;
        let (twins, fit) = fit_of(client, run.uid).await?;
        Ok(Self {
            twins,
            median_fvu: fit.median_fvu,
            tour: client.if_there(&format!("{path}/tour")).await?,
            trials: all_trials(client, run.uid, summary.trials_stored).await?,
            summary,
        })
    }

    fn run(&self) -> &RunRow {
        &self.summary.run
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        let (run, summary) = (self.run(), &self.summary);
        let counts: Vec<String> = summary.contact_counts.iter().map(ToString::to_string).collect();
        let minutes = summary.duration_s.map(crate::cli::output::duration);
        vec![
            ("experiment", run.experiment.clone()),
            ("kind", run.kind.as_str().into()),
            ("label", run.label.as_str().into()),
            ("end", state_words(run)),
            ("stored", stored_words(summary.trials_stored, run.trials_planned)),
            ("skipped", grouped(summary.trials_skipped)),
            ("retries", grouped(summary.retries)),
            ("duration", or_dash(minutes)),
            ("trials with 0, 1, .. 6 contacts", counts.join(" ")),
            ("twins", grouped(self.twins.twins)),
            ("median FVU of the twins", or_dash(self.median_fvu.map(|fvu| format!("{fvu:.3}")))),
            ("seed", or_dash(run.seed)),
            // Placed weights are contacts, whatever their force.
            (
                "deadband, N",
                or_dash(Some(run.deadband_n).filter(|_| run.kind != RunKind::RealRandom)),
            ),
            ("calibration", or_dash(run.calibration_id.as_ref().map(|id| id.as_str()))),
            ("version", run.version.clone()),
            (
                "commit",
                or_dash(run.git_commit.as_ref().map(|id| id.chars().take(12).collect::<String>())),
            ),
        ]
    }
}

/// Frames at the same place and depth.
#[derive(Debug, Serialize)]
struct Frames {
    /// Variance of the earlier frame that the later one does not explain, over the compared pairs.
    fvu: Option<Difference>,
    /// Models of the twins, earlier and later.
    sim_models: [Vec<String>; 2],
}

/// Runs `palpate diff`.
///
/// # Errors
/// As [`find_run`].
pub async fn diff(client: &Client, args: &DiffArgs) -> CliResult<()> {
    let before = Side::read(client, &args.before).await?;
    let after = Side::read(client, &args.after).await?;
    let (a, b) = (before.run(), after.run());
    let files = [
        ("experiment", changes(Some(&a.definition), Some(&b.definition))),
        ("rig", changes(a.rig.as_deref(), b.rig.as_deref())),
        ("sensor", changes(Some(&a.sensor), Some(&b.sensor))),
    ];
    let paired = match (&before.tour, &after.tour) {
        (Some(one), Some(two)) => pairs((one, &before.trials), (two, &after.trials)),
        _ => Vec::new(),
    };
    let frames = frames(client, &paired).await?;
    let mut words = side_by_side(&before, &after).to_string();
    for (name, changes) in files.iter().filter(|(_, changes)| !changes.is_empty()) {
        words += &format!("\n\n{}", file_words(name, changes, a.scan_id, b.scan_id));
    }
    let same = files.iter().filter(|(_, changes)| changes.is_empty());
    let same: Vec<&str> = same.map(|(name, _)| *name).collect();
    if !same.is_empty() {
        words += &format!("\n\nfiles that are the same: {}", same.join(", "));
    }
    let forces = forces_words(&before, &after, &paired);
    words += &format!("\n\n{forces}\n{}", frames_words(&frames, a.scan_id, b.scan_id));
    let facts: Vec<Change> = facts(&before, &after).collect();
    let files: HashMap<&str, Vec<Change>> = files.into_iter().collect();
    let answer = json!({
        "runs": [a.uid, b.uid], "scan_ids": [a.scan_id, b.scan_id], "files": files, "facts": facts,
        "forces": { "pairs": paired.len(), "all_n": by_place(&paired), "by_depth": by_depth(&paired) },
        "frames": frames,
    });
    args.at.output().say(&answer, words);
    let scan_id = b.scan_id;
    Next::of(&args.at)
        .suggest(format_args!("palpate show {scan_id}"), "draws the second run in the terminal")
        .suggest(format_args!("palpate report {scan_id}"), "its findings, as HTML and PDF")
        .say();
    Ok(())
}

fn facts<'a>(before: &'a Side, after: &'a Side) -> impl Iterator<Item = Change> + 'a {
    let pairs = before.facts().into_iter().zip(after.facts());
    pairs.map(|((key, before), (_, after))| Change {
        key: key.into(),
        before: Some(before),
        after: Some(after),
    })
}

fn side_by_side(before: &Side, after: &Side) -> Table {
    let [a, b] = [before, after].map(|side| side.run().scan_id);
    // The last column is cut at the width of a terminal.
    let mut table = Table::new(&format!("| | run {a} | run {b}"), "");
    for change in facts(before, after) {
        let differs = if change.before == change.after { "" } else { "differs" };
        let value = |side: Option<String>| side.unwrap_or_default();
        table.push([change.key, differs.into(), value(change.before), value(change.after)]);
    }
    table
}

fn file_words(name: &str, changes: &[Change], a: i64, b: i64) -> String {
    let mut table = Table::new(&format!("key | run {a} | run {b}"), "");
    for change in changes {
        let Change { key, before, after } = change;
        table.push([key.clone(), or_dash(before.as_ref()), or_dash(after.as_ref())]);
    }
    format!("{name} file:\n{table}")
}

fn interval(of: &Difference) -> [String; 3] {
    let interval = of.low_95.zip(of.high_95);
    let interval = interval.map(|(low, high)| format!("{low:+.2} .. {high:+.2}"));
    [of.n.to_string(), format!("{:+.2}", of.median), or_dash(interval)]
}

fn forces_words(before: &Side, after: &Side, paired: &[Pair]) -> String {
    if paired.is_empty() {
        let why = match before.tour.is_none() || after.tour.is_none() {
            true => "a run has no plan to compare places with",
            false => "the runs have no place and depth in common",
        };
        return format!("forces: not compared, {why}");
    }
    let mut labels = vec![before.run().label.as_str(), after.run().label.as_str()];
    labels.dedup();
    let label = labels.join(" and ");
    let mut table = Table::new(
        "depth, mm> | n> | median, N> | 95 % interval, N>",
        "no force was measured in both runs",
    );
    for at in by_depth(paired) {
        let [n, median, ends] = interval(&at.difference_n);
        table.push([format!("{:.2}", at.depth_mm), n, median, ends]);
    }
    if let Some(all) = by_place(paired) {
        let [n, median, ends] = interval(&all);
        table.push(["all".into(), n, median, ends]);
    }
    format!(
        "largest force, run {} minus run {}, at the same place and depth ({label}; {} pairs;\n`all`: one \
         value per place):\n{table}",
        after.run().scan_id,
        before.run().scan_id,
        grouped(paired.len() as u64)
    )
}

fn frames_words(frames: &Frames, a: i64, b: i64) -> String {
    let [before, after] = &frames.sim_models;
    let models = match before == after {
        true => "of the same model".to_owned(),
        false => format!("of {} and {}", before.join(", "), after.join(", ")),
    };
    match &frames.fvu {
        Some(fvu) => {
            let interval = fvu.low_95.zip(fvu.high_95);
            let interval =
                interval.map_or_else(String::new, |(low, high)| format!(" [{low:.3}, {high:.3}]"));
            format!(
                "\nframes with contacts in both: median FVU of run {a} by run {b} {:.3}{interval} (n = {});\n\
                 twins {models}",
                fvu.median, fvu.n
            )
        }
        None => "\nframes: none with contacts in both runs".into(),
    }
}

/// Compares the frames of some pairs, evenly over the runs.
async fn frames(client: &Client, paired: &[Pair]) -> CliResult<Frames> {
    // Without contact a frame is noise: nothing of it can be explained.
    let touched: Vec<Pair> = paired.iter().filter(|pair| pair.in_contact).copied().collect();
    let some = sampled(&touched, PAIRS_MAX);
    let (mut values, mut sim_models) = (Vec::new(), [Vec::new(), Vec::new()]);
    for chunk in some.chunks(DIFF_PAGE_TRIALS) {
        let before = read(client, chunk.iter().map(|pair| pair.before)).await?;
        let after = read(client, chunk.iter().map(|pair| pair.after)).await?;
        for pair in chunk {
            let (one, two) = (before.get(&pair.before), after.get(&pair.after));
            for (models, trial) in sim_models.iter_mut().zip([one, two]) {
                let model = trial.and_then(|trial| trial.sim_model.clone());
                models.extend(model.filter(|model| !models.contains(model)));
            }
            let frames = one
                .and_then(|t| t.voltages_v.as_ref())
                .zip(two.and_then(|t| t.voltages_v.as_ref()));
            let same = frames.filter(|(one, two)| one.len() == two.len());
            values.extend(same.and_then(|(one, two)| fvu(one, two.iter().map(|v| f64::from(*v)))));
        }
    }
    Ok(Frames { fvu: difference(values), sim_models })
}

/// Trials with their frames, by their numbers.
async fn read(
    client: &Client,
    ids: impl Iterator<Item = i64>,
) -> CliResult<HashMap<i64, TrialRow>> {
    let ids: Vec<String> = ids.map(|id| id.to_string()).collect();
    let path = format!(
        "/api/v1/trials?voltages=true&limit={DIFF_PAGE_TRIALS}&trial_id__in={}",
        ids.join(",")
    );
    let page: Page<TrialRow> = client.get(&path).await?;
    Ok(page.items.into_iter().map(|trial| (trial.trial_id.0, trial)).collect())
}
