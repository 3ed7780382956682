//! Configurations in terms of their strains: a shape between two others, and a motion along a direction, in which the rod bends and twists
//! without being stretched by the motion itself.
//!
//! Each element is described by `ψ = log(R_aᵀ R_b)` and `w = S(ψ) R_aᵀ (x_b - x_a)`, with `S` the inverse tangent of the exponential:
//! rotation and translation of the helix through its ends, whatever the rule of the rod is. From the base on, `R_b = R_a exp(ψ)` and `x_b =
//! x_a + R_a S(ψ)⁻¹ w`. The stiff strains are linear in these coordinates, whereas those of positions and rotations that are moved
//! independently grow with the square of the turn.

use nalgebra::{Matrix3, Matrix6, Vector3};
use pulp::Scalar;

use super::configuration::{Configuration, Trajectory, TrajectoryTangent};
use super::element::helical::HelicalChart;
use super::element::{ElementPose, StrainRule};
use super::rotation::{exp, exp_tangent, log};
use super::vector::Vec3;

/// Smallest number of poses for a thread of its own: some hundred microseconds of work.
const LEAST_SHARE: usize = 2048;

/// `w` and `ψ` of one element.
#[derive(Clone, Copy)]
struct Helix {
    translation: Vector3<f64>,
    turn: Vector3<f64>,
}

impl Helix {
    fn through(
        x_a: &Vector3<f64>,
        r_a: &Matrix3<f64>,
        x_b: &Vector3<f64>,
        r_b: &Matrix3<f64>,
    ) -> Self {
        let pose = ElementPose {
            dx: x_b - x_a,
            rotation_a: r_a,
            rotation_b: r_b,
        };
        let strain = StrainRule::Helical.strain(1.0, &pose);
        Self {
            translation: strain.linear[0],
            turn: strain.curvature,
        }
    }

    /// Returns the far end of the helix that begins at `x`, `r`.
    fn end(&self, x: &Vector3<f64>, r: &Matrix3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
        // S(ψ)⁻¹ is the spatial tangent of the exponential.
        (
            x + r * (exp_tangent(&-self.turn) * self.translation),
            r * exp(&self.turn),
        )
    }
}

/// `(w, ψ)` of an element, linearized at its pose, and solved for the motion of its far end.
#[derive(Clone, Copy, Debug)]
struct Chart {
    rotation_a: Matrix3<f64>,
    turn: Vector3<f64>,
    helical: HelicalChart<Scalar>,
    /// `S⁻¹`
    inverse: Matrix3<f64>,
}

/// Motion of a node: `δx` (spatial frame) and `ζ` (body frame).
type Move = (Vector3<f64>, Vector3<f64>);

impl Chart {
    fn at(x_a: &Vector3<f64>, r_a: &Matrix3<f64>, x_b: &Vector3<f64>, r_b: &Matrix3<f64>) -> Self {
        let (helical, turn) = HelicalChart::of(&ElementPose {
            dx: x_b - x_a,
            rotation_a: r_a,
            rotation_b: r_b,
        });
        Self {
            rotation_a: *r_a,
            turn,
            helical,
            // The spatial tangent of the exponential.
            inverse: exp_tangent(&-turn),
        }
    }

    /// `(w, ψ)`
    fn helix(&self) -> Helix {
        Helix {
            translation: self.helical.s.apply(self.helical.y).vector(),
            turn: self.turn,
        }
    }

    /// Returns `(δw, δψ)` of a motion of both ends.
    fn strain(&self, a: &Move, b: &Move) -> Helix {
        let shift = self.rotation_a.tr_mul(&(b.0 - a.0));
        let motion = [shift, a.1, b.1].map(|own| Vec3::splat(Scalar, &own));
        let [translation, turn] = self.helical.apply(motion).map(Vec3::vector);
        Helix { translation, turn }
    }

