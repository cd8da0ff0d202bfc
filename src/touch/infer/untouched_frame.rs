//! A frame of the untouched skin before other frames, and the age of its offsets.
//! PURE. Uses: `scatter`. Never: a frame with a contact.

use super::scatter::Scatter;

/// Frame of the untouched skin, measured before other frames.
#[derive(Debug, Clone, PartialEq)]
pub struct UntouchedBefore {
    /// Mean voltages, V, injection-major.
    pub voltages_v: Vec<f32>,
    /// Number of frames that it is the mean of, >= 1.
    pub frames: f64,
    /// Process time from it to the frames, h, >= 0.
    pub hours: f64,
    /// What the offsets differ by between two such frames of its run; `None` if the run has too few.
    pub scatter: Option<Scatter>,
}

impl UntouchedBefore {
    /// Share of the drift of a day that its age has.
    pub fn share_of_day(&self) -> f64 {
        share_of_day(self.hours)
    }
}

/// Share of the drift of a day in a number of hours, >= 0: that of a random walk.
pub fn share_of_day(hours: f64) -> f64 {
    (hours / 24.0).sqrt()
}
