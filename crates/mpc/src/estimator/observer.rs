//! A boundary observer: the model with an additional wrench at the tip that damps its deviation from the measurements there.

use nalgebra::{Matrix3, Vector3};

use crate::command::Command;
use crate::error::MpcError;
use crate::signal::{Measurement, Reading};
use mechanics::rotation::{exp, log, orthonormalized};
use mechanics::stability::automatic_step;
use mechanics::{Rod, State};

use super::comparison::Comparison;
use super::prediction::Predictor;
use super::{Disturbance, Estimate, EstimateError, Estimator, Innovation};
use super::{check_start, check_time, setting};

/// Gains of a [`BoundaryObserver`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObserverSettings {
    /// Gain on velocities, divided by the matched impedance of the arm's waves: `sqrt(ρA GA)` across, `sqrt(ρA EA)` along, `sqrt(ρI EI)`
    /// for bending, `sqrt(ρJ GJ)` for twist. The gain has an optimum: a tip that is held too firmly reflects waves as a clamp does.
    pub gain: f64,
    /// Time constant with which the tip alone would follow the measured pose, s: the gain on velocities divided by the gain on poses.
    pub follow_time: f64,
    /// Time in which the injected wrench becomes a disturbance at the tip, s; `None` estimates no disturbance.
    pub integral_time: Option<f64>,
    /// Longest time step of the model, s.
    pub longest_step: f64,
}

/// Defaults that [`ObserverSettings::gain`] and [`ObserverSettings::follow_time`] expose, the latter divided by the time scale of the arm:
/// a ninth of a cantilever's first period.
const GAIN: f64 = 0.1;
const FOLLOW_TIME: f64 = 0.2;

impl ObserverSettings {
    /// Returns a gain of a tenth of the matched impedance, without a disturbance.
    #[must_use]
    pub fn of(model: &Rod) -> Self {
        Self {
            gain: GAIN,
            follow_time: FOLLOW_TIME * model.scales.time,
            integral_time: None,
            longest_step: automatic_step(model),
        }
    }

    fn check(&self) -> Result<(), MpcError> {
        for (name, value) in [
            ("gain", self.gain),
            ("follow_time", self.follow_time),
            ("integral_time", self.integral_time.unwrap_or(1.0)),
            ("longest_step", self.longest_step),
        ] {
            setting(name, value, value > 0.0, "a positive finite number")?;
        }
        Ok(())
    }
}

/// Gains on velocity and angular velocity in the body frame of the tip, kg/s and kg m²/s.
#[derive(Clone, Copy, Debug)]
struct Gains {
    linear: Vector3<f64>,
    angular: Vector3<f64>,
    /// Gain on a pose divided by that on its rate, 1/s.
    rate: f64,
    /// Fraction of an injected wrench that becomes a disturbance within a second, 1/s.
    integral: f64,
}

impl Gains {
    fn of(model: &Rod, settings: &ObserverSettings) -> Self {
        let last = model.n_elements() - 1;
        let element = &model.elements[last];
        let [near, far] = &model.element_inertia[last];
        let impedance = |per_length: Vector3<f64>, stiffness: &Vector3<f64>| {
            per_length.component_mul(stiffness).map(f64::sqrt) * settings.gain
        };
        let mass = (near.mass + far.mass) / element.length;
        let rotary = (near.rotary + far.rotary) / element.length;
        Self {
            linear: impedance(Vector3::repeat(mass), &element.linear_stiffness),
            angular: impedance(rotary, &element.angular_stiffness),
            rate: 1.0 / settings.follow_time,
            integral: settings.integral_time.map_or(0.0, |time| 1.0 / time),
        }
    }
}

/// Knowledge of the tip at one time.
#[derive(Clone, Copy, Debug, Default)]
struct Tip {
    time: f64,
    position: Option<Vector3<f64>>,
    rotation: Option<Matrix3<f64>>,
    velocity: Option<Vector3<f64>>,
    /// Angular velocity, body frame, rad/s.
    spin: Option<Vector3<f64>>,
}

