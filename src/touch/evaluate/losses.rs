//! A learning curve: training and validation loss over the epochs of a training.
//! PURE. Uses: plotters, `figure`, `evaluate::{figures, charts}` (page, scale). Never: files.

use plotters::prelude::*;
use serde::Deserialize;

use super::charts::{empty, upwards};
use super::figures::{FigureResult, page};
use crate::figure::series::MARKED_POINTS;
use crate::figure::style::{AxesStyle, COLOURS, INK, dash, decade, framed, legend, whole};
use crate::figure::{Heading, PageSize};

/// Losses of an epoch, as a training stores them.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct EpochLoss {
    /// Number of the epoch, from 1.
    pub epoch: u32,
    /// Mean loss on the training samples.
    pub train_loss: f64,
    /// Loss on the validation samples.
    pub validation_loss: Option<f64>,
}

/// Size of the learning curve.
const LOSSES_SIZE: PageSize = PageSize { width_px: 960, height_px: 520 };

/// Reads the losses of a training: a JSON object per line. Lines that are none are skipped.
pub fn read(lines: &str) -> Vec<EpochLoss> {
    lines.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
}

/// The epoch with the least validation loss, of equal ones the first.
pub fn best(losses: &[EpochLoss]) -> Option<(u32, f64)> {
    let known = losses.iter().filter_map(|at| Some((at.epoch, at.validation_loss?)));
    known.filter(|at| at.1.is_finite()).min_by(|a, b| a.1.total_cmp(&b.1))
}

/// Draws both losses over the epochs on a logarithmic scale, and marks the best epoch. `unit`: the name
/// of the loss with its unit.
///
/// # Errors
/// `FigureError` if the plotting backend fails.
pub fn curve(heading: &Heading, unit: &str, losses: &[EpochLoss]) -> FigureResult<String> {
    type Pick = fn(&EpochLoss) -> Option<f64>;
    let picks: [(&str, Pick, RGBColor); 2] = [
        ("training", |at| Some(at.train_loss), COLOURS[2]),
        ("validation", |at| at.validation_loss, COLOURS[1]),
    ];
    let places = |pick: Pick| -> Vec<(f64, f64)> {
        let all = losses.iter().filter_map(|at| Some((f64::from(at.epoch), pick(at)?)));
        all.filter(|(_, loss)| loss.is_finite() && *loss > 0.0).collect()
    };
    let all: Vec<(f64, f64)> = picks.iter().flat_map(|(_, pick, _)| places(*pick)).collect();
    if all.is_empty() {
        return empty(heading);
    }
    let right = all.iter().map(|at| at.0).fold(1.0, f64::max);
    let (low, high) =
        all.iter().fold((f64::MAX, f64::MIN), |(l, h), at| (l.min(at.1), h.max(at.1)));
    let room = (right * 0.02).max(0.2);
    page("learning curve", LOSSES_SIZE, heading, |area| {
        let mut chart = framed(area, [14, 50, 92])
            .build_cartesian_2d(1.0 - room..right + room, upwards(low / 1.3, high * 1.3))?;
        chart
            .configure_mesh()
            .x_labels((right as usize).clamp(2, 12))
            .named("epoch", &whole, unit, &decade)
            .draw()?;
        for (name, pick, colour) in picks {
            let places = places(pick);
            chart
                .draw_series(LineSeries::new(places.iter().copied(), colour.stroke_width(3)))?
                .label(name)
                .legend(dash(colour));
            if places.len() <= MARKED_POINTS {
                chart.draw_series(places.iter().map(|at| Circle::new(*at, 3, colour.filled())))?;
            }
        }
        if let Some((epoch, loss)) = best(losses).filter(|(_, loss)| *loss > 0.0) {
            let x = f64::from(epoch);
            let line = [(x, low / 1.3), (x, high * 1.3)];
            chart.draw_series(DashedLineSeries::new(line, 5, 5, INK.mix(0.6).stroke_width(1)))?;
            chart
                .draw_series([Circle::new((x, loss), 7, COLOURS[5].stroke_width(3))])?
                .label(format!("best epoch {epoch}: {}", short(loss)))
                .legend(|(x, y)| Circle::new((x + 11, y), 6, COLOURS[5].stroke_width(3)));
        }
        legend(&mut chart, SeriesLabelPosition::UpperRight)
    })
}

/// A loss with three digits.
fn short(loss: f64) -> String {
    if (1e-2..1e3).contains(&loss) { format!("{loss:.3}") } else { format!("{loss:.2e}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINES: &str = "{\"epoch\":1,\"samples\":9,\"train_loss\":0.5,\"validation_loss\":0.4}\n\
        {\"epoch\":2,\"train_loss\":0.2,\"validation_loss\":0.1}\n\
        {\"epoch\":3,\"train_loss\":0.1,\"validation_loss\":0.3}\nnot a line\n";

    #[test]
    fn the_best_epoch_is_that_of_the_least_validation_loss() {
        let losses = read(LINES);
        assert_eq!((losses.len(), best(&losses)), (3, Some((2, 0.1))));
        let heading = Heading::new("Learning curve of net", 3, "epochs", "virtual");
        let svg = curve(&heading, "loss", &losses).unwrap();
        assert!(svg.contains("best epoch 2: 0.100") && svg.contains("virtual, n = 3 epochs"));
        assert!(svg.contains("epoch") && !svg.contains("NaN"));
    }

    #[test]
    fn a_training_without_an_epoch_has_no_curve() {
        let heading = Heading::new("Learning curve of net", 0, "epochs", "virtual");
        assert!(curve(&heading, "loss", &[]).unwrap().contains("no data"));
    }
}
