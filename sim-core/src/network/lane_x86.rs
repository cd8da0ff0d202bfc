//! Lane vectors of x86: AVX-512, and AVX2 with FMA. The only file of this crate with `unsafe`.
//! Uses: std's intrinsics. Never: a value of a lane type on a processor without its instructions.
//!
//! Soundness: an intrinsic may only run on a processor that supports it. No other file names the
//! two types; a job runs in them only through [`on_avx512`] and [`on_avx2`], which check the processor
//! first.
//! The other uses of `unsafe` here are two loads and two stores, of references to arrays.
#![expect(unsafe_code, reason = "vector instructions; every one of this crate is in this file")]
#![allow(clippy::wildcard_imports, reason = "thirty-two intrinsics, recognised by their names")]

use std::arch::x86_64::*;

use super::lane::{LEAST_SUM_S, Lane, Lane32, LaneJob};

/// Whether the processor supports AVX-512 (foundation) and FMA.
pub(crate) fn has_avx512() -> bool {
    is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("fma")
}

/// Whether the processor supports AVX2 and FMA.
pub(crate) fn has_avx2() -> bool {
    is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")
}

/// Runs a job in lanes of sixteen. Panics if the processor does not support them.
pub(crate) fn on_avx512<J: LaneJob>(job: J) -> J::Output {
    #[target_feature(enable = "avx512f,avx2,fma")]
    fn run<J: LaneJob>(job: J) -> J::Output {
        job.run::<F32x16>()
    }
    assert!(has_avx512(), "avx512 was chosen on a processor without it");
    // SAFETY: the processor has the features.
    unsafe { run(job) }
}

/// Runs a job in lanes of eight. Panics if the processor does not support them.
pub(crate) fn on_avx2<J: LaneJob>(job: J) -> J::Output {
    #[target_feature(enable = "avx2,fma")]
    fn run<J: LaneJob>(job: J) -> J::Output {
        job.run::<F32x8>()
    }
    assert!(has_avx2(), "avx2 was chosen on a processor without it");
    // SAFETY: the processor has the features.
    unsafe { run(job) }
}

/// Implements the operations of lanes for a register of f32, by its intrinsics.
macro_rules! lanes {
    (
        $lanes:ident, $count:literal in $columns:literal columns,
        $splat:ident, $load:ident, $store:ident, $add:ident, $mul:ident, $mul_add:ident, $sqrt:ident,
        $div:ident, $min:ident, $max:ident,
        $shift_left:ident, $bits:ident, $of_bits:ident, $splat_bits:ident, $add_bits:ident $(,)?
    ) => {
        impl Lane for $lanes {
            type Number = f32;
            const LANES: usize = $count;
            const COLUMNS_AT_ONCE: usize = $columns;

            #[inline(always)]
            fn splat(value: f64) -> Self {
                // SAFETY: see the head of this file.
                unsafe { Self($splat(value as f32)) }
            }

            #[inline(always)]
            fn load(numbers: &[f32]) -> Self {
                let numbers: &[f32; $count] =
                    numbers.first_chunk().expect("a whole vector is loaded");
                // SAFETY: see the head of this file; the pointer is to a whole vector.
                unsafe { Self($load(numbers.as_ptr())) }
            }

            #[inline(always)]
            fn store(self, numbers: &mut [f32]) {
                let numbers: &mut [f32; $count] =
                    numbers.first_chunk_mut().expect("a whole vector is stored");
                // SAFETY: see the head of this file; the pointer is to a whole vector.
                unsafe { $store(numbers.as_mut_ptr(), self.0) }
            }

            lanes!(pairs: add $add, mul $mul);

            #[inline(always)]
            fn mul_add(self, factor: Self, addend: Self) -> Self {
                // SAFETY: see the head of this file.
                unsafe { Self($mul_add(self.0, factor.0, addend.0)) }
            }

            #[inline(always)]
            fn reciprocal(self) -> Self {
                Self::splat(1.0).div(self.max(Self::splat(LEAST_SUM_S)))
            }

            #[inline(always)]
            fn sqrt(self) -> Self {
                // SAFETY: see the head of this file.
                unsafe { Self($sqrt(self.0)) }
            }
        }

        impl Lane32 for $lanes {
            lanes!(pairs: div $div, min $min, max $max);

            #[inline(always)]
            fn power_of_two(self) -> Self {
                // SAFETY: see the head of this file.
                unsafe {
                    let exponent = $shift_left::<23>($bits(self.0));
                    let one = $splat_bits(1f32.to_bits() as i32);
                    Self($of_bits($add_bits(exponent, one)))
                }
            }
        }
    };
    (pairs: $($operation:ident $intrinsic:ident),+) => {
        $(
            #[inline(always)]
            fn $operation(self, other: Self) -> Self {
                // SAFETY: see the head of this file.
                unsafe { Self($intrinsic(self.0, other.0)) }
            }
        )+
    };
}

/// Sixteen f32 in an AVX-512 register.
#[derive(Clone, Copy)]
#[repr(transparent)]
pub(crate) struct F32x16(__m512);

/// Eight f32 in an AVX register.
#[derive(Clone, Copy)]
#[repr(transparent)]
pub(crate) struct F32x8(__m256);

lanes! {
    F32x16, 16 in 4 columns,
    _mm512_set1_ps, _mm512_loadu_ps, _mm512_storeu_ps, _mm512_add_ps, _mm512_mul_ps, _mm512_fmadd_ps, _mm512_sqrt_ps,
    _mm512_div_ps, _mm512_min_ps, _mm512_max_ps,
    _mm512_slli_epi32, _mm512_castps_si512, _mm512_castsi512_ps, _mm512_set1_epi32, _mm512_add_epi32,
}

lanes! {
    F32x8, 8 in 2 columns,
    _mm256_set1_ps, _mm256_loadu_ps, _mm256_storeu_ps, _mm256_add_ps, _mm256_mul_ps, _mm256_fmadd_ps, _mm256_sqrt_ps,
    _mm256_div_ps, _mm256_min_ps, _mm256_max_ps,
    _mm256_slli_epi32, _mm256_castps_si256, _mm256_castsi256_ps, _mm256_set1_epi32, _mm256_add_epi32,
}
