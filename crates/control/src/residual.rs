//! Residuals: the vectors of the states that the objective squares and that goals bring to zero.
//!
//! Solver and controller read one list of them. A residual `r` with the weight `w` costs `w/2 |r|²`; a goal that is a constraint has the
//! weight 1. Each gives the values `sqrt(w) r`, their first derivatives as linear forms of the motion, and `Σ y_i ∇²r_i` for the exact
//! Hessian. The check has formulas of its own (`verify/limits.rs`).

use nalgebra::{SVector, Vector3};

use super::path::{
    RodView, RowCurvature, RowGradient, along, durations, element_curvature, element_form,
    node_turn_curvature, term_curvature, turn_curvature,
};
use super::problem::{GoalPart, OptimalControlProblem};
use super::turns::rotation_error;
use mechanics::direction::Deviation;
use mechanics::element::{ElementPose, IntervalStress};
use mechanics::rotation::{log, log_tangent};
use mechanics::{FormTerm, Rod, StateForm, TimeGrid};

/// The quantity of a residual.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ResidualKind {
    /// Distance of a track's node from its path, `(x - x*)/L`; index of the track.
    TrackPosition(usize),
    /// Rotation vector of a track's node from its path, `log(R*ᵀ R)`; index of the track.
    TrackOrientation(usize),
    /// Deviation of the axis of a track's node from its direction; index of the track.
    TrackDirection(usize),
    /// Difference of the mean velocity of a track's node over an interval from that of its path, `(v - v*) T₀/L`; index of the track.
    TrackVelocity(usize),
    /// One value of a term of one's own.
    Term {
        /// Index of the term in the objective.
        index: usize,
        /// Index of the value within the term.
        item: usize,
    },
    /// Square roots of twice the elastic energy of an element divided by `EI/L`, component by component of its strain; index of the
    /// element.
    Energy(usize),
    /// A vector of a goal divided by its [scale](OptimalControlProblem::goal_scale).
    Goal {
        /// Index of the goal.
        goal: usize,
        /// The vector.
        part: GoalPart,
        /// Tells whether the orientation is approached from the start by more than half a turn; `None`: by the shorter way from the present
        /// rotation of the node.
        longer: Option<bool>,
    },
}

/// A residual at a time node, or of an interval between two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// The quantity.
    pub kind: ResidualKind,
    /// Time node; of an interval its end.
    pub time_node: usize,
    /// Time node at which the interval begins; `None` for a residual at one time node.
    pub before: Option<usize>,
    /// Weight `w` of `w/2 |r|²`.
    pub weight: f64,
}

/// The states on which residuals are evaluated: a motion, with the momenta in which it ends.
#[derive(Clone, Copy)]
pub struct States<'a> {
    /// Configurations at all time nodes.
    pub view: RodView<'a>,
    /// Linear (space) and angular momenta (body) of all nodes at the last time node. Derivatives do not need them.
    pub momenta: [&'a [Vector3<f64>]; 2],
}

/// Writes a value of a residual: its row and the value.
pub(crate) type WriteValue<'a> = dyn FnMut(usize, f64) + 'a;

/// Writes a term of a row's derivative: the row, the instant (0 the time node, 1 the beginning of an interval) and the term.
pub(crate) type WriteTerm<'a> = dyn FnMut(usize, usize, FormTerm) + 'a;

impl ResidualKind {
    /// Number of rows.
    pub fn n_rows(self, rod: &Rod) -> usize {
        match self {
            Self::Term { .. } => 1,
            Self::Energy(_) => 3 * rod.strain_rule.n_ends() + 3,
            Self::Goal { part, .. } => part.n_rows(),
            Self::TrackDirection(_) => 2,
            _ => 3,
        }
    }

    /// Tells whether the residual is a distance divided by the rod's length, or an angle.
    pub fn is_place(self) -> bool {
        match self {
            Self::TrackPosition(_) | Self::TrackOrientation(_) | Self::TrackDirection(_) => true,
            Self::Goal { part, .. } => matches!(
                part,
                GoalPart::Position | GoalPart::Orientation | GoalPart::Direction
            ),
            _ => false,
        }
    }
}

