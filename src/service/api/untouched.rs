//! The frame of the untouched skin, for differences: the newest one of this rig.
//! Uses: the campaign's untouched frames, `store`. Never: a frame of a skin that may be touched.

use std::sync::Arc;

use axum::Json;

use super::App;
use super::problem::{ApiError, ApiResult};
use crate::infer::methods::exact::UNTOUCHED_N;
use crate::record::Untouched;
use crate::store::{RunKind, StoreResult, TrialRow};

/// Trials whose frames are averaged.
const AVERAGED_TRIALS: u32 = 8;
/// Runs that are searched, newest first.
const SEARCHED_RUNS: usize = 10;

/// Returns the newest mean frame of the untouched skin of this rig.
///
/// During a run it is taken in the air before each configuration. After a restart of the service it is the
/// mean of the newest stored trials in which no tip touched the skin.
#[utoipa::path(get, operation_id = "untouched_frame", path = "/api/v1/frames/untouched",
    tag = "frames", responses((status = 200, body = Untouched),
        (status = 404, description = "no frame of the untouched skin is known")))]
pub async fn untouched(app: App) -> ApiResult<Json<Arc<Untouched>>> {
    if let Some(taken) = app.campaign.untouched() {
        return Ok(Json(taken));
    }
    let stored = app.facts.memory.untouched.get((), stored(&app)).await?;
    stored.map(Json).ok_or_else(|| {
        let words = "no frame of the untouched skin is known: none was taken in a run on this rig";
        ApiError::not_found(words)
    })
}

/// The mean frame of the newest stored trials of this rig in which the skin was untouched.
async fn stored(app: &App) -> StoreResult<Option<Arc<Untouched>>> {
    let channels = app.serving.sensor().channels();
    let label = app.facts.rig.config.label();
    for run in app.store.runs_with_trials().await?.into_iter().take(SEARCHED_RUNS) {
        let row = app.store.run(run).await?;
        if row.is_none_or(|row| row.kind != RunKind::RealHex || row.label != label) {
            continue;
        }
        let ids = app.store.untouched_trials(run, UNTOUCHED_N, AVERAGED_TRIALS).await?;
        let trials = app.store.trials_with_voltages(&ids).await?;
        if let Some(mean) = mean(&trials, channels) {
            return Ok(Some(Arc::new(mean)));
        }
    }
    Ok(None)
}

/// Mean frame of trials, weighted by their numbers of frames; `None` without a frame of `channels`
/// channels.
fn mean(trials: &[TrialRow], channels: usize) -> Option<Untouched> {
    let measured =
        |t: &TrialRow| Some((t.voltages_v.clone()?, t.frame_count, t.measured_at?, t.run));
    let of_size = |(volts, ..): &(Vec<f32>, u32, _, _)| volts.len() == channels;
    let all: Vec<_> = trials.iter().filter_map(measured).filter(of_size).collect();
    let frames: usize = all.iter().map(|(_, count, ..)| *count as usize).sum();
    let (.., at, run) = all.iter().max_by_key(|(.., at, _)| *at)?;
    let mean_v = |channel: usize| {
        let sum: f64 =
            all.iter().map(|(v, count, ..)| f64::from(v[channel]) * f64::from(*count)).sum();
        (sum / frames.max(1) as f64) as f32
    };
    let voltages_v = (0..channels).map(mean_v).collect();
    Some(Untouched { voltages_v, at: *at, frames, run: Some(*run), stream_since: None })
}
