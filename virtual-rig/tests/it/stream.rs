//! The voltage stream, as decoded by an independent reader.

use std::time::{Duration, Instant};

use tokio::net::TcpStream;
use tokio_serial::SerialStream;

use crate::common::{
    Control, IAI_TCP, StreamReader, bench, on_one_bus, over_the_skin, reader, switch_on,
};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_untouched_skin_is_noise_at_the_rig_s_own_rate() {
    let rig = switch_on(IAI_TCP, 10.0, "").await;
    let mut reader = reader(&rig).await;
    let first = reader.frame().await;
    let since = Instant::now();
    let mut last = first.clone();
    for _ in 0..150 {
        let frame = reader.frame().await;
        assert_eq!(frame.sequence, last.sequence + 1);
        let period = frame.device_time_us - last.device_time_us;
        assert!((33_332..=33_335).contains(&period), "{period}");
        // 28 readings of 1.2 mV noise sum to 6 mV.
        assert!(frame.largest_sum_v() < 0.05, "{}", frame.largest_sum_v());
        assert!(frame.largest_v() > 1e-5, "a readout has noise");
        last = frame;
    }
    let seconds = since.elapsed().as_secs_f64();
    assert!((0.4..1.5).contains(&seconds), "150 frames at 300 per second took {seconds} s");
    assert!(reader.statuses.iter().any(|s| s.contains("virtual readout")));
    assert_eq!(reader.garbled, 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn frames_of_a_press_are_of_its_load_or_missing() {
    let (rig, mut control, mut iai) = bench(20.0).await;
    let surface = over_the_skin(&mut iai, &mut control).await;
    let mut reader = reader(&rig).await;
    let light = reader.frame().await;
    // 2 mm into the skin at 1 mm/s: two process seconds of changing load.
    iai.go(3, surface + 3.0, 60.0).await;
    iai.go(3, surface + 5.0, 1.0).await;
    let arrived = control.status().await["process_s"].as_f64().unwrap();
    let mut frames = vec![light];
    while frames.last().unwrap().device_time_us as f64 * 1e-6 < arrived + 1.0 {
        frames.push(reader.frame().await);
    }
    let at = |f: &crate::common::Frame| f.device_time_us as f64 * 1e-6;
    // The approach ends shortly before it is detected. During the two seconds before that the load
    // changed, and there is no frame.
    let changing = frames.iter().filter(|f| (arrived - 1.5..arrived - 0.5).contains(&at(f)));
    assert_eq!(changing.count(), 0);
    let held: Vec<_> = frames.iter().filter(|f| at(f) > arrived + 0.3).collect();
    assert!(held.len() > 10, "{}", held.len());
    let strong = frames[0].largest_v() * 3.0;
    assert!(held.iter().all(|f| f.largest_v() > strong), "the press shows");
    let spread = held.iter().map(|f| f.largest_v()).fold(0.0, f64::max)
        - held.iter().map(|f| f.largest_v()).fold(f64::INFINITY, f64::min);
    assert!(spread < 0.1 * held[0].largest_v() + 0.01, "not constant while held: {spread}");
    let status = control.status().await;
    assert!(status["frames_dropped"].as_u64().unwrap() > 30);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_client_has_the_whole_stream_and_a_stuck_one_holds_up_nobody() {
    let rig = switch_on(IAI_TCP, 50.0, "").await;
    let stuck = TcpStream::connect(&rig.ready.ert).await.unwrap();
    let mut a = reader(&rig).await;
    let mut b = reader(&rig).await;
    let since = Instant::now();
    let (mut last_a, mut last_b) = (a.frame().await, b.frame().await);
    while since.elapsed() < Duration::from_secs(1) {
        let (next_a, next_b) = (a.frame().await, b.frame().await);
        assert_eq!(next_a.sequence, last_a.sequence + 1);
        assert_eq!(next_b.sequence, last_b.sequence + 1);
        (last_a, last_b) = (next_a, next_b);
    }
    assert!(last_a.sequence > 1000);
    drop(stuck);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_pseudo_terminal_carries_it_as_well() {
    let rig = switch_on(&on_one_bus("iai", 100.0, 100.0), 10.0, "").await;
    for _ in 0..2 {
        let port = SerialStream::open(&tokio_serial::new(&rig.ready.ert, 921_600)).unwrap();
        let mut reader = StreamReader::new(port);
        let mut last = reader.frame().await;
        for _ in 0..60 {
            let frame = reader.frame().await;
            assert!(frame.sequence > last.sequence);
            last = frame;
        }
        assert!(reader.garbled <= 1, "only the first packet may be cut");
        let now = Control::open(&rig).await.status().await["process_s"].as_f64().unwrap();
        assert!(now - last.device_time_us as f64 * 1e-6 < 2.0, "unread data are not stored");
    }
}
