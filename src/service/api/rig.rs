//! Manual actions on the rig: connect, home, jog, tare, reset, check; the abort of a motion.
//! Uses: `campaign::{check, shown}`. Never: motion except through the campaign.

use axum::Json;
use axum::extract::rejection::JsonRejection;
use axum::http::StatusCode;
use serde::Deserialize;
use utoipa::ToSchema;

use super::App;
use super::audit::Act;
use super::problem::{ApiError, ApiResult, Body};
use super::refusals::{CONNECTED, DESK};
use super::runs::Attribution;
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::check::{self, CheckReport, Scope};
use crate::campaign::shown::command::Request;
use crate::campaign::shown::rig_action::RigAction;
use crate::rig::error::RigError;

/// Request for an action on the rig.
#[derive(Debug, Clone, Deserialize, ToSchema)]
pub struct RigActionRequest {
    /// Action that the rig must perform.
    pub action: RigAction,
    /// For `jog`: `x`, `y`, `z` or `radius`.
    pub axis: Option<String>,
    /// For `jog`: absolute target, mm.
    pub to_mm: Option<f64>,
    /// For `tips`: number n of mounted tips, 0 to 6, on arms 1 to n.
    pub tips: Option<u8>,
    /// Name of the person, for the log of actions.
    pub who: Option<String>,
    /// Reason, for the log of actions.
    pub why: Option<String>,
}

/// Options of a check of the rig.
#[derive(Debug, Clone, Default, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RigCheckRequest {
    /// True: also take control of the drives and switch their servos on. The servos stay on.
    pub enable: bool,
    /// Name of the person, for the log of actions.
    pub who: Option<String>,
    /// Reason, for the log of actions.
    pub why: Option<String>,
}

/// Requests a manual action on the rig.
///
/// The response to a motion is sent when the motion is accepted; the status shows its effect.
#[utoipa::path(post, operation_id = "rig_action", path = "/api/v1/rig/actions", tag = "rig",
    request_body = RigActionRequest, responses((status = 202),
        (status = 409,
            description = "the state of the rig does not allow the action, or another person holds the lock"),
        (status = 422, description = "a value is missing or invalid")))]
pub async fn act(app: App, act: Act, Body(asked): Body<RigActionRequest>) -> ApiResult<StatusCode> {
    act.stated(asked.who.as_deref(), asked.why.as_deref());
    act.named(asked.action.as_str());
    let request = match asked.action {
        RigAction::Connect if app.facts.desk => {
            return Err(ApiError::new(StatusCode::CONFLICT, DESK));
        }
        RigAction::Connect => Request::Connect,
        RigAction::Disconnect => Request::Disconnect,
        RigAction::Home => Request::Home,
        RigAction::Tare => Request::Tare,
        RigAction::Reset => Request::Reset,
        RigAction::Tips => {
            let tips = asked.tips.ok_or_else(|| {
                ApiError::value("tips", "absent", "must be the number of mounted tips, 0 to 6")
            })?;
            Request::Mounted { tips, who: act.name() }
        }
        RigAction::Jog => {
            let axis = asked.axis.unwrap_or_default();
            let to_mm = asked.to_mm.filter(|v| v.is_finite()).ok_or_else(|| {
                ApiError::value("to_mm", "absent", "must be a finite number, mm, for a jog")
            })?;
            Request::Jog { axis, to_mm }
        }
    };
    app.conductor.note_operation();
    let asked = app.campaign.ask(request).await;
    app.conductor.keep_operation().await;
    asked?;
    Ok(StatusCode::ACCEPTED)
}

/// Aborts a homing or a jog: the axes stop, then the tips rise.
///
/// Any valid key permits it, and no operator lock refuses it. A motion of a run is aborted with that run.
#[utoipa::path(post, operation_id = "abort_motion", path = "/api/v1/rig/abort", tag = "rig",
    request_body = Attribution, responses((status = 202),
        (status = 409, description = "nothing moves, or a run is active")))]
pub async fn abort(app: App, act: Act, Body(stated): Body<Attribution>) -> ApiResult<StatusCode> {
    act.stated(stated.who.as_deref(), stated.why.as_deref());
    app.conductor.abort_motion().await?;
    Ok(StatusCode::ACCEPTED)
}

/// Checks every device of the rig and returns a report.
///
/// The check moves nothing, and switches the servos on only if `enable` is true. The rig must be
/// disconnected.
#[utoipa::path(post, operation_id = "check_rig", path = "/api/v1/rig/check", tag = "rig",
    request_body = Option<RigCheckRequest>, responses((status = 200, body = Object),
        (status = 409,
            description = "the rig is connected, the e-stop is latched, a check is active, or another person holds the operator lock"),
        (status = 502, description = "a device does not respond as expected")))]
pub async fn check(
    app: App,
    act: Act,
    body: Result<Option<Json<RigCheckRequest>>, JsonRejection>,
) -> ApiResult<Json<serde_json::Value>> {
    let RigCheckRequest { enable, who, why } =
        body?.map(|Json(request)| request).unwrap_or_default();
    act.stated(who.as_deref(), why.as_deref());
    act.named(if enable { "rig_check_enable" } else { "rig_check" });
    if enable {
        app.conductor.note_operation();
    }
    let report = checked(&app, enable).await;
    if enable {
        app.conductor.keep_operation().await;
    }
    let report = report?;
    let report = serde_json::to_value(report).map_err(ApiError::internal)?;
    Ok(Json(report))
}

async fn checked(app: &App, enable: bool) -> ApiResult<CheckReport> {
    let conflict = |words: &str| ApiError::new(StatusCode::CONFLICT, words);
    let wires = app.campaign.wires();
    let Some(_wires) = wires.take() else {
        let is_connected = app.campaign.status().rig.state != RigState::Disconnected;
        return Err(conflict(if is_connected {
            CONNECTED
        } else {
            "another check is active, or the rig is connecting: wait for its end"
        }));
    };
    let estop = app.campaign.stop_switch();
    let scope = if enable { Scope::Enable } else { Scope::Look };
    let report = check::run_on(&app.facts.rig.config, &estop, scope).await;
    report.map_err(|error| {
        let status = match error {
            RigError::Latched { .. } => StatusCode::CONFLICT,
            _ => StatusCode::BAD_GATEWAY,
        };
        ApiError::new(status, error.to_string())
    })
}
