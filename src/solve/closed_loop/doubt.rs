//! A closed loop on the plants of the doubt that its scene states: as many loops, each of the same controller.
//!
//! With a share of the plants that may leave a limit, margins narrow the limits of the plans: back-offs from simulations of the loop itself
//! (Bradford, Imsland, Zhang and del Rio Chanona 2020). Of `n` drawn plants, `k` may leave a limit. Each limit is narrowed by the largest
//! excess of any sample on all but the `k` worst plants, and the loop runs on the same plants again, as long as more of them leave a limit:
//! margins are recomputed and not differentiated, and grow twice as fast each time that they did not suffice. The last step is bisected
//! until it is as small as a violation that counts as none. What the filter knows, how the plan answers, and elements that the model does
//! not have count as they are.
//!
//! Margins that were chosen for some plants fit these better than others, and a loop may answer a margin by another way past a limit. So they
//! count only after the loop has kept them on plants that took no part in the choice, of which no more than the share may leave a limit.
//! Where more do, the margins grow by what these exceed, and are tried on new plants.

use std::ops::ControlFlow;

use super::errors;
use super::recording::LimitWatch;
use crate::mechanics::threads::on_threads;
use crate::mpc::{Contender, MpcError};
use crate::output::closed_loop::LimitPeak;
use crate::scene::{ClosedLoopSetup, Scene, SceneError, SceneSource};
use crate::solve::doubt::{Draws, Purpose};
use crate::stop::StopSignal;
use crate::verify::doubt::{Margins, OnPlant, UnderDoubt};

/// Largest number of times that the plants run: margins grow once or twice, and are bisected to a hundredth of the limit some five times.
const MOST_ROUNDS: usize = 8;
/// Largest number of sets of new plants on which margins are tried.
const MOST_TRIALS: usize = 4;

/// The plants of the doubt of a closed loop.
pub(crate) struct LoopsInDoubt {
    draws: Draws,
    n_threads: usize,
    /// Margins of the limits; absent before they are found.
    margins: Option<Vec<f64>>,
    /// The loop with these margins on the plants of the check, if it has run.
    found: Option<UnderDoubt>,
}

impl LoopsInDoubt {
    /// Returns the plants of the doubt of a closed loop, if its scene states one; both ends of every range are tried.
    ///
    /// # Errors
    /// [`SceneError`] at a number that is none of the scene, whose ends give no plant, or that changes nothing.
    pub fn of(
        setup: &ClosedLoopSetup,
        source: &SceneSource,
        n_threads: usize,
        stop: &StopSignal,
    ) -> Result<Option<Self>, SceneError> {
        let Some(draws) = Draws::of(&setup.resolved) else {
            return Ok(None);
        };
        let out = Self {
            margins: draws.doubt.margins.clone(),
            draws,
            n_threads,
            found: None,
        };
        let in_words = |overrides: &[String]| {
            let setup = out.setup(overrides, 0, stop)?;
            Ok(format!("{:?} {:?}", setup.experiment, setup.initial))
        };
        (out.draws).try_ends(source, in_words)?;
        Ok(Some(out))
    }

    /// Returns the loop with overrides, whose sensors have the noise of another seed for every plant.
    fn setup(
        &self,
        overrides: &[String],
        plant: usize,
        stop: &StopSignal,
    ) -> Result<ClosedLoopSetup, SceneError> {
        let (mut scene, source) = Scene::from_toml("doubt", &self.draws.text, overrides)?;
        let seed = scene
            .mpc
            .as_ref()
            .and_then(|mpc| mpc.seed)
            .unwrap_or_default();
        let seed = seed.wrapping_add(1 + plant as u32);
        if let Some(mpc) = &mut scene.mpc {
            mpc.seed = Some(seed);
        }
        if let Some(doubt) = &mut scene.doubt {
            doubt.margins.clone_from(&self.margins);
        }
        scene.closed_loop(&source, seed, stop)
    }

