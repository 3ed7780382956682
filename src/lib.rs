//! Optimal control of soft arms.
//!
//! A soft arm is a discrete geometrically exact (Cosserat) rod, advanced by a Lie group variational integrator
//! ([`mechanics`]). Its discrete equations of motion are the equality constraints of an optimal-control problem
//! ([`control`]), which a sequential quadratic programming method solves with Clarabel ([`sqp`]). Every result is
//! re-checked by code that shares no assembly with the solver ([`verify`]).
//!
//! ```text
//! minimize    effort/2 ∫ |u/u_s|² dt + …                 over the wrenches u(t) on the arm
//! subject to  the discrete equations of motion (77) of the positions and (81) of the rotations,
//!             goals       c(x, R, p, π) = 0 or within a tolerance, at the end and on the way
//!             bounds      |u| ≤ u_max, |u̇| ≤ u̇_max
//!             limits      obstacles, stretch, curvature, twist, speed, at all times
//! ```
//!
//! An [`Arm`](task::Arm) has no elements and a [`Task`](task::Task) no time steps: a [`Discretization`](task::Discretization) adds both.
//!
//! ```
//! use softarm::mechanics::Material;
//! use softarm::nalgebra::Vector3;
//! use softarm::task::{Arm, Discretization, Task};
//!
//! let silicone = Material::isotropic(1e6, 0.5, 1000.0); // E in Pa, Poisson's ratio, density in kg/m³
//! let arm = Arm::cylinder(&silicone, 1.0, 0.05); // length and radius in m
//! let task = Task::reach(Vector3::new(0.4, 0.0, 0.85), 1.0, 20.0); // where, after how long, the largest force in N
//! let solution = softarm::solve(&arm, &task, &Discretization::with_elements(6))?;
//! assert!(solution.certify()?.is_certified());
//! # let folder = tempfile::tempdir()?;
//! # let results = folder.path();
//! solution.save(&results.join("reach"))?; // what `softarm verify` reads, and a report
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | module | use |
//! |---|---|
//! | [`task`] | describe an arm, a task and a discretization |
//! | [`solve`](mod@solve) | solve, certify, regulate, save |
//! | [`mpc`] | close the loop on a measured state |
//! | [`scene`] | read all of it from a TOML file |
//! | [`mechanics`] | simulate a rod, find its equilibria and frequencies |
//! | [`control`] | work with the discrete optimal-control problem |
//! | [`sqp`] | solve a nonlinear program |
//! | [`verify`] | check a solution by other code |
//! | [`output`] | read and write result directories |
//!
//! Source of the integrator: S. Siddharth, V. Natarajan, R. N. Banavar, "Lie Group Variational Integrator for the Geometrically Exact Rod
//! with Circular Cross-Section Incorporating Cross-Sectional Deformation" ("the paper"; its equation numbers are given in round brackets).
//! All quantities are in SI units.

#![forbid(unsafe_code)]

#[cfg(feature = "cli")]
#[doc(hidden)]
pub mod cli;
#[doc(hidden)]
pub mod derivatives;
#[cfg(feature = "cli")]
pub(crate) mod fit;
#[doc(hidden)]
pub mod memory;
pub mod scene;
pub mod solve;
pub mod tradeoff;

#[doc(inline)]
pub use {control, mechanics, mpc, output, sqp, stop, task, verify};

#[cfg(feature = "cli")]
pub(crate) use mpc::TOOL;
pub(crate) use stop::clock;

pub use solve::solve;

/// The linear algebra crate whose dense matrices of any size this library uses in its interface, in the version with which it is built.
pub use faer;

/// The linear algebra crate whose vectors and small matrices this library uses in its interface, in the version with which it is built.
pub use nalgebra;

/// The README's example, compiled and run by the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
