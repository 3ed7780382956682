//! Obstacles and contacts as a page draws them, with the arm's clearance of each.

use nalgebra::{Matrix3, Vector3};

use super::ROWS;
use crate::control::{PathLimit, RodView, Shape};
use crate::mechanics::{Rod, TimeGrid, Trajectory};
use crate::output::{MotionRecord, ReportObstacle, ReportObstacles, ReportShape};
use crate::scene::translate::directors;
use crate::task::Limit;

/// The obstacles, and the bodies that the arm touches, with the arm's clearance of each; `None` where there are none.
pub(super) fn obstacles(
    limits: &[Limit],
    rod: &Rod,
    radii: &[f64],
    record: &MotionRecord,
) -> Option<ReportObstacles> {
    let limits: Vec<(&str, PathLimit)> = (limits.iter())
        .filter(|limit| matches!(limit.kind, PathLimit::Clearance { .. }))
        .map(|limit| (limit.name.as_str(), limit.kind.on(rod, radii)))
        .collect();
    if limits.is_empty() && rod.contacts.is_empty() {
        return None;
    }
    let rows = record.thinned_rows(ROWS);
    let mut clearances = vec![Vec::with_capacity(rows.len()); limits.len()];
    let mut depths = vec![Vec::with_capacity(rows.len()); rod.contacts.len()];
    for row in &rows {
        let coordinates = record.x.chunks_exact(3 * rod.n_nodes()).nth(*row)?;
        let positions = coordinates.chunks_exact(3).map(Vector3::from_column_slice);
        let trajectory = Trajectory {
            n_nodes: rod.n_nodes(),
            positions: positions.collect(),
            rotations: vec![Matrix3::identity(); rod.n_nodes()],
        };
        let rod_view = RodView {
            rod,
            radii,
            trajectory: &trajectory,
            grid: TimeGrid::instant(record.t[*row]),
        };
        for (own, depths) in rod.depths(&trajectory.positions).iter().zip(&mut depths) {
            depths.push(own.depth);
        }
        for ((_, limit), clearance) in limits.iter().zip(&mut clearances) {
            let (worst, _) = limit.worst(&rod_view, 0);
            clearance.push(-worst * limit.scale(rod));
        }
    }
    let bodies = (limits.into_iter().zip(clearances)).filter_map(|((name, limit), beyond)| {
        let PathLimit::Clearance {
            shape,
            velocity,
            margin,
            ..
        } = limit
        else {
            return None;
        };
        Some(ReportObstacle {
            name: name.into(),
            shape: drawn(&shape),
            velocity: velocity.into(),
            margin,
            clearance: beyond.iter().map(|c| (c + margin) as f32).collect(),
            is_touched: false,
        })
    });
    let touched = (rod.contacts.iter().zip(depths)).map(|(contact, depths)| ReportObstacle {
        name: contact.name.clone(),
        shape: drawn(&contact.shape),
        velocity: [0.0; 3],
        margin: 0.0,
        clearance: depths.iter().map(|depth| -depth as f32).collect(),
        is_touched: true,
    });
    Some(ReportObstacles {
        t: rows.iter().map(|&row| record.t[row]).collect(),
        bodies: bodies.chain(touched).collect(),
    })
}

fn drawn(shape: &Shape) -> ReportShape {
    match *shape {
        Shape::Sphere { center, radius } => ReportShape::Sphere {
            center: center.into(),
            radius,
        },
        Shape::Capsule { from, to, radius } => ReportShape::Capsule {
            from: from.into(),
            to: to.into(),
            radius,
        },
        Shape::HalfSpace { point, normal } => ReportShape::HalfSpace {
            point: point.into(),
            normal: normal.into(),
        },
        Shape::Cuboid {
            center,
            rotation,
            half_size,
        } => ReportShape::Box {
            center: center.into(),
            axes: directors(&rotation),
            half_size: half_size.into(),
        },
    }
}
