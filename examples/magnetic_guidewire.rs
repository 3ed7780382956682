//! Can a magnetic field steer the soft tip of a guidewire to a point, bent about magnets that weigh more than the tip itself?
//!
//! An actuator of one's own, with the public surface alone: two ring magnets with the moment `m` in the body frame at the end of the wire, in
//! a field whose value `B` at the magnets and gradient `G` there (traceless and symmetric, five numbers) are the controls. They feel
//!
//! ```text
//! force  G R m  (space),     moment  m × RᵀB  (body frame).
//! ```
//!
//! The wire is that of the simulator mCR of ETH Zurich (`example_flat.py`): E = 21 MPa, outer and inner diameter 1.33 mm and 0.8 mm, magnets 8 mm
//! long in all. Its soft tip of 34 mm is modelled, clamped to the body, which is a hundred times as stiff; so are the weight of the
//! magnets in blood and a drag that is linear in the velocity. The least effort brings it to a point a radian off the body's axis, at rest;
//! the field is at most 40 mT, every number of its gradient 1 T/m.
//!
//! ```text
//! cargo run --release --example magnetic_guidewire
//! ```

use std::error::Error;
use std::f64::consts::PI;

use softarm::control::{Actuator, Bound, Channel, SharedActuator};
use softarm::faer::Mat;
use softarm::mechanics::{
    NodeInertia, Rod, RotaryInertia, Section, SectionProfile, StateView, TimeScheme, Wrench,
};
use softarm::nalgebra::{Matrix3, Vector3};
use softarm::task::{
    Arm, ControlGroup, Discretization, OwnActuator, PointLoad, Rest, Start, StartShape, Target,
    Task, Tolerances,
};

const LENGTH: f64 = 0.034; // m
const LARGEST_FIELD: f64 = 0.04; // T
const LARGEST_GRADIENT: f64 = 1.0; // T/m
/// What bends the tip by a radian, and counts as effort 1.
const USUAL_FIELD: f64 = 0.01; // T
const USUAL_GRADIENT: f64 = 0.25; // T/m, a force of 2 mN

/// Magnets at the tip, with their moment in the body frame, A m².
#[derive(Debug)]
struct Magnets {
    moment: Vector3<f64>,
}

/// The matrix `v̂` with `v̂ w = v × w`.
fn cross(v: &Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

/// The gradient from its five numbers.
fn gradient(g: &[f64]) -> Matrix3<f64> {
    Matrix3::new(g[0], g[1], g[2], g[1], g[3], g[4], g[2], g[4], -g[0] - g[3])
}

/// A matrix of six rows from blocks of three by three: the place of their first entry, and the block.
fn blocks(columns: usize, blocks: &[([usize; 2], Matrix3<f64>)]) -> Mat<f64> {
    let mut out = Mat::zeros(6, columns);
    for ([row, column], block) in blocks {
        for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
            out[(row + i, column + j)] = block[(i, j)];
        }
    }
    out
}

impl Actuator for Magnets {
    fn n_controls(&self) -> usize {
        8
    }

    fn nodes(&self, rod: &Rod) -> Vec<usize> {
        vec![rod.tip()]
    }

    fn wrench(&self, at: &StateView, u: &[f64], out: &mut [Wrench]) {
        let r = at.rotations[at.rod.tip()];
        let field = Vector3::new(u[0], u[1], u[2]);
        out[0] = Wrench {
            force: gradient(&u[3..]) * r * self.moment,
            moment: self.moment.cross(&(r.transpose() * field)),
        };
    }

    /// With `δR = R ζ̂`: `δ(R m) = -R m̂ ζ` and `δ(RᵀB) = (RᵀB)^ ζ`.
    fn configuration_jacobian(&self, at: &StateView, u: &[f64]) -> Mat<f64> {
        let r = at.rotations[at.rod.tip()];
        let field = r.transpose() * Vector3::new(u[0], u[1], u[2]);
        let m = cross(&self.moment);
        let force = -gradient(&u[3..]) * r * m;
        blocks(6, &[([0, 3], force), ([3, 3], m * cross(&field))])
    }

    fn control_jacobian(&self, at: &StateView, _: &[f64]) -> Mat<f64> {
        let r = at.rotations[at.rod.tip()];
        let mut out = blocks(8, &[([3, 0], cross(&self.moment) * r.transpose())]);
        for j in 0..5 {
            let unit: [f64; 5] = std::array::from_fn(|i| f64::from(u8::from(i == j)));
            let force = gradient(&unit) * r * self.moment;
            for i in 0..3 {
                out[(i, 3 + j)] = force[i];
            }
        }
        out
    }
}

