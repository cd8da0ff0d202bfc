//! Seeded chance: named streams, and random fields that are rough at all scales.
//! Uses: rand_chacha. Never: unseeded chance.

use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Number of waves in a field.
const WAVES: usize = 192;

/// Generator of a seed for one purpose.
pub fn stream(seed: u64, purpose: &str) -> ChaCha8Rng {
    let mut key = [0u8; 32];
    key[..8].copy_from_slice(&seed.to_le_bytes());
    for (n, byte) in purpose.bytes().enumerate() {
        let at = 8 + n % 24;
        key[at] = key[at].rotate_left(3) ^ byte;
    }
    ChaCha8Rng::from_seed(key)
}

/// A standard normal number.
pub fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// A random function of the place with variance 1 and Whittle's correlation `(d/l) K1(d/l)`: less smooth
/// than a Gaussian one (P. Whittle, Biometrika 41, 1954). A sum of plane waves whose wave numbers are
/// drawn from its spectrum, `1 / (1 + k^2 l^2)^2` in the plane.
#[derive(Debug, Clone)]
pub struct Field {
    waves: Vec<[f64; 3]>,
}

impl Field {
    /// Draws a field with correlation length `length_mm`.
    pub fn draw(seed: u64, purpose: &str, length_mm: f64) -> Self {
        let mut rng = stream(seed, purpose);
        let waves = (0..WAVES)
            .map(|_| {
                let share: f64 = rng.random_range(0.0..0.999);
                let number = (share / (1.0 - share)).sqrt() / length_mm;
                let direction = TAU * rng.random::<f64>();
                [number * direction.cos(), number * direction.sin(), TAU * rng.random::<f64>()]
            })
            .collect();
        Self { waves }
    }

    /// Value at a place.
    pub fn at(&self, [x_mm, y_mm]: [f64; 2]) -> f64 {
        let sum: f64 =
            self.waves.iter().map(|[kx, ky, phase]| (kx * x_mm + ky * y_mm + phase).cos()).sum();
        sum * (2.0 / WAVES as f64).sqrt()
    }
}
