//! The rod in motion: laws of its discrete mechanics, closed forms, published motions, and the ends of what it can be asked.

#[path = "../common/mod.rs"]
mod common;

mod boundary_conditions;
mod contacts;
mod diagnostics;
mod discrete_action;
mod discrete_mechanics;
mod ends;
mod extremes;
mod fluid;
mod friction;
mod implicit;
mod lanes;
mod load_jumps;
mod paper;
mod pose_actuators;
mod published_dynamics;
mod strain_actuators;
mod winches;
