//! Static equilibria against closed forms and published solutions.

use crate::common;

use std::f64::consts::PI;

use common::published::statics::{bent_across, elastica, post_buckling, unit_rod};
use common::{RULES, equilibrium, soft_arm, tip_load};
use nalgebra::{Cholesky, DMatrix, Vector3};
use softarm::control::{CannotHold, Held, Holding, OptimalControlProblem, holding};
use softarm::mechanics::equilibrium::{
    EquilibriumError, NodeSpring, nearby_equilibrium_until, static_equilibrium,
};
use softarm::mechanics::{
    BaseCondition, Configuration, Critical, EndCondition, Kept, Load, LoadFrame, LoadPath, Loss,
    Material, Rod, RodParameters, Section, SectionProfile, SmallMotions, Stability, StrainRule,
    Varied,
};
use softarm::scene::Scene;
use softarm::solve::{StaticsOptions, statics};
use softarm::stop::StopSignal;
use softarm::task::{Arm, Discretization, Place, PointLoad};

/// Small tip load, both strain rules: the deflection approaches FL³/(3EI) + FL/(GA) at second order in l.
#[test]
fn cantilever_converges() {
    let (ei, ga) = (
        1e6 * PI * 0.05f64.powi(4) / 4.0,
        1e6 / 3.0 * PI * 0.05f64.powi(2),
    );
    let force = 1e-4;
    let exact = force / (3.0 * ei) + force / ga;
    for rule in RULES {
        let error = |n: usize| {
            let mut p = soft_arm(rule, n);
            p.loads = tip_load(n, [force, 0.0, 0.0], [0.0; 3], LoadFrame::Spatial);
            let (_, shape) = equilibrium(&p, 1);
            (shape.positions[n].x / exact - 1.0).abs()
        };
        // Trapezoidal elements must be shorter than the radius before they converge.
        let (coarse, fine) = match rule {
            StrainRule::Helical => (error(10), error(20)),
            StrainRule::Trapezoidal => (error(100), error(200)),
        };
        let order = (coarse / fine).log2();
        assert!(
            (1.9..2.1).contains(&order),
            "{rule:?}: order {order}, errors {coarse} {fine}"
        );
        assert!(fine < 4e-3);
    }
}

/// The trapezoidal rule bends with EI + GA l²/4 exactly (DESIGN 2.3): end moment, small angle.
#[test]
fn trapezoidal_rule_locks_by_the_formula() {
    for n in [5, 20] {
        let mut p = soft_arm(StrainRule::Trapezoidal, n);
        let moment = 1e-5;
        p.loads = tip_load(n, [0.0; 3], [0.0, moment, 0.0], LoadFrame::Body);
        let (rod, shape) = equilibrium(&p, 1);
        let element = &rod.elements[0];
        let locked = element.angular_stiffness.x * (1.0 + rod.locking_ratio());
        let angle = (shape.rotations[n] * Vector3::z()).x.asin();
        assert!(
            (angle / (moment / locked) - 1.0).abs() < 1e-6,
            "{n}: {angle}"
        );
        let mut p = soft_arm(StrainRule::Helical, n);
        p.loads = tip_load(n, [0.0; 3], [0.0, moment, 0.0], LoadFrame::Body);
        let (rod, shape) = equilibrium(&p, 1);
        let angle = (shape.rotations[n] * Vector3::z()).x.asin();
        assert!((angle * rod.elements[0].angular_stiffness.x / moment - 1.0).abs() < 1e-6);
    }
}

/// The elastica of trapezoidal elements: second order as well, once the elements are shorter than 2 sqrt(EI/GA). A shear stiffness of 1e4 EI/L²
/// keeps that within reach, so the reference is the same rod on a much finer helical grid.
#[test]
fn elastica_order_trapezoidal() {
    let load = 3.0;
    let tip = |rule, n: usize| bent_across(rule, n, 1e4, &[load])[0].positions[n];
    let reference = tip(StrainRule::Helical, 640);
    let coarse = (tip(StrainRule::Trapezoidal, 160) - reference).norm();
    let fine = (tip(StrainRule::Trapezoidal, 320) - reference).norm();
    let order = (coarse / fine).log2();
    assert!(
        (1.9..2.1).contains(&order),
        "order {order}, errors {coarse} {fine}"
    );
}

