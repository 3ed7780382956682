//! `[fluid]` in every verb: simulations, solves with their certificate, loops, and fits.

#![cfg(feature = "cli")]

use crate::desk::Desk;
use crate::tool;

use std::fmt::Write as _;
use std::fs;

use softarm::output::MotionRecord;
use tool::DONE;

/// A silicone arm that hangs in water, which two opposed tendons pull toward a point.
const ARM: &str = "\
[rod]
length_m = 0.3
elements = 8
[rod.material]
youngs_modulus_pa = 1e5
poisson_ratio = 0.4
density_kg_m3 = 1070.0
[rod.section]
radius_m = 0.01
[base]
direction = [0.0, 0.0, -1.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
internal_s = 5e-3
[fluid]
density_kg_m3 = 1000.0
[[tendon]]
name = \"front\"
offset_m = [0.008, 0.0]
tension_n = [0.0, 2.0]
[[tendon]]
name = \"back\"
offset_m = [-0.008, 0.0]
tension_n = [0.0, 2.0]
[time]
end_s = 0.4
[task]
position_m = [0.03, 0.0, -0.29]
hard = false
weight = 1e4
at_rest = false
";

/// Solves in water, by explicit and by implicit steps: all derivatives are those of differences, and results are certified by code that
/// computes the fluid by itself. The same efforts in air lead elsewhere.
#[test]
fn solves_in_water_are_certified() {
    let desk = Desk::holding(ARM);
    for scheme in ["explicit", "implicit"] {
        let set = format!("--set time.integrator={scheme}");
        let found = desk.done(&format!("derivatives arm.toml {set}"));
        assert_eq!(found["verdict"], "ok", "{scheme}: {found}");
        let summary = desk.done(&format!("solve arm.toml --out {scheme} {set}"));
        assert_eq!(summary["check"]["verdict"], "certified", "{scheme}");
        desk.done(&format!("verify {scheme}"));
        let page = fs::read_to_string(desk.path(scheme).join("report.html")).unwrap();
        assert!(page.contains("drag 1.2 across and 0.01 along"), "{scheme}");
    }
    // A result whose scene has another fluid is no longer one.
    let scene = fs::read_to_string(desk.path("explicit/scene.toml")).unwrap();
    let other = scene.replace("density_kg_m3 = 1000.0", "density_kg_m3 = 900.0");
    assert_ne!(scene, other);
    fs::write(desk.path("explicit/scene.toml"), other).unwrap();
    let (code, _, talk) = desk.run("verify explicit");
    assert_ne!(code, DONE, "{talk}");
}

/// In a loop the controller's model has the fluid, and the arm keeps to its way in it.
#[test]
fn loops_hold_their_way_in_water() {
    let desk = Desk::holding(ARM);
    let water = "--set fluid.density_kg_m3=1000.0 --set rod.material.density_kg_m3=1100.0";
    let line = "mpc mpc-tendons --set mpc.duration_s=4.0";
    let summary = desk.done(&format!("{line} --out loop {water}"));
    let off = summary["tip_error_over_length"]["rms"].as_f64().unwrap();
    assert!(off < 2e-3, "{off}");
}

/// A recorded motion in water gives back the drag that slowed it.
#[test]
fn fits_find_the_drag() {
    let desk = Desk::holding(ARM);
    let line = "simulate arm.toml --out made --set time.step_s=2e-4 --set output.rate_hz=50.0 --set fluid.normal_drag=2.0 \
                --set initial.shape=equilibrium --set load.0.node=tip --set load.0.force_n=[0.05,0.0,0.0] \
                --set load.0.profile=[[-1.0,1.0],[0.0,1.0]] --set time.end_s=1.0";
    desk.done(line);
    let motion = MotionRecord::read_npz(&desk.path("made/trajectory.npz")).unwrap();
    let mut table = String::from("t_s,tip_x_m,tip_y_m,tip_z_m\n");
    for (row, t) in motion.t.iter().enumerate() {
        let tip = 3 * ((row + 1) * motion.n_nodes - 1);
        let x = &motion.x[tip..tip + 3];
        let _ = writeln!(table, "{t},{},{},{}", x[0], x[1], x[2]);
    }
    fs::write(desk.path("swing.csv"), table).unwrap();
    let data = "sigma_m = 1e-4\n[[marker]]\nname = \"tip\"\nat = 1.0\n[[recording]]\ncsv = \"swing.csv\"\n";
    fs::write(desk.path("data.toml"), data).unwrap();
    let summary = desk.done(
        "fit arm.toml --data data.toml --free fluid.normal_drag --out fit --set initial.shape=equilibrium \
         --set load.0.node=tip --set load.0.force_n=[0.05,0.0,0.0] --set load.0.profile=[[-1.0,1.0],[0.0,1.0]] \
         --set time.end_s=1.0",
    );
    let found = summary["parameters"][0]["value"].as_f64().unwrap();
    assert!((found - 2.0).abs() < 2e-2, "{found}");
}

/// A fluid around an arm whose surface is unknown is refused, and the message names what is missing.
#[test]
fn a_fluid_needs_a_radius() {
    let desk = Desk::holding(ARM);
    let without = ARM.replace(
        "[rod.material]\nyoungs_modulus_pa = 1e5\npoisson_ratio = 0.4\ndensity_kg_m3 = 1070.0\n[rod.section]\nradius_m = 0.01\n",
        "[rod.stiffness]\nga_n = 10.0\nea_n = 30.0\nei_n_m2 = 1e-3\ngj_n_m2 = 1e-3\n[rod.inertia]\nmass_kg_m = 0.3\nrotary_kg_m = [1e-5, 1e-5, 2e-5]\n",
    );
    fs::write(desk.path("line.toml"), without).unwrap();
    let (code, _, talk) = desk.run("check line.toml");
    assert_ne!(code, DONE);
    assert!(talk.contains("rod.display_radius_m"), "{talk}");
}
