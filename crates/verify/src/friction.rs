//! Friction of tendons along their paths, for the check: the shares of a tension from the turns of the path, and their derivatives along the
//! strains at both ends of an interval.
//!
//! The logarithm of the share in the piece `i` of a path is `-μ Σ σ θ` over the turns up to it, so that its derivative is a sum of those of
//! the turns, by differences, and of the speeds, whose coordinates are differentiated forward.

use nalgebra::Vector3;

use super::dual;
use super::interval::{self, Nine, Strained};
use mechanics::differences;
use mechanics::{PlacedPoint, Rod, Rubbing, State};

/// Shares of efforts in their lines, those of actuators 1, and the mean shares of the tendons of winches, 1 of others.
pub(super) struct Rubbed {
    pub(super) shares: Vec<f64>,
    pub(super) means: Vec<f64>,
}

/// The path of a tendon under the strains of an interval, or at rest.
struct Path<'a> {
    own: Rubbing<'a>,
    rod: &'a Rod,
    /// Turns where the pieces begin.
    turns: Vec<f64>,
    /// Directions of sliding there, and their derivatives along the speed.
    directions: Vec<[f64; 2]>,
}

/// Returns the points of a line.
fn points(rod: &Rod, q: usize, line: usize) -> impl Iterator<Item = &PlacedPoint> {
    (rod.actuators.on(q).iter()).filter(move |point| point.line == line)
}

impl<'a> Path<'a> {
    fn new(
        rod: &'a Rod,
        own: Rubbing<'a>,
        mean: &dyn Fn(usize) -> Nine,
        speeds: Option<&dyn Fn(usize) -> f64>,
    ) -> Self {
        let mut out = Self {
            turns: Vec::new(),
            directions: vec![[own.law.at_rest, 0.0]; own.n_pieces],
            own,
            rod,
        };
        out.turns = (0..out.own.n_pieces).map(|k| out.turn(k, mean)).collect();
        if let Some(speed) = speeds {
            let mut beyond = 0.0;
            for k in (0..out.own.n_pieces).rev() {
                beyond += speed(k);
                let ratio = beyond / out.own.law.speed;
                out.directions[k] = [ratio.tanh(), ratio.cosh().powi(-2) / out.own.law.speed];
            }
        }
        out
    }

    /// Returns the unit tangent in the middle of a piece, and the rotation vector of its element.
    fn tangent(&self, piece: usize, strain: &Nine) -> [Vector3<f64>; 2] {
        let q = self.own.first + piece;
        let (mut offset, mut slope, mut sum) = (Vector3::zeros(), Vector3::zeros(), 0.0);
        for point in points(self.rod, q, self.own.line + piece).filter(|own| own.part == 0) {
            offset += Vector3::new(point.offset[0], point.offset[1], 0.0) * point.weight;
            slope += Vector3::new(point.slope[0], point.slope[1], 0.0) * point.weight;
            sum += point.weight;
        }
        let part = |from: usize| Vector3::from_fn(|i, _| strain[from + i]);
        let (v, bend) = ((part(0) + part(3)) * 0.5, part(6));
        let along = v + bend.cross(&(offset / sum)) + slope / sum;
        [along.normalize(), bend * self.rod.elements[q].length]
    }

    /// Returns the turn where a piece begins; of the first one that up to its middle.
    fn turn(&self, k: usize, mean: &dyn Fn(usize) -> Nine) -> f64 {
        if self.own.n_pieces < 2 {
            return 0.0;
        }
        let far = k.max(1);
        let [[t0, psi0], [t1, psi1]] =
            [far - 1, far].map(|piece| self.tangent(piece, &mean(self.own.first + piece)));
        let turn = (t1 - t0 + ((psi0 + psi1) / 2.0).cross(&((t0 + t1) / 2.0))).norm();
        let straight = self.own.straight[far - 1];
        let u = turn / straight;
        let counted = if u < 1.0 {
            straight * (15.0 * u.powi(2) - 10.0 * u.powi(4) + 3.0 * u.powi(6)) / 8.0
        } else {
            turn
        };
        let length = |piece: usize| self.rod.elements[self.own.first + piece].length;
        if k == 0 {
            counted * length(0) / (length(0) + length(1))
        } else {
            counted
        }
    }

    fn shares(&self) -> Vec<f64> {
        let mut exponent = 0.0;
        (self.turns.iter().zip(&self.directions))
            .map(|(turn, [direction, _])| {
                exponent -= self.own.law.coefficient * direction * turn;
                f64::exp(exponent)
            })
            .collect()
    }

