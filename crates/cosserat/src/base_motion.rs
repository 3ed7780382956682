//! A driven base: position and rotation of node 0 as given functions of time.
//!
//! For the integrator this is a holonomic constraint. Its rows for node 0 are dropped and the unknown is replaced by the pose at every time
//! node; the velocities below are needed only for momenta and energies.

use nalgebra::{Matrix3, Vector3};

use super::rod_error::RodError;
use super::rotation::{exp, exp_tangent};

/// Displacement and rotation of the base from its reference pose `(x_b, R_b)`: `x_0(t) = x_b + d(t)`,
/// `R_0(t) = R_b exp(r(t))`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BaseMotion {
    /// `d(t)`, spatial frame, m.
    pub translation: MotionCurve,
    /// `r(t)`, rotation vector in the reference frame of the base, rad.
    pub rotation: MotionCurve,
}

/// A vector function of time: `rate t + table(t) + Σ amplitude (sin(2π f t + phase) - sin(phase))`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MotionCurve {
    /// Constant rate, per second.
    pub rate: Vector3<f64>,
    /// Curve through given points.
    pub table: Option<CubicSpline>,
    /// Harmonic terms; each is zero at t = 0.
    pub oscillations: Vec<Oscillation>,
}

/// `amplitude (sin(2π f t + phase) - sin(phase))`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Oscillation {
    /// Amplitude, in the unit of the curve.
    pub amplitude: Vector3<f64>,
    /// `f`, Hz.
    pub frequency: f64,
    /// Phase, rad.
    pub phase: f64,
}

/// The cubic spline through given points with zero slope at both ends, constant outside: twice continuously differentiable between the
/// first and the last point, once everywhere.
#[derive(Clone, Debug, PartialEq)]
pub struct CubicSpline {
    times: Vec<f64>,
    values: Vec<Vector3<f64>>,
    slopes: Vec<Vector3<f64>>,
}

/// Pose and velocity of the base at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseState {
    /// Position, spatial frame, m.
    pub position: Vector3<f64>,
    /// Rotation, body to space.
    pub rotation: Matrix3<f64>,
    /// Velocity, spatial frame, m/s.
    pub velocity: Vector3<f64>,
    /// Angular velocity, body frame, rad/s.
    pub angular_velocity: Vector3<f64>,
}

impl BaseMotion {
    /// Returns pose and velocity of the base at time `t`, from the reference pose `position`, `rotation`.
    #[must_use]
    pub fn at(&self, position: &Vector3<f64>, rotation: &Matrix3<f64>, t: f64) -> BaseState {
        let (displacement, velocity) = self.translation.at(t);
        let (turn, turn_rate) = self.rotation.at(t);
        BaseState {
            position: position + displacement,
            rotation: rotation * exp(&turn),
            velocity,
            angular_velocity: exp_tangent(&turn) * turn_rate,
        }
    }

    /// Checks that all numbers are finite.
    ///
    /// # Errors
    /// Returns [`RodError`] for a number that is not.
    pub fn check(&self) -> Result<(), RodError> {
        for curve in [&self.translation, &self.rotation] {
            let numbers = curve
                .rate
                .iter()
                .copied()
                .chain(curve.oscillations.iter().flat_map(|o| {
                    [
                        o.amplitude.x,
                        o.amplitude.y,
                        o.amplitude.z,
                        o.frequency,
                        o.phase,
                    ]
                }));
            for value in numbers {
                require_finite(value)?;
            }
        }
        Ok(())
    }
}

impl MotionCurve {
    /// Returns value and time derivative at `t`.
    #[must_use]
    pub fn at(&self, t: f64) -> (Vector3<f64>, Vector3<f64>) {
        let (mut value, mut slope) = (self.rate * t, self.rate);
        if let Some(table) = &self.table {
            let (v, s) = table.at(t);
            value += v;
            slope += s;
        }
        for o in &self.oscillations {
            let omega = std::f64::consts::TAU * o.frequency;
            let (sin, cos) = (omega * t + o.phase).sin_cos();
            value += o.amplitude * (sin - o.phase.sin());
            slope += o.amplitude * (omega * cos);
        }
        (value, slope)
    }
}

