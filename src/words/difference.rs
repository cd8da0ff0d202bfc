//! The first difference of two JSON values, by which another definition is refused.
//! PURE. Uses: serde_json. Never: what the values mean.

use std::collections::BTreeSet;

use serde_json::Value;

/// First difference of two JSON values.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// Dotted key.
    pub field: String,
    /// Value of the first one; `nothing` if absent.
    pub there: String,
    /// Value of the other one.
    pub here: String,
}

/// The first leaf at which two values differ, by key in alphabetical order.
pub fn first_difference(there: &Value, here: &Value) -> Option<Difference> {
    walk("", there, here)
}

fn walk(path: &str, there: &Value, here: &Value) -> Option<Difference> {
    if there == here {
        return None;
    }
    if let (Value::Object(a), Value::Object(b)) = (there, here) {
        let keys: BTreeSet<&String> = a.keys().chain(b.keys()).collect();
        return keys.into_iter().find_map(|key| {
            let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
            walk(&path, &there[key], &here[key])
        });
    }
    let shown = |value: &Value| match value {
        Value::Null => "nothing".to_owned(),
        value => value.to_string(),
    };
    Some(Difference { field: path.into(), there: shown(there), here: shown(here) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_field_that_differs_is_named() {
        let there = json!({ "draws": { "seed": 1, "contacts": [1, 6] }, "kernel": "f64" });
        assert_eq!(first_difference(&there, &there), None);
        let mut here = there.clone();
        here["draws"]["seed"] = json!(2);
        let found = first_difference(&there, &here).unwrap();
        assert_eq!((found.field.as_str(), found.there.as_str()), ("draws.seed", "1"));
        let mut here = there.clone();
        here["calibration"] = json!("cal-1");
        let found = first_difference(&there, &here).unwrap();
        assert_eq!((found.field.as_str(), found.there.as_str()), ("calibration", "nothing"));
        assert_eq!(found.here, "\"cal-1\"");
    }
}
