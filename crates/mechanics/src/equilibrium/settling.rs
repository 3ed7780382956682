//! The minimization of the energy: how an arm settles, and leaves saddles on the way.

use nalgebra::Vector6;

use super::path::continued;
use super::statics::{
    FIRST_SHIFT, LARGEST_SHIFT, SHIFT_GROWTH, Statics, TOLERANCE, crushed, next_shift,
};
use super::{EquilibriumError, Settled};
use crate::tangent::{POSITIVE, Tangent, dot};
use cosserat::configuration::Configuration;
use cosserat::rod::Rod;
use cosserat::rotation::log;
use stop::StopSignal;

/// Dilatation above which a length has no meaning.
const LARGEST_DILATATION: f64 = 1e6;
/// Cap on the iterations, and on the saddles that are left.
const OUTER_LIMIT: usize = 400;
const MOST_SADDLES: usize = 20;
/// Shift below which an indefinite stiffness counts as neutral: rounding of a loose motion, or of a critical load.
const NEUTRAL_SHIFT: f64 = 1e-5;
/// Largest turn of a node in a step of the minimization, rad.
const LARGEST_TURN: f64 = 1.0;
/// Part of the decrease of a linear model by which the energy falls at least (Nocedal & Wright 2006, p. 33), and cap on the halvings of a
/// step.
const SUFFICIENT_DECREASE: f64 = 1e-4;
const HALVINGS: usize = 5;
/// Rounding of the energy, relative to the sum of its parts.
const ENERGY_ROUNDING: f64 = 1e-13;
/// First displacement away from a saddle, in lengths of the arm or rad, and cap on its halvings.
const LEAVING: f64 = 0.1;
const LEAVING_HALVINGS: usize = 16;

