//! Scores as pictures: lines, bars, heat maps, force maps. SVG text from numbers.
//! PURE. Uses: plotters, `evaluate::figures` (page, legend, colours), `dataset::force_map`. Never:
//! files.

use plotters::coord::combinators::WithKeyPoints;
use plotters::prelude::*;
use plotters::style::colors::colormaps::ViridisRGB;

use super::figures::{COLOURS, FigureError, SMALL, TEXT, dash, legend, page, whole};
use crate::calibrate::page::PageSize;
use crate::dataset::force_map::{ForceMap, ForceMapSpec, SIDE_MM};
use crate::store::Contact;

/// A named line of points.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// Name in the legend.
    pub name: String,
    /// Points (x, y).
    pub places: Vec<(f64, f64)>,
}

/// A named mean with its standard deviation.
#[derive(Debug, Clone, PartialEq)]
pub struct Bar {
    /// Name of the bar.
    pub name: String,
    /// Value of the mean.
    pub mean: f64,
    /// Standard deviation of the averaged values.
    pub sd: f64,
}

/// A quantity by pixel size and diameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Heat {
    /// Name of the quantity.
    pub name: String,
    /// Pixel and diameter, mm, and the value.
    pub cells: Vec<([f64; 2], f64)>,
}

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
    pub fn of_contacts(
        name: &str,
        spec: ForceMapSpec,
        contacts: &[Contact],
    ) -> Result<Self, FigureError> {
        let failed = |error: crate::dataset::force_map::ForceMapError| FigureError {
            figure: "force map",
            why: error.to_string(),
        };
        let skin = crate::dataset::read::SKIN;
        let draws = ForceMap::new(spec, skin.width_mm, skin.height_mm).map_err(failed)?;
        let mut map = vec![0.0; draws.pixels() * draws.pixels()];
        let pressed = contacts.iter().filter_map(|c| c.pressed());
        let pressed: Vec<(f64, f64, f64)> = pressed.map(|[x, y, n]| (x, y, n)).collect();
        draws.render(&pressed, &mut map).map_err(failed)?;
        Ok(Self { name: name.into(), spec, map })
    }
}

/// Draws lines over whole numbers, with a logarithmic y axis.
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn lines(title: &str, x: &str, y: &str, lines: &[Line]) -> Result<String, FigureError> {
    let all = || lines.iter().flat_map(|line| &line.places);
    let (left, right) = all().fold((f64::MAX, f64::MIN), |(l, r), p| (l.min(p.0), r.max(p.0)));
    let (low, high) =
        all().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(p.1.max(1e-3)), h.max(p.1)));
    if left > right {
        return empty(title);
    }
    let (low, high) = (low / 1.5, high * 1.5);
    page("lines", PageSize { width_px: 1000, height_px: 560 }, |area| {
        let (left_area, names) = area.split_horizontally(850);
        let mut chart = ChartBuilder::on(&left_area)
            .caption(title, TEXT)
            .margin(18)
            .x_label_area_size(50)
            .y_label_area_size(70)
            .build_cartesian_2d(left - 0.2..right + 0.2, upwards(low, high))?;
        chart
            .configure_mesh()
            .x_labels((right - left) as usize + 1)
            .x_label_formatter(&whole)
            .y_label_formatter(&|value| format!("{value}"))
            .x_desc(x)
            .y_desc(y)
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.10))
            .label_style(SMALL)
            .axis_desc_style(TEXT)
            .draw()?;
        for (at, (line, colour)) in lines.iter().zip(COLOURS.iter().cycle().skip(1)).enumerate() {
            let places = line.places.iter().map(|(x, y)| (*x, y.max(1e-3)));
            chart.draw_series(LineSeries::new(places.clone(), colour.stroke_width(2)))?;
            chart.draw_series(places.map(|place| Circle::new(place, 3, colour.filled())))?;
            let y = 60 + 24 * at as i32;
            names.draw(&PathElement::new([(0, y), (22, y)], colour.stroke_width(3)))?;
            names.draw(&Text::new(line.name.as_str(), (30, y - 8), SMALL))?;
        }
        Ok(())
    })
}

