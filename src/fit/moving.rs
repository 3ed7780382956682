//! Recordings: the places at which a motion is seen, and their derivatives along what is fitted.
//!
//! Offsets of markers change what is seen of the motion as it is. Several numbers of the arm change an implicit motion by what [`SlopedMotion`]
//! takes along with it. Others have motions of their own, two a number: explicit steps are cheaper than the equations from which sweeps come.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{DMatrix, DVector};

use super::least_squares::Beside;
use super::{FitError, Model, Pose, Steps};
use crate::mechanics::rollout;
use crate::mechanics::rotation::{exp, log};
use crate::mechanics::sloped_motion::{SlopedError, SlopedMotion};
use crate::mechanics::threads::on_threads;
use crate::mechanics::{Configuration, Rod, State, TimeGrid, TimeScheme};
use crate::scene::Simulation;

impl Pose {
    /// Returns the pose after a part of the way to another one: linear in the place, and along the shortest turn.
    pub fn toward(&self, to: &Self, part: f64) -> Self {
        let turn = log(&self.section.tr_mul(&to.section));
        Self {
            place: self.place + (to.place - self.place) * part,
            section: self.section * exp(&(turn * part)),
            turn_of_arm: self.turn_of_arm + part * (to.turn_of_arm - self.turn_of_arm),
        }
    }
}

/// The time of a sight: the time node at the end of a step, or the first one, and the part of the step that is over.
#[derive(Clone, Copy, Debug)]
pub struct Instant {
    pub node: usize,
    pub part: f64,
}

impl Instant {
    /// Returns that of a time, s.
    pub fn of(grid: &TimeGrid, time: f64) -> Self {
        let steps = time.max(0.0) / grid.step;
        let needed = (steps - 1e-9).ceil().max(0.0) as usize;
        let node = needed.min(grid.n_steps);
        Self {
            node,
            part: 1.0 - (node as f64 - steps).clamp(0.0, 1.0),
        }
    }

    /// Returns the time nodes beside it.
    pub fn nodes(self) -> [usize; 2] {
        [self.node.saturating_sub(1), self.node]
    }
}

/// The fewest numbers of the arm for which a sweep pays.
pub type Fewest = fn(TimeScheme) -> usize;

/// Returns the fewest numbers of the arm for which a sweep pays, which costs as much as some five implicit motions and a part of one more for
/// each number, beside two motions of each; it costs more than explicit ones (decision 135).
pub fn fewest(scheme: TimeScheme) -> usize {
    match scheme {
        TimeScheme::Explicit => usize::MAX,
        TimeScheme::Implicit => 8,
    }
}

/// The way in which a recording follows a number of the arm.
enum Follows {
    /// By a sweep along the motion.
    Swept(Box<Along>),
    /// Not at all.
    Not,
    /// By motions of its own.
    Alone,
}

/// A number of the arm.
struct Along {
    /// Index among the parameters.
    parameter: usize,
    /// The arms with more and less of it.
    beside: rollout::Beside,
    /// Their [places of the nodes](crate::mechanics::Rod::places).
    places: [Vec<f64>; 2],
}

/// Residuals of a recording at points beside one; `None` where these need motions of their own.
type Swept = Vec<Option<Result<DVector<f64>, FitError>>>;

