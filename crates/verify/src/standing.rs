//! The growth of small deviations from the equilibrium in which an arm is held after its task.
//!
//! Deviations `q = (δx, η)` obey `M q̈ + C q̇ + K q = 0`. `K` follows from the forces of the check, which come from differentiating the
//! energy, by differences; `C` is viscous damping `c M` and Kelvin-Voigt damping `τ Σ l BᵀC B` of the strains. All motions `exp(s t)` count,
//! since a moment that turns with its node can feed any of them. The rate depends on the grid, so that it is computed on that of the
//! solution and on one of twice the elements.

use nalgebra::{Complex, Matrix6, SMatrix, Vector3, Vector6};

use super::efforts;
use super::interval;
use super::kkt::motion::{applied, energy_gradient, rotary};
use mechanics::differences;
use mechanics::rotation::exp;
use mechanics::tangent::{Tangent, motions_of};
use mechanics::{Configuration, NodeWrenches, Rod, StateView, TimeNode, TimeScheme};

/// Growth of the deviations of an arm that is held.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct HeldGrowth {
    /// Rate at which small deviations grow as `exp(s t)` on the grid of the solution, 1/s; 0 if none grows.
    #[serde(rename = "own_1_s")]
    pub own: f64,
    /// Rate of growth on a grid of twice the elements, 1/s; absent where no equilibrium was found on it.
    #[serde(rename = "refined_1_s")]
    pub refined: Option<f64>,
    /// Frequency of the growing motion, Hz; 0 for an arm that topples or buckles, or where nothing grows.
    #[serde(rename = "frequency_hz")]
    pub frequency: f64,
}

impl HeldGrowth {
    /// Returns the larger one of both rates, 1/s.
    #[must_use]
    pub fn rate(&self) -> f64 {
        self.refined
            .map_or(self.own, |refined| self.own.max(refined))
    }

    /// Describes what grows in a sentence; `None` where nothing does.
    #[must_use]
    pub fn sentence(&self) -> Option<String> {
        let rate = self.rate();
        (rate > 0.0).then(|| {
            let how = match self.frequency {
                0.0 => "leave it".to_string(),
                frequency => format!("swing at {frequency:.3} Hz"),
            };
            format!(
                "the equilibrium in which the arm is held is unstable: with the last controls held, small deviations from it {how} and grow e-fold in \
                 {:.3e} s (growth rate {rate:.3e} 1/s); an arm that is never quite there leaves it",
                rate.recip()
            )
        })
    }
}

/// The forces that act on an arm while it is held.
#[derive(Clone, Copy)]
pub(super) struct Held<'a> {
    pub(super) rod: &'a Rod,
    /// Controls that are held.
    pub(super) control: NodeWrenches<'a>,
    /// Time of loads, s.
    pub(super) time: f64,
    /// Step of the time grid, s.
    pub(super) step: f64,
}

/// Growth and frequency of the motion that grows fastest.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fastest {
    pub(super) rate: f64,
    pub(super) frequency: f64,
}

/// Shift in differences along positions, in lengths of an element, and turn along rotations, rad: differences of fourth order then have an
/// error of 1e-13 of the stiffness of an element.
const SHIFT: f64 = 1e-3;
/// Growth rate up to which nothing grows, in units of the arm's time scale: the rounding of an arm without damping.
const NO_GROWTH: f64 = 3e-4;
/// Unsymmetric part of the stiffness, relative to its largest entry, above which loads have no potential.
const ASYMMETRIC: f64 = 1e-10;
/// Cap on Newton's steps for the equilibrium, and largest turn and change of a node, in rad and lengths of the arm, at which it is found.
const NEWTON_STEPS: usize = 12;
const SETTLED: f64 = 1e-8;
/// Stiffness in the directions that a joint holds, in units of EI/L³ and EI/L per radian: any, for no force acts along them.
const LITTLE: f64 = 1e-9;
/// Largest turn of a node, rad, or change in lengths of the arm, in one step of Newton's method.
const LARGEST_CHANGE: f64 = 0.5;

