//! Terms of one's own: what the solver, the derivative check and the certificate make of them.

use crate::common;

use nalgebra::Vector3;
use softarm::control::{
    FreeDuration, NodeForm, PathEnforcement, SharedTerm, StateCost, StateTerm, StateView,
};
use softarm::derivatives::{Verdict, check};
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{Material, Rod};
use softarm::scene::Scene;
use softarm::sqp::SqpSettings;
use softarm::task::{
    Arm, ChannelLimits, Discretization, DiscretizeError, Limit, PathLimit, Place, Task, Track,
};

fn arm() -> Arm {
    Arm {
        viscous_damping: 1.0,
        ..Arm::cylinder(&Material::isotropic(1e6, 0.5, 1000.0), 1.0, 0.05)
    }
}

fn task() -> Task {
    let mut task = Task::reach(Vector3::new(0.4, 0.0, 0.85), 1.0, 20.0);
    task.actuators[0].moment = ChannelLimits::at_most(5.0);
    task
}

fn grid() -> Discretization {
    Discretization {
        elements: 6,
        blocks: 6,
        ..Discretization::default()
    }
}

/// Components of the way of a place from a moving point, over the length.
#[derive(Debug)]
struct Follow {
    at: Place,
}

fn along(t: f64) -> Vector3<f64> {
    Vector3::new(0.4 * t, 0.1 * t, 1.0 - 0.15 * t)
}

impl StateTerm for Follow {
    fn n_values(&self, _: &Rod) -> usize {
        3
    }
    fn nodes(&self, rod: &Rod, _: usize) -> Vec<usize> {
        vec![self.at.node(&rod.mesh)]
    }
    fn value(&self, at: &StateView, item: usize) -> f64 {
        let node = self.at.node(&at.rod.mesh);
        (at.positions[node] - along(at.time))[item] / at.rod.scales.length
    }
    fn gradient(&self, at: &StateView, item: usize) -> NodeForm {
        let node = self.at.node(&at.rod.mesh);
        let axis = Vector3::ith(item, 1.0 / at.rod.scales.length);
        NodeForm::default().along_position(node, &axis)
    }
}

/// `cos(largest) - d₃·e₃` of the tip: its tilt stays below an angle. `error` spoils the derivative.
#[derive(Debug)]
struct Tilt {
    largest: f64,
    error: f64,
}

impl StateTerm for Tilt {
    fn nodes(&self, rod: &Rod, _: usize) -> Vec<usize> {
        vec![rod.tip()]
    }
    fn value(&self, at: &StateView, _: usize) -> f64 {
        self.largest.cos() - at.rotations[at.rod.tip()][(2, 2)]
    }
    fn gradient(&self, at: &StateView, _: usize) -> NodeForm {
        let tip = at.rod.tip();
        let row = at.rotations[tip].row(2).transpose();
        let gradient = -Vector3::z().cross(&row) * (1.0 + self.error);
        NodeForm::default().along_rotation(tip, &gradient)
    }
}

/// A path to follow, written as a term, is the built-in one: the same optimum, with the same certificate.
#[test]
fn a_path_to_follow_is_a_term() {
    let weight = 300.0;
    let mut built_in = task();
    built_in.cost.tracks.push(Track {
        at: Place::Fraction(0.5),
        path: vec![(0.0, along(0.0)), (1.0, along(1.0))],
        weight: Some(weight),
        ..Track::default()
    });
    let mut own = task();
    own.cost.terms.push(StateCost {
        term: SharedTerm::new(Follow {
            at: Place::Fraction(0.5),
        }),
        weight,
    });
    let [theirs, ours] =
        [built_in, own].map(|task| softarm::solve(&arm(), &task, &grid()).unwrap());
    for solution in [&theirs, &ours] {
        let check = solution.certify().unwrap();
        let failed = common::objections_on_its_own_grid(&check);
        assert!(failed.is_empty(), "{failed:?}: {:?}", check.items);
    }
    let difference = ours.objective() / theirs.objective() - 1.0;
    assert!(difference.abs() < 1e-9, "{difference:e}");
    assert!(theirs.objective() > 1.0, "the path matters");
}

/// A tilt that is limited: without the limit the tip tilts further, with it the limit is touched and kept, hard and at a price above its
/// multiplier alike, and the certificate knows it.
#[test]
fn limits_are_kept() {
    let free = softarm::solve(&arm(), &task(), &grid()).unwrap();
    let tilt = |solution: &softarm::solve::Solution| {
        let tip = solution.problem.discrete.rod.tip();
        let trajectory = solution.trajectory();
        (0..trajectory.n_times())
            .map(|k| trajectory.rotations_at(k)[tip][(2, 2)].acos())
            .fold(0.0, f64::max)
    };
    let largest = 0.8 * tilt(&free);
    let limited = |enforcement| {
        let mut task = task();
        task.limits.push(Limit {
            name: "tilt".into(),
            kind: PathLimit::Term(SharedTerm::new(Tilt {
                largest,
                error: 0.0,
            })),
            rate: Some(50.0),
            span: [None; 2],
            enforcement,
        });
        softarm::solve(&arm(), &task, &grid()).unwrap()
    };
    let hard = limited(PathEnforcement::Hard);
    let check = hard.certify().unwrap();
    assert!(check.is_certified(), "{:?}", check.items);
    assert!(hard.objective() > free.objective() * 1.001);
    assert!(
        (tilt(&hard) / largest - 1.0).abs() < 1e-2,
        "{} {largest}",
        tilt(&hard)
    );
    let priced = limited(PathEnforcement::Soft {
        linear: 1e4,
        quadratic: 0.0,
    });
    let check = priced.certify().unwrap();
    assert!(check.is_certified(), "{:?}", check.items);
    let difference = priced.objective() / hard.objective() - 1.0;
    assert!(difference.abs() < 1e-6, "{difference:e}");
}

