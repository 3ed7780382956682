//! The solver on programs with inequalities: published optima, soft rows, screening.

use crate::toy;

use std::cell::Cell;
use std::ops::ControlFlow;

use faer::Mat;
use softarm::sqp::{
    ConvexSet, Evaluation, Failure, HessianChoice, LiftedProgram, Linearization,
    LinearizationRequest, SADDLE_GAIN, Softness, SqpOutcome, SqpSettings, SqpStatus, solve,
};
use toy::{CHOICES, Jet, Point, Program, go, near, polynomial as p, root, settings};

/// A problem of Hock and Schittkowski (1981) by its number, its optimum and objective there, and how well a residual of
/// 1e-8 and the printed digits determine them.
struct Known {
    name: &'static str,
    start: Vec<f64>,
    optimum: Vec<f64>,
    objective: f64,
    accuracy: f64,
    program: Program,
}

/// `lower ≤ x[index] ≤ upper`; only what is finite.
fn bounds(limits: &[(f64, f64)]) -> Vec<ConvexSet> {
    let mut sets = Vec::new();
    for (index, &(lower, upper)) in limits.iter().enumerate() {
        if lower.is_finite() && upper.is_finite() {
            sets.push(ConvexSet::Interval {
                index,
                lower,
                upper,
            });
        } else if lower.is_finite() {
            sets.push(ConvexSet::HalfSpace {
                direction: vec![(index, -1.0)],
                limit: -lower,
            });
        } else if upper.is_finite() {
            sets.push(ConvexSet::HalfSpace {
                direction: vec![(index, 1.0)],
                limit: upper,
            });
        }
    }
    sets
}

const FREE: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);
const POSITIVE: (f64, f64) = (0.0, f64::INFINITY);

/// An objective that is no sum of squares; the identity stands in for Gauss-Newton.
fn plain(
    objective: impl Fn(&[Jet]) -> Jet + 'static,
    inequalities: impl Fn(&[Jet]) -> Vec<Jet> + 'static,
    sets: Vec<ConvexSet>,
) -> Program {
    Program {
        plain: Some(Box::new(move |x| vec![objective(x)])),
        identity: 1.0,
        inequalities: Box::new(inequalities),
        sets,
        ..Program::default()
    }
}

/// `Σ factor (x[index] - goal)²`, a sum of squares.
fn squares(
    terms: &'static [(f64, usize, f64)],
    inequalities: impl Fn(&[Jet]) -> Vec<Jet> + 'static,
    sets: Vec<ConvexSet>,
) -> Program {
    Program {
        residuals: Box::new(move |x| {
            let residual = |&(factor, index, goal): &(f64, usize, f64)| {
                (x[index].clone() - goal) * (2.0 * factor).sqrt()
            };
            terms.iter().map(residual).collect()
        }),
        inequalities: Box::new(inequalities),
        sets,
        ..Program::default()
    }
}

/// Objective and constraints of the transformer design, HS93, share these.
fn transformer(x: &[Jet]) -> [Jet; 4] {
    let first = p(x, &[(1.0, &[0]), (1.0, &[1]), (1.0, &[2])]) * p(x, &[(1.0, &[0, 3])]);
    let second = p(x, &[(1.0, &[0]), (1.57, &[1]), (1.0, &[3])]) * p(x, &[(1.0, &[1, 2])]);
    let (fifth, sixth) = (x[4].square(), x[5].square());
    [first.clone(), second.clone(), first * fifth, second * sixth]
}

