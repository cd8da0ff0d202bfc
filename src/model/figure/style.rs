//! Fonts, colours, numbers and legends that the figures share.
//! PURE. Uses: plotters. Never: the meaning of a figure.

use std::error::Error;

use plotters::chart::MeshStyle;
use plotters::coord::{CoordTranslate, Shift};
use plotters::prelude::*;

/// Font of all figures: the first family that the viewer has.
pub const FONT: &str = "Helvetica, Arial, Liberation Sans, sans-serif";
/// Font of names of axes.
pub const TEXT: (&str, i32) = (FONT, 18);
/// Font of numbers, legends and names of parts.
pub const SMALL: (&str, i32) = (FONT, 16);
/// Font of numbers within a drawing.
pub const TINY: (&str, i32) = (FONT, 14);
/// Colour of text and lines.
pub const INK: RGBColor = RGBColor(40, 40, 40);
/// Dark on white, distinguishable with colour blindness (Okabe and Ito), 0 to 6 contacts.
pub const COLOURS: [RGBColor; 7] = [
    RGBColor(120, 120, 120),
    RGBColor(0, 114, 178),
    RGBColor(230, 159, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(213, 94, 0),
    RGBColor(86, 180, 233),
];
/// Below zero, at zero, above zero: blue, white, red, distinguishable with colour blindness.
const DIVERGING: [RGBColor; 3] =
    [RGBColor(33, 102, 172), RGBColor(247, 247, 247), RGBColor(178, 24, 43)];

/// Lines and texts of the axes of every figure.
pub trait AxesStyle<'b, X: Ranged, Y: Ranged> {
    /// Sets them; what is set afterwards differs from other figures.
    fn styled(&mut self) -> &mut Self;

    /// Sets them, and for both axes the name with its unit and the text of a number.
    fn named(
        &mut self,
        x: impl Into<String>,
        x_text: &'b dyn Fn(&X::ValueType) -> String,
        y: impl Into<String>,
        y_text: &'b dyn Fn(&Y::ValueType) -> String,
    ) -> &mut Self;
}

impl<'b, X: Ranged, Y: Ranged, DB: DrawingBackend> AxesStyle<'b, X, Y>
    for MeshStyle<'_, 'b, X, Y, DB>
{
    fn styled(&mut self) -> &mut Self {
        self.light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.10))
            .label_style(SMALL)
            .axis_desc_style(TEXT)
    }

    fn named(
        &mut self,
        x: impl Into<String>,
        x_text: &'b dyn Fn(&X::ValueType) -> String,
        y: impl Into<String>,
        y_text: &'b dyn Fn(&Y::ValueType) -> String,
    ) -> &mut Self {
        self.x_desc(x).x_label_formatter(x_text).y_desc(y).y_label_formatter(y_text).styled()
    }
}

/// A chart on an area with room around it, px: the margin, that of the names below and that of the names on the left.
pub fn framed<'t, DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    [margin_px, below_px, left_px]: [u32; 3],
) -> ChartBuilder<'_, 't, DB> {
    let mut chart = ChartBuilder::on(area);
    chart.margin(margin_px).x_label_area_size(below_px).y_label_area_size(left_px);
    chart
}

/// A whole number.
pub fn whole(value: &f64) -> String {
    format!("{value:.0}")
}

/// A number without trailing zeros, of at most six digits after the point.
pub fn plain(value: &f64) -> String {
    let rounded = (value * 1e6).round() / 1e6;
    format!("{}", if rounded == 0.0 { 0.0 } else { rounded })
}

/// A power of ten as a number, if it is short, otherwise as `1e-5`.
pub fn decade(value: &f64) -> String {
    if (1e-3..1e4).contains(value) { plain(value) } else { format!("{value:.0e}") }
}

/// Colour of a share from -1 (blue) over 0 (white) to 1 (red).
pub fn diverging(share: f64) -> RGBColor {
    let [below, middle, above] = DIVERGING;
    let end = if share < 0.0 { below } else { above };
    let part = share.abs().min(1.0);
    let mix = |from: u8, to: u8| {
        (f64::from(from) + part * (f64::from(to) - f64::from(from))).round() as u8
    };
    RGBColor(mix(middle.0, end.0), mix(middle.1, end.1), mix(middle.2, end.2))
}

/// Line next to a name in a legend.
pub fn dash(colour: RGBColor) -> impl Fn((i32, i32)) -> PathElement<(i32, i32)> {
    move |(x, y)| PathElement::new([(x, y), (x + 22, y)], colour.stroke_width(3))
}

/// Draws the legend of the named series.
///
/// # Errors
/// Error of the plotting backend.
pub fn legend<'a, 'b: 'a, C: CoordTranslate>(
    chart: &mut ChartContext<'a, SVGBackend<'b>, C>,
    position: SeriesLabelPosition,
) -> Result<(), Box<dyn Error>> {
    chart
        .configure_series_labels()
        .position(position)
        .background_style(WHITE.mix(0.9))
        .border_style(BLACK.mix(0.3))
        .label_font(SMALL)
        .draw()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_axes_are_short() {
        assert_eq!([0.1 + 0.2, 100.0, -1e-9, 2.50].map(|v| plain(&v)), ["0.3", "100", "0", "2.5"]);
        assert_eq!([0.01, 1e-5, 1e6].map(|v| decade(&v)), ["0.01", "1e-5", "1e6"]);
    }

    #[test]
    fn the_diverging_scale_is_white_at_zero_and_ends_at_one() {
        assert_eq!(diverging(0.0), DIVERGING[1]);
        assert_eq!([diverging(-3.0), diverging(1.0)], [DIVERGING[0], DIVERGING[2]]);
    }
}
