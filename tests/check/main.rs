//! The certificate of a solution, the verification of its files, and the optima of another method.

#[path = "../common/mod.rs"]
mod common;
#[cfg(feature = "cli")]
#[path = "../tool/mod.rs"]
mod tool;

mod certificate;
mod named_controls;
mod second_opinion;
mod tampered_contact;
mod tampered_efforts;
mod tampered_results;