impl Residual {
    /// Number of instants whose states the residual depends on.
    pub fn n_instants(&self) -> usize {
        1 + usize::from(self.before.is_some())
    }

    /// Tells whether the residual counts on a time grid: those of a track count from the track's own time on.
    pub fn counts(&self, problem: &OptimalControlProblem, grid: &TimeGrid) -> bool {
        match self.kind {
            ResidualKind::TrackPosition(index)
            | ResidualKind::TrackOrientation(index)
            | ResidualKind::TrackDirection(index)
            | ResidualKind::TrackVelocity(index) => {
                let first = self.before.unwrap_or(self.time_node);
                problem.objective.tracking[index].counts(grid.time(first))
            }
            _ => true,
        }
    }

    /// Writes the values `sqrt(w) r`.
    pub fn values(&self, problem: &OptimalControlProblem, states: &States, write: &mut WriteValue) {
        let view = &states.view;
        let (k, root) = (self.time_node, self.weight.sqrt());
        let t = view.grid.time(k);
        let mut vector = |factor: f64, off: Vector3<f64>| {
            for axis in 0..3 {
                write(axis, factor * off[axis]);
            }
        };
        match self.kind {
            ResidualKind::TrackPosition(index) => {
                let track = &problem.objective.tracking[index];
                let x = view.trajectory.positions_at(k)[track.node];
                let off = track.position(t).map_or_else(Vector3::zeros, |to| x - to);
                vector(root / problem.rod.scales.length, off);
            }
            ResidualKind::TrackOrientation(index) => {
                vector(root, track_turn(problem, view, index, k));
            }
            ResidualKind::TrackDirection(index) => {
                let off = track_deviation(problem, view, index, k).map(|own| own.value());
                (off.unwrap_or_default().iter().enumerate())
                    .for_each(|(row, off)| write(row, root * off));
            }
            ResidualKind::TrackVelocity(index) => {
                let track = &problem.objective.tracking[index];
                let Some(interval) = Interval::of(self, problem, view) else {
                    return;
                };
                let [a, b] =
                    [interval.from, k].map(|k| view.trajectory.positions_at(k)[track.node]);
                let off = (b - a) / interval.duration - track.velocity(interval.times);
                vector(interval.factor, off);
            }
            ResidualKind::Term { index, item } => {
                let term = &problem.objective.terms[index].term;
                write(0, root * term.value(&view.view(k), item));
            }
            ResidualKind::Energy(q) => {
                let rod = &problem.rod;
                let element = &rod.elements[q];
                let strain = (rod.strain_rule).strain(element.length, &pose(view, k, q));
                let factors = energy_factors(rod, q, self.weight);
                let ends = rod.strain_rule.n_ends();
                for end in 0..ends {
                    let linear = strain.linear[end] - element.rest.linear[end];
                    for axis in 0..3 {
                        write(3 * end + axis, factors[0][axis] * linear[axis]);
                    }
                }
                let angular = strain.curvature - element.rest.curvature;
                for axis in 0..3 {
                    write(3 * ends + axis, factors[1][axis] * angular[axis]);
                }
            }
            ResidualKind::Goal { goal, part, longer } => {
                let off = goal_vector(problem, states, [goal, k], part, longer);
                let scale = problem.goal_scale(part);
                for axis in 0..part.n_rows() {
                    write(axis, root * (off[axis] / scale));
                }
            }
        }
    }

