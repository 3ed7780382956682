//! The search for the coarsest grid on which a simulation is accurate enough.

use super::grid::{self, End, Grid, GridErrors, GridRule, HOUR, LONGEST, Measured, Order};
use super::motion::{ComparedMotion, Run, RunError, Setup};
use crate::mechanics::{StepError, TimeScheme};
use crate::output::summary::{AccuracySummary, Level};
use crate::stop::StopSignal;
use crate::task::Discretization;
use crate::task::prediction::{FEWEST_ELEMENTS, Work, first_elements};

/// Cap on the elements of a first grid, also if fewer cannot represent the arm or its motion: three doublings of the fewest.
const MOST_AT_FIRST: usize = 8 * FEWEST_ELEMENTS;
/// First length of implicit steps, relative to the automatic one, which allows for an arm that is bent into a circle (decision 77). The
/// bound `2 sqrt(J/M)` falls with the root of the bending moment, so that steps four times as long are stable up to a sixteenth of that
/// bending. A search tries them because it notices where they fail; they save a stiff wire two thirds of its time.
const LONGER: f64 = 4.0;
/// Lower limit of the length of steps, relative to the automatic one: a cap on the halvings of the step when a motion breaks down, such as
/// when a sudden load bends an arm into more than a circle. By the same bound, a sixteenth is stable up to 256 circles.
const SHORTEST: f64 = 1.0 / 16.0;
/// Duration of the work of a search, as a multiple of its motion, from which its integrator is chosen: the node-steps of the three coarse
/// motions, `1 + 2 + 2` for one with half the step and one with twice the elements.
const MOTIONS: f64 = 5.0;

/// A grid that is accurate enough.
#[derive(Clone, Debug)]
pub struct Choice {
    /// The discretization; nothing in it is left open.
    pub discretization: Discretization,
    /// Estimated largest position error of any place at any time, divided by the length.
    pub error: f64,
    /// Parts of the error that elements and steps make, by the model of the error.
    pub parts: [f64; 2],
    /// The measured grids, in order.
    pub levels: Vec<Level>,
}

/// The reason why no grid was found.
#[derive(Clone, Debug, thiserror::Error)]
pub enum ChoiceError {
    /// A motion could not be simulated.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Errors do not fall with finer grids.
    #[error(
        "an accuracy of {accuracy:e} of the length is out of reach: with {elements} elements and steps of {step:.3e} s the motion still changes by \
         about {error:.1e}, and finer grids change that little; such a motion depends on its smallest details: shorten it, add the damping that the \
         material has, or let loads grow in time; or give rod.elements"
    )]
    Stalled {
        /// Requested accuracy, divided by the length.
        accuracy: f64,
        /// Estimated error on the last grid, divided by the length.
        error: f64,
        /// Elements of the last grid.
        elements: usize,
        /// Step of the last grid, s.
        step: f64,
    },
    /// The required grid would take too long.
    #[error(
        "an accuracy of {accuracy:e} of the length needs about {elements} elements and steps of {step:.3e} s, which would take some {hours:.0} hours; ask \
         for less, or give rod.elements"
    )]
    TooLong {
        /// Requested accuracy, divided by the length.
        accuracy: f64,
        /// Elements.
        elements: usize,
        /// Step, s.
        step: f64,
        /// Predicted hours.
        hours: f64,
    },
}

/// Finds the coarsest grid on which the estimated error of no place at any time exceeds `accuracy` lengths.
///
/// `base` has what is not chosen: strain rule, integrator and rotary inertia if they are given, and controls.
///
/// # Errors
/// Returns [`ChoiceError`] if no grid is accurate enough or a motion cannot be simulated.
pub fn choose(
    motion: &ComparedMotion,
    base: &Discretization,
    accuracy: f64,
    stop: &StopSignal,
) -> Result<Choice, ChoiceError> {
    choose_telling(motion, base, accuracy, stop, &|_, _| ())
}

