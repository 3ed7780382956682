//! The optimal-control problem of a scene as arrays, for a solver of one's own.

use faer::Mat;
use nalgebra::Vector3;
use numpy::ndarray::{Array2, Array3, Array4};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyArray4};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use super::{interruptibly, raise, read, scene_error};
use crate::arrays::{Numbers, numbers};
use softarm::control::{
    ControlKind, Guess, LiftedPoint, OptimalControlProblem, Transcription, block_transitions,
    first_point,
};
use softarm::mechanics::Trajectory;
use softarm::scene::OptimalControl;
use softarm::solve::saved_coefficients;
use softarm::sqp::{ConvexSet, Failure, LiftedProgram as _, LinearizationRequest, Multipliers};

/// The discrete problem of a scene: `Program(name, text=None, overrides=[])`.
#[pyclass(module = "softarm._softarm", frozen)]
pub(super) struct Program {
    setup: OptimalControl,
}

/// Positions `(N+1, K+1, 3)` and rotations `(N+1, K+1, 3, 3)`.
type Motion<'py> = (Bound<'py, PyArray3<f64>>, Bound<'py, PyArray4<f64>>);
/// Objective, constraints and inequalities.
type Values<'py> = (f64, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);
/// `A` and `B` of a block.
type Block<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>);
/// Changes of positions and rotations, `(N+1, K+1, 3)` each.
type Change<'py> = (Bound<'py, PyArray3<f64>>, Bound<'py, PyArray3<f64>>);

fn failed(py: Python<'_>, failure: &Failure) -> PyErr {
    raise(py, "ModelError", failure.to_string())
}

fn array<'py>(py: Python<'py>, matrix: &Mat<f64>) -> Bound<'py, PyArray2<f64>> {
    Array2::from_shape_fn((matrix.nrows(), matrix.ncols()), |(i, j)| matrix[(i, j)])
        .into_pyarray(py)
}

fn rows_of<'py>(
    py: Python<'py>,
    vectors: &[Vector3<f64>],
    n_nodes: usize,
) -> Bound<'py, PyArray3<f64>> {
    Array3::from_shape_fn((vectors.len() / n_nodes, n_nodes, 3), |(k, q, i)| {
        vectors[k * n_nodes + q][i]
    })
    .into_pyarray(py)
}

fn motion<'py>(py: Python<'py>, trajectory: &Trajectory) -> Motion<'py> {
    let n_nodes = trajectory.n_nodes;
    let rotations = &trajectory.rotations;
    let shape = (rotations.len() / n_nodes, n_nodes, 3, 3);
    let rotations = Array4::from_shape_fn(shape, |(k, q, i, j)| rotations[k * n_nodes + q][(i, j)]);
    (
        rows_of(py, &trajectory.positions, n_nodes),
        rotations.into_pyarray(py),
    )
}

impl Program {
    fn problem(&self) -> &OptimalControlProblem {
        &self.setup.problem
    }

    /// Returns the variables of an array.
    fn variables(&self, variables: &Numbers<'_>) -> PyResult<Vec<f64>> {
        numbers("variables", variables, &[self.problem().n_variables()])
    }

    fn transcription(&self) -> Transcription<'_> {
        Transcription::new(self.problem(), 1)
    }

    /// Returns what `work` makes of the problem, on a thread of its own that an interrupt of Python asks to stop.
    fn interruptibly<T: Send + 'static>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&OptimalControlProblem) -> Result<T, Failure> + Send + 'static,
    ) -> PyResult<T> {
        let mut problem = self.problem().clone();
        let work = move |stop| {
            problem.stop = stop;
            work(&problem)
        };
        interruptibly(py, work, |failure| failed(py, &failure))
    }
}

/// Returns the point with the simulated motion of given variables.
fn at(program: &Transcription<'_>, variables: &[f64]) -> Result<LiftedPoint, Failure> {
    let start = LiftedPoint {
        trajectory: Trajectory::with_capacity(program.problem().rod.n_nodes(), 0),
        variables: vec![0.0; variables.len()],
    };
    program.rollout(&start, variables)
}

#[pymethods]
impl Program {
    #[new]
    #[pyo3(signature = (name, text=None, overrides=Vec::new()))]
    fn new(
        py: Python<'_>,
        name: &str,
        text: Option<&str>,
        overrides: Vec<String>,
    ) -> PyResult<Self> {
        let (scene, source) = read(py, name, text, &overrides)?;
        // A deadline of the scene is one of its solves.
        let work = move |stop| scene.optimal_control_until(&source, &stop);
        let setup = interruptibly(py, work, |error| scene_error(py, &error))?;
        Ok(Self { setup })
    }

