//! Rods and random states that several tests share.
#![allow(dead_code)]

pub mod differentiated;
pub mod extremes;
pub mod learned;
pub mod plain;
pub mod plain_curvature;
pub mod published;
pub mod tasks;

use nalgebra::{DMatrix, Vector3};
use softarm::mechanics::linearization::{RightHandSide, StateTangent};
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{
    BaseCondition, BaseMotion, Configuration, ControlSignal, DistributedLoad, Load, LoadFrame,
    Material, MotionCurve, NodeInertia, NodeSpring, Oscillation, Outline, Rod, RodModel,
    RodParameters, Section, SectionProfile, SectionSegment, State, StrainRule, TimeGrid,
    TimeScheme, Trajectory, Wrench, nearby_equilibrium_until,
};
use softarm::stop::StopSignal;

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

/// The rod of these parameters with `factor` times the elements, its loads on the same material points, and at rest.
pub fn finer_at_rest(
    parameters: &RodParameters,
    factor: usize,
) -> Result<(Rod, State), softarm::mechanics::RodError> {
    let mut finer = parameters.refined(factor);
    for load in &mut finer.loads {
        load.node *= factor;
    }
    let rod = Rod::new(&finer)?;
    let start = rod.at_rest_on_base(rod.rest.clone());
    Ok((rod, start))
}

/// A law of motion with the way it is stepped.
#[derive(Clone, Copy, Debug)]
pub struct Method {
    pub rule: StrainRule,
    pub model: RodModel,
    pub scheme: TimeScheme,
    /// Kelvin-Voigt time, s.
    pub internal_damping: f64,
}

impl Method {
    /// The rod of these parameters, by this method.
    pub fn rod(&self, parameters: RodParameters) -> Rod {
        Rod::new(&self.of(parameters)).unwrap()
    }

    pub fn of(&self, parameters: RodParameters) -> RodParameters {
        RodParameters {
            strain_rule: self.rule,
            model: self.model,
            scheme: self.scheme,
            internal_damping: self.internal_damping,
            ..parameters
        }
    }

    /// Whether the step derives from an action.
    pub fn is_variational(&self) -> bool {
        self.model.has_potential() && self.internal_damping == 0.0
    }
}

/// Every law, explicit, and the standard model implicit, with Kelvin-Voigt damping, and both; the damping is strong (ratio
/// 0.5 and more) in the fastest waves of the soft arm and weak in its bending.
pub fn methods() -> impl Iterator<Item = Method> {
    let explicit = laws().map(|(rule, model)| Method {
        rule,
        model,
        scheme: TimeScheme::Explicit,
        internal_damping: 0.0,
    });
    let others = RULES.into_iter().flat_map(|rule| {
        [
            (TimeScheme::Implicit, 0.0),
            (TimeScheme::Explicit, 2e-3),
            (TimeScheme::Implicit, 2e-3),
        ]
        .map(|(scheme, internal_damping)| Method {
            rule,
            model: RodModel::Standard,
            scheme,
            internal_damping,
        })
    });
    explicit.chain(others)
}