/// End moment 2πEI/L: the rod closes to a full circle; the helical rule is exact at any K (here 6), the tip comes back
/// to the base turned by one whole turn.
#[test]
fn end_moment_rolls_up_to_a_circle() {
    for (rule, n, tolerance) in [
        (StrainRule::Helical, 6, 1e-7),
        (StrainRule::Helical, 20, 1e-7),
        (StrainRule::Trapezoidal, 400, 2e-3),
    ] {
        // Soft in shear, so that the trapezoidal rule's own stiffening GA l²/4 is small beside EI.
        let mut p = unit_rod(rule, n, 100.0);
        for fraction in [0.5, 1.0] {
            p.loads = tip_load(
                n,
                [0.0; 3],
                [0.0, 2.0 * PI * fraction, 0.0],
                LoadFrame::Body,
            );
            let (_, shape) = equilibrium(&p, 12);
            let angle = 2.0 * PI * fraction;
            let exact = Vector3::new((1.0 - angle.cos()) / angle, 0.0, angle.sin() / angle);
            let error = (shape.positions[n] - exact).norm();
            assert!(
                error < tolerance,
                "{rule:?} K = {n}, {fraction} of a circle: {error}"
            );
        }
    }
}

/// Springs on the tip take it to a pose: stiff ones to within their own compliance.
#[test]
fn springs_hold_the_tip() {
    for rule in RULES {
        let rod = Rod::new(&soft_arm(rule, 10)).unwrap();
        let target = Vector3::new(0.3, 0.2, 0.85);
        let turn = softarm::mechanics::rotation::exp(&Vector3::new(-0.3, 0.5, 0.4));
        let spring = NodeSpring {
            node: rod.tip(),
            position: Some((target, 1e5)),
            rotation: Some((turn, 1e5)),
            direction: None,
        };
        let shape = static_equilibrium(&rod, &rod.rest, 0.0, &spring).unwrap();
        assert!((shape.positions[10] - target).norm() < 1e-2);
        assert!((shape.rotations[10] - turn).norm() < 1e-2);
    }
}

/// Rods from soft to practically inextensible, EA = GA = 1e4 to 1e9 EI/L² (slenderness to 16 000), under a load that bends them by half their
/// length: rounding of their stretch, which no iteration can lower, is no failure, and the shape is that of the elastica but
/// for its strain, `P/EA`.
#[test]
fn rounding_of_stretch_is_no_failure() {
    let tip = |stiffness: f64| {
        let p = RodParameters {
            loads: tip_load(100, [3.0, 0.0, 0.0], [0.0; 3], LoadFrame::Spatial),
            ..unit_rod(StrainRule::Helical, 100, stiffness)
        };
        equilibrium(&p, 4).1.positions[100]
    };
    let reference = tip(1e7);
    for exponent in 4..=9 {
        let stiffness = 10f64.powi(exponent);
        let off = (tip(stiffness) - reference).norm();
        assert!(off < 3.0 / stiffness + 1e-6, "{stiffness:e}: {off:e}");
    }
}

/// The rest shape of a curved rod is an equilibrium under both rules, with no force anywhere.
#[test]
fn rest_shape_is_free_of_stress() {
    for rule in RULES {
        let mut p = soft_arm(rule, 7);
        p.rest_curvature = Vector3::new(1.0, -2.0, 0.7);
        p.rest_stretch = 1.1;
        let rod = Rod::new(&p).unwrap();
        assert!(rod.elastic_energy(&rod.rest.positions, &rod.rest.rotations) < 1e-25);
        let shape = static_equilibrium(&rod, &rod.rest, 0.0, &NodeSpring::default()).unwrap();
        assert!((shape.positions[7] - rod.rest.positions[7]).norm() < 1e-12);
    }
}

/// A free rod has no static equilibrium to find: a typed error.
#[test]
fn free_base_is_refused() {
    let rod = Rod::new(&RodParameters {
        base: BaseCondition::Free,
        ..soft_arm(StrainRule::Helical, 3)
    })
    .unwrap();
    assert_eq!(
        static_equilibrium(&rod, &rod.rest, 0.0, &NodeSpring::default()),
        Err(EquilibriumError::FreeBase)
    );
}

/// Springs pull the tip of a thin wire, which bends long before it stretches, to places nearer to the base than its length.
#[test]
fn springs_bend_a_wire() {
    let material = Material {
        youngs_modulus: 60e9,
        shear_modulus: 22e9,
        density: 6450.0,
        shear_factor: 1.0,
    };
    let length = 0.25;
    let section = SectionProfile::Uniform(Section::circle(&material, 0.5e-3));
    let rod = Rod::new(&RodParameters::straight(length, 20, section)).unwrap();
    for target in [
        Vector3::new(0.1, 0.0, 0.2),
        Vector3::new(0.1, 0.05, 0.15),
        Vector3::new(0.12, 0.0, 0.05),
    ] {
        let mut shape = rod.rest.clone();
        for stiffness in [1.0, 10.0, 100.0, 1e3, 1e4] {
            let spring = NodeSpring {
                node: rod.tip(),
                position: Some((target, stiffness * rod.scales.force / length)),
                rotation: None,
                direction: None,
            };
            let found = static_equilibrium(&rod, &shape, 0.0, &spring);
            println!(
                "{target:?} {stiffness} {:?}",
                found.as_ref().map(|s| s.positions[20])
            );
            shape = found.unwrap();
        }
        let pull = (target - shape.positions[20]).norm();
        assert!(pull < 0.01 * length, "{pull}");
    }
}

