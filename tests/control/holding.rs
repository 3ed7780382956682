//! The search for efforts that hold a tip: problems whose distance from the target has several minima over the efforts.

use nalgebra::{Rotation3, Vector3};
use softarm::control::{Holding, OptimalControlProblem, holding};
use softarm::mechanics::{Density, Material, Route, StrainActuator};
use softarm::task::{Arm, Discretization, EffortControl, Task};

/// Elements of every arm; helical ones represent arcs exactly.
const ELEMENTS: usize = 12;
const LENGTH: f64 = 0.4;

fn arm(radius: f64, tendons: &[Route], largest: f64) -> Arm {
    let mut arm = Arm::cylinder(&Material::isotropic(1e6, 0.4, 1000.0), LENGTH, radius);
    arm.actuators = (tendons.iter().enumerate())
        .map(|(i, route)| StrainActuator {
            name: format!("tendon {i}"),
            density: Density::Shortening,
            scale: 1.0,
            route: *route,
            effort: vec![(0.0, 0.0)],
            largest,
        })
        .collect();
    arm
}

/// Returns the problem of a tip that efforts between zero and the largest one bring to a place.
fn problem(arm: &Arm, target: Vector3<f64>, tolerance: f64) -> OptimalControlProblem {
    let mut task = Task::reach(target, 1.0, 1.0);
    task.actuators.clear();
    task.efforts = (arm.actuators.iter().enumerate())
        .map(|(actuator, own)| EffortControl {
            actuator,
            bounds: [0.0, own.largest],
            rate: None,
            scale: None,
        })
        .collect();
    for target in &mut task.targets {
        target.tolerances.distance = Some(tolerance);
    }
    let posed = task.discretize(arm, &Discretization::with_elements(ELEMENTS));
    posed.expect("a problem").discrete
}

/// Returns the tensions that hold the tip, N; none if they are not found.
fn tensions(problem: &OptimalControlProblem) -> Option<Vec<f64>> {
    let Holding::Held(held) = holding(problem).expect("a verdict") else {
        return None;
    };
    let own = problem.efforts.as_ref().expect("efforts");
    let of = |place: usize| held.wrenches[own.first + place / 6].to_array()[place % 6];
    Some(own.places.iter().map(|place| of(*place)).collect())
}

/// A tendon along the lower part of an arm, which bends it by an angle `θ` and leaves the rest straight, without gravity.
struct Curl {
    arm: Arm,
    /// Fraction of the length that the tendon passes.
    part: f64,
    /// Offset of the tendon and radius of the arm, m.
    offset: f64,
    radius: f64,
}

impl Curl {
    fn new(part: f64, most: f64) -> Self {
        let (radius, offset) = (0.004, 0.003);
        let mut curl = Self {
            arm: arm(radius, &[], 0.0),
            part,
            offset,
            radius,
        };
        let route = Route {
            to: part,
            ..Route::straight([offset, 0.0])
        };
        curl.arm = arm(radius, &[route], curl.tension(most));
        curl
    }

    /// Returns the tension that bends the arm by an angle, `EI θ/(part L d)`.
    fn tension(&self, angle: f64) -> f64 {
        let bending = 1e6 * std::f64::consts::PI * 0.25 * self.radius.powi(4);
        bending * angle / (self.part * LENGTH * self.offset)
    }

    /// Returns the tip under the tension that bends the arm by an angle: an arc of the stretch `1 - T/EA`, then a straight piece.
    fn tip(&self, angle: f64) -> Vector3<f64> {
        let axial = 1e6 * std::f64::consts::PI * self.radius.powi(2);
        let arc = self.part * LENGTH * (1.0 - self.tension(angle) / axial);
        let rest = (1.0 - self.part) * LENGTH;
        let (sin, cos) = angle.sin_cos();
        Vector3::new(
            arc * (1.0 - cos) / angle + rest * sin,
            0.0,
            arc * sin / angle + rest * cos,
        )
    }
}

/// The tips that one tendon holds lie on a curve that returns to where it passed. The distance from a target far along it has a minimum
/// at rest and others on the way, from which no descent leads on: the arm has to be led along the curve. The tension found is that of the
/// arc, to the tolerance over the speed of the tip along the curve; the law of the arc is exact for helical elements.
#[test]
fn the_tip_of_one_tendon_is_found_far_along_its_curve() {
    let mut missed = Vec::new();
    for part in [0.4, 0.55, 0.7] {
        let curl = Curl::new(part, 8.0);
        for angle in [4.5, 5.5, 6.0, 6.5, 7.0] {
            let target = curl.tip(angle);
            let found = tensions(&problem(&curl.arm, target, 1e-3 * LENGTH));
            // The tip moves by more than 0.3 of the length per radian.
            let off = found.map(|found| (found[0] / curl.tension(angle) - 1.0) * angle);
            if !off.is_some_and(|off| off.abs() < 4e-3) {
                missed.push((part, angle, off));
            }
        }
    }
    assert!(missed.is_empty(), "{} missed: {missed:?}", missed.len());
}

/// Equal tensions in four tendons around a slender arm shorten it and do not bend it. The tip moves along its axis by so little for a
/// tension that bends the arm far that the little weight on effort would leave it at a distance of its own: it is brought nearer.
#[test]
fn a_common_tension_shortens_an_arm() {
    let radius = 2e-3 * LENGTH;
    let routes: Vec<Route> = (0..4)
        .map(|i| {
            let turn = Rotation3::from_axis_angle(
                &Vector3::z_axis(),
                std::f64::consts::FRAC_PI_2 * f64::from(i),
            );
            let place = turn * Vector3::new(0.8 * radius, 0.0, 0.0);
            Route::straight([place.x, place.y])
        })
        .collect();
    let axial = 1e6 * std::f64::consts::PI * radius.powi(2);
    let mut missed = Vec::new();
    for shortening in [5e-3, 1e-2, 2e-2] {
        let each = 0.25 * shortening * axial;
        let arm = arm(radius, &routes, 2.0 * each);
        let target = Vector3::new(0.0, 0.0, LENGTH * (1.0 - shortening));
        let found = tensions(&problem(&arm, target, 1e-4 * LENGTH));
        let sum = found.map(|found| found.iter().sum::<f64>() / axial);
        if !sum.is_some_and(|sum| (sum - shortening).abs() < 1.1e-4) {
            missed.push((shortening, sum));
        }
    }
    assert!(missed.is_empty(), "{} missed: {missed:?}", missed.len());
}
