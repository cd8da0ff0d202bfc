//! The running mean of constant frames: its noise decreases, and a new load restarts it.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_core::inverse::contacts::{Steady, SteadyError, SteadySettings};

const CHANNELS: usize = 784;
const NOISE_V: f64 = 1.2e-3;

/// A frame of a constant signal with noise of unit variance (a sum of twelve uniform numbers).
fn noisy(signal_v: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
    (0..CHANNELS).map(|i| signal_v * (i as f64).sin() + NOISE_V * normal()).collect()
}

fn steady() -> Steady {
    Steady::new(CHANNELS, SteadySettings::of_noise(NOISE_V)).unwrap()
}

#[test]
fn a_still_load_is_averaged_up_to_its_limit() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut steady = steady();
    for i in 1..=60 {
        let mean = steady.push(&noisy(5e-3, &mut rng)).unwrap();
        assert!(!mean.changed, "frame {i}");
        let count = f64::from(i);
        if count < 16.0 {
            assert!((mean.frames - count).abs() < 1e-9, "{} of {count}", mean.frames);
        }
        assert!(mean.frames <= count.min(30.0) + 1e-9, "{} of {count}", mean.frames);
    }
    let mean = steady.push(&noisy(5e-3, &mut rng)).unwrap();
    assert!(mean.frames > 29.0, "{}", mean.frames);
    let off = mean.mean_v.iter().enumerate().map(|(i, v)| (v - 5e-3 * (i as f64).sin()).powi(2));
    let sd_v = (off.sum::<f64>() / CHANNELS as f64).sqrt();
    let expected_v = NOISE_V / 30f64.sqrt();
    assert!((0.8..1.2).contains(&(sd_v / expected_v)), "{sd_v}");
}

#[test]
fn a_change_starts_again_at_once_and_a_small_one_soon() {
    for (change_v, within) in [(2e-3, 1), (0.6e-3, 5)] {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut steady = steady();
        for _ in 0..30 {
            steady.push(&noisy(4e-3, &mut rng)).unwrap();
        }
        let seen = (1..=20).find(|_| {
            let mean = steady.push(&noisy(4e-3 + change_v, &mut rng)).unwrap();
            mean.changed && mean.frames <= 4.0
        });
        assert!(seen.is_some_and(|n| n <= within), "{change_v}: {seen:?}");
    }
}

#[test]
fn bad_frames_change_nothing() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut steady = steady();
    let mut frame = noisy(4e-3, &mut rng);
    steady.push(&frame).unwrap();
    frame[3] = f64::INFINITY;
    assert_eq!(steady.push(&frame), Err(SteadyError::NotFinite { channel: 3 }));
    let short = steady.push(&frame[..5]);
    assert_eq!(short, Err(SteadyError::Length { found: 5, needed: CHANNELS }));
    assert_eq!(steady.push(&noisy(4e-3, &mut rng)).unwrap().frames, 2.0);
    let settings = SteadySettings { noise_sd_v: 0.0, ..SteadySettings::of_noise(1.0) };
    assert!(matches!(
        Steady::new(CHANNELS, settings),
        Err(SteadyError::Setting { field: "noise_sd_v", .. })
    ));
}