    /// Writes the derivatives of the values, term by term.
    pub fn slopes(&self, problem: &OptimalControlProblem, states: &States, write: &mut WriteTerm) {
        let view = &states.view;
        let (rod, root) = (&problem.rod, self.weight.sqrt());
        let k = self.time_node;
        let one = |node: usize, component: usize, coefficient: f64| FormTerm {
            node,
            component,
            coefficient,
        };
        match self.kind {
            ResidualKind::TrackPosition(index) => {
                let node = problem.objective.tracking[index].node;
                for axis in 0..3 {
                    write(axis, 0, one(node, axis, root / rod.scales.length));
                }
            }
            ResidualKind::TrackOrientation(index) => {
                let node = problem.objective.tracking[index].node;
                write_turn(node, &track_turn(problem, view, index, k), root, write);
            }
            ResidualKind::TrackDirection(index) => {
                let node = problem.objective.tracking[index].node;
                if let Some(own) = track_deviation(problem, view, index, k) {
                    write_deviation(node, &own, root, write);
                }
            }
            ResidualKind::TrackVelocity(index) => {
                let node = problem.objective.tracking[index].node;
                let Some(interval) = Interval::of(self, problem, view) else {
                    return;
                };
                let slope = interval.factor / interval.duration;
                for axis in 0..3 {
                    write(axis, 1, one(node, axis, -slope));
                    write(axis, 0, one(node, axis, slope));
                }
            }
            ResidualKind::Term { index, item } => {
                let form = (problem.objective.terms[index].term).gradient(&view.view(k), item);
                for mut term in form.terms {
                    term.coefficient *= root;
                    write(0, 0, term);
                }
            }
            ResidualKind::Energy(q) => {
                let length = rod.elements[q].length;
                let (_, slope) = rod.strain_rule.strain_derivative(length, &pose(view, k, q));
                let factors = energy_factors(rod, q, self.weight);
                let mut add = |row: usize, component: usize, factor: f64| {
                    let w: SVector<f64, 9> = slope.row(component).transpose() * factor;
                    for term in element_form(q, &w) {
                        write(row, 0, term);
                    }
                };
                let ends = rod.strain_rule.n_ends();
                for (row, component) in (0..3 * ends).enumerate() {
                    add(row, component, factors[0][component % 3]);
                }
                for axis in 0..3 {
                    add(3 * ends + axis, 6 + axis, factors[1][axis]);
                }
            }
            ResidualKind::Goal { goal, part, longer } => {
                let node = problem.goals[goal].node;
                let inertia = &rod.nodes[node];
                let inverse = root * (1.0 / problem.goal_scale(part));
                match part {
                    GoalPart::Position => {
                        (0..3).for_each(|axis| write(axis, 0, one(node, axis, inverse)));
                    }
                    GoalPart::Orientation => {
                        let psi = goal_vector(problem, states, [goal, k], part, longer);
                        write_turn(node, &psi, inverse, write);
                    }
                    GoalPart::Direction => {
                        let Some(to) = &problem.goals[goal].direction else {
                            return;
                        };
                        let own = Deviation::of(to, &view.trajectory.rotations_at(k)[node]);
                        write_deviation(node, &own, inverse, write);
                    }
                    GoalPart::Velocity => {
                        for axis in 0..3 {
                            write(axis, 0, one(node, 6 + axis, inverse / inertia.mass));
                        }
                    }
                    GoalPart::AngularVelocity => {
                        for axis in 0..3 {
                            write(axis, 0, one(node, 9 + axis, inverse / inertia.rotary[axis]));
                        }
                    }
                    GoalPart::Deviation(vector) => {
                        let Some(stay) = &problem.stay else { return };
                        let r = view.trajectory.rotations_at(k);
                        for axis in 0..3 {
                            for mut term in stay.gradient(vector, axis, r) {
                                term.coefficient *= inverse;
                                write(axis, 0, term);
                            }
                        }
                    }
                }
            }
        }
    }

    /// The rows' derivatives, each a sum of forms at one or two time nodes.
    pub fn gradients(&self, problem: &OptimalControlProblem, states: &States) -> Vec<RowGradient> {
        let instants: Vec<usize> = self.before.into_iter().chain([self.time_node]).collect();
        let empty = |time_node: &usize| StateForm {
            time_node: *time_node,
            terms: Vec::new(),
        };
        let mut rows: Vec<RowGradient> = (0..self.kind.n_rows(&problem.rod))
            .map(|_| instants.iter().map(empty).collect())
            .collect();
        let last = instants.len() - 1;
        self.slopes(problem, states, &mut |row, instant, term| {
            rows[row][last - instant].terms.push(term);
        });
        rows
    }

