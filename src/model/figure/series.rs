//! Series over numbers or names: bars, lines or dots, as a result of a query is drawn.
//! PURE. Uses: plotters, `style`. Never: what the numbers mean (the names of the axes state it).

use plotters::prelude::*;

use super::style::{AxesStyle, COLOURS, dash, framed, legend, plain};
use super::{Area, Drawn, Heading, PageSize, figure};

/// Size of a drawing of series.
const SERIES_SIZE: PageSize = PageSize { width_px: 960, height_px: 480 };
/// Longest series whose points are marked.
pub const MARKED_POINTS: usize = 60;
/// Most names below the axis.
const AXIS_NAMES_MAX: usize = 24;
/// Share of a place that its bars fill.
const BAR_SHARE: f64 = 0.84;

/// How series are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Marks {
    /// Bars from zero, next to each other at each place.
    Bars,
    /// Lines in the order of the places.
    Lines,
    /// A dot at each value, without lines.
    Dots,
}

/// Places on the horizontal axis.
#[derive(Debug, Clone, PartialEq)]
pub enum Places {
    /// Positions on a linear axis, in its unit.
    Numbers(Vec<f64>),
    /// Names, at equal distances.
    Names(Vec<String>),
}

/// Values at each place; absent ones are not drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Name of the series in the legend.
    pub name: String,
    /// One value for each place.
    pub values: Vec<Option<f64>>,
}

/// Series over the same places.
#[derive(Debug, Clone, PartialEq)]
pub struct Chart {
    /// Name of the horizontal axis, with its unit.
    pub x_name: String,
    /// Name of the vertical axis, with its unit.
    pub y_name: String,
    /// Places on the horizontal axis.
    pub places: Places,
    /// Width that a bar of a number stands for; absent: the least distance of two places.
    pub width: Option<f64>,
    /// Series in the order of the legend.
    pub series: Vec<Series>,
    /// How they are drawn.
    pub marks: Marks,
}

impl Chart {
    /// Draws the series below a heading, and returns the SVG text.
    ///
    /// # Errors
    /// The text of the error of the plotting backend; a text if there is nothing to draw.
    pub fn draw(&self, heading: &Heading) -> Result<String, String> {
        let numbers: Vec<f64> = match &self.places {
            Places::Numbers(numbers) => numbers.clone(),
            Places::Names(names) => (0..names.len()).map(|n| n as f64).collect(),
        };
        let values = self.series.iter().flat_map(|series| &series.values);
        let values: Vec<f64> = values.flatten().copied().filter(|v| v.is_finite()).collect();
        if values.is_empty() || numbers.is_empty() {
            return Err("there is no number to draw".into());
        }
        let width = self.width.unwrap_or_else(|| least_distance(&numbers));
        // A range starts at its place, a name is in the middle of its bars.
        let is_range = self.marks == Marks::Bars && matches!(self.places, Places::Numbers(_));
        let [before, after] = match self.marks {
            Marks::Bars if is_range && self.width.is_some() => [0.0, width],
            Marks::Bars => [width / 2.0; 2],
            Marks::Lines | Marks::Dots => [0.0; 2],
        };
        let (left, right) = ends(&numbers);
        let room = if right > left { (right - left) * 0.02 } else { width.max(0.5) };
        let (low, high) = ends(&values);
        let (low, high) = match self.marks {
            Marks::Bars => (low.min(0.0), high.max(0.0)),
            Marks::Lines | Marks::Dots => (low, high),
        };
        let room_y = ((high - low) * 0.06).max(f64::MIN_POSITIVE.max(high.abs() * 1e-6));
        // The legend is above the values.
        let legend = if self.series.len() > 1 { 1.2 * self.series.len() as f64 } else { 0.0 };
        let above = room_y * (1.0 + legend.min(8.0));
        let below = if self.marks == Marks::Bars && low == 0.0 { 0.0 } else { room_y };
        let x_range = left - before - room..right + after + room;
        let y_range = low - below..high + above;
        figure(SERIES_SIZE, heading, |area| {
            self.draw_on(area, &numbers, x_range, y_range, [before, after])
        })
    }

