//! Small motions about an equilibrium: first frequencies of beams, the weight under which a column topples, and how fast.

use crate::common;

use common::published::frequencies::{ALL, frequencies};
use common::{MODELS, RULES, SILICONE, busy_arm, equilibrium, soft_arm, tip_load};
use nalgebra::{DMatrix, Vector3};
use softarm::mechanics::vibration::{TOPPLING_WEIGHT_NUMBER, weight_number};
use softarm::mechanics::{
    BaseCondition, LoadFrame, NodeInertia, NodeWrenches, Rod, RodParameters, RotaryInertia,
    Section, SectionProfile, SmallMotions, Stability, State, Stepper, StrainRule, stable_step,
};
use softarm::scene::Scene;

/// Of an arm so slender that shear and rotary inertia, which make an Euler-Bernoulli beam slower by `β² (1 + E/G) I/(2 A) = β² r²/2` or so,
/// change its frequencies by less than 1e-4.
const RADIUS: f64 = 0.003;

fn slender(n_elements: usize) -> RodParameters {
    let section = SectionProfile::Uniform(Section::circle(&SILICONE, RADIUS));
    RodParameters::straight(1.0, n_elements, section)
}

/// `ρA` and `EI` of the slender arm.
fn mass_and_bending() -> (f64, f64) {
    let section = Section::circle(&SILICONE, RADIUS);
    (section.mass, section.angular_stiffness.x)
}

fn first(parameters: &RodParameters) -> f64 {
    let rod = Rod::new(parameters).unwrap();
    (SmallMotions::about(&rod, &rod.rest, 0.0).first_frequency()).unwrap()
}

/// The values that a quantity has with `n`, `2 n` and `4 n` elements: it converges at second order, and the last one is within `tolerance` of
/// `exact`.
#[track_caller]
fn assert_converges(
    what: &str,
    value: impl Fn(usize) -> f64,
    n: usize,
    exact: f64,
    tolerance: f64,
) {
    let [a, b, c] = [n, 2 * n, 4 * n].map(value);
    let order = ((a - b) / (b - c)).log2();
    assert!((1.9..2.1).contains(&order), "{what}: order {order}");
    let error = c / exact - 1.0;
    assert!(error.abs() < tolerance, "{what}: {error:e}");
}

/// Relative error that a wave number `beta` of a beam of length 1 may leave with `n` elements: lumped inertia slows a bending wave by less
/// than `(β l)²/4`, and shear and rotary inertia by `β² r²/2`.
fn wave_error(beta: f64, n: usize) -> f64 {
    0.25 * (beta / n as f64).powi(2) + 0.5 * (beta * RADIUS).powi(2)
}

/// Smallest positive root of `f`, between `low` and `high`.
fn root(f: impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    assert!(f(low) * f(high) < 0.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if f(low) * f(middle) <= 0.0 {
            high = middle;
        } else {
            low = middle;
        }
    }
    0.5 * (low + high)
}

/// Clamped-free Euler-Bernoulli beams without and with a point mass at the tip, `1 + cos β cosh β + μ β (cos β sinh β - sin β cosh β) = 0`
/// with `ω = β² sqrt(EI/(ρA L⁴))`: second order in the length of the elements, and within `(β l)²/4`, as much as lumped inertia slows a
/// bending wave. The beam without a mass has `β² = 3.516`, also if its elements have two lengths, of which the longer
/// one is 1.05 times the mean.
#[test]
fn first_frequencies_of_cantilevers() {
    let (mass, bending) = mass_and_bending();
    let uneven = (0.0, vec![0.3]);
    let even = [0.0, 0.1, 1.0, 10.0].map(|ratio| (ratio, Vec::new()));
    for (ratio, breaks) in even.into_iter().chain([uneven]) {
        let characteristic = |b: f64| {
            let waves = b.cos() * b.sinh() - b.sin() * b.cosh();
            1.0 + b.cos() * b.cosh() + ratio * b * waves
        };
        let beta = root(characteristic, 0.1, 3.0);
        assert!(ratio > 0.0 || (beta * beta - 3.516).abs() < 1e-4);
        let exact = beta * beta * (bending / mass).sqrt();
        let found = |n: usize| {
            first(&RodParameters {
                payload: Some(NodeInertia {
                    mass: ratio * mass,
                    rotary: Vector3::zeros(),
                }),
                breaks: breaks.clone(),
                multiple: n / 6,
                ..slender(n)
            })
        };
        assert_converges(
            &format!("tip mass {ratio}, breaks {breaks:?}"),
            found,
            6,
            exact,
            wave_error(beta, 22),
        );
    }
}