/// The soft tip with its magnets, clamped at the origin along the third axis.
fn soft_tip() -> Arm {
    let (youngs, poisson, density) = (21e6, 0.5, 1100.0);
    let (outer, inner): (f64, f64) = (0.5 * 1.33e-3, 0.5 * 0.8e-3);
    let area = PI * (outer.powi(2) - inner.powi(2));
    let second_moment = 0.25 * PI * (outer.powi(4) - inner.powi(4));
    let shear = youngs / (2.0 * (1.0 + poisson));
    let section = Section {
        linear_stiffness: Vector3::new(shear * area, shear * area, youngs * area),
        angular_stiffness: Vector3::new(youngs, youngs, 2.0 * shear) * second_moment,
        mass: density * area,
        rotary: Vector3::new(1.0, 1.0, 2.0) * (density * second_moment),
    };
    // Two rings of 4 mm, outer and inner radius as below.
    let (mass, length, ring): (f64, f64, f64) = (48e-6, 8e-3, outer.powi(2) + 0.43e-3_f64.powi(2));
    let across = mass * (3.0 * ring + length * length) / 12.0;
    // Of magnets (7500 kg/m³) in blood (1060 kg/m³); the wire itself nearly floats.
    let weight = mass * 9.81 * (1.0 - 1060.0 / 7500.0);
    // At 5 cm/s the Reynolds number is 20 and the drag coefficient of a cylinder about 3.5: drag ½ ρ v d C, over all that moves.
    let drag = 0.5 * 1060.0 * 0.05 * (2.0 * outer) * 3.5 * LENGTH;
    Arm {
        viscous_damping: drag / (mass + density * area * LENGTH),
        loads: vec![PointLoad {
            force: Vector3::new(0.0, -weight, 0.0),
            ..PointLoad::default()
        }],
        payload: Some(NodeInertia {
            mass,
            rotary: Vector3::new(across, across, 0.5 * mass * ring),
        }),
        ..Arm::straight(LENGTH, SectionProfile::Uniform(section))
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    // The end of an arc of one radian, a sixth of a turn off the vertical.
    let (bend, azimuth): (f64, f64) = (1.0, PI / 3.0);
    let aside = LENGTH * (1.0 - bend.cos()) / bend;
    let goal = Vector3::new(
        aside * azimuth.sin(),
        aside * azimuth.cos(),
        LENGTH * bend.sin() / bend,
    );
    let group = |count: usize, scale: f64, bound: Bound| ControlGroup {
        count,
        channel: Channel::new(scale, Some(bound)),
    };
    let each = Bound::PerAxis(Vector3::repeat(LARGEST_GRADIENT));
    let target = Target {
        name: "goal".into(),
        position: Some(goal),
        rest: Rest::Instant,
        tolerances: Tolerances {
            speed: Some(0.0),
            spin: Some(0.0),
            ..Tolerances::default()
        },
        ..Target::default()
    };
    let task = Task {
        targets: vec![target],
        start: Start {
            shape: StartShape::Equilibrium,
            ..Start::default()
        },
        actuators: Vec::new(),
        own_actuators: vec![OwnActuator {
            actuator: SharedActuator::new(Magnets {
                moment: Vector3::new(0.0, 0.0, 2.0 * 3.73e-3),
            }),
            controls: vec![
                group(3, USUAL_FIELD, Bound::Norm(LARGEST_FIELD)),
                group(3, USUAL_GRADIENT, each),
                group(2, USUAL_GRADIENT, each),
            ],
        }],
        ..Task::reach(goal, 0.4, 0.0)
    };
    let discretization = Discretization {
        elements: 8,
        scheme: Some(TimeScheme::Implicit),
        rotary_inertia: Some(RotaryInertia::Segment),
        step: Some(5e-4),
        blocks: 10,
        ..Discretization::default()
    };
    let solution = softarm::solve(&soft_tip(), &task, &discretization)?;
    let check = solution.certify()?;

    let discrete = &solution.problem.discrete;
    let (tip, last) = (discrete.rod.tip(), discrete.grid.n_steps);
    let end = solution.trajectory().positions_at(last)[tip];
    println!("     t/s   |B|/mT  |G|/(T/m)  magnets/mm");
    let (mut field, mut slope) = (0.0_f64, 0.0_f64);
    for k in 0..=last {
        let u = discrete.acting[0].controls(discrete.inputs(&solution.controls_at(k)));
        let now = Vector3::new(u[0], u[1], u[2]).norm();
        field = field.max(now);
        slope = u[3..].iter().fold(slope, |most, g| most.max(g.abs()));
        if k % (last / 8) == 0 {
            let x = solution.trajectory().positions_at(k)[tip] * 1e3;
            println!(
                "{:8.3}  {:7.3}  {:9.3}  ({:6.2}, {:6.2}, {:6.2})",
                discrete.grid.time(k),
                1e3 * now,
                gradient(&u[3..]).norm(),
                x.x,
                x.y,
                x.z
            );
        }
    }
    println!(
        "{} after {} iterations, {:.1e} m from the goal",
        check.verdict(),
        solution.attempt.iterations(),
        (end - goal).norm()
    );
    for item in &check.items {
        println!(
            "{:28} {:9.2e} of {:.2e} {}",
            item.name, item.value, item.limit, item.unit
        );
    }
    assert!(check.is_certified());
    assert!((end - goal).norm() < 1e-6 * LENGTH);
    assert!(0.1 * LARGEST_FIELD < field && field < LARGEST_FIELD * (1.0 + 1e-6));
    assert!(0.0 < slope && slope < LARGEST_GRADIENT * (1.0 + 1e-6));
    Ok(())
}
