//! The mean of frames for as long as the load is still.
//! Uses: nothing. PURE. Never: how a load looks.
//!
//! A frame belongs to the mean while its distance from it is what noise explains: with `d` the
//! frame less the mean of n, `sum (d / sd)^2 / (1 + 1/n)` is chi-square of as many degrees of freedom
//! as there are channels. A change too small for one frame shows in the mean of the last ones: the
//! same test runs on the newest frames together against those before them. A slow drift of the gain
//! is let pass by a share of the signal that is no change.

/// What is wrong with a frame, or with the settings.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum SteadyError {
    /// A setting is not a positive number.
    #[error("still frames: {field} = {value} is not a finite number > 0")]
    Setting {
        /// Its name.
        field: &'static str,
        /// Its value.
        value: f64,
    },
    /// The frame has another length than those before.
    #[error("still frames: a frame of {found} voltages, {needed} needed")]
    Length {
        /// Voltages found.
        found: usize,
        /// Voltages needed.
        needed: usize,
    },
    /// A voltage is no number.
    #[error("still frames: voltage {channel} is not a finite number")]
    NotFinite {
        /// Its channel.
        channel: usize,
    },
}

/// When frames count as one load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SteadySettings {
    /// Standard deviation of the noise of one reading, V.
    pub noise_sd_v: f64,
    /// Change that does not count, as a share of the signal: drift of the gain.
    pub drift_share: f64,
    /// How many standard deviations of chi-square a change is.
    pub limit_sd: f64,
    /// Frames in the mean at most; beyond, old ones fade.
    pub most_frames: usize,
}

impl SteadySettings {
    /// For a noise, V: 1 % of drift, five standard deviations, 30 frames (one second).
    pub fn of_noise(noise_sd_v: f64) -> Self {
        Self { noise_sd_v, drift_share: 0.01, limit_sd: 5.0, most_frames: 30 }
    }
}

/// Frames that are looked at together beside each one alone.
const RECENT: usize = 4;

/// The running mean of a still load.
#[derive(Debug, Clone)]
pub struct Steady {
    settings: SteadySettings,
    mean_v: Vec<f64>,
    /// Frames whose mean would have the noise of `mean_v`.
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
    /// Its noise is that of one frame over the square root of this; so many are in it, or more where
    /// old ones fade.
    pub frames: f64,
    /// Whether this frame showed a new load.
    pub changed: bool,
}

impl Steady {
    /// No frames yet, of `channels` voltages.
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

    /// Forgets all frames.
    pub fn reset(&mut self) {
        self.frames = 0.0;
        self.recent_v.clear();
    }

    /// Takes a frame, V. After an error nothing has changed.
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

    /// Starts again from the newest frames when together they differ from those before.
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

    /// Whether the means of so many frames are of different loads.
    fn differs(&self, old_v: &[f64], old: f64, new_v: &[f64], new: f64) -> bool {
        let noise_v2 = self.settings.noise_sd_v.powi(2) * (1.0 / old + 1.0 / new);
        let signal_v2: f64 = old_v.iter().map(|v| v * v).sum();
        let distance: f64 = old_v.iter().zip(new_v).map(|(a, b)| (a - b).powi(2)).sum();
        let channels = old_v.len() as f64;
        let drift_v2 = self.settings.drift_share.powi(2) * signal_v2;
        let limit = channels + self.settings.limit_sd * (2.0 * channels).sqrt();
        distance > limit * noise_v2 + drift_v2
    }

    /// Takes a frame into the mean; a full one forgets so fast that its noise stays that of as many
    /// frames.
    fn absorb(&mut self, frame_v: &[f64]) {
        let most = self.settings.most_frames.saturating_sub(RECENT).max(1) as f64;
        let share = (1.0 / (self.frames + 1.0)).max(2.0 / (most + 1.0));
        let old = if self.frames > 0.0 { (1.0 - share).powi(2) / self.frames } else { 0.0 };
        self.frames = 1.0 / (old + share * share);
        self.mean_v.iter_mut().zip(frame_v).for_each(|(m, v)| *m += share * (v - *m));
    }

    /// Mean of all frames into `all_v`.
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
