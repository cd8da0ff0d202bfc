//! The paper's Fig. 7B to 7F as pictures: SVG text from numbers.
//! PURE. Uses: plotters, `figure`, `evaluate::simulation`. Never: files, a number that is not in
//! the report.

use plotters::prelude::*;
use plotters::style::colors::colormaps::ViridisRGB;

use crate::figure::skin::{BAR_PX, Outline, colour_bar};
use crate::figure::style::{AxesStyle, COLOURS, INK, TINY, framed, legend, plain, whole};
use crate::figure::{Area, Drawn, Heading, PageSize, with_n};
use crate::plain::{counted, grouped};
use crate::record::CONTACTS_MAX;

use super::simulation::{BoxPlot, FORCE_BIN_N, FORCE_END_N, ForceBin, PointFit, SimulationReport};

/// A figure that could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("drawing {figure}: {why}")]
pub struct FigureError {
    /// Name of the figure.
    pub figure: &'static str,
    /// Error of the plotting backend, as text.
    pub why: String,
}

/// Result of drawing a figure.
pub type FigureResult<T> = Result<T, FigureError>;

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

const REPORT_SIZE: PageSize = PageSize { width_px: 960, height_px: 600 };
/// Bins with fewer trials are not drawn: their mean is not significant.
const BIN_TRIALS_MIN: u64 = 5;
/// Widths of bins, N: the narrowest is used whose drawn bins hold most of the trials.
const WIDTHS_N: [f64; 4] = [FORCE_BIN_N, 2.0, 5.0, 10.0];
/// That share of the trials.
const MOST: f64 = 0.85;
/// FVU at the upper end of the map's colour scale.
const MAP_END: f64 = 1.0;
/// Width of the skin on the map, px.
const MAP_PX: u32 = 560;

/// Draws a figure with its heading and returns its SVG text.
pub(super) fn page(
    name: &'static str,
    size: PageSize,
    heading: &Heading,
    draw: impl FnOnce(&Area<'_>) -> Drawn,
) -> FigureResult<String> {
    crate::figure::figure(size, heading, draw).map_err(|why| FigureError { figure: name, why })
}

/// Trials with a number of contacts in one bin: its middle, N, number, and mean.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Bin {
    middle_n: f64,
    trials: u64,
    mean: f64,
}

/// Bins of this width, by the number of contacts.
fn binned(report: &SimulationReport, quantity: Quantity, width_n: f64) -> Vec<(u8, Vec<Bin>)> {
    let of_count = |contacts: u8| {
        let mut bins: Vec<Bin> = Vec::new();
        for bin in report.by_force.iter().filter(|bin| bin.contacts == Some(contacts)) {
            let middle_n = ((bin.from_n / width_n).floor() + 0.5) * width_n;
            if bins.last().is_none_or(|last| last.middle_n != middle_n) {
                bins.push(Bin { middle_n, trials: 0, mean: 0.0 });
            }
            if let Some(last) = bins.last_mut() {
                last.trials += bin.trials;
                let share = bin.trials as f64 / last.trials as f64;
                last.mean += share * (quantity.of_bin(bin) - last.mean);
            }
        }
        (contacts, bins)
    };
    (0..=CONTACTS_MAX as u8).map(of_count).filter(|(_, bins)| !bins.is_empty()).collect()
}

/// The narrowest bins of which those with enough trials hold most trials.
fn bins(report: &SimulationReport, quantity: Quantity) -> (f64, Vec<(u8, Vec<Bin>)>) {
    let holds_most = |lines: &[(u8, Vec<Bin>)]| {
        let all = || lines.iter().flat_map(|(_, bins)| bins);
        let shown: u64 =
            all().map(|bin| bin.trials).filter(|trials| *trials >= BIN_TRIALS_MIN).sum();
        shown as f64 >= MOST * all().map(|bin| bin.trials).sum::<u64>() as f64
    };
    let all = WIDTHS_N.map(|width_n| (width_n, binned(report, quantity, width_n)));
    let [.., widest] = &all;
    all.iter().find(|(_, lines)| holds_most(lines)).unwrap_or(widest).clone()
}

