//! Rods that the authors of OpenCR-MuJoCo computed by SoRoSim and publish beside their simulator: shapes at rest, and motions from such a
//! shape after the wrenches that hold it are gone. `examples/opencr/references` has a fifth of them, what their columns are, and their
//! license.
//!
//! The references are rods that neither shear nor stretch. The angles of the shapes of the rod of TPU are those of a rod without twist; the
//! positions of a round rod at rest do not depend on its twist, and those of its motions are those of a rod with twist.

use std::fs;
use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, Vector3};
use softarm::mechanics::{
    Configuration, Load, LoadFrame, Material, NodeWrenches, Rod, RodParameters, Section,
    SectionProfile, State, Stepper, TimeScheme,
};

use crate::common::{Dice, equilibrium};

/// A rod of round section.
#[derive(Clone)]
pub struct Reference {
    pub name: &'static str,
    /// Beginning of the names of its files.
    file: &'static str,
    /// m.
    length: f64,
    /// m.
    radius: f64,
    material: Material,
    /// Factor on all of its stiffnesses.
    pub stiffness: f64,
    /// It shears and stretches, as the references do not.
    pub shears: bool,
    /// Numbers of its motions.
    pub releases: [usize; 3],
}

pub fn references() -> [Reference; 2] {
    let releases = [1, 3, 5];
    [
        Reference {
            name: "spring steel",
            file: "steel",
            length: 0.6,
            radius: 0.8e-3,
            material: Material::isotropic(200e9, 0.33, 7870.0),
            stiffness: 1.0,
            shears: false,
            releases,
        },
        Reference {
            name: "TPU",
            file: "tpu",
            length: 0.4,
            radius: 5e-3,
            material: Material::isotropic(70e6, 0.4, 1200.0),
            stiffness: 1.0,
            shears: false,
            releases,
        },
    ]
}

/// Stiffness of a strain that a reference does not have over that of the section: such strains stay below 1e-6.
const WITHOUT: f64 = 100.0;

/// Half of the last place of the data, in their units.
const ROUNDING: f64 = 0.5e-4;

/// The wrenches and the gravity that hold a rod, with directions of space.
#[derive(Clone)]
struct Holding {
    /// Moment (N m) and force (N), in the middle and at the tip.
    wrenches: [[Vector3<f64>; 2]; 2],
    /// m/s².
    gravity: Vector3<f64>,
}

impl Holding {
    /// Loads that the data cannot tell from these.
    fn rounded(&self, dice: &mut Dice) -> Self {
        Self {
            wrenches: (self.wrenches).map(|wrench| wrench.map(|v| v + dice.vector(ROUNDING))),
            gravity: self.gravity + dice.vector(ROUNDING),
        }
    }
}

/// A shape at rest.
pub struct Shape {
    holding: Holding,
    /// m.
    tip: Vector3<f64>,
}

/// A motion from rest.
pub struct Release {
    /// Kelvin-Voigt time, s.
    damping: f64,
    /// Up to time 0.
    holding: Holding,
    /// Time, s, and position of the tip, m.
    tips: Vec<(f64, Vector3<f64>)>,
}

fn vector(numbers: &[f64]) -> Vector3<f64> {
    Vector3::from_column_slice(&numbers[..3])
}

impl Reference {
    fn path(&self, rest: &str) -> PathBuf {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/opencr/references");
        folder.join(format!("{}_{rest}", self.file))
    }

    /// The rod of `n` elements, along x.
    fn rod(&self, n: usize) -> RodParameters {
        let mut section = Section::circle(&self.material, self.radius);
        section.angular_stiffness *= self.stiffness;
        section.linear_stiffness *= self.stiffness;
        if !self.shears {
            section.linear_stiffness *= WITHOUT;
        }
        RodParameters {
            base_rotation: Matrix3::from_columns(&[Vector3::y(), Vector3::z(), Vector3::x()]),
            ..RodParameters::straight(self.length, n, SectionProfile::Uniform(section))
        }
    }

