//! The paper's Fig. 7 as pictures: SVG text from numbers.
//! PURE. Uses: plotters, `calibrate::page`, `evaluate::simulation`. Never: files, a number that is
//! not in the report.

use plotters::coord::CoordTranslate;
use plotters::prelude::*;
use plotters::style::colors::colormaps::ViridisRGB;

use crate::calibrate::page::{self, Area, PageSize};

use super::simulation::{BoxPlot, FORCE_END_N, ForceBin, PointFit, SimulationReport};

/// A figure that could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("drawing {figure}: {why}")]
pub struct FigureError {
    /// Name of the figure.
    pub figure: &'static str,
    /// Error of the plotting backend, as text.
    pub why: String,
}

/// Quantity of a fit that is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Root of the mean squared difference, shown in mV.
    Rmse,
    /// Fraction of variance unexplained.
    Fvu,
}

impl Quantity {
    fn axis(self) -> &'static str {
        match self {
            Quantity::Rmse => "RMSE (mV)",
            Quantity::Fvu => "FVU",
        }
    }

    fn of_bin(self, bin: &ForceBin) -> f64 {
        match self {
            Quantity::Rmse => 1e3 * bin.mean_rmse_v,
            Quantity::Fvu => bin.mean_fvu,
        }
    }
}

/// The outline of a skin, for maps.
#[derive(Debug, Clone, PartialEq)]
pub struct Outline {
    /// Width and height, mm.
    pub size_mm: [f64; 2],
    /// Positions of the electrodes, mm.
    pub electrodes_mm: Vec<[f64; 2]>,
    /// Distance between neighbouring points, mm.
    pub pitch_mm: f64,
}

const SIZE: PageSize = PageSize { width_px: 900, height_px: 560 };
pub(super) const TEXT: (&str, i32) = ("sans-serif", 18);
pub(super) const SMALL: (&str, i32) = ("sans-serif", 15);
/// Dark on white, distinguishable with colour blindness (Okabe and Ito), 0 to 6 contacts.
pub(super) const COLOURS: [RGBColor; 7] = [
    RGBColor(120, 120, 120),
    RGBColor(0, 114, 178),
    RGBColor(230, 159, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(213, 94, 0),
    RGBColor(86, 180, 233),
];
/// Bins with fewer trials are not drawn: their mean is not significant.
const FEWEST: u64 = 5;
/// FVU at the upper end of the map's colour scale.
const MAP_END: f64 = 1.0;

/// Draws on a white page and returns its SVG text.
pub(super) fn page(
    figure: &'static str,
    size: PageSize,
    draw: impl FnOnce(&Area<'_>) -> Result<(), Box<dyn std::error::Error>>,
) -> Result<String, FigureError> {
    page::page(size, draw).map_err(|why| FigureError { figure, why })
}

/// Line next to a name in a legend.
pub(super) fn dash(colour: RGBColor) -> impl Fn((i32, i32)) -> PathElement<(i32, i32)> {
    move |(x, y)| PathElement::new([(x, y), (x + 22, y)], colour.stroke_width(3))
}

/// Draws the legend of the named series.
pub(super) fn legend<'a, 'b: 'a, C: CoordTranslate>(
    chart: &mut ChartContext<'a, SVGBackend<'b>, C>,
    position: SeriesLabelPosition,
) -> Result<(), Box<dyn std::error::Error>> {
    chart
        .configure_series_labels()
        .position(position)
        .background_style(WHITE.mix(0.9))
        .border_style(BLACK.mix(0.3))
        .label_font(SMALL)
        .draw()?;
    Ok(())
}

/// Draws means by the largest force of a trial, one line per number of contacts (Fig. 7B, 7E).
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn by_force(report: &SimulationReport, quantity: Quantity) -> Result<String, FigureError> {
    let lines: Vec<(u8, Vec<(f64, f64)>)> = (0..=6)
        .map(|n| {
            let bins = report.by_force.iter().filter(|b| b.contacts == Some(n));
            let drawn = bins.filter(|b| b.trials >= FEWEST);
            (n, drawn.map(|b| (b.from_n + 0.5, quantity.of_bin(b))).collect::<Vec<_>>())
        })
        .filter(|(_, line)| !line.is_empty())
        .collect();
    let top = lines.iter().flat_map(|(_, l)| l).map(|p| p.1).fold(0.0, f64::max);
    page("means by force", SIZE, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(18)
            .x_label_area_size(50)
            .y_label_area_size(70)
            .build_cartesian_2d(0.0..FORCE_END_N, 0.0..(1.08 * top).max(1e-6))?;
        chart
            .configure_mesh()
            .x_label_formatter(&whole)
            .x_desc("largest force (N)")
            .y_desc(quantity.axis())
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.10))
            .label_style(SMALL)
            .axis_desc_style(TEXT)
            .draw()?;
        for (n, line) in lines {
            let colour = COLOURS[usize::from(n)];
            chart
                .draw_series(LineSeries::new(line.clone(), colour.stroke_width(2)))?
                .label(match n {
                    0 => "no contact".to_owned(),
                    1 => "1 contact".to_owned(),
                    n => format!("{n} contacts"),
                })
                .legend(dash(colour));
            chart.draw_series(line.iter().map(|p| Circle::new(*p, 3, colour.filled())))?;
        }
        let position = match quantity {
            Quantity::Rmse => SeriesLabelPosition::UpperLeft,
            Quantity::Fvu => SeriesLabelPosition::UpperRight,
        };
        legend(&mut chart, position)
    })
}

