//! Couples along an arm: what solver, derivative check, certificate, controller and scenes make of them.

use crate::tracking;

use std::ops::ControlFlow;

use faer::Mat;
use nalgebra::Vector3;
use softarm::control::{Bound, Channel};
use softarm::derivatives::{Verdict, check};
use softarm::mechanics::{Actuator, Rod, SharedActuator, StateView, Wrench};
use softarm::mpc::{Command, Contender, Experiment, MpcError, MpcSettings};
use softarm::task::{
    ChannelLimits, ControlGroup, Discretization, DistributedCouple, OwnActuator, Task,
};

/// Bending couples of at most `most` (N m/m) at four points.
fn couples(most: f64) -> OwnActuator {
    let bound = Bound::PerAxis(Vector3::new(most, most, 0.0));
    DistributedCouple::bounded(4, bound, most)
}

fn reach() -> Task {
    let mut task = Task::reach(Vector3::new(0.2, 0.05, 0.96), 1.0, 1.0);
    task.actuators.clear();
    task.own_actuators = vec![couples(30.0)];
    task
}

/// A reach by couples alone is solved and certified: the certificate uses the wrenches alone, and differentiates them by itself.
#[test]
fn reaches_are_certified() {
    let arm = tracking::arm(1e6);
    let discretization = Discretization::with_elements(6);
    let solution = softarm::solve(&arm, &reach(), &discretization).unwrap();
    let certificate = solution.certify().unwrap();
    assert!(certificate.is_certified(), "{:?}", certificate.items);
}

/// Every derivative of the problem agrees with differences.
#[test]
fn derivatives_are_right() {
    let discretization = Discretization::with_elements(5);
    let problem = reach()
        .discretize(&tracking::arm(1e6), &discretization)
        .unwrap();
    let report = check(&problem.discrete, 0).unwrap();
    for block in &report.blocks {
        assert_ne!(block.verdict, Verdict::Wrong, "{}", block.name);
    }
}

fn track(actuator: OwnActuator) -> Experiment {
    let mut task = tracking::task(5.0);
    task.actuators.clear();
    task.own_actuators = vec![actuator];
    task.cost.rate = 0.1;
    let settings = MpcSettings {
        jump: 1.0,
        ..MpcSettings::receding(0.3)
    };
    let mut scene = Experiment::new(
        tracking::arm(1e6),
        task,
        tracking::discretization(),
        settings,
    );
    scene.duration = 1.0;
    scene.counted_from = 0.2;
    scene
}

fn commands(scene: &Experiment) -> (Vec<Command>, f64) {
    let mut commands = Vec::new();
    let run = scene.run(Contender::Mpc, &mut |sample, closed| {
        assert!(sample.fallback.is_none());
        commands.push(closed.sent().clone());
        ControlFlow::Continue(())
    });
    (commands, run.unwrap().tip_error.rms)
}

/// A closed loop by couples keeps the tip within a twentieth of what it would be off without them, where the arm is the model, and within a tenth where
/// it has twice as many elements and nine tenths of the stiffness. Moments on nodes are of values within their bounds.
#[test]
fn loops_track_by_couples() {
    let most = 12.0;
    let scene = track(couples(most));
    let mut soft = scene.clone();
    soft.plant = tracking::arm(0.9e6);
    soft.plant_discretization = Discretization::with_elements(12);
    let rod = scene.controller().unwrap().rod().clone();
    let couple = DistributedCouple {
        points: 4,
        axes: [true, true, false],
    };
    let map = couple.linear_map(&rod).unwrap();
    let still = {
        let path = &scene.task.cost.tracks[0].path;
        let counted: Vec<f64> = (path.iter())
            .filter(|(t, _)| (0.2..1.0).contains(t))
            .map(|(_, x)| (x - Vector3::new(0.0, 0.0, 1.0)).norm_squared())
            .collect();
        (counted.iter().sum::<f64>() / counted.len() as f64).sqrt()
    };
    for (scene, part) in [(scene, 0.05), (soft, 0.1)] {
        let (commands, rms) = commands(&scene);
        println!("{rms} of {still}");
        assert!(rms < part * still, "{rms} of {still}");
        for command in &commands {
            assert_eq!(command.nodes(), couple.nodes(&rod));
            for at_end in [false, true] {
                for (i, node) in command.nodes().iter().enumerate() {
                    let wrench = command.wrench_on(*node, at_end);
                    assert_eq!(wrench.force, Vector3::zeros());
                    for axis in 0..3 {
                        let row = (0..map.ncols()).map(|j| map[(6 * i + 3 + axis, j)].abs());
                        let largest = most * row.sum::<f64>();
                        assert!(wrench.moment[axis].abs() <= largest * (1.0 + 1e-9));
                    }
                }
            }
        }
    }
}

