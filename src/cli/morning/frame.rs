//! A frame of voltages as a picture: one pixel per reading, a row per injection, next to its twin.
//! PURE. Uses: ratatui's buffer. Never: HTTP, a value that is not in the frame.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::{Color, Style};
use sim_core::stats::{quantile, sorted};

/// Shades of magnitude, the smallest first.
const SHADES: [char; 8] = [' ', '.', ':', '-', '=', '+', '*', '#'];
/// Share of the values within the scale: single large ones do not flatten the picture.
const VALUES_SHARE: f64 = 0.98;
/// Gap between two pictures, characters.
const GAP: u16 = 3;

/// A frame with its title.
#[derive(Debug, Clone)]
pub struct Picture {
    /// Title, as short as the frame is wide.
    pub title: &'static str,
    /// Voltages, V, injection-major.
    pub voltages_v: Vec<f32>,
    /// Magnitude at the end of the scale, V.
    pub end_v: f64,
}

/// How pixels are shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ink {
    /// Two pixels per character, 24-bit colours.
    Colours,
    /// Two pixels per character, 256 colours.
    Palette,
    /// One pixel per character, shaded by its magnitude.
    Shades,
}

impl Picture {
    /// A picture whose scale holds almost all values.
    pub fn new(title: &'static str, voltages_v: Vec<f32>) -> Self {
        let magnitudes = sorted(voltages_v.iter().map(|v| f64::from(v.abs())));
        let end_v = quantile(&magnitudes, VALUES_SHARE).unwrap_or(0.0).max(1e-9);
        Self { title, voltages_v, end_v }
    }

    fn value(&self, row: usize, column: usize, columns: usize) -> Option<f64> {
        self.voltages_v.get(row * columns + column).map(|v| f64::from(*v) / self.end_v)
    }
}

/// Number of injections and of readings of each: a square frame, or one row.
pub fn shape(channels: usize) -> (usize, usize) {
    let side = (channels as f64).sqrt().round() as usize;
    if side > 0 && side * side == channels { (side, side) } else { (1, channels) }
}

/// Draws pictures next to each other, as many as fit; each has its title above and its scale below.
pub fn draw(pictures: &[Picture], ink: Ink, width: u16) -> Buffer {
    let shapes: Vec<(usize, usize)> = pictures.iter().map(|p| shape(p.voltages_v.len())).collect();
    let rows = shapes.iter().map(|(rows, _)| *rows).max().unwrap_or(0);
    let lines = if ink == Ink::Shades { rows } else { rows.div_ceil(2) } as u16;
    let mut buffer = Buffer::empty(Rect::new(0, 0, width, lines + 2));
    let mut x = 0;
    for (picture, (rows, columns)) in pictures.iter().zip(shapes) {
        let end = x + columns as u16;
        if end > width {
            break;
        }
        buffer.set_stringn(x, 0, picture.title, columns, Style::new());
        for line in 0..lines {
            for column in 0..columns {
                let at = |row: usize| (row < rows).then(|| picture.value(row, column, columns))?;
                let (line_of, x) = (usize::from(line), x + column as u16);
                let cell = &mut buffer[(x, line + 1)];
                if ink == Ink::Shades {
                    cell.set_char(at(line_of).map_or(' ', shade));
                } else if let Some(upper) = at(2 * line_of) {
                    cell.set_char('▀').set_fg(colour(upper, ink));
                    if let Some(lower) = at(2 * line_of + 1) {
                        cell.set_bg(colour(lower, ink));
                    }
                }
            }
        }
        scale(&mut buffer, (x, lines + 1), picture, columns, ink);
        x = end + GAP;
    }
    buffer
}

