//! How many inferences, simulations and live clients there may be at once.
//! Uses: tokio's semaphores, `limits`. Never: a wait without a deadline.

use std::sync::Arc;

use axum::http::StatusCode;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::timeout;

use super::limits::{
    FIT_REQUESTS, FRAME_CLIENTS, LIVE_CLIENTS, NET_REQUESTS, PREFLIGHTS, SIMULATIONS,
    STATUS_CLIENTS, TURN_WAIT,
};
use super::problem::{ApiError, ApiResult};

/// Limits of concurrent inferences and simulations, so that enough processor time remains for the campaign.
#[derive(Clone)]
pub struct Turns {
    /// Answers by nets.
    pub(super) answers: Arc<Semaphore>,
    /// Answers by fits.
    pub(super) fits: Arc<Semaphore>,
    /// Clients of live contacts and quantities.
    pub(super) live: Arc<Semaphore>,
    /// Clients of live frames.
    pub(super) frames: Arc<Semaphore>,
    /// Clients of the live status.
    pub(super) status: Arc<Semaphore>,
    /// Preflights and tours: planning takes processor time that a campaign may need.
    pub(super) preflights: Arc<Semaphore>,
    /// Simulations.
    pub(super) simulations: Arc<Semaphore>,
}

/// Waits for a turn of a kind.
///
/// # Errors
/// 503 if none comes within `TURN_WAIT`.
pub(super) async fn turn(of: &Arc<Semaphore>) -> ApiResult<OwnedSemaphorePermit> {
    let Ok(Ok(turn)) = timeout(TURN_WAIT, of.clone().acquire_owned()).await else {
        let words = "too many requests: none could be started within 10 s; retry";
        return Err(ApiError::new(StatusCode::SERVICE_UNAVAILABLE, words));
    };
    Ok(turn)
}

/// Takes the place of a live client.
///
/// # Errors
/// 503 if none is left; `limit` is their number, `kind` what the clients receive.
pub(super) fn place(
    places: &Arc<Semaphore>,
    (limit, kind): (usize, &str),
) -> ApiResult<OwnedSemaphorePermit> {
    places.clone().try_acquire_owned().map_err(|_| {
        let words = format!("{limit} clients of the {kind} are connected, the limit");
        ApiError::new(StatusCode::SERVICE_UNAVAILABLE, words)
    })
}

impl Default for Turns {
    fn default() -> Self {
        let of = |count| Arc::new(Semaphore::new(count));
        Self {
            answers: of(NET_REQUESTS),
            fits: of(FIT_REQUESTS),
            live: of(LIVE_CLIENTS),
            frames: of(FRAME_CLIENTS),
            status: of(STATUS_CLIENTS),
            preflights: of(PREFLIGHTS),
            simulations: of(SIMULATIONS),
        }
    }
}
