//! A plan on the skin: the tips of every configuration, coloured by their order, and the way of the
//! indenter, one panel per number of tips.
//! PURE. Uses: plotters, `skin`. Never: the plan itself (the caller passes positions).

use std::collections::BTreeSet;

use plotters::prelude::*;
use plotters::style::colors::colormaps::ViridisRGB;

use super::skin::{BAR_PX, Outline, colour_bar};
use super::style::{COLOURS, INK};
use super::{Area, Drawn, Heading, NumberChart, PageSize, figure};

/// Most panels next to each other.
const PANELS_ACROSS: usize = 3;
/// Width of the skin in a panel, px: a single one, and one of several.
const SKIN_PX: [u32; 2] = [520, 320];
/// Most stops whose way is drawn: of more it would cover the tips.
pub const WAY_STOPS: usize = 400;
/// Most stops whose arms are drawn, from the centre to each tip.
const ARM_STOPS: usize = 60;

/// A stretch of a plan.
#[derive(Debug, Clone, PartialEq)]
pub struct Leg {
    /// Name above the panel.
    pub name: String,
    /// Configurations in their order.
    pub stops: Vec<Stop>,
    /// Positions of reference presses, mm.
    pub references_mm: Vec<[f64; 2]>,
}

/// A configuration or a manual trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Stop {
    /// Centre of the indenter, mm; absent for weights that a person places.
    pub centre_mm: Option<[f64; 2]>,
    /// Positions of the contacts, mm.
    pub tips_mm: Vec<[f64; 2]>,
}

/// Draws the legs on the skin, in their order.
///
/// # Errors
/// Text of the error of the plotting backend.
pub fn tour(heading: &Heading, outline: &Outline, legs: &[Leg]) -> Result<String, String> {
    let count = legs.len().max(1);
    let columns = count.min(PANELS_ACROSS);
    let rows = count.div_ceil(columns);
    let panel = outline.panel(SKIN_PX[usize::from(count > 1)]);
    let panels_px = panel.width_px * columns as u32;
    let size = PageSize { width_px: panels_px + BAR_PX, height_px: panel.height_px * rows as u32 };
    let stops = legs.iter().map(|leg| leg.stops.len()).sum::<usize>();
    figure(size, heading, |area| {
        let (left, right) = area.split_horizontally(panels_px);
        let mut before = 0;
        for (leg, area) in legs.iter().zip(left.split_evenly((rows, columns))) {
            let shade =
                |at: usize| order((before + at) as f64 / stops.max(2).saturating_sub(1) as f64);
            draw(&area, outline, leg, shade, if count > 1 { 2 } else { 4 })?;
            before += leg.stops.len();
        }
        let (bar, _) = right.split_vertically(panel.height_px);
        colour_bar(&bar, "configuration, in order", [1.0, stops.max(2) as f64], |at| {
            order((at - 1.0) / (stops.max(2) - 1) as f64)
        })
    })
}

/// Colour of a share of the plan, 0 to 1; the light end of the scale is not visible on white.
fn order(share: f64) -> RGBColor {
    ViridisRGB.get_color(0.92 * share.clamp(0.0, 1.0))
}

fn draw(
    area: &Area<'_>,
    outline: &Outline,
    leg: &Leg,
    shade: impl Fn(usize) -> RGBColor,
    radius_px: i32,
) -> Drawn {
    let mut chart = outline.chart(area, &leg.name)?;
    if leg.stops.len() <= WAY_STOPS {
        way(&mut chart, leg)?;
    }
    outline.edge(&mut chart, radius_px + 1)?;
    if leg.stops.len() <= ARM_STOPS {
        for (at, stop) in leg.stops.iter().enumerate() {
            let Some([x, y]) = stop.centre_mm else { continue };
            let arms = stop.tips_mm.iter().map(|tip| [(x, y), (tip[0], tip[1])]);
            let style = shade(at).mix(0.6).stroke_width(1);
            chart.draw_series(arms.map(|arm| PathElement::new(arm, style)))?;
        }
    }
    // Each position has the colour of its first visit: plans of many configurations repeat them.
    let mut seen = BTreeSet::new();
    for (at, stop) in leg.stops.iter().enumerate() {
        let tenths = |mm: f64| (10.0 * mm).round() as i64;
        let fresh = stop.tips_mm.iter().filter(|[x, y]| seen.insert([tenths(*x), tenths(*y)]));
        let tips: Vec<_> = fresh.map(|[x, y]| (*x, *y)).collect();
        let style = shade(at).filled();
        chart.draw_series(tips.into_iter().map(|tip| Circle::new(tip, radius_px, style)))?;
    }
    chart.draw_series(
        leg.references_mm
            .iter()
            .map(|[x, y]| Cross::new((*x, *y), radius_px + 3, COLOURS[5].stroke_width(2))),
    )?;
    if let Some([x, y]) = leg.stops.first().and_then(|stop| stop.centre_mm) {
        chart.draw_series([
            TriangleMarker::new((x, y), radius_px + 5, WHITE.filled()),
            TriangleMarker::new((x, y), radius_px + 3, INK.filled()),
        ])?;
    }
    Ok(())
}

/// The way of the indenter's centre.
fn way(chart: &mut NumberChart<'_, '_>, leg: &Leg) -> Drawn {
    let centres = leg.stops.iter().filter_map(|stop| stop.centre_mm).map(|[x, y]| (x, y));
    chart.draw_series(LineSeries::new(centres, INK.mix(0.35).stroke_width(1)))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outline() -> Outline {
        let electrodes_mm = vec![[10.0, 10.0], [90.0, 110.0]];
        Outline { size_mm: [100.0, 120.0], electrodes_mm, pitch_mm: 20.0 }
    }

    #[test]
    fn every_tip_every_electrode_and_the_reference_are_drawn() {
        let stop =
            |x: f64| Stop { centre_mm: Some([x, 60.0]), tips_mm: vec![[x, 50.0], [x, 70.0]] };
        let leg = |name: &str| Leg {
            name: name.into(),
            stops: vec![stop(20.0), stop(50.0), stop(80.0)],
            references_mm: vec![[50.0, 60.0]],
        };
        let heading = Heading::new("Plan", 6, "configurations", "planned, virtual");
        let svg = tour(&heading, &outline(), &[leg("1 tip"), leg("2 tips")]).unwrap();
        assert!(svg.contains("planned, virtual, n = 6 configurations"), "{svg}");
        assert!(svg.contains("1 tip") && svg.contains("2 tips") && svg.contains("x (mm)"));
        // Six tips, and two circles of each of two electrodes, in each panel.
        assert_eq!(svg.matches("<circle").count(), 2 * (6 + 4));
    }

    #[test]
    fn a_plan_of_one_stop_or_none_is_drawn() {
        let stop = Stop { centre_mm: None, tips_mm: vec![[20.0, 20.0]] };
        let leg = Leg { name: "manual".into(), stops: vec![stop], references_mm: Vec::new() };
        let heading = Heading::new("Plan", 1, "trials", "planned, measured");
        assert!(!tour(&heading, &outline(), &[leg]).unwrap().contains("NaN"));
        assert!(!tour(&heading, &outline(), &[]).unwrap().contains("NaN"));
    }
}
