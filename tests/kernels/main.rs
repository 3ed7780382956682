//! Parts of the vectorized kernels, which only tests see by themselves. They stand here, and not beside the kernels, so that tests do not
//! compile these a second time.

mod chain;
mod lanes;
mod linearize;
mod reduction;
mod team;
mod turn;
