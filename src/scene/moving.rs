//! The arm of a scene as a program moves it, and arms beside it, with more or less of some numbers.

use super::overrides::{number, value_at};
use super::{Scene, SceneError, SceneSource};
use crate::mechanics::at_rest::RodsBeside;
use crate::mechanics::rollout::Beside;
use crate::mechanics::stability::automatic_step;
use crate::mechanics::threads::on_threads;
use crate::mechanics::{Rod, Scales, State};
use crate::stop::StopSignal;
use crate::task::{Discretization, StartError};

/// Half of the distance of two arms beside one, as a part of the number in which they differ: the error of their central difference is some
/// 1e-9 of it, and rounding is a little less.
const DIFFERENCE: f64 = 3e-5;
/// Part of that distance for a difference to one side, whose error is of first order.
const ONE_SIDED: f64 = 1e-3;

/// Turn, rad, by which the orientation of a node jumps: a number on which it depends smoothly turns it by some thousandths of that.
const JUMP: f64 = 1e-2;

/// Two things of one kind, the first with more of a number and the second with less, and the difference of that number.
type Pair<T> = ([T; 2], f64);

/// The numbers of a scene's arm, by their dotted keys.
#[derive(Clone, Debug)]
pub struct ArmNumbers {
    source: SceneSource,
    /// The scene with every default written out.
    resolved: Scene,
    discretization: Discretization,
    /// Tells whether the arm is that of `[plant]`.
    is_plant: bool,
}

/// The arm of a scene, at the start of a motion that a program commands.
#[derive(Clone, Debug)]
pub struct MovingArm {
    /// The rod: that of the `[plant]` if the scene has a closed loop, or that of `[rod]`.
    pub rod: Rod,
    /// The state at the start.
    pub initial: State,
    /// Longest time step, s.
    pub longest_step: f64,
    numbers: ArmNumbers,
}

impl Scene {
    /// Returns the arm of the scene as a program moves it.
    ///
    /// # Errors
    /// As [`Scene::simulation`], or for a scene with a closed loop as [`Scene::closed_loop`].
    pub fn moving_arm(
        &self,
        source: &SceneSource,
        stop: &StopSignal,
    ) -> Result<MovingArm, SceneError> {
        let numbers = |resolved: Scene, discretization: Discretization| ArmNumbers {
            source: source.clone(),
            resolved,
            discretization,
            is_plant: self.mpc.is_some(),
        };
        if self.mpc.is_some() {
            let setup = self.closed_loop(source, 0, stop)?;
            return Ok(MovingArm {
                longest_step: automatic_step(&setup.plant),
                rod: (*setup.plant).clone(),
                initial: setup.initial,
                numbers: numbers(setup.resolved, setup.experiment.plant_discretization),
            });
        }
        let setup = self.simulation_until(source, stop)?;
        Ok(MovingArm {
            rod: setup.rod,
            initial: setup.initial,
            longest_step: setup.grid.step,
            numbers: numbers(setup.resolved, setup.discretization),
        })
    }

    /// Returns the numbers of the arm of `[rod]`.
    ///
    /// # Errors
    /// As [`Scene::arm`].
    pub fn arm_numbers(&self, source: &SceneSource) -> Result<ArmNumbers, SceneError> {
        let discretization = self.discretization();
        Ok(ArmNumbers {
            source: source.clone(),
            resolved: self.resolved(&self.arm(source)?, &discretization),
            discretization,
            is_plant: false,
        })
    }
}

impl ArmNumbers {
    /// Returns the values of numbers.
    ///
    /// # Errors
    /// Returns [`SceneError`] at a key that is no number of the scene.
    pub fn values(&self, keys: &[String]) -> Result<Vec<f64>, SceneError> {
        let table = self.entries();
        let one = |key: &String| {
            number(&table, key).ok_or_else(|| {
                let help = "docs/scene-reference.md names the keys, as rod.material.youngs_modulus_pa or tendon.0.offset_m.1";
                let message = format!("{key} has no number in this scene");
                self.source.error_at(key, message, Some(help.into()))
            })
        };
        keys.iter().map(one).collect()
    }

    /// Returns the entries of the scene with every default.
    fn entries(&self) -> toml::Table {
        toml::from_str(&self.resolved.to_toml()).unwrap_or_default()
    }

    /// Returns overrides that write out the lists of which some keys name a number and which the scene leaves at their defaults.
    #[must_use]
    pub fn written_out(&self, keys: &[String]) -> Vec<String> {
        // The scene was read from them.
        let given = self.source.entries().unwrap_or_default();
        let table = self.entries();
        let mut out: Vec<String> = Vec::new();
        for key in keys {
            let Some((list, index)) = key.rsplit_once('.') else {
                continue;
            };
            let is_missing = index.parse::<usize>().is_ok() && value_at(&given, list).is_none();
            if let (true, Some(value)) = (is_missing, value_at(&table, list)) {
                let setter = format!("{list}={value}");
                if !out.contains(&setter) {
                    out.push(setter);
                }
            }
        }
        out
    }

    /// Returns rods with more and with less of each number than one of the scene.
    ///
    /// # Errors
    /// As [`MovingArm::beside`].
    pub fn rods_beside(
        &self,
        rod: &Rod,
        keys: &[String],
        n_threads: usize,
    ) -> Result<RodsBeside, SceneError> {
        let make = |_: &Scene, rod: Rod| Ok((rod, ()));
        let found = self.beside((rod, &()), keys, n_threads, &make)?;
        let rods = |(pair, width): Pair<(Rod, ())>| (pair.map(|(rod, ())| rod), width);
        Ok(found.into_iter().map(rods).collect())
    }