    /// Returns the motion of the far end for a given strain and a motion of the near end: [`strain`](Self::strain), solved for that.
    fn far_end(&self, a: &Move, strain: &Helix) -> Move {
        let [near, turn] = [a.1, strain.turn].map(|own| Vec3::splat(Scalar, &own));
        let HelicalChart { y, s, g } = self.helical;
        let shift = self.inverse * (strain.translation - g.apply(turn).vector());
        (
            a.0 + self.rotation_a * (shift - y.cross(near).vector()),
            (self.inverse).tr_mul(&(strain.turn + s.apply(near).vector())),
        )
    }
}

/// Writes the shape to which a tangent `(δx, ζ)` of every node leads if it moves the base by `x + δx` and `R exp(ζ)`, and the strains of
/// all elements linearly, to a shape of the same size. To first order it is that of [`State::retract`](super::State::retract).
pub fn retract_shape(
    from: &Configuration,
    positions: &[Vector3<f64>],
    rotations: &[Vector3<f64>],
    to: &mut Configuration,
) {
    let (x, r) = (&from.positions, &from.rotations);
    to.positions[0] = x[0] + positions[0];
    to.rotations[0] = r[0] * exp(&rotations[0]);
    for a in 0..x.len() - 1 {
        let b = a + 1;
        let chart = Chart::at(&x[a], &r[a], &x[b], &r[b]);
        let change = chart.strain(&(positions[a], rotations[a]), &(positions[b], rotations[b]));
        let helix = chart.helix();
        let helix = Helix {
            translation: helix.translation + change.translation,
            turn: helix.turn + change.turn,
        };
        (to.positions[b], to.rotations[b]) = helix.end(&to.positions[a], &to.rotations[a]);
    }
}

/// Computes the tangent at `from` that leads to `to`: the inverse of [`retract_shape`].
pub fn shape_difference(
    to: &Configuration,
    from: &Configuration,
    positions: &mut [Vector3<f64>],
    rotations: &mut [Vector3<f64>],
) {
    let (x, r) = (&from.positions, &from.rotations);
    positions[0] = to.positions[0] - x[0];
    rotations[0] = log(&r[0].tr_mul(&to.rotations[0]));
    for a in 0..x.len() - 1 {
        let b = a + 1;
        let chart = Chart::at(&x[a], &r[a], &x[b], &r[b]);
        let here = chart.helix();
        let there = Helix::through(
            &to.positions[a],
            &to.rotations[a],
            &to.positions[b],
            &to.rotations[b],
        );
        let change = Helix {
            translation: there.translation - here.translation,
            turn: there.turn - here.turn,
        };
        (positions[b], rotations[b]) = chart.far_end(&(positions[a], rotations[a]), &change);
    }
}

/// A map of tangents at one shape to those at another that change the strains of the elements and the base alike: the derivative of
/// [`shape_difference`] along its reference.
#[derive(Clone, Debug)]
pub struct ShapeTransport {
    /// Map of the motion `(δx, ζ)` of the base.
    pub base: Matrix6<f64>,
    /// Maps of every element from the motions of its near and its far end, and from the mapped motion of its near end, to the mapped motion
    /// of its far end, which is their sum.
    pub links: Vec<[Matrix6<f64>; 3]>,
}

impl ShapeTransport {
    /// Creates memory for shapes of `n_nodes` nodes.
    #[must_use]
    pub fn new(n_nodes: usize) -> Self {
        Self {
            base: Matrix6::identity(),
            links: Vec::with_capacity(n_nodes - 1),
        }
    }

