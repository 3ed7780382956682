//! What a motion looks like from outside: momenta, strains, internal forces, the reaction at the base, and balances.
//!
//! Three balances hold over a step of length `h` from `k` to `k+1`, with the external wrench (gravity, loads and the
//! reaction at a clamped base) at the time nodes and the damping wrench of the step, moments about the origin:
//!
//! ```text
//! P⁺ - P = h/2 (F + F⁺) + h F_damping       exactly: elastic forces come in pairs
//! L⁺ - L = h/2 (M + M⁺) + h M_damping       exactly: the elastic energy does not feel a rigid rotation
//! E⁺ - E = h (external - dissipated power)  to second order in h
//! ```
//!
//! The first two are the sums of the steps of the [integrator](super::integrator) over the nodes: the half kicks act
//! where the node is, and a drift keeps `x × p½` and `R g`. With a driven base they hold to second order in `h`. Where the inertia follows the dilatation, its kinetic reaction
//! and its own time derivative are not part of the wrenches here, and the balances hold only as far as these are small.

use nalgebra::Vector3;

use super::base_motion::BaseState;
use super::configuration::{Configuration, State};
use super::constitutive::RodModel;
use super::energy::{Energy, angular_momentum, linear_momentum};
use super::forces::NodalForces;
use super::load::Wrench;
use super::rod::{BaseCondition, Rod};
use super::strain::{Element, ElementPose, StrainRule};

/// Force and moment on the whole rod, both spatial, the moment about the origin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TotalWrench {
    /// N.
    pub force: Vector3<f64>,
    /// N m.
    pub moment: Vector3<f64>,
}

impl TotalWrench {
    /// Adds the force `force` and the moment `moment` (body frame) of a node of the rod.
    fn add(&mut self, state: &State, node: usize, force: &Vector3<f64>, moment: &Vector3<f64>) {
        let configuration = &state.configuration;
        self.force += force;
        self.moment +=
            configuration.positions[node].cross(force) + configuration.rotations[node] * moment;
    }
}

/// Strain and stress of one element, both relative to its stress-free shape, in its body frame (see
/// [`Element::stress`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ElementStress {
    /// `ε = v - v_rest`, the mean of both ends.
    pub linear_strain: Vector3<f64>,
    /// `κ = ψ/l - κ_rest`, 1/m.
    pub angular_strain: Vector3<f64>,
    /// `n`, N: positive third component, tension.
    pub force: Vector3<f64>,
    /// `m`, N m.
    pub moment: Vector3<f64>,
}

impl ElementStress {
    /// Of an element in the pose `pose`.
    #[must_use]
    pub fn of(element: &Element, rule: StrainRule, pose: &ElementPose) -> Self {
        let strain = rule.strain(element.length, pose);
        let rest = &element.rest;
        let ends = [0, 1].map(|end| strain.linear[end] - rest.linear[end]);
        let (force, moment) = element.stress(rule, pose);
        Self {
            linear_strain: 0.5 * (ends[0] + ends[1]),
            angular_strain: strain.curvature - rest.curvature,
            force,
            moment,
        }
    }
}

/// Power in and out over one step, W.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PowerBalance {
    /// Of the loads and of what drives the base, `Σ f·v + τ·ω`, the mean of both ends of the step. Gravity counts as energy.
    pub external: f64,
    /// Taken by damping: `c Σ |p|²/m + π·J⁻¹π`, the mean of both ends, and `τ Σ l ṡ·C ṡ` with the step's own rate of strain.
    pub dissipated: f64,
    /// Change of the energy over the step, divided by its length.
    pub energy_rate: f64,
    /// `energy_rate - external + dissipated`: falls with the square of the step.
    pub residual: f64,
}

impl PowerBalance {
    /// Over the step of length `time_step` that ends at time `t`.
    #[must_use]
    pub fn over_step(rod: &Rod, time_step: f64, t: f64, before: &State, after: &State) -> Self {
        let ends = [(t - time_step, before), (t, after)];
        let mean = |power: &dyn Fn(f64, &State) -> f64| -> f64 {
            ends.iter().map(|(t, state)| 0.5 * power(*t, state)).sum()
        };
        let external =
            mean(&|t, state| load_power(rod, t, state) + base_power(rod, time_step, t, state));
        let energies = ends.map(|(_, state)| Energy::of(rod, state));
        let viscous: f64 = energies
            .iter()
            .map(|energy| rod.viscous_damping * energy.kinetic)
            .sum();
        let [start, end] = [&before.configuration, &after.configuration];
        let dissipated = viscous + rod.internal_dissipation(time_step, start, end);
        let energy_rate = (energies[1].total() - energies[0].total()) / time_step;
        Self {
            external,
            dissipated,
            energy_rate,
            residual: energy_rate - external + dissipated,
        }
    }
}

