//! A run as pictures: forces over depth, contacts, fit of the twins, drift. SVG text from numbers.
//! PURE. Uses: plotters, `figure`, `evaluate::{figures, charts}` (page, lines). Never: files, a number
//! that was not measured.

use std::ops::Range;

use plotters::prelude::*;

use super::charts::Line;
use super::figures::{FigureResult, page};
use crate::figure::style::{AxesStyle, COLOURS, TINY, dash, framed, legend, plain, whole};
use crate::figure::{Area, Drawn, Heading, NumberChart, PageSize};

const RUN_SIZE: PageSize = PageSize { width_px: 900, height_px: 500 };
const HISTOGRAM_BINS: usize = 40;
/// Largest number of contacts of a trial.
const CONTACTS_SHOWN: usize = 7;

/// A named curve with a band.
#[derive(Debug, Clone, PartialEq)]
pub struct Band {
    /// Name in the legend.
    pub name: String,
    /// x, lower end, middle and upper end of the band.
    pub places: Vec<[f64; 4]>,
}

/// Trials by contacts, here and published.
#[derive(Debug, Clone, PartialEq)]
pub struct Contacts {
    /// Number of trials with 0, 1, .. 6 contacts.
    pub here: [u64; CONTACTS_SHOWN],
    /// Name of the run in the legend.
    pub name: String,
    /// Name and numbers of the comparison, scaled to as many trials; absent without one.
    pub published: Option<(String, [f64; CONTACTS_SHOWN])>,
}

/// A chart of numbers with named axes.
fn numbers<'a, 'b>(
    area: &'a Area<'b>,
    [x, y]: [&str; 2],
    [across, up]: [Range<f64>; 2],
) -> Drawn<NumberChart<'a, 'b>> {
    let mut chart = framed(area, [18, 50, 78]).build_cartesian_2d(across, up)?;
    chart.configure_mesh().named(x, &plain, y, &plain).draw()?;
    Ok(chart)
}

/// Draws curves over the depth, mm, with their bands: x from zero, y from zero or the lowest value.
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn bands(heading: &Heading, y: &str, bands: &[Band]) -> FigureResult<String> {
    let all = || bands.iter().flat_map(|band| &band.places);
    let right = all().map(|at| at[0]).fold(1e-6, f64::max);
    let (low, high) =
        all().fold((0.0, 1e-6), |(low, high): (f64, f64), at| (low.min(at[1]), high.max(at[3])));
    page("bands", RUN_SIZE, heading, |area| {
        let mut chart = numbers(area, ["depth (mm)", y], [0.0..right, low..1.06 * high])?;
        for (band, colour) in bands.iter().zip(COLOURS.iter().cycle().skip(1)) {
            let colour = *colour;
            let lower = band.places.iter().map(|at| (at[0], at[1]));
            let upper = band.places.iter().rev().map(|at| (at[0], at[3]));
            let ring: Vec<(f64, f64)> = lower.chain(upper).collect();
            chart.draw_series([Polygon::new(ring, colour.mix(0.16).filled())])?;
            let middle = band.places.iter().map(|at| (at[0], at[2]));
            chart
                .draw_series(LineSeries::new(middle.clone(), colour.stroke_width(2)))?
                .label(band.name.as_str())
                .legend(dash(colour));
            chart.draw_series(middle.map(|at| Circle::new(at, 3, colour.filled())))?;
        }
        legend(&mut chart, SeriesLabelPosition::UpperLeft)
    })
}

/// Draws numbers of trials by contacts, next to the published ones.
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn contacts(heading: &Heading, contacts: &Contacts) -> FigureResult<String> {
    let published = contacts.published.as_ref();
    let here = contacts.here.map(|count| count as f64);
    let top = here.iter().chain(published.iter().flat_map(|(_, all)| all)).copied();
    let top = 1.15 * top.fold(1.0, f64::max);
    page("contacts", RUN_SIZE, heading, |area| {
        let mut chart = framed(area, [18, 50, 78]).build_cartesian_2d(-0.6..6.6_f64, 0.0..top)?;
        chart
            .configure_mesh()
            .disable_x_mesh()
            .x_labels(CONTACTS_SHOWN)
            .named("contacts", &whole, "trials", &whole)
            .draw()?;
        let shown = [(contacts.name.as_str(), here)].into_iter();
        let shown = shown.chain(published.map(|(name, all)| (name.as_str(), *all)));
        let columns = 1 + usize::from(published.is_some());
        let width = 0.8 / columns as f64;
        for (column, (name, counts)) in shown.enumerate() {
            let colour = if column == 0 { COLOURS[1] } else { COLOURS[0] };
            let left = |n: usize| n as f64 - 0.4 + width * column as f64;
            let bars = counts.iter().enumerate().map(|(n, count)| {
                let corners = [(left(n), 0.0), (left(n) + width, *count)];
                Rectangle::new(corners, colour.mix(0.8).filled())
            });
            let square =
                move |(x, y)| Rectangle::new([(x, y - 6), (x + 22, y + 6)], colour.filled());
            chart.draw_series(bars)?.label(name).legend(square);
            let numbers = counts.iter().enumerate().filter(|(_, count)| **count > 0.0);
            chart.draw_series(numbers.map(|(n, count)| {
                let at = (left(n), count + 0.045 * top);
                Text::new(format!("{count:.0}"), at, TINY)
            }))?;
        }
        legend(&mut chart, SeriesLabelPosition::UpperRight)
    })
}