impl CubicSpline {
    /// Returns the points of the spline, `(t, value)`.
    pub fn points(&self) -> impl Iterator<Item = (f64, Vector3<f64>)> + '_ {
        self.times.iter().copied().zip(self.values.iter().copied())
    }

    /// Creates the spline through points `(t, value)`.
    ///
    /// # Errors
    /// Returns [`RodError`] without points, for times that do not increase, and for numbers that are not finite.
    pub fn through(points: &[(f64, Vector3<f64>)]) -> Result<Self, RodError> {
        if points.is_empty() {
            return Err(RodError::OutOfRange {
                parameter: "base motion table",
                value: 0.0,
                expected: "at least one point",
            });
        }
        for (t, value) in points {
            require_finite(*t)?;
            for component in value {
                require_finite(*component)?;
            }
        }
        for pair in points.windows(2) {
            if pair[1].0 <= pair[0].0 {
                return Err(RodError::OutOfRange {
                    parameter: "base motion table time",
                    value: pair[1].0,
                    expected: "after the time before it",
                });
            }
        }
        let (times, values): (Vec<f64>, Vec<_>) = points.iter().copied().unzip();
        let slopes = spline_slopes(&times, &values);
        Ok(Self {
            times,
            values,
            slopes,
        })
    }

    /// Returns value and time derivative at `t`.
    #[must_use]
    pub fn at(&self, t: f64) -> (Vector3<f64>, Vector3<f64>) {
        let after = self.times.partition_point(|&time| time <= t);
        if after == 0 || after == self.times.len() {
            return (self.values[after.saturating_sub(1)], Vector3::zeros());
        }
        let i = after - 1;
        let width = self.times[after] - self.times[i];
        let s = (t - self.times[i]) / width;
        let rise = self.values[after] - self.values[i];
        let (a, b) = (
            self.slopes[i] * width - rise,
            rise - self.slopes[after] * width,
        );
        let value = self.values[i] + s * (rise + (1.0 - s) * (a * (1.0 - s) + b * s));
        let slope = rise + (1.0 - 2.0 * s) * (a * (1.0 - s) + b * s) + s * (1.0 - s) * (b - a);
        (value, slope / width)
    }
}

/// Returns the slopes for which the second derivative is continuous at the inner points, zero at the ends: `h_i m_{i-1} + 2 (h_{i-1} + h_i)
/// m_i + h_{i-1} m_{i+1} = 3 (h_i d_{i-1} + h_{i-1} d_i)` with the widths `h` and the slopes `d` of the chords. The system is diagonally
/// dominant and solved by elimination.
fn spline_slopes(times: &[f64], values: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let n = times.len();
    let mut slopes = vec![Vector3::zeros(); n];
    // Coefficient of m_{i+1} in the eliminated row of i.
    let mut upper = vec![0.0; n];
    for i in 1..n.saturating_sub(1) {
        let (before, after) = (times[i] - times[i - 1], times[i + 1] - times[i]);
        let chords = (values[i] - values[i - 1]) * (after / before)
            + (values[i + 1] - values[i]) * (before / after);
        let pivot = 2.0 * (before + after) - after * upper[i - 1];
        upper[i] = before / pivot;
        slopes[i] = (3.0 * chords - after * slopes[i - 1]) / pivot;
    }
    for i in (1..n.saturating_sub(1)).rev() {
        let next = slopes[i + 1];
        slopes[i] -= upper[i] * next;
    }
    slopes
}

fn require_finite(value: f64) -> Result<(), RodError> {
    if value.is_finite() {
        Ok(())
    } else {
        Err(RodError::OutOfRange {
            parameter: "base motion",
            value,
            expected: "finite",
        })
    }
}
