//! The plants of the doubt that a scene states, and the solve whose limits are narrowed for them.

use std::f64::consts::TAU;
use std::path::Path;

use fastrand::Rng;
use nalgebra::{DMatrix, DVector};

use super::choice::Chosen;
use crate::mechanics::{Rod, State};
use crate::output::{OutputError, read_margins};
use crate::scene::{Doubt, OptimalControl, Scene, SceneError, SceneSource, number};
use crate::stop::StopSignal;
use crate::task::Discretization;
use crate::verify::doubt::{Margins, Plants, replay_on_plants};
use crate::verify::{CheckError, Claim, ForwardCheck};

/// The use of drawn plants, each of which has plants of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// Margins are computed from them.
    Margins = 1,
    /// The result is replayed on them.
    Check = 2,
}

/// The numbers of the doubt of a scene, from which plants are drawn.
pub(crate) struct Draws {
    pub doubt: Doubt,
    /// The scene with every default written out.
    pub text: String,
    /// The least and the largest value of every number.
    ends: Vec<[f64; 2]>,
    /// Root of the correlations of the numbers with a standard deviation.
    root: DMatrix<f64>,
}

impl Draws {
    /// Returns the numbers in doubt of a scene in which every default is written out, if it states any.
    pub fn of(resolved: &Scene) -> Option<Self> {
        let doubt = (resolved.doubt.clone()).filter(|doubt| !doubt.number.is_empty())?;
        let text = resolved.to_toml();
        let table = toml::from_str(&text).unwrap_or_default();
        let own = |key: &str| number(&table, key).unwrap_or(f64::NAN);
        Some(Self {
            ends: (doubt.number.iter())
                .map(|number| number.ends(own(&number.key)))
                .collect(),
            root: doubt.root()?,
            text,
            doubt,
        })
    }

    /// Tries both ends of every range; `attempt` returns what is made of a scene.
    ///
    /// # Errors
    /// [`SceneError`] at a number at whose end `attempt` fails, and at one both of whose ends are the same to it.
    pub fn try_ends<T: PartialEq>(
        &self,
        source: &SceneSource,
        attempt: impl Fn(&[String]) -> Result<T, SceneError>,
    ) -> Result<(), SceneError> {
        for (index, (number, ends)) in self.doubt.number.iter().zip(&self.ends).enumerate() {
            let refuse = |message: String, help: Option<String>| {
                source.error_at(&format!("doubt.number.{index}"), message, help)
            };
            let of = |value: f64| {
                attempt(&[format!("{}={value:e}", number.key)]).map_err(|error| {
                    refuse(format!("with {} = {value}: {error}", number.key), None)
                })
            };
            if of(ends[0])? == of(ends[1])? && ends[0] < ends[1] {
                let help = "a bound, a gain, or a number whose place another key takes is none of the arm's";
                let message = format!(
                    "{} from {} to {} changes nothing",
                    number.key, ends[0], ends[1]
                );
                return Err(refuse(message, Some(help.into())));
            }
        }
        Ok(())
    }

    /// Returns the numbers of a drawn plant as overrides of the scene.
    pub fn overrides(&self, purpose: Purpose, plant: usize) -> Vec<String> {
        let place = (purpose as u64) << 32 | plant as u64;
        let mut dice = Rng::with_seed(self.doubt.seed ^ place.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let independent: Vec<f64> = (0..self.root.nrows()).map(|_| normal(&mut dice)).collect();
        let deviations = &self.root * DVector::from_vec(independent);
        let mut deviations = deviations.iter();
        (self.doubt.number.iter().zip(&self.ends))
            .map(|(number, [least, most])| {
                let value = match number.sigma {
                    None => least + (most - least) * dice.f64(),
                    Some(sigma) => 0.5 * (least + most) + sigma * deviations.next().unwrap_or(&0.0),
                };
                format!("{}={value:e}", number.key)
            })
            .collect()
    }
}

/// Returns a number of the normal distribution with mean 0 and variance 1 (Box and Muller 1958).
fn normal(dice: &mut Rng) -> f64 {
    let size = (-2.0 * (1.0 - dice.f64()).ln()).sqrt();
    size * (TAU * dice.f64()).cos()
}

/// The plants of the doubt of an optimal-control problem.
pub(crate) struct Doubted {
    draws: Draws,
    discretization: Discretization,
    stop: StopSignal,
    n_threads: usize,
}

impl Doubted {
    /// Returns the plants of the doubt of a problem, if its scene states one; both ends of every range are tried.
    ///
    /// # Errors
    /// [`SceneError`] at a number that is none of the scene, whose ends give no arm, or that changes nothing.
    pub fn of(
        setup: &OptimalControl,
        source: &SceneSource,
        n_threads: usize,
    ) -> Result<Option<Self>, SceneError> {
        // The doubt of a closed loop is about its plant.
        let draws = Draws::of(&setup.resolved).filter(|_| setup.resolved.mpc.is_none());
        let Some(draws) = draws else {
            return Ok(None);
        };
        let out = Self {
            draws,
            discretization: setup.discretization,
            stop: setup.problem.stop.clone(),
            n_threads,
        };
        (out.draws).try_ends(source, |overrides| out.arm(overrides))?;
        out.on(setup, source).map(Some)
    }