/// Finds a grid as [`choose`] does; `tell` is called before every motion, with its elements and its predicted time, s.
///
/// # Errors
/// As [`choose`].
pub fn choose_telling(
    motion: &ComparedMotion,
    base: &Discretization,
    accuracy: f64,
    stop: &StopSignal,
    tell: &dyn Fn(usize, f64),
) -> Result<Choice, ChoiceError> {
    let base = suited(motion, base, accuracy)?;
    let mut search = Search {
        motion,
        base,
        accuracy,
        stop,
        tell,
        longer: if base.scheme == Some(TimeScheme::Implicit) {
            LONGER
        } else {
            1.0
        },
        levels: Vec::new(),
        last: None,
    };
    let rule = GridRule {
        accuracy,
        order: Order::Assumed,
        longest: LONGEST,
    };
    let first = Grid {
        elements: first_elements(accuracy).div_ceil(2).max(FEWEST_ELEMENTS),
        step: f64::INFINITY,
    };
    let (last, end) = grid::search(&rule, first, |grid, before| {
        let (run, estimate) = match before {
            None => search.coarse(grid.elements)?,
            Some(before) => search.finer(grid, &before.estimate)?,
        };
        let seconds = search.predicted(estimate.grid)?;
        search.last = Some(run);
        Ok::<_, ChoiceError>(Some(Measured {
            estimate,
            seconds,
            too_coarse: false,
        }))
    })?;
    let Search {
        levels, last: run, ..
    } = search;
    let (Some(Measured { estimate, .. }), Some(run)) = (last, run) else {
        unreachable!("a search measures at least one grid")
    };
    match end {
        End::Met => Ok(Choice {
            discretization: run.discretization,
            error: estimate.error(),
            parts: estimate.parts,
            levels,
        }),
        End::TooLong { wanted, seconds } => Err(too_long(accuracy, wanted, seconds)),
        End::OutOfReach | End::Unmeasured => Err(ChoiceError::Stalled {
            accuracy,
            error: estimate.error(),
            elements: estimate.grid.elements,
            step: estimate.grid.step,
        }),
    }
}

impl Choice {
    /// Returns the choice and the requested accuracy as the numbers and the sentence of a summary.
    #[must_use]
    pub fn summary(self, asked: f64) -> AccuracySummary {
        let grid = Grid {
            elements: self.discretization.elements,
            step: self.discretization.step.unwrap_or(f64::NAN),
        };
        let estimate = GridErrors {
            grid,
            parts: self.parts,
        };
        grid::summary(asked, &estimate, true, self.levels)
    }
}

fn too_long(accuracy: f64, wanted: Grid, seconds: f64) -> ChoiceError {
    ChoiceError::TooLong {
        accuracy,
        elements: wanted.elements,
        step: wanted.step,
        hours: seconds / HOUR,
    }
}

impl ChoiceError {
    /// Tells whether the motion broke down before its end.
    fn breaks_down(&self) -> bool {
        matches!(self, Self::Run(RunError::Step(error)) if !matches!(error, StepError::Stopped(_)))
    }

    /// Tells whether more elements may help.
    fn is_of_coarse_grids(&self) -> bool {
        self.breaks_down() || matches!(self, Self::Run(RunError::Discretize(_)))
    }
}

/// Returns the discretization that all grids of a search share. Its integrator is chosen for the work of the whole search: the first motion
/// alone is short work, for which another one would be chosen.
fn suited(
    motion: &ComparedMotion,
    base: &Discretization,
    accuracy: f64,
) -> Result<Discretization, ChoiceError> {
    let mut first = Discretization {
        elements: first_elements(accuracy),
        ..*base
    };
    loop {
        let found = (motion.arm).choose(&first, MOTIONS * motion.duration, Work::Simulation);
        match found {
            Ok((base, _)) => return Ok(base),
            // Too few elements may be unable to represent the rest shape.
            Err(_) if first.elements < MOST_AT_FIRST => first.elements *= 2,
            Err(error) => return Err(RunError::from(error).into()),
        }
    }
}

struct Search<'a> {
    motion: &'a ComparedMotion,
    /// Discretization that all grids share: one motion is simulated with one integrator and one inertia.
    base: Discretization,
    accuracy: f64,
    stop: &'a StopSignal,
    tell: &'a dyn Fn(usize, f64),
    /// Longest step divided by the automatic one.
    longer: f64,
    levels: Vec<Level>,
    /// The motion on the last grid.
    last: Option<Run>,
}

