//! A heavy cantilever above a floor, on which its far end lies: the boundary-value problem of the same law of contact, and the beam that
//! lies on a rigid floor.

use nalgebra::{Matrix4, SMatrix, Vector2, Vector3, Vector4};
use softarm::control::Shape;
use softarm::mechanics::rotation::exp;
use softarm::mechanics::{
    Contact, NodeSpring, Rod, RodParameters, Section, SectionProfile, static_equilibrium,
};
use softarm::scene::Scene;

/// A cantilever along the first axis at the height `height` above a floor.
#[derive(Clone, Copy)]
struct Beam {
    length: f64,
    height: f64,
    /// Stiffnesses `EA`, `GA` (N) and `EI` (N m²).
    axial: f64,
    shear: f64,
    bending: f64,
    /// Weight per length, N/m.
    weight: f64,
    /// Penetration at which the floor pushes with all the weight, m.
    penetration: f64,
}

impl Beam {
    /// Returns a beam of silicone, 1 cm in radius, whose sections shear `1/stiffer` times as much; `penetration` is per height.
    fn silicone(height: f64, stiffer: f64, penetration: f64) -> Self {
        let (young, radius) = (1e5, 0.01_f64);
        let area = std::f64::consts::PI * radius * radius;
        let mut out = Self {
            length: 0.0,
            height,
            axial: young * area * stiffer,
            shear: young / 2.8 * area * stiffer,
            bending: young * area * radius * radius / 4.0,
            weight: 1070.0 * area * 9.81,
            penetration: penetration * height,
        };
        out.length = 1.4 * out.lift_off();
        out
    }

    /// Where a slender beam that hangs down by little leaves a rigid floor, from its clamp, m. From the clamp (`w = h`, `w' = 0`) to there
    /// (`w = w' = w'' = 0`) `EI w'''' = -q` has `w = q ξ³ (4 l - 3 ξ)/(72 EI)`, `ξ` from there to the clamp, hence `h = q l⁴/(72 EI)`; the moment
    /// in the clamp is `q l²/6`.
    fn lift_off(&self) -> f64 {
        (72.0 * self.bending * self.height / self.weight).powf(0.25)
    }

    fn rod(&self, n_elements: usize) -> Rod {
        let gravity = 9.81;
        let section = Section {
            linear_stiffness: Vector3::new(self.shear, self.shear, self.axial),
            angular_stiffness: Vector3::new(self.bending, self.bending, self.bending),
            mass: self.weight / gravity,
            rotary: Vector3::repeat(1e-6),
        };
        let floor = Contact {
            name: "floor".into(),
            shape: Shape::HalfSpace {
                point: Vector3::new(0.0, 0.0, -self.height),
                normal: Vector3::z(),
            },
            part: [0.0, 1.0],
            force: self.weight * self.length,
            penetration: self.penetration,
        };
        Rod::new(&RodParameters {
            base_rotation: exp(&Vector3::new(0.0, std::f64::consts::FRAC_PI_2, 0.0)),
            gravity: Vector3::new(0.0, 0.0, -gravity),
            contacts: vec![floor],
            ..RodParameters::straight(self.length, n_elements, SectionProfile::Uniform(section))
        })
        .expect("a rod")
    }

    /// `d/ds` of height, slope, vertical force and moment, and of the place along the first axis. The axial force is zero but for the slope.
    fn rates(&self, y: &Vector4<f64>) -> (Vector4<f64>, f64) {
        let (sin, cos) = y[1].sin_cos();
        let (stretch, shear) = (1.0 + y[2] * sin / self.axial, y[2] * cos / self.shear);
        let along = cos * stretch - sin * shear;
        let depth = (-self.height - y[0]).max(0.0) / self.penetration;
        let pressure = self.weight * depth * depth;
        (
            Vector4::new(
                sin * stretch + cos * shear,
                y[3] / self.bending,
                self.weight - pressure,
                -along * y[2],
            ),
            along,
        )
    }

    /// A step of the method of Runge and Kutta.
    fn advance(&self, y: &Vector4<f64>, ds: f64) -> Vector4<f64> {
        let rates = |y: &Vector4<f64>| self.rates(y).0;
        let a = rates(y);
        let b = rates(&(y + a * (0.5 * ds)));
        let c = rates(&(y + b * (0.5 * ds)));
        let d = rates(&(y + c * ds));
        y + (a + b * 2.0 + c * 2.0 + d) * (ds / 6.0)
    }

