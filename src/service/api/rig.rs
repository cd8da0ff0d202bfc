//! The rig by hand: connect, home, jog, tare, reset, check.
//! Uses: `campaign::shown::command`, `rig::check`. Never: motion of its own.

use axum::extract::State;
use axum::extract::rejection::JsonRejection;
use axum::http::StatusCode;
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::App;
use super::auth::Asker;
use super::problem::{ApiError, Body, ProblemBody};
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::shown::command::Request;
use crate::rig::check::{self, CheckReport, Scope};
use crate::rig::error::RigError;

/// One check at a time: a wire has one owner.
static CHECKING: tokio::sync::Mutex<()> = tokio::sync::Mutex::const_new(());

/// An action on the rig.
#[derive(Debug, Clone, Deserialize, ToSchema)]
pub struct RigAct {
    /// What to do.
    pub action: RigAction,
    /// For `jog`: `x`, `y`, `z` or `radius`.
    pub axis: Option<String>,
    /// For `jog`: absolute target, mm.
    pub to_mm: Option<f64>,
    /// For `tips`: how many are mounted, on arms 1 to n; 0 to 6.
    pub tips: Option<u8>,
    /// Who asks.
    pub who: Option<String>,
    /// Why.
    pub why: Option<String>,
}

/// What can be done with the rig by hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RigAction {
    /// Open the wires.
    Connect,
    /// Close them.
    Disconnect,
    /// Home all axes, z first.
    Home,
    /// Move one axis.
    Jog,
    /// Read the cells' zeros.
    Tare,
    /// Say how many tips are mounted.
    Tips,
    /// Acknowledge a trip.
    Reset,
}

/// How far a check of the rig goes.
#[derive(Debug, Clone, Default, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RigCheck {
    /// Also take control of the drives and switch their servos on, which stay on.
    pub enable: bool,
    /// Who asks.
    pub who: Option<String>,
    /// Why.
    pub why: Option<String>,
}

/// An action on the rig. Motions answer when they are taken up.
#[utoipa::path(post, path = "/api/v1/rig/actions", tag = "rig", request_body = RigAct,
    responses((status = 202), (status = 409, body = ProblemBody), (status = 422, body = ProblemBody)))]
pub async fn act(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    Body(act): Body<RigAct>,
) -> Result<StatusCode, ApiError> {
    let (name, request) = match act.action {
        RigAction::Connect => ("connect", Request::Connect),
        RigAction::Disconnect => ("disconnect", Request::Disconnect),
        RigAction::Home => ("home", Request::Home),
        RigAction::Tare => ("tare", Request::Tare),
        RigAction::Reset => ("reset", Request::Reset),
        RigAction::Tips => {
            let tips = act.tips.ok_or_else(|| {
                ApiError::value("tips", "absent", "how many tips are mounted: 0 to 6")
            })?;
            ("tips", Request::Mounted { tips, who: asker.name(act.who.as_deref()) })
        }
        RigAction::Jog => {
            let axis = act.axis.clone().unwrap_or_default();
            let to_mm = act.to_mm.filter(|v| v.is_finite()).ok_or_else(|| {
                ApiError::value("to_mm", "absent", "a jog needs axis and to_mm, a number")
            })?;
            ("jog", Request::Jog { axis, to_mm })
        }
    };
    let outcome = async {
        app.unlocked(&asker, act.who.as_deref()).await?;
        Ok(app.campaign.ask(request).await?)
    }
    .await;
    app.logged(&asker, name, (None, act.who.as_deref(), act.why.as_deref()), outcome).await?;
    Ok(StatusCode::ACCEPTED)
}

/// Talks to every device and says what it found; moves nothing, and switches nothing on unless
/// `enable` says so. Only while the campaign has no wires open.
#[utoipa::path(post, path = "/api/v1/rig/check", tag = "rig", request_body = Option<RigCheck>,
    responses((status = 200, body = Object), (status = 409, body = ProblemBody),
        (status = 422, body = ProblemBody), (status = 502, body = ProblemBody)))]
pub async fn check(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    asked: Result<Option<Json<RigCheck>>, JsonRejection>,
) -> Result<Json<serde_json::Value>, ApiError> {
    let RigCheck { enable, who, why } = asked?.map(|Json(asked)| asked).unwrap_or_default();
    let outcome = checked(&app, &asker, enable, who.as_deref()).await;
    let name = if enable { "rig_check_enable" } else { "rig_check" };
    let report = app.logged(&asker, name, (None, who.as_deref(), why.as_deref()), outcome).await?;
    let report = serde_json::to_value(report)
        .map_err(|e| ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, e.to_string()))?;
    Ok(Json(report))
}

async fn checked(
    app: &App,
    asker: &Asker,
    enable: bool,
    who: Option<&str>,
) -> Result<CheckReport, ApiError> {
    let conflict = |words: &str| ApiError::new(StatusCode::CONFLICT, words);
    if enable {
        app.unlocked(asker, who).await?;
    }
    let _alone = CHECKING.try_lock().map_err(|_| conflict("another check is under way"))?;
    if app.campaign.status().rig.state != RigState::Disconnected {
        return Err(conflict("a check needs the wires: disconnect the rig first"));
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
