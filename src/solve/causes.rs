//! Explanations of a simulation that broke down, such as an arm that topples under its weight.

use crate::mechanics::equilibrium::{TipSpring, static_equilibrium};
use crate::mechanics::vibration::{TOPPLING_WEIGHT_NUMBER, weight_number};
use crate::mechanics::{BaseCondition, Rod, RodModel, SmallMotions, State, StrainRule};

/// Growth of a small deviation over the time of a motion above which the motion is called unstable.
const UNSTABLE_GROWTH: f64 = 10.0;

/// What may be behind a motion that could not be computed, or a problem that could not be solved, over `duration` seconds from `initial` on:
/// an arm that topples, a model that breaks down. Sentences that can follow a message after a semicolon.
pub(crate) fn causes(rod: &Rod, initial: &State, duration: f64) -> Vec<String> {
    [toppling(rod, initial, duration), breakdown(rod)]
        .into_iter()
        .flatten()
        .collect()
}

/// Says that the equilibrium next to the start is unstable, by how fast it is left.
fn toppling(rod: &Rod, initial: &State, duration: f64) -> Option<String> {
    if rod.base == BaseCondition::Free || rod.gravity.norm() == 0.0 && rod.loads.is_empty() {
        return None;
    }
    let shape = static_equilibrium(rod, &initial.configuration, 0.0, &TipSpring::default()).ok()?;
    let rate = SmallMotions::about(rod, &shape, 0.0).growth_rate()?;
    let exponent = rate * duration;
    (exponent > UNSTABLE_GROWTH.ln()).then(|| {
        format!(
            "the motion is unstable: this arm cannot stand as it starts, small deviations from its equilibrium there grow as exp({rate:.3} t), \
             by a factor of 1e{:.0} in {duration} s (weight number rho A g L^3/EI {:.3}; a uniform arm clamped upright topples above \
             {TOPPLING_WEIGHT_NUMBER:.2}, with a payload earlier); make it shorter, thicker or stiffer, lighter at the tip, hang it \
             (base.direction along gravity), or take less time",
            exponent / std::f64::consts::LN_10,
            weight_number(rod)
        )
    })
}

/// The paper's model is no variation of an action.
fn breakdown(rod: &Rod) -> Option<String> {
    (rod.model == RodModel::Dilatation).then(|| {
        let finer = match rod.strain_rule {
            StrainRule::Helical => ", with helical strains the earlier the finer the grid",
            StrainRule::Trapezoidal => "",
        };
        format!(
            "the model \"dilatation\" has no energy to keep and may be what broke down{finer}; set rod.model = \"consistent\", the same law of \
             stretch derived from one action"
        )
    })
}
