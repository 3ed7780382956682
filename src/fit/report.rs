//! Standard errors, correlations, undetermined combinations, and residuals of a fit.

use std::collections::BTreeMap;
use std::ops::Range;

use nalgebra::{DMatrix, Vector3};
use serde::Serialize;

use super::data::{Case, Sight};
use super::explained::{Explanation, explanation};
use super::least_squares::{Minimum, weigh};
use super::left::Left;
use super::{FitError, Model, Pose, Steps};
use crate::TOOL;
use crate::output::ResidualRow;
use crate::output::summary::SCHEMA_VERSION;

/// A direction of the parameters is undetermined where the residuals change by less than this part of what they change along the one that
/// is determined best; differences of the residuals are exact to about 1e-8.
const UNDETERMINED: f64 = 1e-6;
/// A direction of the logarithms of the parameters, a unit vector, is hardly determined where two standard errors along it are more than
/// this: a factor of 1.65 either way.
const HARDLY_DETERMINED: f64 = 0.5;
/// Exponents below this part of the largest one of a direction are left out.
const SMALL_EXPONENT: f64 = 1e-2;
/// A place is an outlier where it is further off than this many standard deviations of all: one of 1100 normal places is.
const OUTLIER: f64 = 4.0;

/// The summary of a fit.
#[derive(Clone, Debug, Serialize)]
pub struct FitSummary {
    /// Version of the layout.
    pub schema_version: u32,
    /// The program.
    pub tool: &'static str,
    /// The verb.
    pub command: &'static str,
    /// Name of the scene.
    pub scene: String,
    /// `converged` or `iteration-limit`.
    pub status: &'static str,
    /// Iterations of Levenberg and Marquardt's method.
    pub iterations: usize,
    /// Duration, s.
    pub wall_s: f64,
    /// Root of the mean square of the distances of fitted places, m; null without any.
    pub rms_m: Option<f64>,
    /// That of the places that were held out, m; null without any.
    pub held_out_rms_m: Option<f64>,
    /// Standard deviation of the measurements as given, m.
    pub sigma_m: f64,
    /// Standard deviation of a coordinate as the residuals have it, m: noise and error of the model.
    pub scatter_m: f64,
    /// Distance from which a place is an outlier, m.
    pub outliers_beyond_m: f64,
    /// Root of the mean square of the angles of fitted orientations, rad; absent without any, as the following ones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rms_rad: Option<f64>,
    /// That of the orientations that were held out, rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub held_out_rms_rad: Option<f64>,
    /// Standard deviation of an orientation about an axis as given, rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_rad: Option<f64>,
    /// That as the residuals have it, those of places among them, rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scatter_rad: Option<f64>,
    /// Angle from which an orientation is an outlier, rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outliers_beyond_rad: Option<f64>,
    /// Tests of the model by its residuals.
    #[serde(flatten)]
    pub explanation: Explanation,
    /// The fitted numbers.
    pub parameters: Vec<Parameter>,
    /// Correlations of the estimates, row by row; empty if a combination has no effect at all.
    pub correlations: Vec<Vec<f64>>,
    /// Combinations that the data cannot tell, or hardly.
    pub undetermined: Vec<Undetermined>,
    /// Markers that seem to be exchanged.
    pub exchanged: Vec<Exchanged>,
    /// Fitted numbers that the scene of the result does not have, as sentences.
    pub advice: Vec<String>,
    /// Distances by marker, direction of the commands, and bending.
    #[serde(flatten)]
    pub left: Left,
    /// Shapes and recordings.
    pub cases: Vec<CaseSummary>,
    /// Result directory.
    pub directory: String,
}

/// A fitted number.
#[derive(Clone, Debug, Serialize)]
pub struct Parameter {
    /// Dotted path, or name of a factor.
    pub key: String,
    /// Key of the list of numbers of which it is one, if that is fitted as a whole.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub list: Option<String>,
    /// Dotted paths of the numbers that a factor multiplies.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub times: Vec<String>,
    /// Value at the start.
    pub start: f64,
    /// Estimate.
    pub value: f64,
    /// Standard error by the scatter of the residuals, and by their correlation where they have one; null where the data cannot tell it.
    pub standard_error: Option<f64>,
    /// Standard error that the noise of the measurements alone would give.
    pub standard_error_of_noise: Option<f64>,
    /// Tells whether it is at a bound.
    pub at_bound: bool,
}

