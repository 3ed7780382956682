//! Equilibria of a held arm while a factor multiplies its loads: the path from the unloaded shape, the stability along it, and the factor
//! at which it is lost.
//!
//! The path is followed by Newton's method from factor to factor. It passes branching points, at which a straight column may stay straight,
//! and ends where it turns back (a limit point, from which the arm snaps through). Along a path the smallest eigenvalue of the stiffness
//! changes its sign only at a singular point; a stride across such a change is shortened to the smallest one, and no stride moves a node
//! far, so that Newton's method does not jump to another path.

use std::ops::ControlFlow;

use nalgebra::{Matrix3, Vector3};

use super::equilibrium::{EquilibriumError, NodeSpring, Passage, ends_are_held, followed, settled};
use super::tangent::{Motions, POSITIVE, Stability, Tangent, own_squared_frequency};
use cosserat::configuration::Configuration;
use cosserat::load::Load;
use cosserat::rod::Rod;
use stop::StopSignal;

/// Loads that the factor multiplies; the others stay as they are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Varied {
    /// Gravity, all loads and the inputs of actuators: efforts, displacements of winches.
    #[default]
    All,
    /// The loads and the inputs of actuators, under constant gravity.
    Loads,
    /// Gravity, under constant loads and inputs.
    Gravity,
}

impl Varied {
    /// Every choice, the default first.
    pub const EACH: [Self; 3] = [Self::All, Self::Loads, Self::Gravity];

    /// Returns the name in commands and result files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::Loads => "loads",
            Self::Gravity => "gravity",
        }
    }

    /// Returns the choice of this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::EACH.into_iter().find(|choice| choice.name() == name)
    }

    /// Describes the loads in words.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::All => "gravity, all loads and inputs of actuators",
            Self::Loads => "the loads and inputs of actuators, under constant gravity",
            Self::Gravity => "gravity, under constant loads",
        }
    }
}

/// An equilibrium at a load factor.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedShape {
    /// Load factor.
    pub factor: f64,
    /// The shape.
    pub shape: Configuration,
    /// Stability under constant loads; `None` if the stiffness is not finite. Under loads without a potential the slowest motions decide
    /// along a path, and all of them where it was [examined](LoadPath::examined).
    pub stability: Option<Stability>,
    /// Tells whether the path ended before this factor, so that the arm jumped to another equilibrium.
    pub jumped: bool,
    /// Number of unstable equilibria that were left on the way, each to a side of less energy; 0 where the path was followed.
    pub saddles: usize,
}

/// Kind of a loss of stability along a load path.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Loss {
    /// The stiffness becomes singular and the path continues: the arm buckles to a side.
    Buckling,
    /// The stiffness becomes singular where the path turns back: the arm snaps through.
    Snapping,
    /// Motions oscillate and grow, as they may under loads without a potential, such as forces that turn with the arm.
    Flutter,
}

/// The reason why no loss of stability was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kept {
    /// The path was followed to the largest factor.
    ToTheEnd,
    /// An element is compressed or stretched beyond what rod models describe.
    OutOfRange,
    /// Newton's method could not follow the path.
    NotFollowed,
    /// The factor multiplies no load.
    Unloaded,
}

/// The factor at which an arm that is loaded from zero loses its stability.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Critical {
    /// Stability is lost at this factor.
    Lost {
        /// Load factor.
        factor: f64,
        /// Kind of loss.
        how: Loss,
    },
    /// Stability is not lost up to this factor.
    Kept {
        /// Load factor.
        factor: f64,
        /// The reason why the path was not followed farther.
        why: Kept,
    },
}

/// Cap on the load factor.
pub const LARGEST_FACTOR: f64 = 1e4;
/// First stride of the load factor, and the smallest one as a fraction of the factor.
const FIRST_STRIDE: f64 = 0.05;
const LEAST_STRIDE: f64 = 1e-6;
/// Relative error of a critical factor, and of one at which fast motions begin to grow.
const PRECISION: f64 = 1e-7;
const FAST_PRECISION: f64 = 1e-3;
/// Largest displacement of a node in one stride, divided by the length of the arm: at a limit point, the smallest stride moves nodes by
/// about its square root, 1e-3, and other equilibria are a fraction of the length away.
const NEAR: f64 = 0.1;
/// Relative distance beyond a critical factor to which a path is followed to show that it continues.
const PAST: f64 = 1e-3;
/// Dilatations of elements between which a linear elastic law is a valid model.
const CREDIBLE_DILATATION: [f64; 2] = [0.7, 1.3];

