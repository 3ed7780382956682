//! Tables of shapes at rest: many commands of one arm, each followed from a shape nearby, with derivatives by the implicit function theorem.
//!
//! One factorization of the [tangent stiffness](crate::mechanics::at_rest) of a row serves all parameters, and derivatives cost evaluations of
//! forces in place of equilibria. Parameters that move the base carry the shape with it.

use std::sync::Mutex;

use nalgebra::{DMatrix, Vector6};

use super::data::{Kind, Rows};
use super::least_squares::{Beside, slope};
use super::{FitError, Model, Pose};
use crate::mechanics::at_rest::{self, OfRow, carry_to_base, displace, forces, shape_near};
use crate::mechanics::equilibrium::EquilibriumError;
use crate::mechanics::tangent::Tangent;
use crate::mechanics::{Configuration, Rod};

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
        Ok(scene.discrete_rod(&source)?)
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
            Ok((shape, columns))
        })?;
        let n: usize = found.iter().map(DMatrix::nrows).sum();
        let mut out = DMatrix::zeros(n, at.len());
        let mut first = 0;
        for own in found {
            out.rows_mut(first, own.nrows()).copy_from(&own);
            first += own.nrows();
        }
        Ok(out)
    }
}

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
    fn in_runs<T: Send>(&self, of_row: OfRow<T, FitError>) -> Result<Vec<T>, FitError> {
        at_rest::in_runs(self.rows.len(), self.model.n_threads, of_row)
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
        let starts = known.as_ref().into_iter().chain(near);
        let found = shape_near(&rod, starts, self.model.stop).map_err(|error| match error {
            EquilibriumError::Stopped(why) => FitError::Stopped(why),
            error => {
                let name = &self.model.cases[self.case].name;
                FitError::Data(format!("{name}, line {}: {error}", self.rows.lines[row]))
            }
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
                carry_to_base(&rod, &mut moved);
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
                displace(&rod, &mut shape, &step);
                residuals(self.poses(&rod, &shape, row, other.at))
            })
            .collect();
        Ok(DMatrix::from_fn(own.len(), widths.len(), |i, j| {
            slope(own[i], [moved[2 * j][i], moved[2 * j + 1][i]], widths[j])
        }))
    }
}
