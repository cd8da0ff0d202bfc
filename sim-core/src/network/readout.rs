//! Converts the reduced network to a frame: impedances Z, electrode voltages, adjacent differences.
//! Uses: `circuit`, the block of `network::kron`. Never: the foam, the mesh.
//!
//! `Z = E' A^-1 E`: potential at j, below the top, per ampere drawn at k. With electrode k at 0 V
//! and the top at V0: `V_j(k) = V0 (Z_kk - Z_jk) / Z_kk`
//! (`docs/references.md`, "Resistor network"). A lead adds to Z_kk of the electrode that it belongs to. Frame:
//! `v[n k + j] = gain (V_j - V_(j+1 mod n))`.

use crate::circuit::ReadoutCircuit;

/// Numbers of `N` loads, one per lane.
type Lanes<const N: usize> = [f64; N];

/// Memory and results of the last stage, for `N` loads in parallel; all square blocks are
/// row-major, `n * n`.
#[derive(Debug, Default)]
pub struct ReadoutWork<const N: usize = 1> {
    lower: Vec<Lanes<N>>,
    inverse: Vec<Lanes<N>>,
    impedance_ohm: Vec<Lanes<N>>,
    electrodes_v: Vec<Lanes<N>>,
    frame_v: Vec<Lanes<N>>,
}

impl ReadoutWork {
    /// Z, ohm: `[n * j + k]`, without leads. Symmetric.
    pub fn impedance_ohm(&self) -> &[f64] {
        self.impedance_ohm.as_flattened()
    }

    /// Electrode voltages before gain, V: `[n * k + j]` = V_j while k is the sink.
    pub fn electrodes_v(&self) -> &[f64] {
        self.electrodes_v.as_flattened()
    }

    /// The frame after gain, V: `[n * k + j]`.
    pub fn frame_v(&self) -> &[f64] {
        self.frame_v.as_flattened()
    }

    /// Computes Z, the voltages and the frame from the block of [`super::kron::KronReduction`]
    /// (column-major, `n + 1` rows, conductances below the diagonal, those to the top last).
    pub fn evaluate(&mut self, reduced: &[f64], circuit: &ReadoutCircuit) {
        self.evaluate_lanes(reduced.as_chunks().0, circuit);
    }
}

impl<const N: usize> ReadoutWork<N> {
    /// As [`ReadoutWork::evaluate`], for each lane. The numbers of a lane do not depend on its
    /// neighbours. Returns the frames: `[n * k + j]`, V after gain.
    #[inline(always)] // so that a kernel's vectors serve here too
    pub fn evaluate_lanes(
        &mut self,
        reduced: &[[f64; N]],
        circuit: &ReadoutCircuit,
    ) -> &[[f64; N]] {
        let n = circuit.electrodes.len();
        for block in
            [&mut self.inverse, &mut self.impedance_ohm, &mut self.electrodes_v, &mut self.frame_v]
        {
            block.clear();
            block.resize(n * n, [0.0; N]);
        }
        self.factor(reduced, n);
        self.invert(n);
        let ReadoutWork { impedance_ohm, electrodes_v, frame_v, .. } = self;
        let rows = impedance_ohm.chunks_exact(n).zip(electrodes_v.chunks_exact_mut(n));
        for (k, ((z, voltages), frame)) in rows.zip(frame_v.chunks_exact_mut(n)).enumerate() {
            let own = z[k].map(|z| z + circuit.electrodes[k].lead_ohm);
            // Without a path to the top there is no current.
            let flows = own.map(|own| own.is_finite() && own > 0.0);
            let volts_per_ohm = own.map(|own| circuit.source_v / own);
            for (v, z) in voltages.iter_mut().zip(z) {
                *v = std::array::from_fn(|lane| {
                    if flows[lane] { volts_per_ohm[lane] * (own[lane] - z[lane]) } else { 0.0 }
                });
            }
            voltages[k] = [0.0; N];
            for (j, value) in frame.iter_mut().enumerate() {
                let (v, next) = (voltages[j], voltages[if j + 1 < n { j + 1 } else { 0 }]);
                *value = std::array::from_fn(|lane| circuit.gain * (v[lane] - next[lane]));
            }
        }
        frame_v
    }

    /// Cholesky without subtraction: `lower[column]` contains l_ik > 0 below the diagonal, and
    /// `1 / sqrt(d)` on it; the last row (top) contributes to d.
    #[inline(always)]
    fn factor(&mut self, reduced: &[Lanes<N>], n: usize) {
        let lead = n + 1;
        self.lower.clear();
        self.lower.extend_from_slice(reduced);
        for k in 0..n {
            let (before, from_k) = self.lower.split_at_mut((k + 1) * lead);
            let column = &mut before[k * lead..];
            let d = column[k + 1..].iter().fold([-0.0; N], |sum, v| add(sum, *v));
            let scale = d.map(|d| 1.0 / d.sqrt());
            column[k + 1..].iter_mut().for_each(|v| *v = mul(*v, scale));
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
            column[k] = [1.0; N];
            for (j, lower) in self.lower.chunks_exact(lead).enumerate().skip(k) {
                let (done, rest) = column.split_at_mut(j + 1);
                done[j] = mul(done[j], lower[j]);
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
fn zip<const N: usize>(mut a: Lanes<N>, b: &Lanes<N>, f: impl Fn(f64, f64) -> f64) -> Lanes<N> {
    for (a, b) in a.iter_mut().zip(b) {
        *a = f(*a, *b);
    }
    a
}

#[inline(always)]
fn add<const N: usize>(a: Lanes<N>, b: Lanes<N>) -> Lanes<N> {
    zip(a, &b, |a, b| a + b)
}

#[inline(always)]
fn mul<const N: usize>(a: Lanes<N>, b: Lanes<N>) -> Lanes<N> {
    zip(a, &b, |a, b| a * b)
}

#[inline(always)]
fn add_scaled<const N: usize>(target: &mut [Lanes<N>], factor: Lanes<N>, source: &[Lanes<N>]) {
    for (t, s) in target.iter_mut().zip(source) {
        *t = add(*t, mul(factor, *s));
    }
}

/// Scalar product as four independent sums, which a processor adds in parallel.
#[inline(always)]
fn dot<const N: usize>(a: &[Lanes<N>], b: &[Lanes<N>]) -> Lanes<N> {
    let ((a, a_tail), (b, b_tail)) = (a.as_chunks::<4>(), b.as_chunks::<4>());
    let mut sums = [[0.0; N]; 4];
    for (a, b) in a.iter().zip(b) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum = add(*sum, mul(*a, *b));
        }
    }
    let tail = a_tail.iter().zip(b_tail).fold([-0.0; N], |sum, (a, b)| add(sum, mul(*a, *b)));
    add(sums.into_iter().fold([-0.0; N], add), tail)
}
