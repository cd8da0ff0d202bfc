//! The thread of the readout: wakes at the end of a frame, converts held loads to noisy frames,
//! sends packets.
//! Uses: `lab`, `skin`, `ert::packet`, `ert::sinks`. Never: waits for a solve or for a reader. A
//! frame whose load is not solved is dropped; its sequence number is used up.

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::packet::{Amplifier, PacketWriter};
use super::sinks::Sinks;
use crate::bench::TakenFrame;
use crate::fault::{Damage, Kind, WireFault};
use crate::lab::Lab;
use crate::skin::AnyReadout;

/// Shortest sleep: an accelerated rig sends several frames at once.
const TICK_MIN: Duration = Duration::from_micros(500);
/// Longest sleep, so that readers are accepted and a stop is detected.
const TICK_MAX: Duration = Duration::from_millis(50);
/// Process time between two status lines, s.
const STATUS_EVERY_S: f64 = 1.0;

/// The running thread; dropping it ends the thread.
pub struct Stream {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Stream {
    /// Starts the thread.
    ///
    /// # Errors
    /// The operating system's error if the thread cannot be created.
    pub fn start(
        lab: Arc<Lab>,
        readout: AnyReadout,
        sinks: Sinks,
        amplifier: Amplifier,
        seed: u64,
    ) -> io::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let electrodes = usize::from(lab.rig.ert.electrodes);
        let mut reader = Sender {
            stop: Arc::clone(&stop),
            lab,
            readout,
            sinks,
            amplifier,
            writer: PacketWriter::default(),
            voltages: vec![0.0; electrodes * electrodes],
            batch: Vec::new(),
            chance: ChaCha8Rng::seed_from_u64(seed),
            status_due_s: 0.0,
        };
        let thread = thread::Builder::new().name("readout".into()).spawn(move || {
            while !reader.stop.load(Ordering::Relaxed) {
                reader.turn();
            }
        })?;
        Ok(Self { stop, thread: Some(thread) })
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}

struct Sender {
    stop: Arc<AtomicBool>,
    lab: Arc<Lab>,
    readout: AnyReadout,
    sinks: Sinks,
    amplifier: Amplifier,
    writer: PacketWriter,
    voltages: Vec<f32>,
    batch: Vec<u8>,
    chance: ChaCha8Rng,
    status_due_s: f64,
}

impl Sender {
    /// Sleeps until the end of the frame in progress, then sends the frames taken.
    fn turn(&mut self) {
        let end_s = self.lab.bench().frame_end_s();
        let wait = self.lab.clock.wall_until(end_s);
        thread::sleep(wait.clamp(TICK_MIN, TICK_MAX));
        let (frames, faults) = {
            let mut bench = self.lab.bench();
            bench.advance(self.lab.clock.process_s());
            (bench.take_frames(), bench.stream_faults())
        };
        let cut = faults.iter().any(|f| matches!(f, Kind::Wire(WireFault::Disconnect { .. })));
        if cut {
            self.sinks.disconnect();
            self.sinks.reject();
        } else {
            self.sinks.accept();
        }
        let readers = self.sinks.readers();
        self.lab.stream.readers.store(readers as u64, Ordering::Relaxed);
        if readers > 0 && !cut && !faults.contains(&Kind::StallStream) {
            self.fill(frames, &faults);
            if !self.batch.is_empty() {
                self.sinks.send(&self.batch);
            }
        }
    }

    fn fill(&mut self, frames: VecDeque<TakenFrame>, faults: &[Kind]) {
        self.batch.clear();
        let (mut sent, mut unsolved) = (0, 0);
        for frame in frames {
            // A slow machine may have thousands of frames to catch up, which takes seconds.
            if self.stop.load(Ordering::Relaxed) {
                return;
            }
            let Some(held) = self.lab.solver.solved(&frame.load) else {
                self.lab.solver.request(frame.load);
                unsolved += 1;
                continue;
            };
            self.readout.frame(&held, frame.first_sample_s, &mut self.voltages);
            let largest = held.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
            let step = self.amplifier.volts_per_count(largest);
            let time_us = (frame.first_sample_s * 1e6).round() as u64;
            let start = self.batch.len();
            let out = &mut self.batch;
            self.writer.frame(frame.sequence, time_us, step, &self.voltages, out);
            sent += 1;
            self.mangle(start, faults);
            if frame.first_sample_s >= self.status_due_s {
                self.status_due_s = frame.first_sample_s + STATUS_EVERY_S;
                let text = format!("virtual readout, t = {:.1} s", frame.first_sample_s);
                self.writer.status(&text, &mut self.batch);
            }
        }
        self.lab.stream.sent.fetch_add(sent, Ordering::Relaxed);
        self.lab.stream.unsolved.fetch_add(unsolved, Ordering::Relaxed);
    }

    /// Damages the packet that begins at `start` according to the active faults.
    fn mangle(&mut self, start: usize, faults: &[Kind]) {
        for fault in faults {
            let Kind::Bytes { rate, damage } = *fault else { continue };
            if self.chance.random_range(0.0..1.0) >= rate || self.batch.len() <= start {
                continue;
            }
            let at = self.chance.random_range(start..self.batch.len());
            match damage {
                Damage::Drop => {
                    let end = (at + self.chance.random_range(1..8)).min(self.batch.len());
                    self.batch.drain(at..end);
                }
                Damage::Flip => self.batch[at] ^= 1 << self.chance.random_range(0..8),
                Damage::Double => self.batch.insert(at, self.batch[at]),
            }
        }
    }
}
