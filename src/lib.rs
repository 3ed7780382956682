//! softarm
pub mod mechanics;
pub mod output;
pub mod scene;