/// The colour scale with its ends, mV.
fn scale(buffer: &mut Buffer, (x, y): (u16, u16), picture: &Picture, columns: usize, ink: Ink) {
    let end = format!("{:.1}", 1e3 * picture.end_v);
    let (from, to) = match ink {
        Ink::Shades => ("0 ".to_owned(), format!(" {end} mV")),
        Ink::Colours | Ink::Palette => (format!("-{end} "), format!(" +{end} mV")),
    };
    let steps = columns.saturating_sub(from.len() + to.len());
    buffer.set_stringn(x, y, &from, columns, Style::new());
    let first = x + from.len().min(columns) as u16;
    for step in 0..steps {
        let share = step as f64 / (steps.max(2) - 1) as f64;
        let cell = &mut buffer[(first + step as u16, y)];
        match ink {
            Ink::Shades => cell.set_char(shade(share)),
            Ink::Colours | Ink::Palette => {
                cell.set_char('█').set_fg(colour(2.0 * share - 1.0, ink))
            }
        };
    }
    buffer.set_stringn(
        first + steps as u16,
        y,
        &to,
        columns - from.len().min(columns),
        Style::new(),
    );
}

fn shade(value: f64) -> char {
    let step = (value.abs().clamp(0.0, 1.0) * (SHADES.len() - 1) as f64).round() as usize;
    SHADES[step]
}

/// Blue for negative, white for zero, red for positive values; -1 to 1.
fn colour(value: f64, ink: Ink) -> Color {
    // Colours of the palette from blue over white to red, chosen manually: its cube is too coarse to compute.
    const PALETTE: [u8; 9] = [21, 27, 75, 153, 231, 223, 216, 203, 196];
    const BLUE: [f64; 3] = [33.0, 102.0, 172.0];
    const RED: [f64; 3] = [178.0, 24.0, 43.0];
    let value = value.clamp(-1.0, 1.0);
    if ink == Ink::Palette {
        let step = ((value + 1.0) / 2.0 * (PALETTE.len() - 1) as f64).round() as usize;
        return Color::Indexed(PALETTE[step]);
    }
    let end = if value < 0.0 { BLUE } else { RED };
    let mix = |end: f64| (247.0 + (end - 247.0) * value.abs()).round() as u8;
    Color::Rgb(mix(end[0]), mix(end[1]), mix(end[2]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(peak: usize) -> Vec<f32> {
        (0..784).map(|channel| if channel == peak { -0.5 } else { 0.001 }).collect()
    }

    #[test]
    fn a_frame_is_28_by_28_pixels_in_14_lines_of_half_blocks() {
        let mut picture = Picture::new("measured", frame(0));
        picture.end_v = 0.5;
        let buffer = draw(&[picture.clone(), picture], Ink::Colours, 100);
        assert_eq!((buffer.area.width, buffer.area.height), (100, 16));
        let first = &buffer[(0, 1)];
        assert_eq!((first.symbol(), first.fg), ("▀", Color::Rgb(33, 102, 172)));
        assert_eq!(buffer[(31, 1)].fg, Color::Rgb(33, 102, 172), "the twin is next to it");
        assert_eq!(buffer[(28, 1)].symbol(), " ");
        let last: String = (0..28).map(|x| buffer[(x, 15)].symbol().to_owned()).collect();
        assert!(last.starts_with("-500.0 █") && last.ends_with("+500.0 mV"), "{last}");
    }

    #[test]
    fn without_colours_the_magnitude_is_shaded() {
        let mut picture = Picture::new("measured", frame(29));
        picture.end_v = 0.5;
        let buffer = draw(&[picture], Ink::Shades, 40);
        assert_eq!(buffer.area.height, 30);
        assert_eq!(buffer[(1, 2)].symbol(), "#", "injection 1, reading 1");
        assert_eq!(buffer[(0, 1)].symbol(), " ");
    }

    #[test]
    fn a_picture_that_does_not_fit_is_not_drawn_and_an_empty_frame_is_none() {
        let picture = Picture::new("measured", frame(0));
        let buffer = draw(&[picture.clone(), picture], Ink::Palette, 40);
        assert!((31..40).all(|x| buffer[(x, 1)].symbol() == " "));
        assert_eq!(draw(&[], Ink::Colours, 10).area.height, 2);
        assert_eq!((shape(784), shape(16), shape(10)), ((28, 28), (4, 4), (1, 10)));
    }
}
