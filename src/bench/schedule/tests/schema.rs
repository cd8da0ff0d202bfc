//! The schema of an experiment file equals what the parser accepts: keys, limits, defaults.

use crate::problem::Problem;
use crate::schedule::experiment::Experiment;
use crate::schedule::schema::of_experiments;
use serde_json::Value;

const START: &str = "name = \"test\"\nseed = 1\nsensor = \"sensors/ert-28.toml\"\n";
const HEX: &str = "[real_hex]\ntips = [1]\nconfigurations = 3\n";
const RANDOM: &str = "[real_random]\ncontacts = [2]\ntrials_each = 1\nweights_n = [5.0]\n";

fn schema() -> Value {
    of_experiments().unwrap()
}

fn keys(object: &Value) -> Vec<&str> {
    let mut keys: Vec<&str> =
        object["properties"].as_object().unwrap().keys().map(String::as_str).collect();
    keys.sort_unstable();
    keys
}

/// The tables of an experiment, with their schemas; the first is the file itself.
fn tables(schema: &Value) -> Vec<(&str, &Value)> {
    let properties = schema["properties"].as_object().unwrap();
    let tables = properties.iter().filter(|(_, of)| of.get("properties").is_some());
    std::iter::once(("", schema)).chain(tables.map(|(name, of)| (name.as_str(), of))).collect()
}

/// A sound experiment that has the table, with keys of it set to values; `name = value` otherwise.
fn with(table: &str, changes: &[(&str, toml::Value)]) -> Vec<Problem> {
    let kind = if table == "real_random" { RANDOM } else { HEX };
    let mut file: toml::Table = toml::from_str(&format!("{START}{kind}")).unwrap();
    let of = match table {
        "" => &mut file,
        table => {
            let empty = toml::Value::Table(toml::Table::new());
            file.entry(table).or_insert(empty).as_table_mut().unwrap()
        }
    };
    for (key, value) in changes {
        of.insert((*key).into(), value.clone());
    }
    Experiment::from_toml("test.toml", &file.to_string()).err().unwrap_or_default()
}

fn dotted(table: &str, key: &str) -> String {
    if table.is_empty() { key.into() } else { format!("{table}.{key}") }
}

fn is_refused(table: &str, key: &str, value: impl Into<toml::Value>) -> bool {
    let mut changes = vec![(key, value.into())];
    if key == "settle_max_ms" {
        changes.push(("settle_ms", 0.0.into()));
    }
    with(table, &changes).iter().any(|problem| problem.key == dotted(table, key))
}

#[test]
fn the_schema_has_the_keys_that_the_parser_accepts() {
    let schema = schema();
    let tables = tables(&schema);
    assert_eq!(tables.len(), 7);
    for (table, of) in tables {
        let header = if table.is_empty() { String::new() } else { format!("[{table}]\n") };
        let refused =
            Experiment::from_toml("test.toml", &format!("{header}zzz = 0\n")).unwrap_err();
        let words = &refused[0].limit;
        let named = words.split("the keys here are ").nth(1).expect(words);
        let mut accepted: Vec<&str> = named.split(", ").collect();
        accepted.sort_unstable();
        assert_eq!(keys(of), accepted, "{table}");
        assert_eq!(of["additionalProperties"], false, "{table}");
        for (key, property) in of["properties"].as_object().unwrap() {
            let text = property["description"].as_str();
            assert!(text.is_some_and(|text| text.ends_with('.')), "{table}.{key}: {property}");
        }
    }
}

#[test]
fn the_schema_has_the_limits_that_the_parser_enforces() {
    let schema = schema();
    let mut compared = 0;
    for (table, of) in tables(&schema) {
        for (key, property) in of["properties"].as_object().unwrap() {
            let whole = property["type"] == "integer";
            let number = |value: f64| match whole {
                true => toml::Value::Integer(value as i64),
                false => toml::Value::Float(value),
            };
            let step = if whole { 1.0 } else { 0.001 };
            for (limit, outwards) in [("minimum", -step), ("maximum", step)] {
                let Some(bound) = property[limit].as_f64() else {
                    continue;
                };
                compared += 1;
                let (inside, beyond) = (number(bound), number(bound + outwards));
                assert!(!is_refused(table, key, inside), "{table}.{key}: {limit} {bound}");
                assert!(is_refused(table, key, beyond), "{table}.{key}: beyond {limit} {bound}");
            }
        }
    }
    assert!(compared > 40, "{compared}");
    for (length, refused) in [(200, false), (201, true)] {
        assert_eq!(is_refused("", "name", "x".repeat(length)), refused);
    }
    assert_eq!(schema["properties"]["name"]["maxLength"], 200);
}

#[test]
fn lists_have_the_limits_of_their_schema() {
    let whole = |list: &[i64]| toml::Value::from(list.to_vec());
    for (table, key) in [("real_hex", "tips"), ("real_random", "contacts")] {
        assert!(!is_refused(table, key, whole(&[6, 1, 2, 3, 4, 5])));
        for list in [&[][..], &[0], &[7], &[1, 1]] {
            assert!(is_refused(table, key, whole(list)), "{key} {list:?}");
        }
    }
    assert!(!is_refused("real_hex", "radius_pitches", whole(&[2, 15])));
    for list in [&[1, 3][..], &[2, 16], &[3, 2], &[2], &[2, 3, 4]] {
        assert!(is_refused("real_hex", "radius_pitches", whole(list)), "{list:?}");
    }
    for list in [vec![], vec![0.0], vec![5.0, -1.0]] {
        assert!(is_refused("real_random", "weights_n", list.clone()), "{list:?}");
    }
}

#[test]
fn defaults_and_required_keys_are_those_of_the_parser() {
    let schema = schema();
    let mut compared = 0;
    for kind in [HEX, RANDOM] {
        let parsed = Experiment::from_toml("test.toml", &format!("{START}{kind}")).unwrap();
        let parsed = serde_json::to_value(&parsed).unwrap();
        for (table, of) in tables(&schema) {
            let values = if table.is_empty() { &parsed } else { &parsed[table] };
            let Some(values) = values.as_object() else { continue };
            let required = of["required"].as_array().cloned().unwrap_or_default();
            for (key, property) in of["properties"].as_object().unwrap() {
                let given = format!("{START}{kind}").contains(&format!("{key} = "));
                assert_eq!(required.contains(&key.as_str().into()), given, "{table}.{key}");
                let default = &property["default"];
                if default.is_null() || given {
                    continue;
                }
                compared += 1;
                let number = || default.is_number() && default.as_f64() == values[key].as_f64();
                let same = default == &values[key] || number();
                assert!(same, "{table}.{key}: {default}, {}", values[key]);
            }
        }
    }
    assert!(compared > 40, "{compared}");
}

#[test]
fn the_number_of_trials_is_that_of_the_plan() {
    for (name, text) in crate::carried::EXPERIMENTS {
        let experiment = Experiment::from_toml(name, text).unwrap();
        assert_eq!(experiment.trials(), super::planned(&experiment).trials(), "{name}");
    }
}
