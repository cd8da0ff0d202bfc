//! A white page to draw on, as SVG text.
//! PURE. Uses: plotters (SVG). Never: files, axes, styles of one figure.

use std::error::Error;

use plotters::coord::Shift;
use plotters::prelude::*;

/// The page, or a part of it.
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Draws on a white page and returns its SVG text. `size`: width and height, px.
///
/// # Errors
/// The text of the error that `draw` or the plotting backend returns.
pub fn page(
    size: (u32, u32),
    draw: impl FnOnce(&Area<'_>) -> Result<(), Box<dyn Error>>,
) -> Result<String, String> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        let drawn = area
            .fill(&WHITE)
            .map_err(Into::into)
            .and_then(|()| draw(&area))
            .and_then(|()| area.present().map_err(Into::into));
        drawn.map_err(|error: Box<dyn Error>| error.to_string())?;
    }
    Ok(svg)
}
