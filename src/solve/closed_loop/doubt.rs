//! A closed loop on the plants of the doubt that its scene states: as many loops, each of the same controller.

use std::ops::ControlFlow;

use super::errors;
use super::recording::LimitWatch;
use crate::mechanics::threads::on_threads;
use crate::mpc::{Contender, MpcError};
use crate::output::closed_loop::LimitPeak;
use crate::scene::{ClosedLoopSetup, Scene, SceneError, SceneSource};
use crate::solve::doubt::{Draws, Purpose};
use crate::stop::StopSignal;
use crate::verify::doubt::{OnPlant, UnderDoubt};

/// The plants of the doubt of a closed loop.
pub(crate) struct LoopsInDoubt {
    draws: Draws,
    n_threads: usize,
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
        let out = Self { draws, n_threads };
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
        scene.closed_loop(&source, seed, stop)
    }

    /// Runs the loop on all plants.
    ///
    /// # Errors
    /// [`MpcError`] of a controller that cannot begin, and where the loops are stopped.
    pub(super) fn run(&self, stop: &StopSignal) -> Result<UnderDoubt, MpcError> {
        let on_plant = |plant: usize| -> Result<Option<(Vec<LimitPeak>, f64)>, MpcError> {
            stop.check().map_err(MpcError::Stopped)?;
            let overrides = self.draws.overrides(Purpose::Check, plant);
            let Ok(setup) = self.setup(&overrides, plant, stop) else {
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
        let found = on_threads(self.draws.doubt.plants, self.n_threads, on_plant)?;
        let names = found
            .iter()
            .flatten()
            .next()
            .map_or_else(Vec::new, |(limits, _)| {
                limits
                    .iter()
                    .map(|own| (own.name.clone(), own.unit))
                    .collect()
            });
        let outcomes: Vec<Option<OnPlant>> = (found.into_iter())
            .map(|own| {
                own.map(|(limits, distance)| OnPlant {
                    excess: limits.iter().map(|own| own.excess).collect(),
                    leaves: limits.iter().map(|own| own.violated).collect(),
                    distance: Some(distance).filter(|rms| rms.is_finite()),
                })
            })
            .collect();
        Ok(UnderDoubt::of(names, &outcomes))
    }
}