/// Draws means by the largest force of a trial, one line per number of contacts, above the number of
/// trials of each bin (Fig. 7B, 7E). Lines end at bins with too few trials.
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn by_force(
    heading: &Heading,
    report: &SimulationReport,
    quantity: Quantity,
) -> FigureResult<String> {
    let (width_n, lines) = bins(report, quantity);
    let all = || lines.iter().flat_map(|(_, bins)| bins);
    let shown = || all().filter(|bin| bin.trials >= BIN_TRIALS_MIN);
    let top = 1.08 * shown().map(|bin| bin.mean).fold(1e-6, f64::max);
    let end_n = all().map(|bin| bin.middle_n + 0.5 * width_n).fold(10.0, f64::max);
    let end_n = (10.0 * (end_n / 10.0).ceil()).min(FORCE_END_N);
    let last = if end_n < FORCE_END_N { "" } else { "; the last one holds all above" };
    let heading = heading.clone().with_note(format!(
        "Dots: means of bins of {width_n} N with at least {BIN_TRIALS_MIN} trials, joined where bins adjoin{last}. Bars: trials"
    ));
    page("means by force", REPORT_SIZE, &heading, |area| {
        let (above, below) = area.split_vertically(410);
        let mut chart = framed(&above, [14, 10, 78]).build_cartesian_2d(0.0..end_n, 0.0..top)?;
        chart
            .configure_mesh()
            .x_label_formatter(&|_| String::new())
            .y_label_formatter(&plain)
            .y_desc(format!("mean {}", quantity.axis()))
            .styled()
            .draw()?;
        for (contacts, bins) in &lines {
            let colour = COLOURS[usize::from(*contacts)];
            let shown: Vec<Bin> =
                bins.iter().copied().filter(|bin| bin.trials >= BIN_TRIALS_MIN).collect();
            let adjoin = |a: &Bin, b: &Bin| b.middle_n - a.middle_n < 1.5 * width_n;
            for stretch in shown.chunk_by(adjoin) {
                let places = stretch.iter().map(|bin| (bin.middle_n, bin.mean));
                chart.draw_series(LineSeries::new(places, colour.stroke_width(2)))?;
            }
            let dots = shown.iter().map(|bin| (bin.middle_n, bin.mean));
            let trials: u64 = bins.iter().map(|bin| bin.trials).sum();
            chart
                .draw_series(dots.map(|at| Circle::new(at, 4, colour.filled())))?
                .label(with_n(&contacts_words(*contacts), trials))
                .legend(move |(x, y)| Circle::new((x + 11, y), 4, colour.filled()));
        }
        let position = match quantity {
            Quantity::Rmse => SeriesLabelPosition::UpperLeft,
            Quantity::Fvu => SeriesLabelPosition::UpperRight,
        };
        legend(&mut chart, position)?;
        counts(&below, &lines, width_n, end_n)
    })
}

/// Number of trials of each bin, one bar above the other.
fn counts(area: &Area<'_>, lines: &[(u8, Vec<Bin>)], width_n: f64, end_n: f64) -> Drawn {
    let mut heights = std::collections::BTreeMap::<i64, u64>::new();
    let mut bars = Vec::new();
    for (contacts, bins) in lines {
        for bin in bins {
            let height = heights.entry((bin.middle_n * 10.0) as i64).or_default();
            let from = *height as f64;
            *height += bin.trials;
            let [left, right] = [-0.46, 0.46].map(|side| bin.middle_n + side * width_n);
            let colour = COLOURS[usize::from(*contacts)].mix(0.75).filled();
            bars.push(Rectangle::new([(left, from), (right, *height as f64)], colour));
        }
    }
    let top = heights.values().copied().max().unwrap_or(1) as f64;
    let mut chart =
        framed(area, [14, 50, 78]).margin_top(0).build_cartesian_2d(0.0..end_n, 0.0..1.08 * top)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .y_labels(4)
        .named("largest force of a trial (N)", &whole, "trials", &whole)
        .draw()?;
    chart.draw_series(bars)?;
    Ok(())
}

fn contacts_words(contacts: u8) -> String {
    match contacts {
        0 => "no contact".to_owned(),
        n => counted(n.into(), "contact", "contacts"),
    }
}

