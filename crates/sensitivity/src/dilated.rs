//! The parts that the dilatation of the elements has in the linearized drift of one time node, where inertia [follows](InertiaRule) it.

use nalgebra::{Matrix3, Vector3};

use super::step::{ElementDrift, LinearizedStep, ReactionDrift, square};
use crate::linearization::Motion;
use cosserat::configuration::Trajectory;
use cosserat::inertia::InertiaRule;
use cosserat::rod::Rod;
use cosserat::rotation::cay_inverse;
use cosserat::rotation_step::TurnedNode;

/// A node over an interval.
struct Turn {
    /// Cayley vector of `F = R^{k,T} R^{k+1}`.
    f: Vector3<f64>,
    /// `F`
    turn: Matrix3<f64>,
    /// Angular momentum, body frame at the start.
    g: Vector3<f64>,
}

/// Writes the [`ElementDrift`] of every element over the interval from time node `k` on to the step, whose nodes' drifts are there
/// already. `leaving` is the inertia of the nodes where they leave.
pub(super) fn element_drifts(
    motion: &Motion,
    trajectory: &Trajectory,
    k: usize,
    leaving: &[Vector3<f64>],
    step: &mut LinearizedStep,
) {
    let (before, after) = (trajectory.rotations_at(k), trajectory.rotations_at(k + 1));
    let turns: Vec<Turn> = (before.iter().zip(after).zip(leaving))
        .map(|((before, after), rotary)| {
            let turn = before.tr_mul(after);
            let f = cay_inverse(&turn);
            let g = TurnedNode::new(rotary, &f, motion.grid.step).momentum_before();
            Turn { f, turn, g }
        })
        .collect();
    for q in 0..motion.rod.n_elements() {
        let drift = element_drift(motion, trajectory, &turns, step, q, k);
        step.element_drifts.push(drift);
    }
}

/// Element `q`.
///
/// The inertia `S/e` of a share `S` changes by `-S δe/e²`; at a given momentum `g` the step turns as if `g` were larger by
/// `(S f + ½ f × S f)/(α h) δe/e²`.
fn element_drift(
    motion: &Motion,
    trajectory: &Trajectory,
    turns: &[Turn],
    step: &LinearizedStep,
    q: usize,
    k: usize,
) -> ElementDrift {
    let Motion { rod, grid, .. } = *motion;
    let h = grid.step;
    let rule = InertiaRule::of(rod.model, k);
    let dx = [k, k + 1].map(|k| {
        let x = trajectory.positions_at(k);
        x[q + 1] - x[q]
    });
    let chord = rod.rest_chords[q];
    let square = dx.map(|dx| (chord / dx.norm()).powi(2));
    // Where the inertia of the leaving momentum is taken.
    let at = usize::from(rule == InertiaRule::End);
    let mut out = ElementDrift {
        stretch: dx.map(|dx| (dx / (dx.norm() * chord)).into()),
        turn: [[[0.0; 3]; 2]; 2],
        spin: [[[0.0; 3]; 2]; 2],
        reaction: None,
    };
    for end in 0..2 {
        let Turn { f, turn, g } = &turns[q + end];
        let share = &rod.element_inertia[q][end].rotary;
        let turned = TurnedNode::new(share, f, h);
        let gain = turned.momentum_before() * square[at];
        let drift = &step.drifts[q + end];
        let turn_gain = matrix(&drift.theta) * gain;
        let spin_gain = if rule == InertiaRule::Both {
            matrix(&drift.momentum) * gain
        } else {
            turn.tr_mul(g).cross(&turn_gain)
        };
        out.turn[at][end] = turn_gain.into();
        out.spin[at][end] = spin_gain.into();
        if rule == InertiaRule::Both {
            out.spin[1][end] = (turned.momentum_after() * -square[1]).into();
        }
    }
    if rule != InertiaRule::Both {
        let factor = [motion.kick(k).impulse, motion.arriving_impulse()][at];
        let turns = [&turns[q].f, &turns[q + 1].f];
        let reaction = reaction_drift(rod, turns, &dx[at], q, [h * factor, h]);
        out.reaction = Some(ReactionDrift { at, ..reaction });
    }
    out
}

/// The kinetic reaction `r = -weight L₀ T dx/|dx|³` over a step of length `h`, at the start of the interval.
fn reaction_drift(
    rod: &Rod,
    turns: [&Vector3<f64>; 2],
    dx: &Vector3<f64>,
    q: usize,
    [weight, h]: [f64; 2],
) -> ReactionDrift {
    let length = dx.norm();
    let scale = -weight * rod.rest_chords[q] / length.powi(3);
    let direction = dx / length;
    let energy = rod.rotational_energy(q, turns, h);
    let across = Matrix3::identity() - 3.0 * direction * direction.transpose();
    ReactionDrift {
        at: 0,
        stiffness: square(&(across * (scale * energy))),
        along: (dx * scale).into(),
        spin: [0, 1].map(|end| {
            let f = turns[end];
            let jf = rod.element_inertia[q][end].rotary.component_mul(f);
            let alpha = 1.0 + 0.25 * f.norm_squared();
            let slope = (jf - f * (f.dot(&jf) / (4.0 * alpha))) / (h * h * alpha);
            // ω = T δf with the tangent T of cay, T⁻ᵀ = I - f̂/2 + f fᵀ/4.
            (slope - 0.5 * f.cross(&slope) + f * (0.25 * f.dot(&slope))).into()
        }),
    }
}

fn matrix(rows: &[[f64; 3]; 3]) -> Matrix3<f64> {
    Matrix3::from_fn(|i, j| rows[i][j])
}