/// The equilibria of a rod while a factor multiplies its loads.
pub struct LoadPath<'a> {
    rod: &'a Rod,
    varied: Varied,
    /// Time at which profiles of loads and the motion of a driven base are evaluated, s.
    time: f64,
    /// Dead force that the factor does not multiply: an imperfection that decides to which side a symmetric arm buckles.
    aside: Option<Load>,
    /// Smallest `ω²` of the unloaded arm, 1/s².
    unit: f64,
    stop: &'a StopSignal,
}

impl<'a> LoadPath<'a> {
    /// Creates the path of a rod whose loads have their values at `time` (s), with a dead force `aside` at every
    /// factor.
    ///
    /// # Errors
    /// Returns [`EquilibriumError::FreeBase`].
    pub fn new(
        rod: &'a Rod,
        varied: Varied,
        time: f64,
        aside: Option<Load>,
        stop: &'a StopSignal,
    ) -> Result<Self, EquilibriumError> {
        if !rod.is_held() {
            return Err(EquilibriumError::FreeBase);
        }
        Ok(Self {
            unit: own_squared_frequency(rod),
            rod,
            varied,
            time,
            aside,
            stop,
        })
    }

    /// Returns the rod under the loads at a factor.
    #[must_use]
    pub fn rod_at(&self, factor: f64) -> Rod {
        let mut out = self.rod.clone();
        if self.varied != Varied::Loads {
            out.gravity *= factor;
        }
        if self.varied != Varied::Gravity {
            out.multiply_loads(factor);
        }
        out.loads.extend(self.aside.clone());
        out
    }

    /// Tells whether the factor multiplies a nonzero load.
    #[must_use]
    pub fn is_loaded(&self) -> bool {
        let weighs = self.varied != Varied::Loads && self.rod.gravity != Vector3::zeros();
        let loads = self.varied != Varied::Gravity;
        let mut acting = (self.rod.loads.iter())
            .filter(|load| load.force != Vector3::zeros() || load.moment != Vector3::zeros());
        let is_driven = self.rod.actuators.are_driven(self.time);
        weighs || (loads && (is_driven || acting.next().is_some()))
    }

    /// Tells whether the path begins at factor 1: the tip is held elsewhere than the stress-free shape ends. Such an arm has several shapes
    /// without loads, and an arch may turn about the line through its ends: none of them is the first, and the loads choose one.
    #[must_use]
    pub fn begins_loaded(&self) -> bool {
        let rest = self.rod.carried(self.rod.rest.clone(), self.time);
        !ends_are_held(self.rod, &rest, self.time)
    }

    /// Returns the tangent stiffness of an equilibrium at a factor.
    pub fn tangent(&self, at: &LoadedShape) -> Tangent {
        Tangent::stiffness(&self.rod_at(at.factor), &at.shape, self.time)
    }

    /// Returns the displacement of the tip per dead force on it, m/N, spatial frame; `None` if the stiffness is singular.
    #[must_use]
    pub fn tip_compliance(&self, at: &LoadedShape) -> Option<Matrix3<f64>> {
        self.tangent(at).tip_compliance()
    }

    /// Returns the node that is not held and gives way most to a dead force on it, and its displacement per force, m/N, spatial frame;
    /// without the latter if the stiffness is singular.
    pub fn softest_node(&self, at: &LoadedShape) -> (usize, Option<Matrix3<f64>>) {
        let first = self.rod.first_free_node();
        let free = self.rod.n_nodes() - first;
        let all = self.tangent(at).compliances(0..free).unwrap_or_default();
        (all.into_iter().enumerate())
            .max_by(|(_, a), (_, b)| a.norm().total_cmp(&b.norm()))
            .map_or((self.rod.tip(), None), |(free, own)| {
                (free + first, Some(own))
            })
    }

