//! Fits numbers of a scene to measured places of markers on its arm: least squares over shapes at rest and recorded motions, with standard
//! errors, correlations, and the combinations that the data cannot tell.

mod assumed;
mod data;
mod explained;
mod least_squares;
mod report;
mod resting;

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

pub use self::assumed::Assumption;
use self::assumed::{Assumed, Kind};
use self::data::{Case, Data, Marker, Sight};
pub use self::explained::Explanation;
use self::least_squares::{Beside, Minimum, Problem};
pub use self::report::FitSummary;
use self::resting::Remembered;
use crate::mechanics::equilibrium::static_equilibrium_until;
use crate::mechanics::place::{locate, pose};
use crate::mechanics::rotation::{exp, log};
use crate::mechanics::{Configuration, NodeSpring, NodeWrenches, Rod, Stepper, TimeScheme};
use crate::output::{MotionRecord, ResidualRow};
use crate::scene::{Scene, SceneError, SceneSource};
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
    let own = entries(source, &[])?;
    let tables: Vec<toml::Table> = (cases.iter())
        .map(|case| entries(source, &case.set))
        .collect::<Result<_, _>>()?;
    let parameters = parameters(&own, (&tables, &cases), &data, options)?;
    refuse_set(&parameters, &cases)?;
    let begun = std::time::Instant::now();
    let mut model = Model {
        remembered: Vec::new(),
        source,
        markers: &data.marker,
        cases: &cases,
        tables: &tables,
        parameters: &parameters,
        sigma: Sigma {
            place: data.sigma_m,
            angle: data.sigma_rad.unwrap_or(1.0),
        },
        n_threads: options.n_threads,
        stop,
    };
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
    let overrides = model.overrides(&found.at, &[], &own);
    let (scene, fitted) = Scene::from_toml(&source.name, &source.text, &overrides)?;
    let arm = scene.arm(&fitted)?;
    let rod = (arm.rod(&scene.discretization()))
        .map_err(|error| scene.discretize_error(&fitted, error.into()))?;
    let predicted = model.predicted(&found.at, &steps)?;
    let shapes = model.shapes(&found.at, &rod)?;
    let (mut summary, rows) = report::summary(&model, &found, &predicted, &steps)?;
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

/// Refuses a key that is free and that a shape or recording sets, itself, in part, or as a part of a list or table: the fitted value would
/// replace what was measured. Factors multiply what is set, and are not refused.
fn refuse_set(parameters: &[Free], cases: &[Case]) -> Result<(), FitError> {
    let parts = |path: &str| -> Vec<String> {
        (path.split('.'))
            .map(|part| part.trim().trim_matches(['"', '\'']).to_string())
            .collect()
    };
    for own in parameters.iter().filter(|own| own.is_key()) {
        let key = parts(&own.key);
        for case in cases {
            let set = case.set.iter().filter_map(|set| set.split_once('='));
            let rows = case.rows().into_iter().flat_map(|rows| &rows.keys);
            for path in set.map(|(path, _)| path).chain(rows.map(String::as_str)) {
                let set = parts(path);
                let shared = key.len().min(set.len());
                if key[..shared] == set[..shared] {
                    return Err(FitError::Data(format!(
                        "{0} is free, and {1} sets {2}: the fit would replace what was measured; take {2} out of `set`, or fit a \
                         factor of it: [[free]] with a name as its key and times = [\"{0}\"]",
                        own.key,
                        case.name,
                        path.trim()
                    )));
                }
            }
        }
    }
    Ok(())
}

/// A number that is fitted.
struct Free {
    key: String,
    /// Paths of the numbers that it multiplies.
    times: Vec<String>,
    /// Paths of the numbers to which it is added.
    plus: Vec<String>,
    /// Marker and axis whose offset it is.
    marker: Option<(usize, usize)>,
    start: f64,
    /// Unit of the search.
    scale: f64,
    bounds: [f64; 2],
    prior: Option<[f64; 2]>,
}

