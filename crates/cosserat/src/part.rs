//! Parts of kernels that are compiled as functions of their own.
//!
//! A kernel is one function for the compiler: all that it calls is inlined, since only then the vector instructions are available to it.
//! Code that stands in it at several places, or is there for few motions, would make it long, and compilers take more than their share for
//! long functions.

use pulp::{Simd, WithSimd};

/// A part of a kernel, with its arguments as fields.
pub trait Part {
    /// The result of the part.
    type Output;

    /// Runs the part. Implementations are `#[inline(always)]`, and take closures only where no vectors are computed in them: a closure is
    /// compiled for the least processor.
    fn run(self) -> Self::Output;
}

/// Runs a part of a kernel for the vectors of `simd` as a function that exists once. Arguments and result go through memory; arguments are
/// best given by value, so that a kernel that leaves the part out keeps them in registers.
#[inline(always)]
pub fn apart<S: Simd, P: Part>(simd: S, part: P) -> P::Output {
    if const { S::F64_LANES <= 2 } {
        plainly(part)
    } else {
        simd.vectorize(Whole(part))
    }
}

/// Every processor has vectors of two numbers.
#[inline(never)]
fn plainly<P: Part>(part: P) -> P::Output {
    part.run()
}

struct Whole<P>(P);

impl<P: Part> WithSimd for Whole<P> {
    type Output = P::Output;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> P::Output {
        self.0.run()
    }
}
