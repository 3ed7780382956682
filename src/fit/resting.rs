//! Tables of shapes at rest: many commands of one arm, each followed from a shape nearby, with derivatives by the implicit function theorem.
//!
//! One factorization of the [tangent stiffness](crate::mechanics::at_rest) of a row serves all parameters, and derivatives cost evaluations of
//! forces in place of equilibria. Parameters that move the base carry the shape with it.

use std::sync::{Mutex, MutexGuard, PoisonError};

use nalgebra::{DMatrix, DVector};

use super::least_squares::{Beside, Residuals, stacked};
use super::rows::Rows;
use super::{FitError, Model, Pose};
use crate::mechanics::at_rest::{self, OfRow, shape_near};
use crate::mechanics::equilibrium::EquilibriumError;
use crate::mechanics::{Configuration, Rod, RodError};

/// Change of an input by which its actuator is found, as a part of the largest one.
const PROBE: f64 = 0.5;

/// The actuators of the keys of a table, and the last shape of every row.
#[derive(Debug)]
pub struct Remembered {
    /// Index among the actuators of the rod of every key.
    actuators: Vec<usize>,
    shapes: Vec<Mutex<Option<Configuration>>>,
    /// Directions in which the actuators with friction have slid, as far as they are not those of the scene: those that rows have.
    slid: Vec<Vec<(usize, f64)>>,
    /// Index of its directions of every row.
    slid_of_row: Vec<usize>,
}