impl Free {
    /// Returns the number of this key, as the data describe it; `own` are the entries of the scene, and `tables` those of the cases.
    fn of(
        key: &str,
        data: &Data,
        own: &toml::Table,
        (tables, cases): (&[toml::Table], &[Case]),
    ) -> Result<Self, FitError> {
        let refuse = |words: String| Err(FitError::Data(words));
        let described = data.free.iter().find(|free| free.key == key);
        let times = described.map_or(&[][..], |free| &free.times);
        let plus = described.map_or(&[][..], |free| &free.plus);
        if !times.is_empty() && !plus.is_empty() {
            return refuse(format!("{key} has times and plus: give a number for each"));
        }
        let is_set = |path: &String| {
            let rows = cases.iter().filter_map(Case::rows);
            rows.flat_map(|rows| &rows.keys).any(|key| key == path)
        };
        for path in times.iter().chain(plus) {
            let mut tables = tables.iter().chain([own]);
            if !is_set(path) && !tables.any(|table| number(table, path).is_some()) {
                let relation = if plus.is_empty() {
                    "of which {key} is a factor"
                } else {
                    "to which {key} is added"
                };
                let relation = relation.replace("{key}", key);
                return refuse(format!("{path}, {relation}, has no number in this scene"));
            }
        }
        let marker = marker_axis(key, &data.marker)?;
        let given = described
            .and_then(|free| free.start)
            .or_else(|| match marker {
                Some((marker, axis)) => Some(data.marker[marker].offset_m[axis]),
                None if !times.is_empty() => Some(1.0),
                None if !plus.is_empty() => Some(0.0),
                None => number(own, key),
            });
        let Some(start) = given else {
            return refuse(format!(
                "{key} has no number in this scene; give the key of a number, or its start in [[free]] of the data"
            ));
        };
        let part = |of: fn(&data::Free) -> Option<f64>| described.and_then(of);
        let is_positive = start > 0.0 && marker.is_none() && plus.is_empty();
        let bounds = [
            part(|free| free.lower).unwrap_or(if is_positive {
                1e-3 * start
            } else {
                f64::NEG_INFINITY
            }),
            part(|free| free.upper).unwrap_or(if is_positive {
                1e3 * start
            } else {
                f64::INFINITY
            }),
        ];
        let prior = match [part(|free| free.prior), part(|free| free.prior_sigma)] {
            [Some(prior), Some(sigma)] if sigma > 0.0 && (prior + sigma).is_finite() => {
                Some([prior, sigma])
            }
            [None, None] => None,
            _ => {
                return refuse(format!(
                    "{key}: a prior has a value and a standard deviation above 0, prior and prior_sigma"
                ));
            }
        };
        let width = bounds[1] - bounds[0];
        let length = number(own, "rod.length_m").unwrap_or(1.0);
        let of_rows = (plus.iter())
            .map(|path| largest_input(cases, path))
            .fold(0.0, f64::max);
        let scale = if marker.is_some() {
            start.abs().max(OFFSET * length)
        } else if start != 0.0 {
            start.abs()
        } else if of_rows > 0.0 {
            of_rows
        } else if let Some([_, sigma]) = prior {
            sigma
        } else if width.is_finite() {
            width
        } else {
            1.0
        };
        Ok(Self {
            key: key.into(),
            times: times.to_vec(),
            plus: plus.to_vec(),
            marker,
            start,
            scale,
            bounds,
            prior,
        })
    }

    /// Returns the dotted paths of its key and of the numbers that it multiplies, or to which it is added.
    fn paths(&self) -> Vec<String> {
        let sums = self.plus.iter().map(|path| format!("{path} plus"));
        let own = [&[self.key.clone()][..], &self.times].concat();
        own.into_iter().chain(sums).collect()
    }

    /// Returns the paths of the numbers that it multiplies, or to which it is added.
    fn related(&self) -> impl Iterator<Item = &String> {
        self.times.iter().chain(&self.plus)
    }

    /// Tells whether it is the number at its key in the scene.
    fn is_key(&self) -> bool {
        self.related().next().is_none() && self.marker.is_none()
    }

    fn scaled_bounds(&self) -> [f64; 2] {
        self.bounds.map(|bound| bound / self.scale)
    }
}

/// Scale of an offset of a marker in the search, as a part of the length of the arm.
const OFFSET: f64 = 1e-2;

/// Returns the marker and the axis of a key as `marker.tip.offset_m.2`.
///
/// # Errors
/// Returns [`FitError`] for another marker, or another number of it.
fn marker_axis(key: &str, markers: &[Marker]) -> Result<Option<(usize, usize)>, FitError> {
    let Some(path) = key.strip_prefix("marker.") else {
        return Ok(None);
    };
    let found = path.split_once(".offset_m.").and_then(|(name, axis)| {
        let marker = markers.iter().position(|own| own.name == name)?;
        Some((marker, axis.parse().ok().filter(|axis: &usize| *axis < 3)?))
    });
    match found {
        Some(found) => Ok(Some(found)),
        None => Err(FitError::Data(format!(
            "{key}: expected marker.NAME.offset_m.0, .1 or .2, with the name of a marker"
        ))),
    }
}