/// A force on the tip, written anew.
#[derive(Debug)]
struct TipForce {
    is_linear: bool,
}

impl Actuator for TipForce {
    fn n_controls(&self) -> usize {
        3
    }
    fn nodes(&self, rod: &Rod) -> Vec<usize> {
        vec![rod.tip()]
    }
    fn wrench(&self, _: &StateView, u: &[f64], out: &mut [Wrench]) {
        out[0] = Wrench::from_array(std::array::from_fn(|i| u.get(i).copied().unwrap_or(0.0)));
    }
    fn configuration_jacobian(&self, _: &StateView, _: &[f64]) -> Mat<f64> {
        Mat::zeros(6, 6)
    }
    fn control_jacobian(&self, _: &StateView, _: &[f64]) -> Mat<f64> {
        Mat::from_fn(6, 3, |i, j| f64::from(u8::from(i == j)))
    }
    fn linear_map(&self, rod: &Rod) -> Option<Mat<f64>> {
        let at = rod.rest.clone();
        let view = StateView {
            rod,
            time: 0.0,
            positions: &at.positions,
            rotations: &at.rotations,
        };
        self.is_linear
            .then(|| self.control_jacobian(&view, &[0.0; 3]))
    }
}

fn tip_force(is_linear: bool) -> OwnActuator {
    OwnActuator {
        actuator: SharedActuator::new(TipForce { is_linear }),
        controls: vec![ControlGroup {
            count: 3,
            channel: Channel::new(2.0, Some(Bound::Norm(5.0))),
        }],
    }
}

/// A force on the tip that is written as an actuator of one's own is commanded as the built-in one, to rounding.
#[test]
fn linear_actuators_are_as_good_as_wrenches() {
    let own = track(tip_force(true));
    let mut built_in = own.clone();
    let wrench = tracking::task(5.0).actuators[0];
    built_in.task.own_actuators.clear();
    built_in.task.actuators = vec![softarm::task::WrenchActuator {
        moment: ChannelLimits::NONE,
        ..wrench
    }];
    built_in.task.cost.force_scale = Some(2.0);
    let ([own, _], [built_in, _]) = (
        [commands(&own).0, Vec::new()],
        [commands(&built_in).0, Vec::new()],
    );
    assert_eq!(own.len(), built_in.len());
    for (own, built_in) in own.iter().zip(&built_in) {
        assert_eq!(own.nodes(), built_in.nodes());
        let [own, built_in] = [own, built_in].map(|own| own.wrench_on(own.nodes()[0], false));
        let off = (own.force - built_in.force).norm();
        assert!(off < 1e-9, "{off}");
    }
}

/// An actuator that does not say that it is linear is refused by a controller.
#[test]
fn other_actuators_are_refused() {
    let refused = track(tip_force(false)).controller().unwrap_err();
    assert!(matches!(refused, MpcError::Unsupported(what) if what.contains("linear")));
}

#[cfg(feature = "cli")]
mod program {
    use std::fs;
    use std::path::Path;
    use std::process::{Command, Output};

    const SCENE: &str = "\
[rod]
length_m = 1.0
elements = 5
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.05
[damping]
viscous_1_s = 1.0
[time]
end_s = 0.6
[control]
blocks = 6
[control.distributed]
points = 3
moment_max_n_m_per_m = [40.0, 40.0, 0.0]
";
    const REACH: &str = "\
[task]
position_m = [0.1, 0.03, 0.985]
at_rest = false
";
    const TRACK: &str = "\
[[objective.track]]
weight = 3e4
circle = { center_m = [0.0, 0.0, 0.99], radius_m = 0.1, turn_s = 2.0, from_m = [0.0, 0.0, 1.0], ramp_s = 0.5 }
[mpc]
period_s = 0.02
horizon_s = 0.3
";

    fn softarm(folder: &Path, arguments: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_softarm"))
            .args(arguments)
            .current_dir(folder)
            .env("NO_COLOR", "1")
            .output()
            .unwrap()
    }