/// A table under parameters.
struct Resting<'a> {
    model: &'a Model<'a>,
    case: usize,
    rows: &'a Rows,
    remembered: &'a Remembered,
    at: &'a [f64],
    /// Values of the keys that act in every row of the file.
    acting: Vec<f64>,
    /// The rod for every set of directions of sliding.
    rods: Vec<Rod>,
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
        let (slid, slid_of_row) = if rows.slides_in_order {
            slid(rows, &actuators, &rod)
        } else {
            (vec![Vec::new()], vec![0; rows.len()])
        };
        if rows.slides_in_order && !rod.actuators.has_friction() {
            return refuse(format!(
                "{name}: sliding = \"in-order\" is for tendons with friction, and none of this arm has any"
            ));
        }
        Ok(Remembered {
            actuators,
            shapes: (0..rows.len()).map(|_| Mutex::new(None)).collect(),
            slid,
            slid_of_row,
        })
    }

    /// Returns the rods of a case at rest under parameters, for every set of directions in which actuators have slid.
    fn rods_at_rest(
        &self,
        at: &[f64],
        case: usize,
        more: &[String],
        slid: &[Vec<(usize, f64)>],
    ) -> Result<Vec<Rod>, FitError> {
        let (scene, source) = self.scene(at, case, None, more)?;
        let arm = scene.arm(&source)?;
        let discretization = scene.discretization();
        let rod = |directions: &Vec<(usize, f64)>| {
            let mut arm = arm.clone();
            for &(actuator, direction) in directions {
                let own = arm.actuators.get_mut(actuator);
                if let Some(friction) = own.and_then(|own| own.friction.as_mut()) {
                    friction.at_rest = direction;
                }
            }
            let refused = |error: RodError| scene.discretize_error(&source, error.into());
            Ok(arm.rod(&discretization).map_err(refused)?)
        };
        slid.iter().map(rod).collect()
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
            let poses = resting.poses(&rod, &shape, row);
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
        let remembered = self.remembered.get(case).and_then(Option::as_ref);
        let Some((rows, remembered)) = self.cases[case].rows().zip(remembered) else {
            return Err(FitError::Data("no table".into()));
        };
        let mut rods = self.rods_at_rest(at, case, more, &remembered.slid)?;
        for rod in &mut rods {
            rod.multiply_loads(loads);
        }
        let own = rows.keys.iter().zip(&rows.play);
        let play: Vec<f64> = own.map(|(key, own)| self.play(at, key, *own)).collect();
        Ok(Resting {
            model: self,
            case,
            rows,
            remembered,
            at,
            acting: rows.acting(&|key, value| self.given(at, key, value), &play),
            rods,
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
        // Numbers beside the end of their range have one side.
        let others: Vec<Option<Resting>> = (beside.points.iter())
            .map(|point| self.resting(point, case, &[], 1.0).ok())
            .collect();
        let found = resting.in_runs(&|row, near| {
            let (rod, shape) = resting.shape(row, near)?;
            let (here, moved) = resting.beside(row, (&rod, &shape), &others)?;
            let columns = beside.differences(&here, moved);
            // The reason why a point cannot be computed.
            let columns = columns.map_err(|index| {
                let refused = self.resting(&beside.points[index], case, &[], 1.0).err();
                refused.unwrap_or_else(|| resting.refused(row, "its derivatives are no numbers"))
            })?;
            Ok((shape, columns))
        })?;
        Ok(stacked(&found, at.len()))
    }
}

/// Returns the sets of directions, 1 for pulled, in which the strain actuators of some rows have slid, and the index of every row among them: an
/// actuator of a winch is pulled where its command falls. Those whose command has not changed yet are left out.
fn slid(rows: &Rows, actuators: &[usize], rod: &Rod) -> (Vec<Vec<(usize, f64)>>, Vec<usize>) {
    let pulls = |actuator: usize| match rod.actuators.iter().nth(actuator) {
        Some(drive) if drive.winch.is_some() => -1.0,
        _ => 1.0,
    };
    let signs: Vec<f64> = actuators.iter().map(|&own| pulls(own)).collect();
    let mut sets: Vec<Vec<i8>> = Vec::new();
    let mut of_row = Vec::new();
    for directions in rows.directions() {
        let known = sets.iter().position(|own| *own == directions);
        of_row.push(known.unwrap_or(sets.len()));
        if known.is_none() {
            sets.push(directions);
        }
    }
    let of_set = |set: &Vec<i8>| {
        let all = actuators.iter().zip(&signs).zip(set);
        all.filter(|(_, way)| **way != 0)
            .map(|((&actuator, sign), way)| (actuator, sign * f64::from(*way)))
            .collect()
    };
    (sets.iter().map(of_set).collect(), of_row)
}

impl Resting<'_> {
    /// Returns a complaint about a row.
    fn refused(&self, row: usize, words: impl std::fmt::Display) -> FitError {
        let name = &self.model.cases[self.case].name;
        FitError::Data(format!("{name}, line {}: {words}", self.rows.lines[row]))
    }

    fn slot(&self, row: usize) -> MutexGuard<'_, Option<Configuration>> {
        let slot = self.remembered.shapes[row].lock();
        slot.unwrap_or_else(PoisonError::into_inner)
    }

    /// Evaluates all rows, run by run, on the threads of the model.
    fn in_runs<T: Send>(&self, of_row: OfRow<T, FitError>) -> Result<Vec<T>, FitError> {
        at_rest::in_runs(self.rows.len(), self.model.n_threads, of_row)
    }

    /// Returns the rod under the commands of a row.
    fn commanded(&self, row: usize) -> Rod {
        let rod = &self.rods[self.remembered.slid_of_row[row]];
        let mut efforts = rod.actuators.efforts(0.0);
        let actuators = &self.remembered.actuators;
        let acting = &self.acting[self.rows.places[row] * actuators.len()..];
        for (&actuator, &value) in actuators.iter().zip(acting) {
            efforts[actuator] = self.loads * value;
        }
        rod.with_inputs(&efforts)
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
            error => self.refused(row, error),
        })?;
        Ok((rod, found))
    }

    /// Returns the predictions of the sights of a row.
    fn poses(&self, rod: &Rod, shape: &Configuration, row: usize) -> Vec<Pose> {
        let nodes = rod.places();
        let sights = self.model.sights_of_row(self.case, row);
        (sights.iter())
            .map(|sight| self.model.pose(&nodes, shape, sight.marker, self.at))
            .collect()
    }

    /// Returns the residuals of a row, and those to first order of the same row of tables at points beside; a point that cannot be computed has
    /// its index instead.
    fn beside(
        &self,
        row: usize,
        (rod, shape): (&Rod, &Configuration),
        others: &[Option<Resting>],
    ) -> Result<(DVector<f64>, Residuals<usize>), FitError> {
        let known = || others.iter().flatten();
        let rods: Vec<Rod> = known().map(|other| other.commanded(row)).collect();
        let shapes = at_rest::shapes_beside(rod, shape, &rods)
            .ok_or_else(|| self.refused(row, "the shape at rest is about to buckle"))?;
        let mut found = known().zip(rods.iter().zip(shapes));
        let moved = others.iter().enumerate().map(|(index, other)| {
            let (other, (rod, shape)) = other.as_ref().and_then(|_| found.next()).ok_or(index)?;
            Ok(other.residuals(row, rod, &shape))
        });
        Ok((self.residuals(row, rod, shape), moved.collect()))
    }

    /// Returns the residuals of a row in a shape.
    fn residuals(&self, row: usize, rod: &Rod, shape: &Configuration) -> DVector<f64> {
        let mut out = Vec::new();
        let sights = self.model.sights_of_row(self.case, row);
        for (pose, sight) in self.poses(rod, shape, row).iter().zip(sights) {
            self.model.append_residuals(pose, sight, &mut out);
        }
        DVector::from_vec(out)
    }
}