    /// Shape at rest of a rod whose number of elements is even.
    fn held(&self, n: usize, holding: &Holding) -> Configuration {
        let load = |(node, [moment, force]): (usize, [Vector3<f64>; 2])| Load {
            node,
            force,
            moment,
            frame: LoadFrame::Spatial,
            profile: Vec::new(),
        };
        let rod = RodParameters {
            gravity: holding.gravity,
            loads: ([n / 2, n].into_iter().zip(holding.wrenches).map(load)).collect(),
            ..self.rod(n)
        };
        equilibrium(&rod, 4).1
    }

    fn tip_at_rest(&self, n: usize, holding: &Holding) -> Vector3<f64> {
        self.held(n, holding).positions[n]
    }

    /// The shapes of the data, in their order.
    pub fn shapes(&self) -> Vec<Shape> {
        let text = fs::read_to_string(self.path("statics.csv")).unwrap();
        let rows: Vec<Vec<f64>> = (text.lines().skip(2))
            .map(|line| {
                line.split(',')
                    .skip(1)
                    .map(|word| word.parse().unwrap())
                    .collect()
            })
            .collect();
        let wrench = |rows: &[Vec<f64>], column: usize| {
            let numbers: Vec<f64> = rows.iter().map(|row| row[column]).collect();
            [vector(&numbers), vector(&numbers[3..])]
        };
        (rows.chunks_exact(6))
            .map(|rows| Shape {
                holding: Holding {
                    wrenches: [wrench(rows, 1), wrench(rows, 2)],
                    gravity: wrench(rows, 0)[1],
                },
                tip: wrench(rows, rows[0].len() - 1)[1],
            })
            .collect()
    }

    /// Distances of the tips of `n` elements from those of the data, over the length.
    pub fn static_errors(&self, n: usize, shapes: &[Shape]) -> Vec<f64> {
        let error = |shape: &Shape| (self.tip_at_rest(n, &shape.holding) - shape.tip).norm();
        (shapes.iter().map(error))
            .map(|error| error / self.length)
            .collect()
    }

    /// Distances by which the rounding of loads and positions moves tips of `n` elements, over the length: one draw a shape.
    pub fn static_rounding(&self, n: usize, shapes: &[Shape]) -> Vec<f64> {
        let mut dice = Dice(1);
        (shapes.iter())
            .map(|Shape { holding, .. }| {
                let moved = self.tip_at_rest(n, &holding.rounded(&mut dice));
                let shift = moved - self.tip_at_rest(n, holding) + dice.vector(ROUNDING);
                shift.norm() / self.length
            })
            .collect()
    }

    /// The motion of this number.
    pub fn release(&self, number: usize) -> Release {
        let text = fs::read_to_string(self.path(&format!("release_{number}.txt"))).unwrap();
        let mut rows = text.lines().map(|line| -> Vec<f64> {
            let words = line.split_whitespace();
            words.map(|word| word.parse().unwrap()).collect()
        });
        let (first, second) = (rows.next().unwrap(), rows.next().unwrap());
        let wrench = |from: usize| [vector(&second[from..]), vector(&second[from + 3..])];
        Release {
            damping: first[0],
            holding: Holding {
                wrenches: [wrench(1), wrench(7)],
                gravity: vector(&first[10..]),
            },
            tips: rows.map(|row| (row[0], vector(&row[10..]))).collect(),
        }
    }

    /// Root mean square over time of the distance of the tip from that of the data, over the length, for `n` elements and implicit steps of
    /// `step` (s).
    pub fn release_error(&self, n: usize, step: f64, release: &Release) -> f64 {
        let held = self.held(n, &release.holding);
        let free = Rod::new(&RodParameters {
            gravity: release.holding.gravity,
            internal_damping: release.damping,
            scheme: TimeScheme::Implicit,
            ..self.rod(n)
        })
        .unwrap();
        let mut motion = Stepper::new(&free, step, State::at_rest(held));
        let squares = release.tips.iter().map(|(t, tip)| {
            while (motion.step() as f64 + 0.5) * step < *t {
                motion.advance([NodeWrenches::NONE; 2]).unwrap();
            }
            (motion.state().configuration.positions[n] - tip).norm_squared()
        });
        (squares.sum::<f64>() / release.tips.len() as f64).sqrt() / self.length
    }
}

/// Root mean square.
pub fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
}

/// The value that half of them are not above.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[(sorted.len() - 1) / 2]
}