    /// Returns `Σ y_i ∇²r_i` with the values `y_i = sqrt(w) r_i` of a cost, weights multiplied in; `None` if the residual is linear in the
    /// states.
    pub fn curvature(
        &self,
        problem: &OptimalControlProblem,
        view: &RodView,
    ) -> Option<RowCurvature> {
        let k = self.time_node;
        match self.kind {
            ResidualKind::TrackOrientation(index) => {
                let psi = track_turn(problem, view, index, k);
                let node = problem.objective.tracking[index].node;
                Some(turn_curvature(k, node, &psi, &(psi * self.weight)))
            }
            ResidualKind::TrackDirection(index) => {
                let own = track_deviation(problem, view, index, k)?;
                let node = problem.objective.tracking[index].node;
                let y = own.value().map(|off| off * self.weight);
                Some(node_turn_curvature(k, node, &own.curvature(y)))
            }
            ResidualKind::Term { index, item } => {
                let term = &problem.objective.terms[index].term;
                let factor = self.weight * term.value(&view.view(k), item);
                Some(term_curvature(term, view, k, item, factor))
            }
            ResidualKind::Energy(q) => {
                let rod = &problem.rod;
                let element = &rod.elements[q];
                let pose = pose(view, k, q);
                let strain = rod.strain_rule.strain(element.length, &pose);
                let ends = [&strain, &strain];
                let stress: IntervalStress = element.interval_stress(ends, [self.weight, 0.0]);
                let own = element.stiffness_under(rod.strain_rule, &pose, &stress, 0.0);
                Some(element_curvature(k, q, &own))
            }
            ResidualKind::TrackPosition(_)
            | ResidualKind::TrackVelocity(_)
            | ResidualKind::Goal { .. } => None,
        }
    }
}

/// The mean of a velocity over an interval, as a residual.
struct Interval {
    /// Time node at which it begins.
    from: usize,
    /// Both ends, s.
    times: [f64; 2],
    /// s
    duration: f64,
    /// `sqrt(w Δt) T₀/L` with the weight `w` per second.
    factor: f64,
}

impl Interval {
    fn of(residual: &Residual, problem: &OptimalControlProblem, view: &RodView) -> Option<Self> {
        let from = residual.before?;
        let times = [from, residual.time_node].map(|k| view.grid.time(k));
        let scales = &problem.rod.scales;
        Some(Self {
            from,
            times,
            duration: times[1] - times[0],
            factor: residual.weight.sqrt() * (scales.time / scales.length),
        })
    }
}

/// `log(R*ᵀ R)` of a track's node at time node `k`; zero where its orientation is free.
fn track_turn(
    problem: &OptimalControlProblem,
    view: &RodView,
    index: usize,
    k: usize,
) -> Vector3<f64> {
    let track = &problem.objective.tracking[index];
    let r = &view.trajectory.rotations_at(k)[track.node];
    track.turn(view.grid.time(k), r).unwrap_or_default()
}

/// The deviation of the axis of a track's node at time node `k`; `None` where its direction is free.
fn track_deviation(
    problem: &OptimalControlProblem,
    view: &RodView,
    index: usize,
    k: usize,
) -> Option<Deviation> {
    let track = &problem.objective.tracking[index];
    let to = track.direction(view.grid.time(k))?;
    let r = &view.trajectory.rotations_at(k)[track.node];
    Some(Deviation::of(&to, r))
}