/// A logarithmic scale with labels at 1, 2 and 5 of every decade.
fn upwards(low: f64, high: f64) -> WithKeyPoints<LogCoord<f64>> {
    let decades = low.log10().floor() as i32..=high.log10().floor() as i32;
    let named = decades.flat_map(|decade| [1.0, 2.0, 5.0].map(|digit| digit * 10f64.powi(decade)));
    let named = named.filter(|value| (low..high).contains(value)).collect();
    (low..high).log_scale().with_key_points(named)
}

/// Draws means and standard deviations, one below the other.
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn bars(title: &str, bars: &[Bar]) -> Result<String, FigureError> {
    let low = bars.iter().map(|bar| bar.mean - bar.sd).fold(0.0, f64::min);
    let high = bars.iter().map(|bar| bar.mean + bar.sd).fold(0.0, f64::max);
    let room = (0.05 * (high - low)).max(1e-6);
    let count = bars.len();
    page("bars", PageSize { width_px: 900, height_px: 90 + 30 * count as u32 }, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(18)
            .x_label_area_size(50)
            .y_label_area_size(230)
            .build_cartesian_2d(low - room..high + room, (0..count).into_segmented())?;
        chart
            .configure_mesh()
            .disable_y_mesh()
            .x_desc(title)
            .y_labels(count)
            .y_label_formatter(&|at| match at {
                SegmentValue::CenterOf(at) => (count - 1)
                    .checked_sub(*at)
                    .map_or(String::new(), |place| bars[place].name.clone()),
                _ => String::new(),
            })
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.10))
            .label_style(SMALL)
            .axis_desc_style(TEXT)
            .draw()?;
        let zero = [(0.0, SegmentValue::Exact(0)), (0.0, SegmentValue::Last)];
        chart.draw_series([PathElement::new(zero, BLACK.mix(0.4))])?;
        for (at, bar) in bars.iter().enumerate() {
            let place = SegmentValue::CenterOf(count - 1 - at);
            let ends = [(bar.mean - bar.sd, place.clone()), (bar.mean + bar.sd, place.clone())];
            chart.draw_series([PathElement::new(ends, COLOURS[1].mix(0.5).stroke_width(2))])?;
            chart.draw_series([Circle::new((bar.mean, place), 5, COLOURS[1].filled())])?;
        }
        Ok(())
    })
}

/// Draws quantities by pixel size and diameter, next to each other (paper, Fig. 9); missing
/// combinations stay white.
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn heats(title: &str, heats: &[Heat]) -> Result<String, FigureError> {
    let axis = |pick: usize| {
        let cells = heats.iter().flat_map(|heat| &heat.cells);
        let mut values: Vec<f64> = cells.map(|(at, _)| at[pick]).collect();
        values.sort_by(f64::total_cmp);
        values.dedup();
        values
    };
    let (pixels, diameters) = (axis(0), axis(1));
    if pixels.is_empty() {
        return empty(title);
    }
    page("heat maps", PageSize { width_px: 1200, height_px: 420 }, |area| {
        let titled = area.titled(title, TEXT)?;
        for (heat, area) in heats.iter().zip(titled.split_evenly((1, heats.len()))) {
            let largest = heat.cells.iter().map(|cell| cell.1.abs()).fold(1e-9, f64::max);
            let mut chart = ChartBuilder::on(&area)
                .caption(&heat.name, SMALL)
                .margin(10)
                .x_label_area_size(44)
                .y_label_area_size(52)
                .build_cartesian_2d(
                    (0..pixels.len()).into_segmented(),
                    (0..diameters.len()).into_segmented(),
                )?;
            let named = |values: &[f64], at: &SegmentValue<usize>| match at {
                SegmentValue::CenterOf(at) => {
                    values.get(*at).map_or(String::new(), |mm| format!("{mm:.0}"))
                }
                _ => String::new(),
            };
            chart
                .configure_mesh()
                .disable_mesh()
                .x_desc("pixel (mm)")
                .y_desc("diameter (mm)")
                .y_labels(diameters.len())
                .x_label_formatter(&|at| named(&pixels, at))
                .y_label_formatter(&|at| named(&diameters, at))
                .label_style(SMALL)
                .axis_desc_style(SMALL)
                .draw()?;
            for ([pixel, diameter], value) in &heat.cells {
                let place = |values: &[f64], mm: f64| values.iter().position(|v| *v == mm);
                let (Some(x), Some(y)) = (place(&pixels, *pixel), place(&diameters, *diameter))
                else {
                    continue;
                };
                let colour = ViridisRGB.get_color(value.abs() / largest);
                let corners = [
                    (SegmentValue::Exact(x), SegmentValue::Exact(y)),
                    (SegmentValue::Exact(x + 1), SegmentValue::Exact(y + 1)),
                ];
                chart.draw_series([Rectangle::new(corners, colour.filled())])?;
                let ink = if value.abs() > 0.6 * largest { BLACK } else { WHITE };
                let style = TextStyle::from(("sans-serif", 14).into_font()).color(&ink);
                let centred = style.pos(plotters::style::text_anchor::Pos::new(
                    plotters::style::text_anchor::HPos::Center,
                    plotters::style::text_anchor::VPos::Center,
                ));
                let at = (SegmentValue::CenterOf(x), SegmentValue::CenterOf(y));
                chart.draw_series([Text::new(format!("{value:.0}"), at, centred)])?;
            }
        }
        Ok(())
    })
}

