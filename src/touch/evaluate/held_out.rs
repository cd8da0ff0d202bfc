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
/// test part. The strata of a split are numbers of contacts, which follow from the deadband.
pub fn is_held_out(part: Option<&str>, scored: &Made<'_>, learned: &Made<'_>) -> bool {
    let apart = scored.runs().is_disjoint(&learned.runs())
        && scored.shards().is_disjoint(&learned.shards());
    let [scored_of, learned_of] = [scored.definition, learned.definition];
    let same_strata = scored_of["split"]["stratify"] != true
        || scored_of["deadband_n"] == learned_of["deadband_n"];
    let divided_alike =
        scored.runs() == learned.runs() && scored_of["split"] == learned_of["split"] && same_strata;
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

    #[test]
    fn another_deadband_divides_strata_otherwise_and_nothing_else() {
        let held_out = |stratify: bool, deadband_n: f64| {
            let of = |deadband_n: f64| {
                let split = json!({ "by": "trial", "stratify": stratify });
                json!({ "split": split, "deadband_n": deadband_n })
            };
            let (one, two, lineage) =
                (of(5.0), of(deadband_n), json!({ "runs": [{ "uid": "a" }] }));
            let [scored, learned] =
                [&one, &two].map(|definition| Made { definition, lineage: &lineage });
            is_held_out(Some("test"), &scored, &learned)
        };
        assert!(held_out(true, 5.0) && !held_out(true, 2.0));
        assert!(held_out(false, 5.0) && held_out(false, 2.0));
    }
}
