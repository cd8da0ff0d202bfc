//! FC22 amplified load cells behind an analog module: volts from newtons, converted at the update
//! period of the module and held in between.
//! PURE. Uses: `config`, `fault`. Never: registers (`device` has those), clocks.
//!
//! Ratiometric: V = supply x (0.1 + 0.8 F / full scale) (`docs/references.md`, "FC22 load cells").
//! A disconnected cell reads 0 V. A connected cell has a live zero, with or without a tip.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::config::{ARMS, Cells};
use crate::device::INPUTS;
use crate::fault::{ActiveFault, CellFault};

/// Largest zero offset, fraction of full scale (accuracy of the cell).
const OFFSET_PART: f64 = 0.01;
/// Noise of a cell and its wires, fraction of full scale, one sigma.
const NOISE_PART: f64 = 2e-4;
/// Output of an overloaded amplifier, fraction of the supply.
const CEILING_PART: f64 = 0.92;
/// Lowest output of an unloaded amplifier, fraction of the supply.
const FLOOR_PART: f64 = 0.06;

/// The cells and the last conversion of the module.
pub struct CellBank {
    file: Cells,
    seed: u64,
    offsets_n: [f64; ARMS],
    held: Option<(i64, [f64; INPUTS])>,
    frozen: [Option<f64>; ARMS],
}

impl CellBank {
    /// Creates six cells with individual zero offsets.
    pub fn new(file: Cells, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let bound = OFFSET_PART * file.full_scale_n;
        let offsets_n = std::array::from_fn(|_| rng.random_range(-bound..bound));
        Self { file, seed, offsets_n, held: None, frozen: [None; ARMS] }
    }

    /// Number of the conversion that is valid at a process time.
    pub fn conversion(&self, t_s: f64) -> i64 {
        (t_s / self.period_s()).floor() as i64
    }

    /// Process time of a conversion, s.
    pub fn time_s(&self, conversion: i64) -> f64 {
        conversion as f64 * self.period_s()
    }

    /// The held voltages, V, if they belong to that conversion.
    pub fn held(&self, conversion: i64) -> Option<[f64; INPUTS]> {
        self.held.filter(|h| h.0 == conversion).map(|h| h.1)
    }

    /// Discards the held conversion, because the attached cells have changed.
    pub fn forget(&mut self) {
        self.held = None;
    }

    fn period_s(&self) -> f64 {
        self.file.update_ms * 1e-3
    }

    /// Converts the outputs of the cells, V, from the forces at the time of the conversion, the
    /// number of connected cells, and the active faults.
    pub fn convert(
        &mut self,
        conversion: i64,
        forces_n: &[f64; ARMS],
        powered: usize,
        faults: &[ActiveFault],
    ) -> [f64; INPUTS] {
        let mut volts = [0.0; INPUTS];
        let t_s = self.time_s(conversion);
        for arm in 0..ARMS {
            let of_arm = || faults.iter().filter(move |f| f.arm == arm);
            let uncoupled = of_arm().any(|f| f.fault == CellFault::Uncoupled);
            let felt_n = if uncoupled { 0.0 } else { forces_n[arm] };
            let mut force = felt_n + self.offsets_n[arm];
            for ActiveFault { fault, began_s, .. } in of_arm() {
                match fault {
                    CellFault::Drifting { n_per_s } => {
                        force += n_per_s * (t_s - began_s).max(0.0);
                    }
                    CellFault::Loaded { n } => force += n,
                    _ => {}
                }
            }
            force += NOISE_PART * self.file.full_scale_n * self.noise(conversion, arm);
            let v = if arm < powered { self.volts(force) } else { 0.0 };
            volts[usize::from(self.file.channels[arm])] = self.with_faults(arm, v, faults);
        }
        self.held = Some((conversion, volts));
        volts
    }

    fn volts(&self, force_n: f64) -> f64 {
        let supply = self.file.supply_v;
        let v = supply * (0.1 + 0.8 * force_n / self.file.full_scale_n);
        v.clamp(FLOOR_PART * supply, CEILING_PART * supply)
    }

