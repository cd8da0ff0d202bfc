//! Force maps and the residuals of a Transfer-Net as pictures. SVG text from numbers.
//! PURE. Uses: plotters, `figure`, `evaluate::figures` (page), `dataset::force_map`. Never: files.

use plotters::prelude::*;
use plotters::style::colors::colormaps::ViridisRGB;

use super::figures::{FigureError, FigureResult, page};
use crate::dataset::force_map::{ForceMap, ForceMapSpec};
use crate::dataset::pressed::as_pressed;
use crate::figure::style::{AxesStyle, COLOURS, SMALL, TINY, dash, framed, legend, plain, whole};
use crate::figure::{Heading, PageSize};
use crate::learn::residuals::Residuals;
use crate::store::Contact;

/// A force map with a name.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Caption of the map.
    pub name: String,
    /// Layout of the map.
    pub spec: ForceMapSpec,
    /// N per pixel, row 0 at the least y.
    pub map: Vec<f32>,
}

impl Picture {
    /// Draws the map of contacts on the paper's skin; those without position or force are skipped.
    ///
    /// # Errors
    /// `FigureError` if a contact is outside the map.
    pub fn of_contacts(name: &str, spec: ForceMapSpec, contacts: &[Contact]) -> FigureResult<Self> {
        let failed = |error: crate::dataset::force_map::ForceMapError| FigureError {
            figure: "force map",
            why: error.to_string(),
        };
        let skin = crate::dataset::read::PAPER_SKIN;
        let draws = ForceMap::new(spec, [skin.width_mm, skin.height_mm]).map_err(failed)?;
        let mut map = vec![0.0; draws.pixels() * draws.pixels()];
        let pressed: Vec<_> = contacts.iter().filter_map(as_pressed).collect();
        draws.render(&pressed, &mut map).map_err(failed)?;
        Ok(Self { name: name.into(), spec, map })
    }
}

/// Draws force maps, `columns` per row, each with its own colour scale (paper, Fig. 10B and 12A).
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn pictures(heading: &Heading, maps: &[Picture], columns: usize) -> FigureResult<String> {
    let columns = columns.max(1);
    let rows = maps.len().div_ceil(columns).max(1);
    page(
        "force maps",
        PageSize { width_px: 320 * columns.max(2) as u32, height_px: 350 * rows as u32 },
        heading,
        |area| {
            for (map, area) in maps.iter().zip(area.split_evenly((rows, columns))) {
                let largest = map.map.iter().copied().fold(1e-6, f32::max);
                let half = map.spec.side_mm / 2.0;
                let mut chart = framed(&area, [8, 42, 52])
                    .caption(format!("{}, to {} N per pixel", map.name, short(largest)), SMALL)
                    .build_cartesian_2d(-half..half, -half..half)?;
                chart
                    .configure_mesh()
                    .disable_mesh()
                    .x_labels(3)
                    .y_labels(3)
                    .x_label_formatter(&whole)
                    .y_label_formatter(&whole)
                    .x_desc("x (mm)")
                    .y_desc("y (mm)")
                    .label_style(TINY)
                    .axis_desc_style(TINY)
                    .draw()?;
                chart.draw_series([Rectangle::new(
                    [(-half, -half), (half, half)],
                    ViridisRGB.get_color(0.0).filled(),
                )])?;
                let (pixels, mm) = (map.spec.pixels(), map.spec.pixel_mm);
                // Pixels of almost zero are the background: pages of 25,600 squares are slow to
                // display.
                let seen = map.map.iter().enumerate().filter(|(_, n)| **n > 0.01 * largest);
                chart.draw_series(seen.map(|(at, newtons)| {
                    let (x, y) =
                        ((at % pixels) as f64 * mm - half, (at / pixels) as f64 * mm - half);
                    let colour = ViridisRGB.get_color(f64::from(newtons / largest));
                    Rectangle::new([(x, y), (x + mm, y + mm)], colour.filled())
                }))?;
            }
            Ok(())
        },
    )
}

/// A number with about three digits.
fn short(value: f32) -> String {
    if value < 0.01 { format!("{value:.1e}") } else { format!("{value:.2}") }
}

/// Draws mean and standard deviation of a Transfer-Net's residuals, by reading (paper, Fig. 10A).
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn residuals(heading: &Heading, of: &Residuals) -> FigureResult<String> {
    let Residuals { mean_v, sd_v, .. } = of;
    let millivolts = |v: f32| 1e3 * f64::from(v);
    let largest = mean_v.iter().zip(sd_v).map(|(m, s)| millivolts(m.abs() + s));
    let most = 1.08 * largest.fold(1e-6, f64::max);
    page("residuals", PageSize { width_px: 1100, height_px: 460 }, heading, |area| {
        let mut chart =
            framed(area, [18, 50, 70]).build_cartesian_2d(0.0..mean_v.len() as f64, -most..most)?;
        chart
            .configure_mesh()
            .named("reading (28 for each injection)", &whole, "transfer error (mV)", &plain)
            .draw()?;
        let spread = mean_v.iter().zip(sd_v).enumerate().map(|(at, (mean, sd))| {
            let x = at as f64 + 0.5;
            let ends = [(x, millivolts(mean - sd)), (x, millivolts(mean + sd))];
            PathElement::new(ends, COLOURS[1].mix(0.5))
        });
        chart.draw_series(spread)?.label("standard deviation").legend(dash(COLOURS[1]));
        let means =
            mean_v.iter().enumerate().map(|(at, mean)| (at as f64 + 0.5, millivolts(*mean)));
        chart
            .draw_series(LineSeries::new(means, COLOURS[5].stroke_width(1)))?
            .label("mean")
            .legend(dash(COLOURS[5]));
        legend(&mut chart, SeriesLabelPosition::UpperRight)
    })
}
