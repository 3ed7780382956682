//! Measurements at the ends of what the rod can be asked: the tests bound them, `cargo bench --bench extremes` prints them.

use std::f64::consts::PI;

use nalgebra::{DVector, Matrix3, Vector3};
use softarm::mechanics::Stepper;
use softarm::mechanics::element::{Element, ElementPose, ElementStrain};
use softarm::mechanics::energy::{angular_momentum, linear_momentum};
use softarm::mechanics::forces::NodalForces;
use softarm::mechanics::rotation::{cay, exp, log, orthonormalized};
use softarm::mechanics::{
    BaseCondition, Energy, LoadFrame, Material, NodeInertia, NodeSpring, NodeWrenches, Rod,
    RodModel, RodParameters, Section, SectionProfile, State, StepError, StrainRule, stable_step,
    static_equilibrium,
};

use super::{Dice, busy_arm, random_state, soft_arm, stiffness, tip_load};

pub type Law = (StrainRule, RodModel);

fn rod_of(law: Law, parameters: RodParameters) -> Rod {
    Rod::new(&RodParameters {
        strain_rule: law.0,
        model: law.1,
        ..parameters
    })
    .unwrap()
}

fn free_arm(law: Law, n_elements: usize) -> Rod {
    rod_of(
        law,
        RodParameters {
            base: BaseCondition::Free,
            ..soft_arm(law.0, n_elements)
        },
    )
}

/// A rod with everything, in units whose meter, kilogram and second are `2^-length`, `2^-mass` and `2^-time` of ours.
fn in_other_units(law: Law, [length, mass, time]: [i32; 3]) -> Rod {
    let unit = |l: i32, m: i32, t: i32| 2f64.powi(l * length + m * mass + t * time);
    let (force, moment) = (unit(1, 1, -2), unit(2, 1, -2));
    let mut p = RodParameters {
        strain_rule: law.0,
        model: law.1,
        ..busy_arm(law.0, 5)
    };
    p.length *= unit(1, 0, 0);
    p.section = match p.section {
        SectionProfile::TaperedCircle {
            material,
            base_radius,
            tip_radius,
        } => SectionProfile::TaperedCircle {
            material: Material {
                youngs_modulus: material.youngs_modulus * unit(-1, 1, -2),
                shear_modulus: material.shear_modulus * unit(-1, 1, -2),
                density: material.density * unit(-3, 1, 0),
                ..material
            },
            base_radius: base_radius * unit(1, 0, 0),
            tip_radius: tip_radius * unit(1, 0, 0),
        },
        other => other,
    };
    p.rest_curvature *= unit(-1, 0, 0);
    p.gravity *= unit(1, 0, -2);
    p.viscous_damping *= unit(0, 0, -1);
    for load in &mut p.loads {
        load.force *= force;
        load.moment *= moment;
        load.profile
            .iter_mut()
            .for_each(|point| point.0 *= unit(0, 0, 1));
    }
    for load in &mut p.distributed_loads {
        load.force *= unit(0, 1, -2);
        load.moment *= force;
        load.profile
            .iter_mut()
            .for_each(|point| point.0 *= unit(0, 0, 1));
    }
    if let Some(payload) = &mut p.payload {
        payload.mass *= unit(0, 1, 0);
        payload.rotary *= unit(2, 1, 0);
    }
    Rod::new(&p).unwrap()
}

