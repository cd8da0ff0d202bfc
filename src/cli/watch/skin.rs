//! The map of the skin, to scale: outline, electrodes, configurations, tips of the current one.
//! PURE. Uses: ratatui's canvas, `night`. Never: HTTP.

use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::canvas::{Canvas, Circle, Context, Line as Stroke, Points};
use ratatui::widgets::{Block, Borders, Paragraph, Wrap};

use super::night::{Mark, Night};
use super::theme::Theme;

/// Skin without a sensor file of the service, mm: the paper's.
const WIDTH_MM: f64 = 540.0;
const HEIGHT_MM: f64 = 560.0;
/// Diameter of a tip without a sensor file of the service, mm.
const TIP_MM: f64 = 20.0;
/// Room around the outline, mm.
const OUTLINE_ROOM_MM: f64 = 8.0;
/// Dots of a character cell, along a line and along a column.
const DOTS: (f64, f64) = (2.0, 4.0);

/// A skin for drawing.
struct Shape {
    width_mm: f64,
    height_mm: f64,
    corners: Vec<[f64; 2]>,
    electrodes: Vec<(f64, f64)>,
    tip_mm: f64,
}

impl Shape {
    fn of(night: &Night) -> Self {
        let skin = night.skin.as_ref();
        let (width_mm, height_mm) =
            skin.map_or((WIDTH_MM, HEIGHT_MM), |skin| (skin.width_mm, skin.height_mm));
        let rectangle =
            || vec![[0.0, 0.0], [width_mm, 0.0], [width_mm, height_mm], [0.0, height_mm]];
        let outline = skin.and_then(|skin| skin.outline_mm.clone());
        let electrodes = skin.map(|skin| skin.electrodes.as_slice()).unwrap_or_default();
        Self {
            width_mm,
            height_mm,
            corners: outline.filter(|corners| corners.len() > 2).unwrap_or_else(rectangle),
            electrodes: electrodes.iter().map(|at| (at.x_mm, at.y_mm)).collect(),
            tip_mm: skin.map_or(TIP_MM, |skin| skin.tip_diameter_mm),
        }
    }
}

/// Draws the map with its legend.
pub fn draw(frame: &mut Frame, area: Rect, night: &Night, theme: Theme) {
    let title = Span::styled(" skin ", theme.aside());
    let block = Block::new().borders(Borders::TOP).border_style(theme.aside()).title(title);
    let inner = block.inner(area);
    frame.render_widget(block, area);
    if inner.is_empty() {
        return;
    }
    let Some(tour) = &night.tour else {
        let words = match night.run {
            Some(_) => "no map: the service states no tour of this run",
            None => "no run is active",
        };
        let words = Paragraph::new(words).style(theme.aside()).wrap(Wrap { trim: true });
        return frame.render_widget(words, inner);
    };
    let marks = night.marks();
    let legend = legend_of(&marks, inner.width, theme);
    let legend_rows = (legend.len() as u16).min(inner.height / 4);
    let map = Rect { height: inner.height - legend_rows, ..inner };
    let below = Rect { y: map.bottom(), height: legend_rows, ..inner };
    let shape = Shape::of(night);
    let (x_mm, y_mm) = bounds(map, shape.width_mm, shape.height_mm);
    let canvas = Canvas::default().marker(Marker::Braille).x_bounds(x_mm).y_bounds(y_mm);
    let canvas =
        canvas.paint(|context| paint(context, &shape, &tour.steps.contacts_mm, &marks, theme));
    frame.render_widget(canvas, map);
    frame.render_widget(Paragraph::new(legend), below);
}

/// Ranges of x and y, mm, that show the skin in the middle of an area, undistorted.
fn bounds(area: Rect, width_mm: f64, height_mm: f64) -> ([f64; 2], [f64; 2]) {
    let dots = (f64::from(area.width) * DOTS.0, f64::from(area.height) * DOTS.1);
    let mm_per_dot = ((width_mm + 2.0 * OUTLINE_ROOM_MM) / dots.0.max(1.0))
        .max((height_mm + 2.0 * OUTLINE_ROOM_MM) / dots.1.max(1.0));
    let range = |middle: f64, dots: f64| {
        let half = dots * mm_per_dot / 2.0;
        [middle - half, middle + half]
    };
    (range(width_mm / 2.0, dots.0), range(height_mm / 2.0, dots.1))
}