/// The inertia of segments, `ρA l²/12` more about every axis, slows the first mode by a part of the order of `(β l)²/12`, which vanishes at
/// second order: the frequency converges to that of the beam, with steps that are as much longer as elements are slender.
#[test]
fn the_inertia_of_segments_vanishes_with_their_length() {
    let (mass, bending) = mass_and_bending();
    let beta = 1.875_104_f64;
    let exact = beta * beta * (bending / mass).sqrt();
    let with_segments = |n: usize| RodParameters {
        rotary_inertia: RotaryInertia::Segment,
        ..slender(n)
    };
    let found = |n: usize| first(&with_segments(n));
    let error = wave_error(beta, 24) + (beta / 24.0).powi(2) / 12.0;
    assert_converges("segments", found, 6, exact, error);
    let n = 12;
    let [sections, segments] =
        [slender(n), with_segments(n)].map(|parameters| Rod::new(&parameters).unwrap());
    let length = 1.0 / n as f64;
    let more = (mass * length) * length * length / 12.0;
    for (thin, thick) in sections.nodes[1..n].iter().zip(&segments.nodes[1..n]) {
        assert_eq!(thin.mass, thick.mass);
        assert!(
            ((thick.rotary - thin.rotary) / more)
                .add_scalar(-1.0)
                .amax()
                < 1e-9
        );
    }
    // Rotations of nodes limit the step by 2/sqrt(GA l/J) or so, and stretching by l/c, which is not touched.
    let ratio = stable_step(&segments) / stable_step(&sections);
    assert!(ratio > 5.0, "{ratio}");
}

/// A slender beam that is free at both ends swings at `4.73004² sqrt(EI/(ρA L⁴))`: its six rigid motions are no frequencies.
#[test]
fn first_frequency_of_a_free_beam() {
    let (mass, bending) = mass_and_bending();
    let exact = 4.730_041_f64.powi(2) * (bending / mass).sqrt();
    let found = |n: usize| {
        let base = BaseCondition::Free;
        first(&RodParameters { base, ..slender(n) })
    };
    assert_converges("free beam", found, 12, exact, wave_error(4.73, 48));
}

/// `β²` of a clamped circular beam whose radius falls linearly to `ratio` of that at the base, over `sqrt(E I₀/(ρ A₀ L⁴))`, by
/// Rayleigh and Ritz with the deflections `x², x³, …, x¹³`; the integrands are polynomials, summed by Gauss's rule on parts.
fn tapered_beam(ratio: f64) -> f64 {
    const TERMS: usize = 12;
    let radius = |x: f64| 1.0 - (1.0 - ratio) * x;
    let (mut k, mut m) = (DMatrix::zeros(TERMS, TERMS), DMatrix::zeros(TERMS, TERMS));
    let parts = 200;
    for part in 0..parts {
        for offset in [-0.6_f64.sqrt(), 0.0, 0.6_f64.sqrt()] {
            let x = (part as f64 + 0.5 + 0.5 * offset) / f64::from(parts);
            let weight = if offset == 0.0 { 4.0 / 9.0 } else { 5.0 / 18.0 } / f64::from(parts);
            for i in 0..TERMS {
                for j in 0..TERMS {
                    let (a, b) = (i as f64 + 2.0, j as f64 + 2.0);
                    let bent = a * (a - 1.0) * b * (b - 1.0) * x.powf(a + b - 4.0);
                    k[(i, j)] += weight * radius(x).powi(4) * bent;
                    m[(i, j)] += weight * radius(x).powi(2) * x.powf(a + b);
                }
            }
        }
    }
    // Powers are nearly dependent: the stiffness, the better conditioned, is factored, and the largest 1/ω² sought.
    let root = k.cholesky().unwrap().l();
    let half = root.solve_lower_triangular(&m).unwrap();
    let scaled = root.solve_lower_triangular(&half.transpose()).unwrap();
    let symmetric: DMatrix<f64> = (&scaled + scaled.transpose()) * 0.5;
    let largest = symmetric.symmetric_eigenvalues().max();
    1.0 / largest.sqrt()
}

