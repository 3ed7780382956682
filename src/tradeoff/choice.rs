//! The coarsest grid that is accurate enough.
//!
//! The error of a motion on `K` elements with steps of `h` is modelled as `a/K² + b h²`, the orders of the rod and of its integrator. Three
//! coarse runs give `a` and `b`, the model gives a grid, and the grid is confirmed: the motion on it is compared with the one on a grid that
//! is 1.5 times coarser, and what the finer one still lacks follows by Richardson's extrapolation.

use super::motion::{Motion, Run, RunError, Setup};
use crate::mechanics::{StepError, TimeScheme};
use crate::output::summary::Level;
use crate::stop::StopSignal;
use crate::task::Discretization;
use crate::task::prediction::{FEWEST_ELEMENTS, Work, first_elements};

/// Part of the accuracy that the model of the error may use up; the rest is for what it does not know.
const MODELLED: f64 = 0.65;
/// Part of the accuracy up to which an error is left as it is.
const SLIGHT: f64 = 0.15;
/// An estimate up to this part of the accuracy confirms a grid: estimates are good to a quarter.
const CONFIRMED: f64 = 0.75;
/// What a grid that is refined once more aims at.
const AIM: f64 = 0.6;
/// How much coarser the grid is that confirms another.
const COARSER: f64 = 1.5;
/// Grids that are tried before the accuracy counts as out of reach.
const ROUNDS: usize = 6;
/// An error that a finer grid leaves above this part of what it was does not converge.
const STALLED: f64 = 0.9;
/// The coarsest grid of a search has no more elements than these, also where fewer cannot show the arm or its motion.
const MOST_AT_FIRST: usize = 32;
/// By how much a grid is refined at once.
const MOST_REFINED: usize = 2;
/// Most elements.
const MOST_ELEMENTS: f64 = 5000.0;
/// Steps that are solved for may be so much longer than automatic ones, which allow for an arm that is bent into a circle.
const LONGER: f64 = 4.0;
/// The shortest step over the automatic one that is tried where a motion breaks down, as where a sudden load bends an arm into more than a circle.
const SHORTEST: f64 = 1.0 / 16.0;
/// Motions that a search simulates, as if all were as long as that on the grid with which it begins.
const MOTIONS: f64 = 5.0;
/// Nobody waits longer for one of the runs, s.
const LONGEST: f64 = 3600.0;

/// Elements and longest step, s, of a finer grid, where the errors of `parts` that elements and steps make, over the length, are too much.
#[must_use]
pub fn finer(elements: usize, step: f64, parts: [f64; 2], accuracy: f64) -> Option<(usize, f64)> {
    let [of_elements, of_steps] = parts;
    // What is no number asks for nothing.
    if !(of_elements + of_steps > accuracy) {
        return None;
    }
    let model = ErrorModel {
        elements,
        step,
        parts,
    };
    let (wanted, longest) = model.grid(accuracy);
    // Errors of a coarse grid are estimated coarsely.
    let wanted = wanted.clamp(elements, MOST_REFINED * elements);
    Some((wanted, longest.min(step).max(step / MOST_REFINED as f64)))
}

/// A grid that is accurate enough.
#[derive(Clone, Debug)]
pub struct Choice {
    /// The discretization; nothing in it is left open.
    pub discretization: Discretization,
    /// Estimated error of any place at any time, over the length.
    pub error: f64,
    /// Parts of it that elements and steps make, as the model has them.
    pub parts: [f64; 2],
    /// The grids that were tried, in order.
    pub levels: Vec<Level>,
}

/// Why there is no grid.
#[derive(Clone, Debug, thiserror::Error)]
pub enum ChoiceError {
    /// A motion that was not simulated.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Errors that do not fall with finer grids.
    #[error(
        "an accuracy of {accuracy:e} of the length is out of reach: with {elements} elements and steps of {step:.3e} s the motion still changes by \
         about {error:.1e}, and finer grids change that little; such a motion depends on its smallest details: shorten it, add the damping that the \
         material has, or let loads grow in time; or give rod.elements"
    )]
    Stalled {
        /// What was asked, over the length.
        accuracy: f64,
        /// What the last grid is estimated to have, over the length.
        error: f64,
        /// Its elements.
        elements: usize,
        /// Its step, s.
        step: f64,
    },
    /// A grid that nobody waits for.
    #[error(
        "an accuracy of {accuracy:e} of the length needs about {elements} elements and steps of {step:.3e} s, which would take some {hours:.0} hours; ask \
         for less, or give rod.elements"
    )]
    TooLong {
        /// What was asked, over the length.
        accuracy: f64,
        /// Elements.
        elements: usize,
        /// Step, s.
        step: f64,
        /// Predicted hours.
        hours: f64,
    },
}