/// Whether 200 steps in other units are, to the last bit, those in ours; `mass` must be even, because of square roots.
pub fn same_in_other_units(law: Law, units: [i32; 3]) -> bool {
    let run = |units: [i32; 3]| {
        let rod = in_other_units(law, units);
        let rest = State::at_rest(rod.rest.clone());
        let mut integrator = Stepper::new(&rod, 0.5 * stable_step(&rod), rest);
        for _ in 0..200 {
            integrator.advance([NodeWrenches::NONE; 2]).unwrap();
        }
        integrator.state().clone()
    };
    let (here, there) = (run([0; 3]), run(units));
    let [length, mass, time] = units;
    let (position, momentum) = (2f64.powi(length), 2f64.powi(length + mass - time));
    let (here_at, there_at) = (&here.configuration, &there.configuration);
    let same = |here: &[Vector3<f64>], there: &[Vector3<f64>], unit: f64| {
        here.iter().zip(there).all(|(a, b)| a * unit == *b)
    };
    same(&here_at.positions, &there_at.positions, position)
        && here_at.rotations == there_at.rotations
        && same(&here.linear_momentum, &there.linear_momentum, momentum)
        && same(
            &here.angular_momentum,
            &there.angular_momentum,
            momentum * position,
        )
}

/// A round arm of length 1 m, density 1000 kg/m³, `G = E/3`.
fn arm(rule: StrainRule, n_elements: usize, radius: f64, youngs_modulus: f64) -> RodParameters {
    let material = Material::isotropic(youngs_modulus, 0.5, 1000.0);
    RodParameters {
        strain_rule: rule,
        section: SectionProfile::Uniform(Section::circle(&material, radius)),
        ..soft_arm(rule, n_elements)
    }
}

/// Helical arm under a tip moment that bends it to an arc of 1 rad: distance of the tip of its equilibrium from the
/// arc's, and how far it moves from there in 200 steps; both over the length.
pub fn arc_errors(
    model: RodModel,
    n_elements: usize,
    slenderness: f64,
    youngs_modulus: f64,
) -> [f64; 2] {
    let parameters = arm(
        StrainRule::Helical,
        n_elements,
        1.0 / slenderness,
        youngs_modulus,
    );
    let bending = parameters.section.at(0.0).angular_stiffness.x;
    let loads = tip_load(n_elements, [0.0; 3], [bending, 0.0, 0.0], LoadFrame::Body);
    let rod = Rod::new(&RodParameters {
        model,
        loads,
        ..parameters
    })
    .unwrap();
    let n = n_elements as f64;
    let mut arc = rod.rest.clone();
    for q in 0..rod.n_nodes() {
        let angle = q as f64 / n;
        arc.positions[q] = Vector3::new(0.0, angle.cos() - 1.0, angle.sin());
        arc.rotations[q] = exp(&Vector3::new(angle, 0.0, 0.0));
    }
    let tip = arc.positions[n_elements];
    let shape = static_equilibrium(&rod, &rod.rest, 0.0, &NodeSpring::default()).unwrap();
    let mut integrator = Stepper::new(&rod, 0.5 * stable_step(&rod), State::at_rest(arc));
    for _ in 0..200 {
        integrator.advance([NodeWrenches::NONE; 2]).unwrap();
    }
    [
        (shape.positions[n_elements] - tip).norm(),
        (integrator.state().configuration.positions[n_elements] - tip).norm(),
    ]
}

/// Trapezoidal arm under a small tip moment: rotation of the tip over that of a rod with `EI + GA l²/4`, less 1.
pub fn locked_bending_error(n_elements: usize, slenderness: f64, youngs_modulus: f64) -> f64 {
    let parameters = arm(
        StrainRule::Trapezoidal,
        n_elements,
        1.0 / slenderness,
        youngs_modulus,
    );
    let bending = parameters.section.at(0.0).angular_stiffness.x;
    let rod = Rod::new(&parameters).unwrap();
    let stiff = bending * (1.0 + rod.locking_ratio());
    let loads = tip_load(
        n_elements,
        [0.0; 3],
        [1e-3 * stiff, 0.0, 0.0],
        LoadFrame::Body,
    );
    let rod = Rod::new(&RodParameters {
        loads,
        ..parameters
    })
    .unwrap();
    let shape = static_equilibrium(&rod, &rod.rest, 0.0, &NodeSpring::default()).unwrap();
    log(&shape.rotations[n_elements]).x / 1e-3 - 1.0
}

