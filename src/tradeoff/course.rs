//! A motion sampled independently of its discretization: poses at the same places of the arm and at the same times.

use nalgebra::{Matrix3, Vector3};

use crate::mechanics::place::{locate, pose};
use crate::mechanics::rotation::log;
use crate::mechanics::{
    Configuration, ControlSignal, Energy, NodeWrenches, Rod, State, StepError, Stepper, TimeGrid,
};
use crate::stop::StopSignal;

/// Intervals between the places along the arm at which motions are compared, the fractions `0, 1/8, …, 1` of the length at rest, which
/// nodes of `2^n` elements share. The largest value of a sine of `n` half-waves over `N` intervals is missed by at most `1 - cos(π n/(2
/// N))` of it: by an eighth for two and a half half-waves, as the third mode of a cantilever has.
const PLACES: usize = 8;

/// Intervals between the times at which motions are compared, which 2, 3 and 4 divide. By the same bound, the largest value of a sine of 15
/// half-waves over the motion is missed by at most an eighth.
pub(super) const TIMES: usize = 48;

/// The motion at one time.
#[derive(Clone, Debug)]
struct Glimpse {
    /// Positions at the places, m.
    positions: [Vector3<f64>; PLACES + 1],
    /// Rotation of the tip.
    tip: Matrix3<f64>,
    /// Kinetic and elastic energy, J.
    energy: f64,
}

/// A sampled motion.
#[derive(Clone, Debug)]
pub struct Course {
    glimpses: Vec<Glimpse>,
    /// Largest angle between neighboring nodes divided by their distance at rest, at any of the times, 1/m.
    curvature: f64,
}

/// Differences between two motions of the same arm.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Errors {
    /// Distance of the tips at the end, divided by the length.
    #[serde(deserialize_with = "number")]
    pub tip_end: f64,
    /// Largest distance of the tips at any time, divided by the length.
    #[serde(deserialize_with = "number")]
    pub tip: f64,
    /// Largest distance of any place at any time, divided by the length; the quantity that tolerances limit.
    #[serde(deserialize_with = "number")]
    pub shape: f64,
    /// Largest angle between the tips at any time, rad.
    #[serde(deserialize_with = "number")]
    pub orientation_rad: f64,
    /// Largest difference of kinetic and elastic energy at any time, divided by the largest such energy.
    #[serde(deserialize_with = "number")]
    pub energy: f64,
    /// Difference of the largest curvatures, divided by the largest curvature.
    #[serde(deserialize_with = "number")]
    pub curvature: f64,
}

/// Reads a number for which JSON has `null` if it is not finite.
pub(super) fn number<'de, D: serde::Deserializer<'de>>(source: D) -> Result<f64, D::Error> {
    let number: Option<f64> = serde::Deserialize::deserialize(source)?;
    Ok(number.unwrap_or(f64::NAN))
}

impl Errors {
    /// Returns all differences multiplied by a factor.
    #[must_use]
    pub fn times(self, factor: f64) -> Self {
        Self {
            tip_end: factor * self.tip_end,
            tip: factor * self.tip,
            shape: factor * self.shape,
            orientation_rad: factor * self.orientation_rad,
            energy: factor * self.energy,
            curvature: factor * self.curvature,
        }
    }

    fn is_finite(&self) -> bool {
        // A sum of nonnegative numbers is finite only if all of them are.
        (self.tip_end + self.shape + self.orientation_rad + self.energy + self.curvature)
            .is_finite()
    }
}

impl Course {
    /// Simulates a rod under a control and samples it at [`TIMES`]` + 1` times, `grid.n_steps / `[`TIMES`] steps apart.
    ///
    /// # Errors
    /// Returns [`StepError`] with node, step and time, also if `stop` is raised.
    pub(super) fn of(
        rod: &Rod,
        grid: TimeGrid,
        initial: &State,
        control: Option<&ControlSignal>,
        stop: &StopSignal,
    ) -> Result<Self, StepError> {
        Self::of_times(rod, grid, initial, control, TIMES, stop)
    }

