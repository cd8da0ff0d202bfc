//! The description of a dataset as a Data Package (Frictionless, `datapackage.json`), for catalogues.
//! PURE. Uses: `store`'s row of a dataset, the table of columns. Never: a fact that is not in the row.

use serde_json::{Value, json};

use super::card;
use crate::store::DatasetRow;
use crate::store::table::Column;

/// Profile of the standard, version 2.
const PROFILE: &str = "https://datapackage.org/profiles/2.0/datapackage.json";

/// Returns the Data Package of a dataset; `url` is the address of its Parquet file. The standard allows paths only
/// below the folder of the package: the file is next to it, under the name with which it is downloaded.
pub fn of(row: &DatasetRow, url: &str) -> Value {
    let (report, lineage) = (&row.report, &row.lineage);
    let columns = report["columns"].as_array().into_iter().flatten();
    let fields: Vec<Value> = columns
        .map(|column| {
            let name = column["name"].as_str().unwrap_or_default();
            let kind = column["type"].as_str().unwrap_or_default();
            let about =
                Column::find(name).map_or_else(|| kind.to_owned(), |c| c.about.replace('`', ""));
            let mut field = json!({ "name": name, "type": field_type(kind), "description": about });
            if let Some(unit) = column["unit"].as_str().filter(|unit| !unit.is_empty()) {
                field["unit"] = unit.into();
            }
            field
        })
        .collect();
    let runs = lineage["runs"].as_array().into_iter().flatten();
    let sources: Vec<Value> = runs
        .map(|run| {
            let (number, experiment, label) = (&run["scan_id"], &run["experiment"], &run["label"]);
            let words = |value: &Value| value.as_str().unwrap_or_default().to_owned();
            json!({ "title": format!("run {number}, {} ({})", words(experiment), words(label)) })
        })
        .collect();
    let mut package = json!({
        "$schema": PROFILE,
        "name": row.name,
        "id": row.id,
        "title": format!("{} ({})", row.name, row.id),
        "description": description(row),
        "created": row.created_at,
        "version": row.id,
        "sources": sources,
        "citation": card::citation(row),
        "lineage": lineage,
        "resources": [{
            "name": row.id,
            "path": format!("{}.parquet", row.id),
            "url": url,
            "format": "parquet",
            "mediatype": "application/vnd.apache.parquet",
            "bytes": row.bytes,
            "hash": format!("sha256:{}", row.sha256),
            "schema": { "fields": fields },
        }],
    });
    if let Some(license) = row.definition["license"].as_str() {
        // A name is an identifier; other words are a title, which needs a name too.
        let word = |c: char| c.is_ascii_alphanumeric() || "-._".contains(c);
        package["licenses"] = match license.chars().all(word) {
            true => json!([{ "name": license }]),
            false => json!([{ "name": "notspecified", "title": license }]),
        };
    }
    package
}

/// The type of Table Schema for a type as people read it.
fn field_type(kind: &str) -> &'static str {
    match kind {
        "string" => "string",
        "timestamp, UTC" => "datetime",
        _ if kind.contains(['[', '{']) || kind.starts_with("list") => "array",
        _ if kind.contains("int") => "integer",
        _ if kind.contains("float") => "number",
        _ => "any",
    }
}

/// What a catalogue shows of a dataset: its rows, by part and by number of contacts.
fn description(row: &DatasetRow) -> String {
    let counts = |title: &str, key: &str| {
        let all = row.report[key].as_object().into_iter().flatten();
        let all: Vec<String> = all.map(|(name, rows)| format!("{name} ({rows})")).collect();
        if all.is_empty() { String::new() } else { format!(" {title}: {}.", all.join(", ")) }
    };
    let (parts, contacts) =
        (counts("Parts", "parts"), counts("Rows by number of contacts", "contact_counts"));
    format!("{} rows, made by Palpate.{parts}{contacts}", row.rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::card::tests::row;

    #[test]
    fn fields_have_types_units_and_meanings() {
        let columns = json!([
            { "name": "depth_mm", "type": "float64", "unit": "mm" },
            { "name": "voltages_v", "type": "float32[784]", "unit": "V" },
            { "name": "tips", "type": "uint8", "unit": null },
        ]);
        let report = json!({ "columns": columns, "parts": {}, "contact_counts": { "2": 3 } });
        let lineage =
            json!({ "runs": [{ "scan_id": 4, "experiment": "hex", "label": "virtual" }] });
        let row = row(json!({ "license": "CC-BY-4.0" }), report, lineage);
        let package = of(&row, "/api/v1/data/ds-1.parquet");
        let fields = &package["resources"][0]["schema"]["fields"];
        assert_eq!(fields[0]["type"], "number");
        assert_eq!(fields[0]["unit"], "mm");
        assert!(fields[0]["description"].as_str().unwrap().starts_with("depth below"));
        assert_eq!([&fields[1]["type"], &fields[2]["type"]], ["array", "integer"]);
        assert_eq!(package["sources"][0]["title"], "run 4, hex (virtual)");
        assert_eq!(package["licenses"][0]["name"], "CC-BY-4.0");
        assert!(package["citation"].as_str().unwrap().starts_with("Dataset real (ds-1, 3 rows)"));
        let about = "3 rows, made by Palpate. Rows by number of contacts: 2 (3).";
        assert_eq!(package["description"], about);
        let file = &package["resources"][0];
        assert_eq!([&file["path"], &file["hash"]], ["ds-1.parquet", "sha256:ab"]);
        assert_eq!(file["url"], "/api/v1/data/ds-1.parquet");
    }
}