    /// Returns the same plants on the grid of a problem of the scene.
    ///
    /// # Errors
    /// [`SceneError`] where limits that are to be narrowed have too many rows.
    pub fn on(mut self, setup: &OptimalControl, source: &SceneSource) -> Result<Self, SceneError> {
        self.discretization = setup.discretization;
        self.draws.text = setup.resolved.to_toml();
        let (problem, doubt) = (&setup.problem, &self.draws.doubt);
        let n_rows: usize = (problem.path.iter())
            .map(|own| own.time_nodes.len() * own.limit.n_items(&problem.rod))
            .sum();
        if doubt.share.is_some() && n_rows * doubt.plants > MOST_ROWS {
            let message = format!(
                "{} plants with {n_rows} rows of limits take {:.0} GB",
                doubt.plants,
                8e-9 * (n_rows * doubt.plants) as f64
            );
            let help = "fewer plants, or a lower rate_hz of what is limited".to_string();
            return Err(source.error_at("doubt.plants", message, Some(help)));
        }
        Ok(self)
    }

    /// Returns the arm with overrides, and the state in which it starts, if it has that.
    fn arm(&self, overrides: &[String]) -> Result<(Rod, Option<State>), SceneError> {
        let (scene, source) = Scene::from_toml("doubt", &self.draws.text, overrides)?;
        let rod = scene.rod_of(&source, &self.discretization)?;
        let start = scene.start().state(&rod, &self.stop).ok();
        Ok((rod, start))
    }

    fn draw(&self, purpose: Purpose, plant: usize) -> Option<(Rod, State)> {
        let (rod, start) = self.arm(&self.draws.overrides(purpose, plant)).ok()?;
        Some((rod, start?))
    }

    /// Replays a solution on the plants of the check, and adds what is found to it.
    ///
    /// # Errors
    /// As [`replay_on_plants`].
    pub fn replay(
        &self,
        setup: &OptimalControl,
        solution: &Claim,
        check: &mut ForwardCheck,
    ) -> Result<(), CheckError> {
        let draw = |plant: usize| self.draw(Purpose::Check, plant);
        let found = replay_on_plants(&setup.problem, solution, &self.plants(&draw))?;
        check.replayed(found, self.draws.doubt.share);
        Ok(())
    }

    /// Computes the margins of a solution for a part of the plants that may leave a limit.
    fn margins(
        &self,
        setup: &OptimalControl,
        solution: &Claim,
        share: f64,
    ) -> Result<Margins, CheckError> {
        let draw = |plant: usize| self.draw(Purpose::Margins, plant);
        Margins::of(&setup.problem, solution, &self.plants(&draw), share)
    }

    fn plants<'b>(&self, draw: &'b (dyn Fn(usize) -> Option<(Rod, State)> + Sync)) -> Plants<'b> {
        Plants {
            draw,
            n: self.draws.doubt.plants,
            n_threads: self.n_threads,
        }
    }

    /// Replays the solution of a solve, if it converged. Other failures than a stop become warnings.
    pub fn replay_chosen(&self, setup: &OptimalControl, chosen: &mut Chosen) {
        let Chosen {
            solution, examined, ..
        } = chosen;
        let Some(check) = (examined.check.as_mut()).filter(|_| solution.has_converged()) else {
            return;
        };
        let setup = setup.around(&solution.problem);
        if let Err(error) = self.replay(&setup, &solution.claim(), check) {
            match error.stopped() {
                Some(stop) => examined.unchecked = Some(stop),
                None => (examined.warnings).push(format!("no plants were replayed: {error}")),
            }
        }
    }

    /// Solves a problem again with limits that are narrowed by the margins of the solution before, as long as that lowers the objective,
    /// and returns the best certified solution whose limits no more plants leave than may; if there is none, the last certified one.
    ///
    /// # Errors
    /// Those of `attempt`, and of the replays.
    pub fn narrow<E: From<CheckError>>(
        &self,
        found: Posed,
        attempt: impl Fn(&OptimalControl, Vec<f64>) -> Result<Chosen, E>,
        say: impl Fn(&str),
    ) -> Result<Posed, E> {
        let (Some(share), true) = (self.draws.doubt.share, found.1.is_certified()) else {
            return Ok(found);
        };
        let most = Margins::most_violating(share, self.draws.doubt.plants).unwrap_or(0);
        // The best one before the last.
        let mut best: Option<Posed> = None;
        let mut last = found;
        let mut round = 0;
        loop {
            let setup = last.0.around(&last.1.solution.problem);
            let margins = match self.margins(&setup, &last.1.solution.claim(), share) {
                Err(error) if error.stopped().is_some() => return Ok(better(best, last, false)),
                margins => margins?,
            };
            let keeps = margins.violating <= most;
            say(&format!(
                "doubt: {} of {} plants leave a limit, {most} may",
                margins.violating, self.draws.doubt.plants
            ));
            let gains = best.as_ref().is_none_or(|best| {
                last.1.solution.objective() < (1.0 - WORTH) * best.1.solution.objective()
            });
            if keeps && (round == 0 || !gains) || round == MOST_ROUNDS {
                return Ok(better(best, last, keeps));
            }
            if !margins.factor.is_finite() {
                say("more plants break down than may: no margin helps these");
                return Ok(better(best, last, keeps));
            }
            say(&format!(
                "limits are narrowed by {:.2} times the spread of their rows",
                margins.factor
            ));
            let mut narrowed = setup;
            narrowed.problem = margins.on(&narrowed.problem);
            let next = attempt(&narrowed, last.1.solution.coefficients.clone())?;
            if !next.is_certified() {
                say("no certified solution was found with these limits");
                return Ok(better(best, last, keeps));
            }
            let before = std::mem::replace(&mut last, (narrowed, next));
            if keeps {
                best = Some(better(best, before, keeps));
            }
            round += 1;
        }
    }
}

