//! The discretization of a continuous problem: elements, strain rule, integrator, time step, blocks of the controls and samples.

use control::Hold;
use mechanics::{RotaryInertia, StrainRule, TimeScheme};

/// Elements, strain rule, integrator, time step, course of the controls and samples.
///
/// [`Task::discretize`](super::Task::discretize) chooses every field that is `None`, and its [`Problem`](super::Problem) has the choices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Discretization {
    /// Elements of the rod, at least 1.
    pub elements: usize,
    /// The number of elements of every piece of an arm that elements have to divide at given places is a multiple of this; see
    /// [`Mesh::new`](mechanics::Mesh::new). 1, but for [finer](Self::refined) discretizations.
    pub multiple: usize,
    /// Rule by which the strains of an element follow from its two nodes.
    pub strain_rule: StrainRule,
    /// Integrator. `None`: explicit, or implicit if it is predicted to take at most a tenth of the time of explicit steps, and these more
    /// than a second; a given `step` decides by its stability (see [`automatic_scheme`](super::prediction::automatic_scheme)).
    pub scheme: Option<TimeScheme>,
    /// Rotary inertia of the nodes. `None`: that of the section, or that of segments if the work is predicted to take more than a second
    /// and five times as long with that of the section.
    pub rotary_inertia: Option<RotaryInertia>,
    /// Longest time step, s; it is shortened so that steps divide the blocks. `None`: a step that suits the rod and its integrator.
    pub step: Option<f64>,
    /// The course of the controls within a block.
    pub hold: Hold,
    /// Blocks of equal duration that the horizon is divided into, at least 1.
    pub blocks: usize,
    /// Number of intervals between samples of terms that are integrated over states, at least 1.
    pub samples: usize,
}

impl Default for Discretization {
    /// 20 helical elements, 20 blocks with linear hold, 100 samples; integrator, rotary inertia and step are chosen.
    fn default() -> Self {
        Self {
            elements: 20,
            multiple: 1,
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

    /// Returns the discretization with `factor` times the elements, which divide every element into as many equal ones.
    #[must_use]
    pub fn refined(&self, factor: usize) -> Self {
        Self {
            elements: self.elements * factor,
            multiple: self.multiple * factor,
            ..*self
        }
    }
}