/// A combination of parameters that the data cannot tell, or hardly.
#[derive(Clone, Debug, Serialize)]
pub struct Undetermined {
    /// Keys, with the exponents with which they may change together: `value_i` times `f` to the power of its exponent leaves the residuals
    /// as they are, or nearly. The largest exponent is one.
    pub exponents: Vec<(String, f64)>,
    /// Standard error of the logarithm of `f`, by the scatter of the residuals; null where `f` has no effect at all.
    pub standard_error: Option<f64>,
}

/// Two markers of one shape, or of one time of a recording, that are outliers as they are named and none if their names are exchanged.
#[derive(Clone, Debug, Serialize)]
pub struct Exchanged {
    /// Shape or recording.
    pub case: String,
    /// Time, s.
    pub t_s: f64,
    /// The markers.
    pub markers: [String; 2],
    /// Their distances as they are named, m.
    pub off_m: [f64; 2],
    /// Those with the names exchanged, m.
    pub exchanged_off_m: [f64; 2],
}

/// Residuals of a shape or recording.
#[derive(Clone, Debug, Serialize)]
pub struct CaseSummary {
    /// Name.
    pub name: String,
    /// Tells whether it is a shape at rest.
    pub at_rest: bool,
    /// Tells whether it was compared only.
    pub held_out: bool,
    /// Times at which a marker of a recording was not seen, by empty or `nan` cells.
    pub gaps: usize,
    /// Places and orientations of markers, each marker counted once for a time.
    pub places: usize,
    /// Root of the mean square of the distances, m; null without a place.
    pub rms_m: Option<f64>,
    /// That of the angles, rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rms_rad: Option<f64>,
    /// That under the estimates without this case, to first order, m; null for a case that was held out.
    pub left_out_rms_m: Option<f64>,
    /// Root of the mean square of the distances of a table of shapes once the mean of the differences is taken away, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub aligned_rms_m: Option<f64>,
    /// Groups of a table of shapes, in the order of the rows.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub groups: Vec<GroupSummary>,
    /// Places that are further off than four standard deviations.
    pub outliers: usize,
}

/// Residuals of a group of the rows of a table.
#[derive(Clone, Debug, Serialize)]
pub struct GroupSummary {
    /// Word in the column of groups.
    pub name: String,
    /// Places of markers.
    pub places: usize,
    /// Root of the mean square of the distances, m.
    pub rms_m: Option<f64>,
}

/// Returns the groups of a table, whose residuals are given.
fn groups(case: &Case, rows: &[ResidualRow]) -> Vec<GroupSummary> {
    let Some(table) = case.rows().filter(|rows| !rows.groups.is_empty()) else {
        return Vec::new();
    };
    let mut names: Vec<&String> = Vec::new();
    let mut own: BTreeMap<&String, Vec<ResidualRow>> = BTreeMap::new();
    for row in rows {
        let name = &table.groups[row.t_s as usize];
        if !own.contains_key(name) {
            names.push(name);
        }
        own.entry(name).or_default().push(row.clone());
    }
    (names.into_iter())
        .map(|name| GroupSummary {
            name: name.clone(),
            places: own[name].len(),
            rms_m: Squares::of(&own[name]).rms()[0],
        })
        .collect()
}

/// Returns the root of the mean square of distances without the mean of the differences.
fn aligned(rows: &[ResidualRow]) -> Option<f64> {
    let off: Vec<Vector3<f64>> = (rows.iter())
        .filter_map(|row| {
            let measured = Vector3::new(row.x_m?, row.y_m?, row.z_m?);
            let predicted = [row.predicted_x_m, row.predicted_y_m, row.predicted_z_m];
            Some(Vector3::from(predicted) - measured)
        })
        .collect();
    let n = off.len() as f64;
    let mean = off.iter().sum::<Vector3<f64>>() / n;
    let sum: f64 = off.iter().map(|own| (own - mean).norm_squared()).sum();
    (n > 0.0).then(|| (sum / n).sqrt())
}

/// Sums of squares of distances and angles.
#[derive(Clone, Copy, Default)]
struct Squares {
    /// Sum of the squares of distances, m², and their number.
    places: (f64, usize),
    /// Sum of the squares of angles, rad², and their number.
    angles: (f64, usize),
}

impl Squares {
    fn of(rows: &[ResidualRow]) -> Self {
        let mut out = Self::default();
        for row in rows {
            for (sum, value) in [
                (&mut out.places, row.off_m),
                (&mut out.angles, row.turned()),
            ] {
                sum.0 += value.map_or(0.0, |value| value * value);
                sum.1 += usize::from(value.is_some());
            }
        }
        out
    }