    /// Returns the mean share over the whole tendon.
    fn mean(&self, shares: &[f64]) -> f64 {
        if !self.own.has_winch {
            return 1.0;
        }
        let inside: f64 = self
            .own
            .weights
            .iter()
            .zip(shares)
            .map(|(w, share)| w * share)
            .sum();
        1.0 - self.own.weights.iter().sum::<f64>() + inside
    }
}

/// Returns the coordinate of a line and its derivative along the strain of its element.
fn coordinate(rod: &Rod, q: usize, line: usize, strain: &Nine) -> (f64, Nine) {
    points(rod, q, line).fold((0.0, Nine::zeros()), |(value, slope), point| {
        let (own, along) = dual::coordinate(point, strain);
        (value + own, slope + along)
    })
}

/// Returns the paths over an interval of the time `time`, s, from the strains at its ends, or at rest where both are the same and there is no
/// time.
fn paths<'a>(
    rod: &'a Rod,
    start: &'a dyn Fn(usize) -> Nine,
    end: &'a dyn Fn(usize) -> Nine,
    time: Option<f64>,
) -> impl Iterator<Item = Path<'a>> {
    rod.actuators.rubbing().map(move |own| {
        let (first, line) = (own.first, own.line);
        let speed = move |piece: usize| {
            let [from, to] = [start, end]
                .map(|at| coordinate(rod, first + piece, line + piece, &at(first + piece)).0);
            (to - from) / time.unwrap_or(f64::INFINITY)
        };
        let speeds: Option<&dyn Fn(usize) -> f64> = time.is_some().then_some(&speed);
        Path::new(rod, own, &|q| (start(q) + end(q)) * 0.5, speeds)
    })
}

/// Returns the shares over an interval, or at rest.
pub(super) fn rubbed(
    rod: &Rod,
    start: &dyn Fn(usize) -> Nine,
    end: &dyn Fn(usize) -> Nine,
    time: Option<f64>,
) -> Rubbed {
    let mut out = Rubbed {
        shares: vec![1.0; rod.actuators.n_efforts()],
        means: vec![1.0; rod.actuators.len()],
    };
    for path in paths(rod, start, end, time) {
        let shares = path.shares();
        out.means[path.own.actuator] = path.mean(&shares);
        out.shares[path.own.line..][..shares.len()].copy_from_slice(&shares);
    }
    out
}

/// The change of the effort of a line with the strains at both ends of an interval, and the derivative of its coordinate along the mean
/// strains, element by element.
pub(super) struct LineSlope {
    pub(super) pull: Vec<Nine>,
    pub(super) forms: [Vec<Nine>; 2],
}

/// Returns those of all lines, for the efforts of all and the derivatives of the tensions of winches along their coordinates.
pub(super) fn slopes(
    rod: &Rod,
    (start, end): (&[Strained], &[Strained]),
    time: f64,
    (efforts, along): (&[f64], &[f64]),
) -> Vec<LineSlope> {
    let mut out = Vec::new();
    let at = [start, end];
    let strain = at.map(|own| move |q: usize| own[q].0);
    for path in paths(rod, &strain[0], &strain[1], Some(time)) {
        let own = &path.own;
        let shares = path.shares();
        let whole = path.mean(&shares);
        let tension = efforts[own.actuator];
        let pulls: Vec<Vec<Nine>> = (0..own.n_pieces)
            .map(|piece| {
                let q = own.first + piece;
                let mean = (start[q].0 + end[q].0) * 0.5;
                let mut pull = vec![Nine::zeros(); rod.n_elements()];
                pull[q] = coordinate(rod, q, own.line + piece, &mean).1;
                pull
            })
            .collect();
        let of_shares = path.share_slopes(&shares, at, time);
        // That of the tension where the tendon leaves its winch.
        let of_tension = [0, 1].map(|end| {
            let mut sum = vec![Nine::zeros(); rod.n_elements()];
            for piece in (0..own.n_pieces).filter(|_| own.has_winch) {
                let factor = tension * own.weights[piece] / whole;
                add(&mut sum, 0.5 * along[own.actuator], &pulls[piece]);
                add(&mut sum, -factor, &of_shares[piece][end]);
            }
            sum
        });
        out.extend(
            pulls
                .into_iter()
                .enumerate()
                .map(|(piece, pull)| LineSlope {
                    pull,
                    forms: [0, 1].map(|end| {
                        let mut form = vec![Nine::zeros(); rod.n_elements()];
                        add(&mut form, shares[piece], &of_tension[end]);
                        add(&mut form, tension, &of_shares[piece][end]);
                        form
                    }),
                }),
        );
    }
    out
}

