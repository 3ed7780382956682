//! The friction of tendons along their paths, as a scene says it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::super::keys::{Checked, Keys, Needs};
use super::super::super::values::{self, Positive, known};
use super::super::Scene;
use super::Tendon;
use crate::mechanics::{Friction, RodModel, TimeScheme};

/// The direction in which a tendon slid before it came to rest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Sliding {
    /// Its motor pulled it in: the tension falls from the motor on.
    #[default]
    Pulled,
    /// Its motor let it out: the tension rises from the motor on.
    Released,
    /// It has crept until its tension is the same everywhere.
    None,
}

impl Sliding {
    pub(super) const ALL: [(Self, f64); 3] = [
        (Self::Pulled, 1.0),
        (Self::Released, -1.0),
        (Self::None, 0.0),
    ];
}

pub(super) fn default_sliding() -> Positive<values::SlidingSpeed> {
    known(Friction::default().speed)
}

pub(super) fn is_default_sliding(speed: &Positive<values::SlidingSpeed>) -> bool {
    *speed == default_sliding()
}

impl Tendon {
    /// Returns the friction along its path.
    pub(super) fn rubs(&self) -> Option<Friction> {
        let coefficient = self.friction.get();
        let sliding = self.sliding.unwrap_or_default();
        let at_rest = Sliding::ALL.iter().find(|own| own.0 == sliding)?.1;
        (coefficient > 0.0).then(|| Friction {
            coefficient,
            speed: self.sliding_speed_m_s.get(),
            at_rest,
        })
    }
}

impl Keys<'_> {
    /// Checks that the scene has what a tendon with friction needs.
    pub(super) fn check_friction(&self, index: usize, tendon: &Tendon, scene: &Scene) -> Checked {
        let section = format!("tendon.{index}");
        if tendon.friction.get() == 0.0 {
            let of_friction = [
                (
                    "sliding_speed_m_s",
                    !is_default_sliding(&tendon.sliding_speed_m_s),
                ),
                ("sliding", tendon.sliding.is_some()),
            ];
            let reason = "it describes the friction of a tendon along its path";
            let rows = of_friction.map(|own| Needs(own, ("friction", false), reason));
            return self.relations(&section, &rows);
        }
        let diagnostics = (scene.output.as_ref()).is_some_and(|output| output.diagnostics);
        let reason = if scene.time.integrator == Some(TimeScheme::Explicit) {
            "time.integrator = \"explicit\": the direction in which a tendon slides is that of a whole implicit step"
        } else if scene.rod.model != RodModel::Standard {
            "this rod.model, which has explicit steps only"
        } else if diagnostics {
            "output.diagnostics, whose balances know no friction"
        } else {
            return Ok(());
        };
        let message = format!("friction along the path does not go with {reason}");
        let help = "leave one of them out";
        Err((self.source).error_at(&format!("{section}.friction"), message, Some(help.into())))
    }
}
