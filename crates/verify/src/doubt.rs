//! The controls of a solution on plants that differ from its model: the part of them that leaves a limit, by how much, and where they end.
//!
//! A plant is drawn by a caller, who states the doubt; here its motion is computed, and every hard path constraint evaluated at each of its
//! steps. Of `n` plants drawn independently, `k` leave a limit. The part of all plants that do is then below the largest `p` with
//! `Σ_{i≤k} C(n, i) pⁱ (1 - p)ⁿ⁻ⁱ ≥ 0.05`, with a confidence of 95 % (Clopper and Pearson 1934, one side).
//!
//! Margins narrow the limits so that a stated part of the plants stays inside. Every row of a limit at a time node deviates on plant `i`
//! from its value on the model by `d_i`; with the root `s` of the mean square of these, the score of a plant is the largest `d_i/s` of all
//! rows that plants come near. The quantile of the scores times `s` is the margin of a row (split conformal prediction; Lindemann and
//! others 2023 for motions). The margins are recomputed for the controls that keep them and not differentiated, which is the zero-order
//! method for robust optimal control (Zanelli, Frey, Messerer and Diehl 2021).

use serde::Serialize;

use super::criteria::BETWEEN;
use super::limits::{Measure, Pose, is_watched};
use super::refinement::{Watch, stable_factor};
use super::{CheckError, Claim, refined_grid, refined_signal};
use control::OptimalControlProblem;
use mechanics::threads::on_threads;
use mechanics::{Rod, State, Stepper};

/// The plants of a stated doubt.
pub struct Plants<'a> {
    /// Returns a plant by its number and the state in which it starts; `None` if it cannot be built, or cannot start as the model does.
    pub draw: &'a (dyn Fn(usize) -> Option<(Rod, State)> + Sync),
    /// Number of plants.
    pub n: usize,
    /// Number of threads.
    pub n_threads: usize,
}

/// A hard limit on all plants.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LimitInDoubt {
    /// Name of the limit.
    pub name: String,
    /// Number of plants that leave it.
    pub violating: usize,
    /// Largest excess over the limit in its own unit on any plant that moves to the end; negative inside.
    pub excess: f64,
    /// Unit of the excess.
    pub unit: &'static str,
}

/// Distances of the plants' tips, or of the nodes that have the goal, from their target at the end, m; of closed loops the root of the mean
/// square of those from their reference.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GoalInDoubt {
    /// Distance that half of the plants stay within.
    pub median_m: f64,
    /// Distance that 95 % of them stay within.
    pub most_m: f64,
    /// Largest distance.
    pub largest_m: f64,
}

/// The controls of a solution on plants of a stated doubt.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct UnderDoubt {
    /// Number of plants.
    pub plants: usize,
    /// Number of plants that leave a limit by more than a certificate allows between samples, or whose motion breaks down.
    pub violating: usize,
    /// Number of plants that could not be built, or whose motion breaks down.
    pub failed: usize,
    /// Part of the plants that leaves a limit.
    pub share: f64,
    /// Bound on the part of all plants of this doubt that do, with a confidence of 95 %.
    pub at_most: f64,
    /// The hard limits.
    pub limits: Vec<LimitInDoubt>,
    /// The goal; absent without a target position.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub goal: Option<GoalInDoubt>,
}

/// One minus the confidence of the bound.
const RISK: f64 = 0.05;

/// A plant whose motion does not break down.
#[derive(Clone, Debug, Default)]
pub struct OnPlant {
    /// Largest excess over each limit in its own unit.
    pub excess: Vec<f64>,
    /// Tells of each limit whether the plant leaves it.
    pub leaves: Vec<bool>,
    /// Distance from the goal, m.
    pub distance: Option<f64>,
}

/// The motion of one plant.
struct Motion {
    on_plant: OnPlant,
    /// Excess of every row at its time nodes; empty unless it is asked for.
    rows: Vec<f64>,
}

