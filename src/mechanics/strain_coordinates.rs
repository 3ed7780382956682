//! Configurations in terms of their strains: a shape between two others, and a motion along a direction, in which the rod bends
//! and twists but is not stretched by the way itself.
//!
//! Each element is described by `ψ = log(R_aᵀ R_b)` and `w = S(ψ) R_aᵀ (x_b - x_a)`, `S` the inverse tangent of the exponential: rotation and
//! translation of the helix through its ends, whatever rule the rod is computed with. From the base on, `R_b = R_a exp(ψ)` and
//! `x_b = x_a + R_a S(ψ)⁻¹ w`. The stiff strains are linear in these coordinates, where those of positions and rotations
//! moved on their own grow with the square of the turn.

use nalgebra::{Matrix3, Vector3};

use super::configuration::{Configuration, Trajectory, TrajectoryTangent};
use super::rotation::{InverseTangentCoefficients, exp, exp_tangent, log, log_tangent};
use super::strain::{ElementPose, StrainRule};

/// Poses that are worth a thread of their own: some hundred microseconds.
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
        let turn = log(&(r_a.transpose() * r_b));
        let inverse_tangent =
            log_tangent(&turn, &InverseTangentCoefficients::at(turn.norm_squared()));
        Self {
            translation: inverse_tangent * (r_a.transpose() * (x_b - x_a)),
            turn,
        }
    }

    /// The far end of the helix that begins at `x`, `r`.
    fn end(&self, x: &Vector3<f64>, r: &Matrix3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
        // S(ψ)⁻¹ is the spatial tangent of the exponential.
        (
            x + r * (exp_tangent(&-self.turn) * self.translation),
            r * exp(&self.turn),
        )
    }
}

/// The shape whose strains lie between those of two others, on the base of the first.
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
    /// Moves every configuration along `direction`: its base by `x + α δx` and `R exp(α ζ)`, the strains of its elements linearly. To
    /// first order the same as [`retract`](Self::retract). `n_threads` changes the time only.
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

    /// The element behind row `a`.
    fn moved_element(&self, a: usize, direction: &TrajectoryTangent, step_length: f64) -> Helix {
        let (x, r) = (&self.positions, &self.rotations);
        let pose = ElementPose {
            dx: x[a + 1] - x[a],
            rotation_a: &r[a],
            rotation_b: &r[a + 1],
        };
        // Per unit of length, which is one: the helix itself.
        let (strain, derivative) = StrainRule::Helical.strain_derivative(1.0, &pose);
        let (dx, zeta) = (&direction.positions, &direction.rotations);
        let change = derivative.fixed_columns::<3>(0) * (dx[a + 1] - dx[a])
            + derivative.fixed_columns::<3>(3) * zeta[a]
            + derivative.fixed_columns::<3>(6) * zeta[a + 1];
        Helix {
            translation: strain.linear[0] + change.fixed_rows::<3>(0) * step_length,
            turn: strain.curvature + change.fixed_rows::<3>(6) * step_length,
        }
    }
}
