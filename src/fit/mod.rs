//! Fits numbers of a scene to measured places of markers on its arm: least squares over shapes at rest and recorded motions, with standard
//! errors, correlations, and the combinations that the data cannot tell.

mod assumed;
mod data;
mod explained;
mod free;
mod lag;
mod least_squares;
mod left;
mod moving;
mod report;
mod resting;
mod rows;
mod written;
mod zeros;

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::path::Path;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

pub use self::assumed::Assumption;
use self::assumed::{Assumed, Kind};
use self::data::{Case, Marker, Sight};
pub use self::explained::Explanation;
use self::free::{Free, parameters, refuse_set};
use self::least_squares::{Beside, Minimum, Problem, stacked};
pub use self::left::{Left, Part};
use self::moving::{Instant, fewest};
pub use self::report::FitSummary;
use self::resting::Remembered;
use self::written::Written;
use crate::mechanics::equilibrium::static_equilibrium_until;
use crate::mechanics::place::{locate, pose};
use crate::mechanics::rotation::log;
use crate::mechanics::threads::on_threads;
use crate::mechanics::{Configuration, NodeSpring, NodeWrenches, Rod, Stepper, TimeScheme};
use crate::output::{MotionRecord, ResidualRow};
use crate::scene::{Scene, SceneError, SceneSource, number, set_entry};
use crate::stop::{Stop, StopSignal};
use crate::task::{Arm, StartShape};

/// The reason why nothing is fitted.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// The measurements cannot be read, or a key cannot be fitted.
    #[error("{0}")]
    Data(String),
    /// The scene is not valid with the values of a case or of the search.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A motion of a recording breaks down.
    #[error("{case}: {error}")]
    Step {
        /// The recording.
        case: String,
        /// The reason.
        error: crate::mechanics::StepError,
    },
    /// The work was stopped.
    #[error("{0}")]
    Stopped(Stop),
}

/// Keys that are fitted, and the way of fitting them.
#[derive(Clone, Debug)]
pub struct FitOptions {
    /// Dotted paths of the numbers.
    pub free: Vec<String>,
    /// Tells whether far residuals weigh less, by Huber's function.
    pub robust: bool,
    /// Number of threads.
    pub n_threads: usize,
}

/// A fit.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The scene with the fitted numbers.
    pub scene: Scene,
    /// Its arm.
    pub arm: Arm,
    /// Its rod.
    pub rod: Rod,
    /// Estimates, their errors and the residuals.
    pub summary: FitSummary,
    /// Every place that was seen, in the order of the cases.
    pub rows: Vec<ResidualRow>,
    /// The predicted shapes at rest, with their numbers from one on as times; those with other elements than the scene are left out.
    pub shapes: MotionRecord,
}