#[allow(clippy::too_many_lines)]
fn known() -> Vec<Known> {
    let known = |name, start: &[f64], optimum: &[f64], objective, accuracy, program| Known {
        name,
        start: start.to_vec(),
        optimum: optimum.to_vec(),
        objective,
        accuracy,
        program: Program {
            n_variables: start.len(),
            ..program
        },
    };
    let a = (7.5 * root(6) + 338.5f64.sqrt()).cbrt();
    let ln10 = 10f64.ln();
    vec![
        known(
            "HS10",
            &[-10.0, 10.0],
            &[0.0, 1.0],
            -1.0,
            1e-6,
            plain(
                |x| p(x, &[(1.0, &[0]), (-1.0, &[1])]),
                |x| {
                    vec![p(
                        x,
                        &[(3.0, &[0, 0]), (-2.0, &[0, 1]), (1.0, &[1, 1]), (-1.0, &[])],
                    )]
                },
                Vec::new(),
            ),
        ),
        known(
            "HS11",
            &[4.9, 0.1],
            &[(a - 1.0 / a) / root(6), (a * a - 2.0 + 1.0 / (a * a)) / 6.0],
            -8.498_464_223 + 25.0,
            1e-6,
            squares(
                &[(1.0, 0, 5.0), (1.0, 1, 0.0)],
                |x| vec![p(x, &[(1.0, &[0, 0]), (-1.0, &[1])])],
                Vec::new(),
            ),
        ),
        known(
            "HS12",
            &[0.0, 0.0],
            &[2.0, 3.0],
            -30.0,
            1e-6,
            plain(
                |x| {
                    p(
                        x,
                        &[
                            (0.5, &[0, 0]),
                            (1.0, &[1, 1]),
                            (-1.0, &[0, 1]),
                            (-7.0, &[0]),
                            (-7.0, &[1]),
                        ],
                    )
                },
                |x| vec![p(x, &[(4.0, &[0, 0]), (1.0, &[1, 1]), (-25.0, &[])])],
                Vec::new(),
            ),
        ),
        known(
            "HS15",
            &[-2.0, 1.0],
            &[0.5, 2.0],
            306.5,
            1e-5,
            Program {
                residuals: Box::new(|x| {
                    vec![
                        p(x, &[(1.0, &[1]), (-1.0, &[0, 0])]) * (10.0 * root(2)),
                        p(x, &[(1.0, &[0]), (-1.0, &[])]) * root(2),
                    ]
                }),
                ..plain(
                    |x| p(x, &[]),
                    |x| {
                        vec![
                            p(x, &[(-1.0, &[0, 1]), (1.0, &[])]),
                            p(x, &[(-1.0, &[0]), (-1.0, &[1, 1])]),
                        ]
                    },
                    bounds(&[(f64::NEG_INFINITY, 0.5), FREE]),
                )
            },
        ),
        known(
            "HS21",
            &[-1.0, -1.0],
            &[2.0, 0.0],
            0.04,
            1e-6,
            squares(
                &[(0.01, 0, 0.0), (1.0, 1, 0.0)],
                |x| vec![p(x, &[(-10.0, &[0]), (1.0, &[1]), (10.0, &[])])],
                bounds(&[(2.0, 50.0), (-50.0, 50.0)]),
            ),
        ),
        known(
            "HS22",
            &[2.0, 2.0],
            &[1.0, 1.0],
            1.0,
            1e-6,
            squares(
                &[(1.0, 0, 2.0), (1.0, 1, 1.0)],
                |x| {
                    vec![
                        p(x, &[(1.0, &[0]), (1.0, &[1]), (-2.0, &[])]),
                        p(x, &[(1.0, &[0, 0]), (-1.0, &[1])]),
                    ]
                },
                Vec::new(),
            ),
        ),
        known(
            "HS24",
            &[1.0, 0.5],
            &[3.0, root(3)],
            -1.0,
            1e-5,
            plain(
                |x| {
                    let cubic = p(x, &[(1.0, &[0, 0]), (-6.0, &[0])]);
                    cubic * p(x, &[(1.0 / (27.0 * root(3)), &[1, 1, 1])])
                },
                |x| {
                    vec![
                        p(x, &[(-1.0 / root(3), &[0]), (1.0, &[1])]),
                        p(x, &[(-1.0, &[0]), (-root(3), &[1])]),
                        p(x, &[(1.0, &[0]), (root(3), &[1]), (-6.0, &[])]),
                    ]
                },
                bounds(&[POSITIVE, POSITIVE]),
            ),
        ),
        known(
            "HS29",
            &[1.0, 1.0, 1.0],
            &[4.0, 2.0 * root(2), 2.0],
            -16.0 * root(2),
            1e-5,
            plain(
                |x| p(x, &[(-1.0, &[0, 1, 2])]),
                |x| {
                    vec![p(
                        x,
                        &[(1.0, &[0, 0]), (2.0, &[1, 1]), (4.0, &[2, 2]), (-48.0, &[])],
                    )]
                },
                Vec::new(),
            ),
        ),
        // The curvature along x₂ vanishes at the optimum: it is determined to the root of the residual of 1e-6.
        known(
            "HS30",
            &[1.0, 1.0, 1.0],
            &[1.0, 0.0, 0.0],
            1.0,
            1e-3,
            squares(
                &[(1.0, 0, 0.0), (1.0, 1, 0.0), (1.0, 2, 0.0)],
                |x| vec![p(x, &[(-1.0, &[0, 0]), (-1.0, &[1, 1]), (1.0, &[])])],
                bounds(&[(1.0, 10.0), (-10.0, 10.0), (-10.0, 10.0)]),
            ),
        ),
        known(
            "HS31",
            &[1.0, 1.0, 1.0],
            &[1.0 / root(3), root(3), 0.0],
            6.0,
            1e-5,
            squares(
                &[(9.0, 0, 0.0), (1.0, 1, 0.0), (9.0, 2, 0.0)],
                |x| vec![p(x, &[(-1.0, &[0, 1]), (1.0, &[])])],
                bounds(&[(-10.0, 10.0), (1.0, 10.0), (-10.0, 1.0)]),
            ),
        ),
        known(
            "HS33",
            &[0.0, 0.0, 3.0],
            &[0.0, root(2), root(2)],
            root(2) - 6.0,
            1e-5,
            plain(
                |x| {
                    p(
                        x,
                        &[
                            (1.0, &[0, 0, 0]),
                            (-6.0, &[0, 0]),
                            (11.0, &[0]),
                            (-6.0, &[]),
                            (1.0, &[2]),
                        ],
                    )
                },
                |x| {
                    vec![
                        p(x, &[(1.0, &[0, 0]), (1.0, &[1, 1]), (-1.0, &[2, 2])]),
                        p(
                            x,
                            &[
                                (-1.0, &[0, 0]),
                                (-1.0, &[1, 1]),
                                (-1.0, &[2, 2]),
                                (4.0, &[]),
                            ],
                        ),
                    ]
                },
                bounds(&[POSITIVE, POSITIVE, (0.0, 5.0)]),
            ),
        ),
        known(
            "HS34",
            &[0.0, 1.05, 2.9],
            &[ln10.ln(), ln10, 10.0],
            -ln10.ln(),
            1e-5,
            plain(
                |x| x[0].clone() * -1.0,
                |x| vec![x[0].exp() - x[1].clone(), x[1].exp() - x[2].clone()],
                bounds(&[(0.0, 100.0), (0.0, 100.0), (0.0, 10.0)]),
            ),
        ),
        known(
            "HS35",
            &[0.5, 0.5, 0.5],
            &[4.0 / 3.0, 7.0 / 9.0, 4.0 / 9.0],
            1.0 / 9.0,
            1e-5,
            plain(
                |x| {
                    p(
                        x,
                        &[
                            (9.0, &[]),
                            (-8.0, &[0]),
                            (-6.0, &[1]),
                            (-4.0, &[2]),
                            (2.0, &[0, 0]),
                            (2.0, &[1, 1]),
                            (1.0, &[2, 2]),
                            (2.0, &[0, 1]),
                            (2.0, &[0, 2]),
                        ],
                    )
                },
                |x| vec![p(x, &[(1.0, &[0]), (1.0, &[1]), (2.0, &[2]), (-3.0, &[])])],
                bounds(&[POSITIVE, POSITIVE, POSITIVE]),
            ),
        ),
        known(
            "HS43",
            &[0.0; 4],
            &[0.0, 1.0, 2.0, -1.0],
            -44.0,
            1e-5,
            plain(
                |x| {
                    p(
                        x,
                        &[
                            (1.0, &[0, 0]),
                            (1.0, &[1, 1]),
                            (2.0, &[2, 2]),
                            (1.0, &[3, 3]),
                            (-5.0, &[0]),
                            (-5.0, &[1]),
                            (-21.0, &[2]),
                            (7.0, &[3]),
                        ],
                    )
                },
                |x| {
                    let row = |squares: [f64; 4], linear: [f64; 4], constant: f64| {
                        (0..4).fold(p(x, &[(constant, &[])]), |sum, i| {
                            sum + p(x, &[(squares[i], &[i, i]), (linear[i], &[i])])
                        })
                    };
                    vec![
                        row([1.0; 4], [1.0, -1.0, 1.0, -1.0], -8.0),
                        row([1.0, 2.0, 1.0, 2.0], [-1.0, 0.0, 0.0, -1.0], -10.0),
                        row([2.0, 1.0, 1.0, 0.0], [2.0, -1.0, 0.0, -1.0], -5.0),
                    ]
                },
                Vec::new(),
            ),
        ),
        known(
            "HS65",
            &[-5.0, 5.0, 0.0],
            &[3.650_461_821, 3.650_461_68, 4.620_417_050_7],
            0.953_528_856_7,
            1e-5,
            Program {
                residuals: Box::new(|x| {
                    vec![
                        p(x, &[(1.0, &[0]), (-1.0, &[1])]) * root(2),
                        p(x, &[(1.0, &[0]), (1.0, &[1]), (-10.0, &[])]) * (root(2) / 3.0),
                        p(x, &[(1.0, &[2]), (-5.0, &[])]) * root(2),
                    ]
                }),
                inequalities: Box::new(|x| {
                    vec![p(
                        x,
                        &[(1.0, &[0, 0]), (1.0, &[1, 1]), (1.0, &[2, 2]), (-48.0, &[])],
                    )]
                }),
                sets: bounds(&[(-4.5, 4.5), (-4.5, 4.5), (-5.0, 5.0)]),
                ..Program::default()
            },
        ),
        known(
            "HS66",
            &[0.0, 1.05, 2.9],
            &[0.184_126_487_9, 1.202_167_873, 3.327_322_322],
            0.518_163_274_1,
            1e-5,
            plain(
                |x| p(x, &[(0.2, &[2]), (-0.8, &[0])]),
                |x| vec![x[0].exp() - x[1].clone(), x[1].exp() - x[2].clone()],
                bounds(&[(0.0, 100.0), (0.0, 100.0), (0.0, 10.0)]),
            ),
        ),
        known(
            "HS71",
            &[1.0, 5.0, 5.0, 1.0],
            &[1.0, 4.742_999_4, 3.821_150_3, 1.379_408_2],
            17.014_017_3,
            1e-6,
            Program {
                constraints: Box::new(|x| {
                    vec![p(
                        x,
                        &[
                            (1.0, &[0, 0]),
                            (1.0, &[1, 1]),
                            (1.0, &[2, 2]),
                            (1.0, &[3, 3]),
                            (-40.0, &[]),
                        ],
                    )]
                }),
                ..plain(
                    |x| {
                        p(
                            x,
                            &[
                                (1.0, &[0, 0, 3]),
                                (1.0, &[0, 1, 3]),
                                (1.0, &[0, 2, 3]),
                                (1.0, &[2]),
                            ],
                        )
                    },
                    |x| vec![p(x, &[(-1.0, &[0, 1, 2, 3]), (25.0, &[])])],
                    bounds(&[(1.0, 5.0); 4]),
                )
            },
        ),
        known(
            "HS76",
            &[0.5; 4],
            &[3.0 / 11.0, 23.0 / 11.0, 0.0, 6.0 / 11.0],
            -103.0 / 22.0,
            1e-5,
            plain(
                |x| {
                    p(
                        x,
                        &[
                            (1.0, &[0, 0]),
                            (0.5, &[1, 1]),
                            (1.0, &[2, 2]),
                            (0.5, &[3, 3]),
                            (-1.0, &[0, 2]),
                            (1.0, &[2, 3]),
                            (-1.0, &[0]),
                            (-3.0, &[1]),
                            (1.0, &[2]),
                            (-1.0, &[3]),
                        ],
                    )
                },
                |x| {
                    vec![
                        p(
                            x,
                            &[
                                (1.0, &[0]),
                                (2.0, &[1]),
                                (1.0, &[2]),
                                (1.0, &[3]),
                                (-5.0, &[]),
                            ],
                        ),
                        p(
                            x,
                            &[
                                (3.0, &[0]),
                                (1.0, &[1]),
                                (2.0, &[2]),
                                (-1.0, &[3]),
                                (-4.0, &[]),
                            ],
                        ),
                        p(x, &[(-1.0, &[1]), (-4.0, &[2]), (1.5, &[])]),
                    ]
                },
                bounds(&[POSITIVE; 4]),
            ),
        ),
        known(
            "HS93",
            &[5.54, 4.4, 12.02, 11.82, 0.702, 0.852],
            &[
                5.332_666,
                4.656_744,
                10.432_99,
                12.082_30,
                0.752_607_4,
                0.878_650_84,
            ],
            135.075_961,
            1e-4,
            plain(
                |x| {
                    let [a, b, c, d] = transformer(x);
                    a * 0.0204 + b * 0.0187 + c * 0.0607 + d * 0.0437
                },
                |x| {
                    let [_, _, c, d] = transformer(x);
                    vec![
                        p(x, &[(-0.001, &[0, 1, 2, 3, 4, 5]), (2.07, &[])]),
                        c * 0.00062 + d * 0.00058 - 1.0,
                    ]
                },
                bounds(&[POSITIVE; 6]),
            ),
        ),
        known(
            "HS100",
            &[1.0, 2.0, 0.0, 4.0, 0.0, 1.0, 1.0],
            &[
                2.330_499,
                1.951_372,
                -0.477_541_4,
                4.365_726,
                -0.624_487_0,
                1.038_131,
                1.594_227,
            ],
            680.630_057_3,
            2e-5,
            plain(
                |x| {
                    let shifted = (x[0].clone() - 10.0).square()
                        + (x[1].clone() - 12.0).square() * 5.0
                        + (x[3].clone() - 11.0).square() * 3.0;
                    shifted
                        + p(
                            x,
                            &[
                                (1.0, &[2; 4]),
                                (10.0, &[4; 6]),
                                (7.0, &[5, 5]),
                                (1.0, &[6; 4]),
                                (-4.0, &[5, 6]),
                                (-10.0, &[5]),
                                (-8.0, &[6]),
                            ],
                        )
                },
                |x| {
                    vec![
                        p(
                            x,
                            &[
                                (2.0, &[0, 0]),
                                (3.0, &[1; 4]),
                                (1.0, &[2]),
                                (4.0, &[3, 3]),
                                (5.0, &[4]),
                                (-127.0, &[]),
                            ],
                        ),
                        p(
                            x,
                            &[
                                (7.0, &[0]),
                                (3.0, &[1]),
                                (10.0, &[2, 2]),
                                (1.0, &[3]),
                                (-1.0, &[4]),
                                (-282.0, &[]),
                            ],
                        ),
                        p(
                            x,
                            &[
                                (23.0, &[0]),
                                (1.0, &[1, 1]),
                                (6.0, &[5, 5]),
                                (-8.0, &[6]),
                                (-196.0, &[]),
                            ],
                        ),
                        p(
                            x,
                            &[
                                (4.0, &[0, 0]),
                                (1.0, &[1, 1]),
                                (-3.0, &[0, 1]),
                                (2.0, &[2, 2]),
                                (5.0, &[5]),
                                (-11.0, &[6]),
                            ],
                        ),
                    ]
                },
                Vec::new(),
            ),
        ),
        known(
            "HS113",
            &[2.0, 3.0, 5.0, 5.0, 1.0, 2.0, 7.0, 3.0, 6.0, 10.0],
            &[
                2.171_996,
                2.363_683,
                8.773_926,
                5.095_984,
                0.990_654_8,
                1.430_574,
                1.321_644,
                9.828_726,
                8.280_092,
                8.375_927,
            ],
            24.306_209_1,
            1e-5,
            plain(
                |x| {
                    let shifted = [
                        (1.0, 2, 10.0),
                        (4.0, 3, 5.0),
                        (1.0, 4, 3.0),
                        (2.0, 5, 1.0),
                        (5.0, 6, 0.0),
                        (7.0, 7, 11.0),
                        (2.0, 8, 10.0),
                        (1.0, 9, 7.0),
                    ];
                    let start = p(
                        x,
                        &[
                            (1.0, &[0, 0]),
                            (1.0, &[1, 1]),
                            (1.0, &[0, 1]),
                            (-14.0, &[0]),
                            (-16.0, &[1]),
                            (45.0, &[]),
                        ],
                    );
                    (shifted.iter()).fold(start, |sum, &(factor, i, goal)| {
                        sum + (x[i].clone() - goal).square() * factor
                    })
                },
                |x| {
                    let far = |i: usize, goal: f64| (x[i].clone() - goal).square();
                    vec![
                        p(
                            x,
                            &[
                                (4.0, &[0]),
                                (5.0, &[1]),
                                (-3.0, &[6]),
                                (9.0, &[7]),
                                (-105.0, &[]),
                            ],
                        ),
                        p(x, &[(10.0, &[0]), (-8.0, &[1]), (-17.0, &[6]), (2.0, &[7])]),
                        p(
                            x,
                            &[
                                (-8.0, &[0]),
                                (2.0, &[1]),
                                (5.0, &[8]),
                                (-2.0, &[9]),
                                (-12.0, &[]),
                            ],
                        ),
                        far(0, 2.0) * 3.0
                            + far(1, 3.0) * 4.0
                            + p(x, &[(2.0, &[2, 2]), (-7.0, &[3]), (-120.0, &[])]),
                        far(2, 6.0)
                            + p(
                                x,
                                &[(5.0, &[0, 0]), (8.0, &[1]), (-2.0, &[3]), (-40.0, &[])],
                            ),
                        far(0, 8.0) * 0.5
                            + far(1, 4.0) * 2.0
                            + p(x, &[(3.0, &[4, 4]), (-1.0, &[5]), (-30.0, &[])]),
                        far(1, 2.0) * 2.0
                            + p(
                                x,
                                &[(1.0, &[0, 0]), (-2.0, &[0, 1]), (14.0, &[4]), (-6.0, &[5])],
                            ),
                        far(8, 8.0) * 12.0 + p(x, &[(-3.0, &[0]), (6.0, &[1]), (-7.0, &[9])]),
                    ]
                },
                Vec::new(),
            ),
        ),
    ]
}

