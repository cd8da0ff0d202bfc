//! Examples of request bodies for the description of the API.
//! Uses: the files of `experiments/`. Never: a body that the service would refuse.

use serde_json::{Value, json};

use crate::carried::{RECIPES, text};

const EXPERIMENT_TEXT: &str = include_str!("../../../experiments/quickstart.toml");
const SENSOR_TEXT: &str = include_str!("../../../experiments/sensors/ert-28.toml");

/// Returns the example of an operation's body; `None` for uploads, and for frames, which are long.
pub fn body(operation: &str) -> Option<Value> {
    let submission = || json!({ "file": "quickstart.toml", "definition": EXPERIMENT_TEXT, "sensor": SENSOR_TEXT });
    Some(match operation {
        "abort_motion" => json!({ "who": "Ada", "why": "a cable is caught" }),
        "arm_run" => json!({ "who": "Ada", "why": "overnight run" }),
        "check_rig" => json!({ "enable": false, "who": "Ada" }),
        "create_key" => json!({ "name": "Ada", "role": "operator" }),
        "edit_run" => {
            let mut body = submission();
            body["not_before"] = "2026-11-23T21:00:00Z".into();
            body
        }
        "evaluate" => {
            json!({ "scored": "exact", "dataset": "real", "where": ["contact_count__lte=2"], "limit": 20 })
        }
        // It prepares a skin at once: a dataset that is not there.
        "evaluation_inputs" => {
            json!({ "scored": "exact", "dataset": "ds-0123456789abcdef", "limit": 20 })
        }
        "make_dataset" => json!({ "name": "real" }),
        "move_run" => json!({ "position": 1, "who": "Ada" }),
        "preflight_submission" => submission(),
        "promote" => {
            json!({ "what": "transfer-net", "why": "least FVU of the week", "who": "Ada" })
        }
        "prune_datasets" => json!({ "keep": 2, "dry_run": true }),
        "query" => json!({ "sql": "SELECT label, count(*) AS trials FROM trials GROUP BY label" }),
        "queue_run" => {
            let mut body = submission();
            body["who"] = "Ada".into();
            body
        }
        "request_export" => {
            json!({ "dataset": "real", "format": "npz", "where": ["contact_count__gte=3"], "map": "4x20" })
        }
        "rig_action" => json!({ "action": "jog", "axis": "z", "to_mm": 0.0, "who": "Ada" }),
        "roll_back" => json!({ "slot": "transfer", "why": "too many ghosts", "who": "Ada" }),
        "run_action" => {
            json!({ "action": "pause", "when": "checkpoint", "why": "lunch", "who": "Ada" })
        }
        "simulate" => {
            json!({ "contacts": [
                { "x_mm": 270.0, "y_mm": 280.0, "force_n": 20.0 },
                { "x_mm": 180.0, "y_mm": 160.0, "depth_mm": 1.5 },
            ] })
        }
        "submission_tour" => submission(),
        "take_lock" => json!({ "note": "hands in the rig" }),
        "train" => json!({ "recipe": text(RECIPES, "transfer-net")? }),
        _ => return None,
    })
}
