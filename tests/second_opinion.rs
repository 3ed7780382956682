//! The SQP's optima against those of another method.

mod common;

use std::ops::ControlFlow;

use common::tasks::reach;
use faer::linalg::solvers::Solve as _;
use faer::{Mat, Side};
use softarm::control::second_opinion::{
    OpinionStatus, ReducedProgram, ReducedValues, SecondOpinionError, SecondOpinionSettings,
    minimize, second_opinion,
};
use softarm::control::{
    Bound, Enforcement, Guess, Hold, OptimalControlProblem, PathConstraint, PathEnforcement,
    PathLimit, Transcription, first_point,
};
use softarm::sqp::{
    Failure, LiftedProgram as _, LinearizationRequest, SqpSettings, SqpStatus, solve,
};

/// The short reach, its force within `bound`.
fn bounded(hold: Hold, bound: Option<Bound>) -> OptimalControlProblem {
    let (_, mut problem) = reach(hold);
    problem.actuators[0].force.bound = bound;
    problem
}

/// Of the projection on what constraints see: more than the negative curvature there.
const PENALTY: f64 = 1e6;

/// Short reaches, hard and soft goals, one with a bound that is not touched: both methods end at the same optimum, also when
/// the second one starts a tenth away from it, without multipliers. Objectives agree to 1e-6; controls to what both residual gradients leave
/// and constraints leave to first order, twice.
#[test]
fn both_methods_agree() {
    let soft = |mut problem: OptimalControlProblem| {
        problem.goals[0].enforcement = Enforcement::Soft { weight: 3.0 };
        problem.objective.rate = 1e-3;
        problem
    };
    for problem in [
        bounded(Hold::Constant, Some(Bound::Norm(1e3))),
        soft(bounded(Hold::Constant, None)),
    ] {
        let program = Transcription::new(&problem, 1);
        let (start, _) = first_point(&problem, Guess::StaticPath, None).unwrap();
        let settings = SqpSettings {
            tolerance: 1e-8,
            ..SqpSettings::default()
        };
        let outcome = solve(&program, start, &settings, &mut |_| {
            ControlFlow::Continue(())
        });
        assert_eq!(outcome.status, SqpStatus::Converged);
        let optimum = &outcome.point.variables;
        let away: Vec<f64> = optimum.iter().map(|v| 0.9 * v).collect();
        let settings = SecondOpinionSettings::default();
        let other = second_opinion(&problem, &away, &settings).unwrap();
        let [feasibility, gradient] = [other.feasibility, other.gradient];
        assert_eq!(
            other.status,
            OpinionStatus::Converged,
            "{feasibility:e} {gradient:e} after {} stages, {} evaluations",
            other.stages,
            other.evaluations
        );
        let difference = (other.objective / outcome.objective - 1.0).abs();
        assert!(difference < 1e-6, "{difference:e}");

        let evaluation = program.evaluate(&outcome.point).unwrap();
        let request = LinearizationRequest {
            multipliers: Some(&outcome.multipliers),
            rows: &[],
        };
        let linearization = program
            .linearize(&outcome.point, &evaluation, &request)
            .unwrap();
        // A residual gradient g and unmet constraints c move the optimum by (H + μ A⁺A)⁻¹ (g + μ A⁺c) to first order, whatever μ is,
        // with the pseudoinverse A⁺.
        // AAᵀ would lose half of the digits.
        let jacobian = &linearization.jacobian;
        let svd = jacobian.thin_svd().unwrap();
        let (m, n) = (jacobian.nrows(), jacobian.ncols());
        let singular = svd.S().column_vector();
        let scaled = Mat::from_fn(n, m, |i, j| svd.V()[(i, j)] / singular[j]);
        let inverse = scaled * svd.U().transpose();
        let hessian = &linearization.gauss_newton
            + linearization.curvature.as_ref().unwrap()
            + svd.V() * svd.V().transpose() * faer::Scale(PENALTY);
        let least = hessian.self_adjoint_eigenvalues(Side::Lower).unwrap()[0];
        assert!(least > 0.0, "{least:e}");
        let own = program
            .lagrangian_gradient(&outcome.point, &outcome.multipliers)
            .unwrap();
        let own = own.iter().map(|g| g * g).sum::<f64>().sqrt();
        let factor = hessian.llt(Side::Lower).unwrap();
        let by_constraints = factor.solve(&inverse).norm_l2() * PENALTY;
        let unmet = (other.feasibility + outcome.residual.feasibility) * (m as f64).sqrt();
        let allowed = 2.0 * ((own + other.gradient) / least + by_constraints * unmet);
        let apart = (other.variables.iter().zip(optimum))
            .map(|(a, b)| (a - b).powi(2))
            .sum::<f64>()
            .sqrt();
        assert!(apart < allowed, "{apart:e} {allowed:e}");
        assert!(allowed < 5e-2, "{allowed:e}");
    }
}