/// Deflection of the tip after 300 steps under a lateral tip force, over the force, m/N.
pub fn compliance(law: Law, force: f64) -> Result<f64, StepError> {
    let rod = rod_of(
        law,
        RodParameters {
            loads: tip_load(8, [force, 0.0, 0.0], [0.0; 3], LoadFrame::Spatial),
            ..soft_arm(law.0, 8)
        },
    );
    let rest = State::at_rest(rod.rest.clone());
    let mut integrator = Stepper::new(&rod, 0.5 * stable_step(&rod), rest);
    for _ in 0..300 {
        integrator.advance([NodeWrenches::NONE; 2])?;
    }
    Ok(integrator.state().configuration.positions[8].x / force)
}

/// What stays and what does not over a run of a free rod.
#[derive(Clone, Copy, Debug)]
pub struct Drift {
    /// Change of the linear momentum over the sum of the nodes'.
    pub linear: f64,
    /// Change of the angular momentum over what the nodes' linear momenta make at the farthest node.
    pub angular: f64,
    /// Largest departure of the energy, relative.
    pub energy: f64,
    /// Largest `|RᵀR - I|`.
    pub rotation: f64,
}

/// How far the energy of a motion without loads may ripple under steps of `h`, J. In a mode of frequency `ω` the scheme keeps
/// `T + (1 - (ω h)²/4) V` exactly, so that the energy `T + V` departs from that of the start by no more than `(ω h)²/4` times its larger
/// part there; over all modes, `(h²/8) (f·M⁻¹ f + v·K v)` with the elastic forces `f` and the velocities `v` of the start.
pub fn energy_ripple(rod: &Rod, initial: &State, h: f64) -> f64 {
    let at = &initial.configuration;
    let mut forces = NodalForces::zeros(rod.n_nodes());
    forces.evaluate(rod, &at.positions, &at.rotations, 0.0);
    let k = stiffness(rod, at);
    let rotary = rod.rotary_at(&at.positions);
    let mut velocity = DVector::zeros(k.nrows());
    let mut sum = 0.0;
    for q in rod.first_free_node()..rod.n_nodes() {
        let (f, tau) = (&forces.forces[q], &forces.moments[q]);
        sum += f.norm_squared() / rod.nodes[q].mass + tau.dot(&tau.component_div(&rotary[q]));
        let v = initial.linear_momentum[q] / rod.nodes[q].mass;
        let omega = initial.angular_momentum[q].component_div(&rotary[q]);
        velocity.fixed_rows_mut::<3>(6 * q).copy_from(&v);
        velocity.fixed_rows_mut::<3>(6 * q + 3).copy_from(&omega);
    }
    h * h / 8.0 * (sum + velocity.dot(&(&k * &velocity)))
}

/// Runs a free rod from `initial` and compares.
pub fn drift(
    rod: &Rod,
    initial: State,
    time_step: f64,
    n_steps: usize,
) -> Result<Drift, StepError> {
    let (p, l) = (linear_momentum(&initial), angular_momentum(&initial));
    let energy = Energy::of(rod, &initial).total();
    let mut integrator = Stepper::new(rod, time_step, initial);
    let mut farthest: f64 = 0.0;
    let mut out = Drift {
        linear: 0.0,
        angular: 0.0,
        energy: 0.0,
        rotation: 0.0,
    };
    for k in 0..n_steps {
        integrator.advance([NodeWrenches::NONE; 2])?;
        if k % 16 == 0 || k + 1 == n_steps {
            let state = &integrator.state();
            for x in &state.configuration.positions {
                farthest = farthest.max(x.norm());
            }
            for r in &state.configuration.rotations {
                out.rotation = out.rotation.max(rotation_defect(r));
            }
            let now = Energy::of(rod, state).total();
            out.energy = out.energy.max((now / energy - 1.0).abs());
        }
    }
    let state = &integrator.state();
    let size: f64 = state.linear_momentum.iter().map(Vector3::norm).sum();
    out.linear = (linear_momentum(state) - p).norm() / size;
    out.angular = (angular_momentum(state) - l).norm() / (size * farthest);
    Ok(out)
}

