//! What the voltage stream and the wires did in the last minute: changes of their counters, and channels that are stuck.
//! Uses: the campaign's status and newest frame. Never: a request to a device, a counter on the disk.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use axum::Json;
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::App;
use super::live::STUCK_FRAMES;
use crate::campaign::bench::stuck::StuckChannels;
use crate::campaign::shown::status::{StreamStatus, WireStatus};

/// Interval of looking at the newest frame.
const FRAME_LOOK: Duration = Duration::from_millis(100);
/// Looks at frames between two readings of the counters, which are a second apart.
const FRAME_LOOKS: u32 = 10;
/// Time over which changes are stated.
const WINDOW: Duration = Duration::from_secs(60);

/// What the stream and the wires did in the last minute, or since the wires were opened.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RigRates {
    /// Length of the time, wall s; 0 until the counters were read twice.
    pub over_s: f64,
    /// The voltage stream.
    pub stream: StreamRates,
    /// Each wire.
    pub wires: Vec<WireRates>,
}

/// What the voltage stream did.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct StreamRates {
    /// Valid frames per second; null until the counters were read twice.
    pub frames_per_s: Option<f64>,
    /// Number of valid frames.
    pub frames: u64,
    /// Number of missing frames.
    pub missed: u64,
    /// Number of rejected packets.
    pub garbled: u64,
    /// Indices of the channels that returned one count in the last 60 frames that were looked at, ten per second.
    pub stuck: Vec<usize>,
    /// Indices of the channels at the end of the converter's range in the newest frame.
    pub saturated: Vec<usize>,
}

/// What a wire did.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct WireRates {
    /// Name of the wire in the rig file.
    pub name: String,
    /// Requests per minute; null until the counters were read twice.
    pub requests_per_min: Option<f64>,
    /// Number of requests with a valid reply.
    pub requests: u64,
    /// Number of repeated requests.
    pub retries: u64,
    /// Number of replies that did not arrive in time.
    pub timeouts: u64,
    /// Number of invalid replies.
    pub garbled: u64,
    /// Number of times the wire was reopened.
    pub reconnects: u64,
}

/// The counters of the last minute, oldest first.
#[derive(Debug, Default)]
pub struct Counters {
    reads: Mutex<VecDeque<Read>>,
    /// Channels that are stuck, and saturated ones; empty while no frame arrives.
    channels: Mutex<[Vec<usize>; 2]>,
}

/// The counters at a time.
#[derive(Debug, Clone)]
struct Read {
    at: Instant,
    stream: StreamStatus,
    wires: Vec<WireStatus>,
}

impl Read {
    /// Whether no counter of the same wires fell since; a wire that was opened again begins at zero.
    fn continues(&self, earlier: &Self) -> bool {
        let (now, then) = (self.stream, earlier.stream);
        let numbers = |wire: &WireStatus| {
            [wire.requests, wire.retries, wire.timeouts, wire.garbled, wire.reconnects]
        };
        let wire = |(now, then): (&WireStatus, &WireStatus)| {
            now.name == then.name && numbers(now).iter().zip(numbers(then)).all(|(n, t)| *n >= t)
        };
        now.frames >= then.frames
            && now.missed >= then.missed
            && now.garbled >= then.garbled
            && self.wires.len() == earlier.wires.len()
            && self.wires.iter().zip(&earlier.wires).all(wire)
    }
}

impl Counters {
    fn add(&self, read: Read) {
        let mut kept = self.reads.lock();
        if kept.back().is_some_and(|last| !read.continues(last)) {
            kept.clear();
        }
        let now = read.at;
        kept.push_back(read);
        while kept.len() > 2 && now.duration_since(kept[1].at) >= WINDOW {
            kept.pop_front();
        }
    }

    /// Number of channels that are stuck or saturated.
    pub(super) fn broken_channels(&self) -> usize {
        self.channels.lock().iter().map(Vec::len).sum()
    }

    fn rates(&self) -> RigRates {
        let [stuck, saturated] = self.channels.lock().clone();
        let kept = self.reads.lock();
        let (Some(first), Some(last)) = (kept.front(), kept.back()) else {
            return RigRates::default();
        };
        let over_s = last.at.duration_since(first.at).as_secs_f64();
        let rate = |count: u64, per_s: f64| (over_s > 0.0).then(|| count as f64 / over_s * per_s);
        let (now, then) = (last.stream, first.stream);
        let frames = now.frames - then.frames;
        let wire = |(now, then): (&WireStatus, &WireStatus)| {
            let requests = now.requests - then.requests;
            WireRates {
                name: now.name.clone(),
                requests_per_min: rate(requests, 60.0),
                requests,
                retries: now.retries - then.retries,
                timeouts: now.timeouts - then.timeouts,
                garbled: now.garbled - then.garbled,
                reconnects: now.reconnects - then.reconnects,
            }
        };
        RigRates {
            over_s,
            stream: StreamRates {
                frames_per_s: rate(frames, 1.0),
                frames,
                missed: now.missed - then.missed,
                garbled: now.garbled - then.garbled,
                stuck,
                saturated,
            },
            wires: last.wires.iter().zip(&first.wires).map(wire).collect(),
        }
    }
}

/// Returns what the voltage stream and the wires did in the last minute.
#[utoipa::path(get, operation_id = "rig_rates", path = "/api/v1/rig/rates", tag = "rig",
    responses((status = 200, body = RigRates)))]
pub async fn rates(app: App) -> Json<RigRates> {
    Json(app.facts.memory.counters.rates())
}

/// Reads the counters and looks at frames until the service ends.
pub async fn keep(app: App) {
    let mut frames = app.campaign.watch_frames();
    let mut channels = StuckChannels::default();
    loop {
        let mut newest = None;
        for _ in 0..FRAME_LOOKS {
            tokio::time::sleep(FRAME_LOOK).await;
            if frames.has_changed().unwrap_or(false) {
                let frame = frames.borrow_and_update().clone();
                if let Some(frame) = &frame {
                    channels.push(&frame.counts);
                }
                newest = frame.or(newest);
            }
        }
        let found = match &newest {
            Some(frame) => [channels.unchanged_in(STUCK_FRAMES), frame.saturated().collect()],
            None => {
                channels = StuckChannels::default();
                [Vec::new(), Vec::new()]
            }
        };
        *app.facts.memory.counters.channels.lock() = found;
        let rig = app.campaign.status().rig;
        let read = Read { at: Instant::now(), stream: rig.stream, wires: rig.wires };
        app.facts.memory.counters.add(read);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_those_of_the_last_minute_and_begin_again_with_a_wire_that_was_opened() {
        let (counters, start) = (Counters::default(), Instant::now());
        assert_eq!(counters.rates().over_s, 0.0);
        let add = |s: u64, frames: u64, requests: u64| {
            let wire = WireStatus { name: "cells".into(), requests, ..WireStatus::default() };
            let stream = StreamStatus { frames, ..StreamStatus::default() };
            counters.add(Read { at: start + Duration::from_secs(s), stream, wires: vec![wire] });
        };
        add(0, 0, 0);
        assert_eq!(counters.rates().stream.frames_per_s, None);
        for s in 1..=90 {
            add(s, 30 * s, 2 * s);
        }
        let rates = counters.rates();
        assert_eq!((rates.over_s, rates.stream.frames), (60.0, 1800));
        assert_eq!(rates.stream.frames_per_s, Some(30.0));
        assert_eq!(rates.wires[0].requests_per_min, Some(120.0));
        add(91, 0, 0);
        assert_eq!((counters.rates().over_s, counters.rates().stream.frames), (0.0, 0));
    }
}
