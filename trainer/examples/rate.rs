//! Samples per second that each net learns, for a comparison with PyTorch:
//! `rate NET BATCH SECONDS [THREADS]` prints one JSON line, by the clock and by the processor's
//! time (Linux). `rate.py` in the same folder runs this and PyTorch in turn. Built for a GPU, it
//! learns there; samples are in host memory and every batch is copied.
//! Uses: the clock, which the crate itself does not.

use std::time::{Duration, Instant};

use nets::compute::Compute;
use nets::error::SamplesResult;
use nets::progress::{Flow, Observer, Plan, Progress};
use nets::recipe::Recipe;
use nets::samples::Samples;
use palpate_trainer::device;
use palpate_trainer::train::train;

/// The same few hundred samples repeatedly: reading costs almost no time.
struct Repeated {
    inputs: Vec<f32>,
    targets: Vec<f32>,
    target_len: usize,
}

const CHANNELS: usize = 784;
/// Number of points of the paper's skin.
const POINTS: usize = 804;
/// Number of samples that are repeated.
const ROWS: usize = 256;
/// Number of batches before the measurement: a GPU's kernels are compiled and selected in them.
const WARM_UP: u64 = 32;

impl Samples for Repeated {
    fn len(&self) -> u64 {
        1 << 20
    }
    fn input_len(&self) -> usize {
        CHANNELS
    }
    fn target_len(&self) -> usize {
        self.target_len
    }
    fn read(&self, samples: &[u64], x: &mut [f32], y: &mut [f32]) -> SamplesResult<()> {
        let outs = x.chunks_exact_mut(CHANNELS).zip(y.chunks_exact_mut(self.target_len));
        for (&sample, (x, y)) in samples.iter().zip(outs) {
            let row = sample as usize % ROWS;
            x.copy_from_slice(&self.inputs[row * CHANNELS..][..CHANNELS]);
            y.copy_from_slice(&self.targets[row * self.target_len..][..self.target_len]);
        }
        Ok(())
    }
}

/// Counts samples over an interval that begins after some batches.
struct Count {
    begun: Option<(Instant, f64, u64)>,
    lasts: Duration,
    /// Samples per second: by the clock, by the processor's time.
    rates: [f64; 2],
}

impl Observer for Count {
    fn see(&mut self, progress: &Progress) -> Flow {
        let (now, used_s, done) = (Instant::now(), processor_s(), progress.samples[0]);
        if progress.batches[0] < WARM_UP {
            return Flow::Continue;
        }
        let (begun, used_before_s, first) = *self.begun.get_or_insert((now, used_s, done));
        let learned = (done - first) as f64;
        let elapsed = now - begun;
        self.rates = [learned / elapsed.as_secs_f64(), learned / (used_s - used_before_s)];
        if elapsed < self.lasts { Flow::Continue } else { Flow::Stop }
    }
    fn keep(&mut self, _: Vec<u8>) {}
}

/// Processor time of all threads of this process, s; 0 if it is unknown.
fn processor_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // User and system time, in hundredths of a second, are fields 14 and 15; the second field, the
    // name in brackets, may contain spaces.
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let ticks = after_name.split_whitespace().skip(11).take(2).map(|t| t.parse().unwrap_or(0.0));
    ticks.sum::<f64>() / 100.0
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [net, batch, seconds, rest @ ..] = &arguments[..] else {
        panic!("rate NET-AS-TOML BATCH SECONDS [THREADS]");
    };
    let threads = rest.first().map_or(0, |t| t.parse().expect("THREADS is a number"));
    let toml = format!("seed = 1\nepochs = 1\nbatch = {batch}\nnet = {net}\n");
    let recipe = Recipe::from_toml(&toml).expect("a recipe");
    let target_len = recipe.net.answer().target_len(CHANNELS, POINTS);
    let numbers = |n: usize| (0..n).map(|i| (i as f32 * 0.618).sin() * 0.05).collect();
    let samples = Repeated {
        inputs: numbers(ROWS * CHANNELS),
        targets: (0..ROWS * target_len).map(|i| if i % 97 == 0 { 9.0 } else { 0.0 }).collect(),
        target_len,
    };
    let own = device::own();
    let plan = Plan {
        recipe,
        data: "rate".into(),
        noise_sd_v: None,
        compute: if own.is_host() { Compute::Cpu { threads } } else { own },
    };
    let lasts = Duration::from_secs_f64(seconds.parse().expect("SECONDS is a number"));
    let mut count = Count { begun: None, lasts, rates: [0.0; 2] };
    train(&plan, &samples, &samples, None, &mut count).expect("training");
    let [clock, processor] = count.rates;
    println!("{{\"samples_per_s\":{clock:.1},\"samples_per_processor_s\":{processor:.1}}}");
}
