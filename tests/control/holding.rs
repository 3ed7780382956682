//! The search for efforts that hold a tip: problems whose distance from the target has several minima over the efforts.

use nalgebra::{Rotation3, Vector3};
use softarm::control::{ControlsAlong, HeldTarget, Holding, OptimalControlProblem, holding};
use softarm::mechanics::{
    Density, Material, NodeWrenches, Route, State, Stepper, StrainActuator, TimeGrid,
};
use softarm::scene::Scene;
use softarm::solve::{SolveOptions, solve_problem};
use softarm::task::{Arm, Discretization, EffortControl, Problem, Task};

/// Elements of every arm; helical ones represent arcs exactly.
const ELEMENTS: usize = 12;
const LENGTH: f64 = 0.4;

fn arm(radius: f64, tendons: &[Route], largest: f64) -> Arm {
    let mut arm = Arm::cylinder(&Material::isotropic(1e6, 0.4, 1000.0), LENGTH, radius);
    arm.actuators = (tendons.iter().enumerate())
        .map(|(i, route)| StrainActuator {
            name: format!("tendon {i}"),
            density: Density::Shortening,
            scale: 1.0,
            route: *route,
            effort: vec![(0.0, 0.0)],
            further: Vec::new(),
            friction: None,
            largest,
            winch: None,
        })
        .collect();
    arm
}

/// Returns the problem of a tip that efforts between zero and the largest one bring to a place.
fn problem(arm: &Arm, target: Vector3<f64>, tolerance: f64) -> OptimalControlProblem {
    let mut task = Task::reach(target, 1.0, 1.0);
    task.actuators.clear();
    task.efforts = (arm.actuators.iter().enumerate())
        .map(|(actuator, own)| EffortControl {
            actuator,
            bounds: [0.0, own.largest],
            rate: None,
            scale: None,
            lag: None,
            follows: None,
        })
        .collect();
    for target in &mut task.targets {
        target.tolerances.distance = Some(tolerance);
    }
    let posed = task.discretize(arm, &Discretization::with_elements(ELEMENTS));
    posed.expect("a problem").discrete
}

/// Returns the tensions that hold the tip, N; none if they are not found.
fn tensions(problem: &OptimalControlProblem) -> Option<Vec<f64>> {
    let Holding::Held(held) = holding(problem).expect("a verdict") else {
        return None;
    };
    let own = problem.efforts.as_ref().expect("efforts");
    let of = |place: usize| problem.inputs(&held.controls)[place];
    Some(own.places.iter().map(|place| of(*place)).collect())
}

/// A tendon along the lower part of an arm, which bends it by an angle `θ` and leaves the rest straight, without gravity.
struct Curl {
    arm: Arm,
    /// Fraction of the length that the tendon passes.
    part: f64,
    /// Offset of the tendon and radius of the arm, m.
    offset: f64,
    radius: f64,
}

impl Curl {
    fn new(part: f64, most: f64) -> Self {
        let (radius, offset) = (0.004, 0.003);
        let mut curl = Self {
            arm: arm(radius, &[], 0.0),
            part,
            offset,
            radius,
        };
        let route = Route {
            to: part,
            ..Route::straight([offset, 0.0])
        };
        curl.arm = arm(radius, &[route], curl.tension(most));
        curl
    }

    /// Returns the tension that bends the arm by an angle, `EI θ/(part L d)`.
    fn tension(&self, angle: f64) -> f64 {
        let bending = 1e6 * std::f64::consts::PI * 0.25 * self.radius.powi(4);
        bending * angle / (self.part * LENGTH * self.offset)
    }

    /// Returns the tip under the tension that bends the arm by an angle: an arc of the stretch `1 - T/EA`, then a straight piece.
    fn tip(&self, angle: f64) -> Vector3<f64> {
        let axial = 1e6 * std::f64::consts::PI * self.radius.powi(2);
        let arc = self.part * LENGTH * (1.0 - self.tension(angle) / axial);
        let rest = (1.0 - self.part) * LENGTH;
        let (sin, cos) = angle.sin_cos();
        Vector3::new(
            arc * (1.0 - cos) / angle + rest * sin,
            0.0,
            arc * sin / angle + rest * cos,
        )
    }
}

