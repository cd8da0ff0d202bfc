//! Whether scored rows may be among those that a net was trained on.
//! PURE. Uses: definition and lineage of datasets. Never: the rows.

use std::collections::BTreeSet;

use serde_json::Value;

/// Origin of a dataset: its definition and its lineage.
pub struct Made<'a> {
    /// The definition, as JSON.
    pub definition: &'a Value,
    /// The lineage, as JSON.
    pub lineage: &'a Value,
}

impl Made<'_> {
    fn named(&self, list: &str, name: &str) -> BTreeSet<&str> {
        let entries = self.lineage[list].as_array().into_iter().flatten();
        entries.filter_map(|entry| entry[name].as_str()).collect()
    }

    fn runs(&self) -> BTreeSet<&str> {
        self.named("runs", "uid")
    }

    fn shards(&self) -> BTreeSet<&str> {
        self.named("sim_random", "folder")
    }
}

/// Whether no row of a part of `scored` (`None`: of all parts) was used to train a net on
/// `learned`: the two share no run and no simulations, or have the same split and the part is the
/// test part.
pub fn is_held_out(part: Option<&str>, scored: &Made<'_>, learned: &Made<'_>) -> bool {
    let apart = scored.runs().is_disjoint(&learned.runs())
        && scored.shards().is_disjoint(&learned.shards());
    let divided_alike = scored.runs() == learned.runs()
        && scored.definition["split"] == learned.definition["split"];
    apart || (part == Some("test") && divided_alike)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn made(runs: &[&str], split_by: &str) -> [Value; 2] {
        let runs: Vec<Value> = runs.iter().map(|uid| json!({ "uid": uid })).collect();
        [json!({ "split": { "by": split_by } }), json!({ "runs": runs })]
    }

    #[test]
    fn tests_of_the_same_division_and_other_runs_are_held_out_and_nothing_else() {
        let learned = made(&["a", "b"], "configuration");
        let held_out = |part, scored: [Value; 2]| {
            let [scored, learned] =
                [&scored, &learned].map(|[definition, lineage]| Made { definition, lineage });
            is_held_out(part, &scored, &learned)
        };
        assert!(held_out(Some("test"), made(&["a", "b"], "configuration")));
        assert!(!held_out(Some("train"), made(&["a", "b"], "configuration")));
        assert!(!held_out(None, made(&["a", "b"], "configuration")));
        assert!(!held_out(Some("test"), made(&["a", "b"], "trial")));
        // With one further run the parts differ.
        assert!(!held_out(Some("test"), made(&["a", "b", "c"], "configuration")));
        assert!(held_out(None, made(&["c"], "none")));
    }
}
