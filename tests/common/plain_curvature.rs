//! The second derivative of the Lagrangian along directions of any kind, term by term: an oracle of its reduction to the controls.

use faer::Mat;
use nalgebra::{SVector, Vector3};
use softarm::mechanics::curvature::{
    InertiaCurvature, MotionMultipliers, NodeCurvature, OwnCurvature, StressCurvature,
    element_curvature, inertia_curvature, load_curvatures, stress_curvature,
};
use softarm::mechanics::element::ElementStiffness;
use softarm::mechanics::implicit::IntervalWeights;
use softarm::mechanics::linearization::Motion;
use softarm::mechanics::{Rod, TimeScheme, Trajectory, TrajectoryTangent};

/// The terms of the second derivative that belong to a time node and to the interval that follows it.
struct StepCurvature {
    elements: Vec<ElementStiffness>,
    loads: Vec<NodeCurvature>,
    inertia: Vec<InertiaCurvature>,
    stress: Vec<StressCurvature>,
}

/// Multipliers of linear and angular rows.
type Pair = (Vector3<f64>, Vector3<f64>);

/// What the multipliers of the ends of an element, times `weight`, say about `(F, M_a, M_b)`: the element pulls a with `+F` and b with
/// `-F`, and turns them with `-M`.
fn pulled([a, b]: [Pair; 2], weight: f64) -> SVector<f64, 9> {
    stack(&(a.0 - b.0), &-a.1, &-b.1) * weight
}

impl StepCurvature {
    fn at(
        motion: &Motion,
        trajectory: &Trajectory,
        multipliers: &MotionMultipliers,
        k: usize,
    ) -> Self {
        let rod = motion.rod;
        let n = rod.n_nodes();
        let kick = motion.kick(k);
        let adjoint = multipliers.adjoint;
        let leaving = |q: usize| (adjoint.linear[k * n + q], adjoint.angular[k * n + q]);
        let arriving = |q: usize| {
            let row = (k + 1) * n + q;
            (adjoint.arriving_linear[row], adjoint.arriving_angular[row])
        };
        let pose = |k: usize, q: usize| {
            Rod::element_pose(q, trajectory.positions_at(k), trajectory.rotations_at(k))
        };
        let explicit = rod.scheme == TimeScheme::Explicit;
        let elements = (rod.elements.iter().enumerate().filter(|_| explicit))
            .map(|(q, element)| {
                let pose = pose(k, q);
                let (_, stiffness) = element.stiffness(rod.strain_rule, &pose);
                let covector = pulled([q, q + 1].map(leaving), kick.weight);
                element_curvature(element, rod.strain_rule, &pose, &stiffness, &covector)
            })
            .collect();
        let (mut inertia, mut stress) = (Vec::new(), Vec::new());
        if k < motion.grid.n_steps {
            let (before, after) = (trajectory.rotations_at(k), trajectory.rotations_at(k + 1));
            inertia.extend((0..n).map(|q| {
                let rotary = &rod.nodes[q].rotary;
                let turn = before[q].tr_mul(&after[q]);
                let h = motion.grid.step;
                inertia_curvature([rotary; 2], h, &turn, &leaving(q).1, &arriving(q).1)
            }));
            let half_step = 0.5 * motion.grid.step;
            let undamped = 1.0 - rod.viscous_damping * half_step;
            if let Some(weights) = IntervalWeights::of(rod, motion.grid.step) {
                stress.extend(rod.elements.iter().enumerate().map(|(q, element)| {
                    let start = pulled([q, q + 1].map(leaving), half_step * kick.impulse);
                    let end = pulled([q, q + 1].map(arriving), half_step / undamped);
                    let ends = [(pose(k, q), start), (pose(k + 1, q), end)];
                    stress_curvature(element, rod.strain_rule, weights, &ends)
                }));
            }
        }
        Self {
            elements,
            loads: load_curvatures(motion, trajectory, multipliers, k),
            inertia,
            stress,
        }
    }

