//! Tables of shapes at rest: many commands of one arm, each followed from a shape nearby, with derivatives by the implicit function theorem.
//!
//! At rest the forces `F(q, p)` on the free nodes vanish. A change of the parameters moves the shape by `dq = K⁻¹ (∂F/∂p) dp` with the tangent
//! stiffness `K = -∂F/∂q`, so that one factorization serves all parameters, and derivatives cost evaluations of forces in place of
//! equilibria. Parameters that move the base carry the shape with it.

use std::sync::Mutex;

use nalgebra::{DMatrix, Matrix3, Vector6};

use super::data::{Kind, Rows};
use super::least_squares::{Beside, slope};
use super::{FitError, Model, Pose};
use crate::mechanics::equilibrium::{nearby_equilibrium_until, static_equilibrium_until};
use crate::mechanics::forces::NodalForces;
use crate::mechanics::rotation::exp;
use crate::mechanics::tangent::Tangent;
use crate::mechanics::{Configuration, NodeSpring, Rod};

/// Rows that follow each other from the first one's shape where none is remembered: so many that most begin near their own, and so few that
/// all threads have work. The result does not depend on the number of threads.
const RUN: usize = 24;
/// Change of an input by which its actuator is found, as a part of the largest one.
const PROBE: f64 = 0.5;

/// What is remembered of a table: the actuators of its keys, and the last shape of every row.
#[derive(Debug)]
pub struct Remembered {
    /// Index among the actuators of the rod of every key.
    actuators: Vec<usize>,
    shapes: Vec<Mutex<Option<Configuration>>>,
}

/// A table under parameters.
struct Resting<'a> {
    model: &'a Model<'a>,
    case: usize,
    rows: &'a Rows,
    at: &'a [f64],
    rod: Rod,
    /// Factor on all loads and inputs.
    loads: f64,
}

impl Model<'_> {
    /// Finds the actuators that the tables set.
    ///
    /// # Errors
    /// Returns [`FitError`] for keys that set no given input of an actuator, and for arms whose elements are chosen or whose tip is held.
    pub(super) fn remember(&self) -> Result<Vec<Option<Remembered>>, FitError> {
        (self.cases.iter().enumerate())
            .map(|(case, own)| {
                own.rows()
                    .map(|rows| self.remembered(case, rows))
                    .transpose()
            })
            .collect()
    }

    fn remembered(&self, case: usize, rows: &Rows) -> Result<Remembered, FitError> {
        let refuse = |words: String| Err(FitError::Data(words));
        let name = &self.cases[case].name;
        let at = self.start();
        let rod = self.rod_at_rest(&at, case, &[])?;
        if !rod.joints.is_empty() {
            return refuse(format!(
                "{name}: tables are for arms whose tip is free; give the rows as [[shape]]"
            ));
        }
        let own = rod.actuators.efforts(0.0);
        let mut actuators = Vec::new();
        for (index, key) in rows.keys.iter().enumerate() {
            let column = (0..rows.len()).map(|row| rows.row(row)[index]);
            let largest = column.fold(0.0, |m: f64, x| if x.abs() > m.abs() { x } else { m });
            let value = PROBE * largest;
            let other = self.rod_at_rest(&at, case, &[format!("{key}={value:e}")])?;
            let others = other.actuators.efforts(0.0);
            let is_same = others.len() == own.len();
            let moved: Vec<usize> = (0..own.len())
                .filter(|&i| is_same && own[i] != others[i])
                .collect();
            match moved[..] {
                [one] if (others[one] - value).abs() <= 1e-12 * value.abs() => actuators.push(one),
                [] if largest == 0.0 => {
                    return refuse(format!("{name}: the column of {key} has nothing but zeros"));
                }
                _ => {
                    return refuse(format!(
                        "{name}: {key} is not what one actuator has before the task, as tendon.0.pretension_n and, of a winch, \
                         tendon.0.rest_displacement_m are; give such shapes as [[shape]]"
                    ));
                }
            }
        }
        Ok(Remembered {
            actuators,
            shapes: (0..rows.len()).map(|_| Mutex::new(None)).collect(),
        })
    }

    /// Returns the rod of a case at rest under parameters.
    fn rod_at_rest(&self, at: &[f64], case: usize, more: &[String]) -> Result<Rod, FitError> {
        let (scene, source) = self.scene(at, case, None, more)?;
        if scene.rod.accuracy.is_some() {
            return Err(FitError::Data(
                "a table needs a number of elements: give rod.elements in the place of rod.accuracy".into(),
            ));
        }
        let arm = scene.arm(&source)?;
        (arm.rod(&scene.discretization()))
            .map_err(|error| scene.discretize_error(&source, error.into()).into())
    }

    /// Returns the predictions of all sights of a table, with the overrides `more` and all loads and inputs times `loads`. Shapes are
    /// remembered if nothing is changed by these.
    pub(super) fn table(
        &self,
        at: &[f64],
        case: usize,
        more: &[String],
        loads: f64,
    ) -> Result<Vec<Pose>, FitError> {
        let resting = self.resting(at, case, more, loads)?;
        let keeps = more.is_empty() && loads == 1.0;
        let found = resting.in_runs(&|row, near| {
            let (rod, shape) = resting.shape(row, near)?;
            let poses = resting.poses(&rod, &shape, row, at);
            if keeps {
                *resting.slot(row) = Some(shape.clone());
            }
            Ok((shape, poses))
        })?;
        Ok(found.into_iter().flatten().collect())
    }

    fn resting<'a>(
        &'a self,
        at: &'a [f64],
        case: usize,
        more: &[String],
        loads: f64,
    ) -> Result<Resting<'a>, FitError> {
        let Kind::Rows(rows) = &self.cases[case].kind else {
            return Err(FitError::Data("no table".into()));
        };
        let mut rod = self.rod_at_rest(at, case, more)?;
        rod.multiply_loads(loads);
        Ok(Resting {
            model: self,
            case,
            rows,
            at,
            rod,
            loads,
        })
    }

    /// Returns the derivatives of the residuals of a table along the parameters, from points beside `at`.
    pub(super) fn table_jacobian(
        &self,
        at: &[f64],
        case: usize,
        beside: &Beside,
    ) -> Result<DMatrix<f64>, FitError> {
        let resting = self.resting(at, case, &[], 1.0)?;
        let others: Vec<Resting> = (beside.points.iter())
            .map(|point| self.resting(point, case, &[], 1.0))
            .collect::<Result<_, _>>()?;
        let found = resting.in_runs(&|row, near| {
            let (rod, shape) = resting.shape(row, near)?;
            let columns = resting.derivatives(row, (&rod, &shape), &others, &beside.widths)?;
            Ok((shape, vec![columns]))
        })?;
        let rows: Vec<_> = found.into_iter().flatten().collect();
        let n: usize = rows.iter().map(DMatrix::nrows).sum();
        let mut out = DMatrix::zeros(n, at.len());
        let mut first = 0;
        for own in rows {
            out.rows_mut(first, own.nrows()).copy_from(&own);
            first += own.nrows();
        }
        Ok(out)
    }
}