fn problem(text: &str, overrides: &[&str]) -> OptimalControlProblem {
    let mut overrides: Vec<String> = overrides.iter().map(|text| text.to_string()).collect();
    overrides.push("task.at_rest=\"tip\"".into());
    let (scene, source) = Scene::from_toml("arm", text, &overrides).expect("a scene");
    scene.optimal_control(&source).expect("a problem").problem
}

/// The arm of a problem with a held wrench as loads.
fn loaded(problem: &OptimalControlProblem, held: &Held) -> Rod {
    let mut rod = Rod::clone(&problem.rod);
    let wrenches = problem.wrenches(&held.controls);
    for (node, wrench) in (problem.actuated_nodes().into_iter()).zip(wrenches) {
        for (force, moment, frame) in [
            (wrench.force, Vector3::zeros(), LoadFrame::Spatial),
            (Vector3::zeros(), wrench.moment, LoadFrame::Body),
        ] {
            rod.loads.push(Load {
                node,
                force,
                moment,
                frame,
                profile: Vec::new(),
            });
        }
    }
    rod
}

/// The wrench within the bounds, the tip at the goal, and the shape one that the static solver finds too, from nearby.
fn assert_holds(problem: &OptimalControlProblem, held: &Held) {
    let tip = problem.rod.tip();
    let length = problem.rod.scales.length;
    let target = (problem.goals.iter().find_map(|goal| goal.position)).expect("a position");
    assert!(
        held.is_stable && held.is_within_bounds(),
        "{:?}",
        held.controls
    );
    assert!((held.shape.positions[tip] - target).norm() < 1e-6 * length);
    let rod = loaded(problem, held);
    let time = problem.grid.duration();
    let again = static_equilibrium(&rod, &held.shape, time, &NodeSpring::default()).unwrap();
    assert!((again.positions[tip] - target).norm() < 1e-6 * length);
    let motions = SmallMotions::about(&rod, &again, time);
    assert_eq!(motions.growth_rate(), None);
    // The compliance is that of a small load more.
    let mut pushed = rod.clone();
    let push = 1e-4 * rod.scales.force;
    pushed.loads.push(Load {
        node: tip,
        force: Vector3::x() * push,
        moment: Vector3::zeros(),
        frame: LoadFrame::Spatial,
        profile: Vec::new(),
    });
    let there = static_equilibrium(&pushed, &again, time, &NodeSpring::default()).unwrap();
    let moved = (there.positions[tip] - again.positions[tip]) / push;
    let compliance = held.compliance.column(0);
    assert!(
        (moved - compliance).norm() < 1e-2 * compliance.norm(),
        "{moved} {compliance}"
    );
}

#[track_caller]
fn held(problem: &OptimalControlProblem) -> Held {
    match holding(problem).unwrap() {
        Holding::Held(held) => {
            assert_holds(problem, &held);
            *held
        }
        other => panic!("{other:?}"),
    }
}

const TOLERANT: &str = "[rod]\nlength_m = 0.5\nelements = 8\n[rod.material]\nyoungs_modulus_pa = 1e6\npoisson_ratio = 0.5\n\
    density_kg_m3 = 1000.0\n[rod.section]\nradius_m = 0.02\n[damping]\ninternal_s = 0.015\n[time]\nend_s = 1.0\n[task]\n\
    position_m = [0.2, 0.0, 0.43]\n[control]\nblocks = 12\nforce_max_n = 5.0\n";

/// The target of the built-in `reach` takes more force than its bound if a force alone holds it, and is held within the bounds by a force and a moment; in the
/// plane of the arm two components of a force hold a target as three do.
#[test]
fn targets_are_held_by_all_that_acts() {
    let reach = |overrides: &[&str]| {
        let passing = "task={position_m = [0.5, 0.0, 0.8], at_rest = \"tip\"}";
        let overrides: Vec<String> = (std::iter::once(&passing).chain(overrides))
            .map(|text| text.to_string())
            .collect();
        let (scene, source) = Scene::load("reach", &overrides).expect("a scene");
        scene.optimal_control(&source).expect("a problem").problem
    };
    let wrench = |problem: &OptimalControlProblem, held: &Held| problem.wrenches(&held.controls)[0];
    let free = reach(&[]);
    assert!(wrench(&free, &held(&free)).moment.norm() > 0.0);
    let force_alone = reach(&["control.moment_max_n_m=0"]);
    match holding(&force_alone).unwrap() {
        Holding::CannotBeHeld { why, .. } => assert!(
            matches!(why, CannotHold::AboveBounds(_) | CannotHold::Unstable(_)),
            "{why}"
        ),
        other => panic!("{other:?}"),
    }
    // Within the sheet of tips that a force holds, for an arm whose shear and stretch lower it by about 3 EI/(GA L²) = 0.6 % of its way.
    let place = "task.position_m=[0.3, 0.0, 0.944]";
    let space = held(&reach(&["control.moment_max_n_m=0", place]));
    let plane = held(&reach(&[
        "control.moment_max_n_m=0",
        "control.force_max_n=[20, 0, 20]",
        place,
    ]));
    let [space, plane] = [space, plane].map(|held| wrench(&free, &held).force);
    assert!((space - plane).norm() < 1e-4 * space.norm());
}