/// Replays a solution on plants.
///
/// # Errors
/// [`CheckError`] for a solution that does not belong to the problem, and if a stop signal ends the replays.
pub fn replay_on_plants(
    problem: &OptimalControlProblem,
    solution: &Claim,
    plants: &Plants,
) -> Result<UnderDoubt, CheckError> {
    solution.validate(problem)?;
    let motions = plants.each(problem, |rod, start| {
        move_plant(problem, solution, rod, start, false)
    })?;
    let watched = Watch::new(problem, &problem.rod, problem.grid.step).worst;
    let limits = watched.into_iter().map(|own| (own.name, own.unit));
    let outcomes: Vec<_> = (motions.into_iter())
        .map(|own| own.map(|motion| motion.on_plant))
        .collect();
    Ok(UnderDoubt::of(limits.collect(), &outcomes))
}

impl UnderDoubt {
    /// Counts what plants do with some limits, each with its name and unit; `None` is a plant without a motion to the end.
    #[must_use]
    pub fn of(limits: Vec<(String, &'static str)>, outcomes: &[Option<OnPlant>]) -> Self {
        let moved: Vec<&OnPlant> = outcomes.iter().flatten().collect();
        let limits = (limits.into_iter().enumerate())
            .map(|(index, (name, unit))| LimitInDoubt {
                name,
                violating: moved.iter().filter(|own| own.leaves[index]).count(),
                excess: (moved.iter())
                    .fold(f64::NEG_INFINITY, |most, own| most.max(own.excess[index])),
                unit,
            })
            .collect();
        let failed = outcomes.len() - moved.len();
        let violating = failed
            + moved
                .iter()
                .filter(|own| own.leaves.contains(&true))
                .count();
        let mut distances: Vec<f64> = moved.iter().filter_map(|own| own.distance).collect();
        distances.sort_by(f64::total_cmp);
        let within = |part: f64| {
            let rank = (part * distances.len() as f64).ceil() as usize;
            distances.get(rank.max(1) - 1).copied()
        };
        let goal = (within(0.5).zip(within(0.95)).zip(within(1.0))).map(
            |((median_m, most_m), largest_m)| GoalInDoubt {
                median_m,
                most_m,
                largest_m,
            },
        );
        Self {
            plants: outcomes.len(),
            violating,
            failed,
            share: violating as f64 / outcomes.len() as f64,
            at_most: at_most(violating, outcomes.len()),
            limits,
            goal,
        }
    }
}

/// Margins of the path constraints of a problem, under which a part of plants may leave a limit.
#[derive(Clone, Debug, PartialEq)]
pub struct Margins {
    /// Number of plants that leave a limit at a time node under the controls from which the margins were computed.
    pub violating: usize,
    /// Quantile of the scores.
    pub factor: f64,
    /// For each path constraint the [margins](control::PathConstraint::margins), empty of soft ones and of those that depend on inputs.
    pub of: Vec<Vec<f64>>,
}

impl Margins {
    /// Returns the largest number of plants among `n` that may leave a limit if `share` of all may: one less than the rank of a quantile of
    /// `n + 1` numbers.
    #[must_use]
    pub fn most_violating(share: f64, n: usize) -> Option<usize> {
        ((share * (n + 1) as f64).floor() as usize).checked_sub(1)
    }

