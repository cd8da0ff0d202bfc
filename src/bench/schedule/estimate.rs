//! Predicted duration and stored size of a plan, with their parts.
//! PURE. Uses: `plan`. Never: the clock, measured runs (the ETA of a campaign uses those).
//!
//! Motion: trapezoidal speed profiles; x, y and radius move together, then z alone. Assumptions
//! that the bench does not state are in `Assumed`, in three cases: low, likely, high. The time of a
//! person (tip changes, weights) is not included: it was not measured.

use crate::record::{LOG_BYTES, RAW_FRAME_BYTES, TRIAL_BYTES, VOLTAGES_BYTES};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::configuration::Stand;
use super::order::Place;
use super::plan::{Plan, Step};

/// Size of a stored configuration in addition to its trials: tare, events, bytes.
pub const CONFIGURATION_BYTES: u64 = 1500;

/// Disk space that a run needs independent of its length, bytes: the log of the database, and the
/// cache of the skin's unit responses, from which the twins are computed (an f32 for every pair of
/// mesh nodes).
pub fn fixed_bytes(plan: &Plan) -> u64 {
    LOG_BYTES + 4 * u64::from(plan.skin_nodes).pow(2)
}

/// Disk space of a stored trial with its twin, bytes.
pub fn trial_bytes(channels: u64, frames_per_trial: u32) -> u64 {
    let (frame, voltages) = (RAW_FRAME_BYTES + 2 * channels, VOLTAGES_BYTES + 4 * channels);
    TRIAL_BYTES + u64::from(frames_per_trial) * frame + 2 * voltages
}

/// Speed and acceleration of an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Travelling speed, mm/s.
    pub speed_mm_s: f64,
    /// Acceleration and deceleration, mm/s^2.
    pub acceleration_mm_s2: f64,
}

impl Motion {
    /// Duration of a motion between two standstills, s.
    pub fn time_s(&self, distance_mm: f64) -> f64 {
        let (d, v, a) = (distance_mm.abs(), self.speed_mm_s, self.acceleration_mm_s2);
        if d * a < v * v { 2.0 * (d / a).sqrt() } else { d / v + v / a }
    }
}

/// Properties of a rig that determine durations; filled in from the rig file.
#[derive(Debug, Clone, PartialEq)]
pub struct Bench {
    /// Those of its stage; absent for a skin alone.
    pub stage: Option<StageTimes>,
    /// `ert.frame_rate_hz` of the rig file, frames per process second.
    pub frame_rate_hz: f64,
    /// Process seconds per wall second.
    pub clock_rate: f64,
}

/// Properties of a stage that determine durations.
#[derive(Debug, Clone, PartialEq)]
pub struct StageTimes {
    /// Motion of `axes.x`.
    pub x: Motion,
    /// Motion of `axes.y`.
    pub y: Motion,
    /// Motion of `axes.z`.
    pub z: Motion,
    /// Motion of `axes.radial`, converted by the law of the slots to the radius.
    pub radial: Motion,
    /// Speed of a press, from the force margin and the update period of the cells, mm/s.
    pub approach_mm_s: f64,
    /// `skin.clearance_mm` of the rig file, mm.
    pub clearance_mm: f64,
    /// `skin.surface_z_mm` of the rig file, mm.
    pub surface_z_mm: [f64; 2],
    /// `slot.backlash_mm` of the rig file, mm.
    pub backlash_mm: f64,
    /// `cells.update_ms` of the rig file, process ms.
    pub cell_update_ms: f64,
    /// Watchdog time of z, wall ms: without a request for this duration z stops. Absent: z
    /// continues to its target.
    pub z_watchdog_ms: Option<u64>,
}

/// Duration by activity, wall s.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Parts {
    /// Lateral motion in x and y, s.
    pub lateral_s: f64,
    /// Radial motion, as far as it takes longer than the simultaneous lateral motion, s.
    pub radial_s: f64,
    /// Lowering from the travelling height to depth 0, s.
    pub approach_s: f64,
    /// Pressing from depth to depth, s.
    pub press_s: f64,
    /// Waiting for forces to settle, s.
    pub settle_s: f64,
    /// Taking frames, s.
    pub frames_s: f64,
    /// Averaging the cells without load, s.
    pub tare_s: f64,
    /// Reference presses, with all their activities, s.
    pub reference_s: f64,
    /// Touch-offs, with all their activities, s.
    pub touch_off_s: f64,
    /// Raising to the travelling height, s.
    pub raise_s: f64,
    /// Wires and storage; in the high case also repeated configurations, s.
    pub other_s: f64,
}