    fn add(&mut self, other: &Self) {
        for (own, other) in [
            (&mut self.places, other.places),
            (&mut self.angles, other.angles),
        ] {
            own.0 += other.0;
            own.1 += other.1;
        }
    }

    /// Returns the root of the mean square of the distances, m, and that of the angles, rad.
    fn rms(&self) -> [Option<f64>; 2] {
        [self.places, self.angles].map(|(squares, n)| (n > 0).then(|| (squares / n as f64).sqrt()))
    }
}

/// Residuals from which a place or an orientation is an outlier.
#[derive(Clone, Copy)]
struct Outlier {
    /// Distance, m.
    off: f64,
    /// Angle, rad.
    turn: f64,
}

impl Outlier {
    fn row(self, model: &Model, case: &Case, sight: &Sight, pose: &Pose) -> ResidualRow {
        let off_m = pose.off(sight).map(|off| off.norm());
        let turn = pose.turn(sight);
        let [x_m, y_m, z_m] = [0, 1, 2].map(|i| sight.position.map(|x| x[i]));
        let [turn_x_rad, turn_y_rad, turn_z_rad] = [0, 1, 2].map(|i| turn.map(|turn| turn[i]));
        ResidualRow {
            case: case.name.clone(),
            marker: model.markers[sight.marker].name.clone(),
            t_s: sight.time,
            x_m,
            y_m,
            z_m,
            predicted_x_m: pose.place.x,
            predicted_y_m: pose.place.y,
            predicted_z_m: pose.place.z,
            off_m,
            outlier: off_m.is_some_and(|off| off > self.off)
                || turn.is_some_and(|turn| turn.norm() > self.turn),
            turn_x_rad,
            turn_y_rad,
            turn_z_rad,
        }
    }
}

/// Residuals of all cases.
#[derive(Default)]
struct Seen {
    rows: Vec<ResidualRow>,
    exchanged: Vec<Exchanged>,
    cases: Vec<CaseSummary>,
    fitted: Squares,
    held_out: Squares,
}

impl Seen {
    /// Returns the residuals of predicted poses; `normal` is the normal matrix of the fit.
    fn of(
        model: &Model,
        found: &Minimum,
        normal: &DMatrix<f64>,
        predicted: &[Vec<Pose>],
        outlier: Outlier,
    ) -> Self {
        let mut out = Self::default();
        let mut first = 0;
        for (case, poses) in model.cases.iter().zip(predicted) {
            let own: Vec<ResidualRow> = (case.sights.iter().zip(poses))
                .map(|(sight, pose)| outlier.row(model, case, sight, pose))
                .collect();
            out.exchanged.extend(exchanged(&own, outlier.off));
            let n = if case.held_out { 0 } else { 3 * case.n_seen() };
            let squares = Squares::of(&own);
            let [rms_m, rms_rad] = squares.rms();
            out.cases.push(CaseSummary {
                name: case.name.clone(),
                at_rest: !case.is_motion(),
                held_out: case.held_out,
                gaps: case.gaps,
                places: own.len(),
                rms_m,
                rms_rad,
                left_out_rms_m: (!case.held_out)
                    .then(|| left_out(model, case, found, normal, first..first + n))
                    .flatten(),
                aligned_rms_m: case.rows().and_then(|_| aligned(&own)),
                groups: groups(case, &own),
                outliers: own.iter().filter(|row| row.outlier).count(),
            });
            first += n;
            let sum = if case.held_out {
                &mut out.held_out
            } else {
                &mut out.fitted
            };
            sum.add(&squares);
            out.rows.extend(own);
        }
        out
    }
}

