//! The vector instructions that kernels take.

use std::sync::atomic::{AtomicU8, Ordering};

use pulp::{Arch, Scalar128b, Simd, WithSimd};

/// A set of vector instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum InstructionSet {
    /// What every processor has.
    Baseline,
    /// AVX2 on x86-64.
    Avx2,
    /// All that the processor has.
    Best,
}

static MOST: AtomicU8 = AtomicU8::new(InstructionSet::Best as u8);

/// Limits the instructions of all kernels of this process, for measurements: motions are the same to the bit.
pub fn limit_instructions(most: InstructionSet) {
    MOST.store(most as u8, Ordering::Relaxed);
}

/// Returns the instructions that kernels take: the best that this processor has within the limit.
#[inline]
#[must_use]
pub fn instructions() -> Arch {
    let most = MOST.load(Ordering::Relaxed);
    if most == InstructionSet::Best as u8 {
        return Arch::new();
    }
    limited(most)
}

#[cold]
fn limited(most: u8) -> Arch {
    #[cfg(target_arch = "x86_64")]
    if most == InstructionSet::Avx2 as u8
        && let Some(simd) = pulp::x86::V3::try_new()
    {
        return Arch::V3(simd);
    }
    let _ = most;
    Arch::Scalar
}

/// Runs work on the widest available vectors; with two doubles if the processor offers no more.
pub fn dispatch<W: WithSimd>(arch: Arch, work: W) -> W::Output {
    // The dispatch of `pulp` would compile all work once more, for single numbers.
    #[cfg(target_arch = "x86_64")]
    match arch {
        Arch::V4(simd) => Simd::vectorize(simd, work),
        Arch::V3(simd) => Simd::vectorize(simd, work),
        _ => work.with_simd(Scalar128b),
    }
    #[cfg(not(target_arch = "x86_64"))]
    match arch {
        Arch::Scalar => work.with_simd(Scalar128b),
        _ => arch.dispatch(work),
    }
}

/// Work that finds the number of lanes of the vectors.
pub struct CountLanes;

impl WithSimd for CountLanes {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> usize {
        S::F64_LANES
    }
}
