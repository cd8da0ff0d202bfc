//! Origin of the rows of a dataset, by its lineage.
//! PURE. Uses: `store`'s labels, serde. Never: the label of a run without trials.

use serde::Deserialize;
use serde_json::Value;

use crate::store::Label;

/// The label that all rows with a lineage have: `simulated` without any run; `None` if they have several, or if one
/// cannot be read.
pub fn label(lineage: &Value) -> Option<Label> {
    let runs = lineage["runs"].as_array().into_iter().flatten();
    let shards = lineage["sim_random"].as_array().into_iter().flatten();
    // The lineage of a net that is scored states no numbers of trials.
    let has_trials = |run: &&Value| run.get("trials").is_none_or(|n| n.as_u64() > Some(0));
    let of_runs = runs.filter(has_trials).map(|run| Label::deserialize(&run["label"]).ok());
    let mut labels = of_runs.chain(shards.map(|_| Some(Label::Simulated)));
    let first = labels.next().unwrap_or(Some(Label::Simulated))?;
    labels.all(|label| label == Some(first)).then_some(first)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn rows_of_one_origin_have_its_label() {
        let of = |runs: Value| label(&json!({ "runs": runs, "sim_random": [] }));
        assert_eq!(of(json!([{ "label": "virtual", "trials": 3 }])), Some(Label::Virtual));
        assert_eq!(of(json!([{ "label": "virtual" }])), Some(Label::Virtual));
        assert_eq!(of(json!([])), Some(Label::Simulated));
        assert_eq!(label(&json!({})), Some(Label::Simulated));
        assert_eq!(of(json!([{ "label": "unknown", "trials": 3 }])), None);
    }

    #[test]
    fn a_run_without_trials_labels_no_row() {
        let empty = json!({ "label": "measured", "trials": null });
        let stored = json!({ "label": "virtual", "trials": 9 });
        assert_eq!(label(&json!({ "runs": [empty, stored] })), Some(Label::Virtual));
    }

    #[test]
    fn rows_of_several_origins_have_no_label() {
        let runs = json!([{ "label": "virtual", "trials": 9 }]);
        let shards = json!([{ "folder": "free" }]);
        assert_eq!(label(&json!({ "runs": runs, "sim_random": shards })), None);
        assert_eq!(label(&json!({ "runs": [], "sim_random": shards })), Some(Label::Simulated));
        let both =
            json!([{ "label": "virtual", "trials": 9 }, { "label": "measured", "trials": 1 }]);
        assert_eq!(label(&json!({ "runs": both })), None);
    }
}
