//! Figures of a calibration: data, fit and bands, as SVG text.
//! PURE. Uses: plotters, `figure`. Never: files, fitting.

use plotters::prelude::*;

use super::CalibrateError;
use super::foam::{FittedRow, FoamFit};
use super::piezo::PiezoFit;
use crate::figure::style::{AxesStyle, COLOURS, INK, dash, decade, framed, legend, plain};
use crate::figure::{Area, Drawn, Heading, PageSize, figure, with_n};

const FIT_SIZE: PageSize = PageSize { width_px: 860, height_px: 520 };
const FIT: RGBColor = COLOURS[1];
const CURVE_STEPS: u32 = 200;

/// Draws Eq. 1 over a compression test: as Fig. 5, resistance on a logarithmic axis.
///
/// # Errors
/// `CalibrateError::Plot` if the plotting backend fails.
pub fn piezo(fit: &PiezoFit) -> Result<String, CalibrateError> {
    figure(FIT_SIZE, &piezo_heading(fit), |area| draw_piezo(area, fit))
        .map_err(CalibrateError::Plot)
}

fn piezo_heading(fit: &PiezoFit) -> Heading {
    let c = &fit.calibration;
    let tail = c.c_ohm.map_or("c not fitted".into(), |c| format!("c = {:.2e} ohm", c.value));
    let note =
        format!("Fit: a = {:.2e} ohm, b = {:.3} /mm, {tail}", c.a_ohm.value, c.b_per_mm.value);
    let title = "Resistance of the compressed foam, and Eq. 1 fitted";
    Heading::new(title, fit.rows.len() as u64, "rows", fit.label.as_str()).with_note(note)
}

fn draw_piezo(area: &Area<'_>, fit: &PiezoFit) -> Drawn {
    let [least, most] = fit.calibration.compression_mm;
    let at = |n: u32| least + (most - least) * f64::from(n) / f64::from(CURVE_STEPS);
    let bands: Vec<_> = (0..=CURVE_STEPS).map(|n| (at(n), fit.band(at(n)))).collect();
    let measured = fit.rows.iter().map(|r| r.resistance_ohm);
    let ends = bands.iter().flat_map(|(_, b)| b.measurement_ohm);
    let (low, high) = measured.chain(ends).fold((f64::MAX, 0f64), |(l, h), v| (l.min(v), h.max(v)));
    let mut chart = framed(area, [14, 48, 84])
        .build_cartesian_2d(0.0..most * 1.03, (low / 1.5..high * 1.5).log_scale())?;
    chart.configure_mesh().named("compression (mm)", &plain, "resistance (ohm)", &decade).draw()?;
    let ring = |ends: &dyn Fn(usize) -> [f64; 2]| -> Vec<(f64, f64)> {
        let upper = bands.iter().enumerate().map(|(n, (x, _))| (*x, ends(n)[1]));
        let lower = bands.iter().enumerate().rev().map(|(n, (x, _))| (*x, ends(n)[0]));
        upper.chain(lower).collect()
    };
    for (name, opacity, ring) in [
        ("95 % of further measurements", 0.12, ring(&|n| bands[n].1.measurement_ohm)),
        ("95 % confidence of the curve", 0.35, ring(&|n| bands[n].1.curve_ohm)),
    ] {
        let style = FIT.mix(opacity).filled();
        chart
            .draw_series(std::iter::once(Polygon::new(ring, style)))?
            .label(name)
            .legend(move |(x, y)| Rectangle::new([(x, y - 5), (x + 18, y + 5)], style));
    }
    let curve = bands.iter().map(|(x, band)| (*x, band.middle_ohm));
    chart
        .draw_series(LineSeries::new(curve, FIT.stroke_width(2)))?
        .label("Eq. 1")
        .legend(dash(FIT));
    let dots = fit.rows.iter().map(|r| dot(r.displacement_mm, r.resistance_ohm, INK));
    chart
        .draw_series(dots)?
        .label("rows of the table")
        .legend(|(x, y)| Circle::new((x + 9, y), 3, INK.mix(0.7).filled()));
    legend(&mut chart, SeriesLabelPosition::UpperRight)
}

fn dot(x: f64, y: f64, colour: RGBColor) -> Circle<(f64, f64), i32> {
    Circle::new((x, y), 3, colour.mix(0.7).filled())
}