impl Parts {
    /// The parts with their names, in the order in which they are shown.
    pub fn named(&self) -> [(&'static str, f64); 11] {
        [
            ("lateral motion", self.lateral_s),
            ("radial motion", self.radial_s),
            ("approach", self.approach_s),
            ("press", self.press_s),
            ("settle", self.settle_s),
            ("frames", self.frames_s),
            ("tare", self.tare_s),
            ("reference presses", self.reference_s),
            ("touch-off", self.touch_off_s),
            ("raise", self.raise_s),
            ("other", self.other_s),
        ]
    }

    /// Sum of all parts, s.
    pub fn total_s(&self) -> f64 {
        self.named().iter().map(|(_, s)| s).sum()
    }

    fn add(&mut self, more: &Self) {
        self.lateral_s += more.lateral_s;
        self.radial_s += more.radial_s;
        self.approach_s += more.approach_s;
        self.press_s += more.press_s;
        self.settle_s += more.settle_s;
        self.frames_s += more.frames_s;
        self.tare_s += more.tare_s;
        self.reference_s += more.reference_s;
        self.touch_off_s += more.touch_off_s;
        self.raise_s += more.raise_s;
        self.other_s += more.other_s;
    }
}

/// Prediction for one setting or a whole plan.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Estimate {
    /// Number of attached tips; absent for a whole plan and for manual trials.
    pub tips: Option<u8>,
    /// Number of trials.
    pub trials: u64,
    /// Likely duration, wall s.
    pub duration_s: f64,
    /// Duration under favourable assumptions, wall s.
    pub low_s: f64,
    /// Duration under unfavourable assumptions, wall s.
    pub high_s: f64,
    /// Parts of the likely duration.
    pub parts: Parts,
    /// Disk space of the stored data, bytes.
    pub disk_bytes: u64,
}

/// Assumptions that the bench does not state.
struct Assumed {
    /// Command of a motion and the polls that detect its arrival, wall ms.
    command_ms: f64,
    /// Durable commit of a trial, wall ms.
    commit_ms: f64,
    /// Frame periods between settling and the first accepted frame: the frame in progress, and the
    /// first complete one.
    frames_dropped: f64,
    /// Samples of the cells awaited beyond the shortest settling time.
    settle_samples: f64,
    /// Samples of the cells that a tare awaits beyond those that it averages.
    tare_samples: f64,
    /// Position of the surface in its range, 0 = highest.
    surface_at: f64,
    /// Share of the configurations that are repeated.
    repeated: f64,
}

const LOW: Assumed = Assumed {
    command_ms: 1.0,
    commit_ms: 1.0,
    frames_dropped: 1.0,
    settle_samples: 0.0,
    tare_samples: 0.0,
    surface_at: 0.0,
    repeated: 0.0,
};

const LIKELY: Assumed = Assumed {
    command_ms: 10.0,
    commit_ms: 5.0,
    frames_dropped: 1.5,
    settle_samples: 0.0,
    tare_samples: 0.5,
    surface_at: 0.5,
    repeated: 0.0,
};

const HIGH: Assumed = Assumed {
    command_ms: 40.0,
    commit_ms: 30.0,
    frames_dropped: 2.0,
    settle_samples: 1.0,
    tare_samples: 1.0,
    surface_at: 1.0,
    repeated: 0.01,
};

/// Prediction of a plan on a bench.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimates {
    /// Settings of the plan in order; one entry without tips for manual trials.
    pub settings: Vec<Estimate>,
    /// The whole plan.
    pub whole: Estimate,
}

/// Predicts a plan on a bench.
pub fn estimate(plan: &Plan, bench: &Bench) -> Estimates {
    let low = Walk::through(plan, bench, &LOW);
    let high = Walk::through(plan, bench, &HIGH);
    let mut settings = Walk::through(plan, bench, &LIKELY);
    for ((setting, low), high) in settings.iter_mut().zip(&low).zip(&high) {
        setting.low_s = low.duration_s;
        setting.high_s = high.duration_s;
    }
    let mut whole = Estimate::default();
    for setting in &settings {
        whole.trials += setting.trials;
        whole.duration_s += setting.duration_s;
        whole.low_s += setting.low_s;
        whole.high_s += setting.high_s;
        whole.disk_bytes += setting.disk_bytes;
        whole.parts.add(&setting.parts);
    }
    Estimates { settings, whole }
}

/// State of one walk through the steps of a plan.
struct Walk<'a> {
    plan: &'a Plan,
    bench: &'a Bench,
    assumed: &'a Assumed,
    here: Option<Place>,
}

impl<'a> Walk<'a> {
    fn through(plan: &'a Plan, bench: &'a Bench, assumed: &'a Assumed) -> Vec<Estimate> {
        let mut walk = Self { plan, bench, assumed, here: None };
        let mut settings = vec![Estimate::default()];
        for step in &plan.steps {
            if let Step::TipChange { tips, .. } = step {
                settings.push(Estimate { tips: Some(*tips), ..Estimate::default() });
            }
            if let Some(setting) = settings.last_mut() {
                walk.step(step, setting);
            }
        }
        settings.retain(|s| s.duration_s > 0.0 || s.trials > 0);
        settings
    }