/// Fits numbers of a scene to a file of measurements.
///
/// # Errors
/// Returns [`FitError`] for data or keys that cannot be used, and where the scene cannot be computed at the start.
pub fn fit(
    source: &SceneSource,
    path: &Path,
    options: &FitOptions,
    stop: &StopSignal,
) -> Result<Fit, FitError> {
    let (data, cases) = data::read(path).map_err(FitError::Data)?;
    let free: Vec<&String> = (options.free.iter())
        .chain(data.free.iter().map(|free| &free.key))
        .collect();
    let plus: Vec<&String> = data.free.iter().flat_map(|free| &free.plus).collect();
    let own = entries(source, &[], (&free, &plus))?;
    let tables: Vec<toml::Table> = (cases.iter())
        .map(|case| entries(source, &case.set, (&free, &plus)))
        .collect::<Result<_, _>>()?;
    let parameters = parameters(&own, (&tables, &cases), &data, options)?;
    refuse_set(&parameters, &cases)?;
    let begun = std::time::Instant::now();
    let mut model = Model::of(
        (source, options, stop),
        (&data, &cases),
        &tables,
        &parameters,
    );
    model.check_count()?;
    model.remembered = model.remember()?;
    let n_seen = model.fitted().map(Case::n_seen).sum::<usize>();
    let groups = if options.robust {
        (0..n_seen).map(|i| 3 * i..3 * i + 3).collect()
    } else {
        Vec::new()
    };
    let mut steps = model.steps(&model.start())?;
    let mut found = model.minimum(&model.start(), &steps, &groups)?;
    for _ in 0..MOST_STEPS {
        let anew = model.steps(&found.at)?;
        if !are_too_long(&steps, &anew) {
            break;
        }
        steps = anew;
        let iterations = found.iterations;
        found = model.minimum(&found.at, &steps, &groups)?;
        found.iterations += iterations;
    }
    let Written {
        scene,
        source: fitted,
        advice,
    } = model.written(&found.at, &own)?;
    let arm = scene.arm(&fitted)?;
    let rod = (arm.rod(&scene.discretization()))
        .map_err(|error| scene.discretize_error(&fitted, error.into()))?;
    let predicted = model.predicted(&found.at, &steps)?;
    let shapes = model.shapes(&found.at, &rod)?;
    let (mut summary, rows) = report::summary(&model, &found, &predicted, &steps)?;
    summary.advice = advice;
    summary.wall_s = begun.elapsed().as_secs_f64();
    Ok(Fit {
        scene,
        arm,
        rod,
        summary,
        rows,
        shapes,
    })
}

/// Returns the entries of a resolved scene, with those of some paths that are not written out because they are zero: of all to which
/// numbers are added, and of free ones that may be negative, for which zero is a start.
fn entries(
    source: &SceneSource,
    set: &[String],
    (free, plus): (&[&String], &[&String]),
) -> Result<toml::Table, FitError> {
    let overrides = [&source.overrides[..], set].concat();
    let (scene, _) = Scene::from_toml(&source.name, &source.text, &overrides)?;
    let mut out = toml::from_str(&scene.to_toml())
        .map_err(|error: toml::de::Error| FitError::Data(error.to_string()))?;
    for path in free.iter().chain(plus) {
        if !path.contains('.') || number(&out, path).is_some() {
            continue;
        }
        let with = |value: f64| {
            let own = [&overrides[..], &[format!("{path}={value:e}")]].concat();
            Scene::from_toml(&source.name, &source.text, &own).map(|(scene, _)| scene)
        };
        let is_zero = with(0.0).is_ok_and(|other| other == scene);
        if is_zero && (plus.contains(path) || with(-f64::MIN_POSITIVE).is_ok()) {
            set_entry(&mut out, &format!("{path}=0.0"))?;
        }
    }
    Ok(out)
}

/// Standard deviations of the noise.
#[derive(Clone, Copy)]
struct Sigma {
    /// Standard deviation of a coordinate, m.
    place: f64,
    /// Standard deviation of an orientation about an axis, rad.
    angle: f64,
}

/// A marker as it is predicted.
struct Pose {
    /// Place, m.
    place: Vector3<f64>,
    /// Rotation from the frame of its section to space.
    section: Matrix3<f64>,
    /// Turn of the arm: the sum of the angles between the tangents of neighboring nodes, rad.
    turn_of_arm: f64,
}

impl Pose {
    /// Returns the vector from the measured to the predicted place, m.
    fn off(&self, sight: &Sight) -> Option<Vector3<f64>> {
        Some(self.place - sight.position?)
    }

    /// Returns the rotation vector from the measured to the predicted orientation, in the frame of the measured section, rad.
    fn turn(&self, sight: &Sight) -> Option<Vector3<f64>> {
        Some(log(&sight.orientation?.tr_mul(&self.section)))
    }
}

/// Predicts what was measured.
struct Model<'a> {
    /// The actuators and last shapes of every case that is a table.
    remembered: Vec<Option<Remembered>>,
    source: &'a SceneSource,
    markers: &'a [Marker],
    cases: &'a [Case],
    /// Entries of the scenes of the cases.
    tables: &'a [toml::Table],
    parameters: &'a [Free],
    sigma: Sigma,
    n_threads: usize,
    stop: &'a StopSignal,
}