/// Draws displacement over force: data, and the fitted lines of the tip and of gauges by distance.
///
/// # Errors
/// `CalibrateError::Plot` if the plotting backend fails.
pub fn foam(fit: &FoamFit) -> Result<String, CalibrateError> {
    figure(FIT_SIZE, &foam_heading(fit), |area| draw_foam(area, fit)).map_err(CalibrateError::Plot)
}

fn foam_heading(fit: &FoamFit) -> Heading {
    let c = &fit.calibration;
    let fabric = if c.fabric_factor.is_some() { "fitted" } else { "not fitted" };
    let note = format!(
        "Fit: foam {:.4} MPa, fabrics {:.3} and {:.3} MPa ({fabric}). Lines: fit; bands: 95 % of further measurements; dots: rows of the table",
        c.foam_mpa.value, c.bottom_mpa, c.top_mpa
    );
    let title = "Displacement of the skin by a force, and the moduli fitted";
    Heading::new(title, fit.rows.len() as u64, "rows", fit.label.as_str()).with_note(note)
}

fn draw_foam(area: &Area<'_>, fit: &FoamFit) -> Drawn {
    let measured = fit.rows.iter().map(|r| r.measured.displacement_mm);
    let fitted = fit.rows.iter().map(|r| r.fitted_mm);
    let (low, high) = measured.chain(fitted).fold((0f64, 0f64), |(l, h), v| (l.min(v), h.max(v)));
    let most_n = fit.calibration.force_n;
    let mut chart =
        framed(area, [14, 48, 70]).build_cartesian_2d(0.0..most_n * 1.05, low * 1.1..high * 1.1)?;
    chart
        .configure_mesh()
        .named("force on the tip (N)", &plain, "displacement (mm)", &plain)
        .draw()?;
    for (n, (name, rows)) in series(fit).into_iter().enumerate() {
        let colour = COLOURS[1 + n % (COLOURS.len() - 1)];
        // The model is a line through the origin, and its uncertainty a wedge.
        let per_n = |value: fn(&FittedRow) -> f64| {
            rows.iter().map(|r| value(r) / r.measured.force_n).sum::<f64>() / rows.len() as f64
        };
        let (slope, sd) = (per_n(|r| r.fitted_mm), per_n(|r| r.fitted_sd_mm));
        let edge = |sign: f64| {
            (0..=CURVE_STEPS).map(move |k| {
                let force_n = most_n * f64::from(k) / f64::from(CURVE_STEPS);
                let half = fit.t_95 * (sd * force_n).hypot(fit.residual_sd_mm);
                (force_n, slope * force_n + sign * half)
            })
        };
        let inside = edge(1.0).chain(edge(-1.0).collect::<Vec<_>>().into_iter().rev());
        let inside = inside.map(|(x, y)| (x, y.clamp(low * 1.1, high * 1.1)));
        let band = Polygon::new(inside.collect::<Vec<_>>(), colour.mix(0.16).filled());
        chart.draw_series(std::iter::once(band))?;
        chart
            .draw_series(LineSeries::new(
                [(0.0, 0.0), (most_n, slope * most_n)],
                colour.stroke_width(2),
            ))?
            .label(name)
            .legend(dash(colour));
        let dots = rows.iter().map(|r| dot(r.measured.force_n, r.measured.displacement_mm, colour));
        chart.draw_series(dots)?;
    }
    legend(&mut chart, SeriesLabelPosition::UpperLeft)
}

/// Rows of the tip, then those of gauges by distance (to a millimetre), each with its name.
fn series(fit: &FoamFit) -> Vec<(String, Vec<FittedRow>)> {
    let mut distances: Vec<Option<i64>> = fit.rows.iter().map(whole_mm).collect();
    distances.sort_unstable();
    distances.dedup();
    let named = |distance: Option<i64>| {
        let rows: Vec<FittedRow> =
            fit.rows.iter().filter(|r| whole_mm(r) == distance).copied().collect();
        let name = distance.map_or("tip".into(), |mm| format!("gauge at {mm} mm"));
        (with_n(&name, rows.len() as u64), rows)
    };
    distances.into_iter().map(named).collect()
}

fn whole_mm(row: &FittedRow) -> Option<i64> {
    row.distance_mm.map(|mm| mm.round() as i64)
}