/// A goal's vector before scaling at time node `k`; the last component of a part with two is zero.
fn goal_vector(
    problem: &OptimalControlProblem,
    states: &States,
    [goal, k]: [usize; 2],
    part: GoalPart,
    longer: Option<bool>,
) -> Vector3<f64> {
    let goal = &problem.goals[goal];
    let inertia = &problem.rod.nodes[goal.node];
    let trajectory = states.view.trajectory;
    let x = trajectory.positions_at(k)[goal.node];
    let [linear, angular] = states.momenta;
    match part {
        GoalPart::Position => x - goal.position.unwrap_or(x),
        GoalPart::Orientation => (goal.rotation.as_ref()).map_or_else(Vector3::zeros, |to| {
            longer.map_or_else(
                || log(&(to.transpose() * trajectory.rotations_at(k)[goal.node])),
                |longer| rotation_error(goal.node, to, (trajectory, k), longer),
            )
        }),
        GoalPart::Direction => goal.direction.map_or_else(Vector3::zeros, |to| {
            let [a, b] = Deviation::of(&to, &trajectory.rotations_at(k)[goal.node]).value();
            Vector3::new(a, b, 0.0)
        }),
        GoalPart::Velocity => linear[goal.node] / inertia.mass - goal.velocity.unwrap_or_default(),
        GoalPart::AngularVelocity => angular[goal.node].component_div(&inertia.rotary),
        GoalPart::Deviation(vector) => problem.stay.as_ref().map_or_else(Vector3::zeros, |stay| {
            let vectors = [trajectory.positions_at(k), linear, angular];
            stay.vector(vector, vectors, trajectory.rotations_at(k))
        }),
    }
}

/// Writes the derivative of `factor ψ`, `ψ = log(R*ᵀ R)` of a node: `δψ = Sᵀ ζ`, whose row i is column i of `S`.
fn write_turn(node: usize, psi: &Vector3<f64>, factor: f64, write: &mut WriteTerm) {
    let slope = log_tangent(psi);
    for axis in 0..3 {
        for term in along(node, 3, &(slope.column(axis) * factor)) {
            write(axis, 0, term);
        }
    }
}

/// Writes the derivative of `factor ρ` of a node.
fn write_deviation(node: usize, own: &Deviation, factor: f64, write: &mut WriteTerm) {
    for (row, gradient) in own.gradients().iter().enumerate() {
        for term in along(node, 3, &(gradient * factor)) {
            write(row, 0, term);
        }
    }
}

fn pose<'a>(view: &RodView<'a>, k: usize, q: usize) -> ElementPose<'a> {
    let (x, r) = (
        view.trajectory.positions_at(k),
        view.trajectory.rotations_at(k),
    );
    Rod::element_pose(q, x, r)
}

/// Returns the square roots of the costs of a unit of an element's linear strains and of its curvature, with the weight of its energy in
/// 1/J.
fn energy_factors(rod: &Rod, q: usize, weight: f64) -> [Vector3<f64>; 2] {
    let element = &rod.elements[q];
    let weight = weight * element.length;
    let of = |stiffness: &Vector3<f64>, weight: f64| stiffness.map(|k| (weight * k).sqrt());
    let ends = rod.strain_rule.n_ends();
    [
        of(&element.linear_stiffness, weight / ends as f64),
        of(&element.angular_stiffness, weight),
    ]
}

/// Time nodes at which costs over states are sampled, and the time that each stands for, s: the trapezoidal rule over a
/// subset of the time nodes as even as possible, both ends included.
#[must_use]
pub fn sample_times(problem: &OptimalControlProblem) -> Vec<(usize, f64)> {
    let objective = &problem.objective;
    if !objective.sees_states() {
        return Vec::new();
    }
    let n = problem.grid.n_steps;
    let intervals = objective.samples.clamp(1, n);
    let node = |i: usize| (2 * i * n + intervals) / (2 * intervals);
    let nodes: Vec<usize> = (0..=intervals).map(node).collect();
    durations(&nodes, problem.grid.step)
}

