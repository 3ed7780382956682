//! How does one give the solver a cost of one's own? Here: the tip of an arm should point upward while it reaches to the side.
//!
//! A cost is a [`StateTerm`]: values, and their first derivatives as linear forms of `(δx, ζ)`, `δR = R ζ̂`. Here they are `R e₃ - e₃` of the
//! tip, whose derivative is `R (ζ × e₃)`. The certificate differentiates the values by itself, so that it would reject a wrong derivative.
//!
//! The result is compared with the envelope theorem: as the weight `w` of the term grows, the least cost `J*(w)` grows at the rate
//! `dJ*/dw = ½ ∫ |R e₃ - e₃|² dt` of the optimum. Only a stationary point passes.
//!
//! ```text
//! cargo run --release --example custom_cost
//! ```

use std::error::Error;

use softarm::control::{NodeForm, SharedTerm, StateCost, StateTerm, StateView, sample_times};
use softarm::mechanics::{Material, Rod};
use softarm::nalgebra::Vector3;
use softarm::solve::Solution;
use softarm::task::{Arm, ChannelLimits, Discretization, Task};

/// `R e₃ - e₃` of the tip.
#[derive(Debug)]
struct TipUpright;

impl StateTerm for TipUpright {
    fn n_values(&self, _: &Rod) -> usize {
        3
    }

    fn nodes(&self, rod: &Rod, _: usize) -> Vec<usize> {
        vec![rod.tip()]
    }

    fn value(&self, at: &StateView, item: usize) -> f64 {
        let up = at.rotations[at.rod.tip()].column(2) - Vector3::z();
        up[item]
    }

    fn gradient(&self, at: &StateView, item: usize) -> NodeForm {
        let tip = at.rod.tip();
        // eᵢ · R (ζ × e₃) = ζ · (e₃ × Rᵀ eᵢ)
        let row = at.rotations[tip].row(item).transpose();
        NodeForm::default().along_rotation(tip, &Vector3::z().cross(&row))
    }
}

fn reach(weight: f64) -> Result<Solution, Box<dyn Error>> {
    let arm = Arm {
        viscous_damping: 1.0,
        ..Arm::cylinder(&Material::isotropic(1e6, 0.5, 1000.0), 1.0, 0.05)
    };
    let mut task = Task::reach(Vector3::new(0.4, 0.0, 0.85), 1.0, 20.0);
    task.actuators[0].moment = ChannelLimits::at_most(5.0);
    task.cost.terms.push(StateCost {
        term: SharedTerm::new(TipUpright),
        weight,
    });
    Ok(softarm::solve(
        &arm,
        &task,
        &Discretization::with_elements(8),
    )?)
}

/// `½ ∫ |R e₃ - e₃|² dt` of a solution: the part of its objective that the weight multiplies.
fn tilt(solution: &Solution) -> f64 {
    let problem = &solution.problem.discrete;
    sample_times(problem)
        .into_iter()
        .map(|(k, duration)| {
            let rotation = solution.trajectory().rotations_at(k)[problem.rod.tip()];
            0.5 * duration * (rotation * Vector3::z() - Vector3::z()).norm_squared()
        })
        .sum::<f64>()
}

fn main() -> Result<(), Box<dyn Error>> {
    println!("weight  objective   ½ ∫ |R e₃ - e₃|² dt   verdict");
    for weight in [0.0, 1.0, 10.0] {
        let solution = reach(weight)?;
        let check = solution.certify()?;
        assert!(check.is_certified());
        println!(
            "{weight:6.1}  {:.6e}  {:.6e}          {} after {} iterations",
            solution.objective(),
            tilt(&solution),
            check.verdict(),
            solution.attempt.iterations()
        );
    }
    let (below, at, above) = (reach(9.99)?, reach(10.0)?, reach(10.01)?);
    let slope = (above.objective() - below.objective()) / 0.02;
    let error = slope / tilt(&at) - 1.0;
    println!("dJ*/dw over the integral: 1 + {error:.1e}");
    // Central differences leave (0.01)²/6 of the third derivative; the solves are good to 1e-6 of the gradient.
    assert!(error.abs() < 1e-4);
    Ok(())
}