/// Every Hessian reaches the published optimum, to what a scaled residual of 1e-8 says about it. Gauss-Newton only where
/// there is one, and not HS31: there the Hessian of the Lagrangian along the tangent is twice that of Gauss-Newton (24 and
/// 12), so that its steps overshoot by as much as they should have covered.
#[test]
fn known_optima_are_found() {
    let mut failures = Vec::new();
    for problem in known() {
        let mut counts = Vec::new();
        for hessian in CHOICES {
            let has_none = problem.program.plain.is_some() || problem.name == "HS31";
            if has_none && hessian == HessianChoice::GaussNewton {
                counts.push("    -".to_string());
                continue;
            }
            let mut settings = settings(hessian);
            if problem.name == "HS30" {
                // No curvature along x₂ at the optimum: at 1e-8 the objective is flat to rounding.
                settings.tolerance = 1e-6;
            }
            let outcome = go(&problem.program, &problem.start, &settings);
            counts.push(format!("{:5}", outcome.history.len() - 1));
            let distance = (outcome.point.v.iter())
                .zip(&problem.optimum)
                .fold(0.0f64, |m, (a, b)| m.max((a - b).abs()));
            let short = (outcome.objective - problem.objective).abs();
            if outcome.status != SqpStatus::Converged
                || !(distance < problem.accuracy)
                || !(short < problem.accuracy)
            {
                failures.push(format!(
                    "{} {hessian:?}: {:?}, {distance:e} away, objective off by {short:e}, {:?}",
                    problem.name, outcome.status, outcome.residual
                ));
            }
        }
        println!("{:6} {}", problem.name, counts.join(" "));
    }
    assert!(failures.is_empty(), "{failures:#?}");
}