impl Held<'_> {
    /// Returns the rate at which deviations from the equilibrium next to a configuration grow; `None` if there is no equilibrium within
    /// `reach` (m) of it, or a number is not finite.
    pub(super) fn growth(&self, near: &Configuration, reach: f64) -> Option<Fastest> {
        let (shape, stiffness) = self.equilibrium(near)?;
        let pairs = shape.positions.iter().zip(&near.positions);
        let off = pairs.map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        if !(off <= reach) {
            return None;
        }
        self.fastest(&shape, stiffness)
    }

    /// Returns force and moment on every free node.
    fn forces(&self, rod: &Rod, at: &Configuration) -> Vec<Vector6<f64>> {
        let (x, r) = (&at.positions, &at.rotations);
        let node = TimeNode {
            time: self.time,
            before: 0.0,
            after: self.step,
        };
        let view = StateView {
            rod,
            time: self.time,
            positions: x,
            rotations: r,
        };
        let mut wrenches = applied(&node, &view, self.control, &energy_gradient(rod, x, r));
        let own = efforts::at_node(rod, &node, &self.control, x, r);
        efforts::add_at_node(rod, x, r, &own, &mut wrenches);
        let mut out: Vec<_> = (wrenches.iter().skip(rod.first_free_node()))
            .map(|own| {
                let (f, m) = (&own.force, &own.moment);
                Vector6::new(f.x, f.y, f.z, m.x, m.y, m.z)
            })
            .collect();
        rod.project_joints(&mut out);
        out
    }

    /// Returns minus the derivative of the forces along the free nodes.
    fn stiffness(&self, rod: &Rod, at: &Configuration) -> Tangent {
        let first = rod.first_free_node();
        let n = rod.n_nodes() - first;
        // Without actuators that couple nodes, columns of nodes that are three apart have no common row.
        let apart = if rod.actuators.follow_shape() || !self.control.acting.is_empty() {
            n
        } else {
            3.min(n)
        };
        let mut out = Tangent::zeros(n);
        for color in 0..apart {
            for component in 0..6 {
                let moved = |sign: f64| {
                    let mut shape = at.clone();
                    let mut change = vec![Vector6::zeros(); n];
                    for own in change.iter_mut().skip(color).step_by(apart) {
                        own[component] = sign * SHIFT;
                    }
                    rod.project_joints(&mut change);
                    for (free, own) in change.iter().enumerate().skip(color).step_by(apart) {
                        let node = first + free;
                        let length = rod.rest_chords[free.min(rod.n_elements() - 1)];
                        shape.positions[node] += own.fixed_rows::<3>(0) * length;
                        shape.rotations[node] *= exp(&own.fixed_rows::<3>(3).into_owned());
                    }
                    self.forces(rod, &shape)
                };
                let [near, far] = [1.0, 2.0].map(|step| [moved(step), moved(-step)]);
                for free in (color..n).step_by(apart) {
                    let length = match component {
                        0..3 => rod.rest_chords[free.min(rod.n_elements() - 1)],
                        _ => 1.0,
                    };
                    let rows = if apart == n {
                        0..n
                    } else {
                        free.saturating_sub(1)..(free + 2).min(n)
                    };
                    for row in rows {
                        let slope = differences::slope(
                            near.each_ref().map(|forces| forces[row]),
                            far.each_ref().map(|forces| forces[row]),
                            SHIFT * length,
                        );
                        let mut block = Matrix6::zeros();
                        block.set_column(component, &-slope);
                        out.add(row, free, &block);
                    }
                }
            }
        }
        out
    }

    /// Returns the equilibrium next to a configuration by Newton's method, and its stiffness.
    fn equilibrium(&self, near: &Configuration) -> Option<(Configuration, Tangent)> {
        // The forces of the elements are the same at a time node of explicit steps.
        let rod = &Rod {
            scheme: TimeScheme::Explicit,
            ..self.rod.clone()
        };
        let first = rod.first_free_node();
        let mut shape = near.clone();
        for _ in 0..NEWTON_STEPS {
            let stiffness = self.stiffness(rod, &shape);
            let forces = self.forces(rod, &shape);
            // What a joint holds has neither stiffness nor force.
            let mut regular = stiffness.clone();
            for joint in &rod.joints {
                let free = joint.node - first;
                let little = LITTLE * rod.scales.force / rod.scales.length;
                regular.add(free, free, &Matrix6::from_diagonal_element(little));
            }
            let step = regular.factor()?.solve(&[forces]).swap_remove(0);
            let largest = (step.iter())
                .map(|own| {
                    let shift = own.fixed_rows::<3>(0).norm() / rod.scales.length;
                    shift.max(own.fixed_rows::<3>(3).norm())
                })
                .fold(0.0, |most: f64, own| if own <= most { most } else { own });
            if !largest.is_finite() {
                return None;
            }
            let length = f64::min(1.0, LARGEST_CHANGE / largest);
            for (free, own) in step.iter().enumerate() {
                shape.positions[first + free] += own.fixed_rows::<3>(0) * length;
                shape.rotations[first + free] *= exp(&(own.fixed_rows::<3>(3) * length));
            }
            if largest < SETTLED {
                return Some((shape, stiffness));
            }
        }
        None
    }

    /// Returns the fastest growth of the motions about an equilibrium.
    fn fastest(&self, at: &Configuration, stiffness: Tangent) -> Option<Fastest> {
        let rod = self.rod;
        let first = rod.first_free_node();
        let time = rod.scales.time;
        let inertia = rotary(rod, &at.positions);
        let roots: Vec<Vector6<f64>> = (first..rod.n_nodes())
            .map(|q| {
                let (m, j) = (rod.nodes[q].mass, inertia[q]);
                Vector6::new(m, m, m, j.x, j.y, j.z).map(|own| own.sqrt().recip())
            })
            .collect();
        let viscous = rod.viscous_damping * time;
        let unscaled = stiffness;
        let stiffness = unscaled.scaled(&roots, time * time);
        if stiffness.asymmetry() <= ASYMMETRIC {
            let modes = unscaled.lowest_modes(rod, at, time.powi(-2), 1)?;
            let least = modes.first()?.squared_frequency * time * time;
            let half = 0.5 * viscous;
            let rate = match least < 0.0 {
                true => -least / (half + (half * half - least).sqrt()) / time,
                false => 0.0,
            };
            return counted(Complex::from(rate), time);
        }
        let internal = (rod.internal_damping > 0.0).then(|| {
            let factor = rod.internal_damping * time;
            strain_stiffness(rod, at).scaled(&roots, factor)
        });
        let motions = motions_of(&stiffness, viscous, internal)?;
        let fastest = (motions.into_iter()).max_by(|a, b| a.re.total_cmp(&b.re))?;
        counted(fastest / time, time)
    }
}

