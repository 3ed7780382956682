//! Derivatives of rows: sums of linear forms of the states, and second derivatives over such forms.

use faer::Mat;
use nalgebra::{DMatrix, Matrix3, SMatrix, SVector, Vector3};

use super::RodView;
use crate::term::SharedTerm;
use mechanics::curvature::OwnCurvature;
use mechanics::element::{IntervalStress, log_second_derivative};
use mechanics::{FormTerm, Rod, StateForm};

/// First derivative of a row: a sum of forms at one or two time nodes.
pub type RowGradient = Vec<StateForm>;

/// Second derivative of a row: `Σ_ij matrix_ij form_i form_j`.
#[derive(Clone, Debug)]
pub struct RowCurvature {
    /// Linear forms of the states.
    pub forms: Vec<RowGradient>,
    /// Symmetric.
    pub matrix: DMatrix<f64>,
}

impl RowCurvature {
    /// Returns the second derivative over components of nodes; `None` if the forms are of several time nodes.
    #[must_use]
    pub fn at_one_time(&self) -> Option<OwnCurvature> {
        let forms: Vec<&StateForm> = (self.forms.iter())
            .map(|gradient| match gradient.as_slice() {
                [form] => Some(form),
                _ => None,
            })
            .collect::<Option<_>>()?;
        let time_node = forms.first()?.time_node;
        let mut rows: Vec<(usize, usize)> = (forms.iter())
            .flat_map(|form| form.terms.iter().map(|term| (term.node, term.component)))
            .collect();
        rows.sort_unstable();
        rows.dedup();
        let mut parts = DMatrix::zeros(forms.len(), rows.len());
        for (i, form) in forms.iter().enumerate() {
            for term in &form.terms {
                if let Ok(j) = rows.binary_search(&(term.node, term.component)) {
                    parts[(i, j)] += term.coefficient;
                }
            }
        }
        let matrix = parts.transpose() * &self.matrix * &parts;
        Some(OwnCurvature {
            forms: Vec::new(),
            earlier: Vec::new(),
            time_node,
            matrix: Mat::from_fn(rows.len(), rows.len(), |i, j| matrix[(i, j)]),
            rows,
        })
    }
}

pub(crate) fn term(node: usize, component: usize, coefficient: f64) -> FormTerm {
    FormTerm {
        node,
        component,
        coefficient,
    }
}

pub(crate) fn at(time_node: usize, terms: Vec<FormTerm>) -> RowGradient {
    vec![StateForm { time_node, terms }]
}

/// `direction · δx` of a node, or `direction · ζ` with `from = 3`.
pub(crate) fn along(
    node: usize,
    from: usize,
    direction: &Vector3<f64>,
) -> impl Iterator<Item = FormTerm> + use<> {
    let direction = *direction;
    (0..3).map(move |axis| term(node, from + axis, direction[axis]))
}

/// `w·(δx_{q+1} - δx_q, ζ_q, ζ_{q+1})` of an element.
pub(crate) fn element_form(
    q: usize,
    w: &SVector<f64, 9>,
) -> impl Iterator<Item = FormTerm> + use<> {
    let part = |i: usize| -> Vector3<f64> { w.fixed_rows::<3>(3 * i).into() };
    let dx = part(0);
    along(q, 0, &-dx)
        .chain(along(q + 1, 0, &dx))
        .chain(along(q, 3, &part(1)))
        .chain(along(q + 1, 3, &part(2)))
}

/// The symmetric part of a matrix over `(δx_{q+1} - δx_q, ζ_q, ζ_{q+1})` of an element, as a second derivative.
pub(crate) fn element_curvature(k: usize, q: usize, matrix: &SMatrix<f64, 9, 9>) -> RowCurvature {
    RowCurvature {
        forms: (0..9)
            .map(|i| {
                at(
                    k,
                    element_form(q, &SVector::<f64, 9>::ith(i, 1.0)).collect(),
                )
            })
            .collect(),
        matrix: DMatrix::from_fn(9, 9, |i, j| 0.5 * (matrix[(i, j)] + matrix[(j, i)])),
    }
}

/// The components of `δx` of a node, or of `ζ` with `from = 3`.
pub(crate) fn vector_forms(k: usize, node: usize, from: usize) -> Vec<RowGradient> {
    (0..3)
        .map(|axis| at(k, vec![term(node, from + axis, 1.0)]))
        .collect()
}

/// Second derivative of `y · ψ`, `ψ = log(R*ᵀ R)` of a node.
pub(crate) fn turn_curvature(
    k: usize,
    node: usize,
    psi: &Vector3<f64>,
    y: &Vector3<f64>,
) -> RowCurvature {
    node_turn_curvature(k, node, &log_second_derivative(psi, y))
}