/// Beside a saddle, `½ x² + ¼ (y² - 1)² + 1` at y = 1e-12, the way out only doubles in an iteration by Newton's steps. A solver that passes
/// saddles does not wait for that; one that asks for more than there is to gain waits, or stays.
#[test]
fn saddles_are_passed() {
    let objective = |x: &[Jet]| {
        let bowls = [
            (0.5, &[0, 0][..]),
            (0.25, &[1, 1, 1, 1]),
            (-0.5, &[1, 1]),
            (1.25, &[]),
        ];
        p(x, &bowls)
    };
    let program = Program {
        n_variables: 2,
        ..plain(objective, |_| Vec::new(), Vec::new())
    };
    let [waiting, leaving] = [1e3, SADDLE_GAIN].map(|saddle_gain| {
        let settings = SqpSettings {
            saddle_gain,
            ..settings(HessianChoice::Exact)
        };
        go(&program, &[0.1, 1e-12], &settings)
    });
    assert_eq!(leaving.status, SqpStatus::Converged);
    let end = &leaving.point.v;
    near(&[end[0], end[1].abs()], &[0.0, 1.0], 1e-6);
    assert!(leaving.history.len() <= 15, "{}", leaving.history.len());
    // Its steps are shorter than rounding for long, so that it may also end there.
    let ends_there = waiting.point.v[1].abs() < 1e-3;
    assert!(ends_there || waiting.history.len() > 2 * leaving.history.len());
}

/// Through a saddle, `½ x² + ¼ x⁴ + ¼ ε (y² - 1)² + 1` from `(1, 0)`, by symmetry: where `ε/4` is more than the asked part of the
/// objective, it is passed; where it is less, the saddle is the result.
#[test]
fn saddles_are_passed_for_a_gain_that_is_worth_it() {
    for (epsilon, end) in [(0.4, 1.0), (0.01, 0.0)] {
        let objective = move |x: &[Jet]| {
            let bowls = [
                (0.5, &[0, 0][..]),
                (0.25, &[0, 0, 0, 0]),
                (0.25 * epsilon, &[1, 1, 1, 1]),
                (-0.5 * epsilon, &[1, 1]),
                (0.25 * epsilon + 1.0, &[]),
            ];
            p(x, &bowls)
        };
        let program = Program {
            n_variables: 2,
            ..plain(objective, |_| Vec::new(), Vec::new())
        };
        let outcome = go(&program, &[1.0, 0.0], &settings(HessianChoice::Exact));
        assert_eq!(outcome.status, SqpStatus::Converged);
        near(&[outcome.point.v[1].abs()], &[end], 1e-6);
    }
}

/// Maratos' example, as an equation and as an inequality: full steps raise the objective and the violation, and an exact
/// Hessian still converges quadratically, because a step is judged by the Lagrangian or corrected.
#[test]
fn maratos_effect_does_not_stall() {
    for is_equation in [true, false] {
        let circle = |x: &[Jet]| vec![p(x, &[(1.0, &[0, 0]), (1.0, &[1, 1]), (-1.0, &[])])];
        let objective = |x: &[Jet]| p(x, &[(2.0, &[0, 0]), (2.0, &[1, 1]), (-10.0, &[0])]);
        let mut program = Program {
            n_variables: 2,
            ..plain(objective, |_| Vec::new(), Vec::new())
        };
        if is_equation {
            program.constraints = Box::new(circle);
        } else {
            program.inequalities = Box::new(circle);
        }
        for hessian in [HessianChoice::Auto, HessianChoice::Exact] {
            let outcome = go(&program, &[0.8, 0.6], &settings(hessian));
            assert_eq!(outcome.status, SqpStatus::Converged, "{hessian:?}");
            near(&outcome.point.v, &[1.0, 0.0], 1e-6);
            assert!(outcome.history.len() <= 10, "{}", outcome.history.len());
        }
    }
}

