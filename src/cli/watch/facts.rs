//! The lines of numbers and words on the screen.
//! PURE. Uses: `night`, `output` (durations and sizes), ratatui's text. Never: a layout.

use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp};
use ratatui::style::Modifier;
use ratatui::text::{Line, Span};

use super::answers::per_hour;
use super::night::{Night, Told, one_line};
use super::theme::Theme;
use crate::api::{Rating, RigRates, Suspender};
use crate::campaign::shown::status::{Eta, RunStatus};
use crate::cli::output::{bytes, counted, duration, grouped};
use crate::cli::rig_facts::broken_channels;
use crate::cli::table::count_or_dash;
use crate::cli::view::{StatusView, rows};
use crate::event::Importance::{self, Act, Look, Routine};
use crate::record::Label;
use crate::state::StoredState;

/// Width of the names of the facts.
const NAME_COLUMNS: usize = 11;

/// Wall time and zone of the terminal.
#[derive(Debug, Clone)]
pub struct Now {
    /// Wall time at which the screen is drawn.
    pub at: Timestamp,
    /// Zone in which times are shown.
    pub zone: TimeZone,
}

impl Now {
    /// A time of the day; with the day of the week if it is not today.
    fn clock(&self, at: Timestamp, format: &str) -> String {
        let (then, now) = (at.to_zoned(self.zone.clone()), self.at.to_zoned(self.zone.clone()));
        let day = if then.date() == now.date() { "" } else { "%a " };
        then.strftime(&format!("{day}{format}")).to_string()
    }

    fn age(&self, at: Timestamp) -> String {
        duration(self.at.duration_since(at).as_secs_f64().max(0.0))
    }
}

/// The state of the run and the rig.
pub fn header(night: &Night, theme: Theme) -> Line<'static> {
    let Some(status) = &night.status else { return Line::from(format!(" {}", night.url)) };
    let mut spans = vec![Span::raw(format!(" {} ", one_line(&status.rig.name)))];
    let label = format!("[{}]  ", status.rig.label.as_str());
    spans.push(match status.rig.label {
        Label::Virtual => Span::styled(label, theme.virtual_rig().add_modifier(Modifier::BOLD)),
        Label::Measured | Label::Simulated => Span::raw(label),
    });
    if let Some(run) = &status.run {
        let state = run.state.as_str().to_uppercase();
        let style = match run.state {
            StoredState::Running => theme.life(),
            StoredState::Panicked => theme.level(Act),
            _ => theme.level(Look),
        };
        spans.push(Span::styled(state, style.add_modifier(Modifier::BOLD)));
        if let Some(requested) = run.requested_state {
            spans.push(Span::styled(format!(" → {requested}"), theme.level(Look)));
        }
        spans.push(Span::raw(format!("  run {}, {}", run.scan_id, one_line(&run.experiment))));
    } else {
        spans.push(Span::raw("no run"));
    }
    spans.push(Span::styled(format!("  rig {}", status.rig.state_words()), theme.aside()));
    Line::from(spans)
}

/// Why the values are old, if they are.
pub fn lost(night: &Night, now: &Now) -> Option<String> {
    let silent = night.lost_for(now.at)?;
    let cause = night.trouble.as_deref().unwrap_or("the answer is late");
    let words = duration(silent.as_secs_f64().floor());
    Some(format!(" NO ANSWER for {words}: what is below is old ({cause}) "))
}

/// The progress of a run: share and text.
pub fn progress(run: &RunStatus, heard_at: Timestamp, now: &Now) -> (f64, String) {
    let done = run.trials_stored + run.trials_skipped;
    let share = done as f64 / run.trials_planned.max(1) as f64;
    let mut words =
        format!("{} of {} trials", grouped(run.trials_stored), grouped(run.trials_planned));
    if run.trials_skipped > 0 {
        words += &format!(", {} skipped", grouped(run.trials_skipped));
    }
    if let Some(eta) = run.eta {
        words += &format!("  {}", eta_words(&eta, heard_at, now));
    }
    (share.clamp(0.0, 1.0), words)
}

fn eta_words(eta: &Eta, heard_at: Timestamp, now: &Now) -> String {
    let end = |in_s: f64| {
        let from_then = SignedDuration::try_from_secs_f64(in_s).unwrap_or_default();
        let format = if eta.remaining_s < 120.0 { "%H:%M:%S" } else { "%H:%M" };
        heard_at.checked_add(from_then).map_or("?".into(), |at| now.clock(at, format))
    };
    let (likely, low, high) = (end(eta.remaining_s), end(eta.low_s), end(eta.high_s));
    format!("done {likely} ({low} .. {high}), in {}", duration(eta.remaining_s))
}