    fn step(&mut self, step: &Step, setting: &mut Estimate) {
        let mut parts = Parts::default();
        match step {
            Step::TipChange { .. } => {}
            Step::TouchOff { places, .. } => {
                parts.touch_off_s = self.touch_off(places);
            }
            Step::Reference(press) => {
                let press = self.press(&press.stand, &[press.depth_mm]);
                parts.reference_s = press.total_s();
                setting.disk_bytes += self.trial_bytes();
            }
            Step::Configuration(configuration) => {
                parts = self.press(&configuration.stand, &self.plan.depths_mm);
                parts.other_s += self.assumed.repeated * parts.total_s();
                let trials = self.plan.depths_mm.len() as u64;
                setting.trials += trials;
                setting.disk_bytes += CONFIGURATION_BYTES + trials * self.trial_bytes();
            }
            Step::Manual(_) => {
                parts.settle_s = self.settle_s();
                parts.frames_s = self.frames_s();
                parts.other_s = self.assumed.commit_ms / 1e3;
                setting.trials += 1;
                setting.disk_bytes += CONFIGURATION_BYTES + self.trial_bytes();
            }
        }
        setting.duration_s += parts.total_s();
        setting.parts.add(&parts);
    }

    /// Duration of a press: travel, tare, approach, press and measurement at each depth, raise.
    fn press(&mut self, stand: &Stand, depths_mm: &[f64]) -> Parts {
        let mut parts = Parts::default();
        // Without a stage the plan has a problem, and no press takes time.
        let Some(bench) = &self.bench.stage else { return parts };
        self.travel(bench, stand, &mut parts);
        let measure = &self.plan.measure;
        let samples = f64::from(measure.tare_samples) + self.assumed.tare_samples;
        parts.tare_s = self.wall(samples * bench.cell_update_ms / 1e3);
        let lowered_mm = bench.clearance_mm - self.plan.standoff_mm;
        parts.approach_s = self.wall(bench.z.time_s(lowered_mm));
        let pressing = Motion { speed_mm_s: bench.approach_mm_s, ..bench.z };
        let mut depth_mm = 0.0;
        let mut motions = 3.0;
        for &next_mm in depths_mm {
            if next_mm > depth_mm {
                parts.press_s += self.wall(pressing.time_s(next_mm - depth_mm));
                motions += 1.0;
            }
            depth_mm = next_mm;
            parts.settle_s += self.settle_s();
            parts.frames_s += self.frames_s();
            parts.other_s += self.assumed.commit_ms / 1e3;
        }
        let raised_mm = depth_mm - self.plan.standoff_mm + bench.clearance_mm;
        parts.raise_s = self.wall(bench.z.time_s(raised_mm));
        parts.other_s += motions * self.assumed.command_ms / 1e3;
        parts
    }

    /// Duration of x, y and radius together; a smaller radius is overshot and approached from
    /// below.
    fn travel(&mut self, bench: &StageTimes, stand: &Stand, parts: &mut Parts) {
        let to = stand.place();
        let from = self.here.replace(to).unwrap_or(to);
        let lateral_s =
            bench.x.time_s(to.x_mm - from.x_mm).max(bench.y.time_s(to.y_mm - from.y_mm));
        let spread_mm = to.radius_mm - from.radius_mm;
        let spread_s = if spread_mm < 0.0 {
            bench.radial.time_s(bench.backlash_mm - spread_mm)
                + bench.radial.time_s(bench.backlash_mm)
        } else {
            bench.radial.time_s(spread_mm)
        };
        parts.lateral_s += self.wall(lateral_s);
        parts.radial_s += self.wall((spread_s - lateral_s).max(0.0));
    }

    /// Duration of a touch-off: each place is approached slowly from the top of the surface's range, the first
    /// from a clearance above it.
    fn touch_off(&mut self, places: &[Stand]) -> f64 {
        let Some(bench) = &self.bench.stage else { return 0.0 };
        let slow = Motion { speed_mm_s: bench.approach_mm_s, ..bench.z };
        let [top, bottom] = bench.surface_z_mm;
        let mut searched_mm = bench.clearance_mm + self.assumed.surface_at * (bottom - top);
        let mut total_s = 0.0;
        for stand in places {
            let mut parts = Parts::default();
            self.travel(bench, stand, &mut parts);
            let down_s = slow.time_s(searched_mm) + bench.z.time_s(bench.clearance_mm);
            // The conversions after the tips were raised from the coarse touch.
            let converted_s = 2.0 * bench.cell_update_ms / 1e3;
            total_s += parts.total_s() + self.wall(down_s + converted_s);
            total_s += 3.0 * self.assumed.command_ms / 1e3;
            searched_mm = self.assumed.surface_at * (bottom - top);
        }
        total_s
    }

    fn settle_s(&self) -> f64 {
        let update_ms = self.bench.stage.as_ref().map_or(0.0, |stage| stage.cell_update_ms);
        let more_ms = self.assumed.settle_samples * update_ms;
        let measure = &self.plan.measure;
        self.wall((measure.settle_ms + more_ms).min(measure.settle_max_ms) / 1e3)
    }

    fn frames_s(&self) -> f64 {
        let frames = f64::from(self.plan.measure.frames_per_trial) + self.assumed.frames_dropped;
        self.wall(frames / self.bench.frame_rate_hz)
    }

    fn trial_bytes(&self) -> u64 {
        trial_bytes(u64::from(self.plan.channels), self.plan.measure.frames_per_trial)
    }

    fn wall(&self, process_s: f64) -> f64 {
        process_s / self.bench.clock_rate
    }
}