/// Draws boxes by the number of contacts, without outliers (Fig. 7C, 7F).
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn boxes(report: &SimulationReport, quantity: Quantity) -> Result<String, FigureError> {
    let boxes: Vec<(u8, u64, BoxPlot, f64)> = report
        .by_contacts
        .iter()
        .map(|b| match quantity {
            Quantity::Rmse => (b.contacts, b.trials, b.rmse_v, 1e3),
            Quantity::Fvu => (b.contacts, b.trials, b.fvu, 1.0),
        })
        .collect();
    let top = boxes.iter().map(|(.., b, scale)| b.high * scale).fold(1e-6, f64::max);
    page("boxes by contacts", SIZE, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(18)
            .x_label_area_size(50)
            .y_label_area_size(70)
            .build_cartesian_2d(0.4..6.6_f64, 0.0..1.12 * top)?;
        chart
            .configure_mesh()
            .disable_x_mesh()
            .x_labels(7)
            .x_label_formatter(&whole)
            .x_desc("contacts")
            .y_desc(quantity.axis())
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.10))
            .label_style(SMALL)
            .axis_desc_style(TEXT)
            .draw()?;
        for (contacts, trials, b, scale) in boxes {
            let x = f64::from(contacts);
            let colour = COLOURS[usize::from(contacts)];
            let [low, q1, median, q3, high] =
                [b.low, b.q1, b.median, b.q3, b.high].map(|v| v * scale);
            let pen = BLACK.stroke_width(1);
            chart.draw_series([
                PathElement::new([(x, low), (x, q1)], pen),
                PathElement::new([(x, q3), (x, high)], pen),
                PathElement::new([(x - 0.12, low), (x + 0.12, low)], pen),
                PathElement::new([(x - 0.12, high), (x + 0.12, high)], pen),
            ])?;
            let corners = [(x - 0.25, q1), (x + 0.25, q3)];
            chart.draw_series([
                Rectangle::new(corners, colour.mix(0.55).filled()),
                Rectangle::new(corners, pen),
            ])?;
            let line = [(x - 0.25, median), (x + 0.25, median)];
            chart.draw_series([PathElement::new(line, BLACK.stroke_width(3))])?;
            let count = Text::new(format!("n = {trials}"), (x - 0.25, high + 0.04 * top), SMALL);
            chart.draw_series([count])?;
        }
        Ok(())
    })
}

