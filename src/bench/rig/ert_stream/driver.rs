//! Reader of the voltage stream: its own thread and runtime, so that neither a slow campaign nor a
//! slow browser delays a byte. It publishes the newest frame and feeds the takers.
//! Uses: `codec`, `timing`, `rig::link` (ports), `clock`. Never: waits for a reader of its frames.
//!
//! `timing` decides which frames a trial may use: by their sampling times, not their arrival times.
//! In addition, the first complete packet that a taker receives is dropped.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use async_trait::async_trait;
use jiff::Timestamp;
use parking_lot::Mutex;
use tokio::io::AsyncReadExt;
use tokio::sync::{Notify, broadcast, watch};
use tokio::time::{Instant, timeout, timeout_at};

use super::codec::{Decoder, Event, RawFrame, Tally};
use super::timing::DeviceTiming;
use crate::clock::Clock;
use crate::priority;
use crate::rig::config::{ErtConfig, Parity};
use crate::rig::error::RigError;
use crate::rig::link::{Opener, Port, SerialSettings, serial_opener, tcp_stream_opener};
use crate::rig::traits::{Frame, SkinReader, StreamCounters};

/// Frames by which a taker may lag before it loses some.
const FEED: usize = 256;
/// Bytes read at once: more than a packet, less than a second of packets.
const STREAM_READ_BYTES: usize = 16 * 1024;
/// Bytes that may wait in the kernel: about 40 packets.
const BUFFER_BYTES: u32 = 64 * 1024;
/// First and longest wait before the wire is reopened, wall time.
const REOPEN_WAIT: [Duration; 2] = [Duration::from_millis(50), Duration::from_secs(1)];
/// Longest wait for the wire to open, wall time.
const OPEN_LIMIT: Duration = Duration::from_secs(2);
/// Bits per byte on a serial line.
const BITS_PER_BYTE: f64 = 10.0;

#[derive(Debug)]
struct Shared {
    tally: Mutex<Tally>,
    reconnects: AtomicU64,
    /// Wall time at which the wire was opened last, or its device restarted after that.
    since: Mutex<Option<Timestamp>>,
    timing: Mutex<DeviceTiming>,
    /// Last line of text from the device, and the reason why the wire is down; none if it works.
    status: Mutex<(Option<String>, Option<String>)>,
    stop: Notify,
}

/// Reader of the voltage stream. Dropping it ends its thread.
#[derive(Debug)]
pub struct ErtStream {
    shared: Arc<Shared>,
    newest: watch::Receiver<Option<Arc<Frame>>>,
    feed: broadcast::Sender<Arc<Frame>>,
    frame_age: Duration,
    frame_period: Duration,
    clock: Clock,
    thread: Option<JoinHandle<()>>,
}

impl ErtStream {
    /// Starts to read the stream of a rig file. `frame_age` is the longest wall time without a
    /// frame: after it a silent wire is reopened, and a taker returns an error.
    ///
    /// # Errors
    /// `RigError::Start` if the thread or its runtime cannot be created. A wire that does not open
    /// is retried by the thread.
    pub fn open(config: &ErtConfig, frame_age: Duration, clock: Clock) -> Result<Self, RigError> {
        let (opener, sending_s) = match config {
            ErtConfig::Tcp { address, .. } => {
                (tcp_stream_opener(address.clone(), BUFFER_BYTES), 0.0)
            }
            ErtConfig::Serial { path, baud, .. } => {
                let settings =
                    SerialSettings { path: path.clone(), baud: *baud, parity: Parity::None };
                let bytes = 24.0 + 2.0 * f64::from(config.electrodes()).powi(2);
                (serial_opener(settings), bytes * BITS_PER_BYTE / f64::from(*baud))
            }
        };
        Self::on(opener, sending_s, config, frame_age, clock)
    }