/// The methods whose second derivatives are exact: the standard model, explicit, implicit, and with Kelvin-Voigt damping.
pub fn exact_methods() -> impl Iterator<Item = Method> {
    methods().filter(|method| method.model == RodModel::Standard)
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

/// [`soft_arm`] with Cowper's shear factor 27/28 for a circle, as in most published values for it.
pub fn cowper_arm(strain_rule: StrainRule, n_elements: usize) -> RodParameters {
    let material = Material {
        shear_factor: 27.0 / 28.0,
        ..SILICONE
    };
    RodParameters {
        section: SectionProfile::Uniform(Section::circle(&material, 0.05)),
        ..soft_arm(strain_rule, n_elements)
    }
}

/// The rod of the paper's section 5 and of the flying beam: L = 10, EA = GA = 1e4, EI = GJ = 500, ρA = 1, ρI = 10.
pub fn paper_rod(strain_rule: StrainRule, n_elements: usize) -> RodParameters {
    let section = Section {
        linear_stiffness: Vector3::repeat(1e4),
        angular_stiffness: Vector3::repeat(500.0),
        mass: 1.0,
        rotary: Vector3::repeat(10.0),
    };
    RodParameters {
        strain_rule,
        ..RodParameters::straight(10.0, n_elements, SectionProfile::Uniform(section))
    }
}

/// A constant force and moment on node `n`.
pub fn tip_load(n: usize, force: [f64; 3], moment: [f64; 3], frame: LoadFrame) -> Vec<Load> {
    vec![Load {
        node: n,
        force: Vector3::from(force),
        moment: Vector3::from(moment),
        frame,
        profile: Vec::new(),
    }]
}

/// Equilibrium, stable or not, reached by raising the loads in `parts` equal parts.
pub fn equilibrium(parameters: &RodParameters, parts: usize) -> (Rod, Configuration) {
    let mut shape = None;
    let mut last = None;
    for part in 1..=parts {
        let factor = part as f64 / parts as f64;
        let mut p = parameters.clone();
        for load in &mut p.loads {
            load.force *= factor;
            load.moment *= factor;
        }
        for load in &mut p.distributed_loads {
            load.force *= factor;
            load.moment *= factor;
        }
        p.gravity *= factor;
        let rod = Rod::new(&p).unwrap();
        let start = shape.take().unwrap_or_else(|| rod.rest.clone());
        let none = NodeSpring::default();
        let stop = StopSignal::default();
        shape = Some(nearby_equilibrium_until(&rod, &start, 0.0, &none, &stop).unwrap());
        last = Some(rod);
    }
    (last.unwrap(), shape.unwrap())
}

/// Tangent stiffness over `(δx, η)` of all nodes, six rows a node, assembled from the elements.
pub fn stiffness(rod: &Rod, at: &Configuration) -> DMatrix<f64> {
    let mut k = DMatrix::zeros(6 * rod.n_nodes(), 6 * rod.n_nodes());
    for (q, element) in rod.elements.iter().enumerate() {
        let pose = Rod::element_pose(q, &at.positions, &at.rotations);
        let (_, block) = element.stiffness(rod.strain_rule, &pose);
        // (row of the whole, row of the element, sign): the element knows x_b - x_a, η_a, η_b.
        let (a, b) = (6 * q, 6 * (q + 1));
        let parts = [(a, 0, -1.0), (b, 0, 1.0), (a + 3, 3, 1.0), (b + 3, 6, 1.0)];
        for (row, i, row_sign) in parts {
            for (column, j, column_sign) in parts {
                let mut view = k.fixed_view_mut::<3, 3>(row, column);
                view += block.fixed_view::<3, 3>(i, j) * (row_sign * column_sign);
            }
        }
    }
    k
}

/// Halving l (or h) must divide the error by four: the observed order lies within 1.9 to 2.1.
#[track_caller]
pub fn assert_second_order(what: &str, coarse: f64, fine: f64) {
    let order = (coarse / fine).log2();
    assert!(
        (1.9..2.1).contains(&order),
        "{what}: order {order}, errors {coarse:e} {fine:e}"
    );
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

/// [`busy_arm`] with elements of three lengths: a taper, then a rectangle with another curvature at rest, whose three moments of inertia differ,
/// and a body.
pub fn uneven_arm(strain_rule: StrainRule, n_elements: usize) -> RodParameters {
    let busy = busy_arm(strain_rule, n_elements);
    let strip = Outline::Rectangle {
        width: 0.09,
        height: 0.06,
    };
    let profiles = [
        (0.35, busy.section.clone()),
        (
            1.0,
            SectionProfile::Uniform(Section::of_shape(&SILICONE, &strip)),
        ),
    ];
    let body = NodeInertia {
        mass: 0.3,
        rotary: Vector3::new(2e-4, 4e-4, 1e-4),
    };
    let [straight, bent] = [0.0, 0.7].map(|kappa| Vector3::new(kappa, 0.0, 0.0));
    RodParameters {
        section: SectionProfile::Segments(
            profiles
                .map(|(to, section)| SectionSegment { to, section })
                .into(),
        ),
        curvature_rows: vec![(0.35, straight), (0.35, bent), (1.0, straight)],
        bodies: vec![(0.5, body)],
        ..busy
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

/// Any wrenches up to this force and moment, on the tip, in the middle, and on the base, where they have an effect only if it is
/// free.
pub fn random_signal(
    rod: &Rod,
    n_steps: usize,
    [force, moment]: [f64; 2],
    dice: &mut Dice,
) -> ControlSignal {
    let nodes = vec![rod.tip(), rod.tip() / 2, 0];
    let wrenches = (0..nodes.len() * (n_steps + 1))
        .map(|_| Wrench {
            force: dice.vector(force),
            moment: dice.vector(moment),
        })
        .collect();
    ControlSignal::on(nodes, wrenches)
}

/// Any right-hand side of the equations of motion.
pub fn random_sources(rod: &Rod, n_steps: usize, size: f64, dice: &mut Dice) -> RightHandSide {
    let n = rod.n_nodes();
    let mut vectors = |count: usize| (0..count).map(|_| dice.vector(size)).collect();
    RightHandSide {
        linear: vectors(n * n_steps),
        angular: vectors(n * n_steps),
        terminal_linear: vectors(n),
        terminal_angular: vectors(n),
        start: Some(StateTangent {
            positions: vectors(n),
            rotations: vectors(n),
            linear: vectors(n),
            angular: vectors(n),
        }),
    }
}

/// Any covector of one instant.
pub fn random_tangent(rod: &Rod, dice: &mut Dice) -> StateTangent {
    let mut vectors = || (0..rod.n_nodes()).map(|_| dice.vector(1.0)).collect();
    StateTangent {
        positions: vectors(),
        rotations: vectors(),
        linear: vectors(),
        angular: vectors(),
    }
}

/// Limits that leave alone how fast the tips of coarse arms are on finer grids.
pub fn on_its_own_grid() -> softarm::verify::CheckLimits {
    softarm::verify::CheckLimits {
        rest: [f64::MAX; 2],
        ..Default::default()
    }
}

/// Criteria that the check of a coarse arm does not meet, but for the speed of its tip on finer grids.
pub fn objections_on_its_own_grid(check: &softarm::verify::ForwardCheck) -> Vec<&'static str> {
    let finer = ["refined_speed_m_s", "refined_spin_rad_s"];
    (check.items.iter())
        .filter(|item| !item.holds() && !finer.contains(&item.name))
        .map(|item| item.name)
        .collect()
}