    /// Returns the equilibrium at factor 0, which is reached from the stress-free shape while the loads that the factor does not multiply
    /// grow from zero. On a path that [begins loaded](Self::begins_loaded) it is the one to which the [equilibrium](Self::loaded) at factor 1
    /// leads while its loads fall.
    ///
    /// # Errors
    /// Returns [`EquilibriumError`] if there is none.
    pub fn start(&self) -> Result<LoadedShape, EquilibriumError> {
        let rest = self.rod.carried(self.rod.rest.clone(), self.time);
        if self.begins_loaded() {
            return self.at(&self.loaded()?, 0.0);
        }
        let constant = self.rod_at(0.0);
        let growing = LoadPath {
            rod: &constant,
            varied: Varied::All,
            aside: None,
            ..*self
        };
        let unloaded = growing.settled(0.0, &rest, false)?;
        if !growing.is_loaded() {
            return Ok(unloaded);
        }
        let found = growing.at(&unloaded, 1.0)?;
        Ok(LoadedShape {
            saddles: found.saddles,
            ..self.looked_at(0.0, found.shape, found.jumped, Motions::Slowest)
        })
    }

    /// Returns the equilibrium at factor 1 in which the arm settles from the stress-free shape, where a path that [begins
    /// loaded](Self::begins_loaded) begins.
    ///
    /// # Errors
    /// Returns [`EquilibriumError`] if there is none.
    pub fn loaded(&self) -> Result<LoadedShape, EquilibriumError> {
        let rest = self.rod.carried(self.rod.rest.clone(), self.time);
        self.settled(1.0, &rest, false)
    }

    /// Returns the equilibrium at a factor in which the arm settles from a shape.
    fn settled(
        &self,
        factor: f64,
        from: &Configuration,
        jumped: bool,
    ) -> Result<LoadedShape, EquilibriumError> {
        let rod = self.rod_at(factor);
        let none = NodeSpring::default();
        let found = settled(&rod, from, self.time, &none, self.stop)?;
        Ok(LoadedShape {
            saddles: found.saddles,
            ..self.looked_at(factor, found.shape, jumped, Motions::Slowest)
        })
    }

    /// Returns the equilibrium near that of another path at the same factor.
    ///
    /// # Errors
    /// Returns [`EquilibriumError`] if there is none.
    pub fn released(&self, from: &LoadedShape) -> Result<LoadedShape, EquilibriumError> {
        self.settled(from.factor, &from.shape, from.jumped)
    }

    fn looked_at(
        &self,
        factor: f64,
        shape: Configuration,
        jumped: bool,
        motions: Motions,
    ) -> LoadedShape {
        LoadedShape {
            factor,
            stability: self.stability(factor, &shape, motions),
            shape,
            jumped,
            saddles: 0,
        }
    }

    fn stability(&self, factor: f64, shape: &Configuration, motions: Motions) -> Option<Stability> {
        let rod = self.rod_at(factor);
        Tangent::stiffness(&rod, shape, self.time).stability(&rod, shape, self.unit, motions)
    }

    /// Returns an equilibrium with its stability under the growth of all motions of the grid, which is costly where loads have no
    /// potential.
    #[must_use]
    pub fn examined(&self, at: LoadedShape) -> LoadedShape {
        match at.stability {
            Some(found) if !found.has_potential => LoadedShape {
                stability: self.stability(at.factor, &at.shape, Motions::All),
                ..at
            },
            _ => at,
        }
    }