    fn draw_on(
        &self,
        area: &Area<'_>,
        numbers: &[f64],
        x_range: std::ops::Range<f64>,
        y_range: std::ops::Range<f64>,
        [before, after]: [f64; 2],
    ) -> Drawn {
        let mut chart = framed(area, [14, 54, 92]).build_cartesian_2d(x_range, y_range)?;
        let name = |x: &f64| match &self.places {
            Places::Numbers(_) => plain(x),
            Places::Names(names) => {
                let at = x.round();
                let is_place = (x - at).abs() < 1e-6 && at >= 0.0;
                names.get(at as usize).filter(|_| is_place).cloned().unwrap_or_default()
            }
        };
        let labels = match &self.places {
            Places::Numbers(_) => 12,
            Places::Names(names) => names.len().clamp(2, AXIS_NAMES_MAX) * 2 + 1,
        };
        let mut frame = chart.configure_mesh();
        frame.x_labels(labels).named(&self.x_name, &name, &self.y_name, &plain);
        if self.marks == Marks::Bars {
            frame.disable_x_mesh();
        }
        frame.draw()?;
        let count = self.series.len() as f64;
        for (n, series) in self.series.iter().enumerate() {
            let colour = COLOURS[1 + n % (COLOURS.len() - 1)];
            let points: Vec<(f64, f64)> = numbers
                .iter()
                .zip(&series.values)
                .filter_map(|(x, value)| Some((*x, value.filter(|v| v.is_finite())?)))
                .collect();
            let drawn = match self.marks {
                Marks::Bars => {
                    let room = before + after;
                    let one = room * BAR_SHARE / count;
                    let bars = points.iter().map(|&(x, y)| {
                        let from = x - before + room * (1.0 - BAR_SHARE) / 2.0 + one * n as f64;
                        Rectangle::new([(from, 0.0), (from + one, y)], colour.mix(0.85).filled())
                    });
                    chart.draw_series(bars)?
                }
                Marks::Lines => {
                    if points.len() <= MARKED_POINTS {
                        let dots = points.iter().map(|at| Circle::new(*at, 3, colour.filled()));
                        chart.draw_series(dots)?;
                    }
                    chart.draw_series(LineSeries::new(points, colour.stroke_width(3)))?
                }
                Marks::Dots => {
                    let dots =
                        points.iter().map(|at| Circle::new(*at, 3, colour.mix(0.6).filled()));
                    chart.draw_series(dots)?
                }
            };
            if self.series.len() > 1 {
                drawn.label(series.name.clone()).legend(dash(colour));
            }
        }
        match self.series.len() {
            0 | 1 => Ok(()),
            _ => legend(&mut chart, SeriesLabelPosition::UpperRight),
        }
    }
}

fn ends(values: &[f64]) -> (f64, f64) {
    values.iter().fold((f64::MAX, f64::MIN), |(low, high), &v| (low.min(v), high.max(v)))
}

/// The least distance of two different numbers; 1 without one.
fn least_distance(numbers: &[f64]) -> f64 {
    let mut sorted = numbers.to_vec();
    sorted.sort_by(f64::total_cmp);
    let distances = sorted.windows(2).map(|pair| pair[1] - pair[0]).filter(|d| *d > 0.0);
    let least = distances.fold(f64::INFINITY, f64::min);
    if least.is_finite() { least } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(places: Places, marks: Marks, values: &[Option<f64>]) -> Chart {
        let series = vec![Series { name: "a".into(), values: values.to_vec() }];
        let (x_name, y_name) = ("depth, mm".into(), "force, N".into());
        Chart { x_name, y_name, places, width: None, series, marks }
    }

    #[test]
    fn bars_start_at_zero_and_absent_values_have_none() {
        let heading = Heading::new("Counts", 7, "trials", "virtual");
        let places = Places::Names(vec!["zero".into(), "one".into(), "two".into()]);
        let bars = chart(places, Marks::Bars, &[Some(3.0), None, Some(4.0)]);
        let svg = bars.draw(&heading).unwrap();
        // The page, and two bars.
        assert_eq!(svg.matches("<rect").count(), 3, "{svg}");
        assert!(svg.contains("zero") && svg.contains("two") && svg.contains("depth, mm"));
    }

    #[test]
    fn lines_and_dots_are_drawn_and_nothing_is_an_error() {
        let heading = Heading::new("Force", 2, "trials", "virtual");
        for marks in [Marks::Lines, Marks::Dots, Marks::Bars] {
            let places = Places::Numbers(vec![0.5, 1.5]);
            assert!(chart(places.clone(), marks, &[Some(1.0), Some(2.0)]).draw(&heading).is_ok());
            // One value, or all equal.
            assert!(chart(places.clone(), marks, &[Some(2.0), Some(2.0)]).draw(&heading).is_ok());
            assert!(chart(Places::Numbers(vec![3.0]), marks, &[Some(0.0)]).draw(&heading).is_ok());
            let nothing = chart(places, marks, &[None, Some(f64::NAN)]).draw(&heading);
            assert_eq!(nothing.unwrap_err(), "there is no number to draw");
        }
        assert_eq!([least_distance(&[3.0, 1.0, 1.5]), least_distance(&[2.0])], [0.5, 1.0]);
    }
}