/// A place nearer to the tip than this fraction of the length counts as the tip: rounding of a fraction that a file has with ten digits.
const AT_TIP: f64 = 1e-9;

impl Tip {
    fn of(measurement: &Measurement) -> Self {
        let mut tip = Self {
            time: measurement.time,
            ..Self::default()
        };
        let at_tip = |signal: &&crate::signal::Signal| signal.place > 1.0 - AT_TIP;
        for signal in measurement.signals.iter().filter(at_tip) {
            match signal.reading {
                Reading::Position(x) => tip.position = Some(x),
                Reading::Rotation(r) => tip.rotation = Some(orthonormalized(&r)),
                Reading::Velocity(v) => tip.velocity = Some(v),
                Reading::AngularVelocity(w) => tip.spin = Some(w),
                _ => {}
            }
        }
        tip
    }

    /// Returns this knowledge, completed by that of another measurement.
    fn or(self, other: &Self) -> Self {
        Self {
            time: self.time,
            position: self.position.or(other.position),
            rotation: self.rotation.or(other.rotation),
            velocity: self.velocity.or(other.velocity),
            spin: self.spin.or(other.spin),
        }
    }

    /// Interpolates between the time before and this one: poses move evenly, and rates that were not measured follow from them.
    fn between(&self, before: &Self, t: f64) -> Self {
        let duration = self.time - before.time;
        // The interpolation begins at the later time.
        let left = self.time - t;
        let moved =
            |from: Option<Vector3<f64>>, to: Option<Vector3<f64>>| Some((to? - from?) / duration);
        let slope = moved(before.position, self.position);
        let turning = before
            .rotation
            .zip(self.rotation)
            .map(|(from, to)| log(&from.tr_mul(&to)) / duration);
        let rate = |measured: Option<Vector3<f64>>, from: Option<Vector3<f64>>, slope| {
            let change = moved(from, measured).unwrap_or_else(Vector3::zeros);
            measured.map(|rate| rate - change * left).or(slope)
        };
        Self {
            time: t,
            position: (self.position).map(|x| x - slope.unwrap_or_else(Vector3::zeros) * left),
            rotation: (self.rotation)
                .map(|r| r * exp(&(turning.unwrap_or_else(Vector3::zeros) * -left))),
            velocity: rate(self.velocity, before.velocity, slope),
            spin: rate(self.spin, before.spin, turning),
        }
    }
}

/// A command, and the time at which it ceased to act.
#[derive(Clone, Debug)]
struct Piece {
    command: Command,
    until: f64,
}

/// Cap on the pieces between two measurements: if the tip was not measured for longer, the motion until then is taken as it is.
const MOST_PIECES: usize = 64;

/// The boundary observer of Zheng et al. (arXiv 2303.06130): a copy of the model with an additional wrench at the tip, in the body frame of
/// the tip,
///
///
/// It damps the deviation from the true motion as a matched end of a line absorbs its waves; it has no covariance and is the same on every
/// grid. It uses positions, rotations and velocities that were measured at the tip; components of a pose that are not measured are not
/// corrected, and rates that are not measured follow from the poses of two measurements.
///
/// The wrench acts over the time between two measurements, toward the pose between them: that time is simulated once more when the second
/// one is known. After every step the tip's momenta take the impulse of the wrench, implicitly: with `v_free` the tip's velocity without it
/// and `m` the mass of the node, `v⁺ = v_free + h (Gv (v - v⁺) + Gp (x - x_hat - h (v⁺ - v_free)))/m`, so that no gain is too large for the
/// step.
///
/// No call after the first of its kind allocates memory if steps are explicit.
#[derive(Debug)]
pub struct BoundaryObserver {
    settings: ObserverSettings,
    gains: Gains,
    estimate: Estimate,
    /// The corrected estimate at the last measurement, and the knowledge of the tip at that time.
    anchor: Estimate,
    tip: Option<Tip>,
    /// Commands since that time; the first `n_pieces` of them are in use.
    pieces: Vec<Piece>,
    n_pieces: usize,
    predictor: Predictor,
    comparison: Comparison,
    next: State,
}

