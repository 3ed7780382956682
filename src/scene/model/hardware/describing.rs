//! The actuators of an arm as a scene describes them.

use super::super::super::values::{self, Positive, known};
use super::super::Scene;
use super::{Braid, Chamber, FollowKeys, Muscle, RateBound, SECTIONS, Sliding, Tendon};
use crate::mechanics::{Density, Route, StrainActuator};
use crate::task::{EffortControl, Follows};

/// Writes the keys of the actuators of an arm, with the efforts that are controls, to a scene; `None` for an actuator that no scene has, or in
/// another order than that of [`SECTIONS`].
pub(in crate::scene) fn describe_hardware(
    actuators: &[StrainActuator],
    efforts: &[EffortControl],
    out: &mut Scene,
) -> Option<()> {
    let mut order = Vec::new();
    for (index, own) in actuators.iter().enumerate() {
        let common = Described::of(actuators, index, efforts)?;
        order.push(match &own.density {
            Density::Shortening | Density::Threaded { .. } => {
                let [spacing, clearance] = match &own.density {
                    Density::Threaded { spacing, clearance } => {
                        [known(*spacing), known(*clearance)]
                    }
                    _ => [known(0.0); 2],
                };
                let sliding = own.friction.and_then(|own| {
                    let found = Sliding::ALL.iter().find(|(_, at)| *at == own.at_rest);
                    found.map(|(sliding, _)| *sliding)
                });
                let friction = own.friction.unwrap_or_default();
                let tendon = Tendon::describing(
                    common,
                    None,
                    None,
                    0.0,
                    None,
                    None,
                    known(0.0),
                    spacing,
                    clearance,
                    known(friction.coefficient),
                    known(friction.speed),
                    sliding,
                );
                out.tendon.push(match own.winch {
                    Some(winch) => tendon.put_on(winch),
                    None => tendon,
                });
                "tendon"
            }
            Density::Volume => {
                (out.chamber).push(Chamber::describing(common, known(own.scale)));
                "chamber"
            }
            Density::Muscle => {
                (out.muscle).push(Muscle::describing(common, known(1.0), known(own.scale)));
                "muscle"
            }
            Density::Braid { fibre, turns } if own.scale == 1.0 => {
                (out.braid).push(Braid::describing(common, known(*fibre), *turns));
                "braid"
            }
            Density::Lengthening | Density::Braid { .. } | Density::Learned(_) => return None,
        });
    }
    let place = |own: &&str| SECTIONS.iter().position(|section| section == own);
    order.is_sorted_by_key(place).then_some(())
}

/// The keys of an actuator that all kinds share, as they describe it.
pub struct Described {
    pub name: Option<String>,
    pub route: Route,
    pub further: Vec<Route>,
    pub bounds: Option<[f64; 2]>,
    pub rate: Option<RateBound>,
    pub lag_s: Option<Positive<values::Time>>,
    pub follows: Option<FollowKeys>,
    pub rest: f64,
    pub profile: Option<Vec<[f64; 2]>>,
}

impl Described {
    /// Returns the keys of the actuator with an index; `None` for one that no scene has.
    fn of(actuators: &[StrainActuator], index: usize, efforts: &[EffortControl]) -> Option<Self> {
        let own = &actuators[index];
        if !own.further.is_empty() && own.routes().any(|route| route.turns != 0.0) {
            return None;
        }
        let control = efforts.iter().find(|control| control.actuator == index);
        if control.is_some_and(|control| control.scale.is_some()) {
            return None;
        }
        let follows = match control.and_then(|control| control.follows) {
            None => None,
            Some(Follows { actuator, gain }) => Some(FollowKeys {
                name: actuators.get(actuator)?.name.clone(),
                gain,
            }),
        };
        let rows = own.effort.iter().map(|&(t, effort)| [t, effort]);
        // A given displacement has a profile even if it is constant.
        let is_winch = own.winch.is_some();
        let is_displacement = is_winch && control.is_none();
        let has_profile = is_displacement || !is_winch && own.effort.len() > 1;
        let rest = match own.effort[..] {
            [(_, only)] if !is_displacement => only,
            _ => 0.0,
        };
        Some(Self {
            name: Some(own.name.clone()).filter(|name| !name.is_empty()),
            route: own.route,
            further: own.further.clone(),
            bounds: control.map(|control| control.bounds),
            rate: control.and_then(|control| control.rate.map(RateBound::Each)),
            lag_s: control.and_then(|control| control.lag).map(known),
            follows,
            rest,
            profile: has_profile.then(|| rows.collect()),
        })
    }
}