/// The wrench that holds or drives node 0, on which `net` acts otherwise: `ṗ + c p - f`, and `Rᵀ d(R π)/dt + c π - τ`.
/// The rates of a driven base are central differences over `2 h`, one-sided at the start.
fn reaction(rod: &Rod, time_step: f64, t: f64, state: &State, net: &NodalForces) -> Wrench {
    if rod.base == BaseCondition::Free {
        return Wrench::default();
    }
    let c = rod.viscous_damping;
    let mut wrench = Wrench {
        force: c * state.linear_momentum[0] - net.forces[0],
        moment: c * state.angular_momentum[0] - net.moments[0],
    };
    let (from, to) = ((t - time_step).max(0.0), t + time_step);
    if let (Some(before), Some(after)) = (rod.driven_base(from), rod.driven_base(to)) {
        let rotary = rod.rotary_at(&state.configuration.positions)[0];
        let spin = |base: &BaseState| base.rotation * rotary.component_mul(&base.angular_velocity);
        let acceleration = (after.velocity - before.velocity) / (to - from);
        wrench.force += rod.nodes[0].mass * acceleration;
        let rate = (spin(&after) - spin(&before)) / (to - from);
        wrench.moment += state.configuration.rotations[0].tr_mul(&rate);
    }
    wrench
}

/// `Σ f·v + τ·ω` of what drives the base, W.
fn base_power(rod: &Rod, time_step: f64, t: f64, state: &State) -> f64 {
    let Some(base) = rod.driven_base(t) else {
        return 0.0;
    };
    let Configuration {
        positions,
        rotations,
    } = &state.configuration;
    let mut net = NodalForces::zeros(rod.n_nodes());
    net.evaluate(rod, positions, rotations, t);
    let wrench = reaction(rod, time_step, t, state, &net);
    wrench.force.dot(&base.velocity) + wrench.moment.dot(&base.angular_velocity)
}

/// `Σ f·v + τ·ω` of the loads, W.
fn load_power(rod: &Rod, t: f64, state: &State) -> f64 {
    let rotary = rod.rotary_at(&state.configuration.positions);
    rod.loads
        .iter()
        .map(|load| {
            let q = load.node;
            let wrench = load.wrench(t, &state.configuration.rotations[q]);
            let velocity = state.linear_momentum[q] / rod.nodes[q].mass;
            let spin = state.angular_momentum[q].component_div(&rotary[q]);
            wrench.force.dot(&velocity) + wrench.moment.dot(&spin)
        })
        .sum()
}

/// Everything that a state says about the motion at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagnostics {
    /// `Σ p`, spatial, kg m/s.
    pub linear_momentum: Vector3<f64>,
    /// `Σ x × p + R π`, about the origin, spatial, kg m²/s.
    pub angular_momentum: Vector3<f64>,
    /// Strain and internal force and moment of every element.
    pub elements: Vec<ElementStress>,
    /// What holds or drives the base: the force (spatial) and the moment (body frame of the base) that, with all others
    /// on node 0, give it its motion; zero for a free base.
    pub reaction: Wrench,
    /// Gravity, loads and the reaction.
    pub external: TotalWrench,
    /// Mean wrench of damping over the step that begins here, `-c Σ p½` and `-c Σ x × p½ + R g`.
    pub damping: TotalWrench,
    /// Largest `|V/V₀ - 1|` of any element, as in the paper's equations (89) and (90): `|e - 1|` under the standard model,
    /// whose section keeps its size; 0 under the others, whose section thins by `e`.
    pub volume_error: f64,
}

impl Diagnostics {
    /// Of a state at time `t`, with its momenta at the same instant, in a motion of step `time_step`. Control wrenches
    /// are not included.
    #[must_use]
    pub fn of(rod: &Rod, time_step: f64, t: f64, state: &State) -> Self {
        let configuration = &state.configuration;
        let (positions, rotations) = (&configuration.positions, &configuration.rotations);
        let elements = rod
            .elements
            .iter()
            .enumerate()
            .map(|(q, element)| {
                let pose = Rod::element_pose(q, positions, rotations);
                ElementStress::of(element, rod.strain_rule, &pose)
            })
            .collect();

        let mut net = NodalForces::zeros(rod.n_nodes());
        net.evaluate(rod, positions, rotations, t);
        let reaction = reaction(rod, time_step, t, state, &net);

        let mut external = TotalWrench::default();
        for (q, node) in rod.nodes.iter().enumerate() {
            external.add(state, q, &(rod.gravity * node.mass), &Vector3::zeros());
        }
        for load in &rod.loads {
            let wrench = load.wrench(t, &rotations[load.node]);
            external.add(state, load.node, &wrench.force, &wrench.moment);
        }
        external.add(state, 0, &reaction.force, &reaction.moment);

        let c = rod.viscous_damping;
        let undamp = 1.0 / (1.0 + 0.5 * c * time_step);
        let mut damping = TotalWrench::default();
        if let Some(base) = rod.driven_base(t + 0.5 * time_step) {
            let p = base.velocity * rod.nodes[0].mass;
            let spin = rod.rotary_at(positions)[0].component_mul(&base.angular_velocity);
            damping.force -= c * p;
            damping.moment -= c * (base.position.cross(&p) + base.rotation * spin);
        }
        for q in rod.first_free_node()..rod.n_nodes() {
            let p = (state.linear_momentum[q] + 0.5 * time_step * net.forces[q]) * undamp;
            let g = (state.angular_momentum[q] + 0.5 * time_step * net.moments[q]) * undamp;
            damping.add(state, q, &(-c * p), &(-c * g));
        }

        Self {
            linear_momentum: linear_momentum(state),
            angular_momentum: angular_momentum(state),
            elements,
            reaction,
            external,
            damping,
            volume_error: match rod.model {
                RodModel::Standard => (rod.dilatation(positions).iter())
                    .map(|e| (e - 1.0).abs())
                    .fold(0.0, f64::max),
                RodModel::Dilatation | RodModel::Consistent => 0.0,
            },
        }
    }
}