    /// A scene with couples is solved and certified, and its files are verified by themselves; a closed loop runs on it, and tells a plant in another process
    /// on which nodes it acts.
    #[test]
    fn scenes_have_couples() {
        let folder = tempfile::tempdir().unwrap();
        let run = |arguments: &[&str]| {
            let output = softarm(folder.path(), arguments);
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(0), "{arguments:?}: {said}");
            String::from_utf8(output.stdout).unwrap()
        };
        fs::write(folder.path().join("reach.toml"), format!("{SCENE}{REACH}")).unwrap();
        fs::write(folder.path().join("track.toml"), format!("{SCENE}{TRACK}")).unwrap();
        run(&["check", "reach.toml"]);
        run(&["solve", "reach.toml", "--out", "solved"]);
        run(&["verify", "solved"]);
        run(&["mpc", "track.toml", "--out", "looped"]);
        let served = run(&["mpc", "track.toml", "--serve"]);
        let hello = served.lines().next().unwrap();
        let hello: serde_json::Value = serde_json::from_str(hello).unwrap();
        let nodes: Vec<u64> = (hello["actuators"].as_array().unwrap().iter())
            .map(|own| own["node"].as_u64().unwrap())
            .collect();
        assert_eq!(nodes, [5, 1, 2, 3, 4]);
    }

    /// A tapered silicone arm that hangs with a payload and is driven by chambers, as couples along it.
    const CHAMBERS: &str = "\
[rod]
length_m = 0.30
elements = 8
[rod.material]
preset = \"dragon-skin-30\"
[rod.section]
radius_base_m = 0.015
radius_tip_m = 0.008
[base]
direction = [0.0, 0.0, -1.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[payload]
mass_kg = 0.04
[damping]
internal_s = 0.01
[initial]
shape = \"equilibrium\"
[time]
end_s = 1.5
[task]
position_m = [0.08, 0.0, -0.285]
at_rest = \"tip\"
tolerance_m = 0.005
[control]
[control.distributed]
points = 3
moment_max_n_m_per_m = [0.3, 0.3, 0.0]
";

    /// `check` shows couples as what they are, no force on a node, and by which of them the target is held, within their bounds; a solve of the scene is certified.
    #[test]
    fn couples_are_checked_as_couples() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("chambers.toml"), CHAMBERS).unwrap();
        let run = |arguments: &[&str]| {
            let output = softarm(folder.path(), arguments);
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(0), "{arguments:?}: {said}");
            let text = String::from_utf8(output.stdout).unwrap();
            let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
            (summary, said)
        };
        // Held it takes more than the motion needs to pass there.
        let wider = "control.distributed.moment_max_n_m_per_m=[1.0, 1.0, 0.0]";
        let (summary, said) = run(&["check", "chambers.toml", "--json", "--set", wider]);
        assert!(!said.contains("nothing is actuated"), "{said}");
        let acting: Vec<&serde_json::Value> = (summary["actuators"].as_array().unwrap().iter())
            .filter(|actuator| actuator["controls"].is_string())
            .collect();
        let [couples] = &acting[..] else {
            panic!("{summary}")
        };
        assert_eq!(couples["force"], "none");
        assert_eq!(couples["moment"], "none");
        let need = &summary["static_need"];
        assert_eq!(need["verdict"], "within-bounds", "{need}");
        for wrench in need["wrenches"].as_array().unwrap() {
            assert!(wrench.as_array().unwrap().iter().all(|part| *part == 0.0));
        }
        let controls = need["controls"][0].as_array().unwrap();
        let values: Vec<f64> = controls.iter().map(|u| u.as_f64().unwrap()).collect();
        assert!(values.iter().any(|u| *u != 0.0));
        assert!(values.iter().all(|u| u.abs() <= 1.0 + 1e-5), "{values:?}");
        let (summary, _) = run(&["solve", "chambers.toml", "--out", "solved", "--json"]);
        assert_eq!(summary["check"]["verdict"], "certified");
    }

    /// What cannot be is refused by its key.
    #[test]
    fn scenes_say_what_is_wrong() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("reach.toml"), format!("{SCENE}{REACH}")).unwrap();
        for (set, key) in [
            ("control.distributed.points=0", "points"),
            ("control.distributed.points=101", "points"),
            (
                "control.distributed.moment_max_n_m_per_m=0",
                "moment_max_n_m_per_m",
            ),
            (
                "control.distributed.moment_max_n_m_per_m=inf",
                "moment_max_n_m_per_m",
            ),
            (
                "control.distributed.moment_max_n_m_per_m=[1,-1,0]",
                "moment_max_n_m_per_m.1",
            ),
            (
                "control.distributed.moment_scale_n_m_per_m=0",
                "moment_scale_n_m_per_m",
            ),
            ("rod.elements=1", "control.distributed"),
        ] {
            let output = softarm(folder.path(), &["check", "reach.toml", "--set", set]);
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(2), "{set}: {said}");
            assert!(said.contains(key), "{set}: {said}");
        }
    }
}
