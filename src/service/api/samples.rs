//! The samples of the load cells of the last half hour, in memory.
//! Uses: the campaign's samples, `envelope`, `live`. Never: a sample on the disk; a delay of the campaign.

use std::collections::VecDeque;
use std::iter::from_fn;
use std::time::Duration;

use axum::Json;
use parking_lot::Mutex;
use serde::Deserialize;
use utoipa::IntoParams;

use super::App;
use super::envelope::{SamplesOut, envelope};
use super::limits::{SAMPLES_MAX, SAMPLES_MINUTES};
use super::live::arrived;
use super::problem::{ApiError, ApiResult, Params};
use crate::campaign::shown::samples::ForceSample;

/// Period for which samples are combined before they are kept: of a period two remain.
const SAMPLES_PERIOD: Duration = Duration::from_millis(50);
/// Samples kept of a period.
const OF_PERIOD: usize = 2;
/// Most samples kept: about 9 MB.
const KEPT_MAX: usize = OF_PERIOD * SAMPLES_MINUTES as usize * 60 * 20;

/// The kept samples, oldest first.
#[derive(Debug, Default)]
pub struct Ring(Mutex<VecDeque<ForceSample>>);

impl Ring {
    fn add(&self, samples: &[ForceSample]) {
        let Some(newest) = samples.last() else { return };
        let oldest_ms = newest.at_ms - i64::from(SAMPLES_MINUTES) * 60_000;
        let mut ring = self.0.lock();
        ring.extend(envelope(samples, OF_PERIOD));
        while ring.len() > KEPT_MAX || ring.front().is_some_and(|s| s.at_ms < oldest_ms) {
            ring.pop_front();
        }
    }

    /// Returns the samples since a time, ms since 1970.
    fn since(&self, at_ms: i64) -> Vec<ForceSample> {
        self.0.lock().iter().filter(|sample| sample.at_ms >= at_ms).copied().collect()
    }
}

/// Selection of samples.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct SamplesParams {
    /// Length of the time before now, minutes, 1 to 30; 5 if absent.
    #[param(minimum = 1, maximum = 30, default = 5)]
    pub minutes: Option<u32>,
}

/// Returns the samples of the load cells of the last minutes, at most 3000 with all extremes.
///
/// They are kept in memory: there are none of the time before the start of the service.
#[utoipa::path(get, operation_id = "rig_samples", path = "/api/v1/rig/samples", tag = "rig",
    params(SamplesParams), responses((status = 200, body = SamplesOut),
        (status = 400, description = "`minutes` is not 1 to 30")))]
pub async fn last_minutes(
    app: App,
    Params(params): Params<SamplesParams>,
) -> ApiResult<Json<SamplesOut>> {
    let minutes = params.minutes.unwrap_or(5);
    if !(1..=SAMPLES_MINUTES).contains(&minutes) {
        return Err(ApiError::query("minutes", minutes, "must be 1 to 30"));
    }
    let now_ms = jiff::Timestamp::now().as_millisecond();
    let samples = app.facts.memory.samples.since(now_ms - i64::from(minutes) * 60_000);
    Ok(Json(SamplesOut::of(&envelope(&samples, SAMPLES_MAX))))
}

/// Keeps the samples until the service ends.
pub async fn keep(app: App) {
    let mut follower = app.campaign.follow_samples();
    loop {
        tokio::time::sleep(SAMPLES_PERIOD).await;
        let samples: Vec<_> = from_fn(|| arrived(&mut follower)).collect();
        app.facts.memory.samples.add(&samples);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::ARMS;

    fn sample(at_ms: i64) -> ForceSample {
        ForceSample { at_ms, z_mm: None, forces_n: [Some(1.0); ARMS] }
    }

    #[test]
    fn the_ring_forgets_what_is_older_than_half_an_hour_and_stays_small() {
        let ring = Ring::default();
        ring.add(&[]);
        ring.add(&[sample(0), sample(10), sample(20)]);
        assert_eq!(ring.since(0).iter().map(|s| s.at_ms).collect::<Vec<_>>(), [0, 20]);
        ring.add(&[sample(1_800_010)]);
        assert_eq!(ring.since(0).iter().map(|s| s.at_ms).collect::<Vec<_>>(), [20, 1_800_010]);
        // Periods of a clock that jumps.
        for _ in 0..KEPT_MAX {
            ring.add(&[sample(1_800_010), sample(1_800_010)]);
        }
        assert_eq!(ring.since(0).len(), KEPT_MAX);
        assert_eq!(ring.since(1_800_011), []);
    }
}