/// Describes a minimum, and every place that was seen.
///
/// # Errors
/// Returns [`FitError::Stopped`].
pub(super) fn summary(
    model: &Model,
    found: &Minimum,
    predicted: &[Vec<Pose>],
    steps: &Steps,
) -> Result<(FitSummary, Vec<ResidualRow>), FitError> {
    let weighted = weigh(&found.jacobian, &found.weights);
    let normal = weighted.transpose() * &found.jacobian;
    let scatter = scatter(found, model.parameters.len());
    let undetermined = undetermined(model, found, scatter);
    let inverse = (undetermined.iter())
        .all(|own| own.standard_error.is_some())
        .then(|| normal.clone().try_inverse())
        .flatten();
    let assumed = model.assumptions(found, inverse.as_ref(), steps)?;
    let explanation = explanation(model, found, inverse.as_ref(), assumed);
    let sigma = &model.sigma;
    let outlier = Outlier {
        off: OUTLIER * scatter * sigma.place,
        turn: OUTLIER * scatter * sigma.angle,
    };
    let seen = Seen::of(model, found, &normal, predicted, outlier);
    let has_angles = seen.rows.iter().any(|row| row.turned().is_some());
    let of_angles = |value: f64| has_angles.then_some(value);
    let [rms_m, rms_rad] = seen.fitted.rms();
    let [held_out_rms_m, held_out_rms_rad] = seen.held_out.rms();
    let summary = FitSummary {
        schema_version: SCHEMA_VERSION,
        tool: TOOL,
        command: "fit",
        scene: String::new(),
        status: if found.converged {
            "converged"
        } else {
            "iteration-limit"
        },
        iterations: found.iterations,
        wall_s: 0.0,
        rms_m,
        held_out_rms_m,
        sigma_m: sigma.place,
        scatter_m: scatter * sigma.place,
        outliers_beyond_m: outlier.off,
        rms_rad,
        held_out_rms_rad,
        sigma_rad: of_angles(sigma.angle),
        scatter_rad: of_angles(scatter * sigma.angle),
        outliers_beyond_rad: of_angles(outlier.turn),
        parameters: parameters(model, found, inverse.as_ref(), scatter, &explanation),
        explanation,
        correlations: inverse.as_ref().map_or_else(Vec::new, correlations),
        undetermined,
        exchanged: seen.exchanged,
        advice: Vec::new(),
        left: Left::of(model, predicted),
        cases: seen.cases,
        directory: String::new(),
    };
    Ok((summary, seen.rows))
}

/// Returns the root of the mean square of the weighted residuals, by their degrees of freedom, as a multiple of the standard deviation of
/// the measurements.
fn scatter(found: &Minimum, n_parameters: usize) -> f64 {
    let chi: f64 = (found.residuals.iter().zip(found.weights.iter()))
        .map(|(r, w)| w * r * r)
        .sum();
    let freedom = found.residuals.len().saturating_sub(n_parameters).max(1);
    (chi / freedom as f64).sqrt()
}

/// Returns the estimates with their standard errors; `inverse` is that of the normal matrix, if it has one.
fn parameters(
    model: &Model,
    found: &Minimum,
    inverse: Option<&DMatrix<f64>>,
    scatter: f64,
    explanation: &Explanation,
) -> Vec<Parameter> {
    (model.parameters.iter().enumerate())
        .map(|(i, own)| {
            let value = found.at[i] * own.scale;
            let error = inverse.map(|inverse| inverse[(i, i)].max(0.0).sqrt() * own.scale);
            Parameter {
                key: own.key.clone(),
                list: own.list.clone(),
                times: own.times.clone(),
                start: own.start,
                value,
                standard_error: error.map(|error| error * scatter * explanation.widened_by),
                standard_error_of_noise: error,
                at_bound: own
                    .bounds
                    .iter()
                    .any(|bound| (value - bound).abs() <= 1e-9 * own.scale),
            }
        })
        .collect()
}

/// Returns the correlations of the estimates, row by row, from the inverse of the normal matrix.
fn correlations(inverse: &DMatrix<f64>) -> Vec<Vec<f64>> {
    let n = inverse.nrows();
    let root = |i: usize| inverse[(i, i)].max(f64::MIN_POSITIVE).sqrt();
    (0..n)
        .map(|i| {
            (0..n)
                .map(|j| inverse[(i, j)] / (root(i) * root(j)))
                .collect()
        })
        .collect()
}

/// Returns the root of the mean square of the distances of a case, m, under the estimates without its rows, to first order.
fn left_out(
    model: &Model,
    case: &Case,
    found: &Minimum,
    normal: &DMatrix<f64>,
    rows: Range<usize>,
) -> Option<f64> {
    let (first, n) = (rows.start, rows.len());
    let jacobian = found.jacobian.rows(first, n).into_owned();
    let residuals = found.residuals.rows(first, n).into_owned();
    let weights = found.weights.rows(first, n).into_owned();
    let weighted = weigh(&jacobian, &weights);
    let without = normal - weighted.transpose() * &jacobian;
    // Without these rows the gradient is minus their own.
    let step = without
        .cholesky()?
        .solve(&(weighted.transpose() * &residuals));
    let residuals = residuals + jacobian * step;
    let (mut squares, mut n, mut row) = (0.0, 0, 0);
    for sight in &case.sights {
        if sight.position.is_some() {
            squares += residuals.rows(row, 3).norm_squared();
            n += 1;
            row += 3;
        }
        row += 3 * usize::from(sight.orientation.is_some());
    }
    (n > 0).then(|| model.sigma.place * (squares / f64::from(n)).sqrt())
}

