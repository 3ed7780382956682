//! The hard limits of a problem on a shape in which its arm is held: obstacles, and limits of strain and direction, at the end of the
//! horizon. A speed is none at rest, and tensions are controls of [a search of their own](super::tensions).

use super::super::path::{PathConstraint, PathEnforcement, PathLimit, RodView};
use super::super::problem::OptimalControlProblem;
use mechanics::{Configuration, FormTerm, TimeGrid, Trajectory};

/// Scaled violation of a limit from which on a held shape is said to cross it: a tenth of what the check allows between samples, of a
/// body whose radius is a hundredth of the arm's length.
const CROSSES: f64 = 1e-5;

/// The rows of the limits that hold at the end, constraint by constraint.
#[derive(Clone, Debug)]
pub(super) struct HeldLimits<'a> {
    problem: &'a OptimalControlProblem,
    constraints: Vec<&'a PathConstraint>,
}

impl<'a> HeldLimits<'a> {
    /// Returns the limits of a problem.
    pub fn of(problem: &'a OptimalControlProblem) -> Self {
        let last = problem.grid.n_steps;
        let constraints = problem.path.iter().filter(|own| {
            own.enforcement == PathEnforcement::Hard
                && own.time_nodes.last() == Some(&last)
                && !matches!(own.limit, PathLimit::Speed { .. })
                && !own.limit.depends_on_inputs()
        });
        Self {
            constraints: constraints.collect(),
            problem,
        }
    }

    /// Tells whether there are none.
    pub fn is_empty(&self) -> bool {
        self.constraints.is_empty()
    }

    /// Returns the number of rows.
    pub fn n_rows(&self) -> usize {
        self.rows().count()
    }

    fn on<T>(&self, shape: &Configuration, read: impl FnOnce(&RodView) -> T) -> T {
        let mut trajectory = Trajectory::with_capacity(shape.positions.len(), 1);
        trajectory.push(shape);
        let grid = &self.problem.grid;
        read(&RodView {
            rod: &self.problem.rod,
            radii: &self.problem.radii,
            trajectory: &trajectory,
            grid: TimeGrid {
                start: grid.start + grid.duration(),
                ..*grid
            },
        })
    }

    fn rows(&self) -> impl Iterator<Item = (&'a PathConstraint, usize)> {
        let rod = &self.problem.rod;
        (self.constraints.iter())
            .flat_map(|own| (0..own.limit.n_items(rod)).map(|item| (*own, item)))
    }

    /// Returns the scaled values of all rows, at most zero within the limits.
    pub fn values(&self, shape: &Configuration) -> Vec<f64> {
        self.on(shape, |view| {
            self.rows()
                .map(|(own, item)| own.limit.value(view, 0, item))
                .collect()
        })
    }

    /// Returns the derivatives of some rows along `(δx, η)` of the nodes.
    pub fn gradients(&self, shape: &Configuration, rows: &[usize]) -> Vec<Vec<FormTerm>> {
        let all: Vec<_> = self.rows().collect();
        self.on(shape, |view| {
            (rows.iter())
                .map(|&row| {
                    let (own, item) = all[row];
                    let forms = own.limit.gradient(view, 0, item);
                    forms.into_iter().flat_map(|form| form.terms).collect()
                })
                .collect()
        })
    }

    /// Returns the largest value of all rows; minus infinity without any.
    pub fn largest(&self, shape: &Configuration) -> f64 {
        let worse = |a: f64, b: f64| if b <= a { a } else { b };
        (self.values(shape).into_iter()).fold(f64::NEG_INFINITY, worse)
    }

    /// Describes the limit that a shape crosses most; `None` if it crosses none.
    pub fn crossed(&self, shape: &Configuration) -> Option<String> {
        let values = self.values(shape);
        let ((own, _), worst) = (self.rows().zip(values))
            .max_by(|(_, a), (_, b)| a.total_cmp(b))
            .filter(|(_, worst)| *worst > CROSSES)?;
        let amount = worst * own.limit.scale(&self.problem.rod);
        Some(format!(
            "{} is off by {amount:.3e} {}",
            own.name,
            own.limit.unit()
        ))
    }
}
