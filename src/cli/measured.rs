//! `palpate rig samples` and `rig untouched`: what the service measured last.
//! Uses: `client`, `table`. Never: a request to the rig.

use jiff::Timestamp;
use serde_json::Value;

use super::client::Client;
use super::error::CliResult;
use super::morning::second;
use super::output::{Output, counted, grouped, say, say_json};
use super::table::Table;
use crate::api::SamplesOut;
use crate::record::{ARMS, Untouched};

/// Prints the ranges of the samples of the last minutes; as JSON the samples.
///
/// # Errors
/// As [`Client::send`].
pub async fn samples(client: &Client, minutes: u8, output: Output) -> CliResult<()> {
    let samples: SamplesOut = client.get(&format!("/api/v1/rig/samples?minutes={minutes}")).await?;
    if output == Output::Json {
        say_json(&samples);
        return Ok(());
    }
    let time = |at_ms: &i64| Timestamp::from_millisecond(*at_ms).map(second).unwrap_or_default();
    if let (Some(first), Some(last)) = (samples.at_ms.first(), samples.at_ms.last()) {
        let count = grouped(samples.at_ms.len() as u64);
        say(format_args!("{count} samples, {} to {}", time(first), time(last)));
    }
    say(ranges(&samples));
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
    let Untouched { voltages_v, at, frames, run } = frame;
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
        };
        let words = untouched_words(&frame);
        assert!(words.contains("mean of 25 frames of 2 channels"), "{words}");
        assert!(words.ends_with("rms 3.536 mV, largest -4.000 mV (channel 1)"), "{words}");
    }
}