/// Clamped beams whose radius tapers to half and to a fifth, against Rayleigh and Ritz, which themselves give the 3.516 of a uniform beam and
/// the 8.719 of a cone (Kirchhoff 1879). Second order in the length of the elements.
#[test]
fn first_frequencies_of_tapered_beams() {
    assert!((tapered_beam(1.0) - 3.516_015).abs() < 1e-5);
    assert!((tapered_beam(1e-9) / 8.719 - 1.0).abs() < 1e-3);
    let base = Section::circle(&SILICONE, RADIUS);
    let unit = (base.angular_stiffness.x / base.mass).sqrt();
    for ratio in [0.5, 0.2] {
        let square = tapered_beam(ratio);
        let found = |n: usize| {
            first(&RodParameters {
                section: SectionProfile::TaperedCircle {
                    material: SILICONE,
                    base_radius: RADIUS,
                    tip_radius: ratio * RADIUS,
                },
                ..slender(n)
            })
        };
        // The wave is the shorter the thinner the arm.
        let tolerance = wave_error((square / ratio).sqrt(), 48);
        assert_converges(
            &format!("taper {ratio}"),
            found,
            12,
            square * unit,
            tolerance,
        );
    }
}

/// Every mode of a rod with taper, rest curvature and payload, of each base and both rules, is that of the dense eigenvalue problem, to the
/// rounding of the largest.
#[test]
fn bisection_finds_every_mode() {
    for rule in RULES {
        for base in [BaseCondition::Clamped, BaseCondition::Free] {
            let rod = Rod::new(&RodParameters {
                base: base.clone(),
                loads: Vec::new(),
                distributed_loads: Vec::new(),
                ..busy_arm(rule, 7)
            })
            .unwrap();
            let dense = frequencies(&rod, ALL);
            let largest = dense.last().unwrap().powi(2);
            let motions = SmallMotions::about(&rod, &rod.rest, 0.0);
            for (mode, frequency) in dense.iter().enumerate() {
                let found = motions.squared_frequency(mode);
                assert!(
                    (found - frequency * frequency).abs() < 1e-12 * largest,
                    "{rule:?} {base:?} mode {mode}: {found} of {}",
                    frequency * frequency
                );
            }
            assert!(motions.squared_frequency(dense.len()).is_nan());
            assert_eq!(motions.growth_rate(), None);
        }
    }
}

/// The upright column of weight number `number`: base below, gravity against its direction.
fn column(n_elements: usize, number: f64) -> RodParameters {
    let (mass, bending) = mass_and_bending();
    RodParameters {
        gravity: Vector3::new(0.0, 0.0, -number * bending / mass),
        ..slender(n_elements)
    }
}

/// About its upright equilibrium.
fn upright(parameters: &RodParameters) -> SmallMotions {
    let (rod, shape) = equilibrium(parameters, 1);
    // The search must have stayed upright: only then the column's own stability is asked.
    assert!(shape.positions.iter().all(|x| x.xy().norm() < 1e-6));
    SmallMotions::about(&rod, &shape, 0.0)
}

/// A column topples under its own weight from `ρA g L³/EI = 7.837` on (Greenhill 1881), at second order in the length of the elements;
/// hanging, it never does, and its weight makes it swing faster.
#[test]
fn columns_topple_under_their_weight() {
    let rod = Rod::new(&column(12, 5.0)).unwrap();
    assert!((weight_number(&rod) - 5.0).abs() < 1e-12);
    let critical = |n: usize| {
        let topples = |number: f64| upright(&column(n, number)).growth_rate().is_some();
        root(|number| if topples(number) { 1.0 } else { -1.0 }, 6.0, 9.0)
    };
    assert_converges(
        "toppling",
        critical,
        10,
        TOPPLING_WEIGHT_NUMBER,
        wave_error(1.875, 40),
    );
    let frequency = |number| upright(&column(12, number)).first_frequency().unwrap();
    assert!(frequency(-20.0) > 1.5 * frequency(0.0));
    assert!(frequency(5.0) < 0.7 * frequency(0.0));
}

