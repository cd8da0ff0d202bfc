//! From the reduced network to a frame: impedances Z, electrode voltages, adjacent differences.
//! Uses: `circuit`, the block that `network::kron` leaves. Never: the foam, the mesh.
//!
//! `Z = E' A^-1 E`: potential at j, below the top, per ampere drawn at k. With electrode k at 0 V
//! and the top at V0: `V_j(k) = V0 (Z_kk - Z_jk) / Z_kk` (`stack.md` part 1 section 2). A lead adds
//! to Z_kk of its own electrode. Frame: `v[n k + j] = gain (V_j - V_(j+1 mod n))`.

use crate::circuit::ReadoutCircuit;

/// Memory and results of the last stage; all square blocks are row-major, `n * n`.
#[derive(Debug, Default)]
pub struct ReadoutWork {
    lower: Vec<f64>,
    inverse: Vec<f64>,
    impedance_ohm: Vec<f64>,
    electrodes_v: Vec<f64>,
    frame_v: Vec<f64>,
}

impl ReadoutWork {
    /// Z, ohm: `[n * j + k]`, without leads. Symmetric.
    pub fn impedance_ohm(&self) -> &[f64] {
        &self.impedance_ohm
    }

    /// Electrode voltages before gain, V: `[n * k + j]` = V_j while k is the sink.
    pub fn electrodes_v(&self) -> &[f64] {
        &self.electrodes_v
    }

    /// The frame after gain, V: `[n * k + j]`.
    pub fn frame_v(&self) -> &[f64] {
        &self.frame_v
    }

    /// Works out Z, the voltages and the frame from the block of [`super::kron::KronReduction`]
    /// (column-major, `n + 1` rows, conductances below the diagonal, those to the top last).
    pub fn evaluate(&mut self, reduced: &[f64], circuit: &ReadoutCircuit) {
        let n = circuit.electrodes.len();
        for block in
            [&mut self.inverse, &mut self.impedance_ohm, &mut self.electrodes_v, &mut self.frame_v]
        {
            block.clear();
            block.resize(n * n, 0.0);
        }
        self.factor(reduced, n);
        self.invert(n);
        for k in 0..n {
            let own = self.impedance_ohm[n * k + k] + circuit.electrodes[k].lead_ohm;
            for j in (0..n).filter(|&j| j != k) {
                let seen = if own.is_finite() && own > 0.0 {
                    (own - self.impedance_ohm[n * j + k]) / own
                } else {
                    0.0 // no path to the top at all: nothing flows
                };
                self.electrodes_v[n * k + j] = circuit.source_v * seen;
            }
            let voltages = &self.electrodes_v[n * k..][..n];
            for j in 0..n {
                self.frame_v[n * k + j] = circuit.gain * (voltages[j] - voltages[(j + 1) % n]);
            }
        }
    }

    /// Cholesky without subtraction: `lower[column]` holds l_ik > 0 below the diagonal, and
    /// `1 / sqrt(d)` on it; the last row (top) takes part in d.
    fn factor(&mut self, reduced: &[f64], n: usize) {
        let lead = n + 1;
        self.lower.clear();
        self.lower.extend_from_slice(reduced);
        for k in 0..n {
            let (before, from_k) = self.lower.split_at_mut((k + 1) * lead);
            let column = &mut before[k * lead..];
            let d: f64 = column[k + 1..].iter().sum();
            let scale = 1.0 / d.sqrt();
            column[k + 1..].iter_mut().for_each(|v| *v *= scale);
            column[k] = scale;
            for (j, target) in (k + 1..n).zip(from_k.chunks_exact_mut(lead)) {
                for i in j + 1..lead {
                    target[i] += column[i] * column[j];
                }
            }
        }
    }

    /// `inverse` = L^-1 (row-major, all entries >= 0), Z = L^-T L^-1.
    fn invert(&mut self, n: usize) {
        let lead = n + 1;
        for k in 0..n {
            self.inverse[n * k + k] = self.lower[k * lead + k];
            for i in k + 1..n {
                let sum: f64 =
                    (k..i).map(|j| self.lower[j * lead + i] * self.inverse[n * j + k]).sum();
                self.inverse[n * i + k] = sum * self.lower[i * lead + i];
            }
        }
        for j in 0..n {
            for k in 0..=j {
                let z = (j..n).map(|i| self.inverse[n * i + j] * self.inverse[n * i + k]).sum();
                self.impedance_ohm[n * j + k] = z;
                self.impedance_ohm[n * k + j] = z;
            }
        }
    }
}