/// A force of 1.6 N balances this target, and the arm leaves it: the equilibrium is unstable, as small motions about it say too. The nearest target
/// that is held is.
#[test]
fn balance_is_not_hold() {
    let problem = problem(TOLERANT, &["task.position_m=[0.2, 0, 0.446]"]);
    let Holding::CannotBeHeld {
        why: CannotHold::Unstable(balanced),
        nearest: Some((nearest, distance)),
    } = holding(&problem).unwrap()
    else {
        panic!("held")
    };
    let force = problem.wrenches(&balanced.controls)[0].force.norm();
    assert!((force - 1.59).abs() < 0.01, "{force}");
    let rod = loaded(&problem, &balanced);
    let motions = SmallMotions::about(&rod, &balanced.shape, 1.0);
    let (here, there) = (
        balanced.growth_rate.unwrap(),
        motions.growth_rate().unwrap(),
    );
    // Without the damping of the material, which slows the growth.
    assert!(0.0 < here && here < 1.001 * there, "{here} {there}");
    assert!(nearest.is_stable && nearest.is_within_bounds());
    assert!(distance > 0.0 && distance < 0.02, "{distance}");
}

/// Tips that a force alone holds on an arm without weight whose shear and stretch hardly matter. A shape whose force pulls back toward the base's axis
/// turns about that axis by itself, so that the lowest of them are those of Euler's buckled column, `x = 2 p/K(p)`, `z = 2 E(p)/K(p) - 1`: an
/// independent route to the edge, which is 0.9424, 0.8943 and 0.8271 for x = 0.3, 0.4, 0.5 of the length.
#[test]
fn tips_held_by_a_force_form_a_sheet() {
    let text = TOLERANT
        .replace("elements = 8", "elements = 30")
        .replace("radius_m = 0.02", "radius_m = 0.004")
        .replace("force_max_n = 5.0", "force_max_n = 0.05");
    for (x, edge) in [(0.3, 0.94241), (0.4, 0.89432), (0.5, 0.82711)] {
        let at = |z: f64| {
            let place = format!("task.position_m=[{}, 0, {}]", 0.5 * x, 0.5 * z);
            problem(&text, &[&place])
        };
        held(&at(edge + 0.002));
        match holding(&at(edge - 0.002)).unwrap() {
            Holding::CannotBeHeld {
                why: CannotHold::Unstable(_),
                nearest: Some((_, distance)),
            } => {
                // To where an arm still sways at a tenth of its frequency, a little above the edge.
                assert!((0.0005..0.01).contains(&(distance / 0.5)), "{distance}");
            }
            other => panic!("{x}: {other:?}"),
        }
    }
}

/// Without anything that acts, an arm stays where it rests and nowhere else; three components of a force do not hold position and orientation.
#[test]
fn too_little_holds_nothing() {
    let away = problem(
        TOLERANT,
        &[
            "task.orientation_wxyz=[0.9659, 0, 0.2588, 0]",
            "control.moment_max_n_m=0",
        ],
    );
    assert!(matches!(
        holding(&away).unwrap(),
        Holding::CannotBeHeld {
            why: CannotHold::TooFewControls {
                controls: 3,
                equations: 6
            },
            ..
        }
    ));
}

/// The path of a rod whose loads all grow together.
fn critical_factor(rod: &Rod, varied: Varied) -> Critical {
    let stop = StopSignal::default();
    let path = LoadPath::new(rod, varied, 0.0, None, &stop).unwrap();
    path.critical(&path.start().unwrap()).unwrap()
}

/// The factor at which stability is lost in this way.
fn lost(rod: &Rod, varied: Varied, expected: Loss) -> f64 {
    match critical_factor(rod, varied) {
        Critical::Lost { factor, how } => {
            assert_eq!(how, expected);
            factor
        }
        kept @ Critical::Kept { .. } => panic!("{kept:?}"),
    }
}

