//! The rig by hand: connect, home, jog, tare, reset, check.
//! Uses: `campaign::command`, `rig::check`. Never: motion of its own.

use axum::extract::State;
use axum::http::StatusCode;
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::App;
use super::auth::Asker;
use super::problem::{ApiError, Body, ProblemBody};
use crate::campaign::command::Request;
use crate::campaign::rig_state::RigState;
use crate::clock::Clock;
use crate::rig::check;
use crate::rig::link::StopLatch;
use crate::rig::registry;

/// An action on the rig.
#[derive(Debug, Clone, Deserialize, ToSchema)]
pub struct RigAct {
    /// What to do.
    pub action: RigAction,
    /// For `jog`: `x`, `y`, `z` or `radius`.
    pub axis: Option<String>,
    /// For `jog`: absolute target, mm.
    pub to_mm: Option<f64>,
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
    /// Acknowledge a trip.
    Reset,
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

/// Talks to every device and says what it found. Only while the campaign has no wires open.
#[utoipa::path(post, path = "/api/v1/rig/check", tag = "rig",
    responses((status = 200, body = Object), (status = 409, body = ProblemBody)))]
pub async fn check(State(app): State<App>) -> Result<Json<serde_json::Value>, ApiError> {
    if app.campaign.status().rig.state != RigState::Disconnected {
        let words = "a check needs the wires: disconnect the rig first";
        return Err(ApiError::new(StatusCode::CONFLICT, words));
    }
    let config = &app.facts.rig.config;
    let clock = Clock::new(config.clock_rate);
    let open = registry::open(config, &clock, &StopLatch::new())
        .map_err(|e| ApiError::new(StatusCode::BAD_GATEWAY, e.to_string()))?;
    let report = check::check(config, &open, &clock).await;
    let report = serde_json::to_value(report)
        .map_err(|e| ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, e.to_string()))?;
    Ok(Json(report))
}