    /// The bilinear form on two directions, each given by its parts at `k` and at `k + 1`.
    fn form(&self, a: &Slice, b: &Slice) -> f64 {
        let mut sum = 0.0;
        for (q, element) in self.elements.iter().enumerate() {
            sum += a.element(q).dot(&(element * b.element(q)));
        }
        for load in &self.loads {
            sum += a.rotations[load.node].dot(&(load.rotation * b.rotations[load.node]));
        }
        for (q, inertia) in self.inertia.iter().enumerate() {
            sum += a.interval(q).dot(&(inertia * b.interval(q)));
        }
        for (q, stress) in self.stress.iter().enumerate() {
            let ([here, there], [other, beyond]) = (a.both(q), b.both(q));
            sum += here.dot(&(stress.start * other + stress.cross * beyond))
                + there.dot(&(stress.cross.tr_mul(&other) + stress.end * beyond));
        }
        sum
    }
}

/// Second derivative of the Lagrangian of the standard model, with the [own](OwnCurvature) one of the functional as far as it is given, along
/// every pair of `directions`: symmetric, in their order; the unit is that of the functional per unit of both directions.
pub fn lagrangian_curvature(
    motion: &Motion,
    trajectory: &Trajectory,
    multipliers: &MotionMultipliers,
    directions: &[TrajectoryTangent],
) -> Mat<f64> {
    let n = motion.rod.n_nodes();
    let mut curvature = Mat::zeros(directions.len(), directions.len());
    for k in 0..=motion.grid.n_steps {
        let step = StepCurvature::at(motion, trajectory, multipliers, k);
        let slices: Vec<Slice> = (directions.iter())
            .map(|direction| Slice {
                positions: &direction.positions[k * n..][..n],
                rotations: &direction.rotations[k * n..][..n],
                next_positions: direction.positions.get((k + 1) * n..).unwrap_or_default(),
                next: direction.rotations.get((k + 1) * n..).unwrap_or_default(),
            })
            .collect();
        for (j, b) in slices.iter().enumerate() {
            for (i, a) in slices[..=j].iter().enumerate() {
                curvature[(i, j)] += step.form(a, b);
                for own in multipliers.own.iter().filter(|own| own.time_node == k) {
                    curvature[(i, j)] += own_form(own, a, b);
                }
            }
        }
    }
    for j in 0..directions.len() {
        for i in 0..j {
            curvature[(j, i)] = curvature[(i, j)];
        }
    }
    curvature
}

/// One time node of a direction, and the next.
struct Slice<'a> {
    positions: &'a [Vector3<f64>],
    rotations: &'a [Vector3<f64>],
    next_positions: &'a [Vector3<f64>],
    next: &'a [Vector3<f64>],
}

fn own_form(own: &OwnCurvature, a: &Slice, b: &Slice) -> f64 {
    let mut sum = 0.0;
    for (i, &row) in own.rows.iter().enumerate() {
        for (j, &column) in own.rows.iter().enumerate() {
            sum += own.matrix[(i, j)] * a.component(row) * b.component(column);
        }
    }
    sum
}

impl Slice<'_> {
    fn component(&self, (node, component): (usize, usize)) -> f64 {
        [self.positions, self.rotations][component / 3][node][component % 3]
    }

    fn element(&self, q: usize) -> SVector<f64, 9> {
        stack(
            &(self.positions[q + 1] - self.positions[q]),
            &self.rotations[q],
            &self.rotations[q + 1],
        )
    }

    /// Element `q` at both time nodes.
    fn both(&self, q: usize) -> [SVector<f64, 9>; 2] {
        let there = stack(
            &(self.next_positions[q + 1] - self.next_positions[q]),
            &self.next[q],
            &self.next[q + 1],
        );
        [self.element(q), there]
    }

    fn interval(&self, q: usize) -> SVector<f64, 6> {
        let mut both = SVector::<f64, 6>::zeros();
        both.fixed_rows_mut::<3>(0).copy_from(&self.rotations[q]);
        both.fixed_rows_mut::<3>(3).copy_from(&self.next[q]);
        both
    }
}

fn stack(a: &Vector3<f64>, b: &Vector3<f64>, c: &Vector3<f64>) -> SVector<f64, 9> {
    let mut out = SVector::<f64, 9>::zeros();
    out.fixed_rows_mut::<3>(0).copy_from(a);
    out.fixed_rows_mut::<3>(3).copy_from(b);
    out.fixed_rows_mut::<3>(6).copy_from(c);
    out
}
