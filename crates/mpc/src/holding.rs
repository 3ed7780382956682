//! The controls that keep the tip, or another node that follows a reference, there, from which effort is measured, and the wrench on that
//! node that would.
//!
//! An effort that is measured from zero leaves a permanent offset from the target, whose size depends on the target's weight. Measured from
//! the control that holds the arm there at rest, it weighs the transient only and leaves no offset (Rawlings, Mayne and Diehl 2017, section
//! 1.5).
//!
//! The controls of least size within their bounds that put the node there at rest are computed (`crates/control/src/holding/along.rs`). The
//! PID law and the need of a reference know a wrench on the node, and along a moving reference a force that accelerates the mass of the arm
//! in it. With `ξ` the pose of the tip and `J` the derivatives of all positions by it, over shapes that are held at rest, the arm is
//! reduced to its tip (static condensation; Guyan 1965), and
//!
//! ```text
//! W = W_static(ξ) + M (ξ̈ + α ξ̇),     M = Σ m Jᵀ J
//! ```
//!
//! with the viscous damping `α`. The inertia of the rotations of elements is negligible.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use super::beam::CLAMPED_STIFFNESS;
use control::{ControlsAlong, HeldModes, HeldTarget, OptimalControlProblem, TIP_STIFFNESS};
use mechanics::beam::Beam;
use mechanics::equilibrium::{NodeSpring, nearby_equilibrium_until};
use mechanics::rotation::{exp, log};
use mechanics::{Configuration, Rod, Wrench};
use stop::StopSignal;

/// Reference position of a node (m), its reference rotation (body to space), and the reference direction of its axis, each `None` if nothing
/// prescribes it. Wrenches on the node hold positions and rotations; controls of all kinds hold directions too.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ReferencePose {
    /// Position, m.
    pub position: Option<Vector3<f64>>,
    /// Rotation, body to space.
    pub rotation: Option<Matrix3<f64>>,
    /// Direction of the axis, of length 1.
    pub direction: Option<Vector3<f64>>,
}

impl ReferencePose {
    /// Returns the displacement to another pose divided by the length, and the turn to it in the body frame, rad; zero for what one of the
    /// two poses leaves open.
    fn way_to(&self, other: &Self, length: f64) -> Vector6<f64> {
        let way = (self.position.zip(other.position))
            .map_or_else(Vector3::zeros, |(from, to)| (to - from) / length);
        let turn = (self.rotation.zip(other.rotation))
            .map_or_else(Vector3::zeros, |(from, to)| log(&(from.transpose() * to)));
        six(way, turn)
    }
}

/// Returns two vectors, one after the other.
pub(super) fn six(a: Vector3<f64>, b: Vector3<f64>) -> Vector6<f64> {
    Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z)
}

/// The wrench on the node that follows, spatial force (N) and moment in the body frame (N m), that keeps a model at the poses of a
/// reference.
#[derive(Clone, Debug)]
pub struct HoldingWrenches {
    /// Wrenches at multiples of `spacing` from time 0 on.
    wrenches: Vec<Vector6<f64>>,
    /// Shape at time 0.
    pub shape: Configuration,
    spacing: f64,
}

/// The times along a reference at which controls hold the node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Along {
    /// All times.
    All,
    /// Times at which the reference rests and the arm is stable there; nothing is held at other times.
    Rests,
}

/// The scaled controls that hold a model at the poses of a reference, from which effort is measured.
#[derive(Clone, Debug)]
pub(super) struct HeldControls {
    /// Controls at multiples of `spacing` from time 0 on: those of the model, their derivative by the factor on the model's stiffness, and
    /// those by each component of a wrench on the tip, control by control. Without meaning where nothing is held.
    controls: Vec<f64>,
    /// Tells for each of these times whether the controls hold the node.
    is_held: Vec<bool>,
    n: usize,
    spacing: f64,
    /// The equilibrium at the end of the reference; `None` if nothing is held there.
    last: Option<ControlsAlong>,
}

impl HeldControls {
    /// Numbers that are kept of a control: itself, and its derivatives.
    const KEPT: usize = 8;