    /// The reader of what `opener` opens; a packet needs `sending_s` on its wire, process s.
    pub(super) fn on(
        opener: Opener,
        sending_s: f64,
        config: &ErtConfig,
        frame_age: Duration,
        clock: Clock,
    ) -> Result<Self, RigError> {
        let period_s = 1.0 / config.frame_rate_hz();
        let shared = Arc::new(Shared {
            tally: Mutex::default(),
            reconnects: AtomicU64::default(),
            since: Mutex::default(),
            timing: Mutex::new(DeviceTiming::new(period_s, sending_s, clock.rate())),
            status: Mutex::default(),
            stop: Notify::new(),
        });
        let (newest_in, newest) = watch::channel(None);
        let (feed, _) = broadcast::channel(FEED);
        let frame_period = clock.wall(period_s);
        let reader = Reader {
            opener,
            decoder: Decoder::new(config.electrodes()),
            events: Vec::new(),
            shared: Arc::clone(&shared),
            newest: newest_in,
            feed: feed.clone(),
            silence: frame_age.max(2 * frame_period),
            clock: clock.clone(),
        };
        let thread = Some(start(reader)?);
        Ok(Self { shared, newest, feed, frame_age, frame_period, clock, thread })
    }

    /// Last line of text from the device; none before the first.
    pub fn status_line(&self) -> Option<String> {
        self.shared.status.lock().0.clone()
    }

    /// Reason why the wire is down; none if it works.
    pub fn wire_trouble(&self) -> Option<String> {
        self.shared.status.lock().1.clone()
    }

    fn sampled_after(&self, frame: &Frame, moment_s: f64) -> bool {
        let sampled = self.shared.timing.lock().sampled_s(frame.device_time_us);
        sampled.is_some_and(|s| s >= moment_s)
    }
}

impl Drop for ErtStream {
    fn drop(&mut self) {
        self.shared.stop.notify_one();
        if let Some(thread) = self.thread.take() {
            // A reader that panicked has already ended.
            let _ = thread.join();
        }
    }
}

#[async_trait]
impl SkinReader for ErtStream {
    fn latest(&self) -> Option<Arc<Frame>> {
        self.newest.borrow().clone()
    }

    fn follow(&self) -> broadcast::Receiver<Arc<Frame>> {
        self.feed.subscribe()
    }

    fn counters(&self) -> StreamCounters {
        let Tally { frames, missed, garbled, restarts: _ } = *self.shared.tally.lock();
        let reconnects = self.shared.reconnects.load(Ordering::Relaxed);
        let since = *self.shared.since.lock();
        StreamCounters { frames, missed, garbled, reconnects, since }
    }

    async fn take(&self, not_before: Instant, count: usize) -> Result<Vec<Arc<Frame>>, RigError> {
        let mut feed = self.feed.subscribe();
        let periods = u32::try_from(count).unwrap_or(u32::MAX).saturating_add(2);
        let wait = self.frame_age + self.frame_period.saturating_mul(periods);
        let deadline = self.clock.now().max(not_before) + wait;
        let moment_s = self.clock.process_s_at(not_before);
        let mut taken = Vec::with_capacity(count);
        let mut first = true;
        while taken.len() < count {
            match timeout_at(deadline, feed.recv()).await {
                Ok(Ok(_)) if first => first = false,
                Ok(Ok(frame)) => {
                    if self.sampled_after(&frame, moment_s) {
                        taken.push(frame);
                    }
                }
                Ok(Err(broadcast::error::RecvError::Lagged(_))) => {}
                Ok(Err(broadcast::error::RecvError::Closed)) => {
                    return Err(RigError::Closed { device: "ert".into() });
                }
                Err(_late) => {
                    let timeout_ms = wait.as_millis() as u64;
                    return Err(RigError::NoFrames { wanted: count, got: taken.len(), timeout_ms });
                }
            }
        }
        Ok(taken)
    }
}