/// Returns the residuals of the costs over states: those of every sample, then those of the intervals between consecutive samples.
///
/// A track's residuals are listed even if the track does not count at the sample yet: see [`Residual::counts`].
pub fn cost_residuals(problem: &OptimalControlProblem) -> Vec<Residual> {
    let (rod, objective) = (&problem.rod, &problem.objective);
    let samples = sample_times(problem);
    let mut out = Vec::new();
    for &(time_node, duration) in &samples {
        let mut add = |kind: ResidualKind, weight: f64| {
            out.push(Residual {
                kind,
                time_node,
                before: None,
                weight,
            });
        };
        for (index, track) in objective.tracking.iter().enumerate() {
            if !track.path.is_empty() {
                add(ResidualKind::TrackPosition(index), track.weight * duration);
            }
            if !track.rotations.is_empty() {
                let weight = track.rotation_weight * duration;
                add(ResidualKind::TrackOrientation(index), weight);
            }
            if !track.directions.is_empty() {
                let weight = track.rotation_weight * duration;
                add(ResidualKind::TrackDirection(index), weight);
            }
        }
        for (index, cost) in objective.terms.iter().enumerate() {
            for item in 0..cost.term.n_values(rod) {
                add(ResidualKind::Term { index, item }, cost.weight * duration);
            }
        }
        if objective.energy > 0.0 {
            let weight = objective.energy * duration / rod.scales.moment;
            (0..rod.n_elements()).for_each(|q| add(ResidualKind::Energy(q), weight));
        }
    }
    for ends in samples.windows(2) {
        let [from, to] = [ends[0].0, ends[1].0];
        let between = problem.grid.time(to) - problem.grid.time(from);
        for (index, track) in objective.tracking.iter().enumerate() {
            if track.speed_weight > 0.0 {
                out.push(Residual {
                    kind: ResidualKind::TrackVelocity(index),
                    time_node: to,
                    before: Some(from),
                    weight: track.speed_weight * between,
                });
            }
        }
    }
    out
}

/// Returns the residuals of the goals with the weight 1, in the order of [`OptimalControlProblem::goal_rows`]. `longer` has for every goal whether its orientation is approached from the start by more than half a turn; `None`: all by the shorter way.
pub fn goal_residuals(problem: &OptimalControlProblem, longer: Option<&[bool]>) -> Vec<Residual> {
    (problem.goal_rows())
        .chunk_by(|row, next| (row.goal, row.part) == (next.goal, next.part))
        .map(|rows| Residual {
            kind: ResidualKind::Goal {
                goal: rows[0].goal,
                part: rows[0].part,
                longer: longer.map(|longer| longer[rows[0].goal]),
            },
            time_node: problem.goals[rows[0].goal].time_node,
            before: None,
            weight: 1.0,
        })
        .collect()
}

/// Returns the second derivative of `Σ multiplier · residual` over the goals: only those of rotations and directions have one.
pub(crate) fn goal_curvature(
    problem: &OptimalControlProblem,
    residuals: &[Residual],
    states: &States,
    multipliers: &[f64],
) -> Vec<RowCurvature> {
    let (mut out, mut along_stay, mut first) = (Vec::new(), Vec::new(), 0);
    for residual in residuals {
        let ResidualKind::Goal { goal, part, longer } = residual.kind else {
            continue;
        };
        let k = residual.time_node;
        let own = &multipliers[first..first + part.n_rows()];
        first += own.len();
        match part {
            GoalPart::Orientation => {
                let psi = goal_vector(problem, states, [goal, k], part, longer);
                let y = Vector3::from_column_slice(own);
                out.push(turn_curvature(k, problem.goals[goal].node, &psi, &y));
            }
            GoalPart::Direction => {
                let goal = &problem.goals[goal];
                let r = &states.view.trajectory.rotations_at(k)[goal.node];
                out.extend(goal.direction.map(|to| {
                    let matrix = Deviation::of(&to, r).curvature([own[0], own[1]]);
                    node_turn_curvature(k, goal.node, &matrix)
                }));
            }
            GoalPart::Deviation(_) => {
                along_stay.push(Vector3::from_column_slice(own) / problem.goal_scale(part));
            }
            _ => {}
        }
    }
    if let Some(stay) = &problem.stay {
        let k = problem.goals[stay.goal].time_node;
        let r = states.view.trajectory.rotations_at(k);
        out.extend(stay.free_nodes().map(|node| {
            let turned = stay.on_turn(node, &along_stay);
            turn_curvature(k, node, &stay.turn(node, &r[node]), &turned)
        }));
    }
    out
}