/// Draws force maps, `columns` per row, each with its own colour scale (paper, Fig. 10B and 12A).
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn pictures(title: &str, maps: &[Picture], columns: usize) -> Result<String, FigureError> {
    let columns = columns.max(1);
    let rows = maps.len().div_ceil(columns).max(1);
    page(
        "force maps",
        PageSize { width_px: 320 * columns as u32, height_px: 30 + 350 * rows as u32 },
        |area| {
            let titled = area.titled(title, TEXT)?;
            for (map, area) in maps.iter().zip(titled.split_evenly((rows, columns))) {
                let largest = map.map.iter().copied().fold(1e-6, f32::max);
                let half = SIDE_MM / 2.0;
                let mut chart = ChartBuilder::on(&area)
                    .caption(format!("{}, to {largest:.2} N per pixel", map.name), SMALL)
                    .margin(8)
                    .x_label_area_size(24)
                    .y_label_area_size(40)
                    .build_cartesian_2d(-half..half, -half..half)?;
                chart
                    .configure_mesh()
                    .disable_mesh()
                    .x_labels(3)
                    .y_labels(3)
                    .x_label_formatter(&whole)
                    .y_label_formatter(&whole)
                    .label_style(SMALL)
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

/// Draws mean and standard deviation of a Transfer-Net's residuals, by reading (paper, Fig. 10A).
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn residuals(mean_v: &[f32], sd_v: &[f32]) -> Result<String, FigureError> {
    let millivolts = |v: f32| 1e3 * f64::from(v);
    let largest = mean_v.iter().zip(sd_v).map(|(m, s)| millivolts(m.abs() + s));
    let most = 1.08 * largest.fold(1e-6, f64::max);
    page("residuals", PageSize { width_px: 1100, height_px: 460 }, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(18)
            .x_label_area_size(50)
            .y_label_area_size(70)
            .build_cartesian_2d(0.0..mean_v.len() as f64, -most..most)?;
        chart
            .configure_mesh()
            .x_label_formatter(&whole)
            .x_desc("reading (28 for each injection)")
            .y_desc("transfer error (mV)")
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.10))
            .label_style(SMALL)
            .axis_desc_style(TEXT)
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

/// A page that states that there is no data.
fn empty(title: &str) -> Result<String, FigureError> {
    page("an empty page", PageSize { width_px: 400, height_px: 120 }, |area| {
        area.draw_text(&format!("{title}: no data"), &TEXT.into_text_style(area), (20, 50))?;
        Ok(())
    })
}