fn start(reader: Reader) -> Result<JoinHandle<()>, RigError> {
    let failed = |e: std::io::Error| RigError::Start { device: "ert".into(), cause: e.to_string() };
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(failed)?;
    let shared = Arc::clone(&reader.shared);
    let run = move || {
        priority::raise();
        runtime.block_on(async {
            tokio::select! {
                () = reader.run() => {}
                () = shared.stop.notified() => {}
            }
        });
        // The lookup of a name may still wait for its server.
        runtime.shutdown_background();
    };
    std::thread::Builder::new().name("ert-reader".into()).spawn(run).map_err(failed)
}

struct Reader {
    opener: Opener,
    decoder: Decoder,
    /// Packets that the last bytes completed: at most a few frames.
    events: Vec<Event>,
    shared: Arc<Shared>,
    newest: watch::Sender<Option<Arc<Frame>>>,
    feed: broadcast::Sender<Arc<Frame>>,
    silence: Duration,
    clock: Clock,
}

impl Reader {
    async fn run(mut self) {
        let mut wait = REOPEN_WAIT[0];
        loop {
            let opened = timeout(OPEN_LIMIT, (self.opener)()).await;
            let trouble = match opened {
                Err(_late) => format!("not open within {} s", OPEN_LIMIT.as_secs()),
                Ok(Err(error)) => error.to_string(),
                Ok(Ok(port)) => {
                    *self.shared.since.lock() = Some(self.clock.timestamp());
                    let before = self.decoder.tally().frames;
                    let ended = self.read(port).await;
                    if self.decoder.tally().frames > before {
                        wait = REOPEN_WAIT[0];
                    }
                    self.shared.reconnects.fetch_add(1, Ordering::Relaxed);
                    self.decoder.reopen();
                    self.shared.timing.lock().forget();
                    ended
                }
            };
            self.shared.status.lock().1 = Some(trouble);
            tokio::time::sleep(wait).await;
            wait = (2 * wait).min(REOPEN_WAIT[1]);
        }
    }

    /// Reads until the connection is lost or no data arrives; returns the reason.
    async fn read(&mut self, mut port: Box<dyn Port>) -> String {
        let mut bytes = vec![0; STREAM_READ_BYTES];
        loop {
            let n = match timeout(self.silence, port.read(&mut bytes)).await {
                Err(_silent) => return format!("no data for {} ms", self.silence.as_millis()),
                Ok(Ok(0)) => return "closed by the other side".into(),
                Ok(Ok(n)) => n,
                Ok(Err(error)) => return error.to_string(),
            };
            self.digest(&bytes[..n]);
        }
    }

    /// Updates the counters before it publishes, so that a taker that receives a frame finds it
    /// counted.
    fn digest(&mut self, bytes: &[u8]) {
        let received = self.clock.now();
        let host_s = self.clock.process_s_at(received);
        let (decoder, events) = (&mut self.decoder, &mut self.events);
        decoder.push(bytes, |event| events.push(event));
        let (tally, shared) = (self.decoder.tally(), &self.shared);
        let before = std::mem::replace(&mut *shared.tally.lock(), tally);
        if tally.restarts != before.restarts {
            *shared.since.lock() = Some(self.clock.timestamp());
        }
        if tally.frames != before.frames {
            shared.status.lock().1 = None;
        }
        for event in self.events.drain(..) {
            match event {
                Event::Status(line) => shared.status.lock().0 = Some(line),
                Event::Frame(raw) => {
                    shared.timing.lock().arrived(raw.device_time_us, host_s);
                    let frame = Arc::new(frame(raw, received));
                    self.newest.send_replace(Some(Arc::clone(&frame)));
                    // There may be no taker at present.
                    let _ = self.feed.send(frame);
                }
            }
        }
    }
}

fn frame(raw: RawFrame, received: Instant) -> Frame {
    Frame {
        sequence: raw.sequence,
        device_time_us: raw.device_time_us,
        volts_per_count: raw.volts_per_count,
        counts: raw.counts,
        received,
    }
}
