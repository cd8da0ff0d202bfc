//! The actions on rig and run, each with the reason why it would be refused now.
//! Uses: `campaign::shown`, whether the service has no rig. Never: an action (`rig` and `runs` request them).

use serde::Serialize;
use utoipa::ToSchema;

use super::App;
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::shown::rig_action::RigAction;
use crate::campaign::shown::run_action::ActionOnRun;
use crate::campaign::shown::status::Status;

/// Refusal of a connection by a service without a rig.
pub const DESK: &str = "this service was started for data, without the rig: use `palpate serve`";
/// Refusal of a check of an open rig.
pub const CONNECTED: &str = "the rig is connected: disconnect it before a check";

/// Whether an action is possible now.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct ActionStatus {
    /// Name of the action, as in a request.
    pub action: &'static str,
    /// Why it would be refused, as text; null if it would not.
    pub refused: Option<String>,
}

/// The actions that this rig has, each with the reason why it would be refused now.
pub fn of_rig(app: &App, status: &Status) -> Vec<ActionStatus> {
    let actions = RigAction::ALL.iter().copied();
    let actions = actions.filter(|action| status.rig.has_stage || !action.needs_stage());
    let actions = actions.map(|action| {
        let at_a_desk = (app.facts.desk && action == RigAction::Connect).then(|| DESK.to_owned());
        let refused = at_a_desk.or_else(|| action.refused_now(status));
        ActionStatus { action: action.as_str(), refused }
    });
    let is_connected = status.rig.state != RigState::Disconnected;
    let check =
        ActionStatus { action: "check", refused: is_connected.then(|| CONNECTED.to_owned()) };
    actions.chain([check]).collect()
}

/// The actions on a run, each with the reason why it would be refused now.
pub fn of_run(status: &Status) -> Vec<ActionStatus> {
    let action_now = |action: ActionOnRun| ActionStatus {
        action: action.as_str(),
        refused: action.refused(status),
    };
    ActionOnRun::ALL.into_iter().map(action_now).collect()
}
