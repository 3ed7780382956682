//! The wrench that holds the tip at its goal: what statics asks of the actuators, before any dynamics.
//!
//! Among the wrenches `u` under which an equilibrium puts the tip where the goal wants it, `c(u) = 0`, the one of least effort (components
//! over their scales) is found by `u ← J⁺ (J u - c)`, `J = ∂c/∂u` by differences of equilibria, while the goal moves from where the tip rests
//! without control to where it is, or with a force on the tip from where a stiff spring pulls it.

use nalgebra::{DMatrix, DVector, Vector3};

use super::guess::{SPRINGS, carried};
use super::problem::{Component, Goal, OptimalControlProblem};
use crate::mechanics::equilibrium::{EquilibriumError, TipSpring, static_equilibrium};
use crate::mechanics::rotation::{exp, log};
use crate::mechanics::{Configuration, Load, LoadFrame, Rod, Wrench};

/// What holds the tip at its goal.
#[derive(Clone, Debug, PartialEq)]
pub struct StaticNeed {
    /// The wrench on every actuator: force in the spatial frame, moment in the node's body frame.
    pub wrenches: Vec<Wrench>,
    /// By how much the wrench exceeds each actuator's bounds: force in N, moment in N m; zero where it does not.
    pub excess: Vec<[f64; 2]>,
    /// The equilibrium under the wrenches.
    pub shape: Configuration,
}

impl StaticNeed {
    /// Whether every wrench is within its bounds.
    #[must_use]
    pub fn is_within_bounds(&self) -> bool {
        self.excess.iter().flatten().all(|excess| *excess == 0.0)
    }
}

/// Why no such wrench was found. There may be one all the same.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StaticNeedError {
    /// There is no goal for the tip's position or orientation at the end.
    #[error("the tip has no goal at the end")]
    NoGoal,
    /// Nothing is actuated.
    #[error("nothing is actuated")]
    NoActuation,
    /// Too large to be looked at in passing.
    #[error("the elements or actuators are too many to look at in passing")]
    TooLarge,
    /// The arm without control has no equilibrium.
    #[error("without control: {0}")]
    Equilibrium(#[from] EquilibriumError),
    /// The search came no nearer.
    #[error("the tip was brought to {reached:.0} % of the way, and no further")]
    NotFound {
        /// Percent of the way.
        reached: f64,
    },
}

/// Elements, and actuated components, up to which equilibria take a fraction of a second.
const MOST_ELEMENTS: usize = 200;
const MOST_COMPONENTS: usize = 24;
/// Component of the wrench, in the rod's scales EI/L² and EI/L, by which the equilibrium is differentiated: equilibria are known to 1e-9 of these.
const DIFFERENCE: f64 = 1e-4;
/// Distance over length, and angle, at which the tip counts as held.
const TOLERANCE: f64 = 1e-6;
/// Stiffness of the last springs, in units of EI/L³ and EI/L, and distance over length at which what they hold is there: a pull of a hundred
/// times the rod's force scale.
const STIFFEST: f64 = 1e6;
const NEAR: f64 = 1e-4;
/// Part of the way in the first step, and the least one.
const FIRST_STRIDE: f64 = 0.5;
const LEAST_STRIDE: f64 = 0.02;
/// Corrections at a point of the way, and rounds that reduce the effort where the goal is met; change of the wrench at which these end.
const ROUNDS: usize = 8;
const SETTLED: f64 = 0.01;
/// Largest change of the wrench in a round, in the rod's scales and of its size: the goal is met to first order of it.
const LARGEST_CHANGE: [f64; 2] = [0.2, 0.3];

/// The wrench of least effort that holds the tip at the goal at the end of the horizon. Where it exceeds a bound, another one may not.
///
/// # Errors
/// [`StaticNeedError`]; a failed search proves nothing.
pub fn static_need(problem: &OptimalControlProblem) -> Result<StaticNeed, StaticNeedError> {
    let goal = problem
        .final_goals()
        .find(|goal| goal.position.is_some() || goal.rotation.is_some())
        .ok_or(StaticNeedError::NoGoal)?;
    // Wrenches on nodes alone: what actuators of one's own can hold is not looked for.
    let components: Vec<Component> = (problem.actuated_components().into_iter())
        .filter(|component| component.actuator < problem.wrench_actuators().len())
        .collect();
    if components.is_empty() {
        return Err(StaticNeedError::NoActuation);
    }
    if problem.rod.n_elements() > MOST_ELEMENTS || components.len() > MOST_COMPONENTS {
        return Err(StaticNeedError::TooLarge);
    }
    let rod = &problem.rod;
    let need_of = |components: Vec<Component>| {
        let statics = Statics {
            problem,
            components,
            end: problem.grid.duration(),
        };
        (statics.held(goal)).map(|held| statics.need(&held))
    };
    // A force on the tip holds it anywhere by itself, which is found most surely: moments are for orientations, and for what its bound denies.
    let tip_force: Vec<Component> = (components.iter())
        .filter(|component| {
            component.axis < 3 && problem.actuators[component.actuator].node == rod.tip()
        })
        .copied()
        .collect();
    if goal.rotation.is_some() || tip_force.len() < 3 || tip_force.len() == components.len() {
        return need_of(components);
    }
    let alone = need_of(tip_force);
    match alone {
        Ok(need) if need.is_within_bounds() => Ok(need),
        _ => need_of(components).or(alone),
    }
}

