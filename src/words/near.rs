//! The known name that a mistyped one was probably meant to be.
//! PURE. Uses: strsim. Never: a list of names (the caller has it).

/// Smallest similarity, 0 to 1, at which a name is proposed.
const SIMILAR: f64 = 0.8;

/// Returns the name that is most similar to `typed`, if one is similar enough.
pub fn nearest<'a>(typed: &str, names: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let typed = typed.to_lowercase();
    let scored = names.into_iter().map(|name| (similarity(&typed, name), name));
    let best = scored.max_by(|a, b| a.0.total_cmp(&b.0))?;
    (best.0 >= SIMILAR).then_some(best.1)
}

/// Similarity of two names, 0 to 1; at least [`SIMILAR`] if only two neighbouring letters are swapped, which the
/// measure does not find in names of three letters.
fn similarity(typed: &str, name: &str) -> f64 {
    let similarity = strsim::jaro_winkler(typed, name);
    let is_swap = strsim::osa_distance(typed, name) == 1 && strsim::levenshtein(typed, name) == 2;
    if is_swap { similarity.max(SIMILAR) } else { similarity }
}

/// Returns `; did you mean ..?` for the name that is most similar, or nothing.
pub fn did_you_mean<'a>(typed: &str, names: impl IntoIterator<Item = &'a str>) -> String {
    nearest(typed, names).map_or_else(String::new, |name| format!("; did you mean `{name}`?"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_similar_name_is_proposed() {
        let names = ["tips", "block", "depths", "depth_step_mm"];
        assert_eq!(nearest("blcok", names), Some("block"));
        assert_eq!(nearest("depth", names), Some("depths"));
        assert_eq!(nearest("Depth_Step", names), Some("depth_step_mm"));
        assert_eq!(nearest("colour", names), None);
        assert_eq!(nearest("rgi", ["gap", "rig"]), Some("rig"));
        assert_eq!(nearest("gpr", ["gap", "rig"]), None);
        assert_eq!(nearest("x", []), None);
        assert_eq!(did_you_mean("tip", names), "; did you mean `tips`?");
    }
}
