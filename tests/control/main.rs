//! Optimal-control problems on rods: their terms, their discretization, and optima that are known.

#[path = "../common/mod.rs"]
mod common;
#[path = "../common/tracking.rs"]
mod tracking;

mod actuators;
mod advice;
mod analytic_optima;
mod axes;
mod contacts;
mod continuous;
mod couple_splines;
mod distributed;
mod ends;
mod free_duration;
mod holding;
mod holding_program;
mod holds;
mod lagging_efforts;
mod lasting;
mod optimal_control;
mod path_constraints;
mod path_rows;
mod path_tracking;
mod pointing;
mod pose_actuators;
mod regulator;
mod slow_growth;
mod soft_goals;
mod staying;
mod strain_actuators;
mod terms;
mod tilt;
mod winches;