impl Model<'_> {
    /// Returns the derivatives of the residuals `here` of some recordings along the parameters, recording by recording, from points beside `at`.
    ///
    /// # Errors
    /// Returns [`FitError`] where a number needs motions of its own, and these break down.
    pub(super) fn motion_jacobians(
        &self,
        at: &[f64],
        here: &DVector<f64>,
        (cases, steps): (&[usize], &Steps),
        (beside, fewest): (&Beside, Fewest),
    ) -> Result<Vec<DMatrix<f64>>, FitError> {
        let swept = on_threads(cases.len(), self.n_threads, |i| {
            match self.swept(at, (cases[i], steps), beside, fewest) {
                Err(FitError::Stopped(stop)) => Err(FitError::Stopped(stop)),
                // Where a motion cannot be linearized, there may be others beside it.
                Err(_) => Ok(beside.points.iter().map(|_| None).collect()),
                found => found,
            }
        })?;
        let mut first = 0;
        let mut parts = Vec::with_capacity(cases.len());
        for (&case, mut found) in cases.iter().zip(swept) {
            let n = 3 * self.cases[case].n_seen();
            let rows = here.rows(first, n).into_owned();
            first += n;
            let alone: Vec<usize> = (0..found.len()).filter(|&i| found[i].is_none()).collect();
            let points: Vec<Vec<f64>> = alone.iter().map(|&i| beside.points[i].clone()).collect();
            let blocks = self.blocks(&points, steps, None, &[case]);
            for (&i, blocks) in alone.iter().zip(blocks) {
                found[i] = Some(blocks.map(|blocks| DVector::from_vec(blocks.concat())));
            }
            parts.push(beside.differences(&rows, found.into_iter().flatten().collect())?);
        }
        Ok(parts)
    }

    /// Returns the residuals of a recording at points beside `at`, to first order in what changes the motion.
    ///
    /// # Errors
    /// Returns [`FitError`] where the motion has no next step or cannot be linearized, and if it is stopped.
    fn swept(
        &self,
        at: &[f64],
        (index, steps): (usize, &Steps),
        beside: &Beside,
        fewest: Fewest,
    ) -> Result<Swept, FitError> {
        let here = self.simulation(at, (index, steps))?;
        // Clocks move the end of a motion, and its time nodes with it; lags change the inputs over time.
        let mut is_alone: Vec<bool> = (self.parameters.iter())
            .map(|own| own.marker.is_none() && own.play.is_empty())
            .collect();
        let of_arm: Vec<usize> = (0..is_alone.len())
            .filter(|&j| is_alone[j] && self.parameters[j].clock.is_empty())
            .filter(|&j| self.parameters[j].lag.is_empty())
            .collect();
        let mut along = Vec::new();
        if of_arm.len() >= fewest(here.rod.scheme) {
            for parameter in of_arm {
                let found = self.follows(parameter, (index, steps), &here, beside)?;
                is_alone[parameter] = matches!(found, Follows::Alone);
                if let Follows::Swept(own) = found {
                    along.push(*own);
                }
            }
        }
        if is_alone.iter().all(|own| *own) {
            return Ok(beside.points.iter().map(|_| None).collect());
        }
        let poses = self.poses_beside(at, (index, &here), (beside, &along))?;
        let late = self.clock(at, index);
        let residuals = |i: usize| {
            let mut out = Vec::new();
            for sight in &self.cases[index].sights {
                let instant = Instant::of(&here.grid, sight.time - late);
                let [from, to] = instant.nodes().map(|node| &poses[&(node, sight.marker)][i]);
                self.append_residuals(&from.toward(to, instant.part), sight, &mut out);
            }
            Ok(DVector::from_vec(out))
        };
        Ok((0..beside.points.len())
            .map(|i| (!is_alone[i / 2]).then(|| residuals(i)))
            .collect())
    }

    /// Returns the poses of markers at all time nodes beside what was seen of them, at every point beside `at`.
    fn poses_beside(
        &self,
        at: &[f64],
        (index, here): (usize, &Simulation),
        (beside, along): (&Beside, &[Along]),
    ) -> Result<BTreeMap<(usize, usize), Vec<Pose>>, FitError> {
        let mut seen: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
        let late = self.clock(at, index);
        for sight in &self.cases[index].sights {
            for node in Instant::of(&here.grid, sight.time - late).nodes() {
                seen.entry(node).or_default().insert(sight.marker);
            }
        }
        let numbers: Vec<rollout::Beside> = along.iter().map(|own| own.beside.clone()).collect();
        let places = here.rod.places();
        // On one thread: several have too little to do between two sights, and other recordings have theirs.
        let mut motion = SlopedMotion::new(
            (&here.rod, here.grid),
            &here.initial,
            &numbers,
            (1, self.stop),
        );
        let mut poses = BTreeMap::new();
        for (node, markers) in seen {
            motion.advance_to(node).map_err(|error| match error {
                SlopedError::Stopped(stop) => FitError::Stopped(stop),
                SlopedError::Step(error) => FitError::Step {
                    case: self.cases[index].name.clone(),
                    error,
                },
            })?;
            let state = motion.state();
            let mut shapes: Vec<Option<(Configuration, &[f64])>> =
                beside.points.iter().map(|_| None).collect();
            for (own, slope) in along.iter().zip(motion.slopes()) {
                let [rise, fall] = beside.widths[own.parameter];
                for (side, way) in [rise, -fall].into_iter().enumerate() {
                    let shape = state.retract(&slope.scaled(way)).configuration;
                    shapes[2 * own.parameter + side] = Some((shape, &own.places[side]));
                }
            }
            for marker in markers {
                let own = |(point, shape): (&Vec<f64>, &Option<(Configuration, &[f64])>)| {
                    let still = (&state.configuration, &places[..]);
                    let (shape, places) = shape.as_ref().map_or(still, |(own, at)| (own, *at));
                    self.pose(places, shape, marker, point)
                };
                let own = beside.points.iter().zip(&shapes).map(own).collect();
                poses.insert((node, marker), own);
            }
        }
        Ok(poses)
    }

    /// Returns how a recording follows a number of the arm.
    ///
    /// # Errors
    /// Returns [`FitError::Stopped`].
    fn follows(
        &self,
        parameter: usize,
        (index, steps): (usize, &Steps),
        here: &Simulation,
        beside: &Beside,
    ) -> Result<Follows, FitError> {
        let mut width = 0.0;
        let mut sides = Vec::new();
        for (side, part) in beside.widths[parameter].into_iter().enumerate() {
            let found = self.simulation(&beside.points[2 * parameter + side], (index, steps));
            self.stop.check().map_err(FitError::Stopped)?;
            // Beside the end of the range of a number there is one side.
            let side = match found {
                Ok(side) => {
                    width += part;
                    (side.rod, side.initial, side.grid)
                }
                Err(_) => (here.rod.clone(), here.initial.clone(), here.grid),
            };
            sides.push(side);
        }
        let is_like = |(rod, _, grid): &(Rod, State, TimeGrid)| {
            SlopedMotion::knows(&here.rod, rod)
                && (grid.step - here.grid.step).abs() <= SAME_STEP * here.grid.step
        };
        if !(width > 0.0 && sides.iter().all(is_like)) {
            return Ok(Follows::Alone);
        }
        let [ahead, behind] = [sides.remove(0), sides.remove(0)];
        if ahead.0 == behind.0 && ahead.1 == behind.1 {
            return Ok(Follows::Not);
        }
        Ok(Follows::Swept(Box::new(Along {
            parameter,
            places: [ahead.0.places(), behind.0.places()],
            beside: rollout::Beside {
                rods: [ahead.0, behind.0],
                initial: [ahead.1, behind.1],
                width,
            },
        })))
    }

    /// Returns the setup of a recording.
    fn simulation(
        &self,
        at: &[f64],
        (index, steps): (usize, &Steps),
    ) -> Result<Simulation, FitError> {
        let (scene, source) = self.scene(at, index, steps.get(&index), &[])?;
        Ok(scene.simulation_until(&source, self.stop)?)
    }
}