/// `|RᵀR - I|`
pub fn rotation_defect(r: &Matrix3<f64>) -> f64 {
    (r.tr_mul(r) - Matrix3::identity()).norm()
}

/// `|RᵀR - I|` after `n` turns like those of an integrator, with nothing done about it.
pub fn unattended_defect(n: usize) -> f64 {
    let mut r = Matrix3::identity();
    let mut f = Vector3::new(0.03, -0.02, 0.05);
    for k in 0..n {
        f.x = 0.03 * ((k % 1000) as f64 * 0.01).sin();
        r *= cay(&f);
    }
    rotation_defect(&r)
}

/// A free rod whose masses and moments of inertia span `orders` orders of magnitude from node to node, geometrically.
pub fn uneven_rod(law: Law, orders: f64) -> Rod {
    let mut rod = free_arm(law, 6);
    for q in 0..rod.n_nodes() {
        let factor = 10f64.powf(orders * (q as f64 / 6.0 - 0.5));
        let heavier = |inertia: &mut NodeInertia| {
            inertia.mass *= factor;
            inertia.rotary *= factor;
        };
        heavier(&mut rod.nodes[q]);
        for element in [q.checked_sub(1), Some(q)].into_iter().flatten() {
            if element < rod.n_elements() {
                heavier(&mut rod.element_inertia[element][q - element]);
            }
        }
    }
    rod
}

/// 20 000 steps of a deformed [`uneven_rod`], from rest.
pub fn uneven_drift(law: Law, orders: f64) -> Result<Drift, StepError> {
    leaking_uneven_drift(law, orders, 0.0).map(|(drift, _)| drift)
}

/// The same, and the [ripple](energy_ripple) that the energy may have, relative to it; with viscous damping that takes `leak` times this
/// ripple from it by the end.
pub fn leaking_uneven_drift(law: Law, orders: f64, leak: f64) -> Result<(Drift, f64), StepError> {
    const STEPS: usize = 20_000;
    let mut rod = uneven_rod(law, orders);
    let initial = random_state(&rod, 0.05, 0.0, &mut Dice(3));
    let h = 0.5 * stable_step(&rod);
    let ripple = energy_ripple(&rod, &initial, h) / Energy::of(&rod, &initial).total();
    // The energy falls by `c E` a second, half of it being kinetic.
    rod.viscous_damping = leak * ripple / (STEPS as f64 * h);
    Ok((drift(&rod, initial, h, STEPS)?, ripple))
}

/// A free rod spun about its axis so that `h |π|` is `level` times the least inertia: largest strain-free error of the
/// angle after 100 steps, rad.
pub fn spin_error(rule: StrainRule, level: f64) -> Result<f64, StepError> {
    let rod = free_arm((rule, RodModel::Standard), 3);
    let h = 0.5 * stable_step(&rod);
    let mut initial = State::at_rest(rod.rest.clone());
    for (momentum, node) in initial.angular_momentum.iter_mut().zip(&rod.nodes) {
        momentum.z = level * node.rotary.min() / h;
    }
    // (1/h) vee(F J_d - J_d Fᵀ) = J sin(θ)/h about a principal axis
    let angle = (level * rod.nodes[0].rotary.min() / rod.nodes[0].rotary.z).asin();
    let mut integrator = Stepper::new(&rod, h, initial);
    for _ in 0..100 {
        integrator.advance([NodeWrenches::NONE; 2])?;
    }
    let expected = exp(&Vector3::new(0.0, 0.0, (100.0 * angle) % (2.0 * PI)));
    let state = integrator.state();
    let errors = (state.configuration.rotations.iter()).map(|r| (r - expected).norm());
    Ok(errors.fold(0.0, f64::max))
}

