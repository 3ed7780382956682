//! Rods and random states that several tests share.
#![allow(dead_code)]

use nalgebra::Vector3;
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{
    BaseCondition, BaseMotion, DistributedLoad, Load, LoadFrame, Material, MotionCurve,
    NodeInertia, Oscillation, Rod, RodModel, RodParameters, Section, SectionProfile, State,
    StrainRule, TimeGrid, Trajectory,
};

pub const RULES: [StrainRule; 2] = [StrainRule::Helical, StrainRule::Trapezoidal];

pub const MODELS: [RodModel; 3] = [
    RodModel::Standard,
    RodModel::Dilatation,
    RodModel::Consistent,
];

/// Every strain rule with every model.
pub fn laws() -> impl Iterator<Item = (StrainRule, RodModel)> {
    RULES
        .into_iter()
        .flat_map(|rule| MODELS.map(|model| (rule, model)))
}

/// The laws that derive from an action.
pub fn variational_laws() -> impl Iterator<Item = (StrainRule, RodModel)> {
    laws().filter(|law| law.1.has_potential())
}

/// L = 1 m, r = 0.05 m, E = 1 MPa, G = E/3, density 1000, the silicone-like arm of the notes and scenes.
pub const SILICONE: Material = Material {
    youngs_modulus: 1e6,
    shear_modulus: 1e6 / 3.0,
    density: 1000.0,
    shear_factor: 1.0,
};

/// A clamped, straight, undamped silicone arm along e3 without gravity.
pub fn soft_arm(strain_rule: StrainRule, n_elements: usize) -> RodParameters {
    let section = SectionProfile::Uniform(Section::circle(&SILICONE, 0.05));
    RodParameters {
        strain_rule,
        ..RodParameters::straight(1.0, n_elements, section)
    }
}

/// A base that is carried along a line while it shakes and tumbles.
pub fn shaking() -> BaseMotion {
    let oscillation = |amplitude, frequency, phase| Oscillation {
        amplitude,
        frequency,
        phase,
    };
    BaseMotion {
        translation: MotionCurve {
            rate: Vector3::new(0.2, -0.1, 0.3),
            table: None,
            oscillations: vec![oscillation(Vector3::new(0.02, 0.05, -0.03), 3.0, 0.4)],
        },
        rotation: MotionCurve {
            rate: Vector3::new(0.5, 1.0, -0.8),
            table: None,
            oscillations: vec![oscillation(Vector3::new(0.2, -0.1, 0.3), 2.0, 1.0)],
        },
    }
}

pub fn bases() -> [BaseCondition; 3] {
    [
        BaseCondition::Clamped,
        BaseCondition::Free,
        BaseCondition::driven(shaking()),
    ]
}

/// Everything at once: taper, rest curvature and stretch, oblique base, gravity, damping, dead and follower loads on
/// nodes and along the rod, payload.
pub fn busy_arm(strain_rule: StrainRule, n_elements: usize) -> RodParameters {
    RodParameters {
        section: SectionProfile::TaperedCircle {
            material: SILICONE,
            base_radius: 0.06,
            tip_radius: 0.03,
        },
        rest_curvature: Vector3::new(0.3, -0.2, 0.5),
        rest_stretch: 1.02,
        base_rotation: exp(&Vector3::new(0.4, -0.8, 0.3)),
        gravity: Vector3::new(1.0, -3.0, 5.0),
        viscous_damping: 1.7,
        loads: vec![
            Load {
                node: n_elements,
                force: Vector3::new(0.3, 0.1, -0.2),
                moment: Vector3::new(0.02, -0.05, 0.03),
                frame: LoadFrame::Spatial,
                profile: vec![(0.0, 0.5), (0.3, 1.5)],
            },
            Load {
                node: n_elements / 2,
                force: Vector3::new(0.2, -0.3, 0.1),
                moment: Vector3::new(0.04, 0.01, -0.02),
                frame: LoadFrame::Body,
                profile: Vec::new(),
            },
        ],
        distributed_loads: vec![DistributedLoad {
            from: 0.2,
            to: 0.9,
            force: Vector3::new(-0.3, 0.4, 0.2),
            moment: Vector3::new(0.01, 0.03, -0.05),
            frame: LoadFrame::Body,
            profile: vec![(0.0, 1.0), (0.3, 0.2)],
        }],
        payload: Some(NodeInertia {
            mass: 0.4,
            rotary: Vector3::new(3e-4, 5e-4, 2e-4),
        }),
        ..soft_arm(strain_rule, n_elements)
    }
}

/// A small deterministic generator (splitmix64), uniform in [-1, 1).
pub struct Dice(pub u64);

impl Dice {
    pub fn roll(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^= z >> 31;
        (z >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    pub fn vector(&mut self, size: f64) -> Vector3<f64> {
        Vector3::new(self.roll(), self.roll(), self.roll()) * size
    }
}

/// A state away from rest: strains of order `size`, velocities of order `speed` (m/s, and rad/s tenfold).
pub fn random_state(rod: &Rod, size: f64, speed: f64, dice: &mut Dice) -> State {
    let mut state = rod.at_rest_on_base(rod.rest.clone());
    let l = rod.elements[0].length;
    for q in rod.first_free_node()..rod.n_nodes() {
        state.configuration.positions[q] += dice.vector(size * l);
        state.configuration.rotations[q] *= exp(&dice.vector(size));
        state.linear_momentum[q] = dice.vector(speed) * rod.nodes[q].mass;
        state.angular_momentum[q] = dice
            .vector(10.0 * speed)
            .component_mul(&rod.nodes[q].rotary);
    }
    state
}

/// A lifted trajectory: it starts in `initial` and wanders, without obeying any dynamics; a driven base goes its way.
pub fn random_trajectory(
    rod: &Rod,
    initial: &State,
    grid: TimeGrid,
    dice: &mut Dice,
) -> Trajectory {
    let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), grid.n_steps + 1);
    let mut configuration = initial.configuration.clone();
    trajectory.push(&configuration);
    for k in 1..=grid.n_steps {
        if let Some(base) = rod.driven_base(grid.time(k)) {
            configuration.positions[0] = base.position;
            configuration.rotations[0] = base.rotation;
        }
        for q in rod.first_free_node()..rod.n_nodes() {
            configuration.positions[q] += dice.vector(0.5 * grid.step);
            configuration.rotations[q] *= exp(&dice.vector(5.0 * grid.step));
        }
        trajectory.push(&configuration);
    }
    trajectory
}