/// A second derivative along the rotation `ζ` of a node.
pub(crate) fn node_turn_curvature(k: usize, node: usize, matrix: &Matrix3<f64>) -> RowCurvature {
    RowCurvature {
        forms: vector_forms(k, node, 3),
        matrix: dynamic(matrix),
    }
}

/// `(I - u uᵀ)/norm`, the second derivative of a norm; zero at 0, where it has none.
pub(crate) fn norm_curvature(v: &Vector3<f64>) -> Matrix3<f64> {
    let norm = v.norm();
    if norm > 0.0 {
        let u = v / norm;
        (Matrix3::identity() - u * u.transpose()) / norm
    } else {
        Matrix3::zeros()
    }
}

/// `v/|v|`, or zero.
pub(crate) fn unit(v: &Vector3<f64>) -> Vector3<f64> {
    v.try_normalize(0.0).unwrap_or_else(Vector3::zeros)
}

pub(crate) fn dynamic(matrix: &Matrix3<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(3, 3, |i, j| matrix[(i, j)])
}

/// Returns the sum of second derivatives.
pub(crate) fn joined(parts: Vec<RowCurvature>) -> RowCurvature {
    let n = parts.iter().map(|part| part.forms.len()).sum();
    let mut matrix = DMatrix::zeros(n, n);
    let mut forms = Vec::with_capacity(n);
    for part in parts {
        let (at, m) = (forms.len(), part.forms.len());
        matrix.view_mut((at, at), (m, m)).copy_from(&part.matrix);
        forms.extend(part.forms);
    }
    RowCurvature { forms, matrix }
}

/// `factor` times the second derivative of a value of a term.
pub(crate) fn term_curvature(
    term: &SharedTerm,
    rod_view: &RodView,
    k: usize,
    item: usize,
    factor: f64,
) -> RowCurvature {
    let matrix = term.curvature(&rod_view.view(k), item);
    RowCurvature {
        forms: (term.nodes(rod_view.rod, item).into_iter())
            .flat_map(|node| [vector_forms(k, node, 0), vector_forms(k, node, 3)].concat())
            .collect(),
        matrix: DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| {
            factor * matrix[(i, j)]
        }),
    }
}

/// `direction · δ` of a point at the fraction `s` of the chord of element `q`.
pub(crate) fn point_form(
    q: usize,
    s: f64,
    direction: &Vector3<f64>,
) -> impl Iterator<Item = FormTerm> + use<> {
    // A point on a node has no share of the next one, which the last node lacks.
    let next = (s > 0.0).then(|| along(q + 1, 0, &(direction * s)));
    along(q, 0, &(direction * (1.0 - s))).chain(next.into_iter().flatten())
}

/// `direction · (δx^k - δx^{k-1})`.
pub(crate) fn velocity_form(k: usize, node: usize, direction: &Vector3<f64>) -> RowGradient {
    let mut forms = at(k, along(node, 0, direction).collect());
    if k > 0 {
        forms.extend(at(k - 1, along(node, 0, &-direction).collect()));
    }
    forms
}

/// `n · δκ` of an element.
pub(crate) fn strain_form(
    rod_view: &RodView,
    k: usize,
    q: usize,
    n: &Vector3<f64>,
) -> impl Iterator<Item = FormTerm> + use<> {
    element_form(q, &(curvature_rows(rod_view, k, q).transpose() * n))
}

/// `∂κ/∂(dx, ζ_q, ζ_{q+1})` of an element.
fn curvature_rows(rod_view: &RodView, k: usize, q: usize) -> SMatrix<f64, 3, 9> {
    let (x, r) = (
        rod_view.trajectory.positions_at(k),
        rod_view.trajectory.rotations_at(k),
    );
    let rod = rod_view.rod;
    let pose = Rod::element_pose(q, x, r);
    let (_, derivative) = rod
        .strain_rule
        .strain_derivative(rod.elements[q].length, &pose);
    derivative.fixed_rows::<3>(6).into_owned()
}

/// Second derivative of a function of the curvature `κ` of an element, with gradient `n` and second derivative `across` there.
pub(crate) fn strain_curvature(
    rod_view: &RodView,
    k: usize,
    q: usize,
    n: &Vector3<f64>,
    across: &Matrix3<f64>,
) -> RowCurvature {
    let (x, r) = (
        rod_view.trajectory.positions_at(k),
        rod_view.trajectory.rotations_at(k),
    );
    let rod = rod_view.rod;
    let element = &rod.elements[q];
    let pose = Rod::element_pose(q, x, r);
    // A stress `n/l` does the work n·δκ.
    let stress = IntervalStress {
        linear: [Vector3::zeros(); 2],
        angular: n / element.length,
    };
    let own = element.stiffness_under(rod.strain_rule, &pose, &stress, 0.0);
    let rows = curvature_rows(rod_view, k, q);
    let sum = own + rows.transpose() * across * rows;
    element_curvature(k, q, &sum)
}
