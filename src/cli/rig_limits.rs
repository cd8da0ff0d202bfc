//! `palpate rig limits`: what trips the rig, and how far its axes may move.
//! Uses: `client`, `table`. Never: the rig file (the service has read it).

use serde_json::Value;

use super::client::Client;
use super::error::CliResult;
use super::output::Output;
use super::table::Table;

/// Limits of a bench: key of the answer, words, unit.
const BENCH_LIMITS: [(&str, &str, &str); 12] = [
    ("force_n", "force on one cell", "N"),
    ("force_sum_n", "sum of forces", "N"),
    ("force_margin_n", "increase of a force until a stop", "N"),
    ("force_sum_margin_n", "increase of the sum until a stop", "N"),
    ("tare_drift_n", "drift of a tare", "N"),
    ("sample_age_ms", "age of a sample", "ms"),
    ("x_mm", "x", "mm"),
    ("y_mm", "y", "mm"),
    ("z_mm", "z, positive downward", "mm"),
    ("radius_mm", "radius", "mm"),
    ("surface_z_mm", "z of the surface", "mm"),
    ("clearance_mm", "clearance in lateral motion", "mm"),
];

/// Prints the limits of the rig; as JSON the answer of the service.
///
/// # Errors
/// As [`Client::send`].
pub async fn limits(client: &Client, output: Output) -> CliResult<()> {
    let limits: Value = client.get("/api/v1/rig/limits").await?;
    output.say(&limits, table(&limits));
    Ok(())
}

fn table(limits: &Value) -> Table {
    let mut table = Table::new("limit | value> | unit", "the service states no limits");
    table.push(["age of a frame".into(), shown(&limits["frame_age_ms"]), "ms".into()]);
    // A skin alone has no bench.
    for (key, words, unit) in BENCH_LIMITS {
        let value = &limits["bench"][key];
        if !value.is_null() {
            table.push([words.into(), shown(value), unit.into()]);
        }
    }
    table
}

/// A number, or both ends of a range.
fn shown(value: &Value) -> String {
    match value.as_array() {
        Some(ends) => ends.iter().map(Value::to_string).collect::<Vec<_>>().join(" to "),
        None => value.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_skin_alone_has_one_limit_and_a_range_has_both_ends() {
        let skin = table(&json!({ "frame_age_ms": 1000, "bench": null })).to_string();
        assert_eq!(skin.lines().count(), 2, "{skin}");
        let bench = json!({ "force_n": 85.0, "z_mm": [0.0, 120.5] });
        let bench = table(&json!({ "frame_age_ms": 1000, "bench": bench })).to_string();
        assert!(bench.contains("z, positive downward"), "{bench}");
        assert!(bench.contains("0.0 to 120.5"), "{bench}");
        assert_eq!(bench.lines().count(), 4, "{bench}");
    }
}
