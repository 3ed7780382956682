//! Values of a scene that can be computed with but are probably mistakes: of a unit, or by a power of ten.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use crate::mechanics::{Rod, Route};
use crate::scene::{Load, Scene};

/// Turns of a rod under a moment above which the moment is probably a mistake.
const MANY_TURNS: f64 = 20.0;
/// Stretch of a rod under a force above which rod models are not valid.
const LARGE_STRAIN: f64 = 0.3;
/// Distance of an actuator from the axis, in lengths of the arm, above which it is probably a mistake.
const FAR_ASIDE: f64 = 0.25;

/// A value, the range of real values, and the names of the range's ends.
struct Figure {
    key: &'static str,
    value: f64,
    unit: &'static str,
    range: [f64; 2],
    of: &'static str,
}

/// Returns warnings about moduli, densities, sizes, weights and loads that are powers of ten away from those of real arms.
pub(super) fn hardly_meant(scene: &Scene, rod: &Rod) -> Vec<String> {
    let material = scene.rod.material.as_ref();
    let modulus = material.and_then(|material| material.youngs_modulus());
    let density = material.and_then(|material| material.density());
    let length = rod.scales.length;
    let radii = || scene.radii().into_iter().map(|(_, radius)| radius);
    let [thinnest, thickest] = match scene.rod.has_material() {
        true => [f64::min, f64::max].map(|of| radii().reduce(of).unwrap_or(f64::NAN)),
        false => [f64::NAN; 2],
    };
    let figures = [
        Figure {
            key: "rod.material.youngs_modulus_pa",
            value: modulus.unwrap_or(f64::NAN),
            unit: "Pa",
            range: [1e3, 1.3e12],
            of: "the softest gels and diamond",
        },
        Figure {
            key: "rod.material.density_kg_m3",
            value: density.unwrap_or(f64::NAN),
            unit: "kg/m3",
            range: [5.0, 23_000.0],
            of: "foams and osmium",
        },
        Figure {
            key: "rod.length_m",
            value: length,
            unit: "m",
            range: [1e-4, 1e3],
            of: "a hair's breadth and a mooring line",
        },
        Figure {
            key: "rod.section",
            value: thinnest,
            unit: "m of radius",
            range: [1e-6, f64::INFINITY],
            of: "a thread of a spider and more",
        },
        Figure {
            key: "rod.section",
            value: thickest / length,
            unit: "(radius over length)",
            range: [0.0, 0.25],
            of: "a thread and the thickest arm that is still a rod",
        },
        Figure {
            key: "rod",
            value: rod.mass(),
            unit: "kg with its payload",
            range: [1e-9, 1e5],
            of: "an eyelash and a locomotive",
        },
        Figure {
            key: "gravity.acceleration_m_s2",
            value: rod.gravity.norm(),
            unit: "m/s2",
            range: [0.0, 100.0],
            of: "no weight and ten times that on earth",
        },
    ];
    let mut out: Vec<String> = (figures.iter())
        .filter(|figure| figure.value < figure.range[0] || figure.value > figure.range[1])
        .map(|figure| {
            format!(
                "{}: {:.3e} {} is hardly meant ({:e} to {:e}: {}); look for a unit that was mistaken",
                figure.key, figure.value, figure.unit, figure.range[0], figure.range[1], figure.of
            )
        })
        .collect();
    let loads = (scene.load.iter().enumerate()).filter_map(|(index, load)| heavy(index, load, rod));
    out.extend(loads);
    let routes = scene.routes();
    out.extend(routes.filter_map(|(key, route)| far_aside(&key, &route, length)));
    out
}

/// Describes an actuator that is too far from the axis of an arm of this length, m.
fn far_aside(key: &str, route: &Route, length: f64) -> Option<String> {
    let [from, to] = [route.offset_from, route.offset_to].map(|[x, y]| x.hypot(y));
    let far = from.max(to) / length;
    (far > FAR_ASIDE).then(|| {
        format!(
            "{key}.offset_m: {far:.3e} lengths of the arm beside its axis are hardly meant (at most {FAR_ASIDE}); look for a unit that was \
             mistaken"
        )
    })
}

/// Describes the effect of a load on the arm if it exceeds the plausible range.
fn heavy(index: usize, load: &Load, rod: &Rod) -> Option<String> {
    let factors = load
        .profile
        .iter()
        .flatten()
        .map(|[_, factor]| factor.abs());
    let factor = factors.reduce(f64::max).unwrap_or(1.0);
    let [force, moment] = [load.force_n, load.moment_n_m].map(|v| factor * Vector3::from(v).norm());
    let turns = moment / rod.scales.moment / TAU;
    if turns > MANY_TURNS {
        return Some(format!(
            "load.{index}.moment_n_m: {moment:.3e} N m is {:.3e} EI/L, which winds this arm up {turns:.0} times; look for a unit that was mistaken",
            moment / rod.scales.moment
        ));
    }
    let stiffness = (rod.elements.iter())
        .map(|element| element.linear_stiffness.min())
        .fold(f64::INFINITY, f64::min);
    let strain = force / stiffness;
    (strain > LARGE_STRAIN).then(|| {
        format!(
            "load.{index}.force_n: {force:.3e} N stretches or shears this arm by {:.0} %, and rod models hold up to about 30 %; look for a unit that \
             was mistaken",
            100.0 * strain
        )
    })
}