/// An error that falls with the square of the elements' length: by four from `n` to `2 n` elements, and to no more than `tolerance`.
fn assert_converges(what: &str, exact: f64, n: usize, tolerance: f64, of: impl Fn(usize) -> f64) {
    let [coarse, fine] = [n, 2 * n].map(|n| (of(n) / exact - 1.0).abs());
    let order = (coarse / fine).log2();
    assert!(
        (1.8..2.2).contains(&order) && fine < tolerance,
        "{what}: order {order}, errors {coarse:e} {fine:e}"
    );
}

/// Critical load factors against closed forms, at second order in the elements: Euler's `π²/4 EI/L²` of a dead force on the tip, Greenhill's
/// `7.837 EI/L³` of the own weight, Beck's `20.05 EI/L²` of a force that turns with the tip (Beck 1952), where motions of two frequencies meet and grow.
#[test]
fn critical_load_factors_are_the_published_ones() {
    // Shear and stretch change the factors by about P/GA, the inertia of sections Beck's by about J/(m L²).
    let slender = |n: usize| RodParameters {
        section: SectionProfile::Uniform(Section {
            linear_stiffness: Vector3::repeat(1e6),
            angular_stiffness: Vector3::repeat(1.0),
            mass: 1.0,
            rotary: Vector3::repeat(1e-6),
        }),
        ..unit_rod(StrainRule::Helical, n, 1e6)
    };
    let pressed = |n: usize, frame| {
        Rod::new(&RodParameters {
            loads: tip_load(n, [0.0, 0.0, -1.0], [0.0; 3], frame),
            ..slender(n)
        })
        .unwrap()
    };
    let euler = |n| lost(&pressed(n, LoadFrame::Spatial), Varied::All, Loss::Buckling);
    assert_converges("Euler", 0.25 * PI * PI, 8, 2e-3, euler);
    let greenhill = |n| {
        let rod = Rod::new(&RodParameters {
            gravity: Vector3::new(0.0, 0.0, -1.0),
            ..slender(n)
        })
        .unwrap();
        lost(&rod, Varied::All, Loss::Buckling)
    };
    assert_converges("Greenhill", 7.837_347, 8, 3e-3, greenhill);
    let beck = |n| lost(&pressed(n, LoadFrame::Body), Varied::All, Loss::Flutter);
    assert_converges("Beck", 20.05, 10, 1e-2, beck);
}

/// Under a moment fixed to the section, the growth of all motions begins at the critical factor, on grids whose fast motions grow
/// before slow ones and on others: an arm without gravity, bent by a moment in the plane of two of its axes, with viscous damping.
#[test]
fn all_motions_decide_about_a_moment() {
    for (n, twist) in [(8, 0.0), (8, 0.02), (16, 0.02)] {
        let rod = Rod::new(&RodParameters {
            loads: tip_load(n, [0.0; 3], [0.2, 0.1, twist], LoadFrame::Body),
            viscous_damping: 0.3,
            ..unit_rod(StrainRule::Helical, n, 1e4)
        })
        .unwrap();
        let factor = lost(&rod, Varied::All, Loss::Flutter);
        let stop = StopSignal::default();
        let path = LoadPath::new(&rod, Varied::All, 0.0, None, &stop).unwrap();
        let start = path.start().unwrap();
        let grows = |factor: f64| {
            let at = path.at(&start, factor).unwrap();
            let stability = Stability::of(&path.rod_at(factor), &at.shape, 0.0).unwrap();
            stability.growth_rate.is_some()
        };
        eprintln!("{n} {twist} {factor}");
        // Twice the relative error of a factor at which fast motions begin to grow.
        assert!(
            !grows(0.998 * factor) && grows(1.002 * factor),
            "{n}, {factor}"
        );
    }
}

/// The factor multiplies what it is asked to: of an upright column under its weight `w` (of Greenhill's) and a force `p` (of Euler's), which loses its stability at
/// about `w + p = 1` (Dunkerley, whose estimate is low by no more than a few parts in a hundred).
#[test]
fn the_factor_multiplies_what_is_asked() {
    let n = 16;
    let (w, p) = (0.4, 0.3);
    let rod = Rod::new(&RodParameters {
        gravity: Vector3::new(0.0, 0.0, -w * 7.837_347),
        loads: tip_load(
            n,
            [0.0, 0.0, -p * 0.25 * PI * PI],
            [0.0; 3],
            LoadFrame::Spatial,
        ),
        ..unit_rod(StrainRule::Helical, n, 1e6)
    })
    .unwrap();
    for (varied, expected) in [
        (Varied::All, 1.0 / (w + p)),
        (Varied::Loads, (1.0 - w) / p),
        (Varied::Gravity, (1.0 - p) / w),
    ] {
        let factor = lost(&rod, varied, Loss::Buckling);
        let over = factor / expected;
        assert!((0.995..1.05).contains(&over), "{varied:?}: {factor}");
        // At the factor the smallest eigenvalue vanishes: on either side of it the column sways, or topples.
        let stop = StopSignal::default();
        let path = LoadPath::new(&rod, varied, 0.0, None, &stop).unwrap();
        let grows = |factor: f64| {
            let rod = path.rod_at(factor);
            let none = NodeSpring::default();
            let shape = nearby_equilibrium_until(&rod, &rod.rest, 0.0, &none, &stop).unwrap();
            SmallMotions::about(&rod, &shape, 0.0)
                .growth_rate()
                .is_some()
        };
        assert!(!grows(0.999 * factor) && grows(1.001 * factor));
    }
}

