//! The reader of the stream against a device on a real socket: which frames a taker receives, and
//! when.

use std::io::Write;
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex, mpsc};
use std::time::Duration;

use jiff::Timestamp;
use tokio::time::Instant;

use super::*;
use crate::clock::Clock;
use crate::rig::config::ErtConfig;
use crate::rig::error::RigError;
use crate::rig::link::{Opener, Port};
use crate::rig::traits::SkinReader;

const ELECTRODES: u16 = 4;
/// Assumed delay with which a loaded machine wakes the device at best, beyond the margin in
/// `timing`. The frame period is ten times this.
const WAKE_UP: Duration = Duration::from_millis(1);

fn packet(sequence: u32, device_time_us: u64) -> Vec<u8> {
    let mut plain = vec![1, 1];
    plain.extend_from_slice(&ELECTRODES.to_le_bytes());
    plain.extend_from_slice(&sequence.to_le_bytes());
    plain.extend_from_slice(&device_time_us.to_le_bytes());
    plain.extend_from_slice(&1e-3_f32.to_le_bytes());
    plain.extend((0..2 * ELECTRODES * ELECTRODES).map(|i| i as u8));
    plain.extend_from_slice(&crc32fast::hash(&plain).to_le_bytes());
    let mut coded = cobs::encode_vec(&plain);
    coded.push(0);
    coded
}

/// True times of the first samples, by sequence number.
type Truth = Arc<Mutex<Vec<Instant>>>;

/// A device on its own thread that samples a frame every `period` (wall) at `rate` device seconds
/// per wall second, and sends it after its last sample. Frames from `hold[0]` to `hold[1]` wait and
/// then arrive together. It ends when the connection is closed.
fn device(mut wire: TcpStream, period: Duration, rate: f64, hold: [u32; 2], truth: &Truth) {
    wire.set_nodelay(true).unwrap();
    let origin = Instant::now();
    let mut waiting = Vec::new();
    for n in 0.. {
        let sampled = origin + period * n;
        truth.lock().unwrap().push(sampled);
        std::thread::sleep((sampled + period).saturating_duration_since(Instant::now()));
        let device_time_us = (sampled - origin).as_secs_f64() * rate * 1e6 + 5e6;
        waiting.extend(packet(n, device_time_us as u64));
        if !(hold[0]..hold[1]).contains(&n) {
            if wire.write_all(&waiting).is_err() {
                return;
            }
            waiting.clear();
        }
    }
}

fn open(period: Duration, rate: f64, hold: [u32; 2]) -> (ErtStream, Truth) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let truth = Truth::default();
    let kept = Arc::clone(&truth);
    std::thread::spawn(move || {
        let (wire, _) = listener.accept().unwrap();
        device(wire, period, rate, hold, &kept);
    });
    let frame_rate_hz = 1.0 / (period.as_secs_f64() * rate);
    let config = ErtConfig::Tcp { address, electrodes: ELECTRODES, frame_rate_hz };
    let stream = ErtStream::open(&config, Duration::from_secs(2), Clock::new(rate)).unwrap();
    (stream, truth)
}

#[tokio::test]
async fn a_taken_frame_was_sampled_after_the_moment_asked_for() {
    for rate in [1.0, 10.0] {
        let (stream, truth) = open(Duration::from_millis(10), rate, [0, 0]);
        tokio::time::sleep(Duration::from_millis(100)).await;
        for _ in 0..10 {
            let asked = Instant::now();
            let frames = stream.take(asked, 2).await.unwrap();
            let truth = truth.lock().unwrap();
            for frame in frames {
                let sampled = truth[frame.sequence as usize];
                assert!(sampled + WAKE_UP >= asked, "{:?} too early", asked - sampled);
            }
        }
    }
}

#[tokio::test]
async fn frames_that_waited_in_a_buffer_are_not_taken() {
    let (stream, truth) = open(Duration::from_millis(10), 1.0, [30, 60]);
    // Request during the hold: thirty frames arrive together after it, most of them sampled before.
    while truth.lock().unwrap().len() < 50 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let asked = Instant::now();
    let frames = stream.take(asked, 3).await.unwrap();
    let truth = truth.lock().unwrap();
    let early: Vec<_> = frames
        .iter()
        .filter(|f| truth[f.sequence as usize] + WAKE_UP < asked)
        .map(|f| f.sequence)
        .collect();
    assert!(early.is_empty(), "{early:?}");
    assert!(frames[0].sequence < 60, "a frame that waited but was sampled after is valid");
}

#[tokio::test]
async fn a_silent_device_is_waited_for_until_the_deadline() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let config = ErtConfig::Tcp { address, electrodes: ELECTRODES, frame_rate_hz: 100.0 };
    let age = Duration::from_millis(100);
    let stream = ErtStream::open(&config, age, Clock::new(1.0)).unwrap();
    let asked = Instant::now();
    let error = stream.take(asked, 1).await.unwrap_err();
    assert!(matches!(error, RigError::NoFrames { wanted: 1, got: 0, .. }), "{error}");
    assert!(asked.elapsed() < Duration::from_millis(400), "{:?}", asked.elapsed());
    assert!(stream.latest().is_none());
}

#[tokio::test]
async fn a_lost_wire_is_opened_again_and_frames_continue() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let closed_at = Arc::new(Mutex::new(None));
    let closed = closed_at.clone();
    std::thread::spawn(move || {
        let (mut wire, _) = listener.accept().unwrap();
        wire.write_all(&packet(1, 10_000)).unwrap();
        *closed.lock().unwrap() = Some(Timestamp::now());
        drop(wire);
        let (wire, _) = listener.accept().unwrap();
        device(wire, Duration::from_millis(5), 1.0, [0, 0], &Truth::default());
    });
    let config = ErtConfig::Tcp { address, electrodes: ELECTRODES, frame_rate_hz: 200.0 };
    let stream = ErtStream::open(&config, Duration::from_secs(2), Clock::new(1.0)).unwrap();
    let frames = stream.take(Instant::now(), 5).await.unwrap();
    assert_eq!(frames.len(), 5);
    assert_eq!(stream.counters().reconnects, 1);
    let closed_at = *closed_at.lock().unwrap();
    assert!(closed_at.is_some() && stream.counters().since > closed_at, "it is open since then");
    assert_eq!(stream.wire_trouble(), None);
}

#[tokio::test]
async fn a_lookup_of_a_name_does_not_delay_the_end_of_the_reader() {
    const TAKES: Duration = Duration::from_secs(20);
    let (begins, begun) = mpsc::channel();
    let opener: Opener = Box::new(move || {
        let begins = begins.clone();
        Box::pin(async move {
            // As the lookup of the system, it cannot be cancelled.
            let lookup = move || {
                let _ = begins.send(());
                std::thread::sleep(TAKES);
            };
            let _ = tokio::task::spawn_blocking(lookup).await;
            Err::<Box<dyn Port>, _>(std::io::Error::from(std::io::ErrorKind::TimedOut))
        })
    });
    let address = "rig.invalid:4001".into();
    let config = ErtConfig::Tcp { address, electrodes: ELECTRODES, frame_rate_hz: 100.0 };
    let age = Duration::from_secs(2);
    let stream = ErtStream::on(opener, 0.0, &config, age, Clock::new(1.0)).unwrap();
    begun.recv_timeout(TAKES).unwrap();
    let ended = Instant::now();
    drop(stream);
    assert!(ended.elapsed() < TAKES / 2, "{:?}", ended.elapsed());
}
