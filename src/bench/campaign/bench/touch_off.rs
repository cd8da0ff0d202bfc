//! Touch-off: measures the surface, and the relative length of each tip, after a tip change.
//! Uses: `campaign::{bench::stage, bench::travel, bench::descent, bench::tare, safe_end}`. Never: the plan,
//! storage.
//!
//! At each place the tips go down until a cell detects a force, up a little, and, once the cells read no
//! touch any more, down again slowly enough that their update period does not blur the height. The surface is the median over
//! places and arms, so that one late tip or one bump does not shift it. Every attached arm must
//! touch at least once: this verifies each cell before any measurement depends on it.

use jiff::Timestamp;
use sim_core::stats::median;

use crate::campaign::bench::descent::Descent;
use crate::campaign::bench::interlock::TripKind;
use crate::campaign::bench::stage::{AxisName, Stage};
use crate::campaign::bench::tare::{self, Accept};
use crate::campaign::bench::travel::{Sample, Target};
use crate::campaign::run::control::Control;
use crate::campaign::run::halt::Halt;
use crate::campaign::safe_end::raise_as_planned;
use crate::record::{ARMS, ArmTouch, TouchOffRecord};
use crate::schedule::configuration::Stand;

/// Force at which a tip counts as touching, N.
const TOUCH_N: f64 = 0.5;
/// Largest force on one arm while the touches of the others are awaited, N.
const ENOUGH_N: f64 = 25.0;
/// Step of the search for a surface of unknown height, mm.
const STEP_MM: f64 = 1.0;
/// Distance raised between the coarse and the fine approach, mm.
const BACK_OFF_MM: f64 = 1.5;
/// Blur of the height by the time between two samples in the fine approach, mm.
const BLUR_MM: f64 = 0.05;
/// Travel between two samples above which a touch has no height: a reply was late, mm.
const BLURRED_MM: f64 = 0.2;
/// Update periods of the cells after which a reading was converted at rest: one that was under way, and
/// a whole one.
const CONVERSIONS: f64 = 2.0;
/// Fine approaches of a place before the touch-off trips.
const APPROACHES: u32 = 3;

/// Touches every place and stores the result as the surface of the stage.
///
/// # Errors
/// Trips if no surface is found in the window of the rig file, if an axis has left a place, or if an attached arm
/// touched nowhere; `Halt::Checkpoint` with raised tips if a pause or a stop was requested.
pub async fn touch_off(
    stage: &mut Stage,
    control: &mut Control,
    places: &[Stand],
    tare_samples: u32,
    at: Timestamp,
) -> Result<TouchOffRecord, Halt> {
    stage.surface = None;
    raise_as_planned(control, stage).await?;
    let mut touches: Vec<ArmTouch> = Vec::new();
    for (i, place) in places.iter().enumerate() {
        let over = stage.go_over(control, place).await?;
        let accept = if i == 0 { Accept::AnyZero } else { Accept::NearLast };
        tare::tare_untouched(stage, control, tare_samples, accept).await?;
        stage.require_over(control, &over).await?;
        // The tips are up: what was requested meanwhile waits for no further place.
        control.checkpoint()?;
        let found = touch(stage, control, first_height(&touches)).await?;
        // No height is kept of another place.
        stage.require_still_over(control, &over).await?;
        for (arm, z_mm) in found {
            let [x_mm, y_mm] = place.tips_mm[usize::from(arm) - 1];
            touches.push(ArmTouch { x_mm, y_mm, arm, z_mm });
        }
        raise_as_planned(control, stage).await?;
    }
    require_every_arm(stage.tips, &touches)?;
    let record = conclude(stage.tips, touches, at)?;
    stage.surface = Some(record.clone());
    Ok(record)
}

fn first_height(touches: &[ArmTouch]) -> Option<f64> {
    touches.iter().map(|t| t.z_mm).min_by(f64::total_cmp)
}

fn require_every_arm(tips: u8, touches: &[ArmTouch]) -> Result<(), Halt> {
    let silent: Vec<String> = (1..=tips)
        .filter(|arm| touches.iter().all(|t| t.arm != *arm))
        .map(|arm| arm.to_string())
        .collect();
    if silent.is_empty() {
        return Ok(());
    }
    let detail = format!(
        "arm {} touched nowhere in the touch-off (skin.surface_z_mm, skin.search_below_mm), with \
         {tips} tips mounted: check that its tip is mounted and its cell responds",
        silent.join(", ")
    );
    Err(Halt::trip(TripKind::Cell, detail))
}