/// Runs a row from the shape of the one before; returns its own, and what is found.
type OfRow<'a, T> =
    &'a (dyn Fn(usize, Option<&Configuration>) -> Result<(Configuration, Vec<T>), FitError> + Sync);

impl Resting<'_> {
    fn remembered(&self) -> Option<&Remembered> {
        self.model.remembered.get(self.case)?.as_ref()
    }

    fn slot(&self, row: usize) -> std::sync::MutexGuard<'_, Option<Configuration>> {
        static NONE: Mutex<Option<Configuration>> = Mutex::new(None);
        let slot = self.remembered().map_or(&NONE, |own| &own.shapes[row]);
        slot.lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    /// Evaluates all rows, run by run, on the threads of the model.
    fn in_runs<T: Send>(&self, of_row: OfRow<T>) -> Result<Vec<Vec<T>>, FitError> {
        let runs: Vec<usize> = (0..self.rows.len()).step_by(RUN).collect();
        let share = runs.len().div_ceil(self.model.n_threads.max(1)).max(1);
        let run = |first: usize| -> Result<Vec<Vec<T>>, FitError> {
            let mut near = None;
            let mut out = Vec::new();
            for row in first..(first + RUN).min(self.rows.len()) {
                self.model.stop.check().map_err(FitError::Stopped)?;
                let (shape, found) = of_row(row, near.as_ref())?;
                near = Some(shape);
                out.push(found);
            }
            Ok(out)
        };
        let run = &run;
        std::thread::scope(|scope| {
            let threads: Vec<_> = (runs.chunks(share))
                .map(|own| scope.spawn(move || own.iter().map(|first| run(*first)).collect()))
                .collect();
            let mut out = Vec::new();
            for thread in threads {
                let found: Result<Vec<Vec<Vec<T>>>, FitError> = match thread.join() {
                    Ok(found) => found,
                    Err(panic) => std::panic::resume_unwind(panic),
                };
                out.extend(found?.into_iter().flatten());
            }
            Ok(out)
        })
    }

    /// Returns the rod under the commands of a row.
    fn commanded(&self, row: usize) -> Rod {
        let mut efforts = self.rod.actuators.efforts(0.0);
        let actuators = self.remembered().map_or(&[][..], |own| &own.actuators);
        let given = self.rows.keys.iter().zip(self.rows.row(row));
        for (&actuator, (key, &value)) in actuators.iter().zip(given) {
            efforts[actuator] = self.loads * self.model.given(self.at, key, value);
        }
        Rod {
            actuators: self.rod.actuators.with_efforts(&efforts),
            ..self.rod.clone()
        }
    }

    /// Returns the rod under the commands of a row, and its shape at rest: that next to the one that is remembered, or else next to a shape
    /// nearby.
    fn shape(
        &self,
        row: usize,
        near: Option<&Configuration>,
    ) -> Result<(Rod, Configuration), FitError> {
        let rod = self.commanded(row);
        let known = self.slot(row).clone();
        let none = NodeSpring::default();
        let stop = self.model.stop;
        for start in [known.as_ref(), near].into_iter().flatten() {
            let mut start = start.clone();
            place_base(&rod, &mut start);
            if let Ok(found) = nearby_equilibrium_until(&rod, &start, 0.0, &none, stop) {
                return Ok((rod, found));
            }
            stop.check().map_err(FitError::Stopped)?;
        }
        let found = static_equilibrium_until(&rod, &rod.rest, 0.0, &none, stop);
        let found = found.map_err(|error| {
            let line = self.rows.lines[row];
            FitError::Data(format!(
                "{}, line {line}: {error}",
                self.model.cases[self.case].name
            ))
        })?;
        Ok((rod, found))
    }

    /// Returns the predictions of the sights of a row.
    fn poses(&self, rod: &Rod, shape: &Configuration, row: usize, at: &[f64]) -> Vec<Pose> {
        let nodes = rod.places();
        let sights = self.model.sights_of_row(self.case, row);
        (sights.iter())
            .map(|sight| self.model.pose(&nodes, shape, sight.marker, at))
            .collect()
    }

    /// Returns the derivatives of the residuals of a row, from the same table at points beside.
    fn derivatives(
        &self,
        row: usize,
        (rod, shape): (&Rod, &Configuration),
        others: &[Resting],
        widths: &[[f64; 2]],
    ) -> Result<DMatrix<f64>, FitError> {
        let lu = Tangent::stiffness(rod, shape, 0.0)
            .factor()
            .ok_or_else(|| {
                let line = self.rows.lines[row];
                let name = &self.model.cases[self.case].name;
                FitError::Data(format!(
                    "{name}, line {line}: the shape at rest is about to buckle"
                ))
            })?;
        let here = forces(rod, shape);
        let beside: Vec<(Rod, Configuration)> = (others.iter())
            .map(|other| {
                let rod = other.commanded(row);
                let mut moved = shape.clone();
                place_base(&rod, &mut moved);
                (rod, moved)
            })
            .collect();
        let changes: Vec<Vec<Vector6<f64>>> = (beside.iter())
            .map(|(rod, shape)| {
                let there = forces(rod, shape);
                there.iter().zip(&here).map(|(a, b)| a - b).collect()
            })
            .collect();
        let steps = lu.solve(&changes);
        let sights = self.model.sights_of_row(self.case, row);
        let residuals = |poses: Vec<Pose>| -> Vec<f64> {
            let mut out = Vec::new();
            for (pose, sight) in poses.iter().zip(sights) {
                self.model.append_residuals(pose, sight, &mut out);
            }
            out
        };
        let own = residuals(self.poses(rod, shape, row, self.at));
        let moved: Vec<Vec<f64>> = (beside.into_iter().zip(steps).zip(others))
            .map(|(((rod, mut shape), step), other)| {
                let first = rod.first_free_node();
                for (node, step) in (first..).zip(&step) {
                    shape.positions[node] += step.fixed_rows::<3>(0);
                    shape.rotations[node] *= exp(&step.fixed_rows::<3>(3).into_owned());
                }
                residuals(self.poses(&rod, &shape, row, other.at))
            })
            .collect();
        Ok(DMatrix::from_fn(own.len(), widths.len(), |i, j| {
            slope(own[i], [moved[2 * j][i], moved[2 * j + 1][i]], widths[j])
        }))
    }
}