/// All other facts, the most important first.
pub fn facts(night: &Night, status: &StatusView, now: &Now, theme: Theme) -> Vec<Line<'static>> {
    let mut lines = Vec::new();
    let mut fact = |name: &str, words: String, level: Importance| {
        let name = Span::styled(format!("{name:<NAME_COLUMNS$}"), theme.aside());
        lines.push(Line::from(vec![name, Span::styled(words, theme.level(level))]));
    };
    for glance in &status.glance {
        let level = match glance.rating() {
            Some(Rating::Unknown | Rating::Good) => continue,
            Some(Rating::Warn) | None => Look,
            Some(Rating::Bad) => Act,
        };
        fact(&one_line(&glance.title()), one_line(&glance.words), level);
    }
    if let Some(run) = &status.run {
        fact("now", phase(run), Routine);
        if let Some(at) = status.care.last_trial_at {
            fact("last trial", format!("{} ago", now.age(at)), Routine);
        }
    }
    if let Some(disk) = status.care.disk {
        let (free, needed) = (bytes(disk.free_bytes as f64), bytes(disk.needed_bytes as f64));
        let level = if disk.free_bytes < disk.needed_bytes { Act } else { Routine };
        fact("disk", format!("{free} free, {needed} needed"), level);
    }
    let rates = night.rates.as_ref();
    if let Some(words) = rates.and_then(|rates| broken_channels(&rates.stream)) {
        fact("channels", words, Look);
    }
    if let Some((words, level)) = twins(night) {
        fact("twins", words, level);
    }
    if let Some(lock) = &status.lock {
        let (holder, note) = (one_line(&lock.holder), one_line(&lock.note));
        fact("lock", format!("{holder}: {note} ({})", now.clock(lock.since, "%H:%M")), Look);
    }
    // The free disk has its line above.
    let is_shown = |s: &&Suspender| s.name != "disk" || s.since.is_some();
    for suspender in status.care.suspenders.iter().filter(is_shown) {
        let level = match (suspender.since, suspender.suspends) {
            (None, _) => Routine,
            (Some(_), false) => Look,
            (Some(_), true) => Act,
        };
        let (name, words) = named(&suspender.name, suspender_words(suspender, now));
        fact(&name, words, level);
    }
    if let Some(words) = status.run.as_ref().and_then(|_| pace(night)) {
        fact("pace", words, Routine);
    }
    if let Some(words) = status.run.as_ref().and_then(|run| predicted(night, run, now)) {
        fact("predicted", words, Routine);
    }
    for (name, words, level) in rates.map_or_else(Vec::new, rate_words) {
        fact(name, words, level);
    }
    if let Some(run) = status.run.as_ref().filter(|run| run.retries > 0) {
        fact("retries", grouped(run.retries), Routine);
    }
    let waits = status.waiting_for.as_deref().map(|words| format!("; {}", one_line(words)));
    let queued = counted(status.queue_length as u64, "run", "runs");
    fact("queue", format!("{queued}{}", waits.unwrap_or_default()), Routine);
    if let Some(p) = status.rig.pose {
        let (x, y, z, r) = (p.x_mm, p.y_mm, p.z_mm, p.radius_mm);
        fact("pose", format!("x {x:.1} y {y:.1} z {z:.2} r {r:.1} mm"), Routine);
    }
    if let Some(actions) = status.asked_of_run() {
        fact("may", actions, Routine);
    }
    lines
}

/// Where the run is in its tour, and what it does there.
fn phase(run: &RunStatus) -> String {
    let words = run.phase.about();
    match (run.current_step, run.trial) {
        (Some(step), _) => format!("step {} of {}, {words}", step.index + 1, step.of),
        (None, Some(key)) => format!("configuration {}, {words}", key.configuration),
        (None, None) => words.into(),
    }
}

/// Trials per hour, of the whole run and of its last tenth.
fn pace(night: &Night) -> Option<String> {
    let course = night.course.as_ref()?;
    let lately = per_hour(course, Some(course.trials.len().div_ceil(10)))?;
    Some(format!("{:.0} trials/h, {lately:.0} lately", per_hour(course, None)?))
}

/// The end as it was predicted at the start, and how much later or earlier it is expected now.
fn predicted(night: &Night, run: &RunStatus, now: &Now) -> Option<String> {
    let course = night.course.as_ref()?;
    let after = |from: Timestamp, in_s: f64| {
        SignedDuration::try_from_secs_f64(in_s).ok().and_then(|in_s| from.checked_add(in_s).ok())
    };
    let planned = after(course.from?, course.predicted_s?)?;
    let expected = after(night.heard_at?, run.eta?.remaining_s)?;
    let late_s = expected.duration_since(planned).as_secs_f64();
    let by = match late_s.abs() {
        0.0..60.0 => String::from("as predicted"),
        late => format!("{} {}", duration(late), if late_s > 0.0 { "later" } else { "earlier" }),
    };
    Some(format!("{} at the start, now {by}", now.clock(planned, "%H:%M")))
}

