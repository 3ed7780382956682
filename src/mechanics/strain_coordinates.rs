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
use super::strain::tangent_derivative;

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

    /// The element behind row `a`: `δψ = Sᵀ ζ_b - S ζ_a` and `δw = S (R_aᵀ δdx + y × ζ_a) + ∂(S y)/∂ψ δψ` with `y = R_aᵀ dx`.
    fn moved_element(&self, a: usize, direction: &TrajectoryTangent, step_length: f64) -> Helix {
        let (x, r) = (&self.positions, &self.rotations);
        let (dx, zeta) = (&direction.positions, &direction.rotations);
        let turn = log(&r[a].tr_mul(&r[a + 1]));
        let coefficients = InverseTangentCoefficients::at(turn.norm_squared());
        let s = log_tangent(&turn, &coefficients);
        let y = r[a].tr_mul(&(x[a + 1] - x[a]));
        let turning = s.tr_mul(&zeta[a + 1]) - s * zeta[a];
        let shift = r[a].tr_mul(&(dx[a + 1] - dx[a])) + y.cross(&zeta[a]);
        let stretching = s * shift + tangent_derivative(&turn, &y, &coefficients, -1.0) * turning;
        Helix {
            translation: s * y + stretching * step_length,
            turn: turn + turning * step_length,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A motion of five nodes, bent by up to 2 rad an element and stretched, and a direction of it.
    fn motion() -> (Trajectory, TrajectoryTangent) {
        let mut random = fastrand::Rng::with_seed(11);
        let mut vector = |size: f64| Vector3::from_fn(|_, _| size * (2.0 * random.f64() - 1.0));
        let (n_nodes, n_times) = (5, 3);
        let mut trajectory = Trajectory::with_capacity(n_nodes, n_times);
        let mut direction = TrajectoryTangent {
            positions: Vec::new(),
            rotations: Vec::new(),
        };
        for _ in 0..n_times {
            let mut shape = Configuration {
                positions: vec![vector(1.0)],
                rotations: vec![exp(&vector(1.0))],
            };
            for q in 1..n_nodes {
                let turn = shape.rotations[q - 1];
                let ahead = turn * Vector3::new(0.0, 0.0, 0.2) + vector(0.05);
                shape.positions.push(shape.positions[q - 1] + ahead);
                shape.rotations.push(turn * exp(&vector(1.1)));
            }
            trajectory.push(&shape);
            for _ in 0..n_nodes {
                direction.positions.push(vector(0.3));
                direction.rotations.push(vector(0.5));
            }
        }
        (trajectory, direction)
    }

    /// `w` and `ψ` of all elements.
    fn strains(trajectory: &Trajectory) -> Vec<Vector3<f64>> {
        (0..trajectory.n_times())
            .flat_map(|k| {
                let (x, r) = (trajectory.positions_at(k), trajectory.rotations_at(k));
                (0..x.len() - 1).flat_map(move |q| {
                    let helix = Helix::through(&x[q], &r[q], &x[q + 1], &r[q + 1]);
                    [helix.translation, helix.turn]
                })
            })
            .collect()
    }

    /// Strains move along straight lines, on any number of threads; their slope is that of the configurations moved on their own.
    #[test]
    fn strains_move_linearly() {
        let (trajectory, direction) = motion();
        let start = strains(&trajectory);
        let near = strains(&trajectory.retract_strains(&direction, 0.1, 1));
        let far = strains(&trajectory.retract_strains(&direction, 0.2, 2));
        const STEP: f64 = 1e-5;
        let [plus, minus] = [STEP, -STEP].map(|s| strains(&trajectory.retract(&direction, s)));
        for i in 0..start.len() {
            let slope = (near[i] - start[i]) / 0.1;
            assert!((far[i] - start[i] - slope * 0.2).norm() < 1e-13, "{i}");
            let difference = (plus[i] - minus[i]) / (2.0 * STEP);
            assert!(
                (slope - difference).norm() < 1e-9,
                "{i}: {slope} {difference}"
            );
        }
    }
}
