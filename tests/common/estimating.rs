//! Arms that estimators are tried on, and the truth that they are to find.

use nalgebra::{Matrix3, Vector3};
use softarm::mechanics::forms::NODE_COMPONENTS;
use softarm::mechanics::linearization::StateTangent;
use softarm::mechanics::rotation::exp;
use softarm::mechanics::stability::automatic_step;
use softarm::mechanics::{Material, NodeSpring, Rod, State, Wrench, static_equilibrium};
use softarm::mpc::{Command, Disturbance, KalmanSettings, Predictor, RandomWalk, Unknown};
use softarm::task::{Arm, Discretization};

use crate::commands::of_wrenches;

/// Weightless, upright, 1 m long, of a soft silicone, E = 1 MPa.
pub fn upright() -> Arm {
    Arm {
        gravity: Vector3::zeros(),
        viscous_damping: 1.0,
        ..Arm::cylinder(&Material::isotropic(1e6, 0.5, 1000.0), 1.0, 0.05)
    }
}

/// Hanging, 30 cm long, of a silicone of E = 0.6 MPa.
pub fn hanging() -> Arm {
    Arm {
        gravity: Vector3::new(0.0, 0.0, -9.81),
        base_rotation: Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)),
        viscous_damping: 1.0,
        ..Arm::cylinder(&Material::isotropic(6e5, 0.5, 1070.0), 0.3, 0.015)
    }
}

pub fn rod(arm: &Arm, elements: usize) -> Rod {
    arm.rod(&Discretization::with_elements(elements)).unwrap()
}

/// A force and a moment on the tip that swing the arm about, over one sample period.
pub fn command(model: &Rod, start: f64, period: f64) -> Command {
    let at = |t: f64| {
        let force = model.scales.force;
        let swing = |frequency: f64, phase: f64| (frequency * t / model.scales.time + phase).sin();
        Wrench {
            force: Vector3::new(1.5 * swing(3.0, 0.0), 1.2 * swing(2.2, 0.6), 0.0) * force,
            moment: Vector3::new(0.0, 0.5 * swing(7.0, 0.0), 0.2 * swing(5.0, 0.3))
                * (force * model.scales.length),
        }
    };
    let end = start + period;
    of_wrenches(&[model.tip()], [start, end], [&[at(start)], &[at(end)]])
}

/// The true motion of a plant under commands to the tip of another rod.
pub struct Truth {
    pub time: f64,
    pub state: State,
    pub disturbance: Disturbance,
    tip: usize,
    predictor: Predictor,
}

impl Truth {
    pub fn new(plant: &Rod, state: State, disturbance: Disturbance) -> Self {
        Self {
            time: 0.0,
            state,
            disturbance,
            tip: plant.tip(),
            predictor: Predictor::new(plant, automatic_step(plant)),
        }
    }

    pub fn advance(&mut self, command: &Command, until: f64) {
        let [from, to] =
            [false, true].map(|at_end| [command.wrench_on(command.nodes()[0], at_end)]);
        let command = of_wrenches(&[self.tip], [command.start, command.end], [&from, &to]);
        let span = [self.time, until];
        (self.predictor)
            .advance(&mut self.state, span, &command, &self.disturbance)
            .unwrap();
        self.time = until;
    }
}

/// A number from the standard normal distribution.
pub fn normal(dice: &mut fastrand::Rng) -> f64 {
    let radius = (-2.0 * (1.0 - dice.f64()).ln()).sqrt();
    radius * (std::f64::consts::TAU * dice.f64()).cos()
}

/// In equilibrium with its loads.
pub fn at_rest(rod: &Rod) -> State {
    State::at_rest(static_equilibrium(rod, &rod.rest, 0.0, &NodeSpring::default()).unwrap())
}

/// A bent, twisted, sheared and moving state.
pub fn moving(rod: &Rod, seed: u64) -> State {
    let mut dice = fastrand::Rng::with_seed(seed);
    let mut state = State::at_rest(rod.rest.clone());
    let mut vector = |size: f64| Vector3::from_fn(|_, _| size * (2.0 * dice.f64() - 1.0));
    let first = rod.first_free_node();
    for q in first..rod.n_nodes() {
        let at = &mut state.configuration;
        let l = rod.elements[q - 1].length;
        let turn = if q > 0 {
            at.rotations[q - 1]
        } else {
            at.rotations[0]
        };
        at.rotations[q] = turn * exp(&vector(0.7));
        at.positions[q] = at.positions[q - 1] + turn * (Vector3::z() + vector(0.2)) * l;
        state.linear_momentum[q] = vector(1.0) * rod.nodes[q].mass;
        state.angular_momentum[q] = vector(3.0).component_mul(&rod.nodes[q].rotary);
    }
    state
}

/// A unit of one component of the error.
pub fn unit(rod: &Rod, component: usize, size: f64) -> StateTangent {
    let mut out = StateTangent::zeros(rod.n_nodes());
    let node = rod.first_free_node() + component / NODE_COMPONENTS;
    let part = component % NODE_COMPONENTS;
    let vector = Vector3::ith(part % 3, size);
    match part / 3 {
        0 => out.positions[node] = vector,
        1 => out.rotations[node] = vector,
        2 => out.linear[node] = vector,
        _ => out.angular[node] = vector,
    }
    out
}

/// A size of each component at which a state changes by a fraction of it that differences can be taken over.
pub fn scale(rod: &Rod, component: usize) -> f64 {
    let node = &rod.nodes[rod.first_free_node() + component / NODE_COMPONENTS];
    let scales = &rod.scales;
    match component % NODE_COMPONENTS {
        0..3 => rod.elements[0].length,
        3..6 => 1.0,
        6..9 => node.mass * scales.length / scales.time,
        part => node.rotary[part - 9] / scales.time,
    }
}

pub fn walk(initial: f64, change: f64) -> RandomWalk {
    RandomWalk { initial, change }
}

/// Estimates everything there is.
pub fn all_disturbances(model: &Rod) -> KalmanSettings {
    let force = model.scales.force;
    let (length, time, mass) = (model.scales.length, model.scales.time, model.mass());
    KalmanSettings::of(model)
        .with(Unknown::TipForce, walk(0.1 * force, 0.01 * force))
        .with(Unknown::TipMoment, walk(0.02 * model.scales.moment, 0.0))
        .with(Unknown::Distributed, walk(0.1 * force / length, 0.0))
        .with(Unknown::Stiffness, walk(0.1, 0.01))
        .with(Unknown::Payload, walk(0.1 * mass, 0.01 * mass))
        .with(Unknown::Viscous, walk(0.5 / time, 0.05 / time))
}