/// A clamped column that a dead force presses on its tip buckles at Euler's `π²/4 EI/L²`, at second order in the length of the elements.
#[test]
fn columns_buckle_under_a_force() {
    let (_, bending) = mass_and_bending();
    let euler = 0.25 * std::f64::consts::PI.powi(2) * bending;
    let critical = |n: usize| {
        let grows = |part: f64| {
            let force = [0.0, 0.0, -part * euler];
            let loads = tip_load(n, force, [0.0; 3], LoadFrame::Spatial);
            (upright(&RodParameters {
                loads,
                ..slender(n)
            })
            .growth_rate())
            .is_some()
        };
        root(|part| if grows(part) { 1.0 } else { -1.0 }, 0.8, 1.2)
    };
    let tolerance = wave_error(0.5 * std::f64::consts::PI, 24);
    assert_converges("buckling", critical, 6, 1.0, tolerance);
}

/// The rate of growth is that of the simulated column: with viscous damping, once the growing part leads, the tip's deflection grows
/// by `exp(s t)`. The explicit scheme with step h errs by `(s h)²/24`, the deflection's part that does not grow is below 1e-3 of it, and the
/// largest deflection, 1e-4 of the length, changes the rate by its square.
#[test]
fn columns_topple_at_the_computed_rate() {
    let parameters = RodParameters {
        viscous_damping: 0.7,
        // A short, thick arm, whose stable step is long.
        ..soft_arm(StrainRule::Helical, 8)
    };
    let unit = weight_number(
        &Rod::new(&RodParameters {
            gravity: Vector3::new(0.0, 0.0, -1.0),
            ..parameters.clone()
        })
        .unwrap(),
    );
    let parameters = RodParameters {
        gravity: Vector3::new(0.0, 0.0, -16.0 / unit),
        ..parameters
    };
    for model in MODELS {
        let (rod, shape) = equilibrium(
            &RodParameters {
                model,
                ..parameters.clone()
            },
            1,
        );
        let rate = SmallMotions::about(&rod, &shape, 0.0)
            .growth_rate()
            .unwrap();
        let step = 0.5 * stable_step(&rod);
        let mut state = State::at_rest(shape.clone());
        for (momentum, node) in state.linear_momentum.iter_mut().zip(&rod.nodes).skip(1) {
            momentum.x = 1e-9 * node.mass;
        }
        let mut integrator = Stepper::new(&rod, step, state);
        let mut deflection_after = |seconds: f64| {
            for _ in 0..(seconds / step).round() as usize {
                integrator.advance([NodeWrenches::NONE; 2]).unwrap();
            }
            integrator.state().configuration.positions[rod.tip()].x
        };
        let before = deflection_after(8.0 / rate);
        let span = 2.0 / rate;
        let grown = (deflection_after(span) / before).ln();
        let taken = (span / step).round() * step;
        assert!(before > 0.0 && before < 1e-4);
        assert!(
            (grown / (rate * taken) - 1.0).abs() < 2e-3,
            "{model:?}: {grown}"
        );
    }
}

/// A load that turns with the tip has no potential: the symmetric part of its stiffness is used, and no number of it is lost on the way.
#[test]
fn follower_loads_keep_the_frequencies_real() {
    let mut parameters = slender(10);
    parameters.loads = tip_load(10, [0.0, 0.0, -1e-3], [0.0; 3], LoadFrame::Body);
    let rod = Rod::new(&parameters).unwrap();
    let motions = SmallMotions::about(&rod, &rod.rest, 0.0);
    assert!(motions.squared_frequency(0).is_finite());
}

