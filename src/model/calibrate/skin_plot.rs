//! Figure of a calibrated skin: fields over the skin, fitted and nominal positions of the
//! electrodes, and FVU of held-out trials before and after; SVG text.
//! PURE. Uses: plotters, `figure`, `calibrate::skin`. Never: files, fitting.

use plotters::prelude::*;
use sim_core::sensor::Sensor;
use sim_core::skin::SkinField;
use sim_core::stats::sorted;

use super::CalibrateError;
use super::skin::CalibratedSkin;
use crate::figure::skin::Outline;
use crate::figure::style::{
    AxesStyle, COLOURS, INK, SMALL, dash, diverging, framed, legend, plain, whole,
};
use crate::figure::{Area, Drawn, Heading, PageSize, figure, with_n};
use crate::plain::grouped;

/// Width of the skin in a panel, px.
const SKIN_PX: u32 = 350;
const BEFORE: RGBColor = COLOURS[5];
const AFTER: RGBColor = COLOURS[1];
/// Number of patches across the skin.
const PATCHES: usize = 54;

/// Draws six panels: ln a, ln compliance, ln sheet conductance, ln b, ln c, and the held-out
/// trials.
///
/// # Errors
/// `CalibrateError::Plot` if the plotting backend fails.
pub fn skin(sensor: &Sensor, fitted: &CalibratedSkin) -> Result<String, CalibrateError> {
    let evidence = &fitted.skin.evidence;
    let title = format!(
        "Skin fitted to run {}: held-out FVU {:.3} -> {:.3} (median)",
        evidence.run, evidence.before.median, evidence.after.median
    );
    let along = fitted.skin.fields.ln_sheet_anisotropy.exp();
    let note = format!(
        "Fields: logarithm of the fitted over the nominal value, white 0; rings: nominal electrodes, dots: fitted ones; \
         the sheet conducts {along:.2} times as well along x as along y"
    );
    let heading = Heading::new(title, evidence.trials as u64, "trials", &evidence.label);
    let heading = heading.with_note(note);
    let panel = Outline::of(sensor).panel(SKIN_PX);
    let size = PageSize { width_px: 3 * panel.width_px, height_px: 2 * panel.height_px };
    figure(size, &heading, |area| draw(area, sensor, fitted)).map_err(CalibrateError::Plot)
}

fn draw(area: &Area<'_>, sensor: &Sensor, fitted: &CalibratedSkin) -> Drawn {
    let panels = area.split_evenly((2, 3));
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
) -> Drawn {
    let (width, height) = (sensor.file.width_mm, sensor.file.height_mm);
    let end = field.values.iter().fold(0.01, |end: f64, v| end.max(v.abs()));
    let caption = format!("{name}: full colour at -{end:.2} and +{end:.2}");
    let outline = Outline::of(sensor);
    let mut chart = outline.chart(area, &caption)?;
    let side = [width / PATCHES as f64, height / PATCHES as f64];
    let patches = (0..PATCHES * PATCHES).map(|i| {
        let low = [side[0] * (i % PATCHES) as f64, side[1] * (i / PATCHES) as f64];
        let value = field.at(sensor, [low[0] + side[0] / 2.0, low[1] + side[1] / 2.0]);
        let corners = [(low[0], low[1]), (low[0] + side[0], low[1] + side[1])];
        Rectangle::new(corners, diverging(value / end).filled())
    });
    chart.draw_series(patches)?;
    let corners = [(0.0, 0.0), (width, height)];
    chart.draw_series([Rectangle::new(corners, INK.stroke_width(2))])?;
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
fn distributions(area: &Area<'_>, fitted: &CalibratedSkin) -> Drawn {
    let above_0 = |fvus: &[f64]| sorted(fvus.iter().copied().filter(|v| *v > 0.0));
    let (before, after) = (above_0(&fitted.before), above_0(&fitted.after));
    let ends =
        |of: fn(f64, f64) -> f64, start: f64| before.iter().chain(&after).copied().fold(start, of);
    let (low, high) = (ends(f64::min, 0.1), ends(f64::max, 1.0));
    let counts = with_n("held-out trials", before.len() as u64);
    let mut chart = framed(area, [12, 46, 58])
        .caption(format!("{counts} and {}", grouped(after.len() as u64)), SMALL)
        .build_cartesian_2d((low..high).log_scale(), 0.0..100.0)?;
    chart
        .configure_mesh()
        .named("FVU", &plain, "share of trials below (%)", &whole)
        .axis_desc_style(SMALL)
        .draw()?;
    for (name, fvus, colour) in [("before", &before, BEFORE), ("after", &after, AFTER)] {
        let share = |n: usize| 100.0 * (n + 1) as f64 / fvus.len() as f64;
        let line = fvus.iter().enumerate().map(|(n, &fvu)| (fvu, share(n)));
        chart
            .draw_series(LineSeries::new(line, colour.stroke_width(2)))?
            .label(name)
            .legend(dash(colour));
    }
    legend(&mut chart, SeriesLabelPosition::UpperLeft)
}