/// Draws boxes by the number of contacts, without outliers (Fig. 7C, 7F).
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn boxes(
    heading: &Heading,
    report: &SimulationReport,
    quantity: Quantity,
) -> FigureResult<String> {
    let boxes: Vec<(u8, u64, BoxPlot, f64)> = report
        .by_contacts
        .iter()
        .map(|b| match quantity {
            Quantity::Rmse => (b.contacts, b.trials, b.rmse_v, 1e3),
            Quantity::Fvu => (b.contacts, b.trials, b.fvu, 1.0),
        })
        .collect();
    let top = boxes.iter().map(|(.., b, scale)| b.high * scale).fold(1e-6, f64::max);
    let heading = heading.clone().with_note(
        "Boxes: quartiles and median; whiskers: outermost values within 1.5 interquartile ranges; \
         values beyond them are not drawn",
    );
    page("boxes by contacts", REPORT_SIZE, &heading, |area| {
        let mut chart =
            framed(area, [14, 50, 78]).build_cartesian_2d(0.4..6.6_f64, 0.0..1.12 * top)?;
        chart
            .configure_mesh()
            .disable_x_mesh()
            .x_labels(7)
            .named("contacts of a trial", &whole, quantity.axis(), &plain)
            .draw()?;
        for (contacts, trials, b, scale) in boxes {
            let x = f64::from(contacts);
            let colour = COLOURS[usize::from(contacts)];
            let [low, q1, median, q3, high] =
                [b.low, b.q1, b.median, b.q3, b.high].map(|v| v * scale);
            let pen = INK.stroke_width(1);
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
            chart.draw_series([PathElement::new(line, INK.stroke_width(3))])?;
            let count = format!("n = {}", grouped(trials));
            chart.draw_series([Text::new(count, (x - 0.25, high + 0.04 * top), TINY)])?;
        }
        Ok(())
    })
}

/// Draws the mean FVU by the position of a single tip, with the outline of the skin and the
/// electrodes (Fig. 7D). Positions that no single tip has pressed stay white.
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn map(heading: &Heading, points: &[PointFit], skin: &Outline) -> FigureResult<String> {
    let panel = skin.panel(MAP_PX);
    let size = PageSize { width_px: panel.width_px + BAR_PX, ..panel };
    let heading = heading.clone().with_note(
        "Hexagons: positions that a single tip has pressed; circles: electrodes; frame: edge of the skin",
    );
    page("map of FVU", size, &heading, |area| {
        let (left, right) = area.split_horizontally(panel.width_px);
        let mut chart = skin.chart(&left, "")?;
        let side = skin.pitch_mm / 3.0_f64.sqrt();
        chart.draw_series(points.iter().map(|p| {
            let corners: Vec<(f64, f64)> = (0..6)
                .map(|k| (f64::from(k) * 60.0 + 30.0).to_radians().sin_cos())
                .map(|(sin, cos)| (p.x_mm + side * cos, p.y_mm + side * sin))
                .collect();
            Polygon::new(corners, colour(p.mean_fvu).filled())
        }))?;
        skin.edge(&mut chart, 5)?;
        colour_bar(&right, "mean FVU (1 or more at the top)", [0.0, MAP_END], colour)
    })
}

fn colour(fvu: f64) -> RGBColor {
    ViridisRGB.get_color((fvu / MAP_END).clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::simulation::report;
    use crate::evaluate::simulation::tests::fit;
    use crate::store::Fit;

    #[test]
    fn few_trials_get_wider_bins_and_no_line_crosses_a_gap() {
        let sparse: Vec<Fit> = (0..20_u32).map(|n| fit(1, f64::from(n % 10), 0.25)).collect();
        let (width_n, lines) = bins(&report(&sparse), Quantity::Fvu);
        assert_eq!((width_n, lines[0].1.len()), (5.0, 2));
        assert_eq!(lines[0].1[0], Bin { middle_n: 2.5, trials: 10, mean: 0.25 });
        let apart = (0..20).map(|n| fit(1, if n < 10 { 3.0 } else { 30.0 }, 0.25));
        let apart: Vec<Fit> = apart.collect();
        let heading = Heading::new("Fit by force", 20, "trials", "virtual");
        let svg = by_force(&heading, &report(&apart), Quantity::Fvu).unwrap();
        let line =
            format!("stroke=\"#{:02X}{:02X}{:02X}\"", COLOURS[1].0, COLOURS[1].1, COLOURS[1].2);
        let joined = svg.lines().filter(|l| l.contains("polyline") && l.contains(&line));
        let joined = joined
            .filter(|l| l.split("points=").nth(1).is_some_and(|p| p.matches(',').count() > 1));
        assert_eq!(joined.count(), 0, "{svg}");
        assert!(svg.contains("1 contact, n = 20") && svg.contains("virtual, n = 20 trials"));
    }
}