/// A block that is pushed from rest at 0 to rest at 1 in unit time by `n` constant forces: the double integrator, exactly
/// discretized. The least `½∫u²` is `6/(1 - 1/n²)`.
struct Push {
    n: usize,
}

impl ReducedProgram for Push {
    fn n_constraints(&self) -> usize {
        2
    }

    fn values(
        &self,
        u: &[f64],
        pull: &dyn Fn(&[f64]) -> Vec<f64>,
    ) -> Result<ReducedValues, Failure> {
        let h = 1.0 / self.n as f64;
        let lever = |j: usize| h * (1.0 - (j as f64 + 0.5) * h);
        let position: f64 = u.iter().enumerate().map(|(j, u)| lever(j) * u).sum();
        let velocity: f64 = u.iter().map(|u| h * u).sum();
        let constraints = vec![position - 1.0, velocity];
        let pull = pull(&constraints);
        Ok(ReducedValues {
            objective: 0.5 * h * u.iter().map(|u| u * u).sum::<f64>(),
            gradient: (u.iter().enumerate())
                .map(|(j, u)| h * u + pull[0] * lever(j) + pull[1] * h)
                .collect(),
            constraints,
        })
    }
}

/// The loop on a problem whose answer is known: value, forces falling linearly, multipliers.
#[test]
fn double_integrator_is_exact() {
    for n in [2, 10, 50] {
        let start = vec![0.0; n];
        let found = minimize(&Push { n }, &start, &SecondOpinionSettings::default()).unwrap();
        assert_eq!(found.status, OpinionStatus::Converged, "{found:?}");
        let n = n as f64;
        let exact = 6.0 / (1.0 - 1.0 / (n * n));
        assert!((found.objective / exact - 1.0).abs() < 1e-6, "{found:?}");
        for (j, u) in found.variables.iter().enumerate() {
            let expected = exact * (1.0 - (2.0 * j as f64 + 1.0) / n);
            // The gradient h (u - u*) is below 1e-6.
            assert!(
                (u - expected).abs() < 1e-6 * n + 1e-6,
                "{j}: {u} {expected}"
            );
        }
        assert!((found.multipliers[0] + 2.0 * exact).abs() < 1e-4 * exact);
    }
}

/// Path constraints are refused by name; a bound that the optimum would violate makes it not comparable.
#[test]
fn inequalities_are_refused() {
    let settings = SecondOpinionSettings::default();
    let mut limited = bounded(Hold::Constant, None);
    limited.path.push(PathConstraint {
        name: "stretch".into(),
        limit: PathLimit::Stretch {
            least: 0.9,
            largest: 1.1,
        },
        time_nodes: vec![0, 50],
        enforcement: PathEnforcement::Hard,
    });
    let start = vec![0.0; limited.n_variables()];
    let error = second_opinion(&limited, &start, &settings).unwrap_err();
    assert_eq!(
        error,
        SecondOpinionError::Inequality {
            name: "stretch".into()
        }
    );
    let tight = bounded(Hold::Constant, Some(Bound::Norm(1e-3)));
    let free = bounded(Hold::Constant, None);
    let (start, _) = first_point(&free, Guess::StaticPath, None).unwrap();
    let program = Transcription::new(&free, 1);
    let optimum = solve(&program, start, &SqpSettings::default(), &mut |_| {
        ControlFlow::Continue(())
    });
    let aside: Vec<f64> = optimum.point.variables.iter().map(|v| 0.9 * v).collect();
    let found = second_opinion(&tight, &aside, &settings).unwrap();
    assert_eq!(found.status, OpinionStatus::BoundsViolated);
}