impl BoundaryObserver {
    /// Creates an observer at `time` (s) in `state`, on the nodes of `model`.
    ///
    /// # Errors
    /// Returns [`MpcError::Setting`] for a gain or a time out of range, [`MpcError::Measurement`] for a state of another size or that is
    /// not finite, and [`MpcError::Unsupported`] for a model whose tip is held.
    pub fn new(
        model: &Rod,
        time: f64,
        state: &State,
        settings: &ObserverSettings,
    ) -> Result<Self, MpcError> {
        settings.check()?;
        check_start(model, time, state)?;
        if !model.has_free_tip() {
            return Err(MpcError::Unsupported(
                "an observer corrects its model by a wrench on the tip, which moves no arm whose tip is held; take estimator.kind = \"kalman\"",
            ));
        }
        let estimate = Estimate {
            time,
            state: state.clone(),
            disturbance: Disturbance::NONE,
            deviation: Disturbance {
                stiffness: 0.0,
                ..Disturbance::NONE
            },
        };
        Ok(Self {
            settings: *settings,
            gains: Gains::of(model, settings),
            anchor: estimate.clone(),
            estimate,
            tip: None,
            pieces: Vec::new(),
            n_pieces: 0,
            predictor: Predictor::new(model, settings.longest_step),
            comparison: Comparison::new(model),
            next: state.clone(),
        })
    }

    /// Returns the settings.
    #[must_use]
    pub fn settings(&self) -> &ObserverSettings {
        &self.settings
    }

    /// Makes the present estimate the start of the next correction.
    fn drop_anchor(&mut self) {
        self.anchor.time = self.estimate.time;
        self.anchor.state.clone_from(&self.estimate.state);
        self.anchor.disturbance = self.estimate.disturbance;
        self.n_pieces = 0;
    }

    /// Stores a command that acted.
    fn remember(&mut self, command: &Command, until: f64) {
        if self.n_pieces == self.pieces.len() {
            self.pieces.push(Piece {
                command: command.clone(),
                until,
            });
        } else {
            let piece = &mut self.pieces[self.n_pieces];
            piece.until = until;
            piece.command.clone_from(command);
        }
        self.n_pieces += 1;
    }

    /// Simulates the time since the anchor with the wrench that pulls the tip to `target`; leaves the state in `next`.
    fn replay(&mut self, target: &Tip) -> Result<Disturbance, EstimateError> {
        let (gains, tip) = (self.gains, self.predictor.model().tip());
        let (mass, rotary) = {
            let node = &self.predictor.model().nodes[tip];
            (node.mass, node.rotary)
        };
        let before = self.tip.unwrap_or_default();
        let mut disturbance = self.anchor.disturbance;
        let mut time = self.anchor.time;
        self.next.clone_from(&self.anchor.state);
        for piece in &self.pieces[..self.n_pieces] {
            if let Some(steps) = self.predictor.steps(time, piece.until)? {
                let step = steps.step;
                self.predictor.roll_out_changing(
                    &self.next,
                    steps,
                    &piece.command,
                    &mut disturbance,
                    |t, state, disturbance| {
                        let to = target.between(&before, t);
                        let [linear, angular] = gains.impulse(state, tip, mass, &rotary, &to, step);
                        state.linear_momentum[tip] += linear;
                        state.angular_momentum[tip] += angular;
                        disturbance.tip.force += linear * gains.integral;
                        disturbance.tip.moment += angular * gains.integral;
                    },
                )?;
                self.next.clone_from(self.predictor.end());
            }
            time = piece.until;
        }
        Ok(disturbance)
    }
}