/// A long slope of negative curvature, `½ x² + x y²/10 - yᵐ` with `y ≤ 3`: a step of the gradient divided by the size of the curvature is
/// `y/(m - 1)` long, 15 to 30 iterations from 0.1, although the model is good much farther. The trust region alone limits steps.
#[test]
fn slopes_of_negative_curvature_are_no_crawl() {
    for power in [4, 8, 12] {
        for start in [0.1, 0.5] {
            let all = vec![1; power];
            let objective = move |x: &[Jet]| {
                p(
                    x,
                    &[(0.5, &[0, 0][..]), (-1.0, &all[..]), (0.1, &[0, 1, 1])],
                )
            };
            let program = Program {
                n_variables: 2,
                ..plain(objective, |_| Vec::new(), bounds(&[FREE, (-1.0, 3.0)]))
            };
            let outcome = go(&program, &[0.1, start], &settings(HessianChoice::Exact));
            assert_eq!(outcome.status, SqpStatus::Converged);
            near(&outcome.point.v, &[-0.9, 3.0], 1e-6);
            assert!(
                outcome.history.len() <= 8,
                "{power} {start}: {}",
                outcome.history.len()
            );
        }
    }
}

/// Such a slope on a parabola, `min m (y - x²) - x⁴` with `ε (y - x²) = 0` and `0 ≤ x ≤ 3`, whose multiplier is `-m/ε`: a step violates the
/// row by its square, which changes the objective by `m` times that and says nothing of the model. A merit `J + 2 |λ| θ` holds the steps to
/// a third of `4 x³/m`.
#[test]
fn curved_rows_do_not_shorten_steps() {
    for m in [1.0, 10.0, 100.0] {
        for scale in [1.0, 1e-3, 1e-5] {
            let objective =
                move |x: &[Jet]| p(x, &[(m, &[1][..]), (-m, &[0, 0]), (-1.0, &[0, 0, 0, 0])]);
            let row = move |x: &[Jet]| vec![p(x, &[(scale, &[1]), (-scale, &[0, 0])])];
            let program = Program {
                n_variables: 2,
                constraints: Box::new(row),
                ..plain(objective, |_| Vec::new(), bounds(&[(0.0, 3.0), FREE]))
            };
            let outcome = go(&program, &[0.3, 0.09], &settings(HessianChoice::Exact));
            assert_eq!(outcome.status, SqpStatus::Converged);
            near(&outcome.point.v, &[3.0, 9.0], 1e-6);
            assert!(
                outcome.history.len() <= 12,
                "{m} {scale}: {}",
                outcome.history.len()
            );
        }
    }
}

/// Wächter and Biegler's example (2000): `x₁² - x₂ = 1`, `x₁ - x₃ = ½`, `x₂, x₃ ≥ 0`, on which line searches jam at points
/// that mean nothing. The optimum is (1, 0, ½); at (-1, 0, 0) the sum of the violations has a strict local minimum (towards
/// larger `x₁` the second falls by 1 and the first grows by 2). A solve ends at one of the two and says which.
#[test]
fn linearized_steps_do_not_jam() {
    let program = Program {
        n_variables: 3,
        constraints: Box::new(|x| {
            vec![
                p(x, &[(1.0, &[0, 0]), (-1.0, &[1]), (-1.0, &[])]),
                p(x, &[(1.0, &[0]), (-1.0, &[2]), (-0.5, &[])]),
            ]
        }),
        ..plain(
            |x| x[0].clone(),
            |_| Vec::new(),
            bounds(&[FREE, POSITIVE, POSITIVE]),
        )
    };
    for hessian in CHOICES {
        let outcome = go(&program, &[-2.0, 3.0, 1.0], &settings(hessian));
        match outcome.status {
            SqpStatus::Converged => near(&outcome.point.v, &[1.0, 0.0, 0.5], 1e-6),
            SqpStatus::LocallyInfeasible => near(&outcome.point.v, &[-1.0, 0.0, 0.0], 1e-3),
            other => panic!("{hessian:?}: {other:?}"),
        }
        let outcome = go(&program, &[3.0, 1.0, 2.0], &settings(hessian));
        assert_eq!(outcome.status, SqpStatus::Converged, "{hessian:?}");
        near(&outcome.point.v, &[1.0, 0.0, 0.5], 1e-6);
    }
}

/// Rows that exclude each other, `x ≥ 1` and `x ≤ -1`, and one that no point meets, `x² + 1 ≤ 0`: locally infeasible, where
/// the violation is least (anywhere between the two of the first).
#[test]
fn rows_that_never_hold_are_infeasible() {
    for hessian in CHOICES {
        let program = |rows: fn(&[Jet]) -> Vec<Jet>| Program {
            n_variables: 1,
            ..squares(&[(0.5, 0, 0.3)], rows, Vec::new())
        };
        let contradictory =
            program(|x| vec![p(x, &[(-1.0, &[0]), (1.0, &[])]), x[0].clone() + 1.0]);
        let outcome = go(&contradictory, &[5.0], &settings(hessian));
        assert_eq!(outcome.status, SqpStatus::LocallyInfeasible, "{hessian:?}");
        assert!(outcome.point.v[0].abs() <= 1.0 + 1e-6);

        let outcome = go(
            &program(|x| vec![x[0].square() + 1.0]),
            &[2.0],
            &settings(hessian),
        );
        assert_eq!(outcome.status, SqpStatus::LocallyInfeasible, "{hessian:?}");
        // The violation is 1 + x²; it no longer falls by a thousandth of itself.
        assert!(outcome.point.v[0].abs() < 0.05, "{:?}", outcome.point);
    }
}

/// `½ |v - (3, 3)|²` with `|v|² ≤ 2` soft: bought where the price is below the multiplier 1 of the hard row, held where it
/// is above. `v = s (1, 1)` with `s - 3 + 2 s (linear + quadratic (2 s² - 2)) = 0`; without quadratic price `s = 3/(1 + 2
/// linear)`. Gauss-Newton, which leaves `2 z` out of the Hessian `1 + 2 z`, only where that is less than 1.
#[test]
fn soft_rows_are_bought_below_their_multiplier() {
    let cases = [
        (0.25, 0.0, 2.0, 0.25),
        (3.0, 0.0, 1.0, 1.0),
        // s = 5/4: 5/4 - 3 + 5/2 z = 0, z = 0.7 = 0.1375 + (2 · 25/16 - 2) / 2.
        (0.1375, 0.5, 1.25, 0.7),
        (0.0, 0.7 / 1.125, 1.25, 0.7),
    ];
    for (linear, quadratic, s, z) in cases {
        let program = Program {
            n_variables: 2,
            softness: vec![Softness::Soft { linear, quadratic }],
            ..squares(
                &[(0.5, 0, 3.0), (0.5, 1, 3.0)],
                |x| vec![p(x, &[(1.0, &[0, 0]), (1.0, &[1, 1]), (-2.0, &[])])],
                Vec::new(),
            )
        };
        for hessian in CHOICES {
            if hessian == HessianChoice::GaussNewton && z >= 0.5 {
                continue;
            }
            let outcome = go(&program, &[0.1, -0.2], &settings(hessian));
            let words = format!("{hessian:?} {linear} {quadratic}: {:?}", outcome.residual);
            assert_eq!(outcome.status, SqpStatus::Converged, "{words}");
            near(&outcome.point.v, &[s, s], 1e-6);
            near(&outcome.multipliers.inequalities, &[z], 1e-6);
            let t = 2.0 * s * s - 2.0;
            let total = (s - 3.0) * (s - 3.0) + t * (linear + 0.5 * quadratic * t);
            assert!((outcome.objective - total).abs() < 1e-6);
        }
    }
}