    /// Finds the margins for the share of plants that may leave a limit, if the scene has one and no margins, and gives them to the loop.
    ///
    /// # Errors
    /// As [`Self::run`].
    pub fn narrow(
        &mut self,
        setup: &mut ClosedLoopSetup,
        stop: &StopSignal,
        say: impl Fn(&str),
    ) -> Result<(), MpcError> {
        let (Some(share), None) = (self.draws.doubt.share, &self.margins) else {
            return Ok(());
        };
        let n_limits = setup.experiment.task.limits.len();
        let mut margins = self.chosen(share, n_limits, stop, &say)?;
        let n = self.draws.doubt.plants;
        let most = may_leave(share, n);
        let mut growth = 1.0;
        for trial in 1..=MOST_TRIALS {
            self.margins = Some(margins.clone());
            let loops = self.on_plants(Purpose::Check, stop)?;
            let found = under_doubt(&loops);
            let violating = found.violating;
            say(&format!(
                "doubt: {violating} of {n} other plants leave a limit, {most} may"
            ));
            self.found = Some(found);
            let wider = grown(&margins, growth, &loops, most);
            if violating <= most || trial == MOST_TRIALS || wider == margins {
                break;
            }
            margins = wider;
            growth *= 2.0;
            self.draws.doubt.seed = self.draws.doubt.seed.wrapping_add(1);
        }
        setup.experiment.margins.clone_from(&margins);
        if let Some(doubt) = &mut setup.resolved.doubt {
            doubt.margins = Some(margins);
            // The plants on which they were tried last.
            doubt.seed = self.draws.doubt.seed;
        }
        Ok(())
    }

    /// Returns margins with which no more than `share` of drawn plants leave a limit, or those with which the fewest do.
    fn chosen(
        &mut self,
        share: f64,
        n_limits: usize,
        stop: &StopSignal,
        say: &impl Fn(&str),
    ) -> Result<Vec<f64>, MpcError> {
        let n = self.draws.doubt.plants;
        let most = Margins::most_violating(share, n).unwrap_or(0);
        let mut margins = vec![0.0; n_limits];
        let mut failing = margins.clone();
        let mut fewest = (usize::MAX, margins.clone());
        let mut keeping: Option<Vec<f64>> = None;
        let mut growth = 1.0;
        for _ in 0..MOST_ROUNDS {
            self.margins = Some(margins.clone());
            let found = self.on_plants(Purpose::Margins, stop)?;
            let violating = found.iter().filter(|own| leaves(own.as_ref())).count();
            say(&format!(
                "doubt: {violating} of {n} plants leave a limit, {most} may"
            ));
            if violating < fewest.0 {
                fewest = (violating, margins.clone());
            }
            if violating <= most {
                keeping = Some(margins.clone());
            } else {
                failing.clone_from(&margins);
            }
            let peaks = found.iter().flatten().map(|(peaks, _)| peaks).next();
            let next: Vec<f64> = match &keeping {
                None => grown(&failing, growth, &found, most),
                Some(keeping) => {
                    let is_near = |(limit, (keeps, fails)): (usize, (&f64, &f64))| {
                        peaks.is_none_or(|peaks| keeps - fails <= peaks[limit].allowed)
                    };
                    if keeping.iter().zip(&failing).enumerate().all(is_near) {
                        break;
                    }
                    (keeping.iter().zip(&failing))
                        .map(|(keeps, fails)| 0.5 * (keeps + fails))
                        .collect()
                }
            };
            if next == margins {
                say("no limit is exceeded on the plants that count: no margin helps the others");
                break;
            }
            growth *= 2.0;
            margins = next;
        }
        Ok(keeping.unwrap_or(fewest.1))
    }

    /// Tells where more plants leave a limit than the share that the scene promises.
    pub fn broken_promise(&self, found: &UnderDoubt) -> Option<String> {
        let share = self.draws.doubt.share?;
        let most = may_leave(share, found.plants);
        (found.violating > most).then(|| {
            format!(
                "doubt.share = {share} is NOT KEPT: {} of {} plants leave a limit, and {most} may; what the arm does beyond its plans does not fall as                  margins grow: estimate the numbers in doubt, narrow their ranges, or give the limit or the reference more room",
                found.violating, found.plants
            )
        })
    }