/// Depth to which the surface may be searched, machine mm: never past the window of the rig file.
/// If the height is expected, from the rig file, an earlier place or the coarse approach, at most
/// `search_below_mm` below it.
fn deepest_search_mm(stage: &Stage, known_mm: Option<f64>) -> f64 {
    let place = &stage.config.skin;
    let [_, bottom] = place.surface_z_mm;
    known_mm.or(place.expected_z_mm).map_or(bottom, |z| bottom.min(z + place.search_below_mm))
}

/// Searches in steps for a surface that no touch has found yet. At each step the skin is checked as
/// well: a dead cell would let z continue, and frames of a moving load may be distorted.
async fn search(
    stage: &mut Stage,
    control: &mut Control,
    to_bottom: Descent,
    touched: impl Fn(&Sample) -> bool + Copy,
) -> Result<bool, Halt> {
    let [top_mm, _] = stage.config.skin.surface_z_mm;
    let mut z_mm = top_mm - STEP_MM;
    while z_mm < to_bottom.z_mm {
        z_mm = (z_mm + STEP_MM).min(to_bottom.z_mm);
        if stage.press_until(control, Descent { z_mm, ..to_bottom }, touched).await? {
            return Ok(true);
        }
        let skin = stage.bench.skin.clone();
        let frames = skin.take(stage.clock.now(), stage.cross_check_frames());
        stage.watch_while(control, frames).await?.map_err(|e| stage.no_frames(e))?;
    }
    Ok(false)
}

/// Touches one place. Returns arms and the heights at which they touched, machine mm.
async fn touch(
    stage: &mut Stage,
    control: &mut Control,
    known_mm: Option<f64>,
) -> Result<Vec<(u8, f64)>, Halt> {
    let tips = usize::from(stage.tips);
    let z = stage.config.axes.z.clone();
    if let Some(first) = known_mm {
        // At travelling speed only where no surface can be: this place may be higher than the others.
        let [top_mm, _] = stage.config.skin.surface_z_mm;
        let near = (first - 2.0 * BACK_OFF_MM).min(top_mm).max(z.travel_mm[0]);
        stage.checked_travel(control, Target::of(AxisName::Z, near)).await?;
    }
    let coarse = stage.stopping.press_speed_mm_s(&stage.config, stage.tips);
    let (tare_v, per_volt) = (stage.tare_v, stage.config.cells.newtons_per_volt());
    let force = move |s: &Sample, i: usize| (s.volts[i] - tare_v[i]) * per_volt;
    let bottom = deepest_search_mm(stage, known_mm);
    let touched = move |s: &Sample| (0..tips).any(|i| force(s, i) > TOUCH_N);
    let to_bottom = Descent { z_mm: bottom, speed_mm_s: coarse };
    let felt = match known_mm {
        Some(_) => stage.press_until(control, to_bottom, touched).await?,
        None => search(stage, control, to_bottom, touched).await?,
    };
    if !felt {
        return Err(no_surface(bottom));
    }
    for _ in 0..APPROACHES {
        let felt_mm = back_off(stage, control).await?;
        let raised = stage.read_cells(control).await?.volts;
        if (0..tips).any(|i| (raised[i] - tare_v[i]) * per_volt > TOUCH_N) {
            continue;
        }
        let fine = (BLUR_MM / stage.stopping.blind_s(&stage.config)).min(coarse);
        let deepest = deepest_search_mm(stage, Some(felt_mm));
        let mut heights = Heights::default();
        stage
            .press_until(control, Descent { z_mm: deepest, speed_mm_s: fine }, |s| {
                heights.take(s.z_mm, (0..tips).map(|i| force(s, i) > TOUCH_N));
                heights.are_complete(tips) || (0..tips).any(|i| force(s, i) > ENOUGH_N)
            })
            .await?;
        let found = heights.found();
        // A place where no tip touches again is omitted, but not at the end of the window: the surface may be below it.
        if found.is_empty() && deepest < felt_mm + stage.config.skin.search_below_mm {
            return Err(no_surface(deepest));
        }
        if !heights.is_blurred {
            return Ok(found);
        }
    }
    let detail = format!(
        "no height of a touch in {APPROACHES} approaches: a cell reads a touch {BACK_OFF_MM} mm above it, or \
         samples came later than {BLURRED_MM} mm of travel"
    );
    Err(Halt::trip(TripKind::Stale, detail))
}