    /// Computes the transport from one shape to another.
    pub fn between(&mut self, from: &Configuration, to: &Configuration) {
        let turn = log(&from.rotations[0].tr_mul(&to.rotations[0]));
        self.base.fill_with_identity();
        (self.base.fixed_view_mut::<3, 3>(3, 3)).copy_from(&exp_tangent(&turn));
        self.links.clear();
        for a in 0..from.positions.len() - 1 {
            let [here, there] = [from, to].map(|shape| {
                let (x, r) = (&shape.positions, &shape.rotations);
                Chart::at(&x[a], &r[a], &x[a + 1], &r[a + 1])
            });
            let still = (Vector3::zeros(), Vector3::zeros());
            let columns = |of: &dyn Fn(&Move) -> Move| {
                let mut matrix = Matrix6::zeros();
                for i in 0..6 {
                    let unit = Vector3::ith(i % 3, 1.0);
                    let (x, r) = of(&if i < 3 {
                        (unit, still.1)
                    } else {
                        (still.0, unit)
                    });
                    matrix.fixed_view_mut::<3, 1>(0, i).copy_from(&x);
                    matrix.fixed_view_mut::<3, 1>(3, i).copy_from(&r);
                }
                matrix
            };
            self.links.push([
                columns(&|near| there.far_end(&still, &here.strain(near, &still))),
                columns(&|far| there.far_end(&still, &here.strain(&still, far))),
                columns(&|moved| there.far_end(moved, &here.strain(&still, &still))),
            ]);
        }
    }
}

/// Returns the shape whose strains lie between those of two others, on the base of the first.
#[must_use]
pub fn between(from: &Configuration, to: &Configuration, fraction: f64) -> Configuration {
    let helix = |shape: &Configuration, q: usize| {
        let (x, r) = (&shape.positions, &shape.rotations);
        Helix::through(&x[q], &r[q], &x[q + 1], &r[q + 1])
    };
    let mut shape = from.clone();
    for q in 0..shape.positions.len() - 1 {
        let (a, b) = (helix(from, q), helix(to, q));
        let helix = Helix {
            translation: a.translation.lerp(&b.translation, fraction),
            turn: a.turn.lerp(&b.turn, fraction),
        };
        (shape.positions[q + 1], shape.rotations[q + 1]) =
            helix.end(&shape.positions[q], &shape.rotations[q]);
    }
    shape
}

impl Trajectory {
    /// Moves every configuration along `direction`: its base by `x + α δx` and `R exp(α ζ)`, the strains of its elements linearly. To first
    /// order this equals [`retract`](Self::retract). `n_threads` has no effect on the result.
    #[must_use]
    pub fn retract_strains(
        &self,
        direction: &TrajectoryTangent,
        step_length: f64,
        n_threads: usize,
    ) -> Self {
        let mut moved = self.clone();
        let n = self.n_nodes;
        let n_threads = n_threads.clamp(1, (self.positions.len() / LEAST_SHARE).max(1));
        let share = n * self.n_times().div_ceil(n_threads).max(1);
        let shares = (moved.positions.chunks_mut(share)).zip(moved.rotations.chunks_mut(share));
        let mut shares = (0..).step_by(share).zip(shares);
        let own = shares.next();
        let retract = |start: usize, x: &mut [Vector3<f64>], r: &mut [Matrix3<f64>]| {
            let shapes = x.chunks_exact_mut(n).zip(r.chunks_exact_mut(n));
            for ((x, r), first) in shapes.zip((start..).step_by(n)) {
                x[0] += direction.positions[first] * step_length;
                r[0] *= exp(&(direction.rotations[first] * step_length));
                for a in 0..n - 1 {
                    let helix = self.moved_element(first + a, direction, step_length);
                    (x[a + 1], r[a + 1]) = helix.end(&x[a], &r[a]);
                }
            }
        };
        std::thread::scope(|scope| {
            let retract = &retract;
            for (start, (x, r)) in shares {
                scope.spawn(move || retract(start, x, r));
            }
            if let Some((start, (x, r))) = own {
                retract(start, x, r);
            }
        });
        moved
    }

    /// Returns the moved strain of the element that begins at row `a`.
    fn moved_element(&self, a: usize, direction: &TrajectoryTangent, step_length: f64) -> Helix {
        let (x, r) = (&self.positions, &self.rotations);
        let (dx, zeta) = (&direction.positions, &direction.rotations);
        let b = a + 1;
        let chart = Chart::at(&x[a], &r[a], &x[b], &r[b]);
        let helix = chart.helix();
        let change = chart.strain(&(dx[a], zeta[a]), &(dx[b], zeta[b]));
        Helix {
            translation: helix.translation + change.translation * step_length,
            turn: helix.turn + change.turn * step_length,
        }
    }
}
