//! Explanations of a simulation that broke down, such as an arm that topples under its weight.

use crate::mechanics::equilibrium::{NodeSpring, nearby_equilibrium_until};
use crate::mechanics::stability::automatic_step;
use crate::mechanics::vibration::weight_in_words;
use crate::mechanics::{
    Configuration, Rod, RodModel, SmallMotions, State, StrainRule, TimeGrid, TimeScheme,
};
use crate::stop::StopSignal;

/// Growth of a small deviation over the time of a motion above which the motion is called unstable. It decides about a sentence alone: a
/// deviation by a hundredth of the length, as real arms have it, becomes one that is seen.
const UNSTABLE_GROWTH: f64 = 10.0;

/// Largest distance of a node from an equilibrium, as a fraction of the arm's length, at which an arm is said to start beside the
/// equilibrium. It decides about a sentence alone: at this distance the terms that the growth rate leaves out, of second order, are a
/// twentieth of those that it has.
const BESIDE: f64 = 0.05;
/// Cap on the elements for which an equilibrium and its frequencies are computed beside other work: they take a fraction of a second.
pub(super) const MOST_ELEMENTS: usize = 1000;
/// Relative difference below which two step lengths, or two weights, are one: roundings of a few operations with numbers that a scene may
/// state in ten digits.
pub(super) const SAME: f64 = 1e-9;

/// Collects likely causes of a motion that could not be computed, or of a problem that could not be solved, on a time grid from `initial`
/// on: a step that is too long, an arm that topples, a model that breaks down. Each cause is a sentence that can follow a message after a
/// semicolon.
pub(crate) fn causes(rod: &Rod, initial: &State, grid: &TimeGrid) -> Vec<String> {
    [
        long_step(rod, grid.step),
        toppling(rod, initial, grid.duration()),
        breakdown(rod),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// Tells that the step is longer than the automatic one. Implicit steps are stable up to a length that falls with the load; the automatic
/// step is stable for an arm that is bent into a circle.
fn long_step(rod: &Rod, step: f64) -> Option<String> {
    let automatic = automatic_step(rod);
    (rod.scheme == TimeScheme::Implicit && step > automatic * (1.0 + SAME)).then(|| {
        format!(
            "time.step_s is {step:.3e} s, longer than the automatic {automatic:.3e} s: in an arm that is bent or loaded, waves that an implicit step \
             does not resolve grow; give at most {automatic:.3e} s, or \"auto\""
        )
    })
}

/// Tells that an arm starts beside an equilibrium that is unstable under the loads at the start or at the end of a motion, and how fast
/// deviations from it grow. The computed motion may then stand by its symmetry alone. Returns `None` otherwise, and above
/// [`MOST_ELEMENTS`].
pub(crate) fn stands_by_symmetry(rod: &Rod, initial: &State, duration: f64) -> Option<String> {
    if rod.n_elements() > MOST_ELEMENTS {
        return None;
    }
    [0.0, duration].into_iter().find_map(|t| {
        let (shape, rate) = unstable_equilibrium(rod, &initial.configuration, t, duration)?;
        let pairs = shape.positions.iter().zip(&initial.configuration.positions);
        let off = pairs.map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        (off < BESIDE * rod.scales.length).then(|| {
            format!(
                "the arm starts beside an equilibrium that is unstable under the loads at t = {t} s, from which deviations grow e-fold in {:.3e} s: if \
                 the motion stays there it stands by its symmetry, where an arm that is never quite straight would fall; tilt the base or add a small \
                 load across it to see that ({})",
                1.0 / rate,
                weight_in_words(rod)
            )
        })
    })
}

/// Returns the equilibrium next to a configuration under the loads at time `t` and the growth rate of deviations from it, 1/s, if they grow
/// by more than [`UNSTABLE_GROWTH`] within `duration`.
///
/// Returns `None` for an arm without loads or with a free base, and under loads that turn with the arm and moments that do not, which have
/// no potential: the symmetric part of the tangent stiffness, which the growth rate is computed from, says nothing about stability under
/// them.
fn unstable_equilibrium(
    rod: &Rod,
    near: &Configuration,
    t: f64,
    duration: f64,
) -> Option<(Configuration, f64)> {
    let is_loaded = rod.gravity.norm() > 0.0 || !rod.loads.is_empty();
    let has_potential = !rod.loads.iter().any(|load| load.turns());
    if !rod.is_held() || !is_loaded || !has_potential {
        return None;
    }
    let shape =
        nearby_equilibrium_until(rod, near, t, &NodeSpring::default(), &StopSignal::default())
            .ok()?;
    let rate = SmallMotions::about(rod, &shape, t).growth_rate()?;
    (rate * duration > UNSTABLE_GROWTH.ln()).then_some((shape, rate))
}

/// Tells that the equilibrium next to the start is unstable, and how fast deviations from it grow.
fn toppling(rod: &Rod, initial: &State, duration: f64) -> Option<String> {
    let (_, rate) = unstable_equilibrium(rod, &initial.configuration, 0.0, duration)?;
    Some(format!(
        "the motion is unstable: this arm cannot stand as it starts, small deviations from its equilibrium there grow as exp({rate:.3} t), \
         by a factor of 1e{:.0} in {duration} s ({}); make it shorter, thicker or stiffer, lighter at the tip, hang it (base.direction along \
         gravity), or take less time",
        rate * duration / std::f64::consts::LN_10,
        weight_in_words(rod)
    ))
}

/// Tells that the model may be the cause where it is the paper's, which derives from no variation of an action.
fn breakdown(rod: &Rod) -> Option<String> {
    (rod.model == RodModel::Dilatation).then(|| {
        let finer = match rod.strain_rule {
            StrainRule::Helical => ", with helical strains the earlier the finer the grid",
            StrainRule::Trapezoidal => "",
        };
        format!(
            "the model \"dilatation\" conserves no energy and may be the cause of the breakdown{finer}; set rod.model = \"consistent\", the same law of \
             stretch derived from one action"
        )
    })
}