/// Draws the mean FVU by the position of a single tip, with the electrodes (Fig. 7D). Positions
/// that no single tip has pressed stay white.
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn map(points: &[PointFit], skin: &Outline) -> Result<String, FigureError> {
    let [width, height] = skin.size_mm;
    page("map of FVU", PageSize { width_px: 760, height_px: 700 }, |area| {
        let (left, right) = area.split_horizontally(650);
        let mut chart = ChartBuilder::on(&left)
            .margin(18)
            .x_label_area_size(50)
            .y_label_area_size(64)
            .build_cartesian_2d(0.0..width, 0.0..height)?;
        chart
            .configure_mesh()
            .disable_mesh()
            .x_label_formatter(&whole)
            .y_label_formatter(&whole)
            .x_desc("x (mm)")
            .y_desc("y (mm)")
            .label_style(SMALL)
            .axis_desc_style(TEXT)
            .draw()?;
        let side = skin.pitch_mm / 3.0_f64.sqrt();
        chart.draw_series(points.iter().map(|p| {
            let corners: Vec<(f64, f64)> = (0..6)
                .map(|k| (f64::from(k) * 60.0 + 30.0).to_radians().sin_cos())
                .map(|(sin, cos)| (p.x_mm + side * cos, p.y_mm + side * sin))
                .collect();
            Polygon::new(corners, colour(p.mean_fvu).filled())
        }))?;
        chart.draw_series(skin.electrodes_mm.iter().map(|[x, y]| {
            EmptyElement::at((*x, *y))
                + Circle::new((0, 0), 6, WHITE.filled())
                + Circle::new((0, 0), 6, BLACK.stroke_width(2))
        }))?;
        bar(&right)
    })
}

/// Draws the colour scale of the map.
fn bar(area: &Area<'_>) -> Result<(), Box<dyn std::error::Error>> {
    let mut chart = ChartBuilder::on(area)
        .margin_top(18)
        .margin_bottom(68)
        .margin_right(8)
        .y_label_area_size(56)
        .build_cartesian_2d(0.0..1.0, 0.0..MAP_END)?;
    const STEPS: u32 = 100;
    chart.draw_series((0..STEPS).map(|i| {
        let [from, to] = [i, i + 1].map(|i| MAP_END * f64::from(i) / f64::from(STEPS));
        Rectangle::new([(0.0, from), (1.0, to)], colour(from).filled())
    }))?;
    chart
        .configure_mesh()
        .disable_mesh()
        .disable_x_axis()
        .y_desc("mean FVU (1 or more at the top)")
        .label_style(SMALL)
        .axis_desc_style(SMALL)
        .draw()?;
    Ok(())
}

pub(super) fn whole(value: &f64) -> String {
    format!("{value:.0}")
}

fn colour(fvu: f64) -> RGBColor {
    ViridisRGB.get_color((fvu / MAP_END).clamp(0.0, 1.0))
}

/// Draws a measured frame and its twin, V, over the 784 readings (Fig. 7A).
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn frames(measured_v: &[f32], simulated_v: &[f32]) -> Result<String, FigureError> {
    let points = |frame: &[f32]| -> Vec<(f64, f64)> {
        frame.iter().enumerate().map(|(i, v)| (i as f64, 1e3 * f64::from(*v))).collect()
    };
    let lines = [
        ("measured", points(measured_v), COLOURS[1]),
        ("simulated", points(simulated_v), COLOURS[5]),
    ];
    let all = || lines.iter().flat_map(|(_, line, _)| line).map(|p| p.1);
    let (low, high) = (all().fold(0.0, f64::min), all().fold(0.0, f64::max));
    let room = (0.06 * (high - low)).max(1e-3);
    page("a trial's frames", PageSize { width_px: 1100, height_px: 460 }, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(18)
            .x_label_area_size(50)
            .y_label_area_size(70)
            .build_cartesian_2d(0.0..measured_v.len() as f64, low - room..high + room)?;
        chart
            .configure_mesh()
            .x_label_formatter(&whole)
            .y_label_formatter(&whole)
            .x_desc("reading (28 for each injection)")
            .y_desc("voltage (mV)")
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.10))
            .label_style(SMALL)
            .axis_desc_style(TEXT)
            .draw()?;
        for (name, line, colour) in &lines {
            let colour = *colour;
            chart
                .draw_series(LineSeries::new(line.clone(), colour.mix(0.8).stroke_width(1)))?
                .label(*name)
                .legend(dash(colour));
        }
        legend(&mut chart, SeriesLabelPosition::UpperRight)
    })
}