    /// Computes the margins for the plants of a doubt.
    ///
    /// # Errors
    /// As [`replay_on_plants`].
    pub fn of(
        problem: &OptimalControlProblem,
        solution: &Claim,
        plants: &Plants,
        share: f64,
    ) -> Result<Self, CheckError> {
        solution.validate(problem)?;
        let own = problem.rod.clone();
        let on_model = move_plant(problem, solution, &own, problem.initial.clone(), true)?;
        let rows = on_model.map_or_else(Vec::new, |own| own.rows);
        let motions = plants.each(problem, |rod, start| {
            move_plant(problem, solution, rod, start, true)
        })?;
        let moved: Vec<&[f64]> = motions.iter().flatten().map(|own| &own.rows[..]).collect();
        let tolerances = tolerances(problem);
        let violating = plants.n - moved.len()
            + (moved.iter())
                .filter(|own| own.iter().zip(&tolerances).any(|(h, most)| !(h <= most)))
                .count();
        let n = moved.len().max(1) as f64;
        let spread: Vec<f64> = (0..rows.len())
            .map(|row| {
                let squares = moved.iter().map(|own| (own[row] - rows[row]).powi(2));
                (squares.sum::<f64>() / n).sqrt()
            })
            .collect();
        let farthest =
            |row: usize| (moved.iter()).fold(0.0, |most: f64, own| most.max(own[row] - rows[row]));
        // Twice as far inside as any plant deviates, a row is none that plants come near.
        let near: Vec<usize> = (0..rows.len())
            .filter(|&row| spread[row] > 0.0 && rows[row] + 2.0 * farthest(row) > 0.0)
            .collect();
        let mut scores: Vec<f64> = (moved.iter())
            .map(|own| {
                let scores = near.iter().map(|&row| (own[row] - rows[row]) / spread[row]);
                scores.fold(0.0, f64::max)
            })
            .collect();
        scores.resize(plants.n, f64::INFINITY);
        scores.sort_by(f64::total_cmp);
        let above = Self::most_violating(share, plants.n).unwrap_or(0);
        let factor = scores[plants.n - 1 - above];
        let mut left = &spread[..];
        let of = (problem.path.iter())
            .map(|constraint| {
                let own = is_watched(constraint).then(|| {
                    let n_items = constraint.limit.n_items(&problem.rod);
                    let (own, rest) = left.split_at(constraint.time_nodes.len() * n_items);
                    left = rest;
                    own.iter().map(|s| factor * s).collect()
                });
                own.unwrap_or_default()
            })
            .collect();
        Ok(Self {
            violating,
            factor,
            of,
        })
    }

    /// Returns the problem with these margins.
    #[must_use]
    pub fn on(&self, problem: &OptimalControlProblem) -> OptimalControlProblem {
        let mut out = problem.clone();
        for (constraint, own) in out.path.iter_mut().zip(&self.of) {
            constraint.margins.clone_from(own);
        }
        out
    }
}

/// Returns the excess by which each row leaves its limit.
fn tolerances(problem: &OptimalControlProblem) -> Vec<f64> {
    (problem.path.iter().filter(|own| is_watched(own)))
        .flat_map(|own| {
            let reference = own.limit.reference(&problem.rod, &problem.radii);
            let n = own.time_nodes.len() * own.limit.n_items(&problem.rod);
            std::iter::repeat_n(BETWEEN * reference, n)
        })
        .collect()
}

/// Computes the motion of a plant; `None` if it breaks down.
fn move_plant(
    problem: &OptimalControlProblem,
    solution: &Claim,
    rod: &Rod,
    start: State,
    with_rows: bool,
) -> Result<Option<Motion>, CheckError> {
    let factor = stable_factor(problem.grid.step, &problem.rod, rod, 1);
    let grid = refined_grid(problem.grid, factor);
    let signal = refined_signal(problem, factor, rod, solution);
    let mut stepper = Stepper::new(rod, grid, start);
    let mut watch = Watch::new(problem, rod, grid.step);
    let mut rows = Rows::new(problem, with_rows);
    watch.look(&stepper);
    rows.look(problem, rod, &stepper, 0);
    for k in 0..grid.n_steps {
        problem.stop.check_at(k)?;
        if stepper.advance([signal.at(k), signal.at(k + 1)]).is_err() {
            return Ok(None);
        }
        watch.look(&stepper);
        if (k + 1).is_multiple_of(factor) {
            rows.look(problem, rod, &stepper, (k + 1) / factor);
        }
    }
    let target = super::last_goal(problem, |goal| goal.position).map(|(target, _)| target);
    let distance = target.map(|target| (stepper.position(problem.goal_node()) - target).norm());
    let is_number = distance.is_none_or(f64::is_finite);
    Ok(is_number.then(|| Motion {
        on_plant: OnPlant {
            excess: watch.worst.iter().map(|own| own.excess).collect(),
            leaves: (watch.worst.iter())
                .map(|own| !(own.excess <= BETWEEN * own.reference))
                .collect(),
            distance,
        },
        rows: rows.in_order(),
    }))
}

/// The excess of all rows of the hard limits at their time nodes, by constraint, time node and item.
struct Rows {
    of: Vec<Vec<f64>>,
    before: Option<Pose>,
}

impl Rows {
    fn new(problem: &OptimalControlProblem, with_rows: bool) -> Self {
        let n = problem.path.iter().filter(|own| is_watched(own)).count();
        Self {
            of: vec![Vec::new(); if with_rows { n } else { 0 }],
            before: None,
        }
    }

