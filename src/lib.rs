//! softarm
pub mod mechanics;
