//! A white page to draw on, as SVG text.
//! PURE. Uses: plotters (SVG). Never: files, axes, styles of one figure.

use std::error::Error;

use plotters::coord::Shift;
use plotters::prelude::*;

/// The page, or a part of it.
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Size of a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PageSize {
    /// Width, px.
    pub width_px: u32,
    /// Height, px.
    pub height_px: u32,
}

/// Draws on a white page and returns its SVG text.
///
/// # Errors
/// The text of the error that `draw` or the plotting backend returns.
pub fn page(
    size: PageSize,
    draw: impl FnOnce(&Area<'_>) -> Result<(), Box<dyn Error>>,
) -> Result<String, String> {
    let mut svg = String::new();
    {
        let area =
            SVGBackend::with_string(&mut svg, (size.width_px, size.height_px)).into_drawing_area();
        let drawn = area
            .fill(&WHITE)
            .map_err(Into::into)
            .and_then(|()| draw(&area))
            .and_then(|()| area.present().map_err(Into::into));
        drawn.map_err(|error: Box<dyn Error>| error.to_string())?;
    }
    Ok(svg)
}
