//! One column of the linearized motion at one instant.

use nalgebra::Vector3;

/// Number of components of a node's tangent: `δx, ζ, δp, δπ`.
pub const NODE_COMPONENTS: usize = 12;

/// One column of the linearized motion at one instant: `(δx, ζ, δp, δπ)` of every node.
#[derive(Clone, Debug, PartialEq)]
pub struct StateTangent {
    /// `δx`, spatial.
    pub positions: Vec<Vector3<f64>>,
    /// `ζ`, body frame.
    pub rotations: Vec<Vector3<f64>>,
    /// `δp`, spatial.
    pub linear: Vec<Vector3<f64>>,
    /// `δπ`, body frame.
    pub angular: Vec<Vector3<f64>>,
}

impl StateTangent {
    /// The zero direction.
    #[must_use]
    pub fn zeros(n_nodes: usize) -> Self {
        let zeros = vec![Vector3::zeros(); n_nodes];
        Self {
            positions: zeros.clone(),
            rotations: zeros.clone(),
            linear: zeros.clone(),
            angular: zeros,
        }
    }

    /// One of the four parts, in the order of the fields.
    pub fn part(&self, part: usize) -> &[Vector3<f64>] {
        [
            &self.positions,
            &self.rotations,
            &self.linear,
            &self.angular,
        ][part]
    }

    /// `(δx, ζ, δp, δπ)` of the nodes from `first` on, node by node.
    pub fn components_from(&self, first: usize) -> impl Iterator<Item = f64> {
        (first..self.positions.len())
            .flat_map(move |node| (0..NODE_COMPONENTS).map(move |i| self.component(node, i)))
    }

    /// One of the [`NODE_COMPONENTS`] of a node.
    pub fn component(&self, node: usize, component: usize) -> f64 {
        self.part(component / 3)[node][component % 3]
    }

    /// Returns one of the four parts of the direction, for writing.
    pub fn part_mut(&mut self, part: usize) -> &mut [Vector3<f64>] {
        [
            &mut self.positions,
            &mut self.rotations,
            &mut self.linear,
            &mut self.angular,
        ][part]
    }

    /// Returns the sum with another direction.
    #[must_use]
    pub fn plus(&self, other: &Self) -> Self {
        let mut out = self.clone();
        for part in 0..4 {
            for (own, more) in out.part_mut(part).iter_mut().zip(other.part(part)) {
                *own += more;
            }
        }
        out
    }

    /// The direction times a number.
    pub fn scaled(&self, factor: f64) -> Self {
        let mut out = self.clone();
        for part in 0..4 {
            out.part_mut(part).iter_mut().for_each(|v| *v *= factor);
        }
        out
    }

    /// The zero direction, in the same memory.
    pub fn fill_zero(&mut self) {
        for part in 0..4 {
            self.part_mut(part).fill(Vector3::zeros());
        }
    }

    /// Euclidean inner product of the components.
    #[must_use]
    pub fn dot(&self, other: &Self) -> f64 {
        (0..4)
            .flat_map(|part| self.part(part).iter().zip(other.part(part)))
            .map(|(a, b)| a.dot(b))
            .sum()
    }
}
