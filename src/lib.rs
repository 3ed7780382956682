//! Optimal control of soft arms.
//!
//! A soft arm is a discrete geometrically exact (Cosserat) rod, advanced by a Lie group variational integrator
//! ([`mechanics`]). Its discrete equations of motion are the equality constraints of an optimal-control problem
//! ([`control`]), which a sequential quadratic programming method solves with Clarabel ([`sqp`]). Every result is
//! re-checked by code that shares no assembly with the solver ([`verify`]).
//!
//! ```text
//! text → Scene → Rod, OptimalControlProblem → Transcription → QuadraticProgram → … SqpOutcome → ForwardCheck → files
//! ```
//!
//! Source of the integrator: S. Siddharth, V. Natarajan, R. N. Banavar, "Lie Group Variational Integrator for the
//! Geometrically Exact Rod with Circular Cross-Section Incorporating Cross-Sectional Deformation" ("the paper"; its
//! equation numbers stand in round brackets). All quantities are in SI units.

#![forbid(unsafe_code)]

pub mod cli;
pub mod control;
pub mod derivatives;
pub mod mechanics;
pub mod memory;
pub mod output;
pub mod paper;
pub mod scene;
pub mod sqp;
pub mod stop;
pub mod task;
pub mod verify;

/// The README's example, compiled and run by the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
