//! The report as one HTML file: style and figures are in it, no script, nothing from elsewhere.
//! PURE. Uses: `facts`, `findings`, `plots`. Never: foreign text that is not escaped.

use std::collections::BTreeMap;
use std::fmt::Write;

use jiff::Timestamp;

use super::super::answers::{
    duration_words, elapsed, settings_words, state_words, stored_words, why_words,
};
use super::facts::Facts;
use super::findings::{findings, outliers};
use super::plots::{self, Plot};
use crate::cli::output::{counted, duration, grouped};
use crate::cli::summary::table_one;
use crate::cli::table::or_dash;
use crate::cli::times::{second, zoned};
use crate::evaluate::figures::FigureResult;
use crate::event::{Importance, shown_kind};
use crate::state::{PausedWhy, StoredState};

const STYLE: &str = include_str!("report.css");
/// Rows of a table of what happened or of skips: the report states how many more there are.
const TABLE_ROWS: usize = 40;
const WORST: usize = 10;

/// Returns the report. `now`: the time at which it is made.
///
/// # Errors
/// `FigureError` if a figure cannot be drawn.
pub fn page(facts: &Facts, now: Timestamp) -> FigureResult<String> {
    let run = facts.run();
    let title = format!("Run {}, {} ({})", run.scan_id, run.experiment, run.label.as_str());
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <title>{0}</title>\n<style>\n{STYLE}</style></head>\n<body><main>\n<header><h1>{0}</h1>\n\
         <p class=\"end {1}\">{2}</p></header>\n",
        escaped(&title),
        if is_whole(facts) { "whole" } else { "short" },
        escaped(&end_words(facts)),
    );
    look(&mut page, facts);
    measured(&mut page, facts, now)?;
    happened(&mut page, facts);
    section(
        &mut page,
        "Force and depth",
        plots::forces(facts)?,
        "No force was measured over depth.",
    );
    fit(&mut page, facts)?;
    section(
        &mut page,
        "Drift",
        plots::drift(facts)?,
        "Too few tares, reference presses and twins to show a drift.",
    );
    sources(&mut page, facts, now);
    page.push_str("</main></body></html>\n");
    Ok(page)
}

fn is_whole(facts: &Facts) -> bool {
    facts.run().exit_status.is_some() && facts.summary.trials_stored >= facts.run().trials_planned
}

fn end_words(facts: &Facts) -> String {
    let run = facts.run();
    let stored = stored_words(facts.summary.trials_stored, run.trials_planned);
    let reason = run.reason.as_deref().map_or_else(String::new, |reason| format!(", {reason}"));
    format!("{}{reason}: {stored} trials stored", state_words(run))
}

fn look(page: &mut String, facts: &Facts) {
    page.push_str("<section><h2>Findings</h2>\n");
    let all = findings(facts);
    if all.is_empty() {
        page.push_str("<p>No findings.</p>\n");
    } else {
        page.push_str("<ul class=\"findings\">\n");
        for finding in all {
            let class = if finding.level == Importance::Act { "act" } else { "look" };
            let _ = writeln!(page, "<li class=\"{class}\">{}</li>", escaped(&finding.words));
        }
        page.push_str("</ul>\n");
    }
    page.push_str("</section>\n");
}

fn measured(page: &mut String, facts: &Facts, now: Timestamp) -> FigureResult<()> {
    let (run, summary) = (facts.run(), &facts.summary);
    page.push_str("<section><h2>Planned and measured</h2>\n<div class=\"columns\">\n");
    let (took, stored) = (elapsed(run, now), summary.trials_stored);
    let mean = took.filter(|_| stored > 0).map(|took| took.as_secs_f64() / stored as f64);
    let rows = [
        ("experiment", format!("{} ({})", run.experiment, run.kind.as_str())),
        ("label of the data", run.label.as_str().into()),
        ("planned", format!("{} trials", grouped(run.trials_planned))),
        ("stored", format!("{} trials", grouped(stored))),
        ("by setting", or_dash(settings_words(summary))),
        (
            "skipped",
            format!(
                "{} trials of {}",
                grouped(summary.trials_skipped),
                counted(summary.skips.len() as u64, "configuration", "configurations")
            ),
        ),
        ("failed attempts", grouped(summary.retries)),
        ("started", or_dash(run.started_at.map(zoned))),
        ("ended", or_dash(run.ended_at.map(second))),
        ("duration", or_dash(took.map(duration_words))),
        ("wall time per trial", or_dash(mean.map(duration))),
        ("submitted by", run.submitted_by.clone()),
    ];
    table(page, &["", ""], rows.map(|(name, value)| vec![name.into(), value]), "facts");
    contacts(page, facts);
    page.push_str("</div>\n");
    if let Some(plot) = plots::counts(facts)? {
        figure(page, &plot);
    }
    page.push_str("</section>\n");
    Ok(())
}