/// Rows that say the same twice, one that is active without a multiplier, and HS13, whose optimum (1, 0) has no
/// multipliers at all: typed outcomes at the optimum, to the accuracy that each determines.
#[test]
fn degenerate_rows_do_no_harm() {
    for hessian in CHOICES {
        let twice = Program {
            n_variables: 2,
            ..squares(
                &[(0.5, 0, 0.0), (0.5, 1, 0.0)],
                |x| {
                    vec![
                        p(x, &[(-1.0, &[0]), (1.0, &[])]),
                        p(x, &[(-2.0, &[0]), (2.0, &[])]),
                        x[1].clone() * -1.0,
                    ]
                },
                Vec::new(),
            )
        };
        let outcome = go(&twice, &[4.0, 4.0], &settings(hessian));
        assert_eq!(outcome.status, SqpStatus::Converged, "{hessian:?}");
        near(&outcome.point.v, &[1.0, 0.0], 1e-5);
        let z = &outcome.multipliers.inequalities;
        assert!((z[0] + 2.0 * z[1] - 1.0).abs() < 1e-6, "{z:?}");

        let cusp = Program {
            n_variables: 2,
            ..squares(
                &[(1.0, 0, 2.0), (1.0, 1, 0.0)],
                |x| {
                    let gap = p(x, &[(1.0, &[]), (-1.0, &[0])]);
                    vec![x[1].clone() - gap.square() * gap.clone()]
                },
                bounds(&[POSITIVE, POSITIVE]),
            )
        };
        let outcome = go(&cusp, &[-2.0, -2.0], &settings(hessian));
        println!(
            "HS13 {hessian:?}: {:?} at {:?}",
            outcome.status, outcome.point.v
        );
        assert!(!matches!(
            outcome.status,
            SqpStatus::Failed(_) | SqpStatus::LocallyInfeasible
        ));
        near(&outcome.point.v, &[1.0, 0.0], 0.05);
    }
}

/// A limit that the optimum just does not reach, beside a direction of negative curvature that a constraint holds: what an interior-point
/// multiplier makes look active must not stay in the Hessian as something held. (There the curvature along the limit, 1e4, would pull
/// the iterates onto it, with a gradient that no multiplier explains.)
#[test]
fn nearly_active_limits_do_not_hold() {
    for slack in [1e-8, 1e-7, 3e-7, 1e-6, 1e-5, 1e-3] {
        let program = Program {
            n_variables: 3,
            constraints: Box::new(|x| vec![x[2].clone() - 0.1]),
            ..plain(
                move |x| {
                    let off = x[1].clone() - (1.0 - slack);
                    x[0].square() * 0.5 + off.square() * 5e3 - x[2].square() * 50.0
                },
                |x| vec![x[1].clone() - 1.0],
                Vec::new(),
            )
        };
        let outcome = go(&program, &[1.0, 0.5, 0.0], &settings(HessianChoice::Exact));
        assert_eq!(outcome.status, SqpStatus::Converged, "{slack:e}");
        assert!(outcome.history.len() < 15, "{}", outcome.history.len());
        // As near as a complementarity of 1e-8 says where it is.
        near(&outcome.point.v, &[0.0, 1.0 - slack, 0.1], 1e-6);
    }
}

/// Two rows that hardly differ, as those of an obstacle at neighboring times do, `±x / 200 ≤ y`: at (0, 0) each holds a direction of its own,
/// and `y - x²/40 + x⁴/4` has its minimum there. To a Hessian that held one of them only, it would be a saddle to be turned round and left.
#[test]
fn neighbors_hold_what_is_their_own() {
    let program = Program {
        n_variables: 2,
        ..plain(
            |x| {
                let bowl = [(-0.025, &[0, 0][..]), (0.25, &[0, 0, 0, 0])];
                p(x, &bowl) + x[1].clone() + p(x, &[(0.5, &[1, 1])])
            },
            |x| {
                let slope = |a: f64| p(x, &[(a, &[0]), (-1.0, &[1]), (0.1, &[1, 1])]);
                vec![slope(0.005), slope(-0.005)]
            },
            Vec::new(),
        )
    };
    for hessian in [HessianChoice::Auto, HessianChoice::Exact] {
        let outcome = go(&program, &[0.01, 0.3], &settings(hessian));
        assert_eq!(outcome.status, SqpStatus::Converged, "{hessian:?}");
        near(&outcome.point.v, &[0.0, 0.0], 1e-8);
        near(&outcome.multipliers.inequalities, &[0.5, 0.5], 1e-6);
        assert!(outcome.history.len() <= 10, "{}", outcome.history.len());
    }
}

/// Two rows that hardly differ, `±ε x ≤ y` but for a slack of the second, beside a direction of negative curvature that a constraint holds: the
/// first is active, and what an interior point leaves of a multiplier must not keep the second one in the Hessian. Its slack over the sine
/// of the angle between the two, `2 ε`, is a step that the Hessian would want, with a gradient that no multiplier explains.
#[test]
fn nearly_active_neighbors_do_not_hold() {
    for angle in [1e-2, 1e-3, 1e-4] {
        for slack in [1e-11, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6] {
            let program = Program {
                n_variables: 3,
                constraints: Box::new(|x| vec![x[2].clone() - 0.1]),
                ..plain(
                    |x| {
                        x[0].square() * 0.5 + x[1].clone() + x[1].square() * 0.5
                            - x[2].square() * 50.0
                    },
                    move |x| {
                        let slope = |a: f64| p(x, &[(a, &[0]), (-1.0, &[1]), (0.1, &[1, 1])]);
                        let shift = 2.0 * angle * angle;
                        vec![slope(angle), slope(-angle) - shift - slack]
                    },
                    Vec::new(),
                )
            };
            let outcome = go(&program, &[0.3, 0.5, 0.0], &settings(HessianChoice::Exact));
            assert_eq!(outcome.status, SqpStatus::Converged, "{angle:e}, {slack:e}");
            assert!(outcome.history.len() <= 8, "{}", outcome.history.len());
            // A complementarity of 1e-8 leaves a part of the multiplier 1 to the second row, the less the larger its slack.
            let second = outcome.multipliers.inequalities[1];
            assert!(second * slack <= 1e-8, "{second:e}");
            let off = 3.0 * angle * (second + angle * angle);
            near(&outcome.point.v, &[-angle, -angle * angle, 0.1], off);
        }
    }
}