    /// Follows the path from an equilibrium to a factor, above or below its own, and calls `each` with every equilibrium on the way, which may end it; returns the
    /// last equilibrium that was reached. The stability of every equilibrium is that of the given motions.
    fn follow(
        &self,
        from: &LoadedShape,
        to: f64,
        motions: Motions,
        each: &mut dyn FnMut(&LoadedShape) -> ControlFlow<()>,
    ) -> Result<LoadedShape, EquilibriumError> {
        // What falls is followed by what it has fallen by.
        let falls = to < from.factor;
        let factor_at = |along: f64| match falls {
            true if along == from.factor - to => to,
            true => from.factor - along,
            false => along,
        };
        let under = |along: f64| self.rod_at(factor_at(along));
        let (begin, end) = match falls {
            true => (0.0, from.factor - to),
            false => (from.factor, to),
        };
        let strides = [FIRST_STRIDE, LEAST_STRIDE];
        let mut last = from.clone();
        followed(
            &under,
            (begin, from.shape.clone()),
            end,
            strides,
            self.time,
            &NodeSpring::default(),
            self.stop,
            &mut |along, shape, is_least| {
                let next = self.looked_at(factor_at(along), shape.clone(), from.jumped, motions);
                let turns = self.sign(&last) * self.sign(&next) < 0;
                let (_, way) = last.shape.farthest_node(&next.shape.positions);
                if (turns && !is_least) || way > NEAR * self.rod.scales.length {
                    return Passage::Refused;
                }
                last = next;
                match each(&last) {
                    ControlFlow::Continue(()) => Passage::On,
                    ControlFlow::Break(()) => Passage::End,
                }
            },
        )?;
        Ok(last)
    }

    /// Returns the sign of the smallest `ω²`, 0 within rounding; also 0 under loads without a potential, for which it is not the sign of
    /// the determinant.
    fn sign(&self, at: &LoadedShape) -> i32 {
        if !at.stability.is_some_and(|found| found.has_potential) {
            return 0;
        }
        match squared(at) / self.unit {
            over if over > POSITIVE => 1,
            over if over < -POSITIVE => -1,
            _ => 0,
        }
    }

    /// Returns the equilibrium at a factor to which the path leads from another; if the path ends before, the one in which the arm settles
    /// from there.
    ///
    /// # Errors
    /// Returns [`EquilibriumError`] if there is none.
    pub fn at(&self, from: &LoadedShape, factor: f64) -> Result<LoadedShape, EquilibriumError> {
        let each = &mut |_: &LoadedShape| ControlFlow::Continue(());
        let reached = self.follow(from, factor, Motions::None, each)?;
        if reached.factor == factor {
            Ok(LoadedShape {
                saddles: from.saddles,
                ..self.looked_at(factor, reached.shape, reached.jumped, Motions::Slowest)
            })
        } else {
            self.settled(factor, &reached.shape, true)
        }
    }

    /// Returns the factor at which an arm that is loaded from `start` on loses its stability; on a path that [begins
    /// loaded](Self::begins_loaded), from factor 1 on.
    ///
    /// # Errors
    /// Returns [`EquilibriumError::Stopped`].
    pub fn critical(&self, start: &LoadedShape) -> Result<Critical, EquilibriumError> {
        let kept = |factor, why| Ok(Critical::Kept { factor, why });
        let is_stable = |at: &LoadedShape| at.stability.is_some_and(|found| found.is_stable);
        let begins_loaded = self.begins_loaded();
        if begins_loaded && !self.is_loaded() {
            return kept(0.0, Kept::Unloaded);
        }
        let loaded = (begins_loaded && start.factor < 1.0)
            .then(|| self.loaded())
            .transpose()?;
        let start = loaded.as_ref().unwrap_or(start);
        if !is_stable(start) {
            let how = how(start);
            return Ok(Critical::Lost {
                factor: start.factor,
                how,
            });
        }
        if !self.is_loaded() {
            return kept(0.0, Kept::Unloaded);
        }
        let found = self.critical_of_slowest(start)?;
        match &found.last.stability {
            Some(stability) if !stability.has_potential => {
                let last = self.examined(found.last);
                let start = self.examined(start.clone());
                match (is_stable(&last), is_stable(&start)) {
                    (true, _) => Ok(found.critical),
                    (false, true) => self.bisected(start, last, Motions::All),
                    (false, false) => {
                        let how = how(&start);
                        let factor = start.factor;
                        Ok(Critical::Lost { factor, how })
                    }
                }
            }
            _ => Ok(found.critical),
        }
    }