    /// Returns the controls along `reference`, from `held` on, a pose of a node at every time up to an end; the two times are their spacing and that end, s. At times at
    /// which none is found nothing is held. `None` if the reference is longer than [`LONGEST`], and if `stop` is raised.
    pub fn along(
        (problem, node): (&OptimalControlProblem, usize),
        mut held: ControlsAlong,
        reference: impl Fn(f64) -> ReferencePose,
        [spacing, end]: [f64; 2],
        along: Along,
        stop: &StopSignal,
    ) -> Option<Self> {
        if !(end <= LONGEST) {
            return None;
        }
        let n = problem.actuated_components().len();
        let mut out = Self {
            controls: Vec::new(),
            is_held: Vec::new(),
            n,
            spacing,
            last: None,
        };
        let mut before: Option<(ReferencePose, Option<Vec<f64>>)> = None;
        for i in 0..=(end / spacing).ceil() as usize {
            stop.check().ok()?;
            let t = i as f64 * spacing;
            let target = reference(t);
            let rests = reference(t + spacing) == target;
            let numbers = match before.take().filter(|(pose, _)| *pose == target) {
                Some((_, numbers)) => numbers,
                None if along == Along::Rests && !rests => None,
                None => {
                    let aim = HeldTarget {
                        node,
                        position: target.position,
                        rotation: target.rotation,
                        direction: target.direction,
                    };
                    let found = held.hold(problem, aim, t, rests);
                    let kept = found.filter(|found| along == Along::All || found.is_stable);
                    kept.map(|own| {
                        (0..n)
                            .flat_map(|c| {
                                [own.controls[c], own.stiffening[c]]
                                    .into_iter()
                                    .chain(own.bearing[c])
                            })
                            .collect()
                    })
                }
            };
            out.is_held.push(numbers.is_some());
            match &numbers {
                Some(numbers) => out.controls.extend_from_slice(numbers),
                None => (out.controls).resize(out.controls.len() + Self::KEPT * n, 0.0),
            }
            before = (rests || along == Along::All).then_some((target, numbers));
        }
        out.last = (out.is_held.last() == Some(&true)).then_some(held);
        Some(out)
    }

    /// Returns the slow modes about the equilibrium at the end of the reference, at time `t` (s), for the node that is held there.
    pub fn modes(&self, problem: &OptimalControlProblem, node: usize, t: f64) -> Option<HeldModes> {
        self.last.as_ref()?.modes(problem, node, t)
    }

    /// Writes the controls at time `t` (s) that hold the model with `stiffness` times its own, under a wrench on its tip; where nothing is held,
    /// `others`.
    pub fn write(&self, t: f64, stiffness: f64, wrench: &Wrench, others: &[f64], out: &mut [f64]) {
        let size = Self::KEPT * self.n;
        let at = (t / self.spacing).max(0.0);
        let last = self.controls.len() / size - 1;
        let (i, s) = ((at as usize).min(last), at.fract());
        let wrench = wrench.to_array();
        let of = |i: usize, c: usize| {
            if !self.is_held[i] {
                return others[c];
            }
            let numbers = &self.controls[i * size + c * Self::KEPT..][..Self::KEPT];
            let borne: f64 = numbers[2..].iter().zip(&wrench).map(|(a, b)| a * b).sum();
            numbers[0] + numbers[1] * (stiffness - 1.0) + borne
        };
        for (c, out) in out.iter_mut().enumerate() {
            *out = of(i, c) * (1.0 - s) + of((i + 1).min(last), c) * s;
        }
    }
}

/// Stiffness of the springs that pull the tip, divided by the transverse stiffness of the arm: stiff enough for the shape to be stable
/// under the springs. The aims correct what the springs miss, a hundredth of the way. The rms error of `mpc-push` in its first 0.6 s is the
/// same in nine digits with half and with twice the value.
const SPRING: f64 = 100.0;
/// Stiffness `1/λ`, divided by the transverse stiffness of the arm, from which on the tip may stay off its target: the geometric mean of
/// the transverse stiffness and an axial one of `4 L²/(3 r²) = 400` for a length of 17 radii. Across, the tip then misses `λ² = 1/400` of
/// the way, along, nearly all.
const STIFFEST: f64 = 20.0;
/// Transverse stiffness of an arm whose tip must not turn, divided by that of an arm whose tip may turn.
const CLAMPED: f64 = CLAMPED_STIFFNESS / TIP_STIFFNESS;
/// Cap on the Gauss-Newton steps, each of which needs up to seven equilibria; and below it the displacement divided by the length, or turn,
/// of the forward differences that give their derivatives, with a relative error of about as much. The rms error of `mpc-push` in its first
/// 0.6 s is the same in nine digits with a third step, and with half and twice the difference.
const AIMS: usize = 2;
const NUDGE: f64 = 1e-4;
/// Cap on the duration of a reference along which statics are computed, s.
const LONGEST: f64 = 600.0;