/// The smallest programs: one variable without any rows; sets that fix variables; a ball of radius zero.
#[test]
fn small_programs_are_solved() {
    for hessian in CHOICES {
        let one = Program {
            n_variables: 1,
            ..squares(&[(0.5, 0, 3.0)], |_| Vec::new(), Vec::new())
        };
        let outcome = go(&one, &[-8.0], &settings(hessian));
        assert_eq!(outcome.status, SqpStatus::Converged, "{hessian:?}");
        near(&outcome.point.v, &[3.0], 1e-6);

        let fixed = Program {
            n_variables: 3,
            ..squares(
                &[(0.5, 0, 3.0), (0.5, 1, 1.0), (0.5, 2, 4.0)],
                |_| Vec::new(),
                vec![
                    ConvexSet::Interval {
                        index: 0,
                        lower: 1.0,
                        upper: 1.0,
                    },
                    ConvexSet::Ball {
                        rows: vec![vec![(2, 1.0), (1, -1.0)]],
                        radius: 0.0,
                    },
                ],
            )
        };
        let outcome = go(&fixed, &[100.0, -50.0, 7.0], &settings(hessian));
        assert_eq!(outcome.status, SqpStatus::Converged, "{hessian:?}");
        near(&outcome.point.v, &[1.0, 2.5, 2.5], 1e-6);
        near(&outcome.multipliers.normals[0], &[2.0], 1e-6);
        near(&outcome.multipliers.normals[1], &[1.5], 1e-6);
    }
}

/// Sets without a common point: said before anything is tried.
#[test]
fn empty_sets_are_named() {
    let program = Program {
        n_variables: 1,
        ..squares(
            &[(0.5, 0, 0.0)],
            |_| Vec::new(),
            vec![
                ConvexSet::Interval {
                    index: 0,
                    lower: 0.0,
                    upper: 1.0,
                },
                ConvexSet::HalfSpace {
                    direction: vec![(0, -2.0)],
                    limit: -4.0,
                },
            ],
        )
    };
    let outcome = solve(
        &program,
        program.start(&[0.5]),
        &settings(HessianChoice::Auto),
        &mut |_| ControlFlow::Continue(()),
    );
    match &outcome.status {
        SqpStatus::Failed(words) => assert!(words.contains("convex sets"), "{words}"),
        other => panic!("{other:?}"),
    }
}

/// A rate limit, `|v₁ - v₀| ≤ 1` about the goals 0 and 4: v = (1.5, 2.5), pulled by 1.5. And `max ½ vᵀ diag(3, 1) v` over
/// `|M v| ≤ 1`, whose value is half the largest eigenvalue, `2 + √3.25`, of `M⁻ᵀ diag(3, 1) M⁻¹`: the curvature of the ball
/// is all that makes the Hessian positive, and few iterations show that it is used.
#[test]
fn balls_of_linear_forms_hold() {
    for hessian in CHOICES {
        let rate = Program {
            n_variables: 2,
            ..squares(
                &[(0.5, 0, 0.0), (0.5, 1, 4.0)],
                |_| Vec::new(),
                vec![ConvexSet::Ball {
                    rows: vec![vec![(1, 1.0), (0, -1.0)]],
                    radius: 1.0,
                }],
            )
        };
        let outcome = go(&rate, &[0.2, 0.1], &settings(hessian));
        assert_eq!(outcome.status, SqpStatus::Converged, "{hessian:?}");
        near(&outcome.point.v, &[1.5, 2.5], 1e-6);
        near(&outcome.multipliers.normals[0], &[1.5], 1e-6);
    }
    let eigenvalue = Program {
        n_variables: 2,
        ..plain(
            |x| p(x, &[(-1.5, &[0, 0]), (-0.5, &[1, 1])]),
            |_| Vec::new(),
            vec![ConvexSet::Ball {
                rows: vec![vec![(0, 1.0), (1, 1.0)], vec![(1, 2.0)]],
                radius: 1.0,
            }],
        )
    };
    let outcome = go(&eigenvalue, &[0.3, 0.1], &settings(HessianChoice::Exact));
    assert_eq!(outcome.status, SqpStatus::Converged);
    assert!((outcome.objective + 0.5 * (2.0 + 3.25f64.sqrt())).abs() < 1e-6);
    assert!(outcome.history.len() <= 12, "{}", outcome.history.len());
}

/// Objectives of 1e-12 and 1e12 of their size have the same optimum, in as many iterations give or take two.
#[test]
fn the_objective_has_no_unit() {
    let program = |factor: f64| Program {
        n_variables: 2,
        residuals: Box::new(move |x| {
            let size = factor.sqrt();
            vec![(x[0].clone() - 5.0) * size, x[1].clone() * size]
        }),
        inequalities: Box::new(|x| vec![p(x, &[(1.0, &[0, 0]), (-1.0, &[1])])]),
        ..Program::default()
    };
    let optimum = known()[1].optimum.clone();
    for hessian in CHOICES {
        let count = |factor: f64| {
            let outcome = go(&program(factor), &[4.9, 0.1], &settings(hessian));
            assert_eq!(
                outcome.status,
                SqpStatus::Converged,
                "{hessian:?} {factor:e}"
            );
            near(&outcome.point.v, &optimum, 1e-5);
            outcome.history.len()
        };
        let usual = count(1.0);
        for factor in [1e-12, 1e12] {
            assert!(count(factor).abs_diff(usual) <= 2, "{hessian:?} {factor:e}");
        }
    }
}

/// HS11 with Gauss-Newton contracts by what it leaves out: `2 z / (2 + 8 x₁²)` along the tangent (1, 2 x₁), `z = 2 x₂`. With
/// the exact Hessian the order is two.
#[test]
fn observed_rates_are_those_of_the_theory() {
    let problem = known().into_iter().find(|k| k.name == "HS11").unwrap();
    let run = |hessian| go(&problem.program, &problem.start, &settings(hessian)).convergence;
    let [x, y] = [problem.optimum[0], problem.optimum[1]];
    let theory = 4.0 * y / (2.0 + 8.0 * x * x);
    let slow = run(HessianChoice::GaussNewton);
    assert!(
        (slow.contraction.unwrap() / theory - 1.0).abs() < 0.02,
        "{slow:?}"
    );
    assert!((slow.order.unwrap() - 1.0).abs() < 0.1, "{slow:?}");
    let fast = run(HessianChoice::Exact);
    assert!(fast.order.unwrap() > 1.6, "{fast:?}");
    assert!(fast.contraction.unwrap() < 0.01, "{fast:?}");
}

/// A curve `p(t) = Σ v_j cos(jπt)` that wants to be `goal(t)`, with three bumps above the limit 1, at `N_ROWS` times; the
/// limit bends: `p + p²/10 ≤ 1`.
struct Curve {
    screening_margin: f64,
    is_soft: bool,
    evaluations: Cell<usize>,
}

const N_ROWS: usize = 20_000;
const N_COSINES: usize = 13;

impl Curve {
    fn basis(row: usize) -> [f64; N_COSINES] {
        let t = (row as f64 + 0.3) / N_ROWS as f64;
        std::array::from_fn(|j| (j as f64 * std::f64::consts::PI * t).cos())
    }

    /// 0.4 + sin² with bumps of different heights, over the basis.
    fn goal(j: usize) -> f64 {
        match j {
            0 => 0.7,
            1 => 0.1,
            2 => 0.05,
            6 => -0.6,
            _ => 0.0,
        }
    }

    fn value(v: &[f64], row: usize) -> f64 {
        Self::basis(row).iter().zip(v).map(|(c, v)| c * v).sum()
    }
}

impl LiftedProgram for Curve {
    type Point = Vec<f64>;
    type Direction = Vec<f64>;
    type Defects = ();
    type Costates = ();

    fn sets(&self) -> &[ConvexSet] {
        &[]
    }

