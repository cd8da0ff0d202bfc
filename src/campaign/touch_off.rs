//! Touch-off: finds the surface, and how much longer or shorter each tip is, after a tip change.
//! Uses: `campaign::{stage, tare}`. Never: the plan, storage.
//!
//! At each place the tips go down until a cell feels something, up a little, and down again slowly
//! enough that a cell's update period does not blur the height. The surface is the median over
//! places and arms: one late tip or one bump does not move it.

use jiff::Timestamp;

use super::control::Control;
use super::halt::Halt;
use super::interlock::TripKind;
use super::record::TouchOffRecord;
use super::stage::{AxisName, Sample, Stage};
use super::tare;
use crate::schedule::configuration::Stand;

/// Force at which a tip is taken to touch, N.
const TOUCH_N: f64 = 0.5;
/// Largest force on one arm while the others are still looked for, N.
const ENOUGH_N: f64 = 25.0;
/// Height taken back between the coarse and the fine approach, mm.
const BACK_OFF_MM: f64 = 1.5;
/// How far below the first touch late tips are looked for, mm.
const LATE_TIP_MM: f64 = 4.0;
/// Blur of the height by the time between two samples in the fine approach, mm.
const BLUR_MM: f64 = 0.05;

/// Touches every place and makes the result the stage's surface.
pub async fn touch_off(
    stage: &mut Stage,
    control: &mut Control,
    places: &[Stand],
    tare_samples: u32,
    at: Timestamp,
) -> Result<TouchOffRecord, Halt> {
    stage.surface = None;
    raise(stage).await?;
    let mut touches: Vec<(f64, f64, u8, f64)> = Vec::new();
    for (i, place) in places.iter().enumerate() {
        stage.go_over(control, place.centre_mm, place.radius_mm).await?;
        tare::tare(stage, control, tare_samples, i == 0).await?;
        for (arm, z_mm) in touch(stage, control, first_height(&touches)).await? {
            let [x, y] = place.tips_mm[usize::from(arm) - 1];
            touches.push((x, y, arm, z_mm));
        }
        raise(stage).await?;
    }
    let record = conclude(stage.tips, touches, at)?;
    stage.surface = Some(record.clone());
    Ok(record)
}

async fn raise(stage: &mut Stage) -> Result<(), Halt> {
    stage.raise().await.map_err(|e| Halt::trip(TripKind::Position, e))
}

fn first_height(touches: &[(f64, f64, u8, f64)]) -> Option<f64> {
    touches.iter().map(|t| t.3).min_by(f64::total_cmp)
}

/// One place: heights at which the arms touched.
async fn touch(
    stage: &mut Stage,
    control: &mut Control,
    known_mm: Option<f64>,
) -> Result<Vec<(u8, f64)>, Halt> {
    let [_, bottom] = stage.config.skin.surface_z_mm;
    let tips = usize::from(stage.tips);
    let z = stage.config.axes.z.clone();
    if let Some(first) = known_mm {
        let near = first - 2.0 * BACK_OFF_MM;
        stage.travel(control, &[(AxisName::Z, near.max(z.travel_mm[0]))], true).await?;
    }
    let coarse = stage.search_speed_mm_s();
    let (tare_v, per_volt) = (stage.tare_v, stage.config.cells.newtons_per_volt());
    let force = move |s: &Sample, i: usize| (s.volts[i] - tare_v[i]) * per_volt;
    let felt = stage
        .travel_at(control, &[(AxisName::Z, bottom, coarse)], true, |s| {
            (0..tips).any(|i| force(s, i) > TOUCH_N)
        })
        .await?;
    if !felt {
        let detail = format!("no surface found above z = {bottom} mm (skin.surface_z_mm)");
        return Err(Halt::trip(TripKind::Position, detail));
    }
    let felt_mm = stage.bench.z.status().await?.position;
    let back = (felt_mm - BACK_OFF_MM).max(z.travel_mm[0]);
    stage.travel(control, &[(AxisName::Z, back)], false).await?;
    let fine = (BLUR_MM / stage.blind_s()).min(coarse);
    let deepest = (felt_mm + LATE_TIP_MM).min(z.travel_mm[1]);
    let mut heights = [None::<f64>; 6];
    stage
        .travel_at(control, &[(AxisName::Z, deepest, fine)], true, |s| {
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

/// The median height, and each arm's own median against it.
fn conclude(
    tips: u8,
    touches: Vec<(f64, f64, u8, f64)>,
    at: Timestamp,
) -> Result<TouchOffRecord, Halt> {
    let median = |heights: Vec<f64>| {
        let mut sorted = heights;
        sorted.sort_by(f64::total_cmp);
        let n = sorted.len();
        (n > 0).then(|| (sorted[(n - 1) / 2] + sorted[n / 2]) / 2.0)
    };
    let surface_z_mm = median(touches.iter().map(|t| t.3).collect())
        .ok_or_else(|| Halt::trip(TripKind::Position, "no tip touched the surface"))?;
    let tip_offset_mm = (1..=tips)
        .filter_map(|arm| {
            let own = touches.iter().filter(|t| t.2 == arm).map(|t| t.3).collect();
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
