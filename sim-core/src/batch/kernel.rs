//! The vector instructions of the lanes: selected at run time, named in manifests.
//! Uses: `network::lane` and its x86 kinds. Never: the model.

use crate::network::lane::{Lane32, LaneJob, Portable};
#[cfg(target_arch = "x86_64")]
use crate::network::lane_x86;

/// Vector instructions of the lanes. The last digits of a frame may differ between kernels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kernel {
    /// Sixteen lanes, AVX-512.
    Avx512F32x16,
    /// Eight lanes, AVX2 and FMA.
    Avx2F32x8,
    /// Eight lanes, any processor.
    PortableF32x8,
}

impl Kernel {
    /// All kernels, the fastest first.
    pub const ALL: [Self; 3] = [Self::Avx512F32x16, Self::Avx2F32x8, Self::PortableF32x8];

    /// Returns the fastest kernel that this processor supports.
    pub fn detect() -> Self {
        Self::ALL.into_iter().find(|kernel| kernel.is_here()).unwrap_or(Self::PortableF32x8)
    }

    /// Whether this processor supports the kernel.
    pub fn is_here(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512F32x16 => lane_x86::has_avx512(),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2F32x8 => lane_x86::has_avx2(),
            #[cfg(not(target_arch = "x86_64"))]
            Self::Avx512F32x16 | Self::Avx2F32x8 => false,
            Self::PortableF32x8 => true,
        }
    }

    /// Name of the kernel in manifests.
    pub fn name(self) -> &'static str {
        match self {
            Self::Avx512F32x16 => "avx512-f32x16",
            Self::Avx2F32x8 => "avx2-f32x8",
            Self::PortableF32x8 => "portable-f32x8",
        }
    }

    /// Number of trials in one vector.
    pub fn lanes(self) -> usize {
        match self {
            Self::Avx512F32x16 => 16,
            Self::Avx2F32x8 | Self::PortableF32x8 => 8,
        }
    }

    /// Does `count` multiply-adds in each lane and returns a number that depends on all of them.
    /// The time of this call determines the processor's peak rate.
    pub fn multiply_adds(self, count: usize) -> f32 {
        self.run(Peak { count })
    }

    /// Runs a job in this kernel's lanes, or in portable ones if the processor does not support it.
    pub(super) fn run<J: LaneJob>(self, job: J) -> J::Output {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512F32x16 if lane_x86::has_avx512() => lane_x86::on_avx512(job),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2F32x8 if lane_x86::has_avx2() => lane_x86::on_avx2(job),
            _ => job.run::<Portable>(),
        }
    }
}

/// The job of [`Kernel::multiply_adds`]: twelve independent sums.
struct Peak {
    count: usize,
}

impl LaneJob for Peak {
    type Output = f32;

    #[inline(always)]
    fn run<L: Lane32>(self) -> f32 {
        let mut sums = [L::splat(1.0); 12];
        let factor = L::splat(0.999);
        for _ in 0..self.count.div_ceil(sums.len()) {
            for sum in &mut sums {
                *sum = sum.mul_add(factor, factor);
            }
        }
        let mut all = sums[0];
        for sum in &sums[1..] {
            all = all.add(*sum);
        }
        let mut numbers = [0.0; 16];
        all.store(&mut numbers);
        numbers[0]
    }
}
