//! `palpate show`: a run drawn in the terminal; a trial is `show_trial`.
//! Uses: `client`, `chart`, the map of `watch`. Never: a change.

use jiff::Timestamp;
use ratatui::layout::Rect;
use serde_json::json;

use super::answers::{
    TwinsOf, duration_words, elapsed, fit_of, settings_words, state_words, stored_words,
    tips_words, worst_fit,
};
use super::chart::{forces, picture, width};
use super::{ShowArgs, history, raw, show_trial};
use crate::api::{ForcesAtDepth, RunProgress, SensorOut, Summary};
use crate::cli::client::Client;
use crate::cli::error::{CliError, CliResult};
use crate::cli::find::{find_run, is_run};
use crate::cli::next::Next;
use crate::cli::output::{counted, filled, grouped, say, say_drawn, say_json};
use crate::cli::table::Table;
use crate::cli::times::local;
use crate::cli::watch::answers::Tour;
use crate::cli::watch::night::Night;
use crate::cli::watch::skin;
use crate::cli::watch::theme::Theme;

/// Height of the map and of the forces, lines.
const MAP_LINES: u16 = 24;
const CHART_LINES: u16 = 14;
const CHART_LINES_MAX: u16 = 20;
/// Width of the map, columns: the skin is nearly square, and a character twice as high as wide.
const MAP_COLUMNS: u16 = 50;
/// Width from which map and forces are next to each other, columns.
const SIDE_BY_SIDE: u16 = 90;
/// Width of a bar of counts, characters.
const BAR: usize = 30;

/// Runs `palpate show`.
///
/// # Errors
/// `CliError::Problems` if the text is not the name of a run or trial; `NoSuch` or `Refused` if there is no such run or
/// trial; others as [`Client::send`].
pub async fn show(client: &Client, args: &ShowArgs) -> CliResult<()> {
    if let Some(part) = args.raw {
        return raw::show(client, &args.what, part).await;
    }
    match show_trial::named(&args.what) {
        _ if args.history => history::show(client, &args.what, args.at.output()).await,
        Some(trial) => show_trial::show(client, &trial, args.at.output()).await,
        None => run(client, args).await,
    }
}

async fn run(client: &Client, args: &ShowArgs) -> CliResult<()> {
    if !is_run(&args.what) {
        let limit = "must be a run (number, start of the id of 4 characters or more, or `last`), or a trial, such as \
                     t812 or 3/81/4 (run, configuration, depth index)";
        return Err(CliError::argument("RUN|TRIAL", &args.what, limit));
    }
    let found = find_run(client, &args.what).await?;
    let path = format!("/api/v1/runs/{}", found.uid);
    let summary: Summary = client.summary(found.uid).await?;
    let (twins, fit) = fit_of(client, found.uid).await?;
    let median_fvu = fit.median_fvu;
    if args.at.json {
        say_json(&json!({ "summary": summary, "twins": twins, "median_fvu": median_fvu }));
        return Ok(());
    }
    let skin: Option<SensorOut> =
        client.if_there(&format!("/api/v1/sensor?run={}", found.uid)).await?;
    let tour: Option<Tour> = client.if_there(&format!("{path}/tour")).await?;
    let progress: Option<RunProgress> = match tour {
        Some(_) => client.if_there(&format!("{path}/progress")).await?,
        None => None,
    };
    // The largest forces of all trials over depth.
    let mut curve: Vec<ForcesAtDepth> = client.all(&format!("{path}/forces?")).await?;
    curve.retain(|at| at.tips.is_none());
    let worst = worst_fit(client, found.uid, &fit).await?;
    let night = Night { run: Some(found.uid), skin, tour, progress, ..Night::new(client.url()) };
    say(facts(&summary, twins, median_fvu, &night));
    if let Some(contacts) = counts(&summary.contact_counts) {
        say(format_args!("\n{contacts}"));
    }
    let picture = pictures(&night, &curve)?;
    if !picture.is_empty() {
        say("");
        say_drawn(&picture);
    }
    let run = found.scan_id;
    let mut next = Next::of(&args.at)
        .suggest(format_args!("palpate report {run}"), "all of it as HTML and PDF")
        .suggest(format_args!("palpate trials {run}"), "its trials");
    if let Some((trial_id, fvu)) = worst.and_then(|trial| Some((trial.trial_id, trial.fvu?))) {
        next = next.suggest(
            format_args!("palpate show t{trial_id}"),
            format_args!("the trial with the largest FVU, {fvu:.2}"),
        );
    }
    next.say();
    Ok(())
}

