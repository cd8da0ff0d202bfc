//! What rigs must have in common in one table: sensor, columns and definition; and where two of them differ.
//! PURE. Uses: sim-core's sensor file, `dataset::schema`. Never: the name of a sensor or of a run as a difference.

use std::collections::BTreeSet;

use arrow_schema::Schema;
use serde_json::{Map, Value};
use sim_core::sensor::Sensor;

use crate::dataset::schema::type_words;

/// Keys of a definition that name the rows of one service.
const OF_ONE_SERVICE: [&str; 4] = ["name", "runs", "sim_random", "license"];

/// What must be equal, each with its name, in the order in which it is compared.
pub(super) type Facts = [(&'static str, Value); 3];

/// A key with its values of two rigs.
#[derive(Debug, PartialEq)]
pub(super) struct Difference {
    pub key: String,
    pub one: String,
    pub other: String,
}

/// The facts of a dataset: of the text of its sensor file, of its columns, and of its definition.
pub(super) fn facts(sensor: &str, columns: &Schema, definition: &Value) -> Facts {
    let columns = columns.fields().iter();
    let columns: Map<String, Value> =
        columns.map(|field| (field.name().clone(), type_words(field.data_type()).into())).collect();
    [
        ("sensor", sensor_facts(sensor)),
        ("columns", columns.into()),
        ("definition", definition_facts(definition)),
    ]
}

fn sensor_facts(text: &str) -> Value {
    let mut facts: Value = match Sensor::from_toml(text) {
        Ok(sensor) => {
            let mut facts = serde_json::to_value(&sensor.file).unwrap_or_default();
            facts["channels"] = sensor.channels().into();
            facts
        }
        // The basic values of another skin.
        Err(_) => toml::from_str(text).unwrap_or_default(),
    };
    if let Some(keys) = facts.as_object_mut() {
        keys.remove("name");
    }
    facts
}

fn definition_facts(definition: &Value) -> Value {
    let mut facts = definition.clone();
    if let Some(keys) = facts.as_object_mut() {
        OF_ONE_SERVICE.iter().for_each(|key| drop(keys.remove(*key)));
    }
    if let Some(split) = facts.get_mut("split").and_then(Value::as_object_mut) {
        split.remove("test_runs");
    }
    facts
}

/// The first key in which the facts of two rigs differ.
pub(super) fn first_difference(one: &Facts, other: &Facts) -> Option<Difference> {
    one.iter().zip(other).find_map(|((key, one), (_, other))| difference(key, one, other))
}

fn difference(key: &str, one: &Value, other: &Value) -> Option<Difference> {
    match (one, other) {
        (Value::Object(one), Value::Object(other)) => {
            let names: BTreeSet<&String> = one.keys().chain(other.keys()).collect();
            let of = |keys: &Map<String, Value>, name: &str| keys.get(name).cloned();
            names.into_iter().find_map(|name| {
                let (one, other) = (of(one, name), of(other, name));
                let key = format!("{key}.{name}");
                difference(&key, &one.unwrap_or_default(), &other.unwrap_or_default())
            })
        }
        (Value::Array(one), Value::Array(other)) if one.len() == other.len() => {
            let mut pairs = one.iter().zip(other).enumerate();
            pairs.find_map(|(at, (one, other))| difference(&format!("{key}[{at}]"), one, other))
        }
        (Value::Number(one), Value::Number(other)) if one.as_f64() == other.as_f64() => None,
        _ if one == other => None,
        _ => Some(Difference { key: key.to_owned(), one: shown(one), other: shown(other) }),
    }
}

fn shown(value: &Value) -> String {
    match value {
        Value::Null => "absent".to_owned(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use arrow_schema::{DataType, Field};
    use serde_json::json;

    use super::*;

    const OWN: &str = include_str!("../../../../experiments/sensors/ert-28.toml");

    fn of(sensor: &str, column: DataType, definition: Value) -> Facts {
        facts(sensor, &Schema::new(vec![Field::new("tips", column, true)]), &definition)
    }

    fn key(one: &Facts, other: &Facts) -> Option<String> {
        let found = first_difference(one, other)?;
        Some(format!("{} = {} and {}", found.key, found.one, found.other))
    }

    #[test]
    fn a_sensor_is_compared_by_everything_but_its_name() {
        let plain = |sensor: &str| of(sensor, DataType::UInt8, json!({}));
        let renamed = OWN.replace("name = \"ert-28\"", "name = \"ert-28-b\"");
        assert!(renamed != OWN);
        assert_eq!(key(&plain(OWN), &plain(&renamed)), None);
        let taller = OWN.replace("height_mm = 560.0", "height_mm = 570.0");
        let found = key(&plain(OWN), &plain(&taller)).unwrap();
        assert_eq!(found, "sensor.height_mm = 560.0 and 570.0");
        let pad = "name = \"pad\"\nchannels = 208\nwidth_mm = 100\nheight_mm = 100.0\n";
        let found = key(&plain(OWN), &plain(pad)).unwrap();
        assert_eq!(found, "sensor.channels = 784 and 208");
        let same = pad.replace("100.0", "100").replace("pad", "pad-2");
        assert_eq!(key(&plain(pad), &plain(&same)), None);
        let found = key(&plain(pad), &plain(&format!("{same}tip_diameter_mm = 5\n"))).unwrap();
        assert_eq!(found, "sensor.tip_diameter_mm = absent and 5");
    }

    #[test]
    fn columns_and_definitions_are_compared_without_what_names_runs() {
        let plain = |definition: Value| of(OWN, DataType::UInt8, definition);
        let one = plain(json!({ "name": "x", "runs": ["1"], "where": ["tips=4"],
            "split": { "seed": 1, "test_runs": ["a"] } }));
        let other = plain(json!({ "name": "y", "where": ["tips=4"], "split": { "seed": 1 } }));
        assert_eq!(key(&one, &other), None);
        let other = plain(json!({ "where": ["tips=5"], "split": { "seed": 1 } }));
        assert_eq!(key(&one, &other).unwrap(), "definition.where[0] = tips=4 and tips=5");
        let wide = of(OWN, DataType::UInt32, json!({}));
        assert_eq!(key(&one, &wide).unwrap(), "columns.tips = uint8 and uint32");
    }
}
