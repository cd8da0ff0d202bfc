//! The running mean of frames while the load does not change.
//! Uses: nothing. PURE. Never: the contacts of a load.
//!
//! A frame belongs to the mean while noise explains its distance from it: with `d` the frame minus
//! the mean of n frames, `sum (d / sd)^2 / (1 + 1/n)` is chi-square with as many degrees of freedom
//! as there are channels. A change too small for one frame is detected in the mean of the last
//! ones: the same test compares the newest frames together with those before them. A slow drift of
//! the gain up to a share of the signal does not count as a change.

/// Why a frame or the settings are rejected.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum SteadyError {
    /// A setting is not a positive number.
    #[error("still frames: {field} = {value} is not a finite number > 0")]
    Setting { field: &'static str, value: f64 },
    /// The length of the frame differs from that of the earlier ones.
    #[error("still frames: a frame of {found} voltages, {needed} needed")]
    Length { found: usize, needed: usize },
    /// A voltage is not finite.
    #[error("still frames: voltage {channel} is not a finite number")]
    NotFinite { channel: usize },
}

/// Criterion by which frames belong to one load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SteadySettings {
    /// Standard deviation of the noise of one reading, V.
    pub noise_sd_v: f64,
    /// Largest drift of the gain that is not a change, as a share of the signal.
    pub drift_share: f64,
    /// Size of a change, in standard deviations of chi-square.
    pub limit_sd: f64,
    /// Largest number of frames in the mean; beyond it, the weight of old ones decays.
    pub most_frames: usize,
}

impl SteadySettings {
    /// Settings for a noise, V: 1 % of drift, five standard deviations, 30 frames (one second).
    pub fn of_noise(noise_sd_v: f64) -> Self {
        Self { noise_sd_v, drift_share: 0.01, limit_sd: 5.0, most_frames: 30 }
    }
}

/// Number of newest frames that are tested together, in addition to the test of each frame.
const RECENT: usize = 4;

/// The running mean of a constant load.
#[derive(Debug, Clone)]
pub struct Steady {
    settings: SteadySettings,
    mean_v: Vec<f64>,
    /// Number of frames whose mean would have the noise of `mean_v`.
    frames: f64,
    /// The newest frames, not yet in `mean_v`, oldest first.
    recent_v: Vec<Vec<f64>>,
    all_v: Vec<f64>,
}

/// The mean after a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SteadyMean<'a> {
    /// Mean of the frames of this load, V.
    pub mean_v: &'a [f64],
    /// Effective number of frames: the noise of the mean is that of one frame over the square root
    /// of this.
    pub frames: f64,
    /// Whether this frame started a new load.
    pub changed: bool,
}

impl Steady {
    /// Starts without frames, for frames of `channels` voltages.
    ///
    /// # Errors
    /// `SteadyError::Setting` if a setting is not positive and finite, or the drift is -1 or less.
    pub fn new(channels: usize, settings: SteadySettings) -> Result<Self, SteadyError> {
        for (field, value) in [
            ("noise_sd_v", settings.noise_sd_v),
            ("limit_sd", settings.limit_sd),
            ("most_frames", settings.most_frames as f64),
            ("drift_share + 1", settings.drift_share + 1.0),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(SteadyError::Setting { field, value });
            }
        }
        Ok(Self {
            settings,
            mean_v: vec![0.0; channels],
            frames: 0.0,
            recent_v: Vec::with_capacity(RECENT + 1),
            all_v: vec![0.0; channels],
        })
    }

    /// Removes all frames.
    pub fn reset(&mut self) {
        self.frames = 0.0;
        self.recent_v.clear();
    }

    /// Adds a frame, V. After an error the state is unchanged.
    ///
    /// # Errors
    /// `SteadyError::Length` or `SteadyError::NotFinite` if the frame is invalid.
    pub fn push(&mut self, frame_v: &[f64]) -> Result<SteadyMean<'_>, SteadyError> {
        let needed = self.mean_v.len();
        if frame_v.len() != needed {
            return Err(SteadyError::Length { found: frame_v.len(), needed });
        }
        if let Some(channel) = frame_v.iter().position(|v| !v.is_finite()) {
            return Err(SteadyError::NotFinite { channel });
        }
        let before = self.frames + self.recent_v.len() as f64;
        let mut changed = false;
        if before > 0.0 {
            self.mix();
            changed = self.differs(&self.all_v, before, frame_v, 1.0);
            if changed {
                self.reset();
            }
        }
        if self.recent_v.len() == RECENT {
            let oldest = self.recent_v.remove(0);
            self.absorb(&oldest);
        }
        self.recent_v.push(frame_v.to_vec());
        changed |= self.drop_if_recent_differ();
        self.mix();
        let frames = self.frames + self.recent_v.len() as f64;
        Ok(SteadyMean { mean_v: &self.all_v, frames, changed })
    }

    /// Restarts from the newest frames if their mean differs from that of the earlier ones.
    fn drop_if_recent_differ(&mut self) -> bool {
        if self.frames == 0.0 || self.recent_v.len() < RECENT {
            return false;
        }
        let recent = mean(&self.recent_v, self.mean_v.len());
        let changed = self.differs(&self.mean_v, self.frames, &recent, RECENT as f64);
        if changed {
            self.frames = 0.0;
        }
        changed
    }

    /// Whether the means of `old` and `new` frames are of different loads.
    fn differs(&self, old_v: &[f64], old: f64, new_v: &[f64], new: f64) -> bool {
        let noise_v2 = self.settings.noise_sd_v.powi(2) * (1.0 / old + 1.0 / new);
        let signal_v2: f64 = old_v.iter().map(|v| v * v).sum();
        let distance: f64 = old_v.iter().zip(new_v).map(|(a, b)| (a - b).powi(2)).sum();
        let channels = old_v.len() as f64;
        let drift_v2 = self.settings.drift_share.powi(2) * signal_v2;
        let limit = channels + self.settings.limit_sd * (2.0 * channels).sqrt();
        distance > limit * noise_v2 + drift_v2
    }

    /// Adds a frame to the mean; once the mean is full, old frames decay at a rate that keeps its
    /// noise that of the same number of frames.
    fn absorb(&mut self, frame_v: &[f64]) {
        let most = self.settings.most_frames.saturating_sub(RECENT).max(1) as f64;
        let share = (1.0 / (self.frames + 1.0)).max(2.0 / (most + 1.0));
        let old = if self.frames > 0.0 { (1.0 - share).powi(2) / self.frames } else { 0.0 };
        self.frames = 1.0 / (old + share * share);
        self.mean_v.iter_mut().zip(frame_v).for_each(|(m, v)| *m += share * (v - *m));
    }

    /// Writes the mean of all frames to `all_v`.
    fn mix(&mut self) {
        let frames = self.frames + self.recent_v.len() as f64;
        let old = if self.frames > 0.0 { self.frames / frames } else { 0.0 };
        for (channel, all) in self.all_v.iter_mut().enumerate() {
            let recent: f64 = self.recent_v.iter().map(|frame| frame[channel]).sum();
            *all = old * self.mean_v[channel] + recent / frames;
        }
    }
}

fn mean(frames: &[Vec<f64>], channels: usize) -> Vec<f64> {
    (0..channels)
        .map(|channel| frames.iter().map(|f| f[channel]).sum::<f64>() / frames.len() as f64)
        .collect()
}