impl Search<'_> {
    /// Simulates with steps no longer than those of `grid` and than the longest that are tried. Halves the steps while the motion breaks
    /// down, down to `shortest` times the automatic step.
    fn run(&mut self, grid: Grid, shortest: f64) -> Result<Run, ChoiceError> {
        loop {
            match self.try_run(grid) {
                Err(error) if error.breaks_down() && self.longer > shortest => self.longer *= 0.5,
                done => return done,
            }
        }
    }

    fn try_run(&self, grid: Grid) -> Result<Run, ChoiceError> {
        let setup = self.setup(grid)?;
        let seconds = setup.predicted();
        if seconds > LONGEST {
            let step = setup.grid.step;
            return Err(too_long(self.accuracy, Grid { step, ..grid }, seconds));
        }
        (self.tell)(grid.elements, seconds);
        Ok(setup.run(self.stop).map_err(RunError::from)?)
    }

    fn setup(&self, grid: Grid) -> Result<Setup, RunError> {
        let open = Discretization {
            elements: grid.elements,
            step: None,
            ..self.base
        };
        Ok((self.motion).setup_longer(&open, self.longer, grid.step, self.stop)?)
    }

    fn predicted(&self, grid: Grid) -> Result<f64, RunError> {
        Ok(self.setup(grid)?.predicted())
    }

    /// Runs three coarse motions; with more elements while they break down, and then with steps shorter than automatic ones.
    fn coarse(&mut self, first: usize) -> Result<(Run, GridErrors), ChoiceError> {
        let mut shortest = 1.0;
        let mut elements = first;
        loop {
            match self.coarse_with(elements, shortest) {
                Err(error) if error.is_of_coarse_grids() && elements < MOST_AT_FIRST => {
                    elements *= 2
                }
                Err(error) if error.breaks_down() && shortest > SHORTEST => {
                    shortest = SHORTEST;
                    elements = first;
                }
                done => return done,
            }
        }
    }

    /// Compares a coarse grid with one of half the step and with one of twice the elements, either of which has a quarter of the respective
    /// error of the coarse one.
    fn coarse_with(
        &mut self,
        elements: usize,
        shortest: f64,
    ) -> Result<(Run, GridErrors), ChoiceError> {
        let length = self.motion.arm.length;
        let longest = f64::INFINITY;
        let coarse = self.run(
            Grid {
                elements,
                step: longest,
            },
            shortest,
        )?;
        let half = 0.5 * coarse.step();
        let in_time = self.run(
            Grid {
                elements,
                step: half,
            },
            shortest,
        )?;
        // Shorter elements need shorter explicit steps.
        let is_explicit = coarse.discretization.scheme == Some(TimeScheme::Explicit);
        let like = if is_explicit { &in_time } else { &coarse };
        let finer = Grid {
            elements: 2 * elements,
            step: like.step(),
        };
        // The elements of every piece are doubled.
        self.base.multiple = 2;
        let in_space = self.run(finer, shortest);
        self.base.multiple = 1;
        let in_space = in_space?;
        // Richardson's extrapolation of the second order from a grid twice as fine.
        let estimate = |a: &Run, b: &Run| a.course.errors(&b.course, length).shape * 4.0 / 3.0;
        let parts = [estimate(like, &in_space), estimate(&coarse, &in_time)];
        for (run, error) in [
            (&coarse, Some(parts[0] + parts[1])),
            (&in_time, None),
            (&in_space, None),
        ] {
            self.note(run, error);
        }
        let grid = coarse.grid();
        Ok((coarse, GridErrors { grid, parts }))
    }

    /// Runs a finer grid and compares it with the last one.
    fn finer(&mut self, grid: Grid, before: &GridErrors) -> Result<(Run, GridErrors), ChoiceError> {
        let run = self.run(grid, SHORTEST)?;
        let distance = self.last.as_ref().map_or(f64::INFINITY, |last| {
            (last.course.errors(&run.course, self.motion.arm.length)).shape
        });
        let estimate = before.seen(run.grid(), distance);
        self.note(&run, Some(estimate.error()));
        Ok((run, estimate))
    }

    fn note(&mut self, run: &Run, error: Option<f64>) {
        self.levels.push(Level {
            elements: run.discretization.elements,
            step_s: run.step(),
            error,
        });
    }
}
