//! Loops in other units of length, mass and time: nothing that a loop assumes of an arm is a number of meters, kilograms or seconds, beside the
//! periods and the price of effort (per second) that the reference of keys gives as defaults.

use std::ops::ControlFlow;

use nalgebra::Vector3;
use softarm::mpc::Contender;
use softarm::scene::Scene;
use softarm::stop::StopSignal;

/// A loop whose plant differs from its model in all that a filter estimates, with every period given.
const LOOP: &str = "
[rod]
length_m = 0.3
elements = 8
[rod.material]
youngs_modulus_pa = 6e5
poisson_ratio = 0.45
density_kg_m3 = 1080.0
[rod.section]
radius_m = 0.015
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
viscous_1_s = 1.0
[time]
end_s = 0.8
[task]
position_m = [0.08, 0.04, 0.26]
tolerance_m = 3e-3
[control]
force_max_n = 2.0
[objective]
effort = 1.0
[plant]
stiffness_factor = 0.9
viscous_1_s = 1.3
payload = { mass_kg = 0.01 }
actuator = { delay_s = 0.005 }
[mpc]
period_s = 0.01
actuator_delay_s = 0.0
[[sensor]]
places = [0.5, 1.0]
position_sigma_m = 1e-3
rotation_sigma_rad = 0.01
rate_hz = 50.0
age_s = 0.005
[estimator]
kind = \"kalman\"
";

/// A unit as powers of those of length, mass and time, by the end of a key's name; a longer end stands before its own end. The weight of
/// effort is per second.
const UNITS: [(&str, [i32; 3]); 15] = [
    ("effort", [0, 0, -1]),
    ("_kg_m3", [-3, 1, 0]),
    ("_m_s2", [1, 0, -2]),
    ("_n_m", [2, 1, -2]),
    ("_1_s", [0, 0, -1]),
    ("_1_m", [-1, 0, 0]),
    ("_m_s", [1, 0, -1]),
    ("_rad_s", [0, 0, -1]),
    ("_rad", [0, 0, 0]),
    ("_kg", [0, 1, 0]),
    ("_hz", [0, 0, -1]),
    ("_pa", [-1, 1, -2]),
    ("_n", [1, 1, -2]),
    ("_m", [1, 0, 0]),
    ("_s", [0, 0, 1]),
];

/// Writes every number under keys with a unit in other ones, of which ours are `units` times as large.
fn rewrite(value: &mut toml::Value, factor: f64, units: [f64; 3]) {
    match value {
        toml::Value::Table(table) => {
            for (key, value) in table {
                let powers = UNITS.iter().find(|(end, _)| key.ends_with(end));
                let factor = powers.map_or(1.0, |(_, powers)| {
                    (0..3).map(|k| units[k].powi(powers[k])).product()
                });
                rewrite(value, factor, units);
            }
        }
        toml::Value::Array(all) => all
            .iter_mut()
            .for_each(|value| rewrite(value, factor, units)),
        toml::Value::Float(number) => *number *= factor,
        _ => {}
    }
}

/// The tip's places of a loop in these units, m of ours, and the default patience in our seconds.
fn motion(text: &str, units: [f64; 3]) -> (Vec<Vector3<f64>>, f64) {
    let mut scene: toml::Value = toml::from_str(text).unwrap();
    rewrite(&mut scene, 1.0, units);
    let (scene, source) =
        Scene::from_toml("units", &toml::to_string(&scene).unwrap(), &[]).unwrap();
    let setup = (scene.closed_loop(&source, 1, &StopSignal::default())).unwrap();
    let run = (setup.experiment)
        .run(Contender::Mpc, &mut |_, _| ControlFlow::Continue(()))
        .unwrap();
    let places = (run.samples.iter()).map(|sample| Vector3::from(sample.tip) / units[0]);
    let patience = setup.experiment.settings.fallback.patience.unwrap();
    (places.collect(), patience / units[2])
}

/// A loop of a wrong model with all unknowns, in millimeters, grams and milliseconds, and of an arm that is large, heavy and slow, is the one
/// in our units, to what rounding grows to; with the given rate of unknown wrenches as well.
#[test]
fn loops_are_the_same_in_any_unit() {
    for changed in ["", "wrench_change_1_s = 0.05\n"] {
        let text = format!("{LOOP}{changed}");
        let (places, patience) = motion(&text, [1.0; 3]);
        for units in [[1e3, 1e3, 1e3], [7.0, 300.0, 11.0]] {
            let (others, other) = motion(&text, units);
            assert_eq!(places.len(), others.len());
            let off = (places.iter().zip(&others)).map(|(a, b)| (a - b).norm());
            let off = off.fold(0.0, f64::max);
            println!("{units:?} {off:e} {patience} {other}");
            assert!(off < 1e-7, "{units:?} {off}");
            assert!((patience / other - 1.0).abs() < 1e-12);
        }
    }
}