fn facts(summary: &Summary, twins: TwinsOf, median_fvu: Option<f64>, night: &Night) -> String {
    let run = &summary.run;
    let mut lines = vec![format!(
        "run {}, {} ({}, {}): {}",
        run.scan_id,
        run.experiment,
        run.kind.as_str(),
        run.label.as_str(),
        state_words(run),
    )];
    let mut line = |name: &str, value: String| lines.push(format!("  {name:<11} {value}"));
    if let Some(reason) = &run.reason {
        line("reason", reason.clone());
    }
    let times = [("started", run.started_at), ("ended", run.ended_at)];
    for (name, at) in times {
        if let Some(at) = at {
            line(name, local(at));
        }
    }
    if let Some(took) = elapsed(run, Timestamp::now()) {
        line("duration", duration_words(took));
    }
    line(
        "trials",
        format!(
            "{} stored, {} skipped, {}",
            stored_words(summary.trials_stored, run.trials_planned),
            grouped(summary.trials_skipped),
            counted(summary.retries, "retry", "retries"),
        ),
    );
    if let Some(settings) = settings_words(summary) {
        line("settings", settings);
    }
    for of in night.progress.iter().flat_map(|progress| &progress.forces_by_tips) {
        let tips = tips_words(run.kind, of.tips);
        let configurations = counted(of.configurations.into(), "configuration", "configurations");
        let (median_n, largest_n) = (of.median_n, of.largest_n);
        let words = format!("{tips}, largest in each of {configurations}:");
        line("force", format!("{words} median {median_n:.1} N, at most {largest_n:.1} N"));
    }
    let fit = median_fvu
        .map_or_else(String::new, |fvu| format!(", median FVU {fvu:.3} of trials with contact"));
    line("twins", format!("{} of {}{fit}", grouped(twins.twins), grouped(twins.trials)));
    line("uid", run.uid.to_string());
    line("submitted", run.submitted_by.clone());
    for skip in summary.skips.iter().take(5) {
        line("skipped", format!("configuration {}: {}", skip.configuration, skip.reason));
    }
    if summary.skips.len() > 5 {
        line("skipped", format!("and {} more", summary.skips.len() - 5));
    }
    lines.join("\n")
}

/// Trials by contacts with bars; `None` without trials.
fn counts(contact_counts: &[u64; 7]) -> Option<Table> {
    let most = contact_counts.iter().copied().max().filter(|most| *most > 0)?;
    let mut table = Table::new("contacts> | trials> |", "");
    let last = contact_counts.iter().rposition(|count| *count > 0).unwrap_or(0);
    for (contacts, count) in contact_counts.iter().enumerate().take(last + 1) {
        let bar = filled(*count as f64 / most as f64, BAR);
        table.push([contacts.to_string(), grouped(*count), bar]);
    }
    Some(table)
}

/// The map of the skin and the forces over depth, next to each other where there is room.
fn pictures(night: &Night, curve: &[ForcesAtDepth]) -> CliResult<String> {
    let (width, has_map, has_curve) = (width(), night.tour.is_some(), curve.len() > 1);
    if !has_map && !has_curve {
        return Ok(String::new());
    }
    let theme = Theme { colour: crate::cli::output::is_coloured() };
    let n: u64 = curve.iter().map(|at| at.trials).sum();
    let title = format!("largest force over depth: quartiles (n = {})", grouped(n));
    let beside = has_map && has_curve && width >= SIDE_BY_SIDE;
    let map = Rect::new(0, 0, MAP_COLUMNS.min(width), if has_map { MAP_LINES } else { 0 });
    let chart = match beside {
        true => Rect::new(MAP_COLUMNS + 2, 0, width - MAP_COLUMNS - 2, MAP_LINES),
        false => Rect::new(0, map.height, width, if has_curve { CHART_LINES + 1 } else { 0 }),
    };
    picture(width, map.height.max(chart.bottom()), |frame| {
        if has_map {
            skin::draw(frame, map, night, theme);
        }
        if has_curve {
            let head = Rect { height: 1, ..chart };
            frame.render_widget(ratatui::text::Line::from(title.as_str()), head);
            let below = Rect { y: chart.y + 1, height: chart.height - 1, ..chart };
            let below = Rect { height: below.height.min(CHART_LINES_MAX), ..below };
            forces(frame, below, curve);
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::api::forces_by_depth;

    #[test]
    fn counts_end_with_the_largest_number_of_contacts() {
        let shown = counts(&[138, 60, 0, 6, 0, 0, 0]).unwrap().to_string();
        assert_eq!(shown.lines().count(), 5, "{shown}");
        assert!(shown.lines().nth(1).unwrap().ends_with(&"█".repeat(BAR)), "{shown}");
        assert!(counts(&[0; 7]).is_none());
    }

    #[test]
    fn a_map_and_a_chart_are_drawn_without_a_service() {
        let tour = Tour { depths_mm: vec![0.0, 1.0], ..Tour::default() };
        let night = Night { tour: Some(tour), ..Night::new("") };
        let curve = forces_by_depth(None, [(0.0, 2.5), (1.0, 2.5)].into_iter());
        let drawn = pictures(&night, &curve).unwrap();
        assert!(drawn.contains("skin") && drawn.contains("quartiles (n = 2)"), "{drawn}");
        assert_eq!(pictures(&Night::new(""), &[]).unwrap(), "");
    }
}