/// Viscous damping `c`: the velocity of a free arm that drifts and spins about its axis falls as `exp(-c t)`, and an arm of one element that
/// swings along its axis, a spring `EA/l` with the mass of its end, follows `A exp(-c t/2) (cos ω_d t + c/(2 ω_d) sin ω_d t)` with
/// `ω_d² = ω² - c²/4`: its amplitude falls half as fast. The scheme errs in the exponent by `(c h)²/12` and in the frequency by `(ω h)²/24`.
#[test]
fn viscous_damping_of_velocities_and_of_swings() {
    let c = 0.8;
    for rule in RULES {
        let damped = RodParameters {
            viscous_damping: c,
            ..soft_arm(rule, 1)
        };
        let free = Rod::new(&RodParameters {
            base: BaseCondition::Free,
            ..damped.clone()
        })
        .unwrap();
        let h = 0.2 * stable_step(&free);
        let (velocity, spin) = (Vector3::new(0.3, -0.2, 0.5), Vector3::new(0.0, 0.0, 2.0));
        let initial = free.rigid_motion(free.rest.clone(), &Vector3::zeros(), &velocity, &spin);
        let mut integrator = Stepper::new(&free, h, initial.clone());
        let n_steps = (3.0 / (c * h)) as usize;
        for _ in 0..n_steps {
            integrator.advance([NodeWrenches::NONE; 2]).unwrap();
        }
        let t = n_steps as f64 * h;
        let left = (-c * t).exp();
        let tolerance = 1.01 * (c * h).powi(2) / 12.0 * c * t;
        for (now, then) in [
            (
                &integrator.state().linear_momentum,
                &initial.linear_momentum,
            ),
            (
                &integrator.state().angular_momentum,
                &initial.angular_momentum,
            ),
        ] {
            for (now, then) in now.iter().zip(then) {
                let off = (now - then * left).norm();
                assert!(
                    off <= tolerance * left * then.norm(),
                    "{rule:?}: {:e} of {tolerance:e}",
                    off / (left * then.norm())
                );
            }
        }

        let rod = Rod::new(&damped).unwrap();
        let stiffness = rod.elements[0].linear_stiffness.z / rod.elements[0].length;
        let omega = (stiffness / rod.nodes[1].mass).sqrt();
        let swinging = (omega * omega - 0.25 * c * c).sqrt();
        let h = 0.01 / omega;
        let amplitude = 1e-3;
        let mut shape = rod.rest.clone();
        shape.positions[1].z += amplitude;
        let mut integrator = Stepper::new(&rod, h, State::at_rest(shape));
        let n_steps = (3.0 / (c * h)) as usize;
        for k in 1..=n_steps {
            integrator.advance([NodeWrenches::NONE; 2]).unwrap();
            let t = k as f64 * h;
            let (sine, cosine) = (swinging * t).sin_cos();
            let envelope = amplitude * (-0.5 * c * t).exp();
            let exact = envelope * (cosine + 0.5 * c / swinging * sine);
            let found = integrator.state().configuration.positions[1].z - rod.rest.positions[1].z;
            let phase = omega * t * (omega * h).powi(2) / 24.0;
            assert!(
                (found - exact).abs() < envelope * (1.5 * phase + 1e-9),
                "{rule:?}, t = {t}: {found} of {exact}"
            );
        }
    }
}

/// An arm of two segments that a force and a moment of its body bend at the tip, with viscous damping alone.
const BENT_BY_ITS_TIP: &str = "\
[rod]
length_m = 0.6
elements = 20
material = { youngs_modulus_pa = 8e5, poisson_ratio = 0.4, density_kg_m3 = 1070.0 }
section = { radius_m = 0.02 }
segment = [
  { fraction = 0.45 },
  { fraction = 0.55, section = { radius_m = 0.014 }, material = { youngs_modulus_pa = 1.4e6, poisson_ratio = 0.4, density_kg_m3 = 900.0 } },
]
[base]
direction = [1.0, 0.0, 0.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
viscous_1_s = 0.5
[initial]
shape = \"equilibrium\"
[time]
end_s = 4.0
integrator = \"explicit\"
[[load]]
node = \"tip\"
force_n = [0.05375989548328178, 0.4228507119957696, 0.3295652345169522]
[[load]]
node = \"tip\"
frame = \"body\"
moment_n_m = [0.01907314270989986, -0.08444698355052753, -0.06863240469061015]
";

/// A moment that turns with the tip feeds motions far above the first frequency, which the twelve slowest modes do not contain: growth rates
/// are those of an independent rod, 5.0 and 0.77 1/s on 20 and 40 elements, to the last digit that it gives.
#[test]
fn fast_motions_grow_under_a_moment_of_the_tip() {
    for (elements, independent, rounding) in [(20, 5.0, 0.05), (40, 0.77, 0.005)] {
        let overrides = [format!("rod.elements={elements}")];
        let (scene, source) = Scene::from_toml("scene.toml", BENT_BY_ITS_TIP, &overrides).unwrap();
        let setup = scene.simulation(&source).unwrap();
        let found = Stability::of(&setup.rod, &setup.initial.configuration, 0.0).unwrap();
        assert!(!found.is_stable && found.is_definite);
        let rate = found.growth_rate.expect("growth");
        assert!((rate - independent).abs() < rounding, "{elements}: {rate}");
    }
}