    fn variables<'a>(&self, point: &'a Vec<f64>) -> &'a [f64] {
        point
    }

    fn evaluate(&self, point: &Vec<f64>) -> Result<Evaluation<()>, Failure> {
        self.evaluations.set(self.evaluations.get() + 1);
        let away = |(j, v): (usize, &f64)| (v - Self::goal(j)).powi(2);
        Ok(Evaluation {
            objective: 0.5 * point.iter().enumerate().map(away).sum::<f64>(),
            constraints: Vec::new(),
            inequalities: (0..N_ROWS)
                .map(|row| {
                    let height = Self::value(point, row);
                    height + 0.1 * height * height - 1.0
                })
                .collect(),
            defect: 0.0,
            defects: (),
        })
    }

    fn softness(&self, _: usize) -> Softness {
        if self.is_soft {
            Softness::Soft {
                linear: 0.01,
                quadratic: 0.1,
            }
        } else {
            Softness::Hard
        }
    }

    fn screening_margin(&self) -> f64 {
        self.screening_margin
    }

    fn linearize(
        &self,
        point: &Vec<f64>,
        evaluation: &Evaluation<()>,
        request: &LinearizationRequest,
    ) -> Result<Linearization, Failure> {
        let slopes: Vec<f64> = (request.rows.iter())
            .map(|&row| 1.0 + 0.2 * Self::value(point, row))
            .collect();
        let gradient: Vec<f64> = (point.iter().enumerate())
            .map(|(j, v)| v - Self::goal(j))
            .collect();
        let curvature = request.multipliers.map(|y| {
            let mut sum = Mat::zeros(N_COSINES, N_COSINES);
            for (row, z) in y.inequalities.iter().enumerate().filter(|(_, z)| **z > 0.0) {
                let c = Self::basis(row);
                sum += Mat::from_fn(N_COSINES, N_COSINES, |i, j| 0.2 * z * c[i] * c[j]);
            }
            sum
        });
        let bases: Vec<_> = request.rows.iter().map(|&row| Self::basis(row)).collect();
        Ok(Linearization {
            model_gradient: gradient.clone(),
            gradient,
            defect_slope: 0.0,
            gauss_newton: Mat::identity(N_COSINES, N_COSINES),
            curvature,
            jacobian: Mat::zeros(0, N_COSINES),
            offset: Vec::new(),
            rows: request.rows.to_vec(),
            inequality_jacobian: Mat::from_fn(request.rows.len(), N_COSINES, |i, j| {
                slopes[i] * bases[i][j]
            }),
            inequality_offset: (request.rows.iter())
                .map(|&row| evaluation.inequalities[row])
                .collect(),
        })
    }

    fn predict_inequalities(
        &self,
        point: &Vec<f64>,
        evaluation: &Evaluation<()>,
        direction: &Vec<f64>,
    ) -> Result<Vec<f64>, Failure> {
        Ok((evaluation.inequalities.iter().enumerate())
            .map(|(row, h)| {
                let slope = 1.0 + 0.2 * Self::value(point, row);
                h + slope * Self::value(direction, row)
            })
            .collect())
    }

    fn expand(&self, _: &Vec<f64>, (): &(), change: &[f64]) -> Result<Vec<f64>, Failure> {
        Ok(change.to_vec())
    }

    fn retract(&self, point: &Vec<f64>, direction: &Vec<f64>, length: f64) -> Vec<f64> {
        (point.iter().zip(direction))
            .map(|(v, d)| v + length * d)
            .collect()
    }

    fn longest_step(&self, _: &Vec<f64>) -> f64 {
        f64::INFINITY
    }

    fn rollout(&self, point: &Vec<f64>, change: &[f64]) -> Result<Vec<f64>, Failure> {
        Ok(point.iter().zip(change).map(|(v, d)| v + d).collect())
    }
}

/// 20 000 rows of which a few are active: with screening, the optimum, the multipliers and the first step are those of the
/// linearization of all rows, hard and soft, and no point is tried that the full linearization would have excluded; few
/// rows are ever linearized, and fewer seen by Clarabel. The peaks lie
/// between two rows each, whose multipliers together are determined, to the width of the rows.
#[test]
fn screening_changes_nothing() {
    for is_soft in [false, true] {
        let run = |screening_margin: f64, max_iterations: usize| {
            let program = Curve {
                screening_margin,
                is_soft,
                evaluations: Cell::new(0),
            };
            let settings = SqpSettings {
                max_iterations,
                row_accuracy: 0.0,
                ..settings(HessianChoice::Exact)
            };
            let outcome = solve(&program, vec![0.0; N_COSINES], &settings, &mut |_| {
                ControlFlow::Continue(())
            });
            (outcome, program.evaluations.get())
        };
        let (all, screened) = (run(f64::INFINITY, 100).0, run(1e-3, 100).0);
        for outcome in [&all, &screened] {
            assert_eq!(outcome.status, SqpStatus::Converged);
        }
        near(&screened.point, &all.point, 1e-7);
        assert!((all.objective - screened.objective).abs() < 1e-9);
        let peaks = |outcome: &SqpOutcome<Vec<f64>>| -> Vec<f64> {
            let mut sums: Vec<(usize, f64)> = Vec::new();
            for (row, &z) in outcome.multipliers.inequalities.iter().enumerate() {
                match sums.last_mut() {
                    _ if z == 0.0 => {}
                    Some((last, sum)) if row - *last < N_ROWS / 12 => {
                        *sum += z;
                        *last = row;
                    }
                    _ => sums.push((row, z)),
                }
            }
            sums.into_iter().map(|(_, z)| z).collect()
        };
        println!(
            "soft {is_soft}: multipliers {:?}, rows {:?}",
            peaks(&all),
            (screened.history.iter())
                .map(|row| (row.linearized_rows, row.working_rows))
                .collect::<Vec<_>>()
        );
        assert!(peaks(&all).len() >= 3);
        near(&peaks(&screened), &peaks(&all), 1e-6);
        for row in screened.history.iter().take(screened.history.len() - 1) {
            assert!(
                row.linearized_rows < N_ROWS / 2 && row.working_rows < 300,
                "{row:?}"
            );
        }
        let [first, screened_first] = [run(f64::INFINITY, 1), run(1e-3, 1)];
        let steps = [&first, &screened_first].map(|(outcome, _)| outcome.history[0].step_norm);
        assert!((steps[0] - steps[1]).abs() < 1e-7, "{steps:?}");
        assert_eq!(first.1, screened_first.1, "points tried");
    }
}

/// Two solves of one program are the same to the bit, but for the clock.
#[test]
fn solves_repeat() {
    for problem in known() {
        for hessian in CHOICES {
            let run = || -> SqpOutcome<Point> {
                let mut outcome = go(&problem.program, &problem.start, &settings(hessian));
                for row in &mut outcome.history {
                    row.elapsed = 0.0;
                }
                outcome
            };
            let (first, second) = (run(), run());
            assert_eq!(
                first.point.v, second.point.v,
                "{} {hessian:?}",
                problem.name
            );
            assert_eq!(first.history, second.history);
            assert_eq!(first.multipliers, second.multipliers);
        }
    }
}
