//! Measured frames, their twins and the differences as images: a row of three per trial (Fig. 7A).
//! PURE. Uses: plotters, `figure`, `evaluate::figures` (page). Never: files, a frame that was not
//! measured.

use plotters::prelude::*;
use sim_core::stats::{quantile, sorted};

use super::figures::{FigureResult, page};
use crate::figure::skin::{BAR_PX, colour_bar};
use crate::figure::style::{INK, SMALL, TEXT, TINY, diverging, framed};
use crate::figure::{Area, Drawn, Heading, PageSize};

/// A trial that is shown.
#[derive(Debug, Clone, PartialEq)]
pub struct FramePair {
    /// Line above its images: trial, force, FVU.
    pub name: String,
    /// Measured voltages, V, injection-major.
    pub measured_v: Vec<f32>,
    /// Simulated voltages, V, as many.
    pub simulated_v: Vec<f32>,
}

/// Side of an image, and the size of a panel around it, px.
const IMAGE_PX: u32 = 252;
const PANEL: [u32; 2] = [IMAGE_PX + 66, IMAGE_PX + 82];
/// Height of a trial's name, px.
const NAME_PX: u32 = 30;
/// Share of the readings within the colour scale: single large ones do not flatten the image.
const READINGS_SHARE: f64 = 0.99;

/// Draws trials, one below the other. A frame of 28 x 28 readings has a row per injection. Electrodes are counted from
/// 0, as in tables and messages.
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn frame_pairs(heading: &Heading, pairs: &[FramePair]) -> FigureResult<String> {
    let rows = pairs.len().max(1) as u32;
    let size = PageSize { width_px: 3 * PANEL[0] + BAR_PX, height_px: rows * (PANEL[1] + NAME_PX) };
    let heading = heading.clone().with_note(
        "A row per injecting electrode, a column per reading; the three images of a trial have one \
         colour scale, which holds 99 % of the readings",
    );
    page("frames", size, &heading, |area| {
        for (pair, area) in pairs.iter().zip(area.split_evenly((rows as usize, 1))) {
            draw(&area, pair)?;
        }
        Ok(())
    })
}

fn draw(area: &Area<'_>, pair: &FramePair) -> Drawn {
    let name = TEXT.into_font().style(FontStyle::Bold).color(&INK);
    area.draw(&Text::new(pair.name.as_str(), (20, 8), name))?;
    let (_, below) = area.split_vertically(NAME_PX);
    let (images, bar) = below.split_horizontally(3 * PANEL[0]);
    let differences = pair.measured_v.iter().zip(&pair.simulated_v).map(|(m, s)| m - s);
    let differences: Vec<f32> = differences.collect();
    let both = pair.measured_v.iter().chain(&pair.simulated_v);
    let magnitudes = sorted(both.map(|v| 1e3 * f64::from(v.abs())));
    let end_mv = quantile(&magnitudes, READINGS_SHARE).unwrap_or(0.0).max(1e-3);
    let shown = [
        ("measured", &pair.measured_v),
        ("twin", &pair.simulated_v),
        ("measured - twin", &differences),
    ];
    for ((name, frame), area) in shown.into_iter().zip(images.split_evenly((1, 3))) {
        image(&area, name, frame, end_mv)?;
    }
    colour_bar(&bar, "voltage (mV)", [-end_mv, end_mv], |mv| diverging(mv / end_mv))
}

/// One frame as a square image, or as one row if its readings do not form a square.
fn image(area: &Area<'_>, name: &str, frame: &[f32], end_mv: f64) -> Drawn {
    let side = (frame.len() as f64).sqrt().round() as usize;
    let [rows, columns] = if side * side == frame.len() { [side; 2] } else { [1, frame.len()] };
    let mut chart = framed(area, [8, 40, 50])
        .caption(name, SMALL)
        // The first injection is at the top.
        .build_cartesian_2d(-0.5..columns as f64 - 0.5, rows as f64 - 0.5..-0.5)?;
    chart
        .configure_mesh()
        .disable_mesh()
        .x_labels(6)
        .y_labels(6)
        // Zero has no sign.
        .x_label_formatter(&|v| format!("{:.0}", v + 0.0))
        .y_label_formatter(&|v| format!("{:.0}", v + 0.0))
        .x_desc("reading")
        .y_desc("injection")
        .label_style(TINY)
        .axis_desc_style(SMALL)
        .draw()?;
    chart.draw_series(frame.iter().enumerate().map(|(at, v)| {
        let (x, y) = ((at % columns) as f64, (at / columns) as f64);
        let colour = diverging(1e3 * f64::from(*v) / end_mv);
        Rectangle::new([(x - 0.5, y - 0.5), (x + 0.5, y + 0.5)], colour.filled())
    }))?;
    let edge = [(-0.5, -0.5), (columns as f64 - 0.5, rows as f64 - 0.5)];
    chart.draw_series([Rectangle::new(edge, INK.mix(0.5).stroke_width(1))])?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_reading_is_a_square_of_three_images_and_the_trial_is_named() {
        let frame = |scale: f32| (0..784).map(|n| scale * (n % 28) as f32).collect::<Vec<_>>();
        let pair = FramePair {
            name: "median: trial 17, 1 contact, 22.4 N, FVU 0.12".into(),
            measured_v: frame(0.001),
            simulated_v: frame(0.0009),
        };
        let heading = Heading::new("Frames and twins", 1, "trials", "virtual");
        let svg = frame_pairs(&heading, &[pair]).unwrap();
        assert!(svg.matches("<rect").count() > 3 * 784);
        for text in ["trial 17", "FVU 0.12", "twin", "injection", "voltage (mV)", "n = 1 trial"] {
            assert!(svg.contains(text), "{text}");
        }
        assert!(svg.matches("\n0\n").count() >= 6, "both axes of three images begin at 0");
        assert!(!svg.contains("NaN"));
    }
}