/// A derivative that is off by a hundredth is found out by the certificate, which has differentiated the values itself.
#[test]
fn wrong_derivatives_are_found_out() {
    let solve = |error: f64| {
        let mut task = task();
        task.cost.terms.push(StateCost {
            term: SharedTerm::new(Tilt {
                largest: 0.0,
                error,
            }),
            weight: 10.0,
        });
        let solution = softarm::solve(&arm(), &task, &grid()).unwrap();
        solution.certify().unwrap()
    };
    assert!(solve(0.0).is_certified());
    let check = solve(0.01);
    let failed: Vec<_> = (check.items.iter())
        .filter(|item| !item.holds())
        .map(|item| item.name)
        .collect();
    assert_eq!(failed, ["kkt.stationarity"]);
}

/// The derivative check has a block for every cost and for every limit of one's own, and finds the one that is off by a hundredth.
#[test]
fn the_derivative_check_sees_terms() {
    for (in_cost, in_limit) in [(0.0, 0.0), (0.01, 0.0), (0.0, 0.01)] {
        let tilt = |error| {
            SharedTerm::new(Tilt {
                largest: 0.3,
                error,
            })
        };
        let mut task = task();
        task.cost.terms.push(StateCost {
            term: SharedTerm::new(Follow { at: Place::Tip }),
            weight: 10.0,
        });
        task.cost.terms.push(StateCost {
            term: tilt(in_cost),
            weight: 10.0,
        });
        task.limits.push(Limit {
            name: "tilt".into(),
            kind: PathLimit::Term(tilt(in_limit)),
            rate: Some(50.0),
            span: [None; 2],
            enforcement: PathEnforcement::Hard,
        });
        let problem = task.discretize(&arm(), &grid()).unwrap();
        let report = check(&problem.discrete, 3).unwrap();
        let verdict = |name: &str| {
            let found = report.blocks.iter().find(|block| block.name == name);
            found.unwrap_or_else(|| panic!("{name}")).verdict
        };
        let expected = |error: f64| [Verdict::Ok, Verdict::Wrong][usize::from(error > 0.0)];
        assert_eq!(verdict("objective.term.0"), Verdict::Ok);
        assert_eq!(verdict("objective.term.1"), expected(in_cost));
        assert_eq!(verdict("objective"), expected(in_cost));
        assert_eq!(verdict("tilt (path)"), expected(in_limit));
        assert_eq!(report.verdict, expected(in_cost + in_limit));
    }
}

/// The curvature that a term has by default is the second derivative of its value: along any direction, of `s ↦ f(x + s δx, R exp(s ζ̂))`.
#[test]
fn curvature_by_default_is_that_of_the_value() {
    let problem = task().discretize(&arm(), &grid()).unwrap().discrete;
    let rod = &problem.rod;
    let tip = rod.tip();
    let positions = rod.rest.positions.clone();
    let mut rotations = rod.rest.rotations.clone();
    rotations[tip] = exp(&Vector3::new(0.4, -0.7, 0.2));
    let term = Tilt {
        largest: 0.3,
        error: 0.0,
    };
    let view = StateView {
        rod,
        time: 0.0,
        positions: &positions,
        rotations: &rotations,
    };
    let matrix = term.curvature(&view, 0);
    for zeta in [
        Vector3::x(),
        Vector3::y(),
        Vector3::new(0.5, -1.0, 2.0),
        Vector3::z(),
    ] {
        let mut along = [0.0; 6];
        along[3..].copy_from_slice(zeta.as_slice());
        let quadratic: f64 = (0..6)
            .flat_map(|i| (0..6).map(move |j| (i, j)))
            .map(|(i, j)| along[i] * matrix[(i, j)] * along[j])
            .sum();
        let value = |s: f64| {
            let mut rotations = rotations.clone();
            rotations[tip] *= exp(&(zeta * s));
            term.value(
                &StateView {
                    rotations: &rotations,
                    ..view
                },
                0,
            )
        };
        let h = 1e-3;
        let second = (value(h) - 2.0 * value(0.0) + value(-h)) / (h * h);
        // The differences leave h²/12 of the fourth derivative, |ζ|⁴ at most.
        let error = h * h / 12.0 * zeta.norm().powi(4) + 1e-8;
        assert!((quadratic - second).abs() < error, "{quadratic} {second}");
    }
}

/// A free duration is refused by name, and no scene can say a term.
#[test]
fn what_does_not_go_with_terms_is_refused() {
    let with_term = || {
        let mut task = task();
        task.cost.terms.push(StateCost {
            term: SharedTerm::new(Follow { at: Place::Tip }),
            weight: 1.0,
        });
        task
    };
    let mut free = with_term();
    free.free_duration = Some(FreeDuration {
        shortest: 0.5,
        longest: 2.0,
        price: 1.0,
    });
    assert!(matches!(
        free.discretize(&arm(), &grid()),
        Err(DiscretizeError::Duration { .. })
    ));
    let problem = with_term().discretize(&arm(), &grid()).unwrap();
    let error = Scene::describing(&problem, &SqpSettings::default()).expect_err("a term");
    assert!(error.to_string().contains("terms of its own"));
}
