//! Closed loops: controller, plant, sensors, estimators, and plants in another process.

#[path = "../common/commands.rs"]
mod commands;
#[path = "../common/estimating.rs"]
mod estimating;
#[path = "../common/rates.rs"]
mod rates;
#[path = "../common/serving.rs"]
mod serving;
#[path = "../common/tracking.rs"]
mod tracking;

mod mpc;
mod mpc_actuators;
mod mpc_cantilever;
mod mpc_estimators;
mod mpc_failures;
mod mpc_gate;
mod mpc_held;
mod mpc_hold;
mod mpc_inbox;
mod mpc_kalman;
mod mpc_knots;
mod mpc_limits;
mod mpc_loop;
mod mpc_maxima;
mod mpc_model;
mod mpc_noise;
mod mpc_poses;
mod mpc_sensors;
mod mpc_serving;
mod mpc_serving_talk;
mod mpc_stopping;
mod mpc_subproblem;
mod mpc_terminal;
mod mpc_transfer;
mod mpc_units;
mod mpc_winches;
mod retracing;