/// The tips that one tendon holds lie on a curve that returns to where it passed. The distance from a target far along it has a minimum
/// at rest and others on the way, from which no descent leads on: the arm has to be led along the curve. The tension found is that of the
/// arc, to the tolerance over the speed of the tip along the curve; the law of the arc is exact for helical elements.
#[test]
fn the_tip_of_one_tendon_is_found_far_along_its_curve() {
    let mut missed = Vec::new();
    for part in [0.4, 0.55, 0.7] {
        let curl = Curl::new(part, 8.0);
        for angle in [4.5, 5.5, 6.0, 6.5, 7.0] {
            let target = curl.tip(angle);
            let found = tensions(&problem(&curl.arm, target, 1e-3 * LENGTH));
            // The tip moves by more than 0.3 of the length per radian.
            let off = found.map(|found| (found[0] / curl.tension(angle) - 1.0) * angle);
            if !off.is_some_and(|off| off.abs() < 4e-3) {
                missed.push((part, angle, off));
            }
        }
    }
    assert!(missed.is_empty(), "{} missed: {missed:?}", missed.len());
}

/// Equal tensions in four tendons around a slender arm shorten it and do not bend it. The tip moves along its axis by so little for a
/// tension that bends the arm far that the little weight on effort would leave it at a distance of its own: it is brought nearer.
#[test]
fn a_common_tension_shortens_an_arm() {
    let radius = 2e-3 * LENGTH;
    let routes: Vec<Route> = (0..4)
        .map(|i| {
            let turn = Rotation3::from_axis_angle(
                &Vector3::z_axis(),
                std::f64::consts::FRAC_PI_2 * f64::from(i),
            );
            let place = turn * Vector3::new(0.8 * radius, 0.0, 0.0);
            Route::straight([place.x, place.y])
        })
        .collect();
    let axial = 1e6 * std::f64::consts::PI * radius.powi(2);
    let mut missed = Vec::new();
    for shortening in [5e-3, 1e-2, 2e-2] {
        let each = 0.25 * shortening * axial;
        let arm = arm(radius, &routes, 2.0 * each);
        let target = Vector3::new(0.0, 0.0, LENGTH * (1.0 - shortening));
        let found = tensions(&problem(&arm, target, 1e-4 * LENGTH));
        let sum = found.map(|found| found.iter().sum::<f64>() / axial);
        if !sum.is_some_and(|sum| (sum - shortening).abs() < 1.1e-4) {
            missed.push((shortening, sum));
        }
    }
    assert!(missed.is_empty(), "{} missed: {missed:?}", missed.len());
}

fn posed(text: &str, overrides: &[&str]) -> Problem {
    let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
    let (scene, source) = Scene::from_toml("scene.toml", text, &overrides).unwrap();
    scene.optimal_control(&source).unwrap().posed()
}