/// An equilibrium and the components that hold it, in the rod's scales.
#[derive(Clone)]
struct Held {
    u: DVector<f64>,
    shape: Configuration,
}

struct Statics<'a> {
    problem: &'a OptimalControlProblem,
    components: Vec<Component>,
    end: f64,
}

impl Statics<'_> {
    /// N or N m of a unit of a component.
    fn unit(&self, component: &Component) -> f64 {
        let scales = &self.problem.rod.scales;
        if component.axis < 3 {
            scales.force
        } else {
            scales.moment
        }
    }

    fn wrenches(&self, u: &DVector<f64>) -> Vec<Wrench> {
        let mut out = vec![Wrench::default(); self.problem.actuators.len()];
        for (component, value) in self.components.iter().zip(u.iter()) {
            let wrench = &mut out[component.actuator];
            let value = value * self.unit(component);
            if component.axis < 3 {
                wrench.force[component.axis] = value;
            } else {
                wrench.moment[component.axis - 3] = value;
            }
        }
        out
    }

    fn need(&self, held: &Held) -> StaticNeed {
        let wrenches = self.wrenches(&held.u);
        let excess = (wrenches.iter().zip(&self.problem.actuators))
            .map(|(wrench, actuator)| {
                [
                    (&actuator.force, &wrench.force),
                    (&actuator.moment, &wrench.moment),
                ]
                .map(|(channel, value)| channel.bound.map_or(0.0, |bound| bound.violation(value)))
            })
            .collect();
        StaticNeed {
            wrenches,
            excess,
            shape: held.shape.clone(),
        }
    }

    /// Equilibrium under `u`, at the end of the horizon.
    fn equilibrium(
        &self,
        u: &DVector<f64>,
        start: &Configuration,
    ) -> Result<Configuration, EquilibriumError> {
        let mut rod = Rod::clone(&self.problem.rod);
        for (wrench, actuator) in self.wrenches(u).iter().zip(&self.problem.actuators) {
            let load = |force, moment, frame| Load {
                node: actuator.node,
                force,
                moment,
                frame,
                profile: Vec::new(),
            };
            let zero = Vector3::zeros();
            if wrench.force != zero {
                rod.loads.push(load(wrench.force, zero, LoadFrame::Spatial));
            }
            if wrench.moment != zero {
                rod.loads.push(load(zero, wrench.moment, LoadFrame::Body));
            }
        }
        static_equilibrium(&rod, start, self.end, &TipSpring::default())
    }

    /// What the tip lacks: over the length, and in rad, in the order of the goal's parts.
    fn lack(&self, goal: &Goal, shape: &Configuration) -> DVector<f64> {
        let tip = self.problem.rod.tip();
        let mut out = Vec::new();
        if let Some(position) = &goal.position {
            let lack = (position - shape.positions[tip]) / self.problem.rod.scales.length;
            out.extend(lack.iter().copied());
        }
        if let Some(rotation) = &goal.rotation {
            let lack = log(&(shape.rotations[tip].transpose() * rotation));
            out.extend(lack.iter().copied());
        }
        DVector::from_vec(out)
    }

    /// The goal at a part of the way from where the tip is in `from`.
    fn on_the_way(&self, goal: &Goal, from: &Configuration, part: f64) -> Goal {
        let tip = self.problem.rod.tip();
        let mut out = goal.clone();
        let (x, r) = (&from.positions[tip], &from.rotations[tip]);
        out.position = goal.position.map(|to| x + (to - x) * part);
        out.rotation = (goal.rotation).map(|to| r * exp(&(log(&(r.transpose() * to)) * part)));
        out
    }

    /// The shape and wrench that hold the goal, from the rest without control.
    fn held(&self, goal: &Goal) -> Result<Held, StaticNeedError> {
        let rod = &self.problem.rod;
        let start = carried(rod, self.problem.initial.configuration.clone(), self.end);
        if let Some(from) = self.pulled(goal, &start) {
            // Where the effort does not settle, the pull of the springs itself.
            let held = (self.toward(goal, &from, ROUNDS)).or_else(|| self.toward(goal, &from, 0));
            if let Some(held) = held {
                return Ok(held);
            }
            // Held by springs, a shape is found that would leave under the same force alone, such as an arm pressed together; with three
            // components for three coordinates there is no other force.
            let is_determined = goal.rotation.is_none() && self.components.len() == 3;
            if is_determined && self.lack(goal, &from.shape).amax() < NEAR {
                return Ok(from);
            }
        }
        let u = DVector::zeros(self.components.len());
        let rest = self.equilibrium(&u, &start)?;
        let mut held = Held {
            u,
            shape: rest.clone(),
        };
        let (mut part, mut stride) = (0.0, FIRST_STRIDE);
        while part < 1.0 {
            let next = f64::min(part + stride, 1.0);
            let effort = if next == 1.0 { ROUNDS } else { 0 };
            match self.toward(&self.on_the_way(goal, &rest, next), &held, effort) {
                Some(found) => {
                    held = found;
                    part = next;
                    stride *= 1.5;
                }
                None if stride > LEAST_STRIDE => stride *= 0.5,
                None => {
                    return Err(StaticNeedError::NotFound {
                        reached: 100.0 * part,
                    });
                }
            }
        }
        Ok(held)
    }

    /// The shape in which stiff springs hold the tip, and their pull; `None` where the tip's actuator has no force in some direction.
    fn pulled(&self, goal: &Goal, start: &Configuration) -> Option<Held> {
        let rod = &self.problem.rod;
        let at = |axis: usize| {
            (self.components.iter()).position(|component| {
                let actuator = &self.problem.actuators[component.actuator];
                actuator.node == rod.tip() && component.axis == axis
            })
        };
        goal.position?;
        let forces = [at(0)?, at(1)?, at(2)?];
        let scales = &rod.scales;
        let mut shape = start.clone();
        let mut spring = TipSpring::default();
        for stiffness in SPRINGS.into_iter().chain([STIFFEST]) {
            spring = TipSpring {
                position: (goal.position).map(|to| (to, stiffness * scales.force / scales.length)),
                rotation: goal.rotation.map(|to| (to, stiffness * scales.moment)),
            };
            shape = static_equilibrium(rod, &shape, self.end, &spring).ok()?;
        }
        let pull = spring.wrench(&shape.positions[rod.tip()], &shape.rotations[rod.tip()]);
        let mut u = DVector::zeros(self.components.len());
        for axis in 0..3 {
            u[forces[axis]] = pull.force[axis] / scales.force;
            if let Some(moment) = at(3 + axis) {
                u[moment] = pull.moment[axis] / scales.moment;
            }
        }
        Some(Held { u, shape })
    }

    /// From a held shape to one that holds `goal`, then `rounds` that reduce the effort.
    fn toward(&self, goal: &Goal, from: &Held, rounds: usize) -> Option<Held> {
        let mut held = from.clone();
        let mut settled = 0;
        for round in 0..ROUNDS + rounds {
            let lack = self.lack(goal, &held.shape);
            let met = lack.amax() < TOLERANCE;
            if met && settled >= rounds {
                return Some(held);
            }
            if !met && round >= ROUNDS && settled == 0 {
                return None;
            }
            let jacobian = self.jacobian(goal, &held, &lack)?;
            let target = &jacobian * &held.u + &lack;
            let wanted = jacobian.svd(true, true).solve(&target, 1e-9).ok()? - &held.u;
            let change = wanted.norm();
            let size = held.u.norm();
            let [least, part] = LARGEST_CHANGE;
            let largest = f64::max(least, part * size);
            let u = &held.u + wanted * f64::min(1.0, largest / change.max(f64::MIN_POSITIVE));
            let shape = self.equilibrium(&u, &held.shape).ok()?;
            held = Held { u, shape };
            if met {
                settled = if change <= SETTLED * size {
                    rounds
                } else {
                    settled + 1
                };
            }
        }
        (self.lack(goal, &held.shape).amax() < TOLERANCE).then_some(held)
    }

    /// Minus the change of the lack per component.
    fn jacobian(&self, goal: &Goal, at: &Held, lack: &DVector<f64>) -> Option<DMatrix<f64>> {
        let mut out = DMatrix::zeros(lack.len(), self.components.len());
        for column in 0..self.components.len() {
            let mut u = at.u.clone();
            u[column] += DIFFERENCE;
            let shape = self.equilibrium(&u, &at.shape).ok()?;
            out.set_column(column, &((lack - self.lack(goal, &shape)) / DIFFERENCE));
        }
        Some(out)
    }
}