impl HoldingWrenches {
    /// Returns the wrenches along `reference`, a pose of a node at every time up to an end, from near the shape `start`; the two times are
    /// the spacing of the wrenches and that end, s. `None` if the reference is longer than [`LONGEST`], and if `stop` is raised.
    pub fn along(
        (rod, node): (&Rod, usize),
        start: &Configuration,
        reference: impl Fn(f64) -> ReferencePose,
        [spacing, end]: [f64; 2],
        stop: &StopSignal,
    ) -> Option<Self> {
        if !(end <= LONGEST) {
            return None;
        }
        let mut shape = start.clone();
        let mut first = None;
        let mut before: Option<(ReferencePose, Vector6<f64>, Matrix6<f64>)> = None;
        let wrenches = (0..=(end / spacing).ceil() as usize)
            .map(|i| {
                stop.check().ok()?;
                let t = i as f64 * spacing;
                let target = reference(t);
                let held = before.filter(|(pose, ..)| *pose == target);
                let (_, own, mass) = held.unwrap_or_else(|| {
                    let search = Search::new((rod, node), target, t, stop);
                    let (own, mass) = search.wrench(&mut shape);
                    (target, own, mass)
                });
                before = Some((target, own, mass));
                first.get_or_insert_with(|| shape.clone());
                let [speed, acceleration] = motion(&reference, t, spacing, rod.scales.length);
                Some(own + mass * (acceleration + speed * rod.viscous_damping))
            })
            .collect::<Option<Vec<_>>>()?;
        Some(Self {
            wrenches,
            shape: first?,
            spacing,
        })
    }

    /// Returns the wrench at time `t` (s).
    pub fn wrench(&self, t: f64) -> Wrench {
        let at = (t / self.spacing).max(0.0);
        let last = self.wrenches.len() - 1;
        let (i, s) = ((at as usize).min(last), at.fract());
        let found = self.wrenches[i] * (1.0 - s) + self.wrenches[(i + 1).min(last)] * s;
        Wrench {
            force: found.fixed_rows::<3>(0).into(),
            moment: found.fixed_rows::<3>(3).into(),
        }
    }
}

/// Returns the velocity and acceleration of a reference at `t`, of its position divided by the length and of its turn in the body frame:
/// medians of neighboring differences over `spacing`, which ignore corners and jumps (Tukey 1977), since no arm can follow these.
pub fn motion(
    reference: &impl Fn(f64) -> ReferencePose,
    t: f64,
    spacing: f64,
    length: f64,
) -> [Vector6<f64>; 2] {
    let here = reference(t);
    let to = |other: f64| here.way_to(&reference(t + other * spacing), length);
    let [far_back, back, ahead, far_ahead] = [-2.0, -1.0, 1.0, 2.0].map(to);
    let median = |of: &[Vector6<f64>]| {
        Vector6::from_fn(|axis, _| {
            let mut sorted: Vec<f64> = of.iter().map(|v| v[axis]).collect();
            sorted.sort_by(f64::total_cmp);
            let (low, high) = (sorted[(of.len() - 1) / 2], sorted[of.len() / 2]);
            0.5 * (low + high)
        })
    };
    let speeds = [back - far_back, -back, ahead, far_ahead - ahead];
    let bends = [far_back - back * 2.0, back + ahead, far_ahead - ahead * 2.0];
    [
        median(&speeds) / spacing,
        median(&bends) / (spacing * spacing),
    ]
}

/// A node that springs pull to a pose. Vectors of six are a displacement divided by the length and a turn in rad, each from the target, and
/// wrenches in units of the arm's transverse stiffness.
struct Search<'a> {
    rod: &'a Rod,
    node: usize,
    target: ReferencePose,
    t: f64,
    stop: &'a StopSignal,
    /// Transverse stiffness of the arm, N/m: that of a cantilever or of a beam between held ends, and that of its weight as a pendulum.
    own: f64,
}

