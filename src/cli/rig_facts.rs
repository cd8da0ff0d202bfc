//! `palpate rig limits`, `rates`, `samples` and `untouched`: what the service knows of its rig.
//! Uses: `client`, `table`. Never: a request to the rig, the rig file (the service has read it).

use jiff::Timestamp;
use serde_json::Value;

use super::client::Client;
use super::error::CliResult;
use super::output::{Output, counted, grouped, say, say_json};
use super::table::{Table, or_dash};
use super::times::second;
use crate::api::{RigRates, SamplesOut, StreamRates};
use crate::record::{ARMS, Untouched};

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
    output.say(&limits, limit_table(&limits));
    Ok(())
}

fn limit_table(limits: &Value) -> Table {
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

/// Channels that are named.
const CHANNELS_SHOWN: usize = 4;

/// Channels that are stuck or saturated, as text; `None` if there are none.
pub fn broken_channels(stream: &StreamRates) -> Option<String> {
    let of = |channels: &[usize], what: &str| {
        let first: Vec<String> =
            channels.iter().take(CHANNELS_SHOWN).map(usize::to_string).collect();
        let more = if channels.len() > CHANNELS_SHOWN { ", .." } else { "" };
        let words = format!("{} {what} ({}{more})", channels.len(), first.join(", "));
        (!channels.is_empty()).then_some(words)
    };
    let parts = [of(&stream.stuck, "stuck"), of(&stream.saturated, "saturated")];
    let parts: Vec<String> = parts.into_iter().flatten().collect();
    (!parts.is_empty()).then(|| parts.join(", "))
}

/// Prints the rates of the last minute; as JSON the answer of the service.
///
/// # Errors
/// As [`Client::send`].
pub async fn rates(client: &Client, output: Output) -> CliResult<()> {
    const PATH: &str = "/api/v1/rig/rates";
    if output == Output::Json {
        say_json(&client.get::<Value>(PATH).await?);
        return Ok(());
    }
    let rates: RigRates = client.get(PATH).await?;
    let RigRates { over_s, stream, .. } = &rates;
    say(format_args!(
        "the last {over_s:.0} s: {} frames/s, {} missed, {} packets garbled",
        or_dash(stream.frames_per_s.map(|rate| format!("{rate:.1}"))),
        stream.missed,
        stream.garbled
    ));
    if let Some(words) = broken_channels(stream) {
        say(format_args!("channels: {words}"));
    }
    say(wire_table(&rates));
    Ok(())
}

fn wire_table(rates: &RigRates) -> Table {
    let mut table = Table::new(
        "wire | requests/min> | retries> | timeouts> | garbled> | reopened>",
        "no wire is open",
    );
    for wire in &rates.wires {
        table.push([
            wire.name.clone(),
            or_dash(wire.requests_per_min.map(|rate| format!("{rate:.0}"))),
            wire.retries.to_string(),
            wire.timeouts.to_string(),
            wire.garbled.to_string(),
            wire.reconnects.to_string(),
        ]);
    }
    table
}

/// Prints the ranges of the samples of the last minutes; as JSON the samples.
///
/// # Errors
/// As [`Client::send`].
pub async fn samples(client: &Client, minutes: u8, output: Output) -> CliResult<()> {
    let samples: SamplesOut = client.get(&format!("/api/v1/rig/samples?minutes={minutes}")).await?;
    let time = |at_ms: &i64| Timestamp::from_millisecond(*at_ms).map(second).unwrap_or_default();
    let mut words = ranges(&samples).to_string();
    if let (Some(first), Some(last)) = (samples.at_ms.first(), samples.at_ms.last()) {
        let count = grouped(samples.at_ms.len() as u64);
        words = format!("{count} samples, {} to {}\n{words}", time(first), time(last));
    }
    output.say(&samples, words);
    Ok(())
}

fn ranges(samples: &SamplesOut) -> Table {
    let mut table = Table::new(
        " | smallest> | largest> | newest>",
        "there are no samples: no wire is open, or no cell is read",
    );
    let mut row = |name: String, values: &mut dyn Iterator<Item = f64>| {
        let Some(first) = values.next() else { return };
        let of = |[low, high, _]: [f64; 3], v: f64| [low.min(v), high.max(v), v];
        let [low, high, last] = values.fold([first; 3], of);
        table.push([name, format!("{low:.3}"), format!("{high:.3}"), format!("{last:.3}")]);
    };
    for arm in 0..ARMS {
        let mut forces_n = samples.forces_n.iter().filter_map(|forces_n| forces_n[arm]);
        row(format!("arm {}, N", arm + 1), &mut forces_n);
    }
    row("z, mm".into(), &mut samples.z_mm.iter().copied().flatten());
    table
}

/// Prints when the frame of the untouched skin was measured, and its size; as JSON the frame.
///
/// # Errors
/// As [`Client::send`]; 404 if no frame of the untouched skin is known.
pub async fn untouched(client: &Client, output: Output) -> CliResult<()> {
    let path = "/api/v1/frames/untouched";
    match output {
        Output::Json => say_json(&client.get::<Value>(path).await?),
        Output::Text => say(untouched_words(&client.get(path).await?)),
    }
    Ok(())
}

fn untouched_words(frame: &Untouched) -> String {
    let Untouched { voltages_v, at, frames, run, .. } = frame;
    let voltages_v: Vec<f64> = voltages_v.iter().copied().map(f64::from).collect();
    let channels = voltages_v.len();
    let run = run.map_or_else(String::new, |run| format!(", run {run}"));
    let rms_v = (voltages_v.iter().map(|v| v * v).sum::<f64>() / channels.max(1) as f64).sqrt();
    let largest = voltages_v.iter().enumerate().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    let (channel, largest_v) = largest.map_or((0, 0.0), |(channel, v)| (channel, *v));
    let frames = counted(*frames as u64, "frame", "frames");
    format!(
        "untouched skin, {}{run}: mean of {frames} of {channels} channels\n  rms {:.3} mV, largest \
         {:.3} mV (channel {channel})",
        second(*at),
        1e3 * rms_v,
        1e3 * largest_v,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::api::WireRates;
    use serde_json::json;

    #[test]
    fn a_skin_alone_has_one_limit_and_a_range_has_both_ends() {
        let skin = limit_table(&json!({ "frame_age_ms": 1000, "bench": null })).to_string();
        assert_eq!(skin.lines().count(), 2, "{skin}");
        let bench = json!({ "force_n": 85.0, "z_mm": [0.0, 120.5] });
        let bench = limit_table(&json!({ "frame_age_ms": 1000, "bench": bench })).to_string();
        assert!(bench.contains("z, positive downward"), "{bench}");
        assert!(bench.contains("0.0 to 120.5"), "{bench}");
        assert_eq!(bench.lines().count(), 4, "{bench}");
    }

    #[test]
    fn a_rate_that_is_not_known_yet_is_a_dash() {
        let wire = WireRates { name: "cells".into(), timeouts: 3, ..WireRates::default() };
        let rates = RigRates { wires: vec![wire], ..RigRates::default() };
        let shown = wire_table(&rates).to_string();
        let cells: Vec<&str> = shown.lines().nth(1).unwrap().split_whitespace().collect();
        assert_eq!(cells, ["cells", "-", "0", "3", "0", "0"]);
        assert_eq!(broken_channels(&rates.stream), None);
        let stuck = StreamRates { stuck: (7..12).collect(), ..StreamRates::default() };
        assert_eq!(broken_channels(&stuck).unwrap(), "5 stuck (7, 8, 9, 10, ..)");
    }

    #[test]
    fn ranges_are_of_the_values_that_were_measured() {
        let mut forces_n = vec![[None; ARMS]; 3];
        for (forces_n, newton) in forces_n.iter_mut().zip([2.0, -1.0, 0.5]) {
            forces_n[1] = Some(newton);
        }
        let samples = SamplesOut { at_ms: vec![0, 1, 2], z_mm: vec![None; 3], forces_n };
        let table = ranges(&samples).to_string();
        let cells = table.lines().nth(1).unwrap().split_whitespace().collect::<Vec<_>>();
        assert_eq!(table.lines().count(), 2);
        assert_eq!(cells, ["arm", "2,", "N", "-1.000", "2.000", "0.500"]);
        let none = SamplesOut::default();
        assert!(ranges(&none).to_string().starts_with("there are no samples"));
    }

    #[test]
    fn an_untouched_frame_is_summarised() {
        let frame = Untouched {
            voltages_v: vec![0.003, -0.004],
            at: Timestamp::UNIX_EPOCH,
            frames: 25,
            run: None,
            stream_since: None,
        };
        let words = untouched_words(&frame);
        assert!(words.contains("mean of 25 frames of 2 channels"), "{words}");
        assert!(words.ends_with("rms 3.536 mV, largest -4.000 mV (channel 1)"), "{words}");
    }
}
