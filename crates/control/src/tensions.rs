//! Winches as tensions: the twin of a problem in which tensions are the controls, and the displacements that follow from them.
//!
//! The tension of a winch, `T = <ℓ - ℓ₀ - z>₊/(C a)`, has no slope where its tendon is slack, so that a search over displacements `z` does
//! not find the way back. Over tensions within `T ≥ 0` a problem is smooth. Every motion of the arm on winches is one under the tensions that
//! its tendons have, and the displacements follow from tensions and shapes: `z = (ℓ + b)/(1 + C T) - ℓ₀ - b`, where a tendon without
//! tension is as long as its way.

use std::sync::Arc;

use nalgebra::Vector3;

use super::problem::{Bound, Component, OptimalControlProblem};
use super::transcription::LiftedPoint;
use mechanics::{Configuration, EffortState};

/// Largest tension, as a multiple of that of a winch at its least displacement in an arm that does not give way: a cap, since the way of a
/// tendon may be longer in an arm that is bent.
const LARGEST: f64 = 2.0;

/// A winch among the controls.
struct DrivenWinch {
    /// Index of its actuator of the rod.
    actuator: usize,
    /// The control.
    component: Component,
    /// Least tension, and tension before the task begins, N.
    least: f64,
    first: f64,
}

/// The winches among the controls of a problem.
pub(super) struct Winches<'a> {
    problem: &'a OptimalControlProblem,
    all: Vec<DrivenWinch>,
}

impl<'a> Winches<'a> {
    /// Returns the winches among the controls; `None` if there are none, or if a control drives several actuators, whose tensions are not free
    /// then.
    pub fn of(problem: &'a OptimalControlProblem) -> Option<Self> {
        Self::with_least_times(problem, 1.0)
    }

    /// Returns [`Self::of`] with least tensions that are `factor` times as large.
    pub fn with_least_times(problem: &'a OptimalControlProblem, factor: f64) -> Option<Self> {
        if problem.driven_components().any(|(driven, _)| !driven.leads) {
            return None;
        }
        let rod = &problem.rod;
        let start = &problem.initial.configuration;
        let state = rod.effort_state(start.poses());
        let given = rod.actuators.efforts(problem.grid.start);
        let least: Vec<(usize, f64)> = problem.least_tensions().collect();
        let all: Vec<DrivenWinch> = (problem.driven_components())
            .map(|(driven, component)| (driven.actuator, component))
            .filter(|(actuator, _)| {
                (rod.actuators.iter().nth(*actuator)).is_some_and(|own| own.winch.is_some())
            })
            .map(|(actuator, component)| {
                let own = least.iter().find(|(index, _)| *index == actuator);
                let least = own.map_or(0.0, |(_, least)| factor * least);
                let law = rod.actuators.law(actuator, given[actuator], &state);
                DrivenWinch {
                    actuator,
                    component,
                    least,
                    first: law.effort.max(least),
                }
            })
            .collect();
        (!all.is_empty()).then_some(Self { problem, all })
    }

    /// Returns the problem with tensions as controls, no less than the least ones; those of displacements are their bounds above. The unit of
    /// a tension is what the winch makes by the unit of its displacement where it is taut.
    pub fn by_tensions(&self) -> OptimalControlProblem {
        let mut out = self.problem.clone();
        let rod = Arc::make_mut(&mut out.rod);
        for own in &self.all {
            let given = (rod.actuators.iter().nth(own.actuator)).map_or(0.0, |own| own.effort(0.0));
            let flexibility = rod.winch_flexibility(own.actuator, given).unwrap_or(1.0);
            let channel = &mut out.channels[own.component.channel].channel;
            channel.scale /= flexibility;
            channel.lag = 0.0;
            channel.rate_bound = None;
            let pulled_in = (channel.bound.and_then(|bound| bound.interval(0)))
                .map_or(-rod.scales.length, |[lower, _]| lower);
            let state = rod.actuators.stress_free_state();
            let law = (rod.actuators).law(own.actuator, given + pulled_in, &state);
            let largest = law.effort;
            channel.bound = Some(Bound::Between {
                lower: Vector3::new(own.least - own.first, 0.0, 0.0),
                upper: Vector3::new(LARGEST * largest.max(channel.scale), 0.0, 0.0),
            });
        }
        let tensions: Vec<_> = (self.all.iter())
            .map(|own| (own.actuator, own.first))
            .collect();
        rod.actuators = rod.actuators.under_tensions(&tensions);
        (out.path).retain(|path| !path.limit.depends_on_inputs());
        if let Some(stay) = &self.problem.stay {
            let mut stay = (**stay).clone();
            stay.controls = self.tensions(&stay.controls, &stay.shape);
            out.stay = Some(Arc::new(stay));
        }
        out
    }

    /// Returns controls with displacements as those with the tensions that they make in a shape.
    fn tensions(&self, controls: &[f64], shape: &Configuration) -> Vec<f64> {
        self.changed(controls, shape, |own, given, control, state| {
            let law = (self.problem.rod.actuators).law(own.actuator, given + control, state);
            law.effort.max(own.least) - own.first
        })
    }

    /// Returns controls with tensions as those with the displacements that make these tensions in a shape.
    pub fn displacements(&self, controls: &[f64], shape: &Configuration) -> Vec<f64> {
        self.changed(controls, shape, |own, given, control, state| {
            let tension = (own.first + control).max(0.0);
            let actuators = &self.problem.rod.actuators;
            let y = state.coordinates[own.actuator];
            (actuators.displacement(own.actuator, tension, y)).map_or(0.0, |z| z - given)
        })
    }

    fn changed(
        &self,
        controls: &[f64],
        shape: &Configuration,
        change: impl Fn(&DrivenWinch, f64, f64, &EffortState) -> f64,
    ) -> Vec<f64> {
        let rod = &self.problem.rod;
        let state = rod.effort_state(shape.poses());
        let given = rod.actuators.efforts(self.problem.grid.start);
        let mut out = controls.to_vec();
        for own in &self.all {
            let value = &mut out[own.component.index];
            *value = change(own, given[own.actuator], *value, &state);
        }
        out
    }

    /// Returns the coefficients of displacements that follow from a motion under tensions, within their bounds.
    pub fn reeled(&self, twin: &OptimalControlProblem, point: &LiftedPoint) -> Vec<f64> {
        let problem = self.problem;
        let coefficients = twin.coefficients(&point.variables);
        let n = problem.n_numbers().max(1);
        let last = problem.grid.n_steps;
        (problem.control.coefficient_times().into_iter())
            .zip(coefficients.chunks(n))
            .flat_map(|(t, own)| {
                let k = ((t / problem.grid.step).round().max(0.0) as usize).min(last);
                let out = self.displacements(own, &point.trajectory.configuration(k));
                problem.within_bounds(&out)
            })
            .collect()
    }
}