/// A problem with its solution.
type Posed = (OptimalControl, Chosen);

/// Returns the one of lower objective, where the last one keeps its limits on enough plants as those before do.
fn better(before: Option<Posed>, last: Posed, keeps: bool) -> Posed {
    let objective = |own: &Posed| own.1.solution.objective();
    match before {
        Some(before) if !keeps || objective(&before) <= objective(&last) => before,
        _ => last,
    }
}

/// Largest number of rows of limits on all plants together: a gigabyte of numbers.
const MOST_ROWS: usize = 125_000_000;
/// Largest number of solves with narrowed limits.
const MOST_ROUNDS: usize = 8;
/// Another solve with narrowed limits is worth this part of the objective.
const WORTH: f64 = 0.01;

/// Gives the path constraints of a setup the margins of a result.
///
/// # Errors
/// Those of [`read_margins`].
pub(crate) fn narrow_as_saved(
    setup: &mut OptimalControl,
    directory: &Path,
) -> Result<(), OutputError> {
    let margins = read_margins(&directory.join("multipliers.json"), &setup.problem)?;
    for (constraint, own) in setup.problem.path.iter_mut().zip(margins) {
        constraint.margins = own;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Drawn numbers have the mean of the scene, and the deviations and the correlation that it states; the ones beside them keep their ranges.
    #[test]
    fn draws_have_the_stated_covariance() {
        let text = "[rod]\nlength_m = 1.0\nelements = 4\n[rod.material]\nyoungs_modulus_pa = 1e6\npoisson_ratio = 0.5\n\
                    density_kg_m3 = 1000.0\n[rod.section]\nradius_m = 0.05\n[damping]\nviscous_1_s = 1.0\n[time]\nend_s = 1.0\n\
                    [doubt]\ncorrelation = [[1.0, -0.8], [-0.8, 1.0]]\n[[doubt.number]]\nkey = \"rod.material.youngs_modulus_pa\"\n\
                    sigma = 1e5\n[[doubt.number]]\nkey = \"damping.viscous_1_s\"\nrange = [0.5, 1.5]\n[[doubt.number]]\n\
                    key = \"rod.material.density_kg_m3\"\nsigma = 20.0\n";
        let (scene, _) = Scene::from_toml("draws", text, &[]).unwrap();
        let draws = Draws::of(&scene).unwrap();
        let n = 4000;
        let rows: Vec<[f64; 3]> = (0..n)
            .map(|plant| {
                let own = draws.overrides(Purpose::Check, plant);
                [0, 1, 2].map(|i: usize| {
                    let (_, value) = own[i].split_once('=').unwrap();
                    value.parse().unwrap()
                })
            })
            .collect();
        let scaled = |row: &[f64; 3]| [(row[0] - 1e6) / 1e5, (row[2] - 1000.0) / 20.0];
        let mean = |of: &dyn Fn(&[f64; 3]) -> f64| rows.iter().map(of).sum::<f64>() / n as f64;
        // Four standard deviations of the means of so many draws.
        let off = 4.0 / (n as f64).sqrt();
        for i in 0..2 {
            assert!(mean(&|row| scaled(row)[i]).abs() < off);
            assert!((mean(&|row| scaled(row)[i].powi(2)) - 1.0).abs() < 2f64.sqrt() * off);
        }
        let correlation = mean(&|row| scaled(row)[0] * scaled(row)[1]);
        assert!(
            (correlation + 0.8).abs() < 2f64.sqrt() * off,
            "{correlation}"
        );
        assert!(rows.iter().all(|row| (0.5..1.5).contains(&row[1])));
    }
}
