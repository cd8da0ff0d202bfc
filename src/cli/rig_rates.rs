//! `palpate rig rates`: what the voltage stream and the wires did in the last minute.
//! Uses: `client`, `table`. Never: a request to the rig.

use serde_json::Value;

use super::client::Client;
use super::error::CliResult;
use super::output::{Output, say, say_json};
use super::table::{Table, or_dash};
use crate::api::{RigRates, StreamRates};

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
    say(table(&rates));
    Ok(())
}

fn table(rates: &RigRates) -> Table {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::api::WireRates;

    #[test]
    fn a_rate_that_is_not_known_yet_is_a_dash() {
        let wire = WireRates { name: "cells".into(), timeouts: 3, ..WireRates::default() };
        let rates = RigRates { wires: vec![wire], ..RigRates::default() };
        let shown = table(&rates).to_string();
        let cells: Vec<&str> = shown.lines().nth(1).unwrap().split_whitespace().collect();
        assert_eq!(cells, ["cells", "-", "0", "3", "0", "0"]);
        assert_eq!(broken_channels(&rates.stream), None);
        let stuck = StreamRates { stuck: (7..12).collect(), ..StreamRates::default() };
        assert_eq!(broken_channels(&stuck).unwrap(), "5 stuck (7, 8, 9, 10, ..)");
    }
}