/// A sweep over a load across the tip is the elastica (Bisshopp and Drucker 1945; Mattiasson 1981), to the error of its elements, which the equilibrium of twice
/// as many elements tells; it is stable throughout.
#[test]
fn a_sweep_across_is_the_elastica() {
    let rows = elastica();
    let last = 10.0;
    let error = |n: usize| {
        let rod = Rod::new(&RodParameters {
            loads: tip_load(n, [last, 0.0, 0.0], [0.0; 3], LoadFrame::Spatial),
            ..unit_rod(StrainRule::Helical, n, 1e7)
        })
        .unwrap();
        let stop = StopSignal::default();
        let path = LoadPath::new(&rod, Varied::All, 0.0, None, &stop).unwrap();
        let mut at = path.start().unwrap();
        let mut worst = 0.0_f64;
        for row in rows.iter().filter(|row| row.load <= last) {
            at = path.at(&at, row.load / last).unwrap();
            assert!(at.stability.unwrap().is_stable && !at.jumped);
            worst = worst.max(row.position_error(&at.shape));
        }
        worst
    };
    let [coarse, fine] = [20, 40].map(error);
    let order = (coarse / fine).log2();
    assert!(
        (1.9..2.1).contains(&order) && fine < 2e-4,
        "order {order}, errors {coarse:e} {fine:e}"
    );
}

/// A hanging arm is stable under any load factor until it is stretched beyond rods; the base carries its weight, and its tip sinks by `ρA g L²/(2 EA)`.
#[test]
fn hanging_arms_never_buckle() {
    let arm = Arm {
        gravity: Vector3::new(0.0, 0.0, 9.81),
        ..Arm::cylinder(&Material::isotropic(1e6, 0.5, 1000.0), 1.0, 0.05)
    };
    let discretization = Discretization::with_elements(10);
    let options = StaticsOptions::default();
    let found = statics(&arm, &discretization, &options, &StopSignal::default()).unwrap();
    let rod = &found.rod;
    let weight = rod.mass() * 9.81;
    let sinks = 0.5 * weight / rod.elements[0].linear_stiffness.z;
    let tip = found.own.shape.positions[rod.tip()];
    assert!((tip.z - 1.0 - sinks).abs() < 1e-9, "{tip} {sinks}");
    let base = rod.static_reaction(&found.own.shape, 0.0);
    assert!((base.force - Vector3::new(0.0, 0.0, -weight)).norm() < 1e-9 * weight);
    let Critical::Kept { factor, why } = found.critical else {
        panic!("{:?}", found.critical)
    };
    // The first element carries all of the weight but half of its own.
    let largest = 0.3 / (2.0 * sinks * (1.0 - 0.05));
    assert_eq!(why, Kept::OutOfRange);
    assert!(
        factor < largest && factor > 0.5 * largest,
        "{factor} {largest}"
    );
    assert!(found.refined_space.unwrap() < 1e-9);
    assert!(found.goes_to.is_none());
}

/// A column above its Euler load: its straight equilibrium is unstable, and pushed a little it goes to the tip of the published table of post-buckling.
#[test]
fn a_buckled_column_goes_to_its_published_shape() {
    let row = *post_buckling().iter().find(|row| row.load > 2.9).unwrap();
    let (n, ei) = (40, 1e6 * PI * 0.01_f64.powi(4) / 4.0);
    let mut arm = Arm::cylinder(&Material::isotropic(1e6, 0.5, 1000.0), 1.0, 0.01);
    arm.loads.push(PointLoad {
        force: Vector3::new(0.0, 0.0, -row.load * ei),
        at: Place::Tip,
        ..PointLoad::default()
    });
    let discretization = Discretization::with_elements(n);
    let options = StaticsOptions::default();
    let found = statics(&arm, &discretization, &options, &StopSignal::default()).unwrap();
    assert!(found.own.stability.unwrap().growth_rate.is_some());
    let there = found.goes_to.expect("a stable shape");
    let tip = there.shape.positions[n];
    let apart = (tip.xy().norm() - row.deflection).abs() + (tip.z - 1.0 + row.shortening).abs();
    // The error of elements, as in `axial_post_buckling`, and the stretch of this thicker rod.
    let euler = 0.25 * PI * PI;
    let allowed = row.load / (row.load - euler) * (5e-4 + 0.75 * row.load * 1e-4);
    assert!(apart < allowed, "{apart:e} {allowed:e}");
}