/// Largest relative difference of steps that are the same but for rounding and the time by which a clock is ahead.
const SAME_STEP: f64 = 1e-3;

#[cfg(test)]
mod tests {
    use super::super::{FitOptions, data, entries, free};
    use super::*;
    use crate::scene::SceneSource;
    use crate::stop::StopSignal;

    /// An arm with a tendon, a payload and damping that is let go.
    const SCENE: &str = "[rod]
length_m = 0.4
elements = 6
[rod.material]
youngs_modulus_pa = 8e5
poisson_ratio = 0.4
density_kg_m3 = 1050.0
[rod.section]
radius_m = 0.01
[rod.reference]
curvature_1_m = [0.0, 2.0, 0.5]
[base]
position_m = [0.1, 0.0, 0.0]
[gravity]
acceleration_m_s2 = [0.5, 0.3, -9.81]
[damping]
viscous_1_s = 1.0
internal_s = 2e-3
[[tendon]]
offset_m = [0.006, 0.002]
pretension_n = 0.5
[payload]
mass_kg = 0.01
[time]
end_s = 0.2
";

    const DATA: &str = "sigma_m = 1e-3
sigma_rad = 0.05
[[marker]]
name = \"tip\"
at = 1.0
[[marker]]
name = \"mid\"
at = 0.47
offset_m = [0.01, 0.0, 0.0]
[[recording]]
csv = \"one.csv\"
[[recording]]
csv = \"two.csv\"
set = [\"tendon.0.pretension_n=0.8\"]
[[free]]
key = \"offsets\"
times = [\"tendon.0.offset_m.0\", \"tendon.0.offset_m.1\"]
[[free]]
key = \"load cell\"
times = [\"tendon.0.pretension_n\"]
";

    /// Keys of the scene and of what measures it: those of the arm first.
    const KEYS: [&str; 12] = [
        "rod.material.youngs_modulus_pa",
        "rod.material.density_kg_m3",
        "damping.viscous_1_s",
        "damping.internal_s",
        "payload.mass_kg",
        "rod.section.radius_m",
        "rod.length_m",
        "rod.reference.curvature_1_m",
        "base.position_m",
        "gravity.acceleration_m_s2",
        "clock_s",
        "marker.mid.offset_m.1",
    ];

    /// Evaluates on a model of two recordings, whose places nobody need have measured, under the given overrides.
    fn on_model(overrides: &[String], of: impl Fn(&Model)) {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("data.toml");
        let write = |name: &str, text: &str| {
            std::fs::write(folder.path().join(name), text).expect("a file");
        };
        write("data.toml", DATA);
        let mut one = String::from("t_s,tip_x_m,tip_y_m,tip_z_m\n0.0,0.2,0.0,0.3\n");
        let mut two = String::from("t_s,mid_x_m,mid_y_m,mid_z_m,mid_qw,mid_qx,mid_qy,mid_qz\n");
        for row in 1..8 {
            let t = 0.02137 * f64::from(row);
            one += &format!("{t},0.2,0.01,0.3\n");
            two += &format!("{t},0.1,0.01,0.2,0.8,0.0,0.6,0.0\n");
        }
        write("one.csv", &one);
        write("two.csv", &two);
        let source = SceneSource {
            name: "arm".into(),
            text: SCENE.into(),
            overrides: overrides.to_vec(),
        };
        let options = FitOptions {
            free: KEYS.map(String::from).to_vec(),
            robust: false,
            n_threads: 2,
        };
        let stop = StopSignal::default();
        let (data, cases) = data::read(&path).expect("data");
        let own = entries(&source, &[], (&[], &[])).expect("a scene");
        let tables: Vec<toml::Table> = (cases.iter())
            .map(|case| entries(&source, &case.set, (&[], &[])).expect("a scene"))
            .collect();
        let parameters =
            free::parameters(&own, (&tables, &cases), &data, &options).expect("numbers");
        of(&Model::of(
            (&source, &options, &stop),
            (&data, &cases),
            &tables,
            &parameters,
        ));
    }

    /// Returns derivatives of residuals by differences of motions whose error is of fourth order.
    fn by_motions(model: &Model, at: &[f64], steps: &Steps, width: f64) -> DMatrix<f64> {
        let residuals = |j: usize, x: f64| {
            let mut point = at.to_vec();
            point[j] += x;
            let mut found = model.residuals(&[point], steps);
            found.remove(0).expect("a motion")
        };
        let columns: Vec<DVector<f64>> = (0..at.len())
            .map(|j| {
                let central = |h: f64| (residuals(j, h) - residuals(j, -h)) / (2.0 * h);
                (4.0 * central(0.5 * width) - central(width)) / 3.0
            })
            .collect();
        DMatrix::from_columns(&columns)
    }

    /// Explicit and implicit steps with a tendon, damping, a payload and a base elsewhere: the derivatives by sweeps are those of motions
    /// beside, along numbers of the arm, the place of the base and that of a marker; the clock has motions of its own.
    #[test]
    fn sweeps_are_differences_of_motions() {
        for scheme in ["explicit", "implicit"] {
            on_model(&[format!("time.integrator=\"{scheme}\"")], |model| {
                // A clock that is ahead leaves the end of the motion, and with it the step, as it is.
                let mut at = model.start();
                let clock = model.parameters.iter().position(|own| own.key == "clock_s");
                at[clock.expect("a clock")] = 0.5;
                let steps = model.steps(&at).expect("steps");
                let here = model
                    .residuals(&[at.clone()], &steps)
                    .remove(0)
                    .expect("a motion");
                let beside = Beside::of(&at, &model.bounds());
                let cases: Vec<usize> = (0..model.cases.len()).collect();
                for case in &cases {
                    let swept = model.swept(&at, (*case, &steps), &beside, |_| 0);
                    let swept = swept.expect("a sweep");
                    for (i, found) in swept.iter().enumerate() {
                        let is_clock = Some(i / 2) == clock;
                        assert_eq!(found.is_some(), !is_clock, "{scheme}, point {i}");
                    }
                }
                let found = model
                    .motion_jacobians(&at, &here, (&cases, &steps), (&beside, |_| 0))
                    .expect("sweeps");
                let found = super::super::stacked(&found, at.len());
                let expected = by_motions(model, &at, &steps, 1e-3);
                for (j, own) in model.parameters.iter().enumerate() {
                    let (found, expected) = (found.column(j), expected.column(j));
                    let error = (found - expected).amax() / expected.amax();
                    assert!(error < 1e-6, "{scheme}, {}: {error:.1e}", own.key);
                }
            });
        }
    }

    /// A motion that breaks down, here under far too large a weight, is refused as a motion is, with the name of its recording.
    #[test]
    fn motions_that_break_down_are_refused() {
        let overrides = [
            "gravity.acceleration_m_s2=[1e7, 0.0, 0.0]".to_string(),
            "time.integrator=\"explicit\"".to_string(),
        ];
        on_model(&overrides, |model| {
            let at = model.start();
            let steps: Steps = (0..2).map(|case| (case, (2e-4, "explicit"))).collect();
            let alone = model.residuals(std::slice::from_ref(&at), &steps).remove(0);
            let beside = Beside::of(&at, &model.bounds());
            let here =
                DVector::zeros(3 * model.cases.iter().map(|case| case.n_seen()).sum::<usize>());
            let swept = model.motion_jacobians(&at, &here, (&[0, 1], &steps), (&beside, |_| 0));
            let (alone, swept) = (alone.expect_err("no motion"), swept.expect_err("no motion"));
            assert!(matches!(alone, FitError::Step { .. }), "{alone}");
            assert!(matches!(swept, FitError::Step { .. }), "{swept}");
            assert!(swept.to_string().starts_with("one.csv"), "{swept}");
        });
    }
}
