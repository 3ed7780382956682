//! The cost of a feature of the model: the same work with and without it, in turns.

use std::ops::ControlFlow;

use serde::{Deserialize, Serialize};

use super::super::course::number;
use super::super::motion::ComparedMotion;
use super::{ProcessorClock, Subject, Work};
use crate::control::{Guess, Search, search};
use crate::scene::Scene;
use crate::sqp::SqpSettings;

/// A feature of the model, and its cost.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FeatureCost {
    /// Name of the feature.
    pub feature: String,
    /// Tells whether the scene has the feature.
    pub in_scene: bool,
    /// Measured quantity and its unit.
    pub unit: String,
    /// Cost with the feature.
    #[serde(deserialize_with = "number")]
    pub with: f64,
    /// Cost without the feature.
    #[serde(deserialize_with = "number")]
    pub without: f64,
    /// Smallest and largest ratio of both costs in the turns in which they were measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ratios: Option<[f64; 2]>,
}

impl FeatureCost {
    /// Describes the ratio with its scatter, as in "1.08 (1.02 to 1.15)".
    #[must_use]
    pub fn ratio_in_words(&self) -> String {
        let ratio = self.with / self.without;
        match self.ratios {
            Some([least, largest]) => format!("{ratio:.2} ({least:.2} to {largest:.2})"),
            None => format!("{ratio:.2}"),
        }
    }
}

/// Cap on the turns in which both costs are measured, and cap on the milliseconds of an iteration that is measured more than once.
const ROUNDS: usize = 5;
const LONG_MS: f64 = 1e3;
/// Cap on the iterations of a timed solve.
const ITERATIONS: usize = 3;
/// Cap on the steps of a timed motion, which take some milliseconds.
const STEPS: f64 = 2000.0;

impl Work<'_, '_> {
    /// Measures the costs of features of a motion or an optimal-control problem, as far as the budget goes.
    pub(super) fn features(&mut self) -> Vec<FeatureCost> {
        let scene = self.scene(&self.usual);
        let subject = Subject::of(self.sweep.scene);
        let rod = (scene.arm(self.sweep.source).ok())
            .and_then(|arm| arm.rod(&scene.discretization()).ok());
        let Some(rod) = rod.filter(|_| subject != Subject::ClosedLoop) else {
            return Vec::new();
        };
        let mut costs = Vec::new();
        for feature in scene.features(rod.scales.time) {
            if self.is_over() {
                self.cut = true;
                break;
            }
            let is_solved = subject == Subject::OptimalControl;
            let measure = |scene: &Scene| {
                if is_solved {
                    self.iteration_ms(scene)
                } else {
                    self.step_ns(scene)
                }
            };
            let mut least = [f64::INFINITY; 2];
            let mut ratios = [f64::INFINITY, 0.0];
            for _ in 0..ROUNDS {
                let turn = [&feature.with, &feature.without]
                    .map(|scene| measure(scene).unwrap_or(f64::INFINITY));
                least = [0, 1].map(|i| least[i].min(turn[i]));
                let ratio = turn[0] / turn[1];
                ratios = [ratios[0].min(ratio), ratios[1].max(ratio)];
                // Long work is measured less often.
                if least[0] > LONG_MS && is_solved || self.is_over() {
                    break;
                }
            }
            if least.iter().all(|value| value.is_finite()) {
                costs.push(FeatureCost {
                    feature: feature.name.into(),
                    in_scene: feature.in_scene,
                    unit: if is_solved {
                        "ms per linearization and subproblem"
                    } else {
                        "ns per node and step"
                    }
                    .into(),
                    with: least[0],
                    without: least[1],
                    ratios: Some(ratios).filter(|ratios| ratios.iter().all(|r| r.is_finite())),
                });
            }
        }
        costs
    }

    /// Measures the nanoseconds of one node and step; `None` if the motion breaks down.
    fn step_ns(&self, scene: &Scene) -> Option<f64> {
        let stop = self.sweep.stop;
        let mut motion = ComparedMotion::of_scene(scene, self.sweep.source).ok()?;
        let open = scene.discretization();
        let found = motion.arm.discretize(motion.duration, &open).ok()?;
        motion.duration = motion.duration.min(STEPS * found.grid.step);
        let setup = motion.setup(&open, f64::INFINITY, stop).ok()?;
        let seconds = setup.time(stop).ok()?.processor;
        let count = setup.rod.n_nodes() * setup.grid.n_steps;
        Some(1e9 * seconds / count as f64)
    }

    /// Measures the milliseconds of linearization and subproblem in one of the first iterations of a solve from rest; `None` if there is
    /// none. Trial points do not count: their number depends on the course of the solve, not on the feature.
    fn iteration_ms(&self, scene: &Scene) -> Option<f64> {
        let stop = self.sweep.stop;
        let setup = scene.optimal_control_until(self.sweep.source, stop).ok()?;
        let settings = SqpSettings {
            max_iterations: ITERATIONS,
            ..setup.settings.clone()
        };
        let from_rest = Search {
            guess: Some(Guess::Rest),
            ..setup.search.clone()
        };
        let clock = ProcessorClock::start();
        let attempts = search(&setup.problem, &settings, &from_rest, &|_, _| {
            ControlFlow::Continue(())
        });
        // Phases are measured by wall time; the processor's fraction of the total is taken for theirs.
        let all = clock.seconds();
        let part = (all.processor / all.wall).min(1.0);
        let attempts = attempts.ok()?;
        let outcome = &attempts.first()?.outcome;
        let phases = outcome.phases;
        let seconds = phases.linearize + phases.condense + phases.qp;
        let n = outcome.history.len();
        (n > 0).then(|| 1e3 * part * seconds / n as f64)
    }
}