/// Carries a shape rigidly to where the rod has its base. A base that moved alone would strain the first element, in which a stiff arm is far
/// from linear.
fn place_base(rod: &Rod, shape: &mut Configuration) {
    if rod.first_free_node() == 0 {
        return;
    }
    let (from, to) = (shape.positions[0], rod.rest.positions[0]);
    let turn = rod.rest.rotations[0] * shape.rotations[0].transpose();
    if from == to && turn == Matrix3::identity() {
        return;
    }
    for (x, r) in shape.positions.iter_mut().zip(&mut shape.rotations) {
        *x = to + turn * (*x - from);
        *r = turn * *r;
    }
    shape.positions[0] = to;
    shape.rotations[0] = rod.rest.rotations[0];
}

/// Returns the forces and moments on the free nodes of a shape that need not be at rest.
fn forces(rod: &Rod, shape: &Configuration) -> Vec<Vector6<f64>> {
    let mut net = NodalForces::zeros(rod.n_nodes());
    net.evaluate(rod, &shape.positions, &shape.rotations, 0.0);
    (rod.first_free_node()..rod.n_nodes())
        .map(|node| {
            let (f, m) = (&net.forces[node], &net.moments[node]);
            Vector6::new(f.x, f.y, f.z, m.x, m.y, m.z)
        })
        .collect()
}