impl Gains {
    /// Returns the impulses on the tip's momenta after a step of length `h`: linear (spatial frame) and angular (body frame).
    fn impulse(
        &self,
        state: &State,
        tip: usize,
        mass: f64,
        rotary: &Vector3<f64>,
        to: &Tip,
        h: f64,
    ) -> [Vector3<f64>; 2] {
        let rotation = &state.configuration.rotations[tip];
        let position = &state.configuration.positions[tip];
        let velocity = state.linear_momentum[tip] / mass;
        let spin = state.angular_momentum[tip].component_div(rotary);
        let zero = Vector3::zeros();
        // Unknown values do not pull, neither by themselves nor through the denominator.
        let pull = |gain: &Vector3<f64>,
                    inertia: &Vector3<f64>,
                    rate: Option<Vector3<f64>>,
                    offset: Option<Vector3<f64>>| {
            let stiff = if offset.is_some() { self.rate } else { 0.0 };
            let damp = if rate.is_some() { 1.0 } else { 0.0 };
            let force = rate.unwrap_or(zero) + offset.unwrap_or(zero) * self.rate;
            Vector3::from_fn(|i, _| {
                let implicit = 1.0 + h * gain[i] * (damp + h * stiff) / inertia[i];
                h * gain[i] * force[i] / implicit
            })
        };
        let linear = pull(
            &self.linear,
            &Vector3::repeat(mass),
            to.velocity.map(|v| rotation.tr_mul(&(v - velocity))),
            to.position.map(|x| rotation.tr_mul(&(x - position))),
        );
        let relative = to.rotation.map(|r| rotation.tr_mul(&r));
        let angular = pull(
            &self.angular,
            rotary,
            // An angular velocity belongs to the measured body frame, if there is one.
            to.spin
                .map(|w| relative.map_or(w, |relative| relative * w) - spin),
            relative.map(|relative| log(&relative)),
        );
        [rotation * linear, angular]
    }
}

impl Estimator for BoundaryObserver {
    fn advance(&mut self, command: &Command, until: f64) -> Result<(), EstimateError> {
        self.predictor.check(command)?;
        let Estimate {
            time,
            state,
            disturbance,
            ..
        } = &mut self.estimate;
        if let Some(steps) = self.predictor.steps(*time, until)? {
            (self.predictor).roll_out(state, steps, command, disturbance, |_| ())?;
            state.clone_from(self.predictor.end());
            *time = until;
            self.remember(command, until);
            if self.n_pieces == MOST_PIECES {
                self.drop_anchor();
            }
        }
        self.estimate.time = until;
        Ok(())
    }

    fn correct(&mut self, measurement: &Measurement) -> Result<Innovation, EstimateError> {
        check_time(measurement.time, self.estimate.time)?;
        let rod = self.predictor.changed(&self.estimate.disturbance);
        let known = |signal: &crate::signal::Signal| {
            signal.place > 1.0 - AT_TIP
                && matches!(
                    signal.reading,
                    Reading::Position(_)
                        | Reading::Rotation(_)
                        | Reading::Velocity(_)
                        | Reading::AngularVelocity(_)
                )
        };
        (self.comparison).compare(rod, &self.estimate, measurement, None, known)?;
        let innovation = self.comparison.innovation();
        if innovation.n == 0 && !measurement.signals.is_empty() {
            return Err(EstimateError::Unusable {
                expected: "it needs position, rotation or velocities at place 1, the tip",
            });
        }
        let target = Tip::of(measurement);
        if self.n_pieces == 0 {
            // The measurement belongs to the time of the last one.
            let before = self.tip.filter(|_| self.anchor.time == self.estimate.time);
            self.tip = Some(before.map_or(target, |before| target.or(&before)));
            self.drop_anchor();
            return Ok(innovation);
        }
        let disturbance = self.replay(&target)?;
        std::mem::swap(&mut self.estimate.state, &mut self.next);
        self.estimate.disturbance = disturbance;
        self.tip = Some(target);
        self.drop_anchor();
        Ok(innovation)
    }

    fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    fn restart(&mut self, time: f64, state: &State) -> Result<(), MpcError> {
        check_start(self.predictor.model(), time, state)?;
        self.estimate.time = time;
        self.estimate.state.clone_from(state);
        self.estimate.disturbance = Disturbance::NONE;
        self.tip = None;
        self.drop_anchor();
        Ok(())
    }
}
