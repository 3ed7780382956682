//! Distances from bodies, for the check.

use nalgebra::Vector3;

use control::Shape;

/// Returns the signed distance of a point from a body, m.
pub(super) fn distance(shape: &Shape, x: &Vector3<f64>) -> f64 {
    match shape {
        Shape::Sphere { center, radius } => {
            nalgebra::distance(&(*x).into(), &(*center).into()) - radius
        }
        Shape::Capsule { from, to, radius } => {
            (x - nearest_on_segment(from, to, x)).norm() - radius
        }
        Shape::HalfSpace { point, normal } => normal.dot(x) - normal.dot(point),
        Shape::Cuboid {
            center,
            rotation,
            half_size,
        } => {
            let local = rotation.transpose() * (x - center);
            let nearest = nearest_in_box(&local, half_size);
            if nearest != local {
                return (local - nearest).norm();
            }
            let to_faces = (0..3).map(|i| half_size[i] - local[i].abs());
            -to_faces.fold(f64::INFINITY, f64::min)
        }
    }
}

/// Returns the direction in which a point leaves a body fastest: away from the nearest point, or to the nearest face.
pub(super) fn away(shape: &Shape, x: &Vector3<f64>) -> Vector3<f64> {
    match shape {
        Shape::Sphere { center, .. } => unit(&(x - center)),
        Shape::Capsule { from, to, .. } => unit(&(x - nearest_on_segment(from, to, x))),
        Shape::HalfSpace { normal, .. } => *normal,
        Shape::Cuboid {
            center,
            rotation,
            half_size,
        } => {
            let local = rotation.transpose() * (x - center);
            let nearest = nearest_in_box(&local, half_size);
            if nearest != local {
                return rotation * unit(&(local - nearest));
            }
            let axis = (half_size - local.abs()).imin();
            rotation * Vector3::ith(axis, local[axis].signum())
        }
    }
}

/// Returns the vector over its length; zero stays.
pub(super) fn unit(v: &Vector3<f64>) -> Vector3<f64> {
    v.try_normalize(0.0).unwrap_or_else(Vector3::zeros)
}

fn nearest_on_segment(from: &Vector3<f64>, to: &Vector3<f64>, x: &Vector3<f64>) -> Vector3<f64> {
    let axis = to - from;
    let square = axis.norm_squared();
    let s = if square > 0.0 {
        ((x - from).dot(&axis) / square).clamp(0.0, 1.0)
    } else {
        0.0
    };
    from + s * axis
}

/// In the frame of the box.
fn nearest_in_box(x: &Vector3<f64>, half_size: &Vector3<f64>) -> Vector3<f64> {
    x.zip_map(half_size, |x, half| x.clamp(-half, half))
}