    /// Simulates as [`Self::of`] with `times` intervals between the times of the comparison; `times` must divide the number of steps.
    pub(super) fn of_times(
        rod: &Rod,
        grid: TimeGrid,
        initial: &State,
        control: Option<&ControlSignal>,
        times: usize,
        stop: &StopSignal,
    ) -> Result<Self, StepError> {
        debug_assert!(grid.n_steps.is_multiple_of(times));
        let every = (grid.n_steps / times).max(1);
        let places = rod.places();
        let places: [(usize, f64); PLACES + 1] =
            std::array::from_fn(|i| locate(&places, i as f64 / PLACES as f64));
        let mut course = Self {
            glimpses: Vec::with_capacity(times + 1),
            curvature: 0.0,
        };
        advance(rod, grid, initial, control, stop, |k, stepper| {
            if k.is_multiple_of(every) {
                course.see(rod, &places, &stepper.state());
            }
        })?;
        Ok(course)
    }

    fn see(&mut self, rod: &Rod, places: &[(usize, f64)], state: &State) {
        let at: &Configuration = &state.configuration;
        let mut positions = [Vector3::zeros(); PLACES + 1];
        for (x, &(q, s)) in positions.iter_mut().zip(places) {
            *x = pose(at, q, s).0;
        }
        let energy = Energy::of(rod, state);
        self.glimpses.push(Glimpse {
            positions,
            tip: at.rotations[rod.tip()],
            energy: energy.kinetic + energy.elastic,
        });
        for (q, element) in rod.elements.iter().enumerate() {
            let turn = log(&at.rotations[q].tr_mul(&at.rotations[q + 1])).norm();
            self.curvature = self.curvature.max(turn / element.length);
        }
    }

    /// Returns the differences between this motion and `other`, of an arm of `length` m; infinite if either motion is not finite.
    #[must_use]
    pub fn errors(&self, other: &Self, length: f64) -> Errors {
        let mut out = Errors::default();
        let mut largest_energy = f64::MIN_POSITIVE;
        for (own, theirs) in self.glimpses.iter().zip(&other.glimpses) {
            for (a, b) in own.positions.iter().zip(&theirs.positions) {
                out.shape = worse(out.shape, (a - b).norm() / length);
            }
            out.tip_end = (own.positions[PLACES] - theirs.positions[PLACES]).norm() / length;
            out.tip = worse(out.tip, out.tip_end);
            let turn = log(&own.tip.tr_mul(&theirs.tip)).norm();
            out.orientation_rad = worse(out.orientation_rad, turn);
            out.energy = worse(out.energy, (own.energy - theirs.energy).abs());
            largest_energy = largest_energy.max(theirs.energy.abs());
        }
        out.energy /= largest_energy;
        let curvature = other.curvature.max(f64::MIN_POSITIVE);
        out.curvature = (self.curvature - other.curvature).abs() / curvature;
        if out.is_finite() {
            out
        } else {
            Errors {
                tip_end: f64::INFINITY,
                tip: f64::INFINITY,
                shape: f64::INFINITY,
                orientation_rad: f64::INFINITY,
                energy: f64::INFINITY,
                curvature: f64::INFINITY,
            }
        }
    }
}

/// Returns the larger number, or NaN if either is NaN.
fn worse(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() {
        f64::NAN
    } else {
        a.max(b)
    }
}

/// Steps through a motion; `see` is called at every time node.
pub(super) fn advance(
    rod: &Rod,
    grid: TimeGrid,
    initial: &State,
    control: Option<&ControlSignal>,
    stop: &StopSignal,
    mut see: impl FnMut(usize, &Stepper),
) -> Result<(), StepError> {
    let mut stepper = Stepper::new(rod, grid, initial.clone());
    see(0, &stepper);
    for k in 0..grid.n_steps {
        stop.check_at(k).map_err(StepError::Stopped)?;
        let at = |k| control.map_or(NodeWrenches::NONE, |control| control.at(k));
        stepper.advance([at(k), at(k + 1)])?;
        see(k + 1, &stepper);
    }
    Ok(())
}