impl<'a> Search<'a> {
    fn new(
        (rod, node): (&'a Rod, usize),
        target: ReferencePose,
        t: f64,
        stop: &'a StopSignal,
    ) -> Self {
        let own = (Beam::of(rod).by_force[0] * rod.scales.force + rod.mass() * rod.gravity.norm())
            / rod.scales.length;
        Self {
            rod,
            node,
            target,
            t,
            stop,
            own,
        }
    }

    /// Returns the springs that pull to `aim`.
    fn spring(&self, aim: &Vector6<f64>) -> NodeSpring {
        let (length, stiffness) = (self.rod.scales.length, SPRING * self.own);
        let way: Vector3<f64> = aim.fixed_rows::<3>(0) * length;
        let turn: Vector3<f64> = aim.fixed_rows::<3>(3).into();
        NodeSpring {
            node: self.node,
            position: (self.target.position).map(|place| (place + way, stiffness)),
            rotation: (self.target.rotation)
                .map(|rotation| (rotation * exp(&turn), stiffness * length * length)),
            direction: None,
        }
    }

    /// Returns the shape at rest under springs that pull to `aim`, from near another.
    fn held(&self, aim: &Vector6<f64>, from: &Configuration) -> Option<Configuration> {
        nearby_equilibrium_until(self.rod, from, self.t, &self.spring(aim), self.stop).ok()
    }

    /// Returns the displacement of the node from the target, and the wrench of the springs.
    fn read(&self, aim: &Vector6<f64>, shape: &Configuration) -> [Vector6<f64>; 2] {
        let length = self.rod.scales.length;
        let (x, r) = (shape.positions[self.node], shape.rotations[self.node]);
        let pull = self.spring(aim).wrench(&x, &r);
        let pose = ReferencePose {
            position: Some(x),
            rotation: Some(r),
            direction: None,
        };
        let force = pull.force / (self.own * length);
        let moment = pull.moment / (self.own * length * length);
        [self.target.way_to(&pose, length), six(force, moment)]
    }

    /// Returns the wrench that holds the node at the target, from near `shape`, which becomes the shape that is held: the minimum of `|ξ|² +
    /// λ² |W|²` over the aims of the springs, with the distance `ξ` and the wrench `W`. If the arm is axially stiff at the target, the tip
    /// may stay off: for a target slightly out of reach, no force has to bend the arm. The second value is the mass of the arm at its tip:
    /// forces and moments (N, N m) by accelerations of a displacement divided by the length and of a turn.
    fn wrench(&self, shape: &mut Configuration) -> (Vector6<f64>, Matrix6<f64>) {
        let is_held = |axis: usize| {
            if axis < 3 {
                self.target.position.is_some()
            } else {
                self.target.rotation.is_some()
            }
        };
        let clamped = self.target.position.and(self.target.rotation).is_some();
        let least = 1.0 / (STIFFEST * if clamped { CLAMPED } else { 1.0 });
        let mut aim = Vector6::zeros();
        let mut mass = Matrix6::zeros();
        for _ in 0..AIMS {
            let Some(found) = self.held(&aim, shape) else {
                break;
            };
            *shape = found;
            let [off, pull] = self.read(&aim, shape);
            let (mut slope, mut give) = (Matrix6::identity(), Matrix6::zeros());
            let mut columns: [Vec<Vector3<f64>>; 6] = Default::default();
            for axis in (0..6).filter(|axis| is_held(*axis)) {
                let mut moved = aim;
                moved[axis] += NUDGE;
                let Some(there) = self.held(&moved, shape) else {
                    return (self.at(&aim, shape), mass);
                };
                let ways = (there.positions.iter().zip(&shape.positions))
                    .map(|(to, from)| (to - from) / NUDGE);
                columns[axis].extend(ways);
                let [off_there, pull_there] = self.read(&moved, &there);
                slope.set_column(axis, &((off_there - off) / NUDGE));
                give.set_column(axis, &((pull_there - pull) * (least / NUDGE)));
            }
            mass = self.mass(&columns, &slope).unwrap_or(mass);
            let square = slope.tr_mul(&slope) + give.tr_mul(&give);
            let Some(inverse) = square.try_inverse() else {
                break;
            };
            aim -= inverse * (slope.tr_mul(&off) + give.tr_mul(&(pull * least)));
        }
        (self.at(&aim, shape), mass)
    }

    /// Returns `Σ m Jᵀ J` over all nodes; `columns` are the derivatives of their positions along the aim, and `slope` that of the tip's
    /// pose.
    fn mass(&self, columns: &[Vec<Vector3<f64>>; 6], slope: &Matrix6<f64>) -> Option<Matrix6<f64>> {
        let along_aim = Matrix6::from_fn(|i, j| {
            (columns[i].iter().zip(&columns[j]).zip(&self.rod.nodes))
                .map(|((a, b), node)| node.mass * a.dot(b))
                .sum()
        });
        let inverse = slope.try_inverse()?;
        let mut mass = inverse.tr_mul(&along_aim) * inverse;
        // Of forces, not of forces times the length.
        mass.fixed_rows_mut::<3>(0)
            .unscale_mut(self.rod.scales.length);
        Some(mass)
    }

    /// Returns the force (N) and moment (N m) of springs that pull to `aim`; zero if no shape is found at rest there.
    fn at(&self, aim: &Vector6<f64>, shape: &Configuration) -> Vector6<f64> {
        let Some(found) = self.held(aim, shape) else {
            return Vector6::zeros();
        };
        let [_, mut pull] = self.read(aim, &found);
        let length = self.rod.scales.length;
        let mut force = pull.fixed_rows_mut::<3>(0);
        force *= self.own * length;
        let mut moment = pull.fixed_rows_mut::<3>(3);
        moment *= self.own * length * length;
        pull
    }
}