/// Returns the size of the largest command of a key in tables.
fn largest_input(cases: &[Case], key: &str) -> f64 {
    let mut largest = 0.0f64;
    for rows in cases.iter().filter_map(Case::rows) {
        for (index, _) in rows.keys.iter().enumerate().filter(|(_, own)| *own == key) {
            let column = (0..rows.len()).map(|row| rows.row(row)[index].abs());
            largest = column.fold(largest, f64::max);
        }
    }
    largest
}

/// Returns the entries of a resolved scene.
fn entries(source: &SceneSource, set: &[String]) -> Result<toml::Table, FitError> {
    let overrides = [&source.overrides[..], set].concat();
    let (scene, _) = Scene::from_toml(&source.name, &source.text, &overrides)?;
    toml::from_str(&scene.to_toml()).map_err(|error| FitError::Data(error.to_string()))
}

/// Returns the numbers that are fitted, with their starts; `own` are the entries of the scene, and `tables` those of the cases.
fn parameters(
    own: &toml::Table,
    cases: (&[toml::Table], &[Case]),
    data: &Data,
    options: &FitOptions,
) -> Result<Vec<Free>, FitError> {
    let refuse = |words: String| Err(FitError::Data(words));
    let mut keys: Vec<&str> = options.free.iter().map(String::as_str).collect();
    for free in &data.free {
        if !keys.contains(&free.key.as_str()) {
            keys.push(&free.key);
        }
    }
    if keys.is_empty() {
        return refuse(
            "nothing is free: name keys by --free, as rod.material.youngs_modulus_pa".into(),
        );
    }
    let mut out: Vec<Free> = Vec::new();
    for key in keys {
        let free = Free::of(key, data, own, cases)?;
        let taken: Vec<String> = out.iter().flat_map(Free::paths).collect();
        let new = free.paths();
        if let Some(path) = (new.iter().enumerate())
            .find(|(i, path)| taken.contains(path) || new[..*i].contains(path))
            .map(|(_, path)| path)
        {
            return refuse(format!("{path} is free twice"));
        }
        let (start, bounds) = (free.start, free.bounds);
        if !(start.is_finite() && bounds[0] <= start && start <= bounds[1] && bounds[0] < bounds[1])
        {
            return refuse(format!(
                "{key} starts at {start}, outside of its bounds {bounds:?}"
            ));
        }
        out.push(free);
    }
    Ok(out)
}

