//! A plan as it is stored with its run, and how it differs from the plan that this version makes of
//! the same files.
//! PURE. Uses: `plan`. Never: storage; what a difference leads to (`conductor`).

use serde_json::Value;

use super::plan::Plan;

/// Largest number of differences that are written out.
const DIFFERENCES_SHOWN: usize = 3;

impl Plan {
    /// The plan as canonical JSON: the same plan results in the same text. Its sha256 identifies it.
    ///
    /// # Panics
    /// Never: a plan holds only numbers, names and lists.
    pub fn text(&self) -> String {
        serde_json::to_string(self).expect("a plan can be written as JSON")
    }
}

/// Compares the text of a stored plan with that of the plan made now. Returns none if they are equal,
/// and otherwise the first differing places with both values, and the number of all.
///
/// # Errors
/// A text is not JSON.
pub fn difference(stored: &str, now: &str) -> Result<Option<String>, serde_json::Error> {
    if now == stored {
        return Ok(None);
    }
    let (stored, now): (Value, Value) = (serde_json::from_str(stored)?, serde_json::from_str(now)?);
    let mut places = Vec::new();
    compare("", Some(&stored), Some(&now), &mut places);
    let more = match places.len().saturating_sub(DIFFERENCES_SHOWN) {
        0 => String::new(),
        more => format!("; and {more} more"),
    };
    places.truncate(DIFFERENCES_SHOWN);
    Ok((!places.is_empty()).then(|| format!("{}{more}", places.join("; "))))
}

/// Adds each differing value below `at`. A list of another length is one difference.
fn compare(at: &str, stored: Option<&Value>, now: Option<&Value>, places: &mut Vec<String>) {
    match (stored, now) {
        (Some(Value::Object(stored)), Some(Value::Object(now))) => {
            let dot = if at.is_empty() { "" } else { "." };
            for (key, value) in stored {
                compare(&format!("{at}{dot}{key}"), Some(value), now.get(key), places);
            }
            for (key, value) in now.iter().filter(|(key, _)| !stored.contains_key(*key)) {
                compare(&format!("{at}{dot}{key}"), None, Some(value), places);
            }
        }
        (Some(Value::Array(stored)), Some(Value::Array(now))) if stored.len() == now.len() => {
            for (i, (stored, now)) in stored.iter().zip(now).enumerate() {
                compare(&format!("{at}[{i}]"), Some(stored), Some(now), places);
            }
        }
        (Some(Value::Array(stored)), Some(Value::Array(now))) => {
            places.push(format!("{at}: stored {} items, now {}", stored.len(), now.len()));
        }
        (stored, now) if stored == now => {}
        (stored, now) => {
            let shown = |value: Option<&Value>| value.map_or("none".into(), Value::to_string);
            places.push(format!("{at}: stored {}, now {}", shown(stored), shown(now)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schedule::plan::Step;
    use crate::schedule::tests::{hex, planned};

    #[test]
    fn equal_plans_do_not_differ_and_a_difference_names_place_and_values() {
        let plan = planned(&hex(3, "tips = [2]\nconfigurations = 4\n"));
        assert_eq!(difference(&plan.text(), &plan.text()).unwrap(), None);

        let mut other = plan.clone();
        other.policy.retries += 1;
        let (was, is) = (plan.policy.retries, other.policy.retries);
        let words = difference(&plan.text(), &other.text()).unwrap();
        assert_eq!(words, Some(format!("policy.retries: stored {was}, now {is}")));

        let first = other.steps.iter_mut().find_map(|step| match step {
            Step::Configuration(c) => Some(c),
            _ => None,
        });
        first.unwrap().stand.centre_mm = [-1.0, -2.0];
        other.depths_mm.pop();
        let words = difference(&plan.text(), &other.text()).unwrap().unwrap();
        assert!(words.contains("depths_mm: stored 11 items, now 10"), "{words}");
        assert!(words.ends_with("; and 1 more"), "{words}");
    }

    #[test]
    fn an_unreadable_stored_plan_is_an_error() {
        let plan = planned(&hex(3, "tips = [1]\nconfigurations = 1\n"));
        assert!(difference("{", &plan.text()).is_err());
    }
}