fn contacts(page: &mut String, facts: &Facts) {
    let counts = facts.summary.contact_counts;
    let stored: u64 = counts.iter().sum();
    let published = table_one(facts.run().kind, stored);
    let paper = published.as_ref().map(|(name, _)| format!("{name}, Table I, scaled"));
    let heads: Vec<&str> = ["contacts", "trials"].into_iter().chain(paper.as_deref()).collect();
    let rows = counts.iter().enumerate().map(|(contacts, count)| {
        let mut row = vec![contacts.to_string(), grouped(*count)];
        row.extend(published.as_ref().map(|(_, all)| match all[contacts] {
            few if few < 100.0 => format!("{few:.1}"),
            many => grouped(many.round() as u64),
        }));
        row
    });
    table(page, &heads, rows, "numbers");
}

/// Something that happened: time, kind, words.
type Row = (Timestamp, String, String);

/// The rows that are shown, about [`TABLE_ROWS`], and the number of those of each kind that are not. A kind with many
/// rows hides no other: each kind has its first ones, no kind more than any other needs.
fn shown(all: Vec<Row>) -> (Vec<Row>, BTreeMap<String, usize>) {
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for (_, kind, _) in &all {
        *counts.entry(kind.clone()).or_default() += 1;
    }
    let fits =
        |most: &usize| counts.values().map(|count| count.min(most)).sum::<usize>() <= TABLE_ROWS;
    let most = (1..=TABLE_ROWS).rev().find(fits).unwrap_or(1);
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    let rows = all.into_iter().filter(|(_, kind, _)| {
        let seen = seen.entry(kind.clone()).or_default();
        *seen += 1;
        *seen <= most
    });
    let rows = rows.collect();
    counts.retain(|_, count| *count > most);
    counts.values_mut().for_each(|count| *count -= most);
    (rows, counts)
}

fn happened(page: &mut String, facts: &Facts) {
    page.push_str("<section><h2>What happened</h2>\n");
    let waits = facts.states.iter().filter(|span| {
        // A run of manual trials pauses for each of them.
        span.why != Some(PausedWhy::ManualTrial)
            && span.to.is_some_and(|to| {
                to.duration_since(span.from).as_secs_f64() >= 1.0
                    && span.state != StoredState::Running
            })
    });
    let waits = waits.map(|span| {
        let took = span.to.map(|to| duration_words(to.duration_since(span.from)));
        let words = format!("for {}{}", took.unwrap_or_default(), why_words(span.why));
        (span.from, span.state.as_str().to_owned(), words)
    });
    let events = facts.events.iter();
    let events = events.map(|event| (event.at, shown_kind(&event.kind), event.words.clone()));
    let mut all: Vec<Row> = waits.chain(events).collect();
    all.sort_by_key(|(at, ..)| *at);
    let count = all.len();
    if all.is_empty() {
        page.push_str("<p>No stop, trip, pause, skip or failed attempt.</p>\n");
    } else {
        let (rows, more) = shown(all);
        let rows = rows.into_iter().map(|(at, kind, words)| vec![second(at), kind, words]);
        table(page, &["time", "what", ""], rows, "events");
        if !more.is_empty() {
            let total: usize = more.values().sum();
            let more: Vec<String> =
                more.iter().map(|(kind, more)| format!("{more} × {kind}")).collect();
            let _ = writeln!(
                page,
                "<p>{total} more ({}): <code>palpate events {} --important --limit {count}</code></p>",
                escaped(&more.join(", ")),
                facts.run().scan_id
            );
        }
    }
    if !facts.summary.skips.is_empty() {
        page.push_str("<h3>Skipped configurations</h3>\n");
        let skips = facts.summary.skips.iter().take(TABLE_ROWS);
        let rows = skips
            .map(|skip| vec![skip.configuration.to_string(), second(skip.at), skip.reason.clone()]);
        table(page, &["configuration", "time", "reason"], rows, "events");
    }
    page.push_str("</section>\n");
}

