//! The growth of small disturbances over the horizon under a replay of the controls.
//!
//! Deviations of a state are measured by the square root of twice their energy: `Σ m |δv|² + δω·J δω` over the nodes and `Σ l ε·C ε` over
//! the elements, with `ε` the linear change of the strains. The transition from the start to the end is replayed column by column, for
//! deviations of unit energy; its largest singular value is the amplification. The base does not deviate; for a free arm, rigid motions
//! have no energy, and node 0 stays at its start.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::CheckError;
use super::interval::{self, nine};
use super::kkt::motion::rotary;
use super::probe::{Probe, roll_out};
use mechanics::rotation::{exp, log};
use mechanics::{BaseCondition, Rod, State};

/// Effects of small disturbances at the end of the horizon.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Growth {
    /// Largest ratio of the sizes of a deviation at the end and at the start.
    pub amplification: f64,
    /// Energy of a deviation of one percent at the start, J: 1e-4 of `½ EI/L`.
    #[serde(rename = "disturbance_J")]
    pub disturbance: f64,
    /// Largest displacement of the tip at the end by such a deviation, m.
    #[serde(rename = "tip_from_state_m")]
    pub tip_from_state: f64,
    /// Upper bound of the displacement of the tip by an error of one percent in every coefficient of the control, relative to the largest
    /// coefficient of its force or moment, m.
    #[serde(rename = "tip_from_control_m")]
    pub tip_from_control: f64,
    /// Length of the rod, m.
    #[serde(skip)]
    pub length: f64,
}

/// Displacement of the tip by a disturbance of 1 %, divided by the length, above which a replay needs feedback.
const POINTLESS: f64 = 0.1;

impl Growth {
    /// Describes the growth in a sentence.
    #[must_use]
    pub fn sentence(&self) -> String {
        let farthest = self.tip_from_state.max(self.tip_from_control);
        let replay = if farthest > POINTLESS * self.length {
            "these controls need feedback"
        } else {
            "they can be replayed as they are"
        };
        format!(
            "a disturbance of 1 % of the initial state ({:.2e} J) grows by a factor of {:.3} and moves the tip by up to {:.2e} m at \
             the target; an error of 1 % of the largest force and moment that are used, by up to {:.2e} m: {replay}",
            self.disturbance, self.amplification, self.tip_from_state, self.tip_from_control
        )
    }
}

/// One percent.
const PERCENT: f64 = 0.01;
/// Size of the replayed deviations, divided by `√(EI/L)`: truncation and rounding are below a thousandth of the result.
const SIZE: f64 = 1e-5;

/// Replays the disturbances. `tip` has the derivatives of the position at the end of the tip, or of the node that has the goal there, along
/// the scaled controls, m.
pub(super) fn examine(probe: &Probe, tip: &DMatrix<f64>) -> Result<Growth, CheckError> {
    let problem = probe.problem;
    let rod = &problem.rod;
    let mut start = problem.initial.clone();
    rod.start_base(problem.grid.start, &mut start);
    let columns = directions(rod);
    let unit = Size::at(rod, &start);
    let sizes: Vec<DVector<f64>> = (columns.iter())
        .map(|&(node, part)| unit.of(&Deviation::along(rod, node, part)))
        .collect();
    // Combinations of unit energy are the columns of R⁻¹.
    let stop = &problem.stop;
    let n = columns.len();
    let sizes = DMatrix::from_columns(&sizes);
    let combinations = stop.unless_raised(n, move || {
        let triangle = sizes.qr().r();
        triangle.solve_upper_triangular(&DMatrix::identity(n, n))
    })?;
    let Some(combinations) = combinations else {
        return Ok(Growth {
            amplification: f64::NAN,
            disturbance: f64::NAN,
            tip_from_state: f64::NAN,
            tip_from_control: f64::NAN,
            length: rod.scales.length,
        });
    };
    let coefficients = probe.coefficients(&probe.variables);
    let end = roll_out(problem, &start, &coefficients)?.end;
    let at_end = Size::at(rod, &end);
    let root = rod.scales.moment.sqrt();
    let amount = SIZE * root;
    let mut grown = Vec::with_capacity(n);
    let mut moved = DMatrix::zeros(3, n);
    for (i, combination) in combinations.column_iter().enumerate() {
        let mut deviation = Deviation::zero(rod);
        for (&(node, part), weight) in columns.iter().zip(combination.iter()) {
            deviation.parts[part][node / 3][node % 3] += weight * amount;
        }
        let other = roll_out(problem, &deviation.added_to(rod, &start), &coefficients)?.end;
        let deviation = Deviation::between(rod, &end, &other);
        grown.push(at_end.of(&deviation) / amount);
        moved.set_column(i, &(deviation.parts[0][problem.goal_node()] / amount));
    }
    let largest =
        |matrix: DMatrix<f64>| stop.unless_raised(n, move || matrix.singular_values().max());
    Ok(Growth {
        amplification: largest(DMatrix::from_columns(&grown))?,
        disturbance: 0.5 * PERCENT * PERCENT * rod.scales.moment,
        tip_from_state: largest(moved)? * PERCENT * root,
        tip_from_control: PERCENT * moved_by_controls(probe, tip),
        length: rod.scales.length,
    })
}