impl Statics<'_> {
    /// Returns the equilibrium in which the arm settles from a shape whose ends are held: a stable one if it `leaves` saddles.
    pub fn at_rest(
        &mut self,
        from: &Settled,
        stop: &StopSignal,
        leaves: bool,
    ) -> Result<Settled, EquilibriumError> {
        let Settled {
            shape: mut center,
            mut saddles,
        } = from.clone();
        let is_conservative = self.is_conservative();
        let mut residual = self.residual(&center);
        let mut iterations = 0;
        let mut shift = 0.0;
        let mut was_continued = false;
        let may_leave = leaves;
        while iterations < OUTER_LIMIT {
            stop.check()?;
            iterations += 1;
            let size = self.scaled(&residual);
            let tolerance = TOLERANCE.max(self.rounding(&center));
            if size <= tolerance {
                let shape = self.refined_once(center, &residual);
                if may_leave
                    && saddles < from.saddles + MOST_SADDLES
                    && let Some(away) = self.away_from_saddle(&shape)
                {
                    saddles += 1;
                    residual = self.residual(&away);
                    center = away;
                    continue;
                }
                let shape = checked(self.rod, shape)?;
                return Ok(Settled { shape, saddles });
            }
            let definite = leaves && self.is_definite(&center, 0.0);
            if let Some((trial, trial_residual)) = self.newton_steps(&center, &residual) {
                let is_lower = !leaves || definite || self.falls(&center, &residual, &trial);
                if is_lower && self.scaled(&trial_residual) < 0.5 * size {
                    center = trial;
                    residual = trial_residual;
                    shift = 0.0;
                    continue;
                }
                // At rounding, further steps bring no improvement.
                if size < 1e3 * TOLERANCE && self.scaled(&trial_residual) < 1e3 * TOLERANCE {
                    let is_nearer = self.scaled(&trial_residual) < size;
                    let shape = checked(self.rod, if is_nearer { trial } else { center })?;
                    return Ok(Settled { shape, saddles });
                }
            }
            if !is_conservative && !was_continued {
                was_continued = true;
                let (rod, t, spring) = (self.rod, self.t, self.spring);
                if let Some(shape) = continued(rod, &from.shape, t, &spring, stop)? {
                    let shape = checked(rod, shape)?;
                    return Ok(Settled { shape, saddles });
                }
            }
            let Some(lower) = self.lower(&center, &residual, &mut shift) else {
                break;
            };
            center = lower;
            residual = self.residual(&center);
        }
        Err(EquilibriumError::NotConverged {
            iterations,
            residual: self.scaled(&residual),
        })
    }

    /// Tells whether a trial lies downhill: in the direction of the forces, with less energy up to rounding.
    fn falls(
        &self,
        center: &Configuration,
        residual: &[Vector6<f64>],
        trial: &Configuration,
    ) -> bool {
        let first = self.rod.first_free_node();
        let along: f64 = (residual.iter().enumerate())
            .map(|(i, r)| {
                let q = i + first;
                let way = trial.positions[q] - center.positions[q];
                let turn = log(&center.rotations[q].tr_mul(&trial.rotations[q]));
                r.fixed_rows::<3>(0).dot(&way) + r.fixed_rows::<3>(3).dot(&turn)
            })
            .sum();
        let (own, size) = self.energy(center, center);
        let (next, _) = self.energy(trial, center);
        let rounding = ENERGY_ROUNDING * size;
        along > -rounding && next <= own + rounding
    }

    /// Returns a shape with less energy by a step with `K + σ W`; `shift` is `σ` of the last step and becomes that of this one. `None` if
    /// no step reduces the energy beyond rounding.
    fn lower(
        &mut self,
        center: &Configuration,
        residual: &[Vector6<f64>],
        shift: &mut f64,
    ) -> Option<Configuration> {
        let (own, size) = self.energy(center, center);
        let residual_size = self.scaled(residual);
        while *shift <= LARGEST_SHIFT {
            let factor = (self.is_definite(center, *shift))
                .then(|| self.factor(center, *shift))
                .flatten();
            let Some(factor) = factor else {
                *shift = next_shift(*shift);
                continue;
            };
            let mut step = factor.solve(&[residual.to_vec()]).swap_remove(0);
            let (mut turn, mut way) = (0.0_f64, 0.0_f64);
            for part in &step {
                way = way.max(part.fixed_rows::<3>(0).norm());
                turn = turn.max(part.fixed_rows::<3>(3).norm());
            }
            let far = turn.max(way / (0.5 * self.rod.scales.length));
            if !far.is_finite() {
                return None;
            }
            let mut part = (LARGEST_TURN / far).min(1.0);
            let slope = dot(residual, &step);
            for _ in 0..HALVINGS {
                for own in &mut step {
                    *own *= part;
                }
                if let Some(trial) = self.stepped(center, &step, &factor) {
                    let expected = dot(residual, &step);
                    let (next, _) = self.energy(&trial, center);
                    let is_lower = next <= own - SUFFICIENT_DECREASE * expected;
                    // Where rounding hides the decrease, the residual decides.
                    let is_hidden = expected < 1e3 * ENERGY_ROUNDING * size
                        && next <= own + ENERGY_ROUNDING * size;
                    if (is_lower && expected > ENERGY_ROUNDING * size)
                        || (is_hidden && {
                            let after = self.residual(&trial);
                            self.scaled(&after) < 0.9 * residual_size
                        })
                    {
                        *shift = match expected > 0.5 * slope {
                            true if *shift <= FIRST_SHIFT => 0.0,
                            true => *shift / (2.0 * SHIFT_GROWTH),
                            false => *shift,
                        };
                        return Some(trial);
                    }
                }
                part = 0.5;
            }
            *shift = next_shift(next_shift(*shift));
        }
        None
    }

    /// Returns a shape with less energy beside a saddle, along its lowest mode; `None` if the shape is not a saddle beyond rounding. Of two
    /// sides of equal energy it is the one along the first axis of the base.
    fn away_from_saddle(&self, at: &Configuration) -> Option<Configuration> {
        if self.is_definite(at, NEUTRAL_SHIFT) {
            return None;
        }
        let rod = self.rod;
        let mut tangent = Tangent::of(self.stiffness(at));
        tangent.add_efforts(rod, at, self.t);
        let unit = rod.scales.time.powi(-2);
        let modes = tangent.lowest_modes(rod, at, unit, 2)?;
        let least = (POSITIVE * unit).max(tangent.rounding(rod, at));
        if !(modes[0].squared_frequency < -least) {
            return None;
        }
        let first = rod.first_free_node();
        let places = rod.places();
        // The way along an axis of the base, more of it towards the tip, so that it is not zero for waves.
        let along = |axis: usize, shape: &[Vector6<f64>]| -> f64 {
            let axis = at.rotations[0].column(axis).into_owned();
            (shape.iter().enumerate())
                .map(|(i, own)| (1.0 + places[i + first]) * axis.dot(&own.fixed_rows::<3>(0)))
                .sum()
        };
        let size = |shape: &[Vector6<f64>]| -> f64 {
            let own = |s: &Vector6<f64>| s.fixed_rows::<3>(0).norm();
            shape.iter().map(own).sum()
        };
        let mut mode = modes[0].shape.clone();
        let is_double = modes.get(1).is_some_and(|second| {
            let apart = second.squared_frequency - modes[0].squared_frequency;
            apart < 1e-6 * (modes[0].squared_frequency.abs() + unit)
        });
        if is_double {
            let second = &modes[1].shape;
            let (a, b) = (along(0, &mode), along(0, second));
            let norm = a.hypot(b);
            if norm > 1e-6 * (size(&mode) + size(second)) {
                for (own, second) in mode.iter_mut().zip(second) {
                    *own = *own * (a / norm) + second * (b / norm);
                }
            }
        }
        let ways = [0, 1, 2].map(|axis| along(axis, &mode));
        let towards = ways.iter().find(|way| way.abs() > 1e-6 * size(&mode));
        let mut sign = towards.map_or(1.0, |way| way.signum());
        let far = (mode.iter())
            .map(|s| {
                let way = s.fixed_rows::<3>(0).norm() / rod.scales.length;
                way.max(s.fixed_rows::<3>(3).norm())
            })
            .fold(0.0, f64::max);
        if !(far > 0.0 && far.is_finite()) {
            return None;
        }
        sign *= LEAVING / far;
        let (own, size) = self.energy(at, at);
        let factor = self.factor(at, self.definite_shift(at)?)?;
        for halving in 0..LEAVING_HALVINGS {
            let trials = [1.0, -1.0].map(|side| {
                let length = side * sign * 0.5_f64.powi(halving as i32);
                let step: Vec<_> = mode.iter().map(|s| s * length).collect();
                let trial = self.stepped(at, &step, &factor)?;
                let (energy, _) = self.energy(&trial, at);
                Some((energy, trial))
            });
            let [plus, minus] = trials;
            let best = match (plus, minus) {
                (Some(plus), Some(minus)) => {
                    let gain = own - plus.0.min(minus.0);
                    // Mirror images have the same energy.
                    if minus.0 < plus.0 - 1e-3 * gain.abs() {
                        Some(minus)
                    } else {
                        Some(plus)
                    }
                }
                (plus, minus) => plus.or(minus),
            };
            if let Some((energy, trial)) = best
                && energy < own - 10.0 * ENERGY_ROUNDING * size
            {
                return Some(trial);
            }
        }
        None
    }
}

fn checked(rod: &Rod, shape: Configuration) -> Result<Configuration, EquilibriumError> {
    let dilatation = rod.dilatation(&shape.positions);
    if let Some(element) = dilatation.iter().position(|e| !(*e < LARGEST_DILATATION)) {
        return Err(EquilibriumError::Overstretched {
            element,
            dilatation: dilatation[element],
        });
    }
    match crushed(rod, &shape) {
        None => Ok(shape),
        Some((element, stretch)) => Err(EquilibriumError::Crushed { element, stretch }),
    }
}