    /// Number of variables.
    #[getter]
    fn n_variables(&self) -> usize {
        self.problem().n_variables()
    }

    /// Number of the first variables that are coefficients of the control.
    #[getter]
    fn n_controls(&self) -> usize {
        self.problem().n_controls()
    }

    /// Times of the motion, s, `(N+1,)`.
    #[getter]
    fn times<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let grid = self.problem().grid;
        (0..=grid.n_steps)
            .map(|k| grid.time(k))
            .collect::<Vec<f64>>()
            .into_pyarray(py)
    }

    /// Starts of the blocks of the control, and the end, s.
    #[getter]
    fn blocks<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.problem().control.edge_times().into_pyarray(py)
    }

    /// The components of a coefficient of the control: `(name, axis, unit, rest)`, "force" (spatial) or "moment" (body) on a node with its
    /// axis as 3 node + i, or the name of another control with no axis. Variable `c + n j` is coefficient `j` of component `c` of `n`, divided
    /// by its unit; the control is `rest` more than the coefficient.
    #[getter]
    fn components(&self) -> Vec<(String, Option<usize>, f64, f64)> {
        let problem = self.problem();
        (problem.named_controls().into_iter())
            .zip(problem.actuated_components())
            .map(|(own, component)| {
                let unit = problem.channel(&component).unit();
                match own.kind {
                    ControlKind::Wrench { node, component } => {
                        let kind = if component < 3 { "force" } else { "moment" };
                        let axis = 3 * node + component % 3;
                        (kind.to_string(), Some(axis), unit, own.rest)
                    }
                    ControlKind::Own | ControlKind::Effort { .. } => {
                        (own.name, None, unit, own.rest)
                    }
                }
            })
            .collect()
    }

    /// The convex sets of the variables as dictionaries.
    #[getter]
    fn sets<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let program = self.transcription();
        let out = PyList::empty(py);
        for set in program.sets() {
            let own = PyDict::new(py);
            match set {
                ConvexSet::Interval {
                    index,
                    lower,
                    upper,
                } => {
                    own.set_item("kind", "interval")?;
                    own.set_item("rows", vec![vec![(*index, 1.0)]])?;
                    own.set_item("lower", lower)?;
                    own.set_item("upper", upper)?;
                }
                ConvexSet::HalfSpace { direction, limit } => {
                    own.set_item("kind", "half-space")?;
                    own.set_item("rows", vec![direction.clone()])?;
                    own.set_item("upper", limit)?;
                }
                ConvexSet::Ball { rows, radius } => {
                    own.set_item("kind", "ball")?;
                    own.set_item("rows", rows.clone())?;
                    own.set_item("upper", radius)?;
                }
            }
            out.append(own)?;
        }
        Ok(out)
    }

    /// The variables with which a solve begins at first.
    fn guess<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let problem = self.problem();
        let first = match problem.stay {
            Some(_) => Guess::StaticPath,
            None => Guess::Rest,
        };
        let guess = self.setup.search.guess.unwrap_or(first);
        let found = py.detach(|| first_point(problem, guess, None));
        let (point, _) = found.map_err(|error| raise(py, "ModelError", error.to_string()))?;
        Ok(point.variables.into_pyarray(py))
    }

    /// The variables of the solution in a result directory; residuals of soft goals are zero.
    fn solution<'py>(
        &self,
        py: Python<'py>,
        directory: std::path::PathBuf,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let problem = self.problem();
        let found = saved_coefficients(&directory, problem);
        let coefficients = found.map_err(|words| raise(py, "ResultError", words))?;
        Ok(problem.variables(&coefficients).into_pyarray(py))
    }

    /// The motion under given variables.
    fn rollout<'py>(&self, py: Python<'py>, variables: Numbers<'_>) -> PyResult<Motion<'py>> {
        let variables = self.variables(&variables)?;
        let point = self.interruptibly(py, move |problem| {
            at(&Transcription::new(problem, 1), &variables)
        })?;
        Ok(motion(py, &point.trajectory))
    }

    /// Objective, constraints and inequalities on the motion under given variables.
    fn evaluate<'py>(&self, py: Python<'py>, variables: Numbers<'_>) -> PyResult<Values<'py>> {
        let variables = self.variables(&variables)?;
        let values = self.interruptibly(py, move |problem| {
            let program = Transcription::new(problem, 1);
            program.evaluate(&at(&program, &variables)?)
        })?;
        Ok((
            values.objective,
            values.constraints.into_pyarray(py),
            values.inequalities.into_pyarray(py),
        ))
    }

    /// The derivatives on the motion under given variables, as a dictionary; `rows` are the inequalities whose gradients are asked for,
    /// ascending, by default those near their limits. With multipliers `curvature` is the difference between the exact Hessian of the
    /// Lagrangian and that of Gauss and Newton.
    #[pyo3(signature = (variables, constraint_multipliers=None, inequality_multipliers=None, rows=None))]
    fn linearize<'py>(
        &self,
        py: Python<'py>,
        variables: Numbers<'_>,
        constraint_multipliers: Option<Numbers<'_>>,
        inequality_multipliers: Option<Numbers<'_>>,
        rows: Option<Vec<usize>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let variables = self.variables(&variables)?;
        let program = self.transcription();
        let (n_constraints, n_rows) = (program.goal_rows().len(), program.n_path_rows());
        if let Some(rows) = &rows
            && !(rows.is_sorted_by(|a, b| a < b) && rows.last().is_none_or(|last| *last < n_rows))
        {
            return Err(PyValueError::new_err(format!(
                "rows: expected ascending numbers of inequalities, of which there are {n_rows}"
            )));
        }
        let mut multipliers = Multipliers::zeros(n_constraints, n_rows, program.sets());
        let is_exact = constraint_multipliers.is_some() || inequality_multipliers.is_some();
        if let Some(given) = &constraint_multipliers {
            let name = "constraint_multipliers";
            multipliers.constraints = numbers(name, given, &[n_constraints])?;
        }
        if let Some(given) = &inequality_multipliers {
            multipliers.inequalities = numbers("inequality_multipliers", given, &[n_rows])?;
        }
        let (values, found) = self.interruptibly(py, move |problem| {
            let program = Transcription::new(problem, 1);
            let point = at(&program, &variables)?;
            let values = program.evaluate(&point)?;
            let near = |row: &usize| {
                values.inequalities[*row] > -program.screening_margin()
                    || multipliers.inequalities[*row] != 0.0
            };
            let rows = rows.unwrap_or_else(|| (0..n_rows).filter(near).collect());
            let request = LinearizationRequest {
                multipliers: is_exact.then_some(&multipliers),
                rows: &rows,
            };
            let found = program.linearize(&point, &values, &request)?;
            Ok((values, found))
        })?;
        let out = PyDict::new(py);
        let held: Vec<f64> = (found.rows.iter())
            .map(|row| values.inequalities[*row])
            .collect();
        out.set_item("objective", values.objective)?;
        out.set_item("gradient", found.gradient.into_pyarray(py))?;
        out.set_item("gauss_newton", array(py, &found.gauss_newton))?;
        out.set_item("constraints", values.constraints.into_pyarray(py))?;
        out.set_item("jacobian", array(py, &found.jacobian))?;
        out.set_item("rows", found.rows)?;
        out.set_item("inequalities", held.into_pyarray(py))?;
        out.set_item("inequality_jacobian", array(py, &found.inequality_jacobian))?;
        if let Some(curvature) = &found.curvature {
            out.set_item("curvature", array(py, curvature))?;
        }
        Ok(out)
    }

    /// The change of the motion along a change of the variables.
    fn sensitivity<'py>(
        &self,
        py: Python<'py>,
        variables: Numbers<'_>,
        change: Numbers<'_>,
    ) -> PyResult<Change<'py>> {
        let variables = self.variables(&variables)?;
        let change = numbers("change", &change, &[variables.len()])?;
        let found = self.interruptibly(py, move |problem| {
            let program = Transcription::new(problem, 1);
            let point = at(&program, &variables)?;
            let values = program.evaluate(&point)?;
            program.expand(&point, &values.defects, &change)
        })?;
        let along = found.trajectory;
        let n_nodes = self.problem().rod.n_nodes();
        Ok((
            rows_of(py, &along.positions, n_nodes),
            rows_of(py, &along.rotations, n_nodes),
        ))
    }

    /// The linearized motion over every block of the control: `A` of the states and `B` of inputs that are constant over the block.
    fn transitions<'py>(
        &self,
        py: Python<'py>,
        variables: Numbers<'_>,
    ) -> PyResult<Vec<Block<'py>>> {
        let variables = self.variables(&variables)?;
        let found = self.interruptibly(py, move |problem| {
            let coefficients = problem.coefficients(&variables);
            let point = at(&Transcription::new(problem, 1), &variables)?;
            block_transitions(problem, &point.trajectory, &coefficients, 1)
                .map_err(|error| Failure(error.to_string()))
        })?;
        Ok((found.iter())
            .map(|own| (array(py, &own.state), array(py, &own.input)))
            .collect())
    }
}