    /// Solves the boundary-value problem by multiple shooting over `n` intervals: Newton's method for the jumps between them, its steps swept
    /// from the clamp on for two unknowns there, force and moment. Returns height, slope, force and moment at the ends of the intervals.
    fn solve(&self, n: usize) -> Vec<Vector4<f64>> {
        let (l, q, ds) = (self.lift_off(), self.weight, self.length / n as f64);
        let scale = Vector4::new(self.height, self.height / l, q * l, q * l * l);
        // The shape on a rigid floor.
        let mut y: Vec<Vector4<f64>> = (0..=n)
            .map(|i| {
                let xi = (l - i as f64 * ds).max(0.0);
                let w = q * xi.powi(3) * (4.0 * l - 3.0 * xi) / (72.0 * self.bending);
                let moment = q * xi * (l / 3.0 - 0.5 * xi);
                let force = if xi > 0.0 { q * (l / 3.0 - xi) } else { 0.0 };
                Vector4::new(w - self.height, 0.0, force, moment)
            })
            .collect();
        let jumps = |y: &[Vector4<f64>]| -> Vec<Vector4<f64>> {
            (0..n).map(|i| self.advance(&y[i], ds) - y[i + 1]).collect()
        };
        let size = |y: &[Vector4<f64>], jumps: &[Vector4<f64>]| {
            let end = Vector4::new(0.0, 0.0, y[n][2], y[n][3]);
            (jumps.iter().chain([&end]))
                .map(|jump| jump.component_div(&scale).amax())
                .fold(0.0, f64::max)
        };
        for _ in 0..50 {
            let off = jumps(&y);
            let before = size(&y, &off);
            if before < 1e-11 {
                return y;
            }
            // Along the two unknowns, and the rest.
            let mut swept = vec![SMatrix::<f64, 4, 3>::zeros()];
            swept[0][(2, 0)] = scale[2];
            swept[0][(3, 1)] = scale[3];
            for i in 0..n {
                let columns = [0, 1, 2, 3].map(|j| {
                    let h = 1e-6 * scale[j];
                    let at = |s: f64| self.advance(&(y[i] + Vector4::ith(j, s * h)), ds);
                    (at(1.0) - at(-1.0)) / (2.0 * h)
                });
                let mut next = Matrix4::from_columns(&columns) * swept[i];
                next.set_column(2, &(next.column(2) + off[i]));
                swept.push(next);
            }
            let end = &swept[n];
            let rest = Vector2::new(y[n][2] + end[(2, 2)], y[n][3] + end[(3, 2)]);
            let solution = (end.fixed_view::<2, 2>(2, 0).into_owned().lu())
                .solve(&-rest)
                .expect("a regular matrix");
            let mut length = 1.0;
            loop {
                let trial: Vec<Vector4<f64>> = (y.iter().zip(&swept))
                    .map(|(y, part)| {
                        let step = part.fixed_columns::<2>(0) * solution + part.column(2);
                        y + step * length
                    })
                    .collect();
                if size(&trial, &jumps(&trial)) < before || length < 1e-3 {
                    y = trial;
                    break;
                }
                length *= 0.5;
            }
        }
        panic!("no solution");
    }

    /// The largest distance in height of a rod's nodes at rest from the solution, per height.
    fn error(&self, n_elements: usize, solution: &[Vector4<f64>]) -> f64 {
        let rod = self.rod(n_elements);
        let shape =
            static_equilibrium(&rod, &rod.rest, 0.0, &Default::default()).expect("an equilibrium");
        let stride = (solution.len() - 1) / n_elements;
        (shape.positions.iter().enumerate())
            .map(|(q, x)| (x.z - solution[q * stride][0]).abs() / self.height)
            .fold(0.0, f64::max)
    }
}

/// The shape of a rod that sags onto the floor is that of the boundary-value problem with the same law of contact, up to an error of second
/// order in the elements, for penetrations of a tenth and of a fortieth of the height.
#[test]
fn a_heavy_cantilever_lies_on_a_floor() {
    for penetration in [0.1, 0.025] {
        let beam = Beam::silicone(0.01, 1.0, penetration);
        let solution = beam.solve(1600);
        // The ends of the intervals are accurate themselves.
        let finer = beam.solve(3200);
        let rounding = (solution.iter().zip(finer.iter().step_by(2)))
            .map(|(a, b)| (a[0] - b[0]).abs())
            .fold(0.0, f64::max);
        assert!(rounding < 1e-7 * beam.height, "{rounding:e}");
        let errors = [20, 40, 80].map(|n| beam.error(n, &solution));
        eprintln!("{penetration}: {errors:?}");
        for pair in errors.windows(2) {
            let order = (pair[0] / pair[1]).log2();
            assert!((1.7..2.4).contains(&order), "{penetration}: {errors:?}");
        }
        assert!(errors[2] < 1e-3, "{errors:?}");
    }
}