fn fit(page: &mut String, facts: &Facts) -> FigureResult<()> {
    let plots = plots::twins(facts)?;
    page.push_str("<section><h2>Twins</h2>\n");
    let twins = &facts.twins;
    let number = |value: Option<f64>, scale: f64, digits: usize| {
        or_dash(value.map(|value| format!("{:.digits$}", scale * value)))
    };
    let rows = [
        ("trials with a twin", format!("{} of {}", grouped(twins.twins), grouped(twins.trials))),
        ("without twin yet, not possible", format!("{}, {}", twins.pending, twins.failures)),
        ("median FVU, trials with contacts", number(facts.fit.median_fvu, 1.0, 3)),
        (
            "median RMSE, trials with contacts",
            format!("{} mV", number(facts.fit.median_rmse_v, 1e3, 2)),
        ),
        ("deadband of the voltages", format!("{} N", number(facts.fit.deadband_n, 1.0, 0))),
    ];
    table(page, &["", ""], rows.map(|(name, value)| vec![name.into(), value]), "facts");
    plots.iter().for_each(|plot| figure(page, plot));
    let far = outliers(&facts.trials);
    if !far.is_empty() {
        page.push_str("<h3>Worst trials</h3>\n");
        let rows = far.iter().take(WORST).map(|trial| {
            vec![
                format!("t{}", trial.trial_id),
                trial.configuration.to_string(),
                number(trial.depth_mm, 1.0, 2),
                trial.contact_count.to_string(),
                number(trial.max_force_n, 1.0, 2),
                number(trial.fvu, 1.0, 3),
            ]
        });
        let heads =
            ["trial", "configuration", "depth (mm)", "contacts", "largest force (N)", "FVU"];
        table(page, &heads, rows, "numbers");
        page.push_str("<p>Draw one with <code>palpate show TRIAL</code>.</p>\n");
    }
    page.push_str("</section>\n");
    Ok(())
}

fn section(page: &mut String, title: &str, plots: Vec<Plot>, none: &str) {
    let _ = writeln!(page, "<section><h2>{title}</h2>");
    if plots.is_empty() {
        let _ = writeln!(page, "<p>{none}</p>");
    }
    plots.iter().for_each(|plot| figure(page, plot));
    page.push_str("</section>\n");
}

fn sources(page: &mut String, facts: &Facts, now: Timestamp) {
    let run = facts.run();
    page.push_str("<section><h2>Sources</h2>\n");
    let short = |sha: &str| sha.chars().take(16).collect::<String>();
    let rows = [
        ("run", run.uid.to_string()),
        ("version", run.version.clone()),
        ("commit", or_dash(run.git_commit.as_ref())),
        ("seed", or_dash(run.seed)),
        ("experiment, sha256", short(&run.definition_sha256)),
        ("rig, sha256", or_dash(run.rig_sha256.as_deref().map(short))),
        ("sensor, sha256", short(&run.sensor_sha256)),
        ("calibration", or_dash(run.calibration_id.as_ref().map(|id| id.as_str()))),
        ("report made", zoned(now)),
    ];
    table(page, &["", ""], rows.map(|(name, value)| vec![name.into(), value]), "facts");
    let _ = writeln!(
        page,
        "<details open><summary>Experiment file</summary><pre>{}</pre></details>\n</section>",
        escaped(&run.definition)
    );
}

fn figure(page: &mut String, plot: &Plot) {
    let caption = escaped(&plot.caption);
    let _ = writeln!(page, "<figure>{}<figcaption>{caption}</figcaption></figure>", plot.svg);
}

/// A table; without heads if all are empty.
fn table(
    page: &mut String,
    heads: &[&str],
    rows: impl IntoIterator<Item = Vec<String>>,
    class: &str,
) {
    let _ = write!(page, "<table class=\"{class}\">");
    if heads.iter().any(|head| !head.is_empty()) {
        page.push_str("<thead><tr>");
        for head in heads {
            let _ = write!(page, "<th>{}</th>", escaped(head));
        }
        page.push_str("</tr></thead>");
    }
    page.push_str("<tbody>\n");
    for row in rows {
        page.push_str("<tr>");
        for cell in row {
            let _ = write!(page, "<td>{}</td>", escaped(&cell));
        }
        page.push_str("</tr>\n");
    }
    page.push_str("</tbody></table>\n");
}

/// A text escaped for HTML.
fn escaped(text: &str) -> String {
    // The ampersand first: those of the others stay.
    let entities = [("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ("\"", "&quot;"), ("'", "&#39;")];
    entities.iter().fold(text.to_owned(), |text, (letter, entity)| text.replace(letter, entity))
}
