//! Derivatives of the motion and of the Lagrangian, by several routes.

#[path = "../common/mod.rs"]
mod common;

mod curvature;
mod derivatives;
mod feedback;
mod friction;
mod numbers;
mod resistance;
mod sensitivity;
mod tip_pull;
mod winches;
