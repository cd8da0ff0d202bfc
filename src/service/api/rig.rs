//! Manual actions on the rig: connect, home, jog, tare, reset, check.
//! Uses: `campaign::shown::command`, `rig::check`. Never: motion except through the campaign.

use axum::extract::State;
use axum::extract::rejection::JsonRejection;
use axum::http::StatusCode;
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::App;
use super::audit::ActionContext;
use super::auth::Caller;
use super::problem::{ApiError, Body, ProblemBody};
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::shown::command::Request;
use crate::rig::check::{self, CheckReport, Scope};
use crate::rig::error::RigError;

/// Held during a check: a wire has one owner, so only one check may be active.
static CHECKING: tokio::sync::Mutex<()> = tokio::sync::Mutex::const_new(());

/// Request for an action on the rig.
#[derive(Debug, Clone, Deserialize, ToSchema)]
pub struct RigActionRequest {
    /// The action.
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

/// Manual action on the rig.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RigAction {
    /// Open the wires.
    Connect,
    /// Close the wires.
    Disconnect,
    /// Home all axes, z first.
    Home,
    /// Move one axis.
    Jog,
    /// Measure the output of the load cells without load.
    Tare,
    /// Enter the number of mounted tips.
    Tips,
    /// Acknowledge a trip.
    Reset,
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
#[utoipa::path(post, operation_id = "rig_action",
    path = "/api/v1/rig/actions", tag = "rig", request_body = RigActionRequest,
    responses((status = 202),
        (status = 409, body = ProblemBody,
            description = "the state of the rig does not allow the action, or another person holds the lock"),
        (status = 422, body = ProblemBody, description = "a value is missing or invalid")))]
pub async fn act(
    State(app): State<App>,
    Extension(caller): Extension<Caller>,
    Body(act): Body<RigActionRequest>,
) -> Result<StatusCode, ApiError> {
    let (name, request) = match act.action {
        RigAction::Connect => ("connect", Request::Connect),
        RigAction::Disconnect => ("disconnect", Request::Disconnect),
        RigAction::Home => ("home", Request::Home),
        RigAction::Tare => ("tare", Request::Tare),
        RigAction::Reset => ("reset", Request::Reset),
        RigAction::Tips => {
            let tips = act.tips.ok_or_else(|| {
                ApiError::value("tips", "absent", "must be the number of mounted tips, 0 to 6")
            })?;
            ("tips", Request::Mounted { tips, who: caller.name(act.who.as_deref()) })
        }
        RigAction::Jog => {
            let axis = act.axis.clone().unwrap_or_default();
            let to_mm = act.to_mm.filter(|v| v.is_finite()).ok_or_else(|| {
                ApiError::value("to_mm", "absent", "must be a finite number, mm, for a jog")
            })?;
            ("jog", Request::Jog { axis, to_mm })
        }
    };
    let outcome = async {
        app.unlocked(&caller, act.who.as_deref()).await?;
        Ok(app.campaign.ask(request).await?)
    }
    .await;
    let (who, why) = (act.who.as_deref(), act.why.as_deref());
    app.logged(&caller, name, ActionContext { run: None, who, why }, outcome).await?;
    Ok(StatusCode::ACCEPTED)
}

/// Checks every device of the rig and returns a report.
///
/// The check moves nothing, and switches the servos on only if `enable` is true. The rig must be
/// disconnected.
#[utoipa::path(post, operation_id = "check_rig",
    path = "/api/v1/rig/check", tag = "rig", request_body = Option<RigCheckRequest>,
    responses((status = 200, body = Object),
        (status = 409, body = ProblemBody,
            description = "the rig is connected, the e-stop is latched, a check is active, or another person holds the operator lock"),
        (status = 422, body = ProblemBody, description = "the body is invalid"),
        (status = 502, body = ProblemBody, description = "a device does not respond as expected")))]
pub async fn check(
    State(app): State<App>,
    Extension(caller): Extension<Caller>,
    body: Result<Option<Json<RigCheckRequest>>, JsonRejection>,
) -> Result<Json<serde_json::Value>, ApiError> {
    let RigCheckRequest { enable, who, why } =
        body?.map(|Json(request)| request).unwrap_or_default();
    let outcome = checked(&app, &caller, enable, who.as_deref()).await;
    let name = if enable { "rig_check_enable" } else { "rig_check" };
    let context = ActionContext { run: None, who: who.as_deref(), why: why.as_deref() };
    let report = app.logged(&caller, name, context, outcome).await?;
    let report = serde_json::to_value(report)
        .map_err(|e| ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, e.to_string()))?;
    Ok(Json(report))
}

async fn checked(
    app: &App,
    caller: &Caller,
    enable: bool,
    who: Option<&str>,
) -> Result<CheckReport, ApiError> {
    let conflict = |words: &str| ApiError::new(StatusCode::CONFLICT, words);
    if enable {
        app.unlocked(caller, who).await?;
    }
    let _alone =
        CHECKING.try_lock().map_err(|_| conflict("another check is active: wait for its end"))?;
    if app.campaign.status().rig.state != RigState::Disconnected {
        return Err(conflict("the rig is connected: disconnect it before a check"));
    }
    let latch = app.campaign.stop_switch().latch();
    let scope = if enable { Scope::Enable } else { Scope::Look };
    let report = check::run_on(&app.facts.rig.config, &latch, scope).await;
    report.map_err(|error| {
        let status = match error {
            RigError::Latched { .. } => StatusCode::CONFLICT,
            _ => StatusCode::BAD_GATEWAY,
        };
        ApiError::new(status, error.to_string())
    })
}