    /// Returns for each number what `make` adds to a rod with more and with less of it, and by how much more.
    fn beside<T: Clone + PartialEq + Send + Sync>(
        &self,
        (rod, own): (&Rod, &T),
        keys: &[String],
        n_threads: usize,
        make: &(impl Fn(&Scene, Rod) -> Result<(Rod, T), SceneError> + Sync),
    ) -> Result<Vec<Pair<(Rod, T)>>, SceneError> {
        let values = self.values(keys)?;
        let given = [&self.source.overrides[..], &self.written_out(keys)].concat();
        let one = |index: usize| {
            let (key, value) = (&keys[index], values[index]);
            let half = match value {
                0.0 => DIFFERENCE * size_of(key, &rod.scales),
                value => DIFFERENCE * value.abs(),
            };
            let with = |x: f64| {
                let SceneSource { name, text, .. } = &self.source;
                let overrides = [&given[..], &[format!("{key}={x:e}")]].concat();
                let (scene, source) = Scene::from_toml(name, text, &overrides)?;
                let rod = if self.is_plant {
                    scene.plant_rod(&source, &self.discretization)?
                } else {
                    scene.rod_of(&source, &self.discretization)?
                };
                make(&scene, rod)
            };
            let here = || (rod.clone(), own.clone());
            let near = ONE_SIDED * half;
            let (ahead, behind, width) = match (with(value + half), with(value - half)) {
                (Ok(ahead), Ok(behind)) => (ahead, behind, 2.0 * half),
                // A number at the end of its range has one side.
                (Ok(_), Err(_)) => (with(value + near)?, here(), near),
                (Err(_), Ok(_)) => (here(), with(value - near)?, near),
                (Err(error), Err(_)) => return Err(error),
            };
            let refuse =
                |words: &str| Err(self.source.error_at(key, format!("{key} {words}"), None));
            if ahead == behind {
                return refuse("changes nothing of the arm");
            }
            if ahead.0.n_nodes() != rod.n_nodes() || ahead.0.mesh != rod.mesh {
                return refuse("changes where elements end, along which there is no derivative");
            }
            if [&ahead.0, &behind.0].iter().any(|own| jumps(rod, own)) {
                return refuse(
                    "turns the arm at once, as the direction of a base turns its roll where it points along -z: give base.orientation_wxyz",
                );
            }
            Ok(([ahead, behind], width))
        };
        on_threads(keys.len(), n_threads, one)
    }
}

impl MovingArm {
    /// Returns the values of numbers, named by their dotted keys in the scene.
    ///
    /// # Errors
    /// Returns [`SceneError`] at a key that is no number of the scene.
    pub fn values(&self, keys: &[String]) -> Result<Vec<f64>, SceneError> {
        self.numbers.values(keys)
    }

    /// Returns overrides that write out lists, as [`ArmNumbers::written_out`].
    #[must_use]
    pub fn written_out(&self, keys: &[String]) -> Vec<String> {
        self.numbers.written_out(keys)
    }

    /// Returns arms with more and with less of each number, named by its dotted key in the scene.
    ///
    /// # Errors
    /// Returns [`SceneError`] at a key that is no number of the scene, that changes nothing of the arm or the ends of its elements, or of which
    /// neither more nor less gives an arm.
    pub fn beside(
        &self,
        keys: &[String],
        (n_threads, stop): (usize, &StopSignal),
    ) -> Result<Vec<Beside>, SceneError> {
        let make = |scene: &Scene, rod: Rod| {
            let refused = |error: StartError| {
                (self.numbers.source).error_at("initial", error.to_string(), None)
            };
            let initial = scene.start().state(&rod, stop).map_err(refused)?;
            Ok((rod, initial))
        };
        let own = (&self.rod, &self.initial);
        let found = self.numbers.beside(own, keys, n_threads, &make)?;
        let pair = |([ahead, behind], width): Pair<(Rod, State)>| Beside {
            rods: [ahead.0, behind.0],
            initial: [ahead.1, behind.1],
            width,
        };
        Ok(found.into_iter().map(pair).collect())
    }
}

/// Tells whether a node at rest has another orientation than in a rod that differs by a small part of a number.
fn jumps(rod: &Rod, other: &Rod) -> bool {
    (rod.rest.rotations.iter().zip(&other.rest.rotations))
        .any(|(own, other)| (other - own).norm() > JUMP)
}

/// Returns the size of a number that is zero, by the unit at the end of its key.
fn size_of(key: &str, scales: &Scales) -> f64 {
    let name = key
        .rsplit('.')
        .find(|part| part.parse::<usize>().is_err())
        .unwrap_or(key);
    let units = [
        ("_n_m", scales.moment),
        ("_1_n", 1.0 / scales.force),
        ("_n", scales.force),
        ("_pa", scales.force / scales.length.powi(2)),
        ("_1_m", 1.0 / scales.length),
        ("_m", scales.length),
        ("_1_s", 1.0 / scales.time),
        ("_m_s", scales.length / scales.time),
        ("_m_s2", scales.length / scales.time.powi(2)),
        ("_s", scales.time),
    ];
    let found = units.iter().find(|(unit, _)| name.ends_with(unit));
    found.map_or(1.0, |(_, size)| *size)
}
