//! Statics of an arm: its equilibrium, its stability, the critical load factor, and a sweep over the load factor.

use std::iter;

use nalgebra::{Matrix3, Vector3};

use crate::mechanics::equilibrium::{EquilibriumError, NodeSpring, nearby_equilibrium_until};
use crate::mechanics::rotation::{exp, log};
use crate::mechanics::{
    Configuration, Critical, Load, LoadFrame, LoadPath, LoadedShape, Rod, RodError, Varied,
};
use crate::stop::StopSignal;
use crate::task::{Arm, Discretization};

/// Options of [`statics`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StaticsOptions {
    /// Loads that the load factor multiplies.
    pub varied: Varied,
    /// Load factor at the end of the sweep.
    pub to: f64,
    /// Number of load factors of the sweep, evenly spaced from 0 to the end; at least two.
    pub points: usize,
    /// Time at which loads with a profile and a driven base are evaluated, s.
    pub time: f64,
    /// Imperfection: a dead force on the node that gives way most, in its softest direction, as a multiple of EI/L². That node is the tip
    /// unless it is held. With it a symmetric arm buckles gradually.
    pub imperfection: f64,
}

impl Default for StaticsOptions {
    fn default() -> Self {
        Self {
            varied: Varied::All,
            to: 1.0,
            points: 21,
            time: 0.0,
            imperfection: 0.0,
        }
    }
}

impl StaticsOptions {
    /// Returns the load factors of the sweep above 0 in ascending order, with 1 among them.
    fn factors(&self) -> Vec<f64> {
        let n = self.points.max(2) - 1;
        let mut out: Vec<f64> = (1..=n).map(|i| self.to * i as f64 / n as f64).collect();
        if !out.contains(&1.0) {
            out.push(1.0);
            out.sort_by(f64::total_cmp);
        }
        out
    }
}

/// Results of [`statics`].
#[derive(Clone, Debug)]
pub struct Statics {
    /// Rod under the loads at factor 1.
    pub rod: Rod,
    /// Dead force that the load factor does not multiply: the imperfection.
    pub aside: Option<Load>,
    /// Equilibrium at load factor 1.
    pub own: LoadedShape,
    /// Displacement of a free tip at that equilibrium per dead force on it, m/N, spatial frame.
    pub tip_compliance: Option<Matrix3<f64>>,
    /// Stable equilibrium to which a slightly pushed arm goes, if `own` is not stable and another equilibrium is found.
    pub goes_to: Option<LoadedShape>,
    /// Load factor from which stability was examined: 0, or 1 where the path of the loads [begins there](LoadPath::begins_loaded).
    pub from_factor: f64,
    /// Load factor at which stability is lost.
    pub critical: Critical,
    /// Equilibria of the sweep by ascending load factor, from 0 on; where the path of the loads begins at factor 1, it is followed from there
    /// to both sides.
    pub sweep: Vec<LoadedShape>,
    /// Reason why the sweep ends early.
    pub cut: Option<EquilibriumError>,
    /// Estimated discretization error of the node of `own` that moves most, m, from an arm with twice as many elements; `None` where that
    /// arm has no equilibrium.
    pub refined_space: Option<f64>,
}

