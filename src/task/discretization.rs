//! The discretization of a continuous problem: elements, strain rule, integrator, time step, blocks of the controls and samples.

use crate::control::Hold;
use crate::mechanics::{RotaryInertia, StrainRule, TimeScheme};

/// Elements, strain rule, integrator, time step, course of the controls and samples.
///
/// What is `None` is chosen by [`Task::discretize`](super::Task::discretize), whose [`Problem`](super::Problem) says what was chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Discretization {
    /// Elements of the rod, at least 1.
    pub elements: usize,
    /// How the strains of an element follow from its two nodes.
    pub strain_rule: StrainRule,
    /// How a time step is taken; `None`: explicit, or implicit where that is predicted to take at most half the time.
    pub scheme: Option<TimeScheme>,
    /// Rotary inertia of the nodes; `None`: that of the section, or that of segments where the section's would take five times as long.
    pub rotary_inertia: Option<RotaryInertia>,
    /// Longest time step, s; it is shortened so that steps divide the blocks. `None`: a step that suits the rod and its integrator.
    pub step: Option<f64>,
    /// The course of the controls within a block.
    pub hold: Hold,
    /// Blocks of equal duration that the horizon is divided into, at least 1.
    pub blocks: usize,
    /// Intervals between samples of what is integrated over states, at least 1.
    pub samples: usize,
}

impl Default for Discretization {
    /// 20 helical elements, 20 blocks with linear hold, 100 samples; integrator, rotary inertia and step are chosen.
    fn default() -> Self {
        Self {
            elements: 20,
            strain_rule: StrainRule::Helical,
            scheme: None,
            rotary_inertia: None,
            step: None,
            hold: Hold::Linear,
            blocks: 20,
            samples: 100,
        }
    }
}

impl Discretization {
    /// The default with another number of elements.
    #[must_use]
    pub fn with_elements(elements: usize) -> Self {
        Self {
            elements,
            ..Self::default()
        }
    }
}
