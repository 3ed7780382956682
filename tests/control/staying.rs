//! An arm that arrives stays: the whole arm comes to rest, and the last wrench holds the tip there.

use nalgebra::Vector3;
use softarm::control::Stay;
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{
    ControlSignal, Energy, Load, LoadFrame, NodeWrenches, Rod, SmallMotions, State, Stepper,
    TimeGrid, stable_step,
};
use softarm::scene::Scene;
use softarm::solve::{Solution, SolveOptions, solve_problem};
use softarm::task::{Problem, Rest};

/// A tapered silicone arm that hangs with a load at its tip and is not damped at all.
const HANGING: &str = "\
[rod]
length_m = 0.3
elements = 10
[rod.material]
youngs_modulus_pa = 0.6e6
poisson_ratio = 0.49
density_kg_m3 = 1080.0
[rod.section]
radius_base_m = 0.015
radius_tip_m = 0.008
[base]
direction = [0.0, 0.0, -1.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[payload]
mass_kg = 0.04
[initial]
shape = \"equilibrium\"
[time]
end_s = 1.2
[task]
position_m = [0.12, 0.0, -0.27]
[control]
force_max_n = 5.0
";

fn posed(text: &str, overrides: &[&str]) -> Problem {
    let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
    let (scene, source) = Scene::from_toml("scene.toml", text, &overrides).unwrap();
    scene.optimal_control(&source).unwrap().posed()
}

fn solved(problem: &Problem) -> Solution {
    let solution = solve_problem(problem, &SolveOptions::default()).unwrap();
    assert!(solution.has_converged(), "{:?}", solution.status());
    solution
}

/// An arm that was simulated to the end of its task.
pub(super) struct Arrived {
    pub(super) rod: Rod,
    pub(super) state: State,
    pub(super) control: ControlSignal,
    pub(super) grid: TimeGrid,
}

/// The controls of a solution on `times` as many elements.
pub(super) fn arrived(solution: &Solution, times: usize) -> Arrived {
    let problem = &solution.problem;
    let (rod, start) = problem.finer(times).unwrap();
    let discrete = &problem.discrete;
    let factor = (discrete.grid.step / (0.9 * stable_step(&rod))).ceil() as usize;
    let grid = TimeGrid {
        step: discrete.grid.step / factor as f64,
        n_steps: discrete.grid.n_steps * factor,
        ..discrete.grid
    };
    let mut control = discrete.signal(&discrete.control.refined(factor), &solution.coefficients);
    for node in &mut control.nodes {
        *node *= times;
    }
    let mut stepper = Stepper::new(&rod, grid, start);
    for k in 0..grid.n_steps {
        stepper.advance([control.at(k), control.at(k + 1)]).unwrap();
    }
    Arrived {
        state: stepper.state(),
        control,
        grid,
        rod,
    }
}

/// Largest distance of the tip from its target over `seconds` after the task, over the length, and largest speed of any node, m/s: on twice
/// the elements, from the start, with the last wrench held.
fn afterwards(solution: &Solution, seconds: f64) -> [f64; 2] {
    let problem = &solution.problem;
    let Arrived {
        rod,
        state,
        control,
        grid,
    } = arrived(solution, 2);
    let after = TimeGrid {
        start: grid.start + grid.duration(),
        ..grid
    };
    let mut stepper = Stepper::new(&rod, after, state);
    let held = control.at(grid.n_steps);
    let target = (problem.discrete)
        .final_goals()
        .find_map(|goal| goal.position)
        .unwrap();
    let mut found = [0.0; 2];
    for _ in 0..(seconds / grid.step).ceil() as usize {
        stepper.advance([held; 2]).unwrap();
        let state = stepper.state();
        let off = (state.configuration.positions[rod.tip()] - target).norm();
        found[0] = f64::max(found[0], off / problem.arm.length);
        for (p, node) in state.linear_momentum.iter().zip(&rod.nodes) {
            found[1] = f64::max(found[1], p.norm() / node.mass);
        }
    }
    found
}

/// The first period of the arm where it is held, s.
fn period(stay: &Stay, problem: &Problem) -> f64 {
    let rod = held_rod(stay, problem);
    let motions = SmallMotions::about(&rod, &stay.shape, problem.discrete.grid.duration());
    std::f64::consts::TAU / motions.first_frequency().expect("a stable equilibrium")
}

fn held_rod(stay: &Stay, problem: &Problem) -> Rod {
    let mut rod = Rod::clone(&problem.discrete.rod);
    let wrenches = problem.discrete.wrenches(&stay.controls);
    for (node, wrench) in (problem.discrete.actuated_nodes().into_iter()).zip(wrenches) {
        rod.loads.push(Load {
            node,
            force: wrench.force,
            moment: Vector3::zeros(),
            frame: LoadFrame::Spatial,
            profile: Vec::new(),
        });
    }
    rod
}

/// With the last wrench held the tip of an undamped arm stays within a hundredth of its length over one period, on twice the elements; where
/// the tip only stops for an instant, it leaves by more than a tenth.
#[test]
fn arms_stay_where_they_arrive() {
    let problem = posed(HANGING, &[]);
    let stay = problem.discrete.stay.clone().expect("the arm stays");
    let period = period(&stay, &problem);
    assert!((stay.seconds - period).abs() < 1e-9 * period);
    let staying = solved(&problem);
    let check = staying.certify().unwrap();
    assert!(check.is_certified(), "{:?}", check.items);
    let [off, speed] = afterwards(&staying, period);
    assert!(off < 0.01, "{off}");
    let found = check.stays.expect("the motion afterwards");
    assert!(found.bound <= 0.005 * problem.arm.length * (1.0 + 1e-6));

    let instant = solved(&posed(HANGING, &["task.at_rest=\"tip\""]));
    assert!(instant.certify().unwrap().stays.is_none());
    let [leaves, faster] = afterwards(&instant, period);
    assert!(leaves > 0.1, "{leaves}");
    assert!(speed < 0.1 * faster, "{speed} {faster}");
}

/// A tip that should stop is judged on the finest grid of the check: on few elements it stops on its own grid alone, and the certificate says so.
#[test]
fn tips_stop_on_finer_grids() {
    for (elements, stops) in [(2, false), (16, true)] {
        let overrides = [
            "task.at_rest=\"tip\"".to_owned(),
            format!("rod.elements={elements}"),
        ];
        let overrides: Vec<&str> = overrides.iter().map(String::as_str).collect();
        let solution = solved(&posed(HANGING, &overrides));
        let check = solution.certify().unwrap();
        let Arrived { rod, state, .. } = arrived(&solution, 4);
        let speed = (state.linear_momentum[rod.tip()] / rod.nodes[rod.tip()].mass).norm();
        let item = |name: &str| check.items.iter().find(|item| item.name == name).unwrap();
        let (own, finer) = (item("tip_speed_m_s"), item("refined_speed_m_s"));
        assert!(own.holds(), "{own:?}");
        // The steps of both replays are not the same.
        let difference = (finer.value - speed).abs();
        assert!(difference < 0.05 * speed + 1e-3, "{finer:?} {speed}");
        assert_eq!(finer.holds(), stops, "{finer:?}");
    }
}

/// The last coefficient of a hold is the wrench of the equilibrium, and the rows of `controls.csv` go on with it.
#[test]
fn the_last_wrench_is_the_holding_one() {
    for hold in ["constant", "cubic"] {
        let problem = posed(HANGING, &[&format!("control.hold=\"{hold}\"")]);
        let stay = problem.discrete.stay.clone().expect("the arm stays");
        let solution = solved(&problem);
        let check = solution.certify().unwrap();
        assert!(check.is_certified(), "{hold}: {:?}", check.items);
        let wrenches = problem.discrete.wrenches(&solution.coefficients);
        let last = wrenches.last().expect("coefficients");
        let held = problem.discrete.wrenches(&stay.controls)[0];
        assert!((last.force - held.force).norm() < 1e-9, "{hold}");
        let directory = tempfile::tempdir().unwrap();
        let saved = solution.save(&directory.path().join("result")).unwrap();
        let path = saved.join("controls.csv");
        let named = problem.discrete.named_controls();
        let headings: Vec<String> = named.iter().map(|own| own.heading()).collect();
        let n_rows = problem.discrete.n_control_rows();
        let rows = softarm::output::read_controls(&path, &headings, n_rows).unwrap();
        let row = rows.last().expect("rows");
        assert!((row.t_end - row.t_start - stay.seconds).abs() < 1e-12);
        assert_eq!(headings[0], "tip force x (N)");
        assert_eq!(row.values[0], stay.controls[0]);
    }
}

/// The energy of a small deviation is, to second order, that of the rod under the held force beyond the energy of the equilibrium.
#[test]
fn the_energy_of_a_deviation_is_the_rods() {
    let problem = posed(HANGING, &[]);
    let stay = problem.discrete.stay.clone().expect("the arm stays");
    let rod = &problem.discrete.rod;
    let held = problem.discrete.wrenches(&stay.controls)[0];
    let total = |state: &State| {
        let work = held.force.dot(&state.configuration.positions[rod.tip()]);
        Energy::of(rod, state).total() - work
    };
    let rest = State::at_rest(stay.shape.clone());
    let deviated = |size: f64| {
        let mut random = fastrand::Rng::with_seed(5);
        let mut vector =
            |unit: f64| Vector3::from_fn(|_, _| size * unit * (2.0 * random.f64() - 1.0));
        let mut state = rest.clone();
        for q in rod.first_free_node()..rod.n_nodes() {
            let node = &rod.nodes[q];
            state.configuration.positions[q] += vector(rod.scales.length * 1e-2);
            state.configuration.rotations[q] *= exp(&vector(1.0));
            state.linear_momentum[q] += vector(node.mass);
            state.angular_momentum[q] += vector(node.rotary.x);
        }
        state
    };
    let error = |size: f64| {
        let state = deviated(size);
        let exact = total(&state) - total(&rest);
        (stay.energy_of(&state) - exact).abs() / exact
    };
    // What is left is of third order, so that its part falls with the size.
    let [coarse, fine] = [error(1e-2), error(1e-3)];
    assert!(fine < 1e-2 && fine < 0.2 * coarse, "{coarse} {fine}");
}

/// Under the held wrench the tip of an undamped arm is never farther from where it is held than the energy of its deviation allows, over ten
/// periods.
#[test]
fn the_bound_holds_for_all_later_time() {
    let problem = posed(HANGING, &[]);
    let stay = problem.discrete.stay.clone().expect("the arm stays");
    let rod = held_rod(&stay, &problem);
    let mut start = State::at_rest(stay.shape.clone());
    // A push that swings the tip as far as it can: along its first mode, nearly.
    for q in rod.first_free_node()..rod.n_nodes() {
        let along = q as f64 / rod.n_elements() as f64;
        start.linear_momentum[q] +=
            rod.nodes[q].mass * Vector3::new(0.02, 0.01, 0.0) * along * along;
    }
    let bound = (2.0 * stay.energy_of(&start) * stay.compliance).sqrt();
    let mut stepper = Stepper::new(&rod, 0.5 * stable_step(&rod), start);
    let place = stay.shape.positions[rod.tip()];
    let mut farthest: f64 = 0.0;
    while stepper.time() < 10.0 * stay.seconds {
        stepper.advance([NodeWrenches::NONE; 2]).unwrap();
        farthest = farthest.max((stepper.position(rod.tip()) - place).norm());
    }
    assert!(farthest < bound, "{farthest} {bound}");
    assert!(
        farthest > 0.5 * bound,
        "the push is along the softest way: {farthest} {bound}"
    );
}

/// How long and how near an arm stays are for arms that stay; both are resolved.
#[test]
fn keys_of_staying() {
    let read = |overrides: &[&str]| {
        let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
        Scene::from_toml("scene.toml", HANGING, &overrides)
    };
    for key in ["task.stays_s=1.0", "task.stays_m=0.01"] {
        let error = read(&["task.at_rest=\"tip\"", key])
            .unwrap_err()
            .to_string();
        assert!(error.contains("contradicts task.at_rest"), "{error}");
    }
    let error = read(&["task.tolerance_m_s=0.1"]).unwrap_err().to_string();
    assert!(error.contains("contradicts task.at_rest"), "{error}");
    let error = read(&["task.at_rest=\"base\""]).unwrap_err().to_string();
    assert!(error.contains("expected true, \"tip\" or false"), "{error}");
    let problem = posed(HANGING, &["task.stays_s=0.25", "task.stays_m=0.002"]);
    let stay = problem.discrete.stay.expect("the arm stays");
    assert_eq!((stay.seconds, stay.distance), (0.25, 0.002));
    assert!(matches!(problem.task.targets[0].rest, Rest::Staying(_)));
}

/// A silicone arm on a base that is moved aside before the arm arrives; only the wrench of the tip holds it there.
const DRIVEN: &str = "\
[rod]
length_m = 0.5
elements = 8
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.02
[damping]
viscous_1_s = 1.0
[base]
kind = \"driven\"
direction = [0.0, 0.0, -1.0]
[base.motion]
translation_m = [[0.2, 0.0, 0.0, 0.0], [0.8, 0.3, 0.0, 0.0]]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[initial]
shape = \"equilibrium\"
[time]
end_s = 1.2
[task]
position_m = [0.4, 0.0, -0.489]
[control]
blocks = 16
force_max_n = 20.0
";

/// An arm on a driven base stays where the base has come to stand; one whose base goes on is refused.
#[test]
fn arms_stay_where_their_base_stands() {
    let solution = solved(&posed(DRIVEN, &[]));
    assert!(solution.certify().unwrap().is_certified());
    let seconds = (solution.problem.discrete.stay.as_ref()).map_or(0.0, |stay| stay.seconds);
    let [off, _] = afterwards(&solution, seconds);
    assert!(off < 0.01, "{off}");

    let later = "base.motion.translation_m=[[0.2, 0.0, 0.0, 0.0], [1.6, 0.3, 0.0, 0.0]]".to_owned();
    let (scene, source) = Scene::from_toml("scene.toml", DRIVEN, &[later]).unwrap();
    let error = scene.optimal_control(&source).unwrap_err().to_string();
    assert!(error.contains("the base still moves"), "{error}");
}

/// A silicone arm without a base that is to be moved and turned.
const FREE: &str = "\
[rod]
length_m = 1.0
elements = 6
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.05
[base]
kind = \"free\"
direction = [0.0, 0.0, 1.0]
[time]
end_s = 2.0
[task]
position_m = [0.3, 0.0, 1.2]
orientation_wxyz = [0.9659258262890683, 0.0, 0.25881904510252074, 0.0]
stays_m = 0.03
[control]
blocks = 10
force_max_n = 20.0
moment_max_n_m = 5.0
";

/// A free arm stays with no wrench and no momentum; gravity takes it on, and without an orientation its pose at rest is open.
#[test]
fn free_arms_stay_without_a_wrench() {
    let problem = posed(FREE, &[]);
    let stay = problem.discrete.stay.clone().expect("the arm stays");
    assert!(stay.controls.iter().all(|number| *number == 0.0));
    let solution = solved(&problem);
    assert!(solution.certify().unwrap().is_certified());
    let [off, _] = afterwards(&solution, stay.seconds);
    assert!(off < 0.03, "{off}");
    // What is left of the momentum moves the whole arm by less than it may during the stay.
    let Arrived { rod, state, .. } = arrived(&solution, 1);
    let momentum: Vector3<f64> = state.linear_momentum.iter().sum();
    assert!(momentum.norm() / rod.mass() * stay.seconds < 0.015);

    let weighed = format!("{FREE}[gravity]\nacceleration_m_s2 = [0.0, 0.0, -9.81]\n");
    let (scene, source) = Scene::from_toml("scene.toml", &weighed, &[]).unwrap();
    let error = scene.optimal_control(&source).unwrap_err().to_string();
    assert!(error.contains("loads move the arm on"), "{error}");

    // Nothing is known to hold it in one of many poses, which refuses nothing: the tip stops, and the task says so.
    let line = FREE
        .lines()
        .find(|line| line.starts_with("orientation"))
        .unwrap();
    let problem = posed(&FREE.replace(line, "").replace("stays_m = 0.03", ""), &[]);
    assert!(problem.discrete.stay.is_none());
    assert_eq!(problem.task.targets[0].rest, Rest::Instant);
}