/// A hanging arm with three tendons that follow their commands with a lag. Without a lag the target is held with no tension in "b".
const LATE_TENDONS: &str = "\
[rod]
length_m = 0.3
elements = 10
material = { youngs_modulus_pa = 3e5, poisson_ratio = 0.4, density_kg_m3 = 1070.0 }
section = { radius_m = 0.01 }
[base]
direction = [0.0, 0.0, -1.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
viscous_1_s = 1.0
internal_s = 5e-3
[initial]
shape = \"equilibrium\"
[time]
end_s = 1.0
[task]
position_m = [0.05, 0.03, -0.28]
tolerance_m = 2e-3
[control]
blocks = 16
[[tendon]]
name = \"a\"
offset_m = [0.008, 0.0]
tension_n = [0.0, 5.0]
rate_n_s = 20.0
lag_s = 0.05
pretension_n = 0.3
[[tendon]]
name = \"b\"
offset_m = [-0.004, 0.0069]
tension_n = [0.0, 5.0]
rate_n_s = 20.0
lag_s = 0.05
pretension_n = 0.3
[[tendon]]
name = \"c\"
offset_m = [-0.004, -0.0069]
tension_n = [0.0, 5.0]
rate_n_s = 20.0
lag_s = 0.05
pretension_n = 0.3
";

/// Tensions with a lag are held inside their bounds, by no more than a hundredth of the range, and by more where the lag is longer; commands
/// within the bounds lead to them, so that the solve converges, and obey the bounds between all time nodes, to the solver's tolerance.
#[test]
fn efforts_with_a_lag_are_held_inside_their_bounds() {
    let mut slackest = Vec::new();
    for (lag, hold) in [(0.01, "linear"), (0.05, "cubic")] {
        let lags: Vec<String> = (0..3).map(|i| format!("tendon.{i}.lag_s={lag}")).collect();
        let hold = format!("control.hold=\"{hold}\"");
        let overrides: Vec<&str> = (lags.iter().chain([&hold])).map(String::as_str).collect();
        let problem = posed(LATE_TENDONS, &overrides);
        let discrete = &problem.discrete;
        let own = discrete.efforts.as_ref().expect("efforts");
        let stay = discrete.stay.as_ref().expect("the arm stays");
        let of = |place: usize| discrete.inputs(&stay.controls)[place];
        let held: Vec<f64> = own.places.iter().map(|place| 0.3 + of(*place)).collect();
        let least = held.iter().copied().fold(f64::INFINITY, f64::min);
        assert!(
            least > 0.0 && least <= 0.05 * (1.0 + 1e-3),
            "{lag} {hold}: {held:?}"
        );
        slackest.push(least);
        let solution = solve_problem(&problem, &SolveOptions::default()).unwrap();
        assert!(
            solution.has_converged(),
            "{lag} {hold}: {:?}",
            solution.status()
        );
        // Commands within a block, from the values of a polynomial of third degree.
        let (control, n) = (&discrete.control, discrete.n_numbers());
        let fine = control.refined(8);
        for k in 0..=fine.n_steps() {
            for place in &own.places {
                let effort =
                    |j: usize| discrete.inputs(&solution.coefficients[j * n..][..n])[*place];
                let weights = fine.command_weights(k, lag);
                let command = 0.3 + weights.iter().map(|&(j, w)| w * effort(j)).sum::<f64>();
                assert!(
                    (-5e-6..5.0 + 5e-6).contains(&command),
                    "{lag} {hold}: {command} N at step {k} of 8 times as many"
                );
            }
        }
    }
    assert!(slackest[0] < slackest[1], "{slackest:?}");
}

/// An arm whose tip a force and a moment bring to its target: two of the six controls are free.
const FREE_TO_CHOOSE: &str = "\
[rod]
length_m = 0.3
elements = 8
material = { preset = \"dragon-skin-30\" }
section = { radius_m = 0.012 }
[base]
direction = [0.0, 0.0, -1.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
viscous_1_s = 0.5
internal_s = 0.01
[initial]
shape = \"equilibrium\"
[time]
end_s = 0.8
[task]
position_m = [0.10, 0.05, -0.26]
[control]
blocks = 16
force_max_n = 1.0
moment_max_n_m = [0.05, 0.05, 0.0]
";

/// The wrench of least effort that holds the target puts the arm into a ball, or bends it more than a limit allows; another one is held,
/// whose shape obeys them, with the target met all the same.
#[test]
fn held_shapes_obey_obstacles_and_limits() {
    let shape = |more: &str| {
        let problem = posed(&format!("{FREE_TO_CHOOSE}{more}"), &[]);
        let stay = problem.discrete.stay.clone().expect("the arm stays");
        assert!(stay.is_stable);
        let tip = stay.shape.positions[problem.discrete.rod.tip()];
        assert!((tip - Vector3::new(0.10, 0.05, -0.26)).norm() < 1e-6);
        (problem, stay.shape.clone())
    };
    let center = Vector3::new(0.04307, -0.00827, -0.18204);
    let clearance = |more: &str| {
        let (_, shape) = shape(more);
        let points = shape.positions.windows(2).flat_map(|ends| {
            (0..=10).map(|i| ends[0] + (ends[1] - ends[0]) * (0.1 * f64::from(i)))
        });
        points
            .map(|x| (x - center).norm())
            .fold(f64::INFINITY, f64::min)
            - 0.022
    };
    let ball =
        "[[obstacle]]\nsphere = { center_m = [0.04307, -0.00827, -0.18204], radius_m = 0.010 }\n";
    assert!(clearance("") < -1e-3 && clearance(ball) > 0.0);
    let bend = |more: &str| {
        let (problem, shape) = shape(more);
        let rod = &problem.discrete.rod;
        (0..rod.n_elements())
            .map(|q| {
                let turn = shape.rotations[q].tr_mul(&shape.rotations[q + 1]);
                Rotation3::from_matrix_unchecked(turn).angle() / rod.elements[q].length
            })
            .fold(0.0, f64::max)
    };
    let limit = "[[limit]]\ncurvature_max_1_m = 6.0\n";
    // The angle between the ends has the twist in it, which only adds to it.
    assert!(
        bend("") > 6.4 && bend(limit) < 6.05,
        "{} {}",
        bend(""),
        bend(limit)
    );
}

/// A target whose wrench of least effort feeds a fast motion of the arm is held by another one, under which deviations of all lengths of
/// waves do not grow: the largest distance of any node in the last half second is below that in the first one.
#[test]
fn wrenches_that_feed_fast_motions_are_not_held() {
    let problem = posed(FLUTTERING, &[]);
    let discrete = &problem.discrete;
    let stay = discrete.stay.as_ref().expect("the arm stays");
    assert!(stay.is_stable);
    let rod = &discrete.rod;
    let mut state = State::at_rest(stay.shape.clone());
    for (q, p) in state.linear_momentum.iter_mut().enumerate().skip(1) {
        let side = if q % 2 == 0 { 1.0 } else { -1.0 };
        *p += Vector3::new(0.3, side, 0.7) * (1e-3 * rod.nodes[q].mass);
    }
    let grid = TimeGrid {
        n_steps: (6.0 / discrete.grid.step) as usize,
        ..discrete.grid
    };
    let mut stepper = Stepper::new(rod, grid, state);
    let (nodes, wrenches) = (discrete.actuated_nodes(), discrete.wrenches(&stay.controls));
    let held = NodeWrenches::on(&nodes, &wrenches);
    let mut farthest = [0.0_f64; 2];
    for k in 0..grid.n_steps {
        stepper.advance([held; 2]).unwrap();
        let t = k as f64 * grid.step;
        let off = |q: usize| (stepper.position(q) - stay.shape.positions[q]).norm();
        let most = (0..rod.n_nodes()).map(off).fold(0.0, f64::max);
        if t < 0.5 {
            farthest[0] = farthest[0].max(most);
        } else if t > 5.5 {
            farthest[1] = farthest[1].max(most);
        }
    }
    assert!(farthest[1] < farthest[0], "{farthest:?}");
}

/// An arm of two segments, its moments those of its own body.
const FLUTTERING: &str = "\
[rod]
length_m = 0.6
elements = 20
material = { youngs_modulus_pa = 8e5, poisson_ratio = 0.4, density_kg_m3 = 1070.0 }
section = { radius_m = 0.02 }
segment = [
  { fraction = 0.45 },
  { fraction = 0.55, section = { radius_m = 0.014 }, material = { youngs_modulus_pa = 1.4e6, poisson_ratio = 0.4, density_kg_m3 = 900.0 } },
]
[time]
end_s = 1.6
[base]
direction = [1.0, 0.0, 0.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
viscous_1_s = 0.5
[initial]
shape = \"equilibrium\"
[control]
force_max_n = 3.0
moment_max_n_m = 0.5
blocks = 14
[task]
position_m = [0.42238, 0.24102, -0.2972]
";

/// Controls that hold a bent arm change with its stiffness as equilibria of a stiffer arm say, by differences, for forces on the tip with and
/// without gravity; without gravity they are in proportion to the stiffness.
#[test]
fn controls_follow_the_stiffness() {
    const CHANGE: f64 = 1e-2;
    let silicone = Material::isotropic(1e6, 0.4, 1000.0);
    let cylinder = |gravity: f64| Arm {
        gravity: Vector3::new(0.0, 0.0, gravity),
        ..Arm::cylinder(&silicone, LENGTH, 0.01)
    };
    let by_force = |arm: &Arm| {
        let task = Task::reach(Vector3::new(0.1, 0.05, 0.381), 1.0, 5.0);
        let posed = task.discretize(arm, &Discretization::with_elements(ELEMENTS));
        posed.expect("a problem").discrete
    };
    for (kind, problem) in [
        ("force", by_force(&cylinder(0.0))),
        ("weight", by_force(&cylinder(-2.0))),
    ] {
        let aim = HeldTarget {
            node: problem.rod.tip(),
            position: problem.goals.iter().find_map(|goal| goal.position),
            ..HeldTarget::default()
        };
        assert!(aim.position.is_some());
        let hold = |factor: f64| {
            let mut own = problem.clone();
            let mut rod = (*own.rod).clone();
            rod.take_stiffness(&problem.rod, factor);
            own.rod = rod.into();
            let mut along = ControlsAlong::new(&own);
            along.hold(&own, aim, 0.0, true).expect("held")
        };
        let [less, own, more] = [1.0 - CHANGE, 1.0, 1.0 + CHANGE].map(hold);
        let size = own
            .controls
            .iter()
            .fold(0.0, |most: f64, u| most.max(u.abs()));
        for (c, stiffening) in own.stiffening.iter().enumerate() {
            let slope = (more.controls[c] - less.controls[c]) / (2.0 * CHANGE);
            assert!(
                (stiffening - slope).abs() < 1e-2 * size,
                "{kind} {c}: {stiffening} {slope}"
            );
            if kind == "force" {
                assert!((stiffening - own.controls[c]).abs() < 1e-3 * size);
            }
        }
    }
}
