//! Random numbers from a seed: named streams, so that an additional draw does not change the
//! others, and smooth random fields.
//! Uses: rand_chacha. Never: unseeded random numbers.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Number of waves in a smooth field.
const WAVES: usize = 128;

/// Random generator of a seed for one purpose.
pub fn stream(seed: u64, name: &str) -> ChaCha8Rng {
    // FNV-1a over the name, starting from the seed: names are few and chosen here.
    let hash = name.bytes().fold(seed ^ 0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    });
    ChaCha8Rng::seed_from_u64(hash)
}

/// A standard normal number, determined by seed, name and index.
pub fn normal_at(seed: u64, name: &str, index: u64) -> f64 {
    let mut rng = stream(seed, name);
    rng.set_stream(index);
    StandardNormal.sample(&mut rng)
}

/// A smooth random function of three coordinates: nearly Gaussian, variance 1, correlation
/// `exp(-d^2 / (2 l^2))` (a sum of plane waves with random directions and phases).
#[derive(Debug, Clone)]
pub struct SmoothField {
    /// Wave vector, 1/mm, and phase, rad.
    waves: Vec<[f64; 4]>,
}

impl SmoothField {
    /// Draws a field with a correlation length, mm.
    pub fn draw(rng: &mut impl Rng, length_mm: f64) -> Self {
        let waves = (0..WAVES)
            .map(|_| {
                let mut wave = [0.0; 4];
                for component in &mut wave[..3] {
                    let normal: f64 = StandardNormal.sample(rng);
                    *component = normal / length_mm;
                }
                let turn = rand::RngExt::random::<f64>(rng);
                wave[3] = std::f64::consts::TAU * turn;
                wave
            })
            .collect();
        Self { waves }
    }

    /// Value of the field at a position, mm.
    pub fn at(&self, place_mm: [f64; 3]) -> f64 {
        let wave = |w: &[f64; 4]| {
            (w[0] * place_mm[0] + w[1] * place_mm[1] + w[2] * place_mm[2] + w[3]).cos()
        };
        (2.0 / WAVES as f64).sqrt() * self.waves.iter().map(wave).sum::<f64>()
    }
}