/// One element of unit length and stiffness whose ends are turned by `π - gap` against each other: relative error of its
/// energy against the closed form.
pub fn half_turn_error(rule: StrainRule, gap: f64) -> f64 {
    let element = Element {
        model: RodModel::Standard,
        length: 1.0,
        linear_stiffness: Vector3::repeat(1.0),
        angular_stiffness: Vector3::repeat(1.0),
        rest: ElementStrain {
            linear: [Vector3::z(); 2],
            curvature: Vector3::zeros(),
        },
    };
    let angle = PI - gap;
    let half = 0.5 * angle;
    let (rotation_a, rotation_b) = (
        exp(&Vector3::new(-half, 0.0, 0.0)),
        exp(&Vector3::new(half, 0.0, 0.0)),
    );
    // The chord of the arc under the helical rule; of unit length under the other.
    let (chord, expected) = match rule {
        StrainRule::Helical => (half.sin() / half, 0.5 * angle * angle),
        StrainRule::Trapezoidal => {
            let psi = 2.0 / (0.5 * gap).tan();
            let (sine, cosine) = half.sin_cos();
            (
                1.0,
                0.5 * psi * psi + 0.5 * (sine * sine + (1.0 - cosine) * (1.0 - cosine)),
            )
        }
    };
    let pose = ElementPose {
        dx: Vector3::new(0.0, 0.0, chord),
        rotation_a: &rotation_a,
        rotation_b: &rotation_b,
    };
    element.energy(rule, &pose) / expected - 1.0
}

/// Two nodes thrown against each other with `excess` times the bending energy of half a turn: how the run ends, and the
/// largest relative departure of the energy before.
pub fn fold(law: Law, excess: f64) -> (Option<StepError>, f64) {
    let section = Section {
        linear_stiffness: Vector3::repeat(10.0),
        angular_stiffness: Vector3::repeat(1e-2),
        mass: 1.0,
        rotary: Vector3::repeat(1.0),
    };
    let rod = rod_of(
        law,
        RodParameters {
            base: BaseCondition::Free,
            ..RodParameters::straight(1.0, 1, SectionProfile::Uniform(section))
        },
    );
    let mut initial = State::at_rest(rod.rest.clone());
    let rate = PI * (excess * 0.5 * 1e-2 / 0.5).sqrt();
    for (momentum, sign) in initial.angular_momentum.iter_mut().zip([-1.0, 1.0]) {
        momentum.x = sign * 0.5 * rate;
    }
    let energy = Energy::of(&rod, &initial).total();
    let mut integrator = Stepper::new(&rod, 0.02 * stable_step(&rod), initial);
    let mut worst: f64 = 0.0;
    for _ in 0..20_000 {
        if let Err(error) = integrator.advance([NodeWrenches::NONE; 2]) {
            return (Some(error), worst);
        }
        let now = Energy::of(&rod, &integrator.state()).total();
        worst = worst.max((now / energy - 1.0).abs());
    }
    (None, worst)
}

/// How far an element went.
#[derive(Clone, Copy, Debug)]
pub struct Stretch {
    /// Largest relative departure of the energy.
    pub energy: f64,
    /// Least dilatation.
    pub least: f64,
    /// Largest dilatation.
    pub largest: f64,
}

/// One clamped element released from rest at dilatation `start`, over `n_steps` of `fraction` of the stable step.
pub fn release(law: Law, start: f64, fraction: f64, n_steps: usize) -> Result<Stretch, StepError> {
    let rod = rod_of(law, soft_arm(law.0, 1));
    let mut initial = State::at_rest(rod.rest.clone());
    initial.configuration.positions[1] *= start;
    let energy = Energy::of(&rod, &initial).total();
    let mut integrator = Stepper::new(&rod, fraction * stable_step(&rod), initial);
    let mut out = Stretch {
        energy: 0.0,
        least: start,
        largest: start,
    };
    for _ in 0..n_steps {
        integrator.advance([NodeWrenches::NONE; 2])?;
        let state = &integrator.state();
        let e = rod.dilatation(&state.configuration.positions)[0];
        out.least = out.least.min(e);
        out.largest = out.largest.max(e);
        out.energy = out
            .energy
            .max((Energy::of(&rod, state).total() / energy - 1.0).abs());
    }
    Ok(out)
}

