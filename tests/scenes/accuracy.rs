//! An accuracy in the place of elements and time step: the grid that is chosen keeps its promise, or the refusal says why there is none.

use std::f64::consts::SQRT_2;

use nalgebra::Vector3;
use softarm::mechanics::{
    LoadFrame, Material, NodeInertia, Section, SectionProfile, SectionSegment, TimeScheme,
};
use softarm::scene::Scene;
use softarm::stop::StopSignal;
use softarm::task::{Arm, Discretization, Place, PointLoad, Start, StartShape};
use softarm::tradeoff::{
    ChoiceError, ComparedMotion, End, Grid, GridErrors, GridRule, Measured, Order, choose,
    first_elements, search,
};

fn silicone() -> Material {
    Material::isotropic(1e6, 0.5, 1000.0)
}

fn pull(force: [f64; 3], profile: &[(f64, f64)]) -> PointLoad {
    PointLoad {
        at: Place::Tip,
        force: force.into(),
        frame: LoadFrame::Spatial,
        profile: profile.to_vec(),
        ..PointLoad::default()
    }
}

/// A wire of nitinol, 0.3 m long and 1 mm thick.
fn wire() -> Arm {
    Arm::cylinder(&Material::isotropic(6e10, 0.33, 6450.0), 0.3, 0.0005)
}

/// The moment on its tip that holds this wire bent into a circle, `2π EI/L`, N m.
fn circle_moment() -> Vector3<f64> {
    let stiffness = 6e10 * std::f64::consts::PI * 0.0005f64.powi(4) / 4.0;
    Vector3::new(0.0, std::f64::consts::TAU * stiffness / 0.3, 0.0)
}