/// Adds a multiple of covectors to others.
fn add(out: &mut [Nine], factor: f64, own: &[Nine]) {
    for (out, own) in out.iter_mut().zip(own) {
        *out += own * factor;
    }
}

impl Path<'_> {
    /// Returns the derivatives of the shares of all pieces along the strains at both ends of an interval of the time `time`, s.
    fn share_slopes(
        &self,
        shares: &[f64],
        ends: [&[Strained]; 2],
        time: f64,
    ) -> Vec<[Vec<Nine>; 2]> {
        let zero = || vec![Nine::zeros(); self.rod.n_elements()];
        let mut logarithms = [zero(), zero()];
        let coordinates = ends.map(|end| -> Vec<Nine> {
            (0..self.own.n_pieces)
                .map(|piece| {
                    let q = self.own.first + piece;
                    coordinate(self.rod, q, self.own.line + piece, &end[q].0).1
                })
                .collect()
        });
        (shares.iter().enumerate())
            .map(|(k, share)| {
                let along_mean = self.turn_slope(k, ends);
                let [direction, rise] = self.directions[k];
                for (end, sum) in logarithms.iter_mut().enumerate() {
                    let friction = -self.own.law.coefficient;
                    for (q, slope) in &along_mean {
                        sum[*q] += slope * (0.5 * friction * direction);
                    }
                    let sign = [-1.0, 1.0][end];
                    let factor = friction * sign * self.turns[k] * rise / time;
                    add(
                        &mut sum[self.own.first + k..],
                        factor,
                        &coordinates[end][k..],
                    );
                }
                logarithms.each_ref().map(|own| {
                    let mut out = zero();
                    add(&mut out, *share, own);
                    out
                })
            })
            .collect()
    }

    /// Returns the derivatives of a turn along the mean strains of the two elements beside it, by differences.
    fn turn_slope(&self, k: usize, [start, end]: [&[Strained]; 2]) -> Vec<(usize, Nine)> {
        const STEP: f64 = 1e-4;
        let mean = |q: usize| (start[q].0 + end[q].0) * 0.5;
        let far = k.max(1);
        (far - 1..(far + 1).min(self.own.n_pieces))
            .map(|piece| {
                let q = self.own.first + piece;
                let slope = Nine::from_fn(|component, _| {
                    let unit = if component < 6 {
                        1.0
                    } else {
                        self.rod.elements[q].length.recip()
                    };
                    let moved = |step: f64| {
                        self.turn(k, &|other| {
                            let mut strain = mean(other);
                            if other == q {
                                strain[component] += step * unit;
                            }
                            strain
                        })
                    };
                    let near = [moved(STEP), moved(-STEP)];
                    let far = [moved(2.0 * STEP), moved(-2.0 * STEP)];
                    differences::slope(near, far, STEP) / unit
                });
                (q, slope)
            })
            .collect()
    }
}

/// Returns the mean shares of the tensions of all actuators over a step of the time `time`, s.
pub(super) fn means(rod: &Rod, ends: [&State; 2], time: f64) -> Vec<f64> {
    if !rod.actuators.has_friction() {
        return vec![1.0; rod.actuators.len()];
    }
    let [start, end] = ends.map(|state| {
        let at = &state.configuration;
        interval::strains(rod, &at.positions, &at.rotations)
    });
    rubbed(rod, &|q| start[q].0, &|q| end[q].0, Some(time)).means
}

/// Returns what friction takes over an interval, J: the work of the tension at every motor less that of the tensions in
/// the pieces.
pub(super) fn loss(rod: &Rod, (start, end): (&[Strained], &[Strained]), efforts: &[f64]) -> f64 {
    rod.actuators
        .rubbing()
        .map(|own| {
            (0..own.n_pieces)
                .map(|piece| {
                    let (q, line) = (own.first + piece, own.line + piece);
                    let [from, to] = [start, end].map(|at| coordinate(rod, q, line, &at[q].0).0);
                    (efforts[own.actuator] - efforts[line]) * (to - from)
                })
                .sum::<f64>()
        })
        .sum()
}
