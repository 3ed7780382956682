//! The certificate of a solution, the verification of its files, and the optima of another method.

#[path = "../common/mod.rs"]
mod common;
#[cfg(feature = "cli")]
#[path = "../tool/mod.rs"]
mod tool;

mod certificate;
mod control_splines;
mod doubt;
mod dual_numbers;
mod finer_rods;
mod named_controls;
mod sample_durations;
mod second_opinion;
mod tampered_contact;
mod tampered_efforts;
mod tampered_results;