    /// Returns what [`Self::critical`] does if fast motions do not grow before slow ones, from a stable start under loads.
    fn critical_of_slowest(&self, start: &LoadedShape) -> Result<Followed, EquilibriumError> {
        let is_stable = |at: &LoadedShape| at.stability.is_some_and(|found| found.is_stable);
        let mut last = start.clone();
        let mut squares = vec![(start.factor, squared(start))];
        let mut beyond = None;
        let mut is_credible = true;
        let reached = self.follow(start, LARGEST_FACTOR, Motions::Slowest, &mut |at| {
            let [least, most] = CREDIBLE_DILATATION;
            let dilatation = self.rod.dilatation(&at.shape.positions);
            if !dilatation.iter().all(|e| (least..=most).contains(e)) {
                is_credible = false;
                return ControlFlow::Break(());
            }
            if !is_stable(at) {
                beyond = Some(at.clone());
                return ControlFlow::Break(());
            }
            squares.push((at.factor, squared(at)));
            last = at.clone();
            ControlFlow::Continue(())
        })?;
        let kept = |factor, why| Critical::Kept { factor, why };
        let critical = if let Some(beyond) = beyond {
            self.bisected(last.clone(), beyond, Motions::Slowest)?
        } else if !is_credible {
            kept(last.factor, Kept::OutOfRange)
        } else if reached.factor >= LARGEST_FACTOR {
            kept(reached.factor, Kept::ToTheEnd)
        } else {
            match fold(&squares) {
                Some(factor) => Critical::Lost {
                    factor,
                    how: Loss::Snapping,
                },
                None => kept(reached.factor, Kept::NotFollowed),
            }
        };
        Ok(Followed { critical, last })
    }

    /// Returns the factor between a stable and an unstable equilibrium of the path.
    fn bisected(
        &self,
        mut stable: LoadedShape,
        mut unstable: LoadedShape,
        motions: Motions,
    ) -> Result<Critical, EquilibriumError> {
        let precision = match motions {
            Motions::All => FAST_PRECISION,
            Motions::Slowest | Motions::None => PRECISION,
        };
        while unstable.factor - stable.factor > precision * unstable.factor {
            self.stop.check().map_err(EquilibriumError::Stopped)?;
            let middle = 0.5 * (stable.factor + unstable.factor);
            let mut at = self.at(&stable, middle)?;
            if motions == Motions::All {
                at = self.examined(at);
            }
            if at.stability.is_some_and(|found| found.is_stable) {
                stable = at;
            } else {
                unstable = at;
            }
        }
        let factor = 0.5 * (stable.factor + unstable.factor);
        let mut how = how(&unstable);
        if how == Loss::Buckling {
            let past = (1.0 + PAST) * unstable.factor;
            let each = &mut |_: &LoadedShape| ControlFlow::Continue(());
            let reached = self.follow(&unstable, past, Motions::None, each)?;
            if reached.factor < past {
                how = Loss::Snapping;
            }
        }
        Ok(Critical::Lost { factor, how })
    }
}

/// The way of a path to its critical factor.
struct Followed {
    critical: Critical,
    /// Last equilibrium that was found stable on strides from the start.
    last: LoadedShape,
}

/// Returns the kind of instability of an equilibrium.
fn how(at: &LoadedShape) -> Loss {
    match at.stability.and_then(|found| found.growth_frequency) {
        Some(omega) if omega > 0.0 => Loss::Flutter,
        _ => Loss::Buckling,
    }
}

/// Returns the smallest `ω²` of an equilibrium, 1/s².
fn squared(at: &LoadedShape) -> f64 {
    at.stability
        .map_or(f64::NAN, |found| found.least_squared_frequency)
}

/// Returns the factor at which a path turns back, from the factors and `ω²` of its equilibria. There `ω²` falls as the square root of the
/// remaining factor, so that its square is linear in the factor; `None` if, extrapolated from the last equilibrium and one [`PAST`] before
/// it, the square does not reach zero within the distance of the two.
fn fold(path: &[(f64, f64)]) -> Option<f64> {
    let &(last, second) = path.last()?;
    let far = PAST * last.max(1.0);
    let &(before, first) = path.iter().rev().find(|(factor, _)| last - factor >= far)?;
    let (first, second) = (first * first, second * second);
    let left = (last - before) * second / (first - second);
    (left > 0.0 && left <= last - before).then_some(last + left)
}
