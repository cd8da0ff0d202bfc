//! Draws the screen from its plain state.
//! PURE. Uses: ratatui, `night`, `facts`, `skin`. Never: HTTP, a clock, the real terminal.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::Modifier;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Borders, Gauge, Paragraph, Wrap};

use super::facts::{self, Now};
use super::night::Night;
use super::skin;
use super::theme::Theme;
use crate::campaign::shown::status::RigStatus;
use crate::cli::output::filled;
use crate::event::Importance::{Act, Look, Notable, Routine};
use crate::record::ARMS;

/// Keys, for the last line.
const KEYS_HELP: &str = " q quit   p pause   r resume   E emergency stop ";
/// Least width of the map, for its legend, if half of the screen is that wide.
const MAP_COLUMNS_MIN: u16 = 36;
/// Room for the number of a bar.
const NUMBER: u16 = 9;

/// Draws the whole screen.
pub fn draw(frame: &mut Frame, night: &Night, now: &Now, theme: Theme) {
    let area = frame.area();
    let events_rows = (area.height / 4).clamp(3, 12);
    let [head, progress, first, middle, events, foot] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(1),
        Constraint::Length(first_rows(night, area)),
        Constraint::Min(3),
        Constraint::Length(events_rows),
        Constraint::Length(1),
    ])
    .areas(area);
    let map_columns = map_columns(middle);
    let [map, side] = Layout::horizontal([Constraint::Length(map_columns), Constraint::Fill(1)])
        .spacing(2)
        .areas(middle);
    let [forces, facts] =
        Layout::vertical([Constraint::Length(ARMS as u16 + 1), Constraint::Min(0)]).areas(side);
    frame.render_widget(facts::header(night, theme), head);
    draw_progress(frame, progress, night, now, theme);
    draw_first(frame, first, night, theme);
    skin::draw(frame, map, night, theme);
    if let Some(status) = &night.status {
        draw_forces(frame, forces, &status.rig, theme);
        let lines = facts::facts(night, status, now, theme);
        let facts = titled(frame, facts, "night", theme);
        frame.render_widget(Paragraph::new(lines), facts);
    }
    draw_events(frame, events, night, now, theme);
    if night.is_map_old(now.at) {
        frame.buffer_mut().set_style(map, theme.old());
    }
    if let Some(words) = facts::lost(night, now) {
        frame.buffer_mut().set_style(area, theme.old());
        let words = Span::styled(words, theme.level(Act));
        frame.render_widget(ratatui::widgets::Clear, head);
        frame.render_widget(Line::from(words), head);
    }
    draw_foot(frame, foot, night, theme);
}

/// Width of the map: a skin is about as wide as it is high, and a character twice as high as wide.
fn map_columns(middle: Rect) -> u16 {
    (middle.height * 2).max(MAP_COLUMNS_MIN).min(middle.width.saturating_sub(2) / 2)
}

/// Lines of what a person must do: two if it is long.
fn first_rows(night: &Night, area: Rect) -> u16 {
    let (_, words) = night.first();
    let long = words.chars().count() + 14 > usize::from(area.width);
    if long && area.height > 12 { 2 } else { 1 }
}

/// A part of the screen with a title; returns the room below the title.
fn titled(frame: &mut Frame, area: Rect, title: &str, theme: Theme) -> Rect {
    let title = Span::styled(format!(" {title} "), theme.aside());
    let block = Block::new().borders(Borders::TOP).border_style(theme.aside()).title(title);
    let inner = block.inner(area);
    frame.render_widget(block, area);
    inner
}

fn draw_progress(frame: &mut Frame, area: Rect, night: &Night, now: &Now, theme: Theme) {
    let (Some(run), Some(heard_at)) = (night.active(), night.heard_at) else {
        let queued = night.status.as_ref().map_or(0, |status| status.queue_length);
        let words = match queued {
            0 => " no run is active; start one with: palpate run EXPERIMENT.toml",
            _ => " no run is active; runs wait in the queue: palpate queue",
        };
        return frame.render_widget(Line::styled(words, theme.aside()), area);
    };
    let (share, words) = facts::progress(run, heard_at, now);
    let gauge = Gauge::default().ratio(share).label(words).use_unicode(true);
    frame.render_widget(gauge.gauge_style(theme.life()), area);
}

fn draw_first(frame: &mut Frame, area: Rect, night: &Night, theme: Theme) {
    let (level, words) = night.first();
    let name = match level {
        Routine | Notable => Span::styled(" needs you:  ", theme.aside()),
        Look => Span::styled(" look:  ", theme.level(level)),
        Act => Span::styled(" FIRST:  ", theme.level(level)),
    };
    let line = Line::from(vec![name, Span::styled(words, theme.level(level))]);
    frame.render_widget(Paragraph::new(line).wrap(Wrap { trim: false }), area);
}

/// One bar per arm, from 0 to the limit of one cell.
fn draw_forces(frame: &mut Frame, area: Rect, rig: &RigStatus, theme: Theme) {
    let limit_n = rig.force_limit_n.filter(|limit_n| *limit_n > 0.0);
    let limit = limit_n.map_or_else(String::new, |limit_n| format!(", limit {limit_n:.0} N"));
    let area = titled(frame, area, &format!("forces{limit}"), theme);
    for (arm, row) in (0..ARMS).zip(area.rows()) {
        let [name, bar, number] = Layout::horizontal([
            Constraint::Length(2),
            Constraint::Fill(1),
            Constraint::Length(NUMBER),
        ])
        .areas(row);
        let force_n = rig.forces_n.get(arm).copied().flatten();
        let share = force_n.zip(limit_n).map_or(0.0, |(force_n, limit_n)| force_n / limit_n);
        let tip = rig.tips.is_some_and(|tips| arm < usize::from(tips));
        let style =
            if tip { theme.level(Routine).add_modifier(Modifier::BOLD) } else { theme.aside() };
        frame.render_widget(Line::styled((arm + 1).to_string(), style), name);
        frame.render_widget(Line::styled(filled(share, bar.width.into()), theme.force(share)), bar);
        let words = force_n.map_or("-".into(), |force_n| format!("{force_n:.1} N"));
        let style = if share >= 1.0 { theme.level(Act) } else { theme.level(Routine) };
        frame.render_widget(Line::styled(words, style).right_aligned(), number);
    }
}

/// The last events, the newest at the bottom.
fn draw_events(frame: &mut Frame, area: Rect, night: &Night, now: &Now, theme: Theme) {
    let area = titled(frame, area, "events", theme);
    let newest = night.events.iter().rev().take(usize::from(area.height));
    let mut lines: Vec<Line> = newest.map(|told| facts::event(told, now, theme)).collect();
    lines.reverse();
    frame.render_widget(Paragraph::new(lines), area);
}

/// The keys, or the outcome of the last one.
fn draw_foot(frame: &mut Frame, area: Rect, night: &Night, theme: Theme) {
    let line = match &night.outcome {
        Some(words) => Line::styled(format!(" {words}"), theme.level(Look)),
        None => Line::styled(KEYS_HELP, theme.aside()),
    };
    frame.render_widget(line, area);
}
