//! Linear forms of the variation of a motion at single time nodes, by which constraints and costs enter a linearized motion.

use super::configuration::TrajectoryTangent;
pub use super::state_tangent::NODE_COMPONENTS;
use super::state_tangent::StateTangent;

/// One component of one node, with its coefficient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FormTerm {
    /// Index of the rod's node.
    pub node: usize,
    /// 0..3 `δx` (spatial), 3..6 `ζ` (body), 6..9 `δp` (spatial), 9..12 `δπ` (body).
    pub component: usize,
    /// Unit of the form per unit of the component.
    pub coefficient: f64,
}

/// A linear form `Σ coefficient · component` of the tangent at one time node.
///
/// At `k < N` the momenta are those that arrive at `k`, before its kick: `m (x^k - x^{k-1})/h` for a standard rod with explicit steps, the
/// initial ones at 0. At `N` they are those after the last kick, the terminal Legendre transform. Held or driven nodes have no tangent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StateForm {
    /// Time node `k`.
    pub time_node: usize,
    /// Terms of the sum.
    pub terms: Vec<FormTerm>,
}

impl StateForm {
    /// Returns the form whose value is [`StateTangent::dot`] with `covector`.
    #[must_use]
    pub fn of_covector(time_node: usize, covector: &StateTangent) -> Self {
        let parts = [
            &covector.positions,
            &covector.rotations,
            &covector.linear,
            &covector.angular,
        ];
        let terms = (parts.into_iter().enumerate())
            .flat_map(|(part, vectors)| {
                (vectors.iter().enumerate()).flat_map(move |(node, vector)| {
                    (0..3).map(move |axis| FormTerm {
                        node,
                        component: 3 * part + axis,
                        coefficient: vector[axis],
                    })
                })
            })
            .filter(|term| term.coefficient != 0.0)
            .collect();
        Self { time_node, terms }
    }

    /// Returns the value on a tangent at the form's time node.
    #[must_use]
    pub fn of(&self, tangent: &StateTangent) -> f64 {
        (self.terms.iter())
            .map(|term| {
                term.coefficient * tangent.part(term.component / 3)[term.node][term.component % 3]
            })
            .sum()
    }

    /// Returns the value on a direction of the configurations of `n_nodes` nodes; the form must not contain momenta.
    #[must_use]
    pub fn along(&self, direction: &TrajectoryTangent, n_nodes: usize) -> f64 {
        (self.terms.iter())
            .map(|term| {
                let row = self.time_node * n_nodes + term.node;
                let part = match term.component {
                    0..3 => &direction.positions,
                    _ => &direction.rotations,
                };
                term.coefficient * part[row][term.component % 3]
            })
            .sum()
    }

    /// Adds the form's coefficients to a covector.
    pub fn add_to(&self, covector: &mut StateTangent) {
        for term in &self.terms {
            covector.part_mut(term.component / 3)[term.node][term.component % 3] +=
                term.coefficient;
        }
    }
}

/// Returns the range of the forms of time node `k`, among forms in ascending order of time.
pub fn forms_at(forms: &[StateForm], k: usize) -> std::ops::Range<usize> {
    let before = |limit| forms.partition_point(|form| form.time_node < limit);
    before(k)..before(k + 1)
}
