//! Figure of a calibrated skin: fields over the skin, fitted and nominal positions of the
//! electrodes, and FVU of held-out trials before and after; SVG text.
//! PURE. Uses: plotters, `page`, `calibrate::skin`. Never: files, fitting.

use std::error::Error;

use plotters::prelude::*;
use sim_core::sensor::Sensor;
use sim_core::skin::SkinField;
use sim_core::stats::sorted;

use super::CalibrateError;
use super::page::{Area, PageSize, page};
use super::skin::CalibratedSkin;

const SIZE: PageSize = PageSize { width_px: 1320, height_px: 900 };
const INK: RGBColor = RGBColor(40, 40, 40);
/// Below zero, at zero, above zero (blue, white, red: distinguishable with colour blindness).
const SCALE: [RGBColor; 3] =
    [RGBColor(33, 102, 172), RGBColor(247, 247, 247), RGBColor(178, 24, 43)];
const BEFORE: RGBColor = RGBColor(200, 90, 20);
const AFTER: RGBColor = RGBColor(0, 90, 160);
/// Number of patches across the skin.
const PATCHES: usize = 54;
/// Font of a map's title, with its height in px.
const TITLE: (&str, i32) = ("sans-serif", 17);
const SMALL: (&str, i32) = ("sans-serif", 13);

/// Draws six panels: ln a, ln compliance, ln sheet conductance, ln b, ln c, and the held-out
/// trials.
///
/// # Errors
/// `CalibrateError::Plot` if the plotting backend fails.
pub fn skin(sensor: &Sensor, fitted: &CalibratedSkin) -> Result<String, CalibrateError> {
    page(SIZE, |area| draw(area, sensor, fitted)).map_err(CalibrateError::Plot)
}

fn draw(area: &Area<'_>, sensor: &Sensor, fitted: &CalibratedSkin) -> Result<(), Box<dyn Error>> {
    let evidence = &fitted.skin.evidence;
    let title = format!(
        "Skin fitted to {} trials of run {} ({}): held-out FVU {:.3} -> {:.3} (median)",
        evidence.trials,
        evidence.run,
        evidence.label,
        evidence.before.median,
        evidence.after.median
    );
    let panels = area.titled(&title, ("sans-serif", 20))?.split_evenly((2, 3));
    let fields = &fitted.skin.fields;
    for (panel, (name, field)) in panels.iter().zip([
        ("ln a", &fields.ln_a),
        ("ln compliance", &fields.ln_compliance),
        ("ln sheet conductance", &fields.ln_sheet_conductance),
        ("ln b", &fields.ln_b),
        ("ln c", &fields.ln_c),
    ]) {
        map(panel, sensor, fitted, name, field)?;
    }
    distributions(&panels[5], fitted)
}

/// One field; each electrode is a ring at its nominal position and a line to a dot at the fitted
/// one.
fn map(
    area: &Area<'_>,
    sensor: &Sensor,
    fitted: &CalibratedSkin,
    name: &str,
    field: &SkinField,
) -> Result<(), Box<dyn Error>> {
    let (width, height) = (sensor.file.width_mm, sensor.file.height_mm);
    let end = field.values.iter().fold(0.01, |end: f64, v| end.max(v.abs()));
    let title = format!("{name}: white 0, full colour -{end:.2} and +{end:.2}");
    let mut chart = ChartBuilder::on(area)
        .caption(title, TITLE)
        .margin(12)
        .x_label_area_size(34)
        .y_label_area_size(42)
        .build_cartesian_2d(0.0..width, 0.0..height)?;
    chart
        .configure_mesh()
        .disable_mesh()
        .x_desc("x, mm")
        .y_desc("y, mm")
        .x_label_formatter(&|v| format!("{v:.0}"))
        .y_label_formatter(&|v| format!("{v:.0}"))
        .label_style(SMALL)
        .draw()?;
    let side = [width / PATCHES as f64, height / PATCHES as f64];
    let patches = (0..PATCHES * PATCHES).map(|i| {
        let low = [side[0] * (i % PATCHES) as f64, side[1] * (i / PATCHES) as f64];
        let value = field.at(sensor, [low[0] + side[0] / 2.0, low[1] + side[1] / 2.0]);
        let corners = [(low[0], low[1]), (low[0] + side[0], low[1] + side[1])];
        Rectangle::new(corners, colour(value / end).filled())
    });
    chart.draw_series(patches)?;
    let electrodes = &fitted.skin.electrodes;
    let found = electrodes.x_mm.iter().zip(&electrodes.y_mm).map(|(&x, &y)| (x, y));
    for (&[x, y], (at_x, at_y)) in sensor.electrodes_mm().iter().zip(found) {
        let ring = Circle::new((x, y), 5, INK.mix(0.6).stroke_width(1));
        chart.draw_series([ring])?;
        let moved = PathElement::new([(x, y), (at_x, at_y)], INK.stroke_width(1));
        chart.draw_series([moved])?;
        chart.draw_series([Circle::new((at_x, at_y), 3, INK.filled())])?;
    }
    Ok(())
}

/// Share of the held-out trials below each FVU, before and after.
fn distributions(area: &Area<'_>, fitted: &CalibratedSkin) -> Result<(), Box<dyn Error>> {
    let above_0 = |fvus: &[f64]| sorted(fvus.iter().copied().filter(|v| *v > 0.0));
    let (before, after) = (above_0(&fitted.before), above_0(&fitted.after));
    let ends =
        |of: fn(f64, f64) -> f64, start: f64| before.iter().chain(&after).copied().fold(start, of);
    let (low, high) = (ends(f64::min, 0.1), ends(f64::max, 1.0));
    let mut chart = ChartBuilder::on(area)
        .caption("held-out trials", TITLE)
        .margin(12)
        .x_label_area_size(34)
        .y_label_area_size(48)
        .build_cartesian_2d((low..high).log_scale(), 0.0..100.0)?;
    chart
        .configure_mesh()
        .x_desc("FVU")
        .y_desc("share of trials below, %")
        .x_label_formatter(&|v| format!("{v:.3}"))
        .y_label_formatter(&|v| format!("{v:.0}"))
        .light_line_style(TRANSPARENT)
        .bold_line_style(INK.mix(0.12))
        .label_style(SMALL)
        .draw()?;
    for (name, fvus, colour) in [("before", &before, BEFORE), ("after", &after, AFTER)] {
        let share = |n: usize| 100.0 * (n + 1) as f64 / fvus.len() as f64;
        let line = fvus.iter().enumerate().map(|(n, &fvu)| (fvu, share(n)));
        chart
            .draw_series(LineSeries::new(line, colour.stroke_width(2)))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], colour.stroke_width(3)));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .background_style(WHITE.mix(0.9))
        .border_style(INK.mix(0.3))
        .label_font(TITLE)
        .draw()?;
    Ok(())
}

/// Colour of a value from -1 to 1.
fn colour(value: f64) -> RGBColor {
    let [below, middle, above] = SCALE;
    let end = if value < 0.0 { below } else { above };
    let share = value.abs().min(1.0);
    let mix = |from: u8, to: u8| {
        (f64::from(from) + share * (f64::from(to) - f64::from(from))).round() as u8
    };
    RGBColor(mix(middle.0, end.0), mix(middle.1, end.1), mix(middle.2, end.2))
}
