//! How many samples a second each net learns, beside PyTorch: `rate NET BATCH SECONDS [THREADS]`
//! prints one JSON line. `rate.py` beside it runs this and PyTorch in turn.
//! Uses: the clock, which the crate itself does not.

use std::time::{Duration, Instant};

use nets::device::Compute;
use nets::recipe::Recipe;
use nets::samples::{Samples, SamplesError};
use nets::train::{Flow, Observer, Plan, Progress, train};

/// The same few hundred samples again and again: reading costs next to nothing.
struct Repeated {
    inputs: Vec<f32>,
    targets: Vec<f32>,
    target_len: usize,
}

const CHANNELS: usize = 784;
const KEPT: usize = 256;

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
    fn read(&self, samples: &[u64], x: &mut [f32], y: &mut [f32]) -> Result<(), SamplesError> {
        let outs = x.chunks_exact_mut(CHANNELS).zip(y.chunks_exact_mut(self.target_len));
        for (&sample, (x, y)) in samples.iter().zip(outs) {
            let row = sample as usize % KEPT;
            x.copy_from_slice(&self.inputs[row * CHANNELS..][..CHANNELS]);
            y.copy_from_slice(&self.targets[row * self.target_len..][..self.target_len]);
        }
        Ok(())
    }
}

/// Counts samples over a time that begins after some batches.
struct Count {
    begun: Option<(Instant, u64)>,
    lasts: Duration,
    rate: f64,
}

impl Observer for Count {
    fn see(&mut self, progress: &Progress) -> Flow {
        let (now, done) = (Instant::now(), progress.samples[0]);
        if progress.batches[0] < 4 {
            return Flow::Continue;
        }
        let (begun, first) = *self.begun.get_or_insert((now, done));
        self.rate = (done - first) as f64 / (now - begun).as_secs_f64();
        if now - begun < self.lasts { Flow::Continue } else { Flow::Stop }
    }
    fn keep(&mut self, _: Vec<u8>) {}
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [net, batch, seconds, rest @ ..] = &arguments[..] else {
        panic!("rate NET-AS-TOML BATCH SECONDS [THREADS]");
    };
    let threads = rest.first().map_or(0, |t| t.parse().expect("THREADS is a number"));
    let toml = format!("seed = 1\nepochs = 1\nbatch = {batch}\nnet = {net}\n");
    let recipe = Recipe::from_toml(&toml).expect("a recipe");
    let target_len = match &recipe.net {
        nets::recipe::Net::TransferNet(_) => CHANNELS,
        nets::recipe::Net::ReconNet(net) | nets::recipe::Net::EndToEnd(net) => net.side * net.side,
        nets::recipe::Net::PointNet(_) => 804,
    };
    let numbers = |n: usize| (0..n).map(|i| (i as f32 * 0.618).sin() * 0.05).collect();
    let samples = Repeated {
        inputs: numbers(KEPT * CHANNELS),
        targets: (0..KEPT * target_len).map(|i| if i % 97 == 0 { 9.0 } else { 0.0 }).collect(),
        target_len,
    };
    let plan = Plan {
        recipe,
        data: "rate".into(),
        noise_sd_v: None,
        start: None,
        compute: Compute::Cpu { threads },
    };
    let lasts = Duration::from_secs_f64(seconds.parse().expect("SECONDS is a number"));
    let mut count = Count { begun: None, lasts, rate: 0.0 };
    train(&plan, &samples, &samples, None, &mut count).expect("training");
    println!("{{\"samples_per_s\":{:.1}}}", count.rate);
}