/// Time step, s, and scheme of every recording, which a search keeps: those that changed with the stiffness would make the residuals jump.
/// Where a search ends with numbers for which they are too long, another one begins there with steps chosen anew.
type Steps = BTreeMap<usize, (f64, &'static str)>;

/// Most times that steps are chosen anew; each may make the arm stiffer by a factor of four.
const MOST_STEPS: usize = 12;
/// Steps are chosen anew where they are longer by this factor than those of the numbers that were found.
const TOO_LONG: f64 = 1.25;

/// Tells whether steps are too long, or of another scheme, beside those that are chosen anew.
fn are_too_long(steps: &Steps, anew: &Steps) -> bool {
    (steps.values().zip(anew.values()))
        .any(|(own, anew)| own.1 != anew.1 || own.0 > TOO_LONG * anew.0)
}

/// Part of the automatic step with which recordings are simulated by explicit steps, so that the arm may become stiffer by a factor of four
/// in the search.
const EXPLICIT_STEP: f64 = 0.5;
/// That of implicit steps, whose automatic step has an error that would show beside standard errors (docs/fitting.md).
const IMPLICIT_STEP: f64 = 0.125;

impl<'a> Model<'a> {
    fn of(
        (source, options, stop): (&'a SceneSource, &FitOptions, &'a StopSignal),
        (data, cases): (&'a data::Data, &'a [Case]),
        tables: &'a [toml::Table],
        parameters: &'a [Free],
    ) -> Self {
        Self {
            remembered: Vec::new(),
            source,
            markers: &data.marker,
            cases,
            tables,
            parameters,
            sigma: Sigma {
                place: data.sigma_m,
                angle: data.sigma_rad.unwrap_or(1.0),
            },
            n_threads: options.n_threads,
            stop,
        }
    }

    fn start(&self) -> Vec<f64> {
        self.parameters
            .iter()
            .map(|own| own.start / own.scale)
            .collect()
    }

    fn fitted(&self) -> impl Iterator<Item = &Case> {
        self.cases.iter().filter(|case| !case.held_out)
    }

    /// Returns the overrides of a case under parameters, but for those of [`Self::changed`].
    fn overrides(&self, at: &[f64], set: &[String]) -> Vec<String> {
        let own = self.source.overrides.iter().chain(set).cloned();
        let values = (self.parameters.iter().zip(at))
            .filter(|(own, _)| own.is_key() && own.list.is_none())
            .map(|(own, at)| format!("{}={:e}", own.key, at * own.scale));
        own.chain(values).chain(self.lists(at)).collect()
    }

    /// Returns the numbers that factors and summands change, by their paths; `table` has the entries of the scene.
    fn changed(&self, at: &[f64], table: &toml::Table) -> Vec<(String, String)> {
        let related = self.parameters.iter().flat_map(Free::related);
        let related: std::collections::BTreeSet<&String> = related.collect();
        (related.into_iter())
            .filter_map(|path| Some((path, number(table, path)?)))
            .map(|(path, value)| {
                let setter = format!("{path}={:e}", self.given(at, path, value));
                (path.clone(), setter)
            })
            .collect()
    }

    /// Returns the overrides of lists that are fitted as a whole, whose entries follow each other.
    fn lists(&self, at: &[f64]) -> Vec<String> {
        let mut out: Vec<(&str, Vec<String>)> = Vec::new();
        for (own, at) in self.parameters.iter().zip(at) {
            let Some(list) = &own.list else {
                continue;
            };
            let number = format!("{:e}", at * own.scale);
            match out.last_mut().filter(|(key, _)| key == list) {
                Some((_, numbers)) => numbers.push(number),
                None => out.push((list, vec![number])),
            }
        }
        (out.into_iter())
            .map(|(key, numbers)| format!("{key}=[{}]", numbers.join(",")))
            .collect()
    }

    /// Checks that there are no fewer numbers than keys.
    fn check_count(&self) -> Result<(), FitError> {
        if self.fitted().map(Case::n_seen).sum::<usize>() < self.parameters.len().div_ceil(3) {
            return Err(FitError::Data(
                "there are fewer numbers than free keys; measure more, or fit less".into(),
            ));
        }
        Ok(())
    }

    /// Searches from a point with given steps; `groups` are those of [`Problem`].
    fn minimum(
        &self,
        start: &[f64],
        steps: &Steps,
        groups: &[std::ops::Range<usize>],
    ) -> Result<Minimum, FitError> {
        let has_others = self.fitted().any(|case| !case.is_static());
        let jacobian = |at: &[f64], here: &DVector<f64>| self.jacobian(at, here, steps);
        let problem = Problem {
            residuals: &|points: &[Vec<f64>]| self.residuals(points, steps),
            bounds: self.bounds(),
            jacobian: has_others.then_some(&jacobian),
            groups: groups.to_vec(),
        };
        problem.minimize(start)
    }

    fn bounds(&self) -> Vec<[f64; 2]> {
        self.parameters.iter().map(Free::scaled_bounds).collect()
    }

    /// Returns the derivatives of the residuals `here`: of shapes by differences, of recordings, which come after them, by sweeps, and of tables,
    /// which come last, by the implicit function theorem.
    ///
    /// # Errors
    /// Returns [`FitError`] where one of these cannot be computed.
    fn jacobian(
        &self,
        at: &[f64],
        here: &DVector<f64>,
        steps: &Steps,
    ) -> Result<DMatrix<f64>, FitError> {
        let beside = Beside::of(at, &self.bounds());
        let of = |is: &dyn Fn(&Case) -> bool| -> Vec<usize> {
            let fitted = (0..self.cases.len()).filter(|&case| !self.cases[case].held_out);
            fitted.filter(|&case| is(&self.cases[case])).collect()
        };
        let shapes = of(&Case::is_static);
        let found = (self
            .blocks(&beside.points, steps, None, &shapes)
            .into_iter())
        .map(|blocks| blocks.map(|blocks| DVector::from_vec(blocks.concat())))
        .collect();
        let n = shapes
            .iter()
            .map(|&case| 3 * self.cases[case].n_seen())
            .sum();
        let mut parts = vec![beside.differences(&here.rows(0, n).into_owned(), found)?];
        let rest = here.rows(n, here.len() - n).into_owned();
        let motions = of(&Case::is_motion);
        parts.extend(self.motion_jacobians(at, &rest, (&motions, steps), (&beside, fewest))?);
        for case in of(&|case| case.rows().is_some()) {
            parts.push(self.table_jacobian(at, case, &beside)?);
        }
        for (j, own) in self.parameters.iter().enumerate() {
            if let Some([_, sigma]) = own.prior {
                let mut row = DMatrix::zeros(1, at.len());
                row[(0, j)] = own.scale / sigma;
                parts.push(row);
            }
        }
        Ok(stacked(&parts, at.len()))
    }

    /// Returns the value of a number that the scene or a row has, under the factors and summands of it that are fitted.
    fn given(&self, at: &[f64], path: &str, value: f64) -> f64 {
        let has = |paths: &[String]| paths.iter().any(|own| own == path);
        let own = || self.parameters.iter().zip(at);
        let times = own().filter(|(own, _)| has(&own.times));
        let product = times.fold(value, |value, (own, at)| value * at * own.scale);
        let plus = own().filter(|(own, _)| has(&own.plus));
        plus.fold(product, |sum, (own, at)| sum + at * own.scale)
    }

    /// Returns the play of the actuator of a key that a row sets, whose own is `play`.
    fn play(&self, at: &[f64], path: &str, play: f64) -> f64 {
        let mut own = self.parameters.iter().zip(at);
        let found = own.find(|(own, _)| own.play.iter().any(|own| own == path));
        found.map_or(play, |(own, at)| at * own.scale)
    }

    /// Returns the sights of a row of a table.
    fn sights_of_row(&self, case: usize, row: usize) -> &[Sight] {
        let sights = &self.cases[case].sights;
        let before = |row: usize| sights.partition_point(|sight| sight.time < row as f64);
        &sights[before(row)..before(row + 1)]
    }

    /// Appends the residuals of a sight, in standard deviations.
    fn append_residuals(&self, pose: &Pose, sight: &Sight, out: &mut Vec<f64>) {
        let off = pose.off(sight).map(|off| off / self.sigma.place);
        let turn = pose.turn(sight).map(|turn| turn / self.sigma.angle);
        for part in [off, turn].into_iter().flatten() {
            out.extend_from_slice(part.as_slice());
        }
    }

    /// Returns time steps and schemes of recordings.
    fn steps(&self, at: &[f64]) -> Result<Steps, FitError> {
        let mut out = Steps::new();
        for (index, _) in self
            .cases
            .iter()
            .enumerate()
            .filter(|(_, case)| case.is_motion())
        {
            let (scene, source) = self.scene(at, index, None, &[])?;
            let setup = scene.simulation_until(&source, self.stop)?;
            let (part, scheme) = match setup.rod.scheme {
                TimeScheme::Explicit => (EXPLICIT_STEP, "explicit"),
                TimeScheme::Implicit => (IMPLICIT_STEP, "implicit"),
            };
            out.insert(index, (part * setup.grid.step, scheme));
        }
        Ok(out)
    }

    fn scene(
        &self,
        at: &[f64],
        index: usize,
        step: Option<&(f64, &'static str)>,
        more: &[String],
    ) -> Result<(Scene, SceneSource), FitError> {
        let case = &self.cases[index];
        let mut overrides = self.overrides(at, &case.set);
        // The rows of a table have these numbers in the place of the scene.
        let is_row = |path: &String| case.rows().is_some_and(|rows| rows.keys.contains(path));
        let changed = self.changed(at, &self.tables[index]).into_iter();
        overrides.extend(
            changed
                .filter(|(path, _)| !is_row(path))
                .map(|(_, setter)| setter),
        );
        overrides.extend_from_slice(more);
        if !case.is_motion() {
            overrides.push("initial.shape=\"equilibrium\"".into());
        } else {
            let last = case.sights.last().map_or(0.0, |sight| sight.time);
            let end = (last - self.clock(at, index)).max(last);
            overrides.push(format!("time.end_s={:e}", end.max(1e-9)));
            if let Some((step, scheme)) = step {
                overrides.extend(self.lagged(at, &self.tables[index], (end, *step)));
                overrides.push(format!("time.step_s={step:e}"));
                overrides.push(format!("time.integrator=\"{scheme}\""));
            }
        }
        Ok(Scene::from_toml(
            &self.source.name,
            &self.source.text,
            &overrides,
        )?)
    }

    /// Returns the predictions of all sights of a case, with another value of an assumed number if one is given, which differs by this from its own.
    fn case(
        &self,
        at: &[f64],
        index: usize,
        steps: &Steps,
        changed: Option<(&Assumed, f64)>,
    ) -> Result<Vec<Pose>, FitError> {
        let case = &self.cases[index];
        self.stop.check().map_err(FitError::Stopped)?;
        if case.rows().is_some() {
            let (more, loads) = match changed {
                Some((
                    Assumed {
                        kind: Kind::Loads, ..
                    },
                    by,
                )) => (Vec::new(), 1.0 + by),
                Some((assumed, by)) => (assumed.overrides(by, &self.tables[index]), 1.0),
                None => (Vec::new(), 1.0),
            };
            return self.table(at, index, &more, loads);
        }
        let more = changed.map_or_else(Vec::new, |(assumed, by)| {
            assumed.overrides(by, &self.tables[index])
        });
        let (scene, source) = self.scene(at, index, steps.get(&index), &more)?;
        let mut setup = scene.simulation_until(&source, self.stop)?;
        let late = self.clock(at, index)
            + match changed {
                Some((
                    Assumed {
                        kind: Kind::Clock, ..
                    },
                    by,
                )) => by,
                _ => 0.0,
            };
        if let Some((
            Assumed {
                kind: Kind::Loads, ..
            },
            by,
        )) = changed
        {
            setup.rod.multiply_loads(1.0 + by);
            if scene.start().shape == StartShape::Equilibrium {
                let shape = &mut setup.initial.configuration;
                let none = NodeSpring::default();
                *shape = static_equilibrium_until(&setup.rod, shape, 0.0, &none, self.stop)
                    .map_err(|error| FitError::Data(error.to_string()))?;
            }
        }
        let nodes = setup.rod.places();
        let pose = |shape: &Configuration, marker: usize| self.pose(&nodes, shape, marker, at);
        if case.is_static() {
            let shape = &setup.initial.configuration;
            return Ok(case
                .sights
                .iter()
                .map(|sight| pose(shape, sight.marker))
                .collect());
        }
        let mut stepper = Stepper::new(&setup.rod, setup.grid, setup.initial.clone());
        let mut before = setup.initial.configuration.clone();
        let mut now = before.clone();
        let mut out = Vec::with_capacity(case.sights.len());
        for sight in &case.sights {
            let instant = Instant::of(&setup.grid, sight.time - late);
            while stepper.step() < instant.node {
                if stepper.step() + 1 == instant.node {
                    before = stepper.state().configuration;
                }
                stepper
                    .advance([NodeWrenches::NONE; 2])
                    .map_err(|error| FitError::Step {
                        case: case.name.clone(),
                        error,
                    })?;
                if stepper.step() == instant.node {
                    now = stepper.state().configuration;
                }
                self.stop.check().map_err(FitError::Stopped)?;
            }
            let [from, to] = [&before, &now].map(|shape| pose(shape, sight.marker));
            out.push(from.toward(&to, instant.part));
        }
        Ok(out)
    }

    /// Returns the time by which the clock of a recording is ahead of the scene, s.
    fn clock(&self, at: &[f64], case: usize) -> f64 {
        let own = self.parameters.iter().zip(at);
        let own = own.filter(|(own, _)| own.clock.contains(&case));
        own.map(|(own, at)| at * own.scale).sum()
    }

    /// Returns the pose of a marker, given the [places of the nodes](crate::mechanics::Rod::places).
    fn pose(&self, nodes: &[f64], shape: &Configuration, index: usize, at: &[f64]) -> Pose {
        let marker = &self.markers[index];
        let (q, part) = locate(nodes, marker.at);
        let (x, section) = pose(shape, q, part);
        let mut offset = Vector3::from(marker.offset_m);
        for (own, at) in self.parameters.iter().zip(at) {
            if let Some((_, axis)) = own.marker.filter(|(marker, _)| *marker == index) {
                offset[axis] = at * own.scale;
            }
        }
        let place = x + section * offset;
        let turn = |pair: &[Matrix3<f64>]| pair[0].column(2).angle(&pair[1].column(2));
        Pose {
            place,
            section,
            turn_of_arm: shape.rotations.windows(2).map(turn).sum(),
        }
    }

    /// Returns the predictions of all cases.
    fn predicted(&self, at: &[f64], steps: &Steps) -> Result<Vec<Vec<Pose>>, FitError> {
        (0..self.cases.len())
            .map(|index| self.case(at, index, steps, None))
            .collect()
    }

    /// Returns the shapes at rest of arms with as many nodes as a rod.
    fn shapes(&self, at: &[f64], like: &Rod) -> Result<MotionRecord, FitError> {
        let mut out = MotionRecord::empty(like.n_nodes());
        let resting = (0..self.cases.len()).filter(|&index| self.cases[index].is_static());
        for (index, case) in resting.enumerate() {
            let (scene, source) = self.scene(at, case, None, &[])?;
            let setup = scene.simulation_until(&source, self.stop)?;
            if setup.rod.n_nodes() == like.n_nodes() {
                let shape = &setup.initial.configuration;
                out.push_at_rest((index + 1) as f64, &setup.rod, shape, 0.0);
            }
        }
        Ok(out)
    }

    /// Returns the residuals at several points, in standard deviations: those of fitted cases, then those of priors.
    fn residuals(&self, points: &[Vec<f64>], steps: &Steps) -> Vec<Result<DVector<f64>, FitError>> {
        self.residuals_with(points, steps, None)
    }

    /// Returns the residuals at a point with another value of an assumed number.
    fn changed_residuals(
        &self,
        at: &[f64],
        steps: &Steps,
        changed: (&Assumed, f64),
    ) -> Result<DVector<f64>, FitError> {
        let mut found = self.residuals_with(&[at.to_vec()], steps, Some(changed));
        found.remove(0)
    }

    fn residuals_with(
        &self,
        points: &[Vec<f64>],
        steps: &Steps,
        changed: Option<(&Assumed, f64)>,
    ) -> Vec<Result<DVector<f64>, FitError>> {
        let cases: Vec<usize> = (0..self.cases.len())
            .filter(|case| !self.cases[*case].held_out)
            .collect();
        let found = self.blocks(points, steps, changed, &cases);
        (found.into_iter().zip(points))
            .map(|(blocks, point)| {
                let mut out = blocks?.concat();
                for (own, at) in self.parameters.iter().zip(point) {
                    if let Some([prior, sigma]) = own.prior {
                        out.push((at * own.scale - prior) / sigma);
                    }
                }
                Ok(DVector::from_vec(out))
            })
            .collect()
    }

    /// Returns the residuals of some cases at several points, case by case.
    fn blocks(
        &self,
        points: &[Vec<f64>],
        steps: &Steps,
        changed: Option<(&Assumed, f64)>,
        cases: &[usize],
    ) -> Vec<Result<Vec<Vec<f64>>, FitError>> {
        let of = |point: usize| cases.iter().map(move |case| (point, *case));
        let work: Vec<(usize, usize)> = (0..points.len()).flat_map(of).collect();
        // Tables have threads of their own.
        let is_table = |case: usize| self.cases[case].rows().is_some();
        let (tables, work): (Vec<_>, Vec<_>) =
            work.into_iter().partition(|(_, case)| is_table(*case));
        let one = |index: usize| {
            let (point, case) = work[index];
            Ok::<_, Infallible>(self.case(&points[point], case, steps, changed))
        };
        let Ok(found) = on_threads(work.len(), self.n_threads, one);
        let mut others = work.iter().zip(found).peekable();
        let mut tables = tables.into_iter().peekable();
        (0..points.len())
            .map(|point| {
                let mut out = vec![Vec::new(); cases.len()];
                let mut fault = None;
                let mut take = |case: usize, poses: Result<Vec<Pose>, FitError>| match poses {
                    Ok(poses) => {
                        let place = cases.partition_point(|own| *own < case);
                        for (pose, sight) in poses.iter().zip(&self.cases[case].sights) {
                            self.append_residuals(pose, sight, &mut out[place]);
                        }
                    }
                    Err(error) => fault = Some(error),
                };
                while let Some((&(_, case), poses)) = others.next_if(|((own, _), _)| *own == point)
                {
                    take(case, poses);
                }
                while let Some((_, case)) = tables.next_if(|(own, _)| *own == point) {
                    take(case, self.case(&points[point], case, steps, changed));
                }
                match fault {
                    Some(error) => Err(error),
                    None => Ok(out),
                }
            })
            .collect()
    }
}
