//! Equilibria of the rod and small vibrations about them, against closed forms and the literature.

#[path = "../common/mod.rs"]
mod common;

mod beams;
mod contacts;
mod direction;
mod ends;
mod energy_norm;
mod friction;
mod learned;
mod pose_actuators;
mod published_frequencies;
mod published_statics;
mod sections;
mod shapes_at_rest;
mod slow_modes;
mod springs;
mod statics;
mod strain_actuators;
mod vibration;
mod winches;
