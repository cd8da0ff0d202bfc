//! The schema of an experiment file. It follows from the fields; that of lists is in `list_schema`.
//! PURE. Uses: utoipa, `experiment`. Never: a limit that the parser does not enforce.

use super::experiment::Experiment;
use serde_json::{Value, json};
use utoipa::PartialSchema;

/// JSON schema of an experiment file (draft 2020-12), whose tables are objects with properties.
///
/// # Errors
/// Those of serde_json; none are known for a schema.
pub fn of_experiments() -> Result<Value, serde_json::Error> {
    let mut schema = serde_json::to_value(Experiment::schema())?;
    for table in schema["properties"].as_object_mut().into_iter().flat_map(|of| of.values_mut()) {
        // utoipa writes a table with its own description as a pair: the type, and the description.
        let Some(Value::Array(parts)) = table.get_mut("allOf").map(Value::take) else { continue };
        *table = json!({});
        for part in parts.into_iter().filter_map(|part| part.as_object().cloned()) {
            table.as_object_mut().into_iter().for_each(|table| table.extend(part.clone()));
        }
        for value in table["properties"].as_object_mut().into_iter().flat_map(|of| of.values_mut())
        {
            // TOML has no null: a key that may be absent has its type, and no default.
            if value["default"].is_null() {
                value.as_object_mut().and_then(|value| value.remove("default"));
            }
            if let Some(Value::Array(types)) = value.get("type") {
                value["type"] = types[0].clone();
            }
        }
    }
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema".into();
    Ok(schema)
}
