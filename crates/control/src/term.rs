//! User-defined terms: functions of the arm's configuration that are costs, or that must stay below zero.
//!
//! A [`StateTerm`] is a list of values `f_i(x, R)` at one instant, each with its first derivative as a linear form of `(δx, ζ)` of a few
//! nodes, `δR = R ζ̂`. As a cost it adds `weight/2 ∫ Σ f_i² dt` to the objective ([`StateCost`]), as a limit it requires `f_i ≤ 0` at all
//! times, hard or with a penalty ([`PathLimit::Term`](super::PathLimit)). Solver, derivative check, certificate and regulator treat it like
//! the built-in terms. The certificate uses the values alone, which it differentiates by itself: a wrong derivative makes it reject the
//! solution.

use std::fmt;
use std::sync::Arc;

use faer::Mat;
use nalgebra::Vector3;

use mechanics::Rod;
pub use mechanics::StateView;
use mechanics::forms::FormTerm;

/// A linear form `Σ a_q·δx_q + b_q·ζ_q` of the motion of nodes.
#[derive(Clone, Debug, Default)]
pub struct NodeForm {
    pub(super) terms: Vec<FormTerm>,
}

impl NodeForm {
    /// Adds `a·δx` of a node, with `a` in the spatial frame.
    #[must_use]
    pub fn along_position(self, node: usize, a: &Vector3<f64>) -> Self {
        self.along(node, 0, a)
    }

    /// Adds `b·ζ` of a node, `δR = R ζ̂`, with `b` in its body frame.
    #[must_use]
    pub fn along_rotation(self, node: usize, b: &Vector3<f64>) -> Self {
        self.along(node, 3, b)
    }

    fn along(mut self, node: usize, from: usize, direction: &Vector3<f64>) -> Self {
        self.terms.extend((0..3).map(|axis| FormTerm {
            node,
            component: from + axis,
            coefficient: direction[axis],
        }));
        self
    }

    /// Returns the coefficient of a component of a node: 0..3 `δx`, 3..6 `ζ`.
    fn coefficient(&self, node: usize, component: usize) -> f64 {
        (self.terms.iter())
            .filter(|term| (term.node, term.component) == (node, component))
            .map(|term| term.coefficient)
            .sum()
    }
}

/// A function of the arm's configuration at one instant.
pub trait StateTerm: fmt::Debug + Send + Sync {
    /// Returns the number of values; one by default.
    fn n_values(&self, rod: &Rod) -> usize {
        let _ = rod;
        1
    }

    /// Returns the nodes on which value `item` depends.
    fn nodes(&self, rod: &Rod, item: usize) -> Vec<usize>;

    /// Returns value `item`, which should be of order one: divide it by a value that counts as large.
    fn value(&self, at: &StateView, item: usize) -> f64;

    /// Returns the first derivative of value `item`.
    fn gradient(&self, at: &StateView, item: usize) -> NodeForm;

    /// Returns the second derivative of value `item` with respect to `(δx, ζ)` of its [nodes](Self::nodes), six rows each, symmetric; along
    /// a rotation it is that of `s ↦ f(R exp(s ζ̂))`. By default it comes from central differences of the gradient, accurate to about 1e-9
    /// of its size.
    fn curvature(&self, at: &StateView, item: usize) -> Mat<f64> {
        differenced(at, &self.nodes(at.rod, item), |at| self.gradient(at, item))
    }

    /// Returns the unit of the values in reports; none by default.
    fn unit(&self) -> &'static str {
        ""
    }
}

/// Half the width of central differences along rotations, rad, along positions, in lengths, and along scaled controls: near the cube root
/// of the machine precision, 6e-6, at which truncation and rounding of a difference are about equal (Nocedal and Wright 2006, section 8.1).
pub const DIFFERENCE: f64 = 1e-5;

/// Returns the symmetric derivative of a gradient with respect to the components of some nodes.
fn differenced(
    at: &StateView,
    nodes: &[usize],
    gradient: impl Fn(&StateView) -> NodeForm,
) -> Mat<f64> {
    let size = 6 * nodes.len();
    let mut out = Mat::zeros(size, size);
    for (j, &node) in nodes.iter().enumerate() {
        for component in 0..6 {
            let step = if component < 3 {
                DIFFERENCE * at.rod.scales.length
            } else {
                DIFFERENCE
            };
            let moved = |step: f64| at.moved(node, component, step, &gradient);
            let (plus, minus) = (moved(step), moved(-step));
            for (i, &other) in nodes.iter().enumerate() {
                for row in 0..6 {
                    let slope = (plus.coefficient(other, row) - minus.coefficient(other, row))
                        / (2.0 * step);
                    out[(6 * i + row, 6 * j + component)] += 0.5 * slope;
                    out[(6 * j + component, 6 * i + row)] += 0.5 * slope;
                }
            }
        }
    }
    out
}

/// A shared term, which is equal only to itself.
#[derive(Clone, Debug)]
pub struct SharedTerm(pub Arc<dyn StateTerm>);

impl SharedTerm {
    /// Shares a term.
    pub fn new(term: impl StateTerm + 'static) -> Self {
        Self(Arc::new(term))
    }
}

impl std::ops::Deref for SharedTerm {
    type Target = dyn StateTerm;

    fn deref(&self) -> &Self::Target {
        &*self.0
    }
}

impl PartialEq for SharedTerm {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

/// A term of the objective: `weight/2 ∫ Σ f_i² dt`, by the trapezoidal rule over the samples of the objective.
#[derive(Clone, Debug, PartialEq)]
pub struct StateCost {
    /// The residuals `f_i`.
    pub term: SharedTerm,
    /// Weight, 1/s; not negative.
    pub weight: f64,
}
