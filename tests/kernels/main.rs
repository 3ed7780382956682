//! Parts of the vectorized kernels, which only tests see by themselves. They stand here, and not beside the kernels, so that tests do not
//! compile these a second time.

mod block_tridiagonal;
mod chain;
mod lanes;
mod linearize;
mod logarithm;
mod reduction;
mod rotation_step;
mod team;
mod turn;

use pulp::Arch;

/// Instruction sets that this machine has.
fn levels() -> Vec<Arch> {
    let mut levels = vec![Arch::Scalar];
    #[cfg(target_arch = "x86_64")]
    {
        use pulp::x86::{V3, V4};
        levels.extend(V3::try_new().map(Arch::V3));
        levels.extend(V4::try_new().map(Arch::V4));
    }
    levels
}