/// Draws a histogram of values from zero; those beyond `end` are in the last bin. `mark`: a value with
/// its name, drawn as a line.
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn histogram(
    heading: &Heading,
    x: &str,
    values: &[f64],
    end: f64,
    mark: Option<(&str, f64)>,
) -> FigureResult<String> {
    let width = end / HISTOGRAM_BINS as f64;
    let mut counts = [0_u32; HISTOGRAM_BINS];
    for value in values.iter().filter(|value| value.is_finite()) {
        counts[((value.max(0.0) / width) as usize).min(HISTOGRAM_BINS - 1)] += 1;
    }
    let top = 1.12 * f64::from(counts.iter().copied().max().unwrap_or(0).max(1));
    page("histogram", RUN_SIZE, heading, |area| {
        let mut chart = framed(area, [18, 50, 70]).build_cartesian_2d(0.0..end, 0.0..top)?;
        chart
            .configure_mesh()
            .disable_x_mesh()
            .named(format!("{x} (the last bin holds all above)"), &plain, "trials", &whole)
            .draw()?;
        chart.draw_series(counts.iter().enumerate().filter(|(_, count)| **count > 0).map(
            |(bin, count)| {
                let left = bin as f64 * width;
                let corners = [(left, 0.0), (left + 0.94 * width, f64::from(*count))];
                Rectangle::new(corners, COLOURS[1].mix(0.8).filled())
            },
        ))?;
        if let Some((name, value)) = mark.filter(|(_, value)| (0.0..=end).contains(value)) {
            let line = [(value, 0.0), (value, top)];
            chart
                .draw_series([PathElement::new(line, COLOURS[5].stroke_width(2))])?
                .label(format!("{name} {value:.3}"))
                .legend(dash(COLOURS[5]));
            legend(&mut chart, SeriesLabelPosition::UpperRight)?;
        }
        Ok(())
    })
}

/// Draws lines over a linear scale, as of time; y spans the values.
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn over_time(heading: &Heading, x: &str, y: &str, lines: &[Line]) -> FigureResult<String> {
    let all = || lines.iter().flat_map(|line| &line.places);
    let right = all().map(|at| at.0).fold(1e-6, f64::max);
    let (low, high) =
        all().fold((f64::MAX, f64::MIN), |(low, high), at| (low.min(at.1), high.max(at.1)));
    let (low, high) = if low > high { (0.0, 1.0) } else { (low, high) };
    let room = (0.08 * (high - low)).max(1e-3 * high.abs()).max(1e-6);
    // Several lines have a legend above them.
    let above = if lines.len() > 1 { 0.3 * (high - low) } else { 0.0 };
    page("over time", RUN_SIZE, heading, |area| {
        let mut chart = numbers(area, [x, y], [0.0..right, low - room..high + room + above])?;
        for (line, colour) in lines.iter().zip(COLOURS.iter().cycle().skip(1)) {
            let colour = *colour;
            let places = line.places.iter().copied();
            chart
                .draw_series(LineSeries::new(places.clone(), colour.stroke_width(2)))?
                .label(line.name.as_str())
                .legend(dash(colour));
            chart.draw_series(places.map(|at| Circle::new(at, 2, colour.filled())))?;
        }
        if lines.len() > 1 {
            legend(&mut chart, SeriesLabelPosition::UpperRight)?;
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_figure_has_its_title_and_axes_also_without_data() {
        let band =
            Band { name: "1 tip".into(), places: vec![[0.0, 0.0, 0.1, 0.2], [1.0, 2.0, 4.0, 5.0]] };
        let none = Contacts { here: [0; 7], name: "run 1".into(), published: None };
        let of_paper = Some(("Table I, scaled".to_owned(), [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.5]));
        let some = Contacts { here: [1, 2, 3, 0, 0, 0, 1], published: of_paper, ..none.clone() };
        let line = Line { name: "arm 1".into(), places: vec![(0.0, 1.0), (2.0, 1.5)] };
        let heading = Heading::new("forces", 2, "readings", "virtual");
        let all = [
            bands(&heading, "force (N)", &[band]),
            bands(&heading, "force (N)", &[]),
            contacts(&heading, &none),
            contacts(&heading, &some),
            histogram(&heading, "FVU", &[0.1, 0.2, 9.0], 2.0, Some(("median", 0.2))),
            histogram(&heading, "FVU", &[], 2.0, None),
            over_time(&heading, "time (h)", "tare (mV)", &[line.clone(), line]),
            over_time(&heading, "time (h)", "tare (mV)", &[]),
        ];
        for figure in all {
            let svg = figure.unwrap();
            assert!(svg.starts_with("<svg") && svg.contains("virtual, n = 2 readings"), "{svg}");
            assert!(!svg.contains("NaN"), "{svg}");
        }
    }
}