/// A column between two clamps that carries its weight: straight it is stable up to the load at which the energy of bending beside the work of
/// the weight has no minimum there (a Ritz series, the weight being borne half by either end). Beyond it, pushed a little, its middle goes
/// aside, the tip being held; and an imperfection in the middle bends it gradually to that side.
#[test]
fn columns_between_clamps_buckle_under_their_weight() {
    // Weight q L³/EI at which ∫ w''² = q ∫ (s - 1/2) w'² for w = Σ c_k (cos (k-1)πs - cos (k+1)πs), the force being (s - 1/2) q L in compression
    // towards the lower end at s = 1.
    let count = 14;
    let steps = 4000;
    let (mut bends, mut falls) = (DMatrix::zeros(count, count), DMatrix::zeros(count, count));
    for step in 0..steps {
        let s = (f64::from(step) + 0.5) / f64::from(steps);
        let of = |k: usize| {
            let (a, b) = (PI * k as f64, PI * (k + 2) as f64);
            let slope = -a * (a * s).sin() + b * (b * s).sin();
            let bend = -a * a * (a * s).cos() + b * b * (b * s).cos();
            (slope, bend)
        };
        for i in 0..count {
            for j in 0..count {
                bends[(i, j)] += of(i).1 * of(j).1 / f64::from(steps);
                falls[(i, j)] += (s - 0.5) * of(i).0 * of(j).0 / f64::from(steps);
            }
        }
    }
    let root: DMatrix<f64> = Cholesky::new(bends).unwrap().l().try_inverse().unwrap();
    let scaled = &root * falls * root.transpose();
    let critical = 1.0 / scaled.symmetric_eigenvalues().max();

    let (n, radius, density) = (20, 0.01, 1000.0);
    let material = Material::isotropic(1e8, 0.5, density);
    let mut arm = Arm::cylinder(&material, 1.0, radius);
    let bending = 1e8 * PI * radius.powi(4) / 4.0;
    let weight = density * PI * radius * radius;
    arm.gravity = Vector3::new(0.0, 0.0, -1.2 * critical * bending / weight);
    arm.tip = EndCondition::Clamped;
    let discretization = Discretization::with_elements(n);
    let run = |imperfection: f64| {
        let options = StaticsOptions {
            imperfection,
            ..StaticsOptions::default()
        };
        statics(&arm, &discretization, &options, &StopSignal::default()).unwrap()
    };
    let found = run(0.0);
    let Critical::Lost { factor, how } = found.critical else {
        panic!("{:?}", found.critical);
    };
    assert_eq!(how, Loss::Buckling);
    // Elements soften by about (half a wave of four)²; shear and stretch of this column by 1e-3.
    assert!((factor * 1.2 - 1.0).abs() < 0.02, "{factor}");
    assert!(found.own.stability.unwrap().growth_rate.is_some());
    let there = found.goes_to.expect("a stable shape");
    let width = |shape: &Configuration| {
        let aside = shape.positions.iter().map(|x| x.xy().norm());
        aside.fold(0.0, f64::max)
    };
    // Its ends do not approach, so that it stretches as it bends: it goes aside by about its radius.
    let aside = width(&there.shape) / radius;
    assert!((0.5..2.0).contains(&aside), "{aside}");
    let pushed = run(1e-3);
    let load = pushed.aside.expect("a force");
    assert!(load.node.abs_diff(n / 2) <= 1, "{}", load.node);
    assert!(pushed.own.stability.unwrap().is_stable);
    let (straight, bent) = (width(&found.own.shape), width(&pushed.own.shape));
    assert!(
        straight < 1e-9 && (bent / width(&there.shape) - 1.0).abs() < 0.1,
        "{straight} {bent}"
    );
}