    fn with_faults(&mut self, arm: usize, v: f64, faults: &[ActiveFault]) -> f64 {
        let has = |fault: CellFault| faults.iter().any(|f| f.arm == arm && f.fault == fault);
        let frozen = has(CellFault::Frozen);
        self.frozen[arm] = frozen.then(|| self.frozen[arm].unwrap_or(v));
        if has(CellFault::Dead) {
            0.0
        } else if has(CellFault::Saturated) {
            CEILING_PART * self.file.supply_v
        } else {
            self.frozen[arm].unwrap_or(v)
        }
    }

    /// Standard normal noise that depends only on conversion and arm.
    fn noise(&self, conversion: i64, arm: usize) -> f64 {
        let mut state = self.seed ^ (conversion as u64).wrapping_mul(8) ^ arm as u64;
        let mut next = || {
            // SplitMix64.
            state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
            let mut z = state;
            z = (z ^ z >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            z = (z ^ z >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
            ((z ^ z >> 31) >> 11) as f64 / (1u64 << 53) as f64
        };
        let (u, v): (f64, f64) = (next().max(1e-16), next());
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::RigFile;

    fn bank() -> CellBank {
        let text = include_str!("../../../experiments/rigs/virtual.toml");
        CellBank::new(RigFile::from_toml(text).unwrap().cells, 7)
    }

    #[test]
    fn volts_follow_newtons_and_stop_at_the_ceiling() {
        let mut bank = bank();
        let newtons_per_volt = 111.2 / 4.0;
        let zero = bank.convert(0, &[0.0; 6], 6, &[]);
        let loaded = bank.convert(1, &[10.0, 20.0, 40.0, 80.0, 110.0, 200.0], 6, &[]);
        for (channel, force) in [10.0, 20.0, 40.0, 80.0].into_iter().enumerate() {
            let measured = (loaded[channel] - zero[channel]) * newtons_per_volt;
            assert!((measured - force).abs() < 0.2, "{measured} for {force}");
        }
        assert!((loaded[5] - 4.6).abs() < 1e-9);
        assert_eq!(loaded[6], 0.0);
    }

    #[test]
    fn a_cell_that_is_not_on_its_cable_reads_nothing() {
        let volts = bank().convert(0, &[0.0; 6], 2, &[]);
        assert!(volts[0] > 0.4 && volts[1] > 0.4);
        assert_eq!(volts[2..6], [0.0; 4]);
    }

    #[test]
    fn a_conversion_is_held_and_repeats_itself() {
        let mut bank = bank();
        let conversion = bank.conversion(12.34);
        assert_eq!(conversion, 123);
        let volts = bank.convert(conversion, &[5.0; 6], 6, &[]);
        assert_eq!(bank.held(bank.conversion(12.399)), Some(volts));
        assert_eq!(bank.held(bank.conversion(12.401)), None);
        assert_eq!(bank.convert(conversion, &[5.0; 6], 6, &[]), volts);
    }

    #[test]
    fn faults_of_cells_show() {
        let mut bank = bank();
        let faults = [
            (0, CellFault::Dead),
            (1, CellFault::Saturated),
            (2, CellFault::Frozen),
            (3, CellFault::Drifting { n_per_s: 1.0 }),
        ];
        let faults = faults.map(|(arm, fault)| ActiveFault { arm, fault, began_s: 0.0 });
        let first = bank.convert(10, &[0.0; 6], 6, &faults);
        let later = bank.convert(110, &[20.0; 6], 6, &faults);
        assert_eq!(later[0], 0.0);
        assert!((later[1] - 4.6).abs() < 1e-9);
        assert_eq!(later[2], first[2]);
        let drift = (later[3] - first[3]) * 27.8 - 20.0;
        assert!((drift - 10.0).abs() < 0.3, "{drift}");
    }

    #[test]
    fn a_foreign_load_pushes_or_pulls_on_a_cell_without_a_tip() {
        let mut bank = bank();
        let zero = bank.convert(10, &[0.0; 6], 6, &[]);
        let faults = [(5, 8.0), (0, -3.0)].map(|(arm, n)| {
            let fault = CellFault::Loaded { n };
            ActiveFault { arm, fault, began_s: 0.0 }
        });
        let loaded = bank.convert(11, &[0.0; 6], 6, &faults);
        let changes = [0, 5].map(|arm| (loaded[arm] - zero[arm]) * 27.8);
        assert!((changes[0] + 3.0).abs() < 0.2 && (changes[1] - 8.0).abs() < 0.2, "{changes:?}");
    }
}
