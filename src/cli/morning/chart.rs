//! Pictures in the terminal: widgets drawn in memory, as lines of text with or without colours.
//! Uses: ratatui. Never: the terminal itself (a picture is printed like any text), HTTP.

use std::io;

use ratatui::backend::CrosstermBackend;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::widgets::{Axis, Chart, Dataset, GraphType};
use ratatui::{Frame, Terminal, TerminalOptions, Viewport};

use crate::api::ForcesAtDepth;
use crate::cli::error::{CliError, CliResult};
use crate::cli::output::{is_coloured, terminal_width};

/// Width without a terminal, characters.
const CHART_WIDTH: u16 = 100;
/// Narrowest and widest picture, characters.
const NARROWEST: u16 = 40;
const WIDEST: u16 = 140;

/// Width of a picture, characters.
pub fn width() -> u16 {
    let found = terminal_width().and_then(|width| u16::try_from(width).ok());
    found.unwrap_or(CHART_WIDTH).clamp(NARROWEST, WIDEST)
}

/// Draws a picture and returns its lines, with colours if standard output shows them.
///
/// # Errors
/// `CliError::System` if it cannot be drawn.
pub fn picture(width: u16, height: u16, draw: impl FnOnce(&mut Frame)) -> CliResult<String> {
    let failed = CliError::system("drawing a picture");
    let viewport = Viewport::Fixed(Rect::new(0, 0, width, height));
    let options = TerminalOptions { viewport };
    let mut terminal =
        Terminal::with_options(CrosstermBackend::new(io::sink()), options).map_err(&failed)?;
    let drawn = terminal.draw(draw).map_err(failed)?;
    Ok(printed(drawn.buffer))
}

/// The lines of a picture, with colours if standard output shows them.
pub fn printed(buffer: &Buffer) -> String {
    lines(buffer, is_coloured())
}

/// The lines of a picture, without blanks at their ends.
fn lines(buffer: &Buffer, coloured: bool) -> String {
    let width = usize::from(buffer.area.width.max(1));
    let line = |cells: &[ratatui::buffer::Cell]| {
        let is_blank = |cell: &ratatui::buffer::Cell| {
            cell.symbol() == " "
                && cell.bg == Color::Reset
                && !cell.modifier.contains(Modifier::REVERSED)
        };
        let end = cells.iter().rposition(|cell| !is_blank(cell)).map_or(0, |last| last + 1);
        let (mut text, mut now) = (String::new(), None);
        for cell in &cells[..end] {
            let style = (cell.fg, cell.bg, cell.modifier.contains(Modifier::BOLD));
            if coloured && now != Some(style) {
                text += &escape(style);
                now = Some(style);
            }
            text += cell.symbol();
        }
        if now.is_some_and(|style| style != (Color::Reset, Color::Reset, false)) {
            text += "\u{1b}[0m";
        }
        text
    };
    let all: Vec<String> = buffer.content.chunks(width).map(line).collect();
    let end = all.iter().rposition(|line| !line.is_empty()).map_or(0, |last| last + 1);
    all[..end].join("\n")
}

/// The escape sequence that begins a style.
fn escape((fg, bg, bold): (Color, Color, bool)) -> String {
    let mut codes = vec!["0".to_owned()];
    if bold {
        codes.push("1".into());
    }
    codes.extend(colour_code(fg, 30));
    codes.extend(colour_code(bg, 40));
    format!("\u{1b}[{}m", codes.join(";"))
}

/// The code of a colour; `base` is 30 for the foreground and 40 for the background.
fn colour_code(colour: Color, base: u8) -> Option<String> {
    let bright = base + 60;
    let plain = |base: u8, n: u8| Some((base + n).to_string());
    match colour {
        Color::Reset => None,
        Color::Rgb(r, g, b) => Some(format!("{};2;{r};{g};{b}", base + 8)),
        Color::Indexed(n) => Some(format!("{};5;{n}", base + 8)),
        Color::Black => plain(base, 0),
        Color::Red => plain(base, 1),
        Color::Green => plain(base, 2),
        Color::Yellow => plain(base, 3),
        Color::Blue => plain(base, 4),
        Color::Magenta => plain(base, 5),
        Color::Cyan => plain(base, 6),
        Color::Gray => plain(base, 7),
        Color::DarkGray => plain(bright, 0),
        Color::LightRed => plain(bright, 1),
        Color::LightGreen => plain(bright, 2),
        Color::LightYellow => plain(bright, 3),
        Color::LightBlue => plain(bright, 4),
        Color::LightMagenta => plain(bright, 5),
        Color::LightCyan => plain(bright, 6),
        Color::White => plain(bright, 7),
    }
}

/// Draws the forces over depth: the median as a line, the quartiles as dots.
pub fn forces(frame: &mut Frame, area: Rect, curve: &[ForcesAtDepth]) {
    let line: Vec<(f64, f64)> = curve.iter().map(|at| (at.depth_mm, at.median_n)).collect();
    let quartiles: Vec<(f64, f64)> =
        curve.iter().flat_map(|at| [(at.depth_mm, at.q1_n), (at.depth_mm, at.q3_n)]).collect();
    let deepest = curve.iter().map(|at| at.depth_mm).fold(0.5, f64::max);
    let top = curve.iter().map(|at| at.q3_n).fold(1.0, f64::max) * 1.05;
    let coloured = is_coloured();
    let style = |colour| if coloured { Style::new().fg(colour) } else { Style::new() };
    let datasets = vec![
        Dataset::default().marker(Marker::Dot).style(style(Color::DarkGray)).data(&quartiles),
        Dataset::default()
            .marker(Marker::Braille)
            .graph_type(GraphType::Line)
            .style(style(Color::Green))
            .data(&line),
    ];
    let labels = |end: f64, digits: usize| {
        [0.0, end / 2.0, end].map(|value| format!("{value:.digits$}")).to_vec()
    };
    let chart = Chart::new(datasets)
        .x_axis(
            Axis::default().title("depth, mm").bounds([0.0, deepest]).labels(labels(deepest, 1)),
        )
        .y_axis(Axis::default().title("N").bounds([0.0, top]).labels(labels(top, 0)))
        .legend_position(None);
    frame.render_widget(chart, area);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::api::forces_by_depth;

    #[test]
    fn a_picture_without_colours_is_plain_text() {
        let mut buffer = Buffer::empty(Rect::new(0, 0, 6, 3));
        buffer.set_string(0, 0, "ab", Style::new().fg(Color::Red));
        buffer.set_string(2, 0, "c", Style::new());
        assert_eq!(lines(&buffer, false), "abc");
        assert_eq!(lines(&buffer, true), "\u{1b}[0;31mab\u{1b}[0mc");
        buffer.set_string(0, 1, " ", Style::new().bg(Color::Rgb(1, 2, 3)));
        assert_eq!(lines(&buffer, true).lines().nth(1), Some("\u{1b}[0;48;2;1;2;3m \u{1b}[0m"));
    }

    #[test]
    fn a_chart_has_its_units() {
        let values = [(0.0, 0.0), (1.0, 10.0), (2.0, 40.0)];
        let curve = forces_by_depth(None, values.into_iter());
        let drawn = picture(60, 12, |frame| forces(frame, frame.area(), &curve)).unwrap();
        assert!(drawn.contains("depth, mm") && drawn.contains("2.0"), "{drawn}");
        assert_eq!(drawn.lines().count(), 12, "{drawn}");
    }
}