    fn look(&mut self, problem: &OptimalControlProblem, rod: &Rod, stepper: &Stepper, k: usize) {
        if self.of.is_empty() {
            return;
        }
        let here = Pose::now(stepper);
        let measure = Measure {
            rod,
            radii: &problem.radii,
            step: problem.grid.step,
        };
        let watched = problem.path.iter().filter(|own| is_watched(own));
        for (constraint, out) in watched.zip(&mut self.of) {
            if constraint.time_nodes.binary_search(&k).is_err() {
                continue;
            }
            let items = 0..constraint.limit.n_items(rod);
            out.extend(
                items.map(|item| {
                    measure.excess(&constraint.limit, item, &here, self.before.as_ref())
                }),
            );
        }
        self.before = Some(here);
    }

    fn in_order(self) -> Vec<f64> {
        self.of.concat()
    }
}

impl Plants<'_> {
    /// Evaluates all plants.
    fn each<T: Send>(
        &self,
        problem: &OptimalControlProblem,
        evaluate: impl Fn(&Rod, State) -> Result<Option<T>, CheckError> + Sync,
    ) -> Result<Vec<Option<T>>, CheckError> {
        on_threads(self.n, self.n_threads, |number| {
            problem.stop.check()?;
            match (self.draw)(number) {
                Some((rod, start)) => evaluate(&rod, start),
                None => Ok(None),
            }
        })
    }
}

/// Returns the bound on a part of which `k` of `n` were found, with the confidence `1 - RISK`.
#[must_use]
pub fn at_most(k: usize, n: usize) -> f64 {
    if k >= n {
        return 1.0;
    }
    let at_most_k = |p: f64| -> f64 {
        // The term of `i` from that of `i - 1`, in logarithms.
        let (mut term, mut sum) = (n as f64 * (-p).ln_1p(), 0.0);
        for i in 0..=k {
            sum += term.exp();
            term += ((n - i) as f64 / (i + 1) as f64).ln() + p.ln() - (-p).ln_1p();
        }
        sum
    };
    let (mut below, mut above) = (k as f64 / n as f64, 1.0);
    while above - below > 1e-12 {
        let middle = 0.5 * (below + above);
        if at_most_k(middle) >= RISK {
            below = middle;
        } else {
            above = middle;
        }
    }
    above
}

impl UnderDoubt {
    /// Returns what was found in sentences; `tips` says what the distances are.
    #[must_use]
    pub fn sentence(&self, tips: &str) -> String {
        let mut out = format!(
            "{} of {} plants leave a limit: with 95 % confidence at most {:.1} % of all do",
            self.violating,
            self.plants,
            100.0 * self.at_most
        );
        for own in self.limits.iter().filter(|own| own.violating > 0) {
            out += &format!(
                "; {} by up to {:.1e} {} ({} plants)",
                own.name, own.excess, own.unit, own.violating
            );
        }
        if self.failed > 0 {
            out += &format!("; {} do not move to the end", self.failed);
        }
        if let Some(goal) = &self.goal {
            out += &format!(
                "; {tips} {:.1e} m (median), of 95 % within {:.1e} m",
                goal.median_m, goal.most_m
            );
        }
        out
    }
}
