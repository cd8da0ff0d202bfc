//! A lane vector: one number of each of several loads, processed in parallel.
//! Uses: std alone. Never: a sum or a comparison across lanes (a load's result must not depend on
//! its neighbours).
//!
//! The kernels of this crate are written once over [`Lane`]. `f64` is a vector of one; [`Portable`]
//! is an array that the compiler may map to any vectors; `lane_x86` has AVX2 and AVX-512.

/// Numbers of several loads, one per lane.
pub(crate) trait Lane: Copy + Send + Sync + 'static {
    /// Type of one load's number.
    type Number: Copy;
    /// Number of loads.
    const LANES: usize;
    /// Number of columns of a 4 x 4 tile whose sums fit into the registers at once: 2 or 4.
    const COLUMNS_AT_ONCE: usize;

    /// Returns the same number in every lane.
    fn splat(value: f64) -> Self;

    /// Reads the first `LANES` numbers of a slice.
    fn load(numbers: &[Self::Number]) -> Self;

    /// Writes the first `LANES` numbers of a slice.
    fn store(self, numbers: &mut [Self::Number]);

    /// Sum in each lane.
    fn add(self, other: Self) -> Self;

    /// Product in each lane.
    fn mul(self, other: Self) -> Self;

    /// `self * factor + addend`, rounded once if the processor supports it.
    fn mul_add(self, factor: Self, addend: Self) -> Self;

    /// `1 / self`, but at most 1e36: zero times it is zero.
    fn reciprocal(self) -> Self;

    /// Square root in each lane.
    fn sqrt(self) -> Self;
}

/// Lanes of f32, with the additional operations of the foam's law.
pub(crate) trait Lane32: Lane<Number = f32> {
    /// Quotient in each lane.
    fn div(self, other: Self) -> Self;

    /// Smaller number in each lane.
    fn min(self, other: Self) -> Self;

    /// Larger number in each lane.
    fn max(self, other: Self) -> Self;

    /// 2^n of `self = ROUND + n`, n = 0, 1, .. 127.
    fn power_of_two(self) -> Self;
}

/// Adding this rounds an f32 (below 2^22) to a whole number, which is then in its lowest bits.
pub(crate) const ROUND: f32 = 12_582_912.0;

/// A smaller sum of conductances counts as zero, S.
pub(super) const LEAST_SUM_S: f64 = 1e-36;

/// A job that can run in lanes of every kind.
pub(crate) trait LaneJob {
    /// Result of the job.
    type Output;

    /// Runs the job. Implementations are `#[inline(always)]`, as is everything that they call in
    /// lanes: only then does the compiler use the processor's features in them.
    fn run<L: Lane32>(self) -> Self::Output;
}

impl Lane for f64 {
    type Number = f64;
    const LANES: usize = 1;
    const COLUMNS_AT_ONCE: usize = 4;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn load(numbers: &[f64]) -> Self {
        numbers[0]
    }

    #[inline(always)]
    fn store(self, numbers: &mut [f64]) {
        numbers[0] = self;
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self + other
    }

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self * other
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, addend: Self) -> Self {
        self * factor + addend
    }

    #[inline(always)]
    fn reciprocal(self) -> Self {
        1.0 / self.max(LEAST_SUM_S)
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        self.sqrt()
    }
}

/// Eight f32 without instructions of a particular processor.
#[derive(Debug, Clone, Copy)]
#[repr(align(32))]
pub(crate) struct Portable([f32; 8]);

impl Portable {
    #[inline(always)]
    fn zip(mut self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        for (i, a) in self.0.iter_mut().enumerate() {
            *a = f(*a, other.0[i]);
        }
        self
    }
}

impl Lane for Portable {
    type Number = f32;
    const LANES: usize = 8;
    const COLUMNS_AT_ONCE: usize = 2;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        Self([value as f32; 8])
    }

    #[inline(always)]
    fn load(numbers: &[f32]) -> Self {
        Self(*numbers.first_chunk().expect("a whole vector is loaded"))
    }

    #[inline(always)]
    fn store(self, numbers: &mut [f32]) {
        *numbers.first_chunk_mut().expect("a whole vector is stored") = self.0;
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, addend: Self) -> Self {
        self.mul(factor).add(addend)
    }

    #[inline(always)]
    fn reciprocal(self) -> Self {
        self.zip(self, |a, _| 1.0 / a.max(LEAST_SUM_S as f32))
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        self.zip(self, |a, _| a.sqrt())
    }
}

impl Lane32 for Portable {
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.zip(other, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.zip(other, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    fn power_of_two(self) -> Self {
        self.zip(self, |a, _| f32::from_bits((a.to_bits() << 23).wrapping_add(1f32.to_bits())))
    }
}