/// Returns the largest displacement of the tip if every coefficient of a channel is off by the largest of them, to first order, m.
fn moved_by_controls(probe: &Probe, tip: &DMatrix<f64>) -> f64 {
    let components = probe.problem.actuated_components();
    let width = components.len();
    let mut sum = 0.0;
    for channel in 0..probe.problem.channels.len() {
        let of_vector: Vec<usize> = (components.iter().enumerate())
            .filter(|(_, c)| c.channel == channel)
            .map(|(i, _)| i)
            .collect();
        let columns = |j: usize| of_vector.iter().map(move |i| j * width + i);
        let count = probe.variables.len() / width.max(1);
        let size = |j: usize| columns(j).map(|i| probe.variables[i].powi(2)).sum::<f64>();
        let largest = (0..count).map(size).fold(0.0, f64::max).sqrt();
        for j in 0..count {
            let slope = tip.select_columns(&columns(j).collect::<Vec<_>>());
            if !slope.is_empty() {
                sum += largest * slope.singular_values().max();
            }
        }
    }
    sum
}

/// Returns the directions of deviations: three times the node plus the axis, and the part of the state.
fn directions(rod: &Rod) -> Vec<(usize, usize)> {
    let first = rod.first_free_node();
    let mut out = Vec::new();
    for node in first..rod.n_nodes() {
        for part in 0..4 {
            if part < 2 && node == 0 && rod.base == BaseCondition::Free && rod.has_free_tip() {
                continue;
            }
            // Of a joint, a ball's angular velocity alone: without the poses of its node the arm has no motion without energy.
            if rod
                .joint(node)
                .is_some_and(|joint| part != 3 || joint.turning != Matrix3::identity())
            {
                continue;
            }
            out.extend((0..3).map(|axis| (3 * node + axis, part)));
        }
    }
    out
}

/// Deviation of a state: positions, body rotations, velocities, body angular velocities.
struct Deviation {
    parts: [Vec<Vector3<f64>>; 4],
}

impl Deviation {
    fn zero(rod: &Rod) -> Self {
        Self {
            parts: std::array::from_fn(|_| vec![Vector3::zeros(); rod.n_nodes()]),
        }
    }

    fn along(rod: &Rod, node: usize, part: usize) -> Self {
        let mut out = Self::zero(rod);
        out.parts[part][node / 3][node % 3] = 1.0;
        out
    }

    fn added_to(&self, rod: &Rod, state: &State) -> State {
        let mut out = state.clone();
        let inertia = rotary(rod, &state.configuration.positions);
        let [x, eta, v, omega] = &self.parts;
        for q in rod.first_free_node()..rod.n_nodes() {
            out.configuration.positions[q] += x[q];
            out.configuration.rotations[q] *= exp(&eta[q]);
            out.linear_momentum[q] += v[q] * rod.nodes[q].mass;
            out.angular_momentum[q] += omega[q].component_mul(&inertia[q]);
        }
        out
    }

    fn between(rod: &Rod, from: &State, to: &State) -> Self {
        let mut out = Self::zero(rod);
        let inertia = rotary(rod, &from.configuration.positions);
        let [x, eta, v, omega] = &mut out.parts;
        for q in rod.first_free_node()..rod.n_nodes() {
            x[q] = to.configuration.positions[q] - from.configuration.positions[q];
            eta[q] = log(&(from.configuration.rotations[q].tr_mul(&to.configuration.rotations[q])));
            v[q] = (to.linear_momentum[q] - from.linear_momentum[q]) / rod.nodes[q].mass;
            omega[q] =
                (to.angular_momentum[q] - from.angular_momentum[q]).component_div(&inertia[q]);
        }
        out
    }
}

/// Maps deviations to vectors whose squared norm is twice their energy.
struct Size<'a> {
    rod: &'a Rod,
    strains: Vec<interval::Strained>,
    inertia: Vec<Vector3<f64>>,
}

impl<'a> Size<'a> {
    fn at(rod: &'a Rod, state: &State) -> Self {
        let at = &state.configuration;
        Self {
            rod,
            strains: interval::strains(rod, &at.positions, &at.rotations),
            inertia: rotary(rod, &at.positions),
        }
    }

    fn of(&self, deviation: &Deviation) -> DVector<f64> {
        let [x, eta, v, omega] = &deviation.parts;
        let mut out = Vec::with_capacity(9 * self.strains.len() + 6 * x.len());
        for (q, (_, b)) in self.strains.iter().enumerate() {
            let stiffness = interval::stiffness(&self.rod.elements[q]).map(f64::sqrt);
            let strain = b * nine(&(x[q + 1] - x[q]), &eta[q], &eta[q + 1]);
            out.extend(stiffness.component_mul(&strain).iter());
        }
        for q in self.rod.first_free_node()..x.len() {
            out.extend((v[q] * self.rod.nodes[q].mass.sqrt()).iter());
            out.extend(
                omega[q]
                    .component_mul(&self.inertia[q].map(f64::sqrt))
                    .iter(),
            );
        }
        DVector::from_vec(out)
    }
}