/// A damped arm that a force pulls aside, a hanging tapered arm that is let go, one with internal damping out of the plane, and one of two
/// segments with a body, whose elements have three lengths.
fn motions() -> [(&'static str, ComparedMotion); 4] {
    let from_rest = |arm, duration| ComparedMotion {
        arm,
        start: Start::default(),
        duration,
    };
    let pulled = Arm {
        viscous_damping: 1.0,
        loads: vec![pull([4.0, 0.0, 0.0], &[(0.0, 0.0), (0.3, 1.0), (9.0, 1.0)])],
        ..Arm::cylinder(&silicone(), 1.0, 0.05)
    };
    let hanging = Arm {
        gravity: Vector3::new(0.0, 0.0, -9.81),
        viscous_damping: 2.0,
        loads: vec![pull(
            [0.05, 0.0, 0.0],
            &[(0.0, 0.0), (0.2, 1.0), (0.4, 0.0)],
        )],
        ..Arm::cone(&silicone(), 0.3, [0.02, 0.01])
    }
    .pointing(Vector3::new(0.0, 0.0, -1.0));
    let twisted = Arm {
        internal_damping: 0.01,
        rest_curvature: Vector3::new(0.8, 0.0, 1.5),
        loads: vec![pull([1.0, 2.0, 0.5], &[(0.0, 0.0), (0.2, 1.0), (9.0, 1.0)])],
        ..Arm::cylinder(&silicone(), 1.0, 0.05)
    };
    let stiff = Material::isotropic(4e6, 0.5, 1200.0);
    let segments = [
        (0.3, Section::circle(&stiff, 0.05)),
        (1.0, Section::circle(&silicone(), 0.04)),
    ];
    let body = NodeInertia {
        mass: 0.4,
        rotary: Vector3::repeat(2e-4),
    };
    let in_pieces = Arm {
        viscous_damping: 1.0,
        bodies: vec![(0.45, body)],
        loads: vec![pull([2.0, 0.0, 0.0], &[(0.0, 0.0), (0.3, 1.0), (9.0, 1.0)])],
        ..Arm::straight(
            1.0,
            SectionProfile::Segments(
                segments
                    .map(|(to, section)| SectionSegment {
                        to,
                        section: SectionProfile::Uniform(section),
                    })
                    .into(),
            ),
        )
    };
    [
        ("in pieces", from_rest(in_pieces, 0.8)),
        ("pulled", from_rest(pulled, 1.0)),
        (
            "hanging",
            ComparedMotion {
                start: Start {
                    shape: StartShape::Equilibrium,
                    ..Start::default()
                },
                ..from_rest(hanging, 0.8)
            },
        ),
        ("twisted", from_rest(twisted, 0.6)),
    ]
}

/// How far the motion on a grid is from that with four times the elements and a quarter of the step, over the length.
fn true_error(motion: &ComparedMotion, chosen: Discretization) -> f64 {
    let fine = Discretization {
        step: chosen.step.map(|step| 0.25 * step),
        ..chosen.refined(4)
    };
    let [own, truth] =
        [chosen, fine].map(|grid| motion.run(&grid, &StopSignal::default()).unwrap());
    own.course.errors(&truth.course, motion.arm.length).shape
}

/// The motion on the chosen grid is as near as promised to that with four times the elements and a quarter of the step; and the grid is not
/// needlessly fine: the error is not below a twentieth of what was asked, unless the coarsest grid is that good.
#[test]
fn grids_keep_their_promise() {
    let stop = StopSignal::default();
    for (name, motion) in motions() {
        for accuracy in [1e-2, 1e-3] {
            let choice = choose(&motion, &Discretization::default(), accuracy, &stop).unwrap();
            let chosen = choice.discretization;
            let error = true_error(&motion, chosen);
            assert!(error <= accuracy, "{name}: {error} for {accuracy}");
            assert!(choice.error <= accuracy, "{name}");
            let coarsest = chosen.elements <= first_elements(accuracy).div_ceil(2).max(4);
            assert!(
                coarsest || error > accuracy / 20.0,
                "{name}: {error} for {accuracy}"
            );
        }
    }
}

/// The search for the grid of a stiff wire takes implicit steps from its first motion on, though that one alone is not long enough for them to be
/// chosen; the promise holds.
#[test]
fn searches_take_the_integrator_of_their_grids() {
    let stop = StopSignal::default();
    let motion = ComparedMotion {
        arm: Arm {
            viscous_damping: 2.0,
            loads: vec![pull([0.02, 0.0, 0.0], &[])],
            ..wire()
        },
        start: Start::default(),
        duration: 0.5,
    };
    let accuracy = 1e-2;
    let choice = choose(&motion, &Discretization::default(), accuracy, &stop).unwrap();
    let alone = Discretization {
        elements: choice.levels[0].elements,
        ..Discretization::default()
    };
    let alone = (motion.arm).discretize(motion.duration, &alone).unwrap();
    assert_eq!(alone.discretization.scheme, Some(TimeScheme::Explicit));
    let chosen = choice.discretization;
    assert_eq!(chosen.scheme, Some(TimeScheme::Implicit));
    assert!(choice.levels[0].step_s > 20.0 * alone.grid.step);
    let error = true_error(&motion, chosen);
    assert!(error <= accuracy, "{error}");
}

/// Implicit steps are longer than automatic ones, which allow for an arm that is bent into a circle at any speed: where a wire is little bent, and where a
/// moment slowly bends it into that circle, as far as they are accurate there. Both promises hold.
#[test]
fn searches_take_long_steps_where_the_arm_is_little_bent() {
    let stop = StopSignal::default();
    let wire = Arm {
        viscous_damping: 20.0,
        ..wire()
    };
    let slowly = |load: PointLoad| PointLoad {
        profile: vec![(0.0, 0.0), (0.2, 1.0), (9.0, 1.0)],
        ..load
    };
    let over_automatic = |load: PointLoad| {
        let motion = ComparedMotion {
            arm: Arm {
                loads: vec![slowly(load)],
                ..wire.clone()
            },
            start: Start::default(),
            duration: 0.4,
        };
        let accuracy = 1e-2;
        let open = Discretization {
            scheme: Some(TimeScheme::Implicit),
            ..Discretization::default()
        };
        let chosen = choose(&motion, &open, accuracy, &stop)
            .unwrap()
            .discretization;
        let error = true_error(&motion, chosen);
        assert!(error <= accuracy, "{error}");
        let automatic = Discretization {
            step: None,
            ..chosen
        };
        let automatic = (motion.arm)
            .discretize(motion.duration, &automatic)
            .unwrap();
        chosen.step.unwrap() / automatic.grid.step
    };
    let little = over_automatic(pull([0.01, 0.0, 0.0], &[]));
    assert!(little > 2.0, "{little}");
    let circle = over_automatic(PointLoad {
        moment: circle_moment(),
        frame: LoadFrame::Body,
        ..pull([0.0; 3], &[])
    });
    assert!(circle > 2.0, "{circle}");
}

/// A sudden moment that would hold a wire bent into a circle bends it further than automatic implicit steps can follow: the search takes shorter ones,
/// and the promise holds.
#[test]
fn motions_that_break_down_are_tried_with_shorter_steps() {
    let stop = StopSignal::default();
    let moment = PointLoad {
        moment: circle_moment(),
        ..pull([0.0; 3], &[])
    };
    let motion = ComparedMotion {
        arm: Arm {
            viscous_damping: 2.0,
            loads: vec![moment],
            ..wire()
        },
        start: Start::default(),
        duration: 0.01,
    };
    let open = Discretization {
        scheme: Some(TimeScheme::Implicit),
        ..Discretization::default()
    };
    let accuracy = 1e-2;
    let chosen = choose(&motion, &open, accuracy, &stop)
        .unwrap()
        .discretization;
    let automatic = Discretization {
        step: None,
        ..chosen
    };
    assert!(motion.run(&automatic, &stop).is_err());
    let error = true_error(&motion, chosen);
    assert!(error <= accuracy, "{error}");
}

/// A coil has more turns than the elements that a loose accuracy begins with can show; the search takes as many as it needs, also to confirm them.
#[test]
fn coils_have_the_elements_that_their_shape_needs() {
    let stop = StopSignal::default();
    let motion = ComparedMotion {
        arm: Arm {
            viscous_damping: 2.0,
            rest_curvature: Vector3::new(0.0, 60.0, 0.0),
            loads: vec![pull(
                [0.05, 0.02, 0.0],
                &[(0.0, 0.0), (0.1, 1.0), (9.0, 1.0)],
            )],
            ..wire()
        },
        start: Start::default(),
        duration: 0.2,
    };
    let accuracy = 1e-2;
    let few = Discretization {
        elements: first_elements(accuracy),
        ..Discretization::default()
    };
    assert!(motion.run(&few, &stop).is_err());
    let choice = choose(&motion, &Discretization::default(), accuracy, &stop).unwrap();
    let error = true_error(&motion, choice.discretization);
    assert!(error <= accuracy, "{error}");
}

/// Errors `a/K² + b h²`, over the length, with which grids are measured exactly.
fn modelled([a, b]: [f64; 2], grid: Grid) -> GridErrors {
    let k = grid.elements as f64;
    GridErrors {
        grid,
        parts: [a / (k * k), b * grid.step * grid.step],
    }
}

/// Of all grids on which the model expects an error up to the aim, no coarser than the one that was measured, the one that is chosen takes the least time
/// `K/h`, but for a whole element.
#[test]
fn refinement_follows_the_errors() {
    let grid = Grid {
        elements: 10,
        step: 0.01,
    };
    let aim = 6e-4;
    for parts in [
        [1.5e-3, 1e-5],
        [1e-5, 1.5e-3],
        [1e-3, 8e-4],
        [8e-4, 1e-3],
        [2e-4, 1e-3],
        [1.0, 1.0],
    ] {
        let measured = GridErrors { grid, parts };
        let chosen = measured.cheapest(aim);
        assert!(chosen.elements >= 10 && chosen.step <= grid.step * (1.0 + 1e-12));
        let error = measured.on(chosen).error();
        assert!(error <= aim * (1.0 + 1e-9), "{parts:?}: {error}");
        let time = |grid: Grid| grid.elements as f64 / grid.step;
        let least = (10..=2000)
            .filter_map(|elements| {
                let step = grid.step;
                let [of_elements, of_steps] = measured.on(Grid { elements, step }).parts;
                let allowed = step * ((aim - of_elements) / of_steps).sqrt();
                let step = allowed.min(step);
                (of_elements < aim).then(|| time(Grid { elements, step }))
            })
            .fold(f64::INFINITY, f64::min);
        let whole = 1.0 + 1.0 / chosen.elements as f64;
        assert!(
            time(chosen) <= least * whole * whole * (1.0 + 1e-9),
            "{parts:?}: {chosen:?} {} {least}",
            time(chosen)
        );
    }
}

/// Motions whose errors follow the model are at a distance from each other that gives these errors, whichever of elements and steps is refined.
#[test]
fn distances_of_two_grids_give_their_errors() {
    let coarse = Grid {
        elements: 8,
        step: 0.01,
    };
    let errors = [0.5, 40.0];
    for (elements, step) in [(12, 0.008), (8, 0.005), (16, 0.01), (9, 0.0099)] {
        let grid = Grid { elements, step };
        let [before, after] = [coarse, grid].map(|grid| modelled(errors, grid));
        let distance = before.error() - after.error();
        // Known too high by a factor, but for the part that is not seen.
        let seen = before.seen(grid, distance);
        for (seen, own) in seen.parts.iter().zip(after.parts) {
            assert!((seen - own).abs() <= 1e-9 * own, "{seen} {own}");
        }
        let doubled = GridErrors {
            parts: before.parts.map(|part| 2.0 * part),
            ..before
        };
        if elements != 8 && step != 0.01 {
            let seen = doubled.seen(grid, distance).error();
            assert!((seen - after.error()).abs() <= 1e-9 * after.error());
        }
    }
}

/// A search ends on a grid that is accurate enough where errors follow the model, and says so where they do not fall or where the grid takes too long.
#[test]
fn searches_end() {
    let first = Grid {
        elements: 6,
        step: 0.02,
    };
    let rule = GridRule {
        accuracy: 1e-3,
        order: Order::Assumed,
        longest: 3600.0,
    };
    let run = |seconds: f64, error: &dyn Fn(Grid) -> GridErrors| {
        let mut tried = Vec::new();
        let found = search(&rule, first, |grid, _| {
            tried.push(grid);
            Ok::<_, ()>(Some(Measured {
                estimate: error(grid),
                seconds: seconds * grid.elements as f64 / grid.step,
                too_coarse: false,
            }))
        });
        (found.unwrap(), tried)
    };
    let ((last, end), tried) = run(1e-6, &|grid| modelled([0.5, 20.0], grid));
    assert_eq!(end, End::Met);
    assert!(last.unwrap().estimate.error() <= 0.75e-3);
    for pair in tried.windows(2) {
        let finer = pair[1].elements as f64 / pair[0].elements as f64;
        let whole = 1.0 / pair[0].elements as f64;
        assert!((1.0..=SQRT_2 + whole).contains(&finer), "{tried:?}");
        assert!(pair[0].step / pair[1].step <= SQRT_2 + 1e-9, "{tried:?}");
    }
    let ((_, end), tried) = run(1e-6, &|grid| GridErrors {
        grid,
        parts: [0.1, 0.1],
    });
    assert_eq!((end, tried.len()), (End::OutOfReach, 3));
    let ((_, end), tried) = run(10.0, &|grid| modelled([0.5, 20.0], grid));
    assert!(matches!(end, End::TooLong { .. }) && tried.len() == 1);
    let nothing = search(&rule, first, |_, _| Ok::<_, ()>(None)).unwrap();
    assert!(nothing.0.is_none() && nothing.1 == End::Unmeasured);
}

/// A steel wire to 1e-8 for a minute is refused with the time that it would take, at once.
#[test]
fn what_takes_hours_is_refused() {
    let steel = Material::isotropic(2e11, 0.3, 7850.0);
    let motion = ComparedMotion {
        arm: Arm {
            loads: vec![pull([1e-3, 0.0, 0.0], &[])],
            ..Arm::cylinder(&steel, 0.5, 0.5e-3)
        },
        start: Start::default(),
        duration: 60.0,
    };
    let refusal = choose(
        &motion,
        &Discretization::default(),
        1e-8,
        &StopSignal::default(),
    );
    let Err(error @ ChoiceError::TooLong { hours, .. }) = refusal else {
        panic!("{refusal:?}");
    };
    assert!(hours > 1.0);
    assert!(error.to_string().contains("hours"), "{error}");
}

const ARM: &str = "[rod]\nlength_m = 1.0\n[rod.material]\npreset = \"ecoflex-00-30\"\n[rod.section]\nradius_m = 0.02\n[time]\nend_s = 0.2\n";

fn read(text: &str, overrides: &[&str]) -> Result<Scene, String> {
    let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
    (Scene::from_toml("scene", text, &overrides))
        .map(|(scene, _)| scene)
        .map_err(|error| error.to_string())
}

/// A scene without elements asks for 1e-3; keys of the command line take the place of those of the file; what contradicts is refused with
/// the key.
#[test]
fn accuracies_and_elements_exclude_each_other() {
    let scene = read(ARM, &[]).unwrap();
    assert_eq!(scene.accuracy(), Some(1e-3));
    assert_eq!(scene.rod.elements, first_elements(1e-3));
    let with_elements = ARM.replace("[rod]\n", "[rod]\nelements = 7\n");
    assert_eq!(read(&with_elements, &[]).unwrap().accuracy(), None);
    let scene = read(&with_elements, &["rod.accuracy=1e-2"]).unwrap();
    assert_eq!(scene.accuracy(), Some(1e-2));
    let with_accuracy = ARM.replace("[rod]\n", "[rod]\naccuracy = 1e-2\n");
    let scene = read(&with_accuracy, &["rod.elements=9"]).unwrap();
    assert_eq!((scene.accuracy(), scene.rod.elements), (None, 9));
    let both = with_accuracy.replace("[rod]\n", "[rod]\nelements = 7\n");
    let with_step = format!("{ARM}step_s = 1e-4\n");
    let with_index = format!("{ARM}[[load]]\nnode = 3\nforce_n = [1.0, 0.0, 0.0]\n");
    for (text, words) in [
        (both.as_str(), ["rod.accuracy", "contradicts rod.elements"]),
        (with_step.as_str(), ["rod.elements", "time.step_s is given"]),
        (with_index.as_str(), ["load.0.node", "without rod.elements"]),
        (
            &with_accuracy.replace("1e-2", "0.5"),
            ["rod.accuracy", "1e-8 to 0.1"],
        ),
        (
            &with_accuracy.replace("1e-2", "\"fine\""),
            ["rod.accuracy", "number"],
        ),
    ] {
        let error = read(text, &[]).unwrap_err();
        for word in words {
            assert!(error.contains(word), "{word}: {error}");
        }
    }
}

/// On another grid, nodes that are named by their index stay at their places.
#[test]
fn nodes_stay_at_their_places() {
    let text = format!(
        "{}[[load]]\nnode = 3\nforce_n = [1.0, 0.0, 0.0]\n[[load]]\nnode = \"tip\"\nforce_n = [1.0, 0.0, 0.0]\n",
        ARM.replace("[rod]\n", "[rod]\nelements = 4\n")
    );
    let scene = read(&text, &[]).unwrap();
    assert!(scene.names_nodes_of(8) && scene.names_nodes_of(12) && !scene.names_nodes_of(6));
    let finer = scene.with_grid(&Discretization::with_elements(12));
    assert_eq!(finer.load[0].node, softarm::scene::LoadNode::Index(9));
    assert_eq!(finer.load[1].node, softarm::scene::LoadNode::Tip);
}
