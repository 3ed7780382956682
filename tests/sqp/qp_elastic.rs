//! The elastic quadratic subproblem: known solutions, working sets, multipliers, and what it refuses.

use faer::Mat;
use softarm::sqp::quadratic_program::{LinearInequalities, QpError, QuadraticProgram};
use softarm::sqp::{ConvexSet, Softness};

fn identity(n: usize) -> Mat<f64> {
    Mat::identity(n, n)
}

fn none() -> LinearInequalities<'static> {
    static EMPTY: std::sync::LazyLock<Mat<f64>> = std::sync::LazyLock::new(|| Mat::zeros(0, 0));
    LinearInequalities {
        jacobian: &EMPTY,
        offset: &[],
        softness: &[],
        groups: &[],
        first: &[],
    }
}

/// A subproblem without rows, sets and trust region, at an elastic weight of 1.
fn bare<'a>(
    hessian: &'a Mat<f64>,
    gradient: &'a [f64],
    jacobian: &'a Mat<f64>,
) -> QuadraticProgram<'a> {
    QuadraticProgram {
        hessian,
        gradient,
        jacobian,
        offset: &[],
        inequalities: none(),
        variables: &[],
        sets: &[],
        elastic_weight: 1.0,
        trust_radius: f64::INFINITY,
        unlimited: &[],
        row_tolerance: 1e-9,
        stop: None,
        states: None,
        expected: None,
    }
}

/// Projection of a point outside onto a ball, without constraints: known solution, outward normal, right sign.
#[test]
fn ball_projects() {
    let hessian = identity(2);
    let jacobian = Mat::zeros(0, 2);
    let qp = QuadraticProgram {
        variables: &[0.0, 0.0],
        sets: &[ConvexSet::ball([0, 1], 1.0)],
        ..bare(&hessian, &[-3.0, -4.0], &jacobian)
    };
    let solution = qp.solve().expect("solvable");
    assert!((solution.change[0] - 0.6).abs() < 1e-8 && (solution.change[1] - 0.8).abs() < 1e-8);
    // Stationarity: δ + g + normal = 0.
    let normal = &solution.multipliers.normals[0];
    assert!((normal[0] - 2.4).abs() < 1e-6 && (normal[1] - 3.2).abs() < 1e-6);
}

/// Intervals at either side, with normals that close the stationarity condition.
#[test]
fn intervals_hold_on_both_sides() {
    let hessian = identity(2);
    let jacobian = Mat::zeros(0, 2);
    let variables = [0.5, 0.5];
    let set = |index| ConvexSet::Interval {
        index,
        lower: -1.0,
        upper: 1.0,
    };
    let qp = QuadraticProgram {
        variables: &variables,
        sets: &[set(0), set(1)],
        ..bare(&hessian, &[-9.0, 9.0], &jacobian)
    };
    let solution = qp.solve().expect("solvable");
    assert!((solution.change[0] - 0.5).abs() < 1e-8 && (solution.change[1] + 1.5).abs() < 1e-8);
    assert!((solution.multipliers.normals[0][0] - 8.5).abs() < 1e-6);
    assert!((solution.multipliers.normals[1][0] + 7.5).abs() < 1e-6);
}

/// A constraint that contradicts a set: the slack is the missing value, the multiplier equals the elastic weight.
#[test]
fn elastic_weight_bounds_the_multiplier() {
    let hessian = identity(1);
    let jacobian = Mat::from_fn(1, 1, |_, _| 1.0);
    let qp = QuadraticProgram {
        offset: &[-5.0],
        variables: &[0.0],
        sets: &[ConvexSet::Interval {
            index: 0,
            lower: -1.0,
            upper: 1.0,
        }],
        elastic_weight: 100.0,
        ..bare(&hessian, &[0.0], &jacobian)
    };
    let solution = qp.solve().expect("always feasible");
    assert!((solution.change[0] - 1.0).abs() < 1e-7);
    assert!((solution.slack - 4.0).abs() < 1e-6);
    assert!((solution.multipliers.constraints[0].abs() - 100.0).abs() < 1e-3);
}

/// A NaN never reaches the solver.
#[test]
fn nan_is_refused() {
    let hessian = identity(1);
    let jacobian = Mat::zeros(0, 1);
    let qp = QuadraticProgram {
        variables: &[0.0],
        ..bare(&hessian, &[f64::NAN], &jacobian)
    };
    assert_eq!(qp.solve(), Err(QpError::NotFinite("gradient")));
}

