//! Strains, stresses and speed of a motion over arc length and time.

use nalgebra::{Matrix3, Vector3};

use super::FRAMES;
use crate::mechanics::Rod;
use crate::output::{MotionRecord, ReportField, ReportFields};

/// Part of the scale of a quantity that is noise of its rounding.
const NOISE: f64 = 1e-9;
/// Part of the largest stiffness that is noise of a stress: strains are differences of numbers near 1.
const STRESS_NOISE: f64 = 1e-13;

/// A row of a record as vectors and matrices.
pub(super) fn pose(record: &MotionRecord, row: usize) -> (Vec<Vector3<f64>>, Vec<Matrix3<f64>>) {
    let n = record.n_nodes;
    let positions = record.x[3 * n * row..3 * n * (row + 1)].chunks_exact(3);
    let rotations = record.rotation[9 * n * row..9 * n * (row + 1)].chunks_exact(9);
    (
        positions.map(Vector3::from_column_slice).collect(),
        rotations.map(Matrix3::from_row_slice).collect(),
    )
}

/// The quantities at the frames of a motion: bending curvature, twist, stretch, speed, internal force and moment; `None` where nothing
/// moves and nothing is strained.
///
/// Curvature and twist are those of the shape itself, 1/m, the stress-free ones included. Force and moment are elastic, without internal
/// damping. The speed is the distance between the neighboring rows of the record over the time between them.
pub(super) fn fields(rod: &Rod, record: &MotionRecord) -> Option<ReportFields> {
    let frames = record.thinned_rows(FRAMES);
    let scales = &rod.scales;
    let [mut bending, mut twist, mut force, mut moment] = [const { Vec::new() }; 4];
    let (mut stretch, mut speed) = (Vec::new(), Vec::new());
    for &row in &frames {
        let (positions, rotations) = pose(record, row);
        let mut strains = [const { Vec::new() }; 4];
        for (q, element) in rod.elements.iter().enumerate() {
            let ends = Rod::element_pose(q, &positions, &rotations);
            let curvature = rod.strain_rule.strain(element.length, &ends).curvature;
            let (n, m) = element.stress(rod.strain_rule, &ends);
            for (values, value) in
                strains
                    .iter_mut()
                    .zip([curvature.xy().norm(), curvature.z, n.norm(), m.norm()])
            {
                values.push(value);
            }
        }
        for (all, values) in [&mut bending, &mut twist, &mut force, &mut moment]
            .into_iter()
            .zip(strains)
        {
            all.push(values);
        }
        let elements = rod.n_elements();
        stretch.push(record.dilatation[elements * row..elements * (row + 1)].to_vec());
        let (before, after) = (row.saturating_sub(1), (row + 1).min(record.n_rows() - 1));
        let span = record.t[after] - record.t[before];
        speed.push(
            (0..rod.n_nodes())
                .map(|node| {
                    let way = record.position(after, node) - record.position(before, node);
                    if span > 0.0 { way.norm() / span } else { 0.0 }
                })
                .collect::<Vec<_>>(),
        );
    }
    let (mut stiffest, mut stiffest_turn) = (0.0, 0.0);
    for element in &rod.elements {
        stiffest = element.linear_stiffness.max().max(stiffest);
        stiffest_turn = element.angular_stiffness.max().max(stiffest_turn);
    }
    let force_noise = (NOISE * scales.force).max(STRESS_NOISE * stiffest);
    let moment_noise =
        (NOISE * scales.moment).max(STRESS_NOISE * stiffest_turn / rod.shortest_element());
    let curvature_noise = NOISE / scales.length;
    let fields: Vec<ReportField> = [
        ReportField::of(
            "bending curvature",
            "1/m",
            false,
            None,
            curvature_noise,
            &bending,
        ),
        ReportField::of("stretch", "", false, Some(1.0), NOISE, &stretch),
        ReportField::of("twist", "1/m", false, Some(0.0), curvature_noise, &twist),
        ReportField::of(
            "speed",
            "m/s",
            true,
            None,
            NOISE * scales.length / scales.time,
            &speed,
        ),
        ReportField::of("internal force", "N", false, None, force_noise, &force),
        ReportField::of("internal moment", "N m", false, None, moment_noise, &moment),
    ]
    .into_iter()
    .flatten()
    .collect();
    (!fields.is_empty() && frames.len() > 1).then(|| ReportFields {
        t: frames.iter().map(|&row| record.t[row]).collect(),
        length: scales.length,
        places: match rod.mesh.n_pieces() {
            1 => Vec::new(),
            _ => rod.mesh.fractions(),
        },
        fields,
    })
}
