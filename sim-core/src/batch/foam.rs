//! Eq. 1 in lanes of f32: from the skin's compression to the foam's conductance at every node.
//! Uses: `network::lane`, the forward model's laws and fields. Never: contacts.
//!
//! `1 / f(x) = E / (a + c E)`, `E = expm1(b x)`: relative error below 5e-7 at any compression.
//! Lanes are nodes here, not loads; a node's result is the same in every lane.

use crate::fields::DisplacementLut;
use crate::network::lane::{Lane32, ROUND};
use crate::piezo::{LEAST_COMPRESSION_MM, NodeLaw};

/// Nodes that are evaluated together; a multiple of every lane count.
pub(super) const BLOCK_NODES: usize = 16;

/// Limit of b x: beyond it the foam's resistance is c to f32 accuracy, and E is still far from its
/// largest value.
const MOST_EXPONENT: f64 = 60.0;

/// The laws of all nodes in the order of their removal, padded to whole blocks.
#[derive(Debug)]
pub(super) struct Foam {
    a_ohm: Vec<f32>,
    b_per_mm: Vec<f32>,
    c_ohm: Vec<f32>,
    compliance: Vec<f32>,
    displacement: Option<DisplacementLut>,
}

impl Foam {
    /// Builds the laws of the mesh's nodes; further nodes in `order` have no foam.
    pub(super) fn new(
        order: &[u32],
        laws: &[NodeLaw],
        displacement: Option<DisplacementLut>,
    ) -> Self {
        let column = |of: fn(&NodeLaw) -> f64, without: f32| -> Vec<f32> {
            let mut column: Vec<f32> = order
                .iter()
                .map(|&node| laws.get(node as usize).map_or(without, |law| of(law) as f32))
                .collect();
            column.resize(order.len().next_multiple_of(BLOCK_NODES), without);
            column
        };
        Self {
            a_ohm: column(|law| law.a_ohm, f32::INFINITY),
            b_per_mm: column(|law| law.b_per_mm, 1.0),
            c_ohm: column(|law| law.c_ohm, 0.0),
            compliance: column(|law| law.compliance, 1.0),
            displacement,
        }
    }

    /// Nodes, padded.
    pub(super) fn nodes(&self) -> usize {
        self.a_ohm.len()
    }

    /// Replaces the nominal compressions of a block of nodes (mm, before the clamp) by their
    /// conductances (S).
    #[inline(always)]
    pub(super) fn conduct<L: Lane32>(&self, block: usize, values: &mut [f32; BLOCK_NODES]) {
        let first = block * BLOCK_NODES;
        let at = |values: &[f32], part: usize| L::load(&values[first + part..]);
        for (part, values) in
            (0..BLOCK_NODES).step_by(L::LANES).zip(values.chunks_exact_mut(L::LANES))
        {
            let mut x = L::load(values).max(L::splat(0.0)).mul(at(&self.compliance, part));
            if let Some(lut) = &self.displacement {
                x.store(values);
                values.iter_mut().for_each(|x| *x = lut.apply(f64::from(*x)) as f32);
                x = L::load(values);
            }
            let x = x.max(L::splat(LEAST_COMPRESSION_MM));
            let e = expm1(x.mul(at(&self.b_per_mm, part)).min(L::splat(MOST_EXPONENT)));
            e.div(e.mul_add(at(&self.c_ohm, part), at(&self.a_ohm, part))).store(values);
        }
    }
}

/// `exp(y) - 1` of 0 <= y <= 80, relative error below 3e-7.
///
/// y = n ln 2 + r with |r| <= ln 2 / 2; expm1(r) by its Taylor series, truncated where the next
/// term is below 2e-8 of it; then 2^n expm1(r) + (2^n - 1), whose last bracket is exact.
#[inline(always)]
fn expm1<L: Lane32>(y: L) -> L {
    let number = |value: f64| L::splat(value);
    let shifted = y.mul_add(number(std::f64::consts::LOG2_E), number(f64::from(ROUND)));
    let n = shifted.add(number(f64::from(-ROUND)));
    // ln 2 in two parts, the first with so few digits that n times it is exact.
    let r = n.mul_add(number(-0.693_359_375), y);
    let r = n.mul_add(number(2.121_944_400_546_905_8e-4), r);
    let mut series = number(1.0 / 5040.0);
    for term in [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5] {
        series = series.mul_add(r, number(term));
    }
    let small = series.mul(r).mul_add(r, r);
    let power = shifted.power_of_two();
    power.mul_add(small, power.add(number(-1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::Kernel;
    use crate::network::lane::LaneJob;

    struct Conduct<'a>(&'a Foam, [f32; BLOCK_NODES]);

    impl LaneJob for Conduct<'_> {
        type Output = [f32; BLOCK_NODES];

        #[inline(always)]
        fn run<L: Lane32>(mut self) -> [f32; BLOCK_NODES] {
            self.0.conduct::<L>(0, &mut self.1);
            self.1
        }
    }

    #[test]
    fn eq_1_holds_to_5e_7_at_every_compression() {
        let law = NodeLaw { a_ohm: 2.2e8, b_per_mm: 1.4, c_ohm: 6.5e5, compliance: 1.0 };
        let order: Vec<u32> = (0..BLOCK_NODES as u32).collect();
        let foam = Foam::new(&order, &[law; BLOCK_NODES], None);
        for kernel in Kernel::ALL.into_iter().filter(|kernel| kernel.is_here()) {
            let mut worst = 0f64;
            for step in 0..4000 {
                // 1e-5 to 1e3 mm, and below zero.
                let x = (1e-5 * 10f64.powf(8.0 * f64::from(step) / 4000.0)) as f32;
                let found = kernel.run(Conduct(&foam, [x; BLOCK_NODES]));
                assert!(found.iter().all(|g| *g == found[0]), "the same in every lane");
                let exact = law.conductance_s(f64::from(x));
                worst = worst.max((f64::from(found[0]) / exact - 1.0).abs());
            }
            assert!(worst < 5e-7, "{}: {worst:e}", kernel.name());
            let rest = kernel.run(Conduct(&foam, [0.0; BLOCK_NODES]));
            assert_eq!(
                kernel.run(Conduct(&foam, [-3.0; BLOCK_NODES])),
                rest,
                "uplift is no compression"
            );
        }
    }

    #[test]
    fn a_node_without_foam_conducts_nothing() {
        let foam = Foam::new(&[7], &[], None);
        assert_eq!(Kernel::detect().run(Conduct(&foam, [2.0; BLOCK_NODES])), [0.0; BLOCK_NODES]);
    }
}