/// Reason why the statics cannot be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StaticsError {
    /// The arm cannot be discretized with these options.
    #[error(transparent)]
    Rod(#[from] RodError),
    /// No equilibrium was found.
    #[error(transparent)]
    Equilibrium(#[from] EquilibriumError),
}

/// Multiple of EI/L² that pushes an arm aside to find the equilibrium that it goes to, and multiple of its length that it must move by to
/// have gone anywhere. A cantilever deflects by a third of this fraction of its length under the push (`F L³/(3 EI)`), so that a tip that
/// ends farther away went to another equilibrium; rounding is smaller by ten orders of magnitude.
const PUSH: f64 = 1e-3;
/// Ratio of the error to the distance from the equilibrium with twice as many elements, whose own error is a quarter: `1/(1 - 1/4)`
/// (Richardson).
const RICHARDSON: f64 = 4.0 / 3.0;

/// Computes the statics of an arm with the elements of a discretization.
///
/// # Errors
/// [`StaticsError`] where no equilibrium is found, or the work was stopped.
pub fn statics(
    arm: &Arm,
    discretization: &Discretization,
    options: &StaticsOptions,
    stop: &StopSignal,
) -> Result<Statics, StaticsError> {
    let rod = arm.rod(discretization)?;
    let aside = match options.imperfection {
        0.0 => None,
        part => Some(push(&rod, part, options, stop)?),
    };
    let path = LoadPath::new(&rod, options.varied, options.time, aside.clone(), stop)?;
    let begins_loaded = path.begins_loaded();
    let [start, own] = begun(&path)?;
    let own = path.examined(own);
    let critical = path.critical(&start)?;
    let is_stable = own.stability.is_some_and(|found| found.is_stable);
    let goes_to = match is_stable {
        true => None,
        false => pushed(&rod, &own, options, stop)?,
    };
    let factors = options.factors();
    let first = if begins_loaded { own.clone() } else { start };
    let (mut sweep, mut cut) = (vec![first], None);
    if begins_loaded {
        // From factor 1 down to 0, and then up from there.
        let below = factors.iter().copied().filter(|factor| *factor < 1.0);
        let mut below: Vec<f64> = iter::once(0.0).chain(below).collect();
        below.reverse();
        extended(&path, &below, &own, &mut sweep, &mut cut)?;
        sweep.reverse();
        let above: Vec<f64> = factors.into_iter().filter(|factor| *factor > 1.0).collect();
        extended(&path, &above, &own, &mut sweep, &mut cut)?;
    } else {
        extended(&path, &factors, &own, &mut sweep, &mut cut)?;
    }
    let finer = arm.rod(&discretization.refined(2))?;
    let refined_space = shape_on(&finer, &own, options, aside.as_ref(), stop)?.map(|fine| {
        let (_, way) = own.shape.farthest_node(fine.positions.iter().step_by(2));
        RICHARDSON * way
    });
    Ok(Statics {
        aside,
        // The stiffness of a joint is none of the arm's.
        tip_compliance: match rod.has_free_tip() {
            true => path.tip_compliance(&own),
            false => None,
        },
        own,
        goes_to,
        from_factor: if begins_loaded { 1.0 } else { 0.0 },
        critical,
        sweep,
        cut,
        refined_space,
        rod,
    })
}

/// Returns the equilibrium where a path begins, and that at factor 1, which are one on a path that [begins there](LoadPath::begins_loaded).
fn begun(path: &LoadPath<'_>) -> Result<[LoadedShape; 2], EquilibriumError> {
    if path.begins_loaded() {
        let own = path.loaded()?;
        return Ok([own.clone(), own]);
    }
    let start = path.start()?;
    let own = path.at(&start, 1.0)?;
    Ok([start, own])
}

/// Adds to a sweep the equilibria at further factors, each from the one before, until one has none, which goes to `cut`; that of factor 1 is
/// known.
fn extended(
    path: &LoadPath<'_>,
    factors: &[f64],
    own: &LoadedShape,
    sweep: &mut Vec<LoadedShape>,
    cut: &mut Option<EquilibriumError>,
) -> Result<(), EquilibriumError> {
    for &factor in factors {
        let last = &sweep[sweep.len() - 1];
        let next = if factor == 1.0 {
            Ok(own.clone())
        } else {
            path.at(last, factor)
        };
        match next {
            Ok(next) => sweep.push(next),
            Err(error @ EquilibriumError::Stopped(_)) => return Err(error),
            Err(error) => {
                *cut = Some(error);
                break;
            }
        }
    }
    Ok(())
}

/// Returns the equilibrium of a rod with twice the elements next to that of the own one, or `None` where there is none. An arm may have
/// several equilibria, and a whole circle of them where nothing brings it back, of which another search could find another one.
fn shape_on(
    finer: &Rod,
    own: &LoadedShape,
    options: &StaticsOptions,
    aside: Option<&Load>,
    stop: &StopSignal,
) -> Result<Option<Configuration>, StaticsError> {
    let aside = aside.map(|load| Load {
        node: 2 * load.node,
        ..load.clone()
    });
    let path = LoadPath::new(finer, options.varied, options.time, aside, stop)?;
    let start = LoadedShape {
        shape: doubled(&own.shape),
        ..own.clone()
    };
    // A shape that is not stable would be left for another one.
    let found = match own.stability {
        Some(found) if !found.is_stable => {
            let rod = path.rod_at(own.factor);
            let none = NodeSpring::default();
            nearby_equilibrium_until(&rod, &start.shape, options.time, &none, stop)
        }
        _ => path.released(&start).map(|found| found.shape),
    };
    match found {
        Ok(shape) => Ok(Some(shape)),
        Err(EquilibriumError::Stopped(stop)) => Err(EquilibriumError::Stopped(stop).into()),
        Err(_) => Ok(None),
    }
}

/// Returns the shape with a node in the middle of every element: in the middle of the chord, turned half as far.
fn doubled(shape: &Configuration) -> Configuration {
    let (x, r) = (&shape.positions, &shape.rotations);
    let last = x.len() - 1;
    let node = |at: usize| {
        let q = at / 2;
        if at.is_multiple_of(2) {
            return (x[q], r[q]);
        }
        let turn = 0.5 * log(&r[q].tr_mul(&r[q + 1]));
        (0.5 * (x[q] + x[q + 1]), r[q] * exp(&turn))
    };
    let (positions, rotations) = (0..=2 * last).map(node).unzip();
    Configuration {
        positions,
        rotations,
    }
}

/// Returns a dead force of a part of EI/L² on the node of the unloaded arm that is most compliant, along its softest direction; for a
/// straight arm the first axis of its section.
fn push(
    rod: &Rod,
    part: f64,
    options: &StaticsOptions,
    stop: &StopSignal,
) -> Result<Load, StaticsError> {
    let path = LoadPath::new(rod, options.varied, options.time, None, stop)?;
    let start = path.start()?;
    let first = start.shape.rotations[0].column(0).into_owned();
    let (node, compliance) = match rod.has_free_tip() {
        true => (rod.tip(), path.tip_compliance(&start)),
        false => path.softest_node(&start),
    };
    let direction = compliance.map_or(first, |compliance| {
        let compliance = 0.5 * (compliance + compliance.transpose());
        // The power of the compliance selects the softest directions; of equally soft ones it keeps the one nearest to the first axis.
        let softest = compliance * compliance * compliance * first;
        softest.try_normalize(0.0).unwrap_or(first)
    });
    Ok(Load {
        node,
        force: part * rod.scales.force * direction,
        moment: Vector3::zeros(),
        frame: LoadFrame::Spatial,
        profile: Vec::new(),
    })
}

/// Returns the stable equilibrium that the arm reaches when its loads grow from zero while a small force pushes its tip aside, after that
/// force is removed; `None` where it is not stable or not another one.
fn pushed(
    rod: &Rod,
    own: &LoadedShape,
    options: &StaticsOptions,
    stop: &StopSignal,
) -> Result<Option<LoadedShape>, StaticsError> {
    let aside = push(rod, PUSH, options, stop)?;
    let path = LoadPath::new(rod, options.varied, options.time, Some(aside), stop)?;
    let free = LoadPath::new(rod, options.varied, options.time, None, stop)?;
    let found = begun(&path).and_then(|[_, leaning]| free.released(&leaning));
    match found {
        Ok(found) => {
            let found = free.examined(found);
            let grows = (found.stability).is_none_or(|found| found.growth_rate.is_some());
            let (_, away) = own.shape.farthest_node(&found.shape.positions);
            Ok((!grows && away > PUSH * rod.scales.length).then_some(found))
        }
        Err(EquilibriumError::Stopped(stop)) => Err(EquilibriumError::Stopped(stop).into()),
        Err(_) => Ok(None),
    }
}
