//! The frames of an evaluation as text: voltages, and what is known of them.
//! PURE. Uses: `infer::{methods, scatter, untouched_frame}`. Never: a number that is read otherwise than it was written.

use crate::infer::methods::Frames;
use crate::infer::scatter::Scatter;
use crate::infer::untouched_frame::UntouchedBefore;

/// Stands for an unknown scatter.
const UNKNOWN_SCATTER: &str = "-";

/// A frame that is read by a method.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameInput {
    /// Voltages, V, injection-major.
    pub voltages_v: Vec<f32>,
    /// Number of frames that it is the mean of, >= 1.
    pub averaged: f64,
    /// The untouched skin before it, if it was measured.
    pub untouched: Option<UntouchedBefore>,
}

impl FrameInput {
    /// Frames as text, a line each: the number of averaged frames and the voltages, separated by commas; and if the
    /// untouched skin was measured, the number of its frames, its age (h), its scatter (standard
    /// deviation, V, and after `;` the spectrum, or `-`) and its voltages.
    pub fn lines(inputs: &[Self]) -> String {
        let voltages =
            |frame_v: &[f32]| frame_v.iter().map(ToString::to_string).collect::<Vec<_>>().join(",");
        let mut text = String::new();
        for Self { voltages_v, averaged, untouched } in inputs {
            text += &format!("{averaged} {}", voltages(voltages_v));
            if let Some(UntouchedBefore { voltages_v, frames, hours, scatter }) = untouched {
                let scatter = scatter.as_ref().map_or(UNKNOWN_SCATTER.into(), text_of_scatter);
                text += &format!(" {frames} {hours} {scatter} {}", voltages(voltages_v));
            }
            text.push('\n');
        }
        text
    }

    /// Reads the lines of [`Self::lines`].
    ///
    /// # Errors
    /// The number of the first line that has another form, as text.
    pub fn read(text: &str) -> Result<Vec<Self>, String> {
        let invalid =
            |at: usize| format!("line {}: must be a frame, as the order was written", at + 1);
        let line = |(at, line)| Self::of_line(line).ok_or_else(|| invalid(at));
        text.lines().enumerate().map(line).collect()
    }

    fn of_line(line: &str) -> Option<Self> {
        let mut words = line.split(' ');
        let averaged = words.next()?.parse::<f64>().ok()?;
        let voltages_v = voltages(words.next()?)?;
        let rest: Vec<&str> = words.collect();
        let untouched = match rest.as_slice() {
            [] => None,
            [frames, hours, scatter, untouched_v] => Some(UntouchedBefore {
                voltages_v: voltages(untouched_v)?,
                frames: frames.parse::<f64>().ok()?,
                hours: hours.parse::<f64>().ok()?,
                scatter: match *scatter {
                    UNKNOWN_SCATTER => None,
                    known => Some(scatter_of_text(known)?),
                },
            }),
            _ => return None,
        };
        Some(Self { voltages_v, averaged, untouched })
    }

    /// The frame as a method reads it.
    pub fn frames(&self) -> Frames<'_> {
        let Self { voltages_v, averaged, untouched } = self;
        Frames { voltages_v, averaged: *averaged, untouched: untouched.as_ref() }
    }
}

fn text_of_scatter(Scatter { sd_v, spectrum }: &Scatter) -> String {
    let shares: Vec<String> = spectrum.iter().map(ToString::to_string).collect();
    format!("{sd_v};{}", shares.join(","))
}

fn scatter_of_text(text: &str) -> Option<Scatter> {
    let (sd_v, shares) = text.split_once(';')?;
    let shares = shares.split(',').filter(|_| !shares.is_empty());
    let spectrum: Option<Vec<f64>> = shares.map(|share| share.parse::<f64>().ok()).collect();
    Some(Scatter { sd_v: sd_v.parse::<f64>().ok()?, spectrum: spectrum? })
}

fn voltages(text: &str) -> Option<Vec<f32>> {
    text.split(',').map(|number| number.parse::<f32>().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_read_to_the_last_bit_and_other_lines_refused() {
        let alone = FrameInput { voltages_v: vec![0.1, -2.5e-7], averaged: 30.0, untouched: None };
        let untouched = |scatter| UntouchedBefore {
            voltages_v: vec![f32::MIN_POSITIVE, 1.0 / 3.0],
            frames: 8.0,
            hours: 0.1 + 0.2,
            scatter,
        };
        let of_waves = |spectrum| untouched(Some(Scatter { sd_v: 1e-4, spectrum }));
        let known = FrameInput { untouched: Some(of_waves(vec![1.0 / 3.0, 2.0])), ..alone.clone() };
        let without = FrameInput { untouched: Some(of_waves(Vec::new())), ..alone.clone() };
        let unknown = FrameInput { untouched: Some(untouched(None)), ..alone.clone() };
        let inputs = vec![alone, known, without, unknown];
        let text = FrameInput::lines(&inputs);
        assert_eq!(text.lines().next(), Some("30 0.1,-0.00000025"));
        assert_eq!(FrameInput::read(&text).unwrap(), inputs);
        for line in [
            "",
            "30",
            "x 0.1",
            "30 0.1,x",
            "30 0.1 8 0.3",
            "30 0.1 8 0.3 x 0.1",
            "30 0.1 8 0.3 1;x 0.1",
        ] {
            let error = FrameInput::read(&format!("30 0.1\n{line}\n")).unwrap_err();
            assert!(error.starts_with("line 2: "), "{line}: {error}");
        }
    }
}
