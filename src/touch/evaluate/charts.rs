//! Scores as pictures: small multiples of lines, means, heat maps. SVG text from numbers.
//! PURE. Uses: plotters, `figure`, `evaluate::figures` (page). Never: files.

use plotters::coord::combinators::WithKeyPoints;
use plotters::coord::ranged1d::SegmentedCoord;
use plotters::coord::types::RangedCoordusize;
use plotters::prelude::*;
use plotters::style::colors::colormaps::ViridisRGB;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::figures::{FigureResult, page};
use crate::figure::style::{AxesStyle, COLOURS, INK, SMALL, TEXT, TINY, framed, plain, whole};
use crate::figure::{Area, Drawn, Heading, PageSize, with_n};

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
    /// Number of the averaged values.
    pub n: u64,
}

/// A quantity by pixel size and diameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Heat {
    /// Name of the quantity.
    pub name: String,
    /// Pixel and diameter, mm, and the value.
    pub cells: Vec<([f64; 2], f64)>,
}

/// One panel of several: lines over the number of contacts.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// Name above the panel.
    pub name: String,
    /// Largest x that is marked as known, as by the training; 0 for none.
    pub known_to: f64,
    /// Values here, published ones, and those without a net, in this order; a legend names them.
    pub lines: Vec<Line>,
}

/// Columns of panels, and the size of a panel, px.
const CHARTS_ACROSS: usize = 3;
const PANEL: [u32; 2] = [350, 290];
/// Height of the legend below the panels, px.
const LEGEND_PX: u32 = 34;
/// Colours of the lines of a panel: here, published, without a net.
const ROLES: [RGBColor; 3] = [COLOURS[1], COLOURS[5], COLOURS[0]];

/// Draws panels with common axes: x whole numbers, y logarithmic. Only neighbouring whole numbers are
/// joined: a missing one is a gap.
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn panels(heading: &Heading, x: &str, y: &str, panels: &[Panel]) -> FigureResult<String> {
    let all = || panels.iter().flat_map(|panel| &panel.lines).flat_map(|line| &line.places);
    let (left, right) = all().fold((f64::MAX, f64::MIN), |(l, r), p| (l.min(p.0), r.max(p.0)));
    let (low, high) =
        all().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(p.1.max(1e-3)), h.max(p.1)));
    if left > right {
        return empty(heading);
    }
    let ends = [left - 0.4, right + 0.4, low / 1.5, high.max(2e-3) * 1.5];
    let rows = panels.len().div_ceil(CHARTS_ACROSS) as u32;
    let panels_px = PANEL[1] * rows;
    let size =
        PageSize { width_px: PANEL[0] * CHARTS_ACROSS as u32, height_px: panels_px + LEGEND_PX };
    page("panels", size, heading, |area| {
        let (above, below) = area.split_vertically(panels_px);
        for (panel, area) in panels.iter().zip(above.split_evenly((rows as usize, CHARTS_ACROSS))) {
            draw_panel(&area, [x, y], ends, panel)?;
        }
        let names = panels.iter().map(|panel| &panel.lines).max_by_key(|lines| lines.len());
        for (at, (line, colour)) in names.into_iter().flatten().zip(ROLES).enumerate() {
            let left = 60 + 300 * at as i32;
            mark(&below, (left + 11, 12), at, colour)?;
            below.draw(&Text::new(line.name.as_str(), (left + 32, 4), SMALL))?;
        }
        Ok(())
    })
}

fn draw_panel(
    area: &Area<'_>,
    [x, y]: [&str; 2],
    [left, right, low, high]: [f64; 4],
    panel: &Panel,
) -> Drawn {
    let mut chart = framed(area, [8, 44, 60])
        .caption(&panel.name, SMALL)
        .build_cartesian_2d(left..right, upwards(low, high))?;
    if panel.known_to > 0.0 {
        let known = [(left, low), (panel.known_to + 0.4, high)];
        chart.draw_series([Rectangle::new(known, COLOURS[2].mix(0.12).filled())])?;
    }
    chart
        .configure_mesh()
        .x_labels((right - left) as usize + 1)
        .named(x, &whole, y, &plain)
        .label_style(TINY)
        .axis_desc_style(SMALL)
        .draw()?;
    // Values here are drawn last, above the others.
    for (at, (line, colour)) in panel.lines.iter().zip(ROLES).enumerate().rev() {
        let places: Vec<(f64, f64)> = line.places.iter().map(|(x, y)| (*x, y.max(1e-3))).collect();
        for stretch in places.chunk_by(|a, b| b.0 - a.0 < 1.5) {
            let stretch = stretch.iter().copied();
            if at == 0 {
                chart.draw_series(LineSeries::new(stretch, colour.stroke_width(3)))?;
            } else {
                let dashed = DashedLineSeries::new(stretch, 6, 4, colour.stroke_width(2));
                chart.draw_series(dashed)?;
            }
        }
        if at == 0 {
            chart.draw_series(places.iter().map(|at| Circle::new(*at, 4, colour.filled())))?;
        } else {
            let rings = places.iter().map(|at| Circle::new(*at, 4, colour.stroke_width(2)));
            chart.draw_series(rings)?;
        }
    }
    Ok(())
}