fn paint(
    context: &mut Context,
    shape: &Shape,
    contacts_mm: &[Vec<[f64; 2]>],
    marks: &[Mark],
    theme: Theme,
) {
    let outline = theme.outline();
    for (from, to) in shape.corners.iter().zip(shape.corners.iter().cycle().skip(1)) {
        context.draw(&Stroke::new(from[0], from[1], to[0], to[1], outline));
    }
    context.draw(&Points { coords: &shape.electrodes, color: outline });
    // A cell has one colour: what matters more is painted later.
    for mark in [Mark::Later, Mark::Done] {
        let Some(color) = theme.mark(mark) else { continue };
        let coords: Vec<(f64, f64)> =
            of(mark, contacts_mm, marks).filter_map(|contacts| middle(contacts)).collect();
        context.draw(&Points { coords: &coords, color });
        context.layer();
    }
    for mark in [Mark::Failed, Mark::Skipped] {
        for (x, y) in of(mark, contacts_mm, marks).filter_map(|contacts| middle(contacts)) {
            context.print(x, y, symbol(mark, theme));
        }
    }
    for mark in [Mark::Next, Mark::Now] {
        for [x, y] in of(mark, contacts_mm, marks).flatten() {
            if let (Mark::Now, Some(color)) = (mark, theme.mark(mark)) {
                context.draw(&Circle { x: *x, y: *y, radius: shape.tip_mm / 2.0, color });
            }
            context.print(*x, *y, symbol(mark, theme));
        }
    }
}

/// Contacts of the configurations with a mark.
fn of<'a>(
    wanted: Mark,
    contacts_mm: &'a [Vec<[f64; 2]>],
    marks: &'a [Mark],
) -> impl Iterator<Item = &'a Vec<[f64; 2]>> {
    contacts_mm.iter().zip(marks).filter(move |(_, mark)| **mark == wanted).map(|(at, _)| at)
}

/// Middle of the contacts of a configuration, by which the map shows it.
fn middle(contacts: &[[f64; 2]]) -> Option<(f64, f64)> {
    let n = contacts.len() as f64;
    let sum = contacts.iter().fold((0.0, 0.0), |sum, at| (sum.0 + at[0], sum.1 + at[1]));
    (!contacts.is_empty()).then_some((sum.0 / n, sum.1 / n))
}

fn symbol(mark: Mark, theme: Theme) -> Span<'static> {
    let symbol = match mark {
        Mark::Later => "·",
        Mark::Done => "⣿",
        Mark::Failed => "×",
        Mark::Skipped => "/",
        Mark::Next => "○",
        Mark::Now => "●",
    };
    let style = theme.mark(mark).map_or(Style::new(), |color| Style::new().fg(color));
    Span::styled(symbol, style)
}

/// Numbers of configurations by mark, on as few lines as they need.
fn legend_of(marks: &[Mark], width: u16, theme: Theme) -> Vec<Line<'static>> {
    let mut lines = vec![Line::default()];
    for (mark, word) in [
        (Mark::Done, "done"),
        (Mark::Failed, "failed"),
        (Mark::Skipped, "skipped"),
        (Mark::Now, "now"),
        (Mark::Next, "next"),
        (Mark::Later, "later"),
    ] {
        let n = marks.iter().filter(|of| **of == mark).count();
        if n == 0 && mark != Mark::Done {
            continue;
        }
        let words = match mark {
            Mark::Now | Mark::Next => format!(" {word}  "),
            Mark::Done | Mark::Failed | Mark::Skipped | Mark::Later => format!(" {n} {word}  "),
        };
        let entry = [symbol(mark, theme), Span::raw(words)];
        let needed: usize = entry.iter().map(Span::width).sum();
        match lines.last_mut() {
            Some(last) if last.width() + needed <= usize::from(width) => last.extend(entry),
            _ => lines.push(Line::from_iter(entry)),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_skin_is_drawn_to_scale_and_whole() {
        for (width, height) in [(40, 15), (20, 30), (3, 3)] {
            let (x, y) = bounds(Rect::new(0, 0, width, height), 540.0, 560.0);
            let per_column = (x[1] - x[0]) / (f64::from(width) * DOTS.0);
            let per_row = (y[1] - y[0]) / (f64::from(height) * DOTS.1);
            assert!((per_column - per_row).abs() < 1e-9, "{width} x {height}");
            assert!(x[0] <= 0.0 && x[1] >= 540.0 && y[0] <= 0.0 && y[1] >= 560.0);
        }
    }

    #[test]
    fn a_configuration_is_in_the_middle_of_its_contacts() {
        assert_eq!(middle(&[[0.0, 10.0], [20.0, 30.0]]), Some((10.0, 20.0)));
        assert_eq!(middle(&[]), None);
    }
}
