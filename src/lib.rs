//! softarm
pub mod mechanics;
pub mod output;
pub mod scene;
pub mod control;
pub mod sqp;
pub mod verify;