/// Bodies become rigid as the penetration falls: the moment in the clamp of a slender beam differs from `q l²/6`, on a rigid floor, in
/// proportion to it, and extrapolated to zero is that, up to the square of the slopes and the flexibility in shear.
#[test]
fn the_floor_becomes_rigid_in_proportion_to_the_penetration() {
    let moments = [0.1, 0.05, 0.025].map(|penetration| {
        let beam = Beam::silicone(1e-3, 1e3, penetration);
        let rigid = beam.weight * beam.lift_off().powi(2) / 6.0;
        -beam.solve(1600)[0][3] / rigid
    });
    let changes = [moments[0] - moments[1], moments[1] - moments[2]];
    let ratio = changes[0] / changes[1];
    eprintln!("{moments:?} {ratio}");
    assert!((1.7..2.3).contains(&ratio), "{moments:?}");
    let extrapolated = 2.0 * moments[2] - moments[1];
    assert!((extrapolated - 1.0).abs() < 2e-3, "{extrapolated}");
}

/// A cable lies on a floor and rises to a hand at one end: its horizontal pull is that of the elastic catenary from the point of touchdown on
/// (Irvine 1981, section 1.4), whatever its bending stiffness, as long as it is small. The bending stiffness and the elements change
/// the pull by the part of the hanging length over which the cable bends, `sqrt(EI/H)`, and that of an element.
#[test]
fn a_cable_rises_from_the_floor() {
    let (length, span, height, axial) = (1.0, 0.75, 0.4, 7.068_583_470_577_034_5);
    let weight: f64 = 0.021_205_75 * 9.81;
    let root = |mut low: f64, mut high: f64, falls: &dyn Fn(f64) -> f64| {
        for _ in 0..200 {
            let middle = 0.5 * (low + high);
            if falls(middle) > 0.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        0.5 * (low + high)
    };
    // Of the length that hangs, s: its pull from the height, and the span with the part that lies.
    let pull = |s: f64| {
        let v = weight * s;
        let rise = |h: f64| (h.hypot(v) - h) / weight + v * s / (2.0 * axial) - height;
        root(1e-9, 10.0, &rise)
    };
    let across = |s: f64| {
        let h = pull(s);
        let hangs = h / weight * (weight * s / h).asinh() + h * s / axial;
        span - hangs - (length - s) * (1.0 + h / axial)
    };
    let hanging = root(height, length, &across);
    let exact = pull(hanging);
    for bending in [1e-6, 4e-7, 1e-7] {
        for elements in [40, 80] {
            let text = format!(
                r#"
[rod]
length_m = 1.0
elements = {elements}
display_radius_m = 0.0015
stiffness = {{ ea_n = {axial}, ga_n = 2.35, ei_n_m2 = {bending}, gj_n_m2 = {bending} }}
inertia = {{ mass_kg_m = 0.02120575, rotary_kg_m = [1e-8, 1e-8, 2e-8] }}
[base]
kind = "pinned"
direction = [1.0, 0.0, 0.0]
[tip]
kind = "pinned"
position_m = [{span}, 0.0, {height}]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[[contact]]
name = "floor"
half_space = {{ point_m = [0.0, 0.0, -0.0015], normal = [0.0, 0.0, 1.0] }}
penetration_m = 0.0002
[time]
end_s = 1.0
"#
            );
            let (scene, source) = Scene::from_toml("cable", &text, &[]).expect("a scene");
            let arm = scene.arm(&source).expect("an arm");
            let rod = arm.rod(&scene.discretization()).expect("a rod");
            let found = static_equilibrium(&rod, &rod.rest, 0.0, &NodeSpring::default());
            let shape = found.unwrap_or_else(|error| panic!("{bending:e} {elements}: {error}"));
            let h = rod.static_reaction_at(rod.tip(), &shape, 0.0).force.x;
            let parts = (bending / exact).sqrt() / hanging + 0.5 / f64::from(elements);
            assert!(
                (h / exact - 1.0).abs() < parts,
                "{bending:e} {elements}: {h} {exact}"
            );
        }
    }
}