/// An arm that bends in a plane alone, leans to one side under more than its critical weight and is pulled to the other one snaps through: at the factor found the equilibrium it leans
/// in vanishes, and no other one is near.
#[test]
fn leaning_arms_snap_through() {
    let n = 12;
    let lean: f64 = 0.05;
    let rod = Rod::new(&RodParameters {
        base_rotation: nalgebra::Rotation3::from_axis_angle(&Vector3::y_axis(), -lean).into_inner(),
        gravity: Vector3::new(0.0, 0.0, -1.3 * 7.837_347),
        loads: tip_load(n, [1.0, 0.0, 0.0], [0.0; 3], LoadFrame::Spatial),
        section: SectionProfile::Uniform(Section {
            linear_stiffness: Vector3::repeat(1e5),
            angular_stiffness: Vector3::new(100.0, 1.0, 100.0),
            mass: 1.0,
            rotary: Vector3::repeat(1e-3),
        }),
        ..unit_rod(StrainRule::Helical, n, 1e5)
    })
    .unwrap();
    let factor = lost(&rod, Varied::Loads, Loss::Snapping);
    let stop = StopSignal::default();
    let path = LoadPath::new(&rod, Varied::Loads, 0.0, None, &stop).unwrap();
    let start = path.start().unwrap();
    assert!(start.shape.positions[n].x < -0.3);
    let before = path.at(&start, 0.999 * factor).unwrap();
    assert!(!before.jumped && before.shape.positions[n].x < 0.0);
    // Beyond it there is none nearby: the arm jumps, if the search finds where to.
    let after = path.at(&before, 1.001 * factor);
    assert!(after.is_err() || after.is_ok_and(|after| after.jumped));
}

/// Forty random arms: free, pinned or clamped tips, stiffnesses over five decades, up to four tendons with tensions or on winches, floors. Every
/// one has an equilibrium, about which nothing grows.
#[test]
fn random_arms_have_an_equilibrium() {
    for seed in 0..40 {
        let mut dice = fastrand::Rng::with_seed(seed);
        let mut between = |low: f64, high: f64| low + (high - low) * dice.f64();
        let length = between(0.1, 1.0);
        let radius = length * between(0.005, 0.04);
        let modulus = 10f64.powf(between(5.0, 10.0));
        let elements = [6, 10, 16, 24][between(0.0, 4.0) as usize];
        let direction = Vector3::from_fn(|_, _| between(-1.0, 1.0)).normalize();
        let tip = ["free", "free", "pinned", "clamped"][between(0.0, 4.0) as usize];
        let of = |v: &Vector3<f64>| format!("[{}, {}, {}]", v.x, v.y, v.z);
        let mut text = format!(
            "[rod]\nlength_m = {length}\nelements = {elements}\n[rod.material]\nyoungs_modulus_pa = {modulus}\npoisson_ratio = 0.4\n\
             density_kg_m3 = {}\n[rod.section]\nradius_m = {radius}\n[base]\ndirection = {}\n[gravity]\nacceleration_m_s2 = [0.0, 0.0, -9.81]\n\
             [time]\nend_s = 1.0\n",
            between(900.0, 2000.0),
            of(&direction)
        );
        if tip != "free" {
            let aside = Vector3::from_fn(|_, _| between(-0.4, 0.4));
            let place = (direction + aside).normalize() * between(0.4, 0.95) * length;
            text += &format!("[tip]\nkind = \"{tip}\"\nposition_m = {}\n", of(&place));
        }
        let bending = modulus * PI * radius.powi(4) / 4.0;
        let offset = 0.8 * radius;
        for _ in 0..[0, 1, 2, 4][between(0.0, 4.0) as usize] {
            let (sin, cos) = between(0.0, 2.0 * PI).sin_cos();
            text += &format!(
                "[[tendon]]\noffset_m = [{}, {}]\n",
                offset * cos,
                offset * sin
            );
            if tip != "free" || between(0.0, 1.0) < 0.5 {
                let most = 0.2 * modulus * PI * radius * radius;
                let tension = (bending / (offset * length) * between(0.0, 2.0)).min(most);
                text += &format!("profile = [[0.0, {tension}]]\n");
            } else {
                text += &format!(
                    "displacement_profile = [[0.0, {}]]\ncompliance_1_n = {}\nfree_length_m = {}\n",
                    -offset * between(0.0, 1.5),
                    10f64.powf(between(-5.0, -3.0)),
                    between(0.05, 1.0)
                );
            }
        }
        if between(0.0, 1.0) < 0.35 {
            text += &format!(
                "[[contact]]\nname = \"floor\"\nhalf_space = {{ point_m = [0.0, 0.0, {}], normal = [0.0, 0.0, 1.0] }}\npenetration_m = {}\n",
                -between(0.05, 0.5) * length - radius,
                length * 10f64.powf(between(-3.5, -2.0))
            );
        }
        let (scene, source) = Scene::from_toml("random", &text, &[])
            .unwrap_or_else(|error| panic!("{seed}: {error}\n{text}"));
        let arm = scene.arm(&source).unwrap();
        let rod = arm.rod(&scene.discretization()).unwrap();
        let shape = static_equilibrium(&rod, &rod.rest, 0.0, &NodeSpring::default())
            .unwrap_or_else(|error| panic!("{seed}: {error}\n{text}"));
        let stability = Stability::of(&rod, &shape, 0.0).expect("finite");
        assert_eq!(stability.growth_rate, None, "{seed}:\n{text}");
    }
}
