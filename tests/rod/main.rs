//! The rod in motion: laws of its discrete mechanics, closed forms, published motions, and the ends of what it can be asked.

#[path = "../common/mod.rs"]
mod common;

mod base_motion;
mod boundary_conditions;
mod contacts;
mod diagnostics;
mod differences;
mod discrete_action;
mod discrete_mechanics;
mod elements;
mod ends;
mod extremes;
mod fluid;
mod friction;
mod implicit;
mod lanes;
mod load_jumps;
mod loads;
mod mesh;
mod nodal_state;
mod obstacles;
mod paper;
mod pose_actuators;
mod published_dynamics;
mod resistance;
mod rotations;
mod rows;
mod section_shapes;
mod strain_actuators;
mod strain_coordinates;
mod winches;
