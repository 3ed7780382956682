//! Equilibria of the rod and small vibrations about them, against closed forms and the literature.

#[path = "../common/mod.rs"]
mod common;

mod contacts;
mod ends;
mod friction;
mod pose_actuators;
mod published_frequencies;
mod published_statics;
mod sections;
mod statics;
mod strain_actuators;
mod vibration;
mod winches;
