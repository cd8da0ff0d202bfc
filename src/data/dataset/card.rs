//! The card of a dataset in Markdown: content, units, quality, origin and citation.
//! PURE. Uses: `store`'s row of a dataset. Never: a number that is not in the row.

use std::fmt::Write;

use serde_json::Value;

use crate::store::DatasetRow;

/// Title of the paper whose datasets these follow.
const PAPER: &str = "Predicting the Force Map of an ERT-Based Tactile Sensor Using Simulation and \
                     Deep Networks (Table II)";

/// Returns the card as Markdown.
pub fn text(row: &DatasetRow) -> String {
    let mut card = String::new();
    // Writing to a string does not fail.
    let _ = write(&mut card, row);
    card
}

fn write(card: &mut String, row: &DatasetRow) -> std::fmt::Result {
    let (report, lineage) = (&row.report, &row.lineage);
    writeln!(card, "# {} ({})\n", row.name, row.id)?;
    writeln!(card, "{} rows, made at {} by Palpate {}.", row.rows, row.created_at, code(lineage))?;
    let runs = || lineage["runs"].as_array().into_iter().flatten();
    if runs().any(|run| run["label"] == "virtual") {
        writeln!(card, "\n**Virtual**: measured on a virtual rig. No skin was touched.")?;
    }
    writeln!(card, "\n## Content\n")?;
    writeln!(card, "Task: {}.", words(&report["task"]))?;
    counts(card, "Parts", &report["parts"])?;
    counts(card, "Rows by number of contacts", &report["contact_counts"])?;
    writeln!(card, "\n## Quality\n")?;
    writeln!(
        card,
        "Flags and counts of saturated, stuck and missing channels, injection sums, dropped \
         packets, depth error, settling and overshoot are columns. A quality that was not checked \
         is null."
    )?;
    match report["left_out"].as_object().filter(|reasons| !reasons.is_empty()) {
        Some(_) => counts(card, "Excluded", &report["left_out"])?,
        None => writeln!(card, "\nNo row was excluded.")?,
    }
    writeln!(card, "\n## Origin\n")?;
    for run in runs() {
        // Placed weights are contacts, whatever their force.
        let contacts = match run["kind"] == "real-random" {
            true => "placed contacts".to_owned(),
            false => format!("contacts from {} N", run["deadband_n"]),
        };
        writeln!(
            card,
            "- run {} `{}` {} ({}), {} to {}: {} trials, {contacts}",
            run["scan_id"],
            words(&run["uid"]),
            words(&run["experiment"]),
            words(&run["label"]),
            words(&run["started_at"]),
            words(&run["ended_at"]),
            run["trials"],
        )?;
    }
    for model in lineage["models"].as_array().into_iter().flatten() {
        let calibration = match &model["calibration"] {
            Value::Null => "not calibrated".to_owned(),
            id => format!("calibration {}", words(id)),
        };
        writeln!(card, "- simulated with {} ({calibration})", words(&model["model"]))?;
    }
    for folder in lineage["sim_random"].as_array().into_iter().flatten() {
        let shards = folder["shards"].as_array().map_or(0, Vec::len);
        writeln!(
            card,
            "- Sim-Random {}: {shards} shards, seed {}, {}",
            words(&folder["folder"]),
            folder["definition"]["draws"]["seed"],
            words(&folder["definition"]["model"]),
        )?;
    }
    writeln!(card, "\n## Columns\n\n| column | type | unit |\n|---|---|---|")?;
    for column in report["columns"].as_array().into_iter().flatten() {
        writeln!(
            card,
            "| {} | {} | {} |",
            words(&column["name"]),
            words(&column["type"]),
            words(&column["unit"])
        )?;
    }
    writeln!(
        card,
        "\nA frame is injection-major: `v[28 k + j] = V_j - V_(j+1 mod 28)` while electrode k is \
         the sink, V after gain. Contacts are in skin coordinates, mm from the skin's corner."
    )?;
    let license = row.definition["license"].as_str();
    writeln!(card, "\n## Licence\n\n{}.", license.unwrap_or("Not stated in its definition"))?;
    writeln!(card, "\n## Citation\n\n{}", citation(row))
}

/// How to cite a dataset, one line.
pub fn citation(row: &DatasetRow) -> String {
    let (name, id, code) = (&row.name, &row.id, code(&row.lineage));
    let year = row.created_at.strftime("%Y");
    format!("Dataset {name} ({id}, {} rows), Palpate {code}, {year}. After: {PAPER}.", row.rows)
}

fn code(lineage: &Value) -> String {
    let code = &lineage["code"];
    match code["git_commit"].as_str() {
        Some(commit) => format!("{} ({commit})", words(&code["version"])),
        None => words(&code["version"]),
    }
}

fn words(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Null => String::new(),
        other => other.to_string(),
    }
}

fn counts(card: &mut String, heading: &str, counts: &Value) -> std::fmt::Result {
    let Some(counts) = counts.as_object().filter(|counts| !counts.is_empty()) else {
        return Ok(());
    };
    writeln!(card, "\n| {heading} | rows |\n|---|---|")?;
    for (what, rows) in counts {
        writeln!(card, "| {what} | {rows} |")?;
    }
    Ok(())
}

#[cfg(test)]
pub(super) mod tests {
    use jiff::Timestamp;
    use serde_json::json;

    use super::*;
    use crate::ids::DatasetId;

    /// A dataset `real` of three rows.
    pub(in super::super) fn row(definition: Value, report: Value, lineage: Value) -> DatasetRow {
        let (id, name, sha256) = (DatasetId::unchecked("ds-1"), "real".into(), "ab".into());
        let (rows, bytes, created_at) = (3, 9, Timestamp::UNIX_EPOCH);
        DatasetRow { id, name, definition, rows, bytes, sha256, report, lineage, created_at }
    }

    #[test]
    fn placed_weights_are_contacts_whatever_their_force() {
        let run = |kind: &str| json!({ "kind": kind, "trials": 3, "deadband_n": 5.0 });
        let lineage = json!({ "runs": [run("real-hex"), run("real-random")] });
        let card = text(&row(json!({}), json!({}), lineage));
        assert!(card.contains(": 3 trials, contacts from 5.0 N\n"), "{card}");
        assert!(card.contains(": 3 trials, placed contacts\n"), "{card}");
    }
}
