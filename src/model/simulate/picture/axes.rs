//! Scales of the figure: the edges of the support with ticks, the stretched height, the colour bar.
//! PURE. Uses: `svg`. Never: the load.

use super::svg::{Drawing, View};
use super::{Part, compression_colour};

/// Length of a tick, as a share of the part's longer side.
const TICK_SHARE: f64 = 0.014;
/// Number of colour steps of the bar.
const BAR_STEPS: usize = 64;

/// Smallest 1, 2 or 5 times a power of ten that is not below `value`; 0.1 for zero.
pub(super) fn round_up(value: f64) -> f64 {
    if value <= 1e-3 {
        return 0.1;
    }
    let decade = 10f64.powf(value.log10().floor());
    let found =
        [1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0].iter().find(|m| *m * decade >= value);
    found.unwrap_or(&10.0) * decade
}

/// Even ticks within a range, about `count` of them.
fn ticks(from: f64, to: f64, count: f64) -> Vec<f64> {
    let rough = (to - from) / count;
    let decade = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].iter().map(|m| m * decade).find(|s| *s >= rough);
    let step = step.unwrap_or(10.0 * decade);
    let first = (from / step - 1e-9).ceil() as i64;
    let last = (to / step + 1e-9).floor() as i64;
    (first..=last).map(|i| i as f64 * step).collect()
}

/// A number without trailing zeros.
pub(super) fn number(value: f64) -> String {
    let text = format!("{value:.3}");
    text.trim_end_matches('0').trim_end_matches('.').into()
}

/// The support under the part: its outline, ticks in millimetres along the two near edges, and the
/// stretch of heights.
pub(super) fn draw(out: &mut Drawing, view: &View, part: &Part) {
    let floor = part.floor();
    out.group("stroke=\"#9a9aa2\" stroke-width=\"0.8\"");
    out.polygon(&floor.map(|c| view.place(c)), [238.0, 238.0, 240.0]);
    out.end_group();
    let [[x0, x1], [y0, y1]] = part.range_mm;
    let tick = TICK_SHARE * part.longer_mm();
    // With a turn to the right the near edges are y0 and x1; to the left, y0 and x0.
    let (side, outwards) = if view.away([1.0, 0.0]) < 0.0 { (x1, tick) } else { (x0, -tick) };
    out.group("stroke=\"#555\" stroke-width=\"1\" fill=\"#333\" font-size=\"13\"");
    let mut marks = Vec::new();
    for x in ticks(x0, x1, 6.0) {
        let [on, off, words] = [0.0, 1.0, 3.2].map(|n| view.place([x, y0 - n * tick, 0.0]));
        out.stroke(on, off);
        marks.push((words, number(x)));
    }
    for y in ticks(y0, y1, 6.0) {
        let [on, off, words] = [0.0, 1.0, 2.6].map(|n| view.place([side + n * outwards, y, 0.0]));
        out.stroke(on, off);
        marks.push((words, number(y)));
    }
    out.end_group();
    let middle = |[from, to]: [f64; 2]| (from + to) / 2.0;
    let away = 7.5 * tick;
    marks.push((view.place([middle(part.range_mm[0]), y0 - away, 0.0]), "x (mm)".into()));
    marks.push((
        view.place([side + away * outwards.signum(), middle(part.range_mm[1]), 0.0]),
        "y (mm)".into(),
    ));
    marks.push(height_bar(out, view, part, outwards));
    out.group("fill=\"#333\" font-size=\"13\"");
    for ([x, y], words) in marks {
        out.words([x, y + 5.0], "middle", &words);
    }
    out.end_group();
}

/// The unloaded skin's height, at the outer end of the x axis; returns the position and the text.
fn height_bar(out: &mut Drawing, view: &View, part: &Part, outwards: f64) -> ([f64; 2], String) {
    let [[x0, x1], [y0, _]] = part.range_mm;
    let x = if outwards < 0.0 { x1 } else { x0 } - 2.5 * outwards;
    let [low, high] = [0.0, part.height_mm].map(|z| view.place([x, y0, z]));
    out.group("stroke=\"#555\" stroke-width=\"1\"");
    out.stroke(low, high);
    for [x, y] in [low, high] {
        out.stroke([x - 4.0, y], [x + 4.0, y]);
    }
    out.end_group();
    ([high[0], high[1] - 14.0], format!("{} mm", number(part.height_mm)))
}

/// The scale of the foam's compression, from 0 to `most_mm`; `left, top, right, bottom` in px.
pub(super) fn colour_bar(out: &mut Drawing, [left, top, right, bottom]: [f64; 4], most_mm: f64) {
    let height = |share: f64| bottom + share * (top - bottom);
    out.group("stroke=\"none\"");
    for step in 0..BAR_STEPS {
        let [low, high] = [step, step + 1].map(|s| height(s as f64 / BAR_STEPS as f64));
        let colour = compression_colour((step as f64 + 0.5) / BAR_STEPS as f64);
        // Half a pixel of overlap avoids a visible seam.
        let high = high - if step + 1 < BAR_STEPS { 0.5 } else { 0.0 };
        out.polygon(&[[left, low], [right, low], [right, high], [left, high]], colour);
    }
    out.end_group();
    out.group("stroke=\"#333\" stroke-width=\"1\"");
    let corners = [[left, top], [right, top], [right, bottom], [left, bottom]];
    for (i, corner) in corners.iter().enumerate() {
        out.stroke(*corner, corners[(i + 1) % 4]);
    }
    let values = ticks(0.0, most_mm, 5.0);
    for value in &values {
        let y = height(value / most_mm);
        out.stroke([right, y], [right + 5.0, y]);
    }
    out.end_group();
    out.group("fill=\"#333\" font-size=\"13\"");
    for value in values {
        out.words([right + 9.0, height(value / most_mm) + 4.5], "start", &number(value));
    }
    out.words([left - 2.0, top - 30.0], "start", "compression");
    out.words([left - 2.0, top - 14.0], "start", "of the foam (mm)");
    out.end_group();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_end_at_round_numbers() {
        assert_eq!([0.0, 0.1, 0.37, 1.01, 3.2, 9.0].map(round_up), [0.1, 0.1, 0.4, 1.5, 4.0, 10.0]);
        assert_eq!(ticks(0.0, 1.5, 5.0), [0.0, 0.5, 1.0, 1.5]);
        assert_eq!(ticks(81.0, 460.0, 5.0), [100.0, 200.0, 300.0, 400.0]);
        assert_eq!(["0.5", "100", "0"], [0.5, 100.0, 0.0].map(number).each_ref().map(|s| &**s));
    }
}
