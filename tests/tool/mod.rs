//! The command line's exit codes, and a scene that it solves in a blink.

#![allow(dead_code)] // no test program uses all of it

use std::time::Duration;

/// A run that takes longer hangs, however busy the machine: runs of the tests take seconds.
pub const HANGS: Duration = Duration::from_secs(3600);

pub const DONE: i32 = 0;
pub const USAGE: i32 = 2;
pub const NOT_CONVERGED: i32 = 3;
pub const INFEASIBLE: i32 = 4;
pub const NUMERICAL: i32 = 5;
pub const STOPPED: i32 = 6;
pub const REJECTED: i32 = 7;
pub const UNWRITTEN: i32 = 8;

/// Four elements, 0.3 s, five blocks: solved in a blink.
pub const SCENE: &str = "\
[rod]
length_m = 1.0
elements = 4
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.05
[damping]
viscous_1_s = 1.0
[time]
end_s = 0.3
[task]
position_m = [0.1, 0.03, 0.985]
at_rest = false
[control]
blocks = 5
hold = \"constant\"
force_max_n = 20.0
moment_max_n_m = 5.0
[control.feedback]
";