/// Returns the number at a dotted path.
fn number(table: &toml::Table, key: &str) -> Option<f64> {
    let mut parts = key.split('.');
    let mut value = table.get(parts.next()?)?;
    for part in parts {
        value = match value {
            toml::Value::Table(table) => table.get(part)?,
            toml::Value::Array(items) => items.get(part.parse::<usize>().ok()?)?,
            _ => return None,
        };
    }
    match value {
        toml::Value::Float(number) => Some(*number),
        toml::Value::Integer(number) => Some(*number as f64),
        _ => None,
    }
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
    /// Of every case that is a table, what is remembered of it.
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

impl Model<'_> {
    fn start(&self) -> Vec<f64> {
        self.parameters
            .iter()
            .map(|own| own.start / own.scale)
            .collect()
    }

    fn fitted(&self) -> impl Iterator<Item = &Case> {
        self.cases.iter().filter(|case| !case.held_out)
    }

    /// Returns the overrides of a case under parameters; `table` has the entries of its scene.
    fn overrides(&self, at: &[f64], set: &[String], table: &toml::Table) -> Vec<String> {
        let own = self.source.overrides.iter().chain(set).cloned();
        let values = (self.parameters.iter().zip(at))
            .filter(|(own, _)| own.is_key())
            .map(|(own, at)| format!("{}={:e}", own.key, at * own.scale));
        let related = self.parameters.iter().flat_map(Free::related);
        let related: std::collections::BTreeSet<&String> = related.collect();
        let changed = (related.into_iter())
            .filter_map(|path| Some((path, number(table, path)?)))
            .map(|(path, value)| format!("{path}={:e}", self.given(at, path, value)));
        own.chain(values).chain(changed).collect()
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
        let has_tables = self.fitted().any(|case| case.rows().is_some());
        let jacobian = |at: &[f64]| self.jacobian(at, steps);
        let problem = Problem {
            residuals: &|points: &[Vec<f64>]| self.residuals(points, steps),
            bounds: self.bounds(),
            jacobian: has_tables.then_some(&jacobian),
            groups: groups.to_vec(),
        };
        problem.minimize(start)
    }

    fn bounds(&self) -> Vec<[f64; 2]> {
        self.parameters.iter().map(Free::scaled_bounds).collect()
    }

    /// Returns the derivatives of the residuals: of tables by the implicit function theorem, of shapes and recordings by differences.
    ///
    /// # Errors
    /// Returns [`FitError`] where one of these cannot be computed.
    fn jacobian(&self, at: &[f64], steps: &Steps) -> Result<DMatrix<f64>, FitError> {
        let beside = Beside::of(at, &self.bounds());
        let is_other = |case: &usize| self.cases[*case].rows().is_none();
        let cases: Vec<usize> = (0..self.cases.len())
            .filter(|case| !self.cases[*case].held_out)
            .collect();
        let others: Vec<usize> = cases.iter().copied().filter(is_other).collect();
        let mut found = Vec::new();
        for blocks in self.blocks(&beside.points, steps, None, &others) {
            found.push(blocks?);
        }
        let mut parts = Vec::new();
        for case in cases {
            if !is_other(&case) {
                parts.push(self.table_jacobian(at, case, &beside)?);
                continue;
            }
            let place = others.partition_point(|other| *other < case);
            let n = found.first().map_or(0, |blocks| blocks[place].len());
            parts.push(DMatrix::from_fn(n, at.len(), |i, j| {
                let [rise, fall] = beside.widths[j];
                let [ahead, behind] = [0, 1].map(|side| found[2 * j + side][place][i]);
                (ahead - behind) / (rise + fall)
            }));
        }
        for (j, own) in self.parameters.iter().enumerate() {
            if let Some([_, sigma]) = own.prior {
                let mut row = DMatrix::zeros(1, at.len());
                row[(0, j)] = own.scale / sigma;
                parts.push(row);
            }
        }
        let n = parts.iter().map(DMatrix::nrows).sum();
        let mut out = DMatrix::zeros(n, at.len());
        let mut first = 0;
        for part in parts {
            out.rows_mut(first, part.nrows()).copy_from(&part);
            first += part.nrows();
        }
        Ok(out)
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
        let mut overrides = self.overrides(at, &case.set, &self.tables[index]);
        overrides.extend_from_slice(more);
        if !case.is_motion() {
            overrides.push("initial.shape=\"equilibrium\"".into());
        } else {
            let last = case.sights.last().map_or(0.0, |sight| sight.time);
            overrides.push(format!("time.end_s={:e}", last.max(1e-9)));
            if let Some((step, scheme)) = step {
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
        let late = match changed {
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
        let h = setup.grid.step;
        for sight in &case.sights {
            let time = (sight.time - late).max(0.0);
            let needed = (time / h - 1e-9).ceil().max(0.0) as usize;
            while stepper.step() < needed.min(setup.grid.n_steps) {
                stepper
                    .advance([NodeWrenches::NONE; 2])
                    .map_err(|error| FitError::Step {
                        case: case.name.clone(),
                        error,
                    })?;
                before = now;
                now = stepper.state().configuration;
                self.stop.check().map_err(FitError::Stopped)?;
            }
            // Linear between the two time nodes beside the sight, and along the shortest turn.
            let part = 1.0 - (stepper.step() as f64 - time / h).clamp(0.0, 1.0);
            let [from, to] = [&before, &now].map(|shape| pose(shape, sight.marker));
            let turn = log(&from.section.tr_mul(&to.section));
            out.push(Pose {
                place: from.place + (to.place - from.place) * part,
                section: from.section * exp(&(turn * part)),
            });
        }
        Ok(out)
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
        Pose { place, section }
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
        let share = work.len().div_ceil(self.n_threads.max(1)).max(1);
        let mut found: Vec<Result<Vec<Pose>, FitError>> = Vec::new();
        std::thread::scope(|scope| {
            let threads: Vec<_> = (work.chunks(share))
                .map(|work| {
                    scope.spawn(move || {
                        let one = |&(point, case): &(usize, usize)| {
                            self.case(&points[point], case, steps, changed)
                        };
                        work.iter().map(one).collect::<Vec<_>>()
                    })
                })
                .collect();
            for thread in threads {
                match thread.join() {
                    Ok(own) => found.extend(own),
                    Err(panic) => std::panic::resume_unwind(panic),
                }
            }
        });
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