/// Mark of a line in the legend below the panels.
fn mark(area: &Area<'_>, (x, y): (i32, i32), role: usize, colour: RGBColor) -> Drawn {
    let stretches = if role == 0 { vec![[-14, 14]] } else { vec![[-14, -8], [-4, 4], [8, 14]] };
    for [from, to] in stretches {
        area.draw(&PathElement::new([(x + from, y), (x + to, y)], colour.stroke_width(3)))?;
    }
    let style = if role == 0 { colour.filled() } else { colour.stroke_width(2) };
    area.draw(&Circle::new((x, y), 4, style))?;
    Ok(())
}

/// A logarithmic scale with labels at 1, 2 and 5 of every decade; on a short one also between them.
pub(super) fn upwards(low: f64, high: f64) -> WithKeyPoints<LogCoord<f64>> {
    let decades = low.log10().floor() as i32..=high.log10().floor() as i32;
    let named = |step: usize, digits: &[u32]| -> Vec<f64> {
        let digits = digits.iter().flat_map(|digit| (0..step).map(move |k| (*digit, k)));
        let digits: Vec<f64> =
            digits.map(|(digit, k)| f64::from(digit) + k as f64 / step as f64).collect();
        let all = decades.clone().flat_map(|decade| {
            digits.iter().map(move |digit| digit * 10f64.powi(decade)).collect::<Vec<_>>()
        });
        all.filter(|value| (low..high).contains(value)).collect()
    };
    let every: Vec<u32> = (1..10).collect();
    let choices = [
        named(1, &[1, 2, 5]),
        named(1, &every),
        named(2, &every),
        named(5, &every),
        named(10, &every),
    ];
    let [.., finest] = &choices;
    let chosen = choices.iter().find(|points| points.len() > 2).unwrap_or(finest).clone();
    (low..high).log_scale().with_key_points(chosen)
}

/// An axis of this many segments; plotters counts the end of a range as one.
pub(super) fn segments(count: usize) -> SegmentedCoord<RangedCoordusize> {
    (0..count.saturating_sub(1).max(1)).into_segmented()
}

/// The item whose segment this is, if items are drawn one below the other, the first at the top.
pub(super) fn from_top<'a, T>(at: &SegmentValue<usize>, items: &'a [T]) -> Option<&'a T> {
    let SegmentValue::CenterOf(at) = at else { return None };
    items.iter().rev().nth(*at)
}

/// Draws means and standard deviations, one below the other. `x`: the quantity with its unit.
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn bars(heading: &Heading, x: &str, bars: &[Bar]) -> FigureResult<String> {
    let low = bars.iter().map(|bar| bar.mean - bar.sd).fold(0.0, f64::min);
    let high = bars.iter().map(|bar| bar.mean + bar.sd).fold(0.0, f64::max);
    let room = (0.05 * (high - low)).max(1e-6);
    let count = bars.len();
    if count == 0 {
        return empty(heading);
    }
    let heading = heading.clone().with_note(format!(
        "{}Dots: means; lines: one standard deviation to each side",
        if heading.note.is_empty() { String::new() } else { format!("{}. ", heading.note) }
    ));
    let size = PageSize { width_px: 960, height_px: 80 + 30 * count as u32 };
    page("bars", size, &heading, |area| {
        let mut chart = framed(area, [18, 50, 330])
            .build_cartesian_2d(low - room..high + room, segments(count))?;
        chart
            .configure_mesh()
            .disable_y_mesh()
            .x_desc(x)
            .x_label_formatter(&plain)
            .y_labels(count)
            .y_label_formatter(&|at| {
                let bar = from_top(at, bars);
                bar.map_or(String::new(), |bar| with_n(&bar.name, bar.n))
            })
            .styled()
            .draw()?;
        let zero = [(0.0, SegmentValue::Exact(0)), (0.0, SegmentValue::Last)];
        chart.draw_series([PathElement::new(zero, INK.mix(0.4))])?;
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
pub fn heats(heading: &Heading, heats: &[Heat]) -> FigureResult<String> {
    let axis = |pick: usize| {
        let cells = heats.iter().flat_map(|heat| &heat.cells);
        let mut values: Vec<f64> = cells.map(|(at, _)| at[pick]).collect();
        values.sort_by(f64::total_cmp);
        values.dedup();
        values
    };
    let (pixels, diameters) = (axis(0), axis(1));
    if pixels.is_empty() {
        return empty(heading);
    }
    page("heat maps", PageSize { width_px: 1240, height_px: 390 }, heading, |area| {
        for (heat, area) in heats.iter().zip(area.split_evenly((1, heats.len()))) {
            let largest = heat.cells.iter().map(|cell| cell.1.abs()).fold(1e-9, f64::max);
            let mut chart = framed(&area, [10, 44, 52])
                .caption(&heat.name, SMALL)
                .build_cartesian_2d(segments(pixels.len()), segments(diameters.len()))?;
            let named = |values: &[f64], at: &SegmentValue<usize>| match at {
                SegmentValue::CenterOf(at) => values.get(*at).map(whole).unwrap_or_default(),
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
                let style = TextStyle::from(TINY.into_font()).color(&ink);
                let centred = style.pos(Pos::new(HPos::Center, VPos::Center));
                let at = (SegmentValue::CenterOf(x), SegmentValue::CenterOf(y));
                chart.draw_series([Text::new(format!("{value:.0}"), at, centred)])?;
            }
        }
        Ok(())
    })
}

/// A page that states that there is no data.
pub(super) fn empty(heading: &Heading) -> FigureResult<String> {
    page("an empty page", PageSize { width_px: 500, height_px: 80 }, heading, |area| {
        area.draw_text("no data", &TEXT.into_text_style(area), (20, 20))?;
        Ok(())
    })
}
