//! The nonlinear program's solver: programs without a rod, subproblems by two routes, and solves that go on.

#[path = "../common/mod.rs"]
mod common;
#[path = "../toy/mod.rs"]
mod toy;

mod balls;
mod progress;
mod qp_elastic;
mod qp_oracle;
mod qp_polish;
mod qp_routes;
mod sqp_inequalities;
mod sqp_programs;
mod warm_start;