/// What the stream and the wires did in the last minute.
fn rate_words(rates: &RigRates) -> Vec<(&'static str, String, Importance)> {
    let stream = &rates.stream;
    let Some(frames_per_s) = stream.frames_per_s else { return Vec::new() };
    let lost = format!("{} missed, {} garbled", stream.missed, stream.garbled);
    let level = if stream.garbled > 0 { Look } else { Routine };
    let mut lines = vec![("stream", format!("{frames_per_s:.1} frames/s, {lost}"), level)];
    for wire in &rates.wires {
        let failed = wire.timeouts + wire.garbled + wire.reconnects;
        let level = if failed > 0 { Look } else { Routine };
        let per_min = wire.requests_per_min.unwrap_or(0.0);
        let words = format!(
            "{}: {per_min:.0}/min, {} repeated, {failed} failed",
            one_line(&wire.name),
            wire.retries
        );
        lines.push(("wire", words, level));
    }
    lines
}

/// Backlog and fit of the twins.
fn twins(night: &Night) -> Option<(String, Importance)> {
    let twins = night.twins.as_ref()?;
    let (pool, runs) = (&twins["pool"], rows(twins, "runs"));
    let of_run = match night.run {
        Some(run) => runs.iter().find(|of_run| of_run["run"] == run.to_string()),
        None => runs.first(),
    };
    let pending = of_run.map(|of_run| format!("{} pending", count_or_dash(&of_run["pending"])));
    let fvu = pool["rolling"]["median_fvu"].as_f64().map(|fvu| format!("rolling FVU {fvu:.3}"));
    let error = pool["last_error"].as_str().map(one_line);
    let level = match pool["rolling"]["level"].as_str() {
        Some("suspend") => Act,
        Some("warn") => Look,
        _ if error.is_some() => Look,
        _ => Routine,
    };
    let parts: Vec<String> = [pending, fvu, error].into_iter().flatten().collect();
    (!parts.is_empty()).then(|| (parts.join(", "), level))
}

fn suspender_words(suspender: &Suspender, now: &Now) -> String {
    let shown = |value: f64| match suspender.unit.as_str() {
        // Of a ratio.
        "" | "1" => number(value),
        "bytes" => bytes(value),
        _ => format!("{value:.0}"),
    };
    let unit = match suspender.unit.as_str() {
        "" | "1" | "bytes" => String::new(),
        unit => format!(" {unit}"),
    };
    let value = suspender.value.map_or_else(|| "-".into(), shown);
    let threshold = shown(suspender.threshold);
    let since = suspender
        .since
        .map_or_else(String::new, |at| format!(", since {}", now.clock(at, "%H:%M")));
    one_line(&format!("{value} of {threshold}{unit}{since}"))
}

/// A number with about three digits.
fn number(value: f64) -> String {
    match value.abs() {
        1e6.. => format!("{value:.2e}"),
        100.0.. => format!("{value:.0}"),
        10.0.. => format!("{value:.1}"),
        _ => format!("{value:.3}"),
    }
}

/// A name that leaves room for a value, and the words; the rest of a longer name precedes them.
fn named(name: &str, words: String) -> (String, String) {
    let name = one_line(&name.replace('_', " "));
    match name.split_once(' ') {
        Some((first, rest)) if name.chars().count() >= NAME_COLUMNS => {
            (first.chars().take(NAME_COLUMNS - 1).collect(), format!("{rest} {words}"))
        }
        _ => (name.chars().take(NAME_COLUMNS - 1).collect(), words),
    }
}

/// Returns the line of an event: its time and its words, coloured by level.
pub fn event(told: &Told, now: &Now, theme: Theme) -> Line<'static> {
    let at = told.at.map_or_else(String::new, |at| now.clock(at, "%H:%M:%S"));
    let style = match told.level {
        // A past trip is no present one: only the line above the map asks for an action.
        Act => theme.level(Look),
        level => theme.level(level),
    };
    let time = Span::styled(format!(" {at}  "), theme.aside());
    Line::from(vec![time, Span::styled(told.words.clone(), style)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_and_values_read_well() {
        assert_eq!([0.0942, 12.34, 1234.5].map(number), ["0.094", "12.3", "1234"]);
    }

    #[test]
    fn the_end_of_a_run_names_its_day_if_it_is_another_one() {
        let at: Timestamp = "2026-03-01T20:00:00Z".parse().unwrap();
        let now = Now { at, zone: TimeZone::UTC };
        let eta = Eta { remaining_s: 7380.0, low_s: 7000.0, high_s: 8000.0 };
        let words = eta_words(&eta, at, &now);
        assert_eq!(words, "done 22:03 (21:56 .. 22:13), in 2 h 3 min");
        let eta = Eta { remaining_s: 36_000.0, ..eta };
        assert!(eta_words(&eta, at, &now).starts_with("done Mon 06:00 ("));
    }
}
