//! Requests that come late: a network that was silent may deliver one long after it was sent. One that states the status
//! that its client had then (`Status-At`) is refused if that status is too old.
//! Uses: the time of the service. Never: a refusal of a stop, a pause or an abort.

use axum::http::{HeaderMap, StatusCode};
use jiff::Timestamp;

use super::App;
use super::limits::STATUS_AGE_MAX;
use super::problem::{ApiError, ApiResult};

/// Header with the `at` of the newest status that the client had.
const STATUS_AT: &str = "status-at";

impl App {
    /// Time of the service: the wall time of its start, and the time that has passed since. It does not follow a wall
    /// clock that is set.
    pub(super) fn time(&self) -> Timestamp {
        self.facts.started_at + self.facts.began.elapsed()
    }

    /// Checks that a request follows the status that it states, if it states one.
    ///
    /// # Errors
    /// 409 if the status is too old, or not of this service; 400 if the header is invalid.
    pub(super) fn in_time(&self, headers: &HeaderMap) -> ApiResult<()> {
        follows(headers, self.time())
    }
}

fn follows(headers: &HeaderMap, now: Timestamp) -> ApiResult<()> {
    for stated in headers.get_all(STATUS_AT) {
        let at = stated.to_str().ok().and_then(|text| text.parse::<Timestamp>().ok());
        let Some(at) = at else {
            let words = "header Status-At: must be the `at` of a status";
            return Err(ApiError::new(StatusCode::BAD_REQUEST, words));
        };
        let (late_s, most_s) = (now.duration_since(at).as_secs_f64(), STATUS_AGE_MAX.as_secs_f64());
        if !(0.0..=most_s).contains(&late_s) {
            let words = format!(
                "the request came {late_s:.0} s after the status that it states (Status-At), limit {most_s} s: \
                 nothing was done, nothing moves; check the rig, then request it again"
            );
            return Err(ApiError::new(StatusCode::CONFLICT, words));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_that_comes_long_after_its_status_is_refused() {
        let now = Timestamp::constant(1_795_000_000, 500_000_000);
        let refusal = |stated: &[&str]| {
            let mut headers = HeaderMap::new();
            for value in stated {
                headers.append(STATUS_AT, value.parse().unwrap());
            }
            follows(&headers, now).err().map(|e| (e.status().as_u16(), e.detail().to_owned()))
        };
        let after = |late_ms: i64| {
            refusal(&[&(now - jiff::SignedDuration::from_millis(late_ms)).to_string()])
        };
        assert_eq!(refusal(&[]), None, "other clients state none");
        assert_eq!([0, 200, 10_000].map(after), [None, None, None]);
        let (status, words) = after(14_000).unwrap();
        assert!(status == 409 && words.contains("came 14 s after"), "{status} {words}");
        assert_eq!(after(10_001).unwrap().0, 409);
        assert_eq!(after(-1).unwrap().0, 409, "of another process");
        let fresh = now.to_string();
        assert_eq!(refusal(&[&fresh, "2026-01-01T00:00:00Z"]).unwrap().0, 409);
        for invalid in ["", "now", "undefined"] {
            assert_eq!(refusal(&[invalid]).unwrap().0, 400, "{invalid}");
        }
    }
}
