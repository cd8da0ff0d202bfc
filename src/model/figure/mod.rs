//! The frame of every figure: a white page as SVG text, with title, label and n above the drawing.
//! PURE. Uses: plotters (SVG), `plain` (counts). Never: files, a figure without title, label and n.
//!
//! `style`: fonts, colours, legends. `skin`: the outline of a skin. `tour`: a plan on the skin. `series`:
//! bars, lines and dots.

use std::error::Error;

use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

pub mod style;
pub mod skin;
pub mod tour;
pub mod series;

use style::{FONT, INK};

use crate::plain::{counted, grouped};

/// The part of a page below its heading, or a part of it.
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// A chart whose axes are numbers.
pub type NumberChart<'a, 'b> =
    ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Result of drawing: what was drawn, or the error of the plotting backend.
pub type Drawn<T = ()> = Result<T, Box<dyn Error>>;

/// Size of a drawing; the heading adds to its height.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PageSize {
    /// Width, px.
    pub width_px: u32,
    /// Height without the heading, px.
    pub height_px: u32,
}

/// What a figure shows: the lines above its drawing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Heading {
    /// Title: what is shown, without a final full stop.
    pub title: String,
    /// Number of the shown things.
    pub n: u64,
    /// The shown things, plural: `trials`.
    pub of: String,
    /// Origin of the data: `measured`, `virtual`, `simulated`, or `planned`.
    pub label: String,
    /// How to read the figure; empty if it needs no words.
    pub note: String,
}

/// Left edge of the heading, px.
const LEFT: i32 = 20;
/// Height above the first line, px.
const ABOVE: i32 = 14;
/// Font size of the title in plotters' unit, height of a line and width of an average character, px.
const TITLE: (i32, i32, u32) = (24, 28, 10);
/// The same of the lines below the title.
const NOTE: (i32, i32, u32) = (18, 20, 7);

impl Heading {
    /// A heading without a note.
    pub fn new(title: impl Into<String>, n: u64, of: &str, label: &str) -> Self {
        let (title, of, label) = (title.into(), of.into(), label.into());
        Self { title, n, of, label, note: String::new() }
    }

    /// The heading with a note on how to read the figure.
    #[must_use]
    pub fn with_note(self, note: impl Into<String>) -> Self {
        Self { note: note.into(), ..self }
    }

    /// The heading of another quantity of the same things.
    #[must_use]
    pub fn titled(&self, title: impl Into<String>) -> Self {
        Self { title: title.into(), ..self.clone() }
    }

    /// Label, n and note as one text: `virtual, n = 12 trials. Dots: ..`
    fn below(&self) -> String {
        let label = if self.label.is_empty() { "no label" } else { &self.label };
        let note = if self.note.is_empty() { String::new() } else { format!(". {}", self.note) };
        format!("{label}, n = {}{note}", counted(self.n, singular(&self.of), &self.of))
    }

    /// Lines of the title, and lines below it, on a page of this width.
    fn lines(&self, width_px: u32) -> [Vec<String>; 2] {
        let room = width_px.saturating_sub(2 * LEFT.unsigned_abs());
        let most = |(_, _, character_px): (i32, i32, u32)| (room / character_px) as usize;
        [wrapped(&self.title, most(TITLE)), wrapped(&self.below(), most(NOTE))]
    }
}

/// A name in a figure with the number of things that it covers: `1 contact, n = 1,171`.
pub fn with_n(name: &str, n: u64) -> String {
    format!("{name}, n = {}", grouped(n))
}

/// A plural in `s` as a singular: `trials`, `presses`.
fn singular(plural: &str) -> &str {
    let stem = plural.strip_suffix("es").filter(|stem| stem.ends_with("ss"));
    stem.or(plural.strip_suffix('s')).unwrap_or(plural)
}

/// Divides a text at its spaces into lines of at most `most` characters; a longer word has its own line.
fn wrapped(text: &str, most: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= most => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.into()),
        }
    }
    lines
}

/// Draws a heading and a figure on a white page, and returns its SVG text. `draw` gets the page
/// below the heading.
///
/// # Errors
/// The text of the error that `draw` or the plotting backend returns.
pub fn figure(
    size: PageSize,
    heading: &Heading,
    draw: impl FnOnce(&Area<'_>) -> Drawn,
) -> Result<String, String> {
    let [title, notes] = heading.lines(size.width_px);
    let top_px = ABOVE + TITLE.1 * title.len() as i32 + NOTE.1 * notes.len() as i32 + 6;
    let whole = (size.width_px, size.height_px + top_px.unsigned_abs());
    let mut svg = String::new();
    {
        let page = SVGBackend::with_string(&mut svg, whole).into_drawing_area();
        let title_style = (FONT, TITLE.0).into_font().style(FontStyle::Bold).color(&INK);
        let note_style = (FONT, NOTE.0).into_font().color(&INK.mix(0.75));
        let drawn = || -> Drawn {
            page.fill(&WHITE)?;
            let mut y = ABOVE;
            for line in &title {
                page.draw(&Text::new(line.as_str(), (LEFT, y), &title_style))?;
                y += TITLE.1;
            }
            for line in &notes {
                page.draw(&Text::new(line.as_str(), (LEFT, y), &note_style))?;
                y += NOTE.1;
            }
            let (_, below) = page.split_vertically(top_px);
            draw(&below)?;
            page.present()?;
            Ok(())
        };
        drawn().map_err(|error| error.to_string())?;
    }
    Ok(svg)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_figure_states_title_label_and_n() {
        let heading =
            Heading::new("Force over depth", 1171, "trials", "virtual").with_note("Dots: 1");
        let size = PageSize { width_px: 400, height_px: 100 };
        let svg = figure(size, &heading, |_| Ok(())).unwrap();
        assert!(svg.contains("Force over depth"), "{svg}");
        assert!(svg.contains("virtual, n = 1,171 trials. Dots: 1"), "{svg}");
        assert_eq!(with_n("1 contact", 33_000), "1 contact, n = 33,000");
        assert!(svg.starts_with("<svg width=\"400\" height=\"168\""), "{svg}");
    }

    #[test]
    fn long_headings_are_divided_at_spaces() {
        assert_eq!(wrapped("one two three", 7), ["one two", "three"]);
        assert_eq!(wrapped("unbreakable a", 3), ["unbreakable", "a"]);
        assert_eq!(wrapped("", 3), [""; 0]);
    }

    #[test]
    fn one_thing_is_singular() {
        assert_eq!(["trials", "reference presses"].map(singular), ["trial", "reference press"]);
    }
}