/// Returns the combinations of parameters along which the residuals do not change, and then those along which they hardly do, the worst
/// first.
///
/// Both are directions in the logarithms of the parameters, so that products and quotients are directions. The second ones are axes of the
/// covariance of the logarithms of parameters that are positive throughout: others have no such scale.
fn undetermined(model: &Model, found: &Minimum, scatter: f64) -> Vec<Undetermined> {
    let free = model.parameters;
    let n = free.len();
    let mut relative = weigh(&found.jacobian, &found.weights.map(f64::sqrt));
    for ((mut column, at), own) in (relative.column_iter_mut().zip(&found.at)).zip(free) {
        // Of lists, many numbers of which are about zero, in units of their prior.
        if *at != 0.0 && own.list.is_none() {
            column *= *at;
        }
    }
    let svd = relative.svd(false, true);
    let Some(directions) = svd.v_t else {
        return Vec::new();
    };
    let combination = |parts: &[f64], standard_error: Option<f64>| {
        let largest = (parts.iter().copied())
            .max_by(|a, b| a.abs().total_cmp(&b.abs()))
            .unwrap_or(1.0);
        Undetermined {
            exponents: (free.iter().zip(parts))
                .map(|(own, part)| (own.key.clone(), part / largest))
                .filter(|(_, part)| part.abs() > SMALL_EXPONENT)
                .collect(),
            standard_error: standard_error.map(|error| error * largest.abs()),
        }
    };
    let most = svd.singular_values.max();
    let mut out = Vec::new();
    let mut covariance = DMatrix::zeros(n, n);
    for (direction, &value) in directions.row_iter().zip(&svd.singular_values) {
        if value > UNDETERMINED * most {
            covariance += direction.tr_mul(&direction) * (scatter / value).powi(2);
        } else {
            let parts: Vec<f64> = direction.iter().copied().collect();
            out.push(combination(&parts, None));
        }
    }
    if covariance.iter().any(|part| !part.is_finite()) {
        return out;
    }
    let positive: Vec<usize> = (0..n).filter(|&i| free[i].bounds[0] > 0.0).collect();
    if positive.is_empty() {
        return out;
    }
    let axes = (covariance.select_rows(&positive))
        .select_columns(&positive)
        .symmetric_eigen();
    let mut hardly: Vec<(f64, Vec<f64>)> =
        (axes.eigenvalues.iter().zip(axes.eigenvectors.column_iter()))
            .map(|(square, axis)| {
                let mut parts = vec![0.0; n];
                for (&i, part) in positive.iter().zip(axis.iter()) {
                    parts[i] = *part;
                }
                (square.max(0.0).sqrt(), parts)
            })
            .filter(|(error, _)| 2.0 * error > HARDLY_DETERMINED)
            .collect();
    hardly.sort_by(|a, b| b.0.total_cmp(&a.0));
    out.extend((hardly.iter()).map(|(error, parts)| combination(parts, Some(*error))));
    out
}

/// Returns the pairs of outliers at one time that are none if their markers are exchanged, among the places of a case.
fn exchanged(seen: &[ResidualRow], limit: f64) -> Vec<Exchanged> {
    let off = |measured: &ResidualRow, predicted: &ResidualRow| {
        let from = measured.measured()?;
        Some((Vector3::from(predicted.predicted()) - Vector3::from(from)).norm())
    };
    let is_far = |row: &&ResidualRow| row.off_m.is_some_and(|off| off > limit);
    let outliers: Vec<&ResidualRow> = seen.iter().filter(is_far).collect();
    let mut out = Vec::new();
    for (i, a) in outliers.iter().enumerate() {
        let same_time = |b: &&&ResidualRow| b.t_s == a.t_s;
        for b in outliers[..i].iter().rev().take_while(same_time) {
            let (Some(own), Some(others)) = (
                b.off_m.zip(a.off_m).map(<[f64; 2]>::from),
                off(a, b).zip(off(b, a)).map(<[f64; 2]>::from),
            ) else {
                continue;
            };
            if others.iter().all(|off| *off <= limit) {
                out.push(Exchanged {
                    case: a.case.clone(),
                    t_s: a.t_s,
                    markers: [b.marker.clone(), a.marker.clone()],
                    off_m: own,
                    exchanged_off_m: others,
                });
            }
        }
    }
    out
}