/// The coarsest grid on which no place of the arm is ever further than `accuracy` lengths from where it should be, as far as can be estimated.
///
/// `base` has what is not chosen: strain rule, integrator and rotary inertia, where they are given, and controls.
///
/// # Errors
/// [`ChoiceError`]
pub fn choose(
    motion: &Motion,
    base: &Discretization,
    accuracy: f64,
    stop: &StopSignal,
) -> Result<Choice, ChoiceError> {
    choose_telling(motion, base, accuracy, stop, &|_, _| ())
}

/// [`choose`]; `tell` is called before every motion, with its elements and the time that it is predicted to take, s.
///
/// # Errors
/// [`ChoiceError`]
pub fn choose_telling(
    motion: &Motion,
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
    };
    let model = search.coarse()?;
    let (mut elements, mut step) = model.grid(accuracy);
    let mut last = f64::INFINITY;
    let mut stalled = 0;
    let mut run = None;
    for _ in 0..ROUNDS {
        let fine = search.run_shown(elements, elements.max(model.elements), step)?;
        elements = fine.discretization.elements;
        let error = search.confirm(&fine, &model)?;
        search.levels.push(Level {
            elements,
            step_s: fine.step(),
            error: Some(error),
        });
        if error <= CONFIRMED * accuracy {
            return Ok(Choice {
                discretization: fine.discretization,
                error,
                parts: model.parts(elements, fine.step()),
                levels: search.levels,
            });
        }
        stalled += usize::from(error > STALLED * last);
        let finer = (error / (AIM * accuracy)).sqrt().clamp(1.2, 3.0);
        last = error;
        let wanted = (elements as f64 * finer).ceil();
        step = fine.step() / finer;
        run = Some(fine);
        if stalled == 2 || wanted > MOST_ELEMENTS {
            break;
        }
        elements = wanted as usize;
    }
    let (elements, step) = run.map_or((elements, step), |run| {
        (run.discretization.elements, run.step())
    });
    Err(ChoiceError::Stalled {
        accuracy,
        error: last,
        elements,
        step,
    })
}

impl ChoiceError {
    /// Whether a motion came to no end of its own.
    fn breaks_down(&self) -> bool {
        matches!(self, Self::Run(RunError::Step(error)) if !matches!(error, StepError::Stopped(_)))
    }

    /// Whether more elements may help.
    fn is_of_coarse_grids(&self) -> bool {
        self.breaks_down() || matches!(self, Self::Run(RunError::Discretize(_)))
    }
}

/// What all grids of a search have: its first motion is the fastest, and would by itself be simulated by the integrator of short work.
fn suited(
    motion: &Motion,
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
            // Few elements may be unable to show the arm's shape at rest.
            Err(_) if first.elements < MOST_AT_FIRST => first.elements *= 2,
            Err(error) => return Err(RunError::from(error).into()),
        }
    }
}

struct Search<'a> {
    motion: &'a Motion,
    /// What every grid has: one motion is simulated by one integrator, with one inertia.
    base: Discretization,
    accuracy: f64,
    stop: &'a StopSignal,
    tell: &'a dyn Fn(usize, f64),
    /// Longest step over the automatic one.
    longer: f64,
    levels: Vec<Level>,
}

/// `a/K² + b h²`, over the length.
struct ErrorModel {
    elements: usize,
    step: f64,
    /// Errors that elements and step make on that grid.
    parts: [f64; 2],
}

impl ErrorModel {
    /// Elements, not less than half of those that were tried, and longest step, s, for an accuracy.
    fn grid(&self, accuracy: f64) -> (usize, f64) {
        let [of_elements, of_step] = self.parts.map(|part| part / accuracy);
        let rest = MODELLED - SLIGHT;
        let (finer, shorter) = if of_step <= SLIGHT {
            ((of_elements / rest).sqrt(), (of_step / SLIGHT).sqrt())
        } else if of_elements <= SLIGHT {
            (1.0, (of_step / rest).sqrt())
        } else {
            let both = ((of_elements + of_step) / MODELLED).sqrt();
            (both, both)
        };
        let elements = (finer * self.elements as f64).min(MOST_ELEMENTS).ceil() as usize;
        (
            elements.max(self.elements.div_ceil(2)),
            self.step / shorter.max(f64::MIN_POSITIVE),
        )
    }

    /// Errors that elements and step make on another grid.
    fn parts(&self, elements: usize, step: f64) -> [f64; 2] {
        let coarser = self.elements as f64 / elements as f64;
        let longer = step / self.step;
        [
            self.parts[0] * coarser * coarser,
            self.parts[1] * longer * longer,
        ]
    }
}

