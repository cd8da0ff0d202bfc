//! Touch-off: measures the surface, and the relative length of each tip, after a tip change.
//! Uses: `campaign::{bench::stage, bench::travel, bench::tare, safe_end}`. Never: the plan,
//! storage.
//!
//! At each place the tips go down until a cell detects a force, up a little, and down again slowly
//! enough that the update period of a cell does not blur the height. The surface is the median over
//! places and arms, so that one late tip or one bump does not shift it. Every attached arm must
//! touch at least once: this verifies each cell before any measurement depends on it.

use jiff::Timestamp;
use sim_core::stats::median;

use crate::campaign::bench::interlock::TripKind;
use crate::campaign::bench::stage::{AxisName, Stage};
use crate::campaign::bench::tare::{self, Accept};
use crate::campaign::bench::travel::{Descent, Sample, Target};
use crate::campaign::run::control::Control;
use crate::campaign::run::halt::Halt;
use crate::campaign::safe_end::raise_as_planned;
use crate::record::TouchOffRecord;
use crate::rig::config::ARMS;
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

/// Touches every place and stores the result as the surface of the stage.
///
/// # Errors
/// Trips if no surface is found in the window of the rig file, or if an attached arm touched
/// nowhere.
pub async fn touch_off(
    stage: &mut Stage,
    control: &mut Control,
    places: &[Stand],
    tare_samples: u32,
    at: Timestamp,
) -> Result<TouchOffRecord, Halt> {
    stage.surface = None;
    raise_as_planned(control, stage).await?;
    let mut touches: Vec<(f64, f64, u8, f64)> = Vec::new();
    for (i, place) in places.iter().enumerate() {
        stage.go_over(control, place).await?;
        let accept = if i == 0 { Accept::AnyZero } else { Accept::NearLast };
        tare::tare_untouched(stage, control, tare_samples, accept).await?;
        for (arm, z_mm) in touch(stage, control, first_height(&touches)).await? {
            let [x, y] = place.tips_mm[usize::from(arm) - 1];
            touches.push((x, y, arm, z_mm));
        }
        raise_as_planned(control, stage).await?;
    }
    require_every_arm(stage.tips, &touches)?;
    let record = conclude(stage.tips, touches, at)?;
    stage.surface = Some(record.clone());
    Ok(record)
}

fn first_height(touches: &[(f64, f64, u8, f64)]) -> Option<f64> {
    touches.iter().map(|t| t.3).min_by(f64::total_cmp)
}

fn require_every_arm(tips: u8, touches: &[(f64, f64, u8, f64)]) -> Result<(), Halt> {
    let silent: Vec<String> = (1..=tips)
        .filter(|arm| touches.iter().all(|t| t.2 != *arm))
        .map(|arm| arm.to_string())
        .collect();
    if silent.is_empty() {
        return Ok(());
    }
    let detail = format!(
        "arm {} touched nowhere in the touch-off, with {tips} tips mounted: check that its tip is \
         mounted and its cell responds",
        silent.join(", ")
    );
    Err(Halt::trip(TripKind::Cell, detail))
}

/// Depth to which the surface may be searched, machine mm: never past the window of the rig file.
/// If the height is expected, from the rig file or from an earlier place, at most `search_below_mm`
/// below it.
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
        let frames = skin.take(stage.clock.now(), stage.witness_frames());
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
        let near = (first - 2.0 * BACK_OFF_MM).max(z.travel_mm[0]);
        stage.weighed_travel(control, Target::of(AxisName::Z, near)).await?;
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
        let detail = format!(
            "no cell detected the surface down to z = {bottom:.3} mm (skin.surface_z_mm, \
             skin.expected_z_mm, skin.search_below_mm)"
        );
        return Err(Halt::trip(TripKind::Position, detail));
    }
    let felt_mm = stage.bench.z.status().await?.position;
    let back = (felt_mm - BACK_OFF_MM).max(z.travel_mm[0]);
    stage.weighed_travel(control, Target::of(AxisName::Z, back)).await?;
    let fine = (BLUR_MM / stage.stopping.blind_s(&stage.config)).min(coarse);
    let deepest = (felt_mm + stage.config.skin.search_below_mm).min(z.travel_mm[1]);
    let mut heights = [None::<f64>; ARMS];
    stage
        .press_until(control, Descent { z_mm: deepest, speed_mm_s: fine }, |s| {
            for (i, height) in heights.iter_mut().enumerate().take(tips) {
                if height.is_none() && force(s, i) > TOUCH_N {
                    *height = Some(s.z_mm);
                }
            }
            heights[..tips].iter().all(Option::is_some) || (0..tips).any(|i| force(s, i) > ENOUGH_N)
        })
        .await?;
    Ok((0..tips).filter_map(|i| heights[i].map(|h| (i as u8 + 1, h))).collect())
}

/// Median height, and the median of each arm relative to it.
fn conclude(
    tips: u8,
    touches: Vec<(f64, f64, u8, f64)>,
    at: Timestamp,
) -> Result<TouchOffRecord, Halt> {
    let surface_z_mm = median(touches.iter().map(|t| t.3))
        .ok_or_else(|| Halt::trip(TripKind::Position, "no tip touched the surface"))?;
    let tip_offset_mm = (1..=tips)
        .filter_map(|arm| {
            let own = touches.iter().filter(|t| t.2 == arm).map(|t| t.3);
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
                touches.push((0.0, 0.0, arm, 60.0 + bump + late));
            }
        }
        let found = conclude(6, touches, Timestamp::UNIX_EPOCH).expect("tips touched");
        assert!((found.surface_z_mm - 60.05).abs() < 0.06, "{}", found.surface_z_mm);
        assert!((found.tip_offset_mm[5].1 - 2.0).abs() < 0.1);
    }

    #[test]
    fn no_touch_is_a_trip_and_not_a_height() {
        assert!(conclude(1, Vec::new(), Timestamp::UNIX_EPOCH).is_err());
    }
}