fn no_surface(down_to_mm: f64) -> Halt {
    let detail = format!(
        "no cell detected the surface down to z = {down_to_mm:.3} mm (skin.surface_z_mm, \
         skin.expected_z_mm, skin.search_below_mm)"
    );
    Halt::trip(TripKind::Position, detail)
}

/// Raises the tips from where they touch, and waits until the module has converted there: its next reply
/// would still show the touch. Returns the height from which they were raised, machine mm.
async fn back_off(stage: &mut Stage, control: &mut Control) -> Result<f64, Halt> {
    let felt_mm = control.attending(stage.bench.z.status()).await??.position;
    let back = (felt_mm - BACK_OFF_MM).max(stage.config.axes.z.travel_mm[0]);
    stage.checked_travel(control, Target::of(AxisName::Z, back)).await?;
    let (clock, wait_s) = (stage.clock.clone(), CONVERSIONS * stage.config.cells.update_ms / 1e3);
    stage.watch_while(control, async move { clock.sleep(wait_s).await }).await?;
    Ok(felt_mm)
}

/// Heights of the first touch of each arm in one approach, machine mm.
#[derive(Debug, Default)]
struct Heights {
    of_arms: [Option<f64>; ARMS],
    last_mm: Option<f64>,
    is_blurred: bool,
}

impl Heights {
    /// Takes a sample: its height, and which arms touch. The first sample of an approach has no step.
    fn take(&mut self, z_mm: f64, touching: impl Iterator<Item = bool>) {
        let step_mm = self.last_mm.map_or(0.0, |last| z_mm - last);
        for (height, touches) in self.of_arms.iter_mut().zip(touching) {
            if height.is_none() && touches {
                *height = Some(z_mm);
                self.is_blurred |= step_mm > BLURRED_MM;
            }
        }
        self.last_mm = Some(z_mm);
    }

    fn are_complete(&self, tips: usize) -> bool {
        self.of_arms[..tips].iter().all(Option::is_some)
    }

    /// The arms that touched, from 1, with their heights.
    fn found(&self) -> Vec<(u8, f64)> {
        let arms = (1..).zip(self.of_arms);
        arms.filter_map(|(arm, height)| height.map(|height| (arm, height))).collect()
    }
}

/// Median height, and the median of each arm relative to it.
fn conclude(tips: u8, touches: Vec<ArmTouch>, at: Timestamp) -> Result<TouchOffRecord, Halt> {
    let surface_z_mm = median(touches.iter().map(|t| t.z_mm))
        .ok_or_else(|| Halt::trip(TripKind::Position, "no tip touched the surface"))?;
    let tip_offset_mm = (1..=tips)
        .filter_map(|arm| {
            let own = touches.iter().filter(|t| t.arm == arm).map(|t| t.z_mm);
            median(own).map(|z| (arm, z - surface_z_mm))
        })
        .collect();
    Ok(TouchOffRecord { tips, surface_z_mm, tip_offset_mm, touches, at })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_surface_is_the_median_and_a_late_tip_shows_as_shorter() {
        let mut touches = Vec::new();
        for place in 0..5 {
            let bump = 0.1 * f64::from(place - 2);
            for arm in 1..=6u8 {
                let late = if arm == 6 { 2.0 } else { 0.0 };
                let z_mm = 60.0 + bump + late;
                touches.push(ArmTouch { x_mm: 0.0, y_mm: 0.0, arm, z_mm });
            }
        }
        let found = conclude(6, touches, Timestamp::UNIX_EPOCH).expect("tips touched");
        assert!((found.surface_z_mm - 60.05).abs() < 0.06, "{}", found.surface_z_mm);
        assert!((found.tip_offset_mm[5].1 - 2.0).abs() < 0.1);
    }

    #[test]
    fn the_first_touch_of_each_arm_counts_unless_a_sample_came_late() {
        let mut heights = Heights::default();
        for (z_mm, touching) in
            [(57.0, [false, false]), (57.1, [true, false]), (57.2, [true, true])]
        {
            assert!(!heights.are_complete(2));
            heights.take(z_mm, touching.into_iter());
        }
        assert!(heights.are_complete(2) && !heights.is_blurred);
        assert_eq!(heights.found(), [(1, 57.1), (2, 57.2)]);
        let mut late = Heights::default();
        late.take(57.0, [false].into_iter());
        late.take(57.5, [true].into_iter());
        assert!(late.is_blurred);
    }

    #[test]
    fn no_touch_is_a_trip_and_not_a_height() {
        assert!(conclude(1, Vec::new(), Timestamp::UNIX_EPOCH).is_err());
    }
}