    /// Runs the loop on all plants.
    ///
    /// # Errors
    /// [`MpcError`] of a controller that cannot begin, and where the loops are stopped.
    pub(super) fn run(&self, stop: &StopSignal) -> Result<UnderDoubt, MpcError> {
        match &self.found {
            Some(found) => Ok(found.clone()),
            None => Ok(under_doubt(&self.on_plants(Purpose::Check, stop)?)),
        }
    }

    /// Runs the loop on the plants of a purpose; those whose motion breaks down, or that cannot be built, have none.
    fn on_plants(
        &self,
        purpose: Purpose,
        stop: &StopSignal,
    ) -> Result<Vec<Option<OnLoop>>, MpcError> {
        let on_plant = |plant: usize| -> Result<Option<OnLoop>, MpcError> {
            stop.check().map_err(MpcError::Stopped)?;
            let overrides = self.draws.overrides(purpose, plant);
            let noise = plant + self.draws.doubt.plants * usize::from(purpose == Purpose::Margins);
            let Ok(setup) = self.setup(&overrides, noise, stop) else {
                return Ok(None);
            };
            let mut watch = LimitWatch::new(&setup);
            let run = setup
                .experiment
                .run(Contender::Mpc, &mut |sample, closed| {
                    watch.look(sample, closed);
                    match stop.check() {
                        Ok(()) => ControlFlow::Continue(()),
                        Err(_) => ControlFlow::Break(()),
                    }
                })?;
            stop.check().map_err(MpcError::Stopped)?;
            let distance = errors(&run, setup.experiment.counted_from).rms;
            Ok((run.broke_down.is_none()).then_some((watch.peaks, distance)))
        };
        on_threads(self.draws.doubt.plants, self.n_threads, on_plant)
    }
}

/// Returns margins that are larger by a multiple of the excess over each limit on all plants but the `most` worst ones.
fn grown(margins: &[f64], growth: f64, found: &[Option<OnLoop>], most: usize) -> Vec<f64> {
    (margins.iter().enumerate())
        .map(|(limit, margin)| margin + growth * largest_excess(found, limit, most))
        .collect()
}

/// Counts what the loops on drawn plants do.
fn under_doubt(found: &[Option<OnLoop>]) -> UnderDoubt {
    let limits = found.iter().flatten().next().map(|(limits, _)| limits);
    let names = (limits.into_iter().flatten())
        .map(|own| (own.name.clone(), own.unit))
        .collect();
    let outcomes: Vec<Option<OnPlant>> = (found.iter())
        .map(|own| {
            own.as_ref().map(|(limits, distance)| OnPlant {
                excess: limits.iter().map(|own| own.excess).collect(),
                leaves: limits.iter().map(|own| own.violated).collect(),
                distance: Some(*distance).filter(|rms| rms.is_finite()),
            })
        })
        .collect();
    UnderDoubt::of(names, &outcomes)
}

/// Returns how many of `n` plants that took no part in the choice of margins may leave a limit.
fn may_leave(share: f64, n: usize) -> usize {
    (share * n as f64).floor() as usize
}

/// Tells whether a plant leaves a limit, or whether its motion breaks down.
fn leaves(found: Option<&OnLoop>) -> bool {
    found.is_none_or(|(peaks, _)| peaks.iter().any(|peak| peak.violated))
}

/// Returns the largest excess over a limit on all plants but the `most` worst ones, in its unit; 0 for a soft limit, and where it is kept.
/// A plant whose motion breaks down says nothing of how much would have helped it.
fn largest_excess(found: &[Option<OnLoop>], limit: usize, most: usize) -> f64 {
    let hard = (found.iter().flatten())
        .map(|(peaks, _)| &peaks[limit])
        .filter(|peak| peak.allowed.is_finite());
    let mut excess: Vec<f64> = hard.map(|peak| peak.excess).collect();
    excess.sort_by(f64::total_cmp);
    let counted = excess.len().saturating_sub(most);
    excess[..counted].last().map_or(0.0, |own| own.max(0.0))
}

/// The limits of a loop on a plant, and the root mean square of the distances from its reference, m.
type OnLoop = (Vec<LimitPeak>, f64);
