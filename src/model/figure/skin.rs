//! The outline of a skin with its electrodes, at the same scale along x and y, and colour bars.
//! PURE. Uses: plotters, sim-core's sensor. Never: what is drawn on the skin.

use plotters::prelude::*;
use sim_core::sensor::Sensor;

use super::style::{INK, SMALL, plain, whole};
use super::{Area, Drawn, NumberChart, PageSize};

/// The outline of a skin.
#[derive(Debug, Clone, PartialEq)]
pub struct Outline {
    /// Width and height, mm.
    pub size_mm: [f64; 2],
    /// Positions of the electrodes, mm.
    pub electrodes_mm: Vec<[f64; 2]>,
    /// Distance between neighbouring points, mm.
    pub pitch_mm: f64,
}

/// Space around the skin, as a share of its width.
const AROUND: f64 = 0.03;
/// Heights of caption and of numbers below a chart, width of numbers left of it, margin, px.
const CAPTION: u32 = 30;
const BELOW: u32 = 46;
const LEFT: u32 = 58;
const MARGIN: u32 = 10;
/// Width of the part of a figure that holds a colour bar, px.
pub const BAR_PX: u32 = 112;
/// Number of steps of a colour bar.
const BAR_STEPS: u32 = 100;

impl Outline {
    /// The outline of a sensor.
    pub fn of(sensor: &Sensor) -> Self {
        Self {
            size_mm: [sensor.file.width_mm, sensor.file.height_mm],
            electrodes_mm: sensor.electrodes_mm().to_vec(),
            pitch_mm: sensor.pitch_mm(),
        }
    }

    /// Size of a panel in which the skin is about `width_px` wide.
    pub fn panel(&self, width_px: u32) -> PageSize {
        let [width, height] = self.size_mm;
        let around = 2.0 * AROUND * width;
        let tall = f64::from(width_px) * (height + around) / (width + around);
        PageSize {
            width_px: width_px + LEFT + 2 * MARGIN,
            height_px: tall.round() as u32 + BELOW + CAPTION + 2 * MARGIN,
        }
    }

    /// Draws axes and outline on an area of the size of [`Outline::panel`].
    ///
    /// # Errors
    /// Error of the plotting backend.
    pub fn chart<'a, 'b>(&self, area: &'a Area<'b>, caption: &str) -> Drawn<NumberChart<'a, 'b>> {
        let [width, height] = self.size_mm;
        let around = AROUND * width;
        let mut builder = ChartBuilder::on(area);
        builder.margin(MARGIN).x_label_area_size(BELOW).y_label_area_size(LEFT);
        if caption.is_empty() {
            builder.margin_top(MARGIN + CAPTION);
        } else {
            // A caption is as high as its text and a quarter more.
            builder.caption(caption, SMALL).margin_top(MARGIN + CAPTION - 21);
        }
        let mut chart =
            builder.build_cartesian_2d(-around..width + around, -around..height + around)?;
        chart
            .configure_mesh()
            .disable_mesh()
            .x_label_formatter(&whole)
            .y_label_formatter(&whole)
            .x_desc("x (mm)")
            .y_desc("y (mm)")
            .axis_style(INK.mix(0.4))
            .label_style(SMALL)
            .axis_desc_style(SMALL)
            .draw()?;
        chart.draw_series([Rectangle::new([(0.0, 0.0), (width, height)], WHITE.filled())])?;
        Ok(chart)
    }

    /// Draws the edge of the skin, above what lies on it, and the electrodes as circles of this
    /// radius.
    ///
    /// # Errors
    /// Error of the plotting backend.
    pub fn edge(&self, chart: &mut NumberChart<'_, '_>, radius_px: i32) -> Drawn {
        let [width, height] = self.size_mm;
        let corners = [(0.0, 0.0), (width, height)];
        chart.draw_series([Rectangle::new(corners, INK.stroke_width(2))])?;
        chart.draw_series(self.electrodes_mm.iter().map(|[x, y]| {
            EmptyElement::at((*x, *y))
                + Circle::new((0, 0), radius_px, WHITE.filled())
                + Circle::new((0, 0), radius_px, INK.stroke_width(1))
        }))?;
        Ok(())
    }
}

/// Draws a colour scale from `from` to `to`, with its name and unit.
///
/// # Errors
/// Error of the plotting backend.
pub fn colour_bar(
    area: &Area<'_>,
    name: &str,
    [from, to]: [f64; 2],
    colour: impl Fn(f64) -> RGBColor,
) -> Drawn {
    let mut chart = ChartBuilder::on(area)
        .margin_top(MARGIN + CAPTION)
        .margin_bottom(MARGIN + BELOW)
        .margin_right(12)
        .y_label_area_size(66)
        .build_cartesian_2d(0.0..1.0, from..to)?;
    // Each step reaches to the end: no seam between two.
    chart.draw_series((0..BAR_STEPS).map(|i| {
        let start = from + (to - from) * f64::from(i) / f64::from(BAR_STEPS);
        let middle = start + 0.5 * (to - from) / f64::from(BAR_STEPS);
        Rectangle::new([(0.0, start), (1.0, to)], colour(middle).filled())
    }))?;
    chart
        .configure_mesh()
        .disable_mesh()
        .disable_x_axis()
        .y_desc(name)
        .y_label_formatter(&plain)
        .label_style(SMALL)
        .axis_desc_style(SMALL)
        .draw()?;
    Ok(())
}