/// `2/ω_max` of the assembled rod about its rest shape, s.
pub fn assembled_limit(rod: &Rod) -> f64 {
    let k = stiffness(rod, &rod.rest);
    let first = 6 * rod.first_free_node();
    let inverse_root = |i: usize| {
        let node = &rod.nodes[i / 6];
        let inertia = if i % 6 < 3 {
            node.mass
        } else {
            node.rotary[i % 6 - 3]
        };
        1.0 / inertia.sqrt()
    };
    let n = k.nrows() - first;
    let scaled = nalgebra::DMatrix::from_fn(n, n, |i, j| {
        let (i, j) = (i + first, j + first);
        0.5 * (k[(i, j)] + k[(j, i)]) * inverse_root(i) * inverse_root(j)
    });
    2.0 / scaled.symmetric_eigenvalues().max().sqrt()
}

/// A soft arm disturbed by 1e-9, with steps of `fraction` of [`assembled_limit`]: growth of its energy, and the error that
/// ended it, if one did.
pub fn growth(law: Law, fraction: f64, n_steps: usize) -> (f64, Option<StepError>) {
    let rod = rod_of(law, soft_arm(law.0, 6));
    let initial = random_state(&rod, 1e-9, 0.0, &mut Dice(41));
    let energy = Energy::of(&rod, &initial).total();
    let mut integrator = Stepper::new(&rod, fraction * assembled_limit(&rod), initial);
    let mut largest: f64 = 1.0;
    for _ in 0..n_steps {
        if let Err(error) = integrator.advance([NodeWrenches::NONE; 2]) {
            return (largest, Some(error));
        }
        largest = largest.max(Energy::of(&rod, &integrator.state()).total() / energy);
    }
    (largest, None)
}

/// Change of the elastic energy of a deformed arm under a rigid turn, relative.
pub fn objectivity_error(law: Law, angle: f64) -> f64 {
    let mut dice = Dice(31);
    let rod = rod_of(law, soft_arm(law.0, 12));
    let here = random_state(&rod, 0.3, 0.0, &mut dice).configuration;
    let turn = exp(&(Vector3::new(0.3, -0.8, 0.5).normalize() * angle));
    let positions: Vec<_> = here.positions.iter().map(|x| turn * x).collect();
    let rotations: Vec<_> = here.rotations.iter().map(|r| turn * r).collect();
    let energy = |positions: &[_], rotations: &[_]| rod.elastic_energy(positions, rotations);
    energy(&positions, &rotations) / energy(&here.positions, &here.rotations) - 1.0
}

/// Relative change of energy and of the angular momentum's size when the rotations of a state with defects of 1e-14 are
/// made orthogonal again.
pub fn orthonormalization_effect(law: Law) -> [f64; 2] {
    let mut dice = Dice(5);
    let rod = free_arm(law, 6);
    let mut state = random_state(&rod, 0.1, 0.5, &mut dice);
    for r in &mut state.configuration.rotations {
        *r += Matrix3::from_columns(&[(); 3].map(|()| dice.vector(1e-14)));
    }
    let of = |state: &State| (Energy::of(&rod, state).total(), angular_momentum(state));
    let before = of(&state);
    for r in &mut state.configuration.rotations {
        *r = orthonormalized(r);
    }
    let after = of(&state);
    [
        (after.0 / before.0 - 1.0).abs(),
        (after.1 - before.1).norm() / before.1.norm(),
    ]
}