/// Returns the growth of a motion, none up to rounding; `time` is the arm's time scale, s.
fn counted(fastest: Complex<f64>, time: f64) -> Option<Fastest> {
    if !fastest.re.is_finite() {
        return None;
    }
    let grows = fastest.re > NO_GROWTH / time;
    Some(Fastest {
        rate: if grows { fastest.re } else { 0.0 },
        frequency: match grows {
            true => fastest.im.abs() / std::f64::consts::TAU,
            false => 0.0,
        },
    })
}

/// Returns `Σ l BᵀC B` over the elements.
fn strain_stiffness(rod: &Rod, at: &Configuration) -> Tangent {
    let first = rod.first_free_node();
    let mut out = Tangent::zeros(rod.n_nodes() - first);
    let strains = interval::strains(rod, &at.positions, &at.rotations);
    for (q, (element, (_, b))) in rod.elements.iter().zip(&strains).enumerate() {
        let own = interval::stiffness(element);
        let weighted = SMatrix::<f64, 9, 9>::from_diagonal(&own) * b;
        let matrix = b.tr_mul(&weighted);
        // Places of `(δx_b - δx_a, η_a, η_b)` in the components of both nodes.
        let place = |node: usize, i: usize| -> Vec<(usize, f64)> {
            match (node, i) {
                (0, 0..3) => vec![(i, -1.0)],
                (_, 0..3) => vec![(i, 1.0)],
                (0, _) => vec![(i, 1.0)],
                _ => vec![(i + 3, 1.0)],
            }
        };
        for row in 0..2 {
            for column in 0..2 {
                let (Some(i), Some(j)) = (
                    (q + row).checked_sub(first),
                    (q + column).checked_sub(first),
                ) else {
                    continue;
                };
                let block = Matrix6::from_fn(|a, b| {
                    let mut sum = 0.0;
                    for (k, left) in place(row, a) {
                        for (l, right) in place(column, b) {
                            sum += left * matrix[(k, l)] * right;
                        }
                    }
                    sum
                });
                out.add(i, j, &rod.project_block((q + row, q + column), block));
            }
        }
    }
    out
}

/// Fraction of the arm's length within which an equilibrium counts as the one next to a state, and largest speed of a node there, in
/// lengths per time scale of the arm: a motion that passes is not held.
const BESIDE: f64 = 0.05;
const AT_REST: f64 = 0.02;

/// Returns the reach of [`Held::growth`] around a state of an arm that is at rest, m; `None` for one that moves.
pub(super) fn reach_at_rest(rod: &Rod, momenta: &[Vector3<f64>]) -> Option<f64> {
    let speed = (momenta.iter().zip(&rod.nodes))
        .map(|(p, node)| p.norm() / node.mass)
        .fold(0.0, |most: f64, own| if own <= most { most } else { own });
    (speed < AT_REST * rod.scales.length / rod.scales.time).then_some(BESIDE * rod.scales.length)
}
