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
    #[inline(always)] // so that a kernel's vectors serve here too
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
        let ReadoutWork { impedance_ohm, electrodes_v, frame_v, .. } = self;
        let rows = impedance_ohm.chunks_exact(n).zip(electrodes_v.chunks_exact_mut(n));
        for (k, ((z, voltages), frame)) in rows.zip(frame_v.chunks_exact_mut(n)).enumerate() {
            let own = z[k] + circuit.electrodes[k].lead_ohm;
            if own.is_finite() && own > 0.0 {
                let volts_per_ohm = circuit.source_v / own;
                for (v, z) in voltages.iter_mut().zip(z) {
                    *v = volts_per_ohm * (own - z);
                }
            } // else no path to the top at all: nothing flows
            voltages[k] = 0.0;
            for (j, value) in frame.iter_mut().enumerate() {
                let next = if j + 1 < n { j + 1 } else { 0 };
                *value = circuit.gain * (voltages[j] - voltages[next]);
            }
        }
    }

    /// Cholesky without subtraction: `lower[column]` holds l_ik > 0 below the diagonal, and
    /// `1 / sqrt(d)` on it; the last row (top) takes part in d.
    #[inline(always)]
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
                add_scaled(&mut target[j + 1..], column[j], &column[j + 1..]);
            }
        }
    }

    /// `inverse` = L^-1 by columns, all entries >= 0; then Z = L^-T L^-1.
    #[inline(always)]
    fn invert(&mut self, n: usize) {
        let lead = n + 1;
        for (k, column) in self.inverse.chunks_exact_mut(n).enumerate() {
            column[k] = 1.0;
            for (j, lower) in self.lower.chunks_exact(lead).enumerate().skip(k) {
                let (done, rest) = column.split_at_mut(j + 1);
                done[j] *= lower[j];
                add_scaled(rest, done[j], &lower[j + 1..n]);
            }
        }
        for (j, left) in self.inverse.chunks_exact(n).enumerate() {
            for (k, right) in self.inverse.chunks_exact(n).enumerate().take(j + 1) {
                let z = dot(&left[j..], &right[j..]);
                self.impedance_ohm[n * j + k] = z;
                self.impedance_ohm[n * k + j] = z;
            }
        }
    }
}

#[inline(always)]
fn add_scaled(target: &mut [f64], factor: f64, source: &[f64]) {
    for (t, s) in target.iter_mut().zip(source) {
        *t += factor * s;
    }
}

/// Scalar product in four strands, which a processor adds side by side.
#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let ((a, a_tail), (b, b_tail)) = (a.as_chunks::<4>(), b.as_chunks::<4>());
    let mut sums = [0.0; 4];
    for (a, b) in a.iter().zip(b) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    let tail: f64 = a_tail.iter().zip(b_tail).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f64>() + tail
}