impl Search<'_> {
    /// A run with no longer steps than `step`, or than the longest that is tried; with shorter ones where the motion breaks down, the shortest of
    /// them `shortest` times as long as the automatic step.
    fn run(&mut self, elements: usize, step: f64, shortest: f64) -> Result<Run, ChoiceError> {
        loop {
            match self.try_run(elements, step) {
                Err(error) if error.breaks_down() && self.longer > shortest => self.longer *= 0.5,
                done => return done,
            }
        }
    }

    /// A run with as many elements as the arm's shape at rest needs, from `elements` to `most`.
    fn run_shown(&mut self, elements: usize, most: usize, step: f64) -> Result<Run, ChoiceError> {
        let mut elements = elements;
        loop {
            match self.run(elements, step, SHORTEST) {
                Err(ChoiceError::Run(RunError::Discretize(_))) if elements < most => elements += 1,
                done => return done,
            }
        }
    }

    fn try_run(&self, elements: usize, step: f64) -> Result<Run, ChoiceError> {
        let setup = self.setup(elements, step)?;
        let seconds = setup.predicted();
        if seconds > LONGEST {
            return Err(ChoiceError::TooLong {
                accuracy: self.accuracy,
                elements,
                step: setup.grid.step,
                hours: seconds / 3600.0,
            });
        }
        (self.tell)(elements, seconds);
        Ok(setup.run(self.stop).map_err(RunError::from)?)
    }

    fn setup(&self, elements: usize, step: f64) -> Result<Setup, RunError> {
        let open = Discretization {
            elements,
            step: None,
            ..self.base
        };
        Ok((self.motion).setup_longer(&open, self.longer, step, self.stop)?)
    }

    /// Three coarse runs, with more elements where they break down, and with steps shorter than automatic ones where that does not help.
    fn coarse(&mut self) -> Result<ErrorModel, ChoiceError> {
        let first = first_elements(self.accuracy)
            .div_ceil(2)
            .max(FEWEST_ELEMENTS);
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

    fn coarse_with(&mut self, elements: usize, shortest: f64) -> Result<ErrorModel, ChoiceError> {
        let length = self.motion.arm.length;
        let coarse = self.run(elements, f64::INFINITY, shortest)?;
        let half = 0.5 * coarse.step();
        let in_time = self.run(elements, half, shortest)?;
        // Explicit steps have to be shorter on shorter elements.
        let is_explicit = coarse.discretization.scheme == Some(TimeScheme::Explicit);
        let (like, step) = if is_explicit {
            (&in_time, half)
        } else {
            (&coarse, coarse.step())
        };
        let in_space = self.run(2 * elements, step, shortest)?;
        // What a grid twice as fine still lacks is a quarter of it.
        let estimate = |a: &Run, b: &Run| a.course.errors(&b.course, length).shape * 4.0 / 3.0;
        let parts = [estimate(like, &in_space), estimate(&coarse, &in_time)];
        for (run, error) in [
            (&coarse, Some(parts[0] + parts[1])),
            (&in_time, None),
            (&in_space, None),
        ] {
            self.levels.push(Level {
                elements: run.discretization.elements,
                step_s: run.step(),
                error,
            });
        }
        Ok(ErrorModel {
            elements,
            step: coarse.step(),
            parts,
        })
    }

    /// Estimated error of a run, over the length.
    fn confirm(&mut self, fine: &Run, model: &ErrorModel) -> Result<f64, ChoiceError> {
        let own = fine.discretization.elements;
        let elements = ((own as f64 / COARSER).round() as usize).clamp(1, own.max(2) - 1);
        let coarse = match self.run_shown(elements, own - 1, COARSER * fine.step()) {
            // No coarser grid shows the arm: nothing is known of the error of this one.
            Err(ChoiceError::Run(RunError::Discretize(_))) => return Ok(f64::INFINITY),
            found => found?,
        };
        let elements = coarse.discretization.elements;
        self.levels.push(Level {
            elements,
            step_s: coarse.step(),
            error: None,
        });
        let difference = (coarse.course.errors(&fine.course, self.motion.arm.length)).shape;
        let finer = own as f64 / elements as f64;
        let shorter = coarse.step() / fine.step();
        let [_, of_step] = model.parts(own, fine.step());
        // Steps that could not be longer say nothing about the error that they make, and small errors nothing about the order.
        if of_step <= SLIGHT * self.accuracy || shorter < 0.5 * (1.0 + COARSER) {
            return Ok(difference / (finer * finer - 1.0) + of_step);
        }
        let seen = finer.min(shorter);
        Ok(difference / (seen * seen - 1.0))
    }
}