/// Many rows with three kinds of price: the exchange of working sets ends at the solution of the problem with all rows.
#[test]
fn exchange_finds_the_full_solution() {
    const ROWS: usize = 600;
    let n = 8;
    let angle = |i: usize, j: usize| (j as f64 + 0.5) * (i as f64) / ROWS as f64;
    let rows = Mat::from_fn(ROWS, n, |i, j| (3.0 * angle(i, j)).cos());
    let offset: Vec<f64> = (0..ROWS).map(|i| -0.4 - 0.1 * angle(i, 3).sin()).collect();
    let hard = vec![Softness::Hard; ROWS];
    let soft = vec![
        Softness::Soft {
            linear: 0.05,
            quadratic: 0.1,
        };
        ROWS
    ];
    let mixed: Vec<Softness> = (0..ROWS)
        .map(|i| [Softness::Hard, soft[0], Softness::FREE][i * 3 / ROWS])
        .collect();
    let (hessian, jacobian) = (identity(n), Mat::zeros(0, n));
    let groups: Vec<usize> = (0..ROWS).collect();
    for softness in [&hard, &soft, &mixed] {
        let qp = QuadraticProgram {
            inequalities: LinearInequalities {
                jacobian: &rows,
                offset: &offset,
                softness,
                groups: &groups,
                first: &[],
            },
            variables: &[0.0; 8],
            elastic_weight: 100.0,
            ..bare(
                &hessian,
                &[-1.0, 0.7, -0.4, 0.9, -0.3, 0.2, -0.8, 0.1],
                &jacobian,
            )
        };
        let all: Vec<usize> = (0..ROWS)
            .filter(|&at| softness[at] != Softness::FREE)
            .collect();
        let full = qp.solve_with(&all).expect("feasible");
        let found = qp.solve().expect("feasible");
        let seen = found.working.len();
        assert!(0 < seen && seen < ROWS / 4, "{seen}");
        assert!(full.multipliers.inequalities.iter().any(|z| *z > 0.01));
        for (a, b) in found.change.iter().zip(&full.change) {
            assert!((a - b).abs() < 1e-8, "{a} {b}");
        }
    }
}

/// A problem that Clarabel cannot solve is returned in Clarabel's JSON, with its cones.
#[test]
fn unsolved_problem_is_saved() {
    let (hessian, jacobian) = (identity(1), Mat::zeros(0, 1));
    let qp = QuadraticProgram {
        variables: &[0.0],
        sets: &[
            ConvexSet::ball([0], 1.0),
            ConvexSet::HalfSpace {
                direction: vec![(0, -1.0)],
                limit: -2.0,
            },
        ],
        ..bare(&hessian, &[0.0], &jacobian)
    };
    let Err(QpError::Status {
        problem: Some(problem),
        ..
    }) = qp.solve()
    else {
        panic!("the sets have no common point");
    };
    let problem: serde_json::Value = serde_json::from_str(&problem).expect("JSON");
    assert_eq!(problem["cones"].as_array().map(Vec::len), Some(2));
    assert_eq!(problem["b"].as_array().map(Vec::len), Some(3));
}

/// A row at its limit has its multiplier however small the trust region is: a step of `δ`, which wants to be 1, along `0.1 δ ≤ 0`. A row on
/// which `δ` has no effect has none.
#[test]
fn small_regions_keep_the_multipliers_of_rows() {
    let hessian = identity(1);
    let jacobian = Mat::zeros(0, 1);
    let rows = Mat::from_fn(2, 1, |i, _| [0.1, 0.0][i]);
    let qp = QuadraticProgram {
        inequalities: LinearInequalities {
            jacobian: &rows,
            offset: &[0.0, 0.0],
            softness: &[Softness::Hard; 2],
            groups: &[0, 1],
            first: &[],
        },
        variables: &[0.5],
        elastic_weight: 1e3,
        trust_radius: 5e-9,
        ..bare(&hessian, &[-1.0], &jacobian)
    };
    let solution = qp.solve().expect("solvable");
    assert!(solution.change[0].abs() < 1e-11, "{:e}", solution.change[0]);
    let multipliers = &solution.multipliers.inequalities;
    assert!((multipliers[0] - 10.0).abs() < 1e-6, "{multipliers:?}");
    assert_eq!(multipliers[1], 0.0);
}
