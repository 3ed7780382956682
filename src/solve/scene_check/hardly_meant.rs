//! Values of a scene that can be computed with but are probably mistakes: of a unit, or by a power of ten.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector3;

use crate::mechanics::Rod;
use crate::scene::{LoadKeys, Scene};

/// Turns of a rod under a moment above which the moment is probably a mistake.
const MANY_TURNS: f64 = 20.0;
/// Stretch of a rod under a force above which rod models are not valid.
const LARGE_STRAIN: f64 = 0.3;
/// Distance of an actuator from the axis, in radii, above which the arm is a backbone with disks.
const ON_DISKS: f64 = 3.0;

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
    out.extend(scene.far_aside());
    out.extend(beside_section(scene));
    out
}

/// Describes actuators beside the section, where it is not so small that disks carry them, and chambers larger than it.
fn beside_section(scene: &Scene) -> Vec<String> {
    let radii = scene.radii();
    let Some(thickest) = radii.iter().map(|(_, radius)| *radius).reduce(f64::max) else {
        return Vec::new();
    };
    // Radius at a fraction of the length; segments have two rows where they meet, of which the larger counts.
    let at = |s: f64| {
        let mut found = 0.0f64;
        for pair in radii.windows(2) {
            let [(a, ra), (b, rb)] = [pair[0], pair[1]];
            if (a..=b).contains(&s) {
                let part = if b > a { (s - a) / (b - a) } else { 0.0 };
                found = found.max(ra + part * (rb - ra));
            }
        }
        if found > 0.0 { found } else { thickest }
    };
    let mut out = Vec::new();
    for (key, routes) in scene.routes() {
        let ends =
            (routes.iter()).flat_map(|own| [(own.from, own.offset_from), (own.to, own.offset_to)]);
        let beyond = ends.map(|(s, [x, y])| x.hypot(y) / at(s));
        let most = beyond.fold(0.0, f64::max);
        if most > 1.0 && most <= ON_DISKS {
            out.push(format!(
                "{key}.offset_m: lies outside of the section, at {most:.2} of its radius: right for disks on a backbone, and hardly for a cast arm"
            ));
        }
    }
    for (index, chamber) in scene.chamber.iter().enumerate() {
        let (area, section) = (chamber.area_m2.get(), PI * thickest * thickest);
        if area > section {
            out.push(format!(
                "chamber.{index}.area_m2: {area:.3e} m2 is more than the section of the arm has, {section:.3e} m2; look for a unit that was mistaken"
            ));
        }
    }
    out
}

/// Describes the effect of a load on the arm if it exceeds the plausible range.
fn heavy(index: usize, load: &LoadKeys, rod: &Rod) -> Option<String> {
    let factors = load.profile.iter().map(|(_, factor)| factor.abs());
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
