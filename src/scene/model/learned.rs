//! Densities that are learned from data: their keys, what they are in an arm, and the keys that describe them.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::SceneError;
use super::super::keys::{Checked, Keys, Needs, given, given_of};
use super::super::source::SceneSource;
use super::super::values::{Fraction, known};
use super::Scene;
use crate::mechanics::{Learned, LearnedBasis, LearnedPart, LearnedStrains};

/// A rest of the model that is learned from data: a potential `W(x)` in J per m of the arm, of its strains x, beside the elastic one; or with
/// `of` what actuators lack, so that a tendon is longer by `W(x)` m per m of the arm than its line in the section, and the coordinate of
/// another actuator less by it. `W(x) = Σ w φ(x)` is a sum of radial functions, which are zero away from the data, or of the functions of a
/// network with one hidden layer. `softarm fit` finds the weights w from measurements. Stress and stiffness are derivatives of W, in
/// simulations, solves and loops.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LearnedRest {
    /// Name in results, one for each. Absent: the word learned with its place in the list, from 0.
    pub name: Option<String>,
    /// Names of tendons, chambers, muscles and braids that it corrects, all by the same weights. Absent: the arm itself.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub of: Vec<String>,
    /// Start of the part of the arm that it describes, as a fraction of `rod.length_m` from the base. An element ends there. Default: 0.
    #[serde(default)]
    pub from: Fraction,
    /// End of the part, as a fraction, after `from`. An element ends there. Default: 1, the tip.
    #[serde(default = "Fraction::one")]
    pub to: Fraction,
    /// Strains on which it depends, each once: "bend_1" and "bend_2" in 1/m, about the axes of the section; with `of` instead of these "toward",
    /// the bending that shortens a tendon there, and "across"; "twist" in 1/m; "stretch", 0 at rest.
    pub strains: Vec<LearnedStrain>,
    /// Radial functions on a grid: [least, largest, number] for every strain, with centers at both ends; a number of 1 is one in the middle.
    pub grid: Option<Vec<[f64; 3]>>,
    /// Instead of `grid`: centers c of radial functions, each with a number for every strain.
    pub centers: Option<Vec<Vec<f64>>>,
    /// Radii h of radial functions, one for every strain: `φ = (1 - ρ)⁶ (35 ρ² + 18 ρ + 3)/3` at the distance ρ = |(x - c)/h| below 1, else 0.
    /// Default, with `grid`: three times the distance of its points.
    pub radii: Option<Vec<f64>>,
    /// Instead of radial functions: slopes a of `φ = sqrt(1 + z²) - 1`, `z = a·x + b`, each with a number for every strain.
    pub slopes: Option<Vec<Vec<f64>>>,
    /// Numbers b, one for every row of `slopes`.
    pub offsets: Option<Vec<f64>>,
    /// Weights w, one for every function, in J/m, or with `of` in the unit of the coordinate per m. Absent: zeros, which a fit begins with.
    #[serde(default)]
    pub weights: Vec<f64>,
    /// Instead of these arrays: a safetensors file with tensors of these names (`weights`, and `centers` and `radii`, or `slopes` and `offsets`),
    /// relative to the folder of the scene.
    pub file: Option<String>,
}

/// A strain of a section.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LearnedStrain {
    /// Bending about the first axis of the section, 1/m.
    #[serde(rename = "bend_1")]
    Bend1,
    /// Bending about the second axis, 1/m.
    #[serde(rename = "bend_2")]
    Bend2,
    /// Bending toward the line of an actuator, 1/m.
    Toward,
    /// Bending across it, 1/m.
    Across,
    /// Twist, 1/m.
    Twist,
    /// Axial strain.
    Stretch,
}

impl LearnedStrain {
    /// Returns its place among those of a density.
    fn place(self) -> usize {
        match self {
            Self::Bend1 | Self::Toward => 0,
            Self::Bend2 | Self::Across => 1,
            Self::Twist => 2,
            Self::Stretch => 3,
        }
    }

    fn is_of_line(self) -> bool {
        matches!(self, Self::Toward | Self::Across)
    }

    fn is_of_section(self) -> bool {
        matches!(self, Self::Bend1 | Self::Bend2)
    }

    /// Returns the strains that have these places.
    fn at(place: usize, frame: LearnedStrains) -> Self {
        match (place, frame) {
            (0, LearnedStrains::OfSection) => Self::Bend1,
            (1, LearnedStrains::OfSection) => Self::Bend2,
            (0, LearnedStrains::OfLine) => Self::Toward,
            (1, LearnedStrains::OfLine) => Self::Across,
            (2, _) => Self::Twist,
            _ => Self::Stretch,
        }
    }
}

/// Most functions of one density.
const MOST_FUNCTIONS: usize = 1000;
/// Radii of the functions on a grid, in distances of its points.
const GRID_RADIUS: f64 = 3.0;

/// Returns the points of a grid, the last strain changing first.
fn grid_points(grid: &[[f64; 3]]) -> Vec<Vec<f64>> {
    let mut out = vec![Vec::new()];
    for &[least, largest, n] in grid {
        let n = n as usize;
        let at = |k: usize| match n {
            1 => 0.5 * (least + largest),
            _ => least + (largest - least) * k as f64 / (n - 1) as f64,
        };
        out = (out.iter())
            .flat_map(|point| (0..n).map(|k| [&point[..], &[at(k)]].concat()))
            .collect();
    }
    out
}

impl LearnedRest {
    fn name(&self, index: usize) -> String {
        (self.name.clone()).unwrap_or_else(|| format!("learned {index}"))
    }

    /// Returns the centers of radial functions; `None` of others.
    fn centers(&self) -> Option<Vec<Vec<f64>>> {
        (self.centers.clone()).or_else(|| self.grid.as_deref().map(grid_points))
    }

    /// Returns the radii of radial functions, as given or those of a grid.
    fn radii(&self) -> Vec<f64> {
        let of_grid = || {
            let spacing = |&[least, largest, n]: &[f64; 3]| {
                GRID_RADIUS * (largest - least) / (n.max(2.0) - 1.0)
            };
            self.grid.iter().flatten().map(spacing).collect()
        };
        self.radii.clone().unwrap_or_else(of_grid)
    }

    /// Returns the number of functions.
    fn n_functions(&self) -> usize {
        match (&self.slopes, self.centers()) {
            (Some(slopes), _) => slopes.len(),
            (None, Some(centers)) => centers.len(),
            (None, None) => 0,
        }
    }

    /// Gives zero weights where there are none.
    fn complete(&mut self) {
        if self.weights.is_empty() {
            self.weights = vec![0.0; self.n_functions()];
        }
    }

    /// Returns the numbers of all strains of a density from those of the strains here.
    fn spread(&self, own: &[f64]) -> [f64; 4] {
        let mut out = [0.0; 4];
        for (strain, own) in self.strains.iter().zip(own) {
            out[strain.place()] = *own;
        }
        out
    }

    fn density(&self) -> Learned {
        let rows = |rows: &[Vec<f64>]| rows.iter().map(|row| self.spread(row)).collect();
        let basis = match &self.slopes {
            Some(slopes) => LearnedBasis::Ridge {
                slopes: rows(slopes),
                offsets: self.offsets.clone().unwrap_or_default(),
            },
            None => LearnedBasis::Radial {
                inverse_radii: self
                    .spread(&(self.radii().iter().map(|own| 1.0 / own)).collect::<Vec<_>>()),
                centers: rows(&self.centers().unwrap_or_default()),
            },
        };
        let of_line = self.strains.iter().any(|own| own.is_of_line());
        Learned {
            strains: match of_line {
                true => LearnedStrains::OfLine,
                false => LearnedStrains::OfSection,
            },
            basis,
            weights: self.weights.clone(),
        }
    }

    /// Returns the keys of a part of an arm whose actuators on strains have these names.
    fn describing(part: &LearnedPart, actuators: &[String]) -> Option<Self> {
        let own = &part.density;
        let used: Vec<usize> = (0..4)
            .filter(|&i| match &own.basis {
                LearnedBasis::Radial { inverse_radii, .. } => inverse_radii[i] != 0.0,
                LearnedBasis::Ridge { slopes, .. } => slopes.iter().any(|row| row[i] != 0.0),
            })
            .collect();
        let row = |row: &[f64; 4]| used.iter().map(|i| row[*i]).collect::<Vec<f64>>();
        let rows = |rows: &[[f64; 4]]| Some(rows.iter().map(row).collect());
        let (centers, radii, slopes, offsets) = match &own.basis {
            LearnedBasis::Radial {
                inverse_radii,
                centers,
            } => {
                let radii = row(&inverse_radii.map(|own| 1.0 / own));
                (rows(centers), Some(radii), None, None)
            }
            LearnedBasis::Ridge { slopes, offsets } => {
                (None, None, rows(slopes), Some(offsets.clone()))
            }
        };
        let of = part.of.iter().map(|index| actuators.get(*index).cloned());
        Some(Self {
            name: Some(part.name.clone()),
            of: of.collect::<Option<_>>()?,
            from: known(part.from),
            to: known(part.to),
            strains: (used.iter())
                .map(|&place| LearnedStrain::at(place, own.strains))
                .collect(),
            grid: None,
            centers,
            radii,
            slopes,
            offsets,
            weights: own.weights.clone(),
            file: None,
        })
    }
}

/// Describes the learned parts of an arm whose actuators on strains have these names; `None` for one that no scene has.
pub(in crate::scene) fn describe_learned(
    parts: &[LearnedPart],
    actuators: &[String],
) -> Option<Vec<LearnedRest>> {
    (parts.iter())
        .map(|part| LearnedRest::describing(part, actuators))
        .collect()
}

impl Scene {
    /// Returns the learned parts of the arm.
    pub(in crate::scene) fn learned_parts(&self) -> Vec<LearnedPart> {
        let names = self.strain_names();
        let index_of = |name: &String| names.iter().position(|own| own == name);
        (self.learned.iter().enumerate())
            .map(|(index, own)| LearnedPart {
                name: own.name(index),
                density: Arc::new(own.density()),
                of: own.of.iter().filter_map(index_of).collect(),
                from: own.from.get(),
                to: own.to.get(),
            })
            .collect()
    }

    /// Reads the files of learned densities, and gives zero weights where there are none.
    pub(in crate::scene) fn read_learned(
        &mut self,
        source: &SceneSource,
    ) -> Result<(), SceneError> {
        for (index, own) in self.learned.iter_mut().enumerate() {
            file::read(own, source, index)?;
            own.complete();
        }
        Ok(())
    }
}

impl Keys<'_> {
    /// Checks learned densities.
    pub(in crate::scene) fn check_learned(&self, scene: &Scene) -> Checked {
        let names = scene.strain_names();
        for (index, own) in scene.learned.iter().enumerate() {
            let section = format!("learned.{index}");
            self.check_strains(own, &section)?;
            self.check_functions(own, &section)?;
            self.part(&section, [own.from.get(), own.to.get()])?;
            let key = |name: &str| format!("{section}.{name}");
            for (at, name) in own.of.iter().enumerate() {
                let key = key(&format!("of.{at}"));
                if own.of[..at].contains(name) {
                    let message = format!("\"{name}\" is there twice");
                    return Err(self.source.error_at(&key, message, None));
                }
                if !names.contains(name) {
                    let message = format!("no actuator in the arm is named \"{name}\"");
                    let help = match names.is_empty() {
                        true => "leave `of` out for a rest of the arm itself".into(),
                        false => format!("it may correct {}", names.join(", ")),
                    };
                    return Err(self.source.error_at(&key, message, Some(help)));
                }
            }
            let earlier = scene.learned[..index].iter().enumerate();
            let mut others = names
                .iter()
                .cloned()
                .chain(earlier.map(|(at, own)| own.name(at)));
            let name = own.name(index);
            if others.any(|other| other == name) {
                let message =
                    format!("another actuator or learned density is named \"{name}\" too");
                let help = "give every one a name of its own";
                return Err((self.source).error_at(&key("name"), message, Some(help.into())));
            }
        }
        Ok(())
    }

    fn check_strains(&self, own: &LearnedRest, section: &str) -> Checked {
        let key = format!("{section}.strains");
        if own.strains.is_empty() {
            return Err(self.source.error_at(&key, "no strain", None).expecting(
                "expected some of \"bend_1\", \"bend_2\", \"toward\", \"across\", \"twist\", \"stretch\"",
            ));
        }
        for (at, strain) in own.strains.iter().enumerate() {
            let key = format!("{key}.{at}");
            if own.strains[..at].contains(strain) {
                return Err(self
                    .source
                    .error_at(&key, "a strain that is there twice", None));
            }
            if strain.is_of_line() && own.of.is_empty() {
                let message =
                    "bending toward and across the line of an actuator, without an actuator";
                let help = "name actuators in `of`, or take \"bend_1\" and \"bend_2\"";
                return Err((self.source).error_at(&key, message, Some(help.into())));
            }
            let line = own.strains[..at].iter().any(|other| other.is_of_line());
            let section = own.strains[..at].iter().any(|other| other.is_of_section());
            if (strain.is_of_line() && section) || (strain.is_of_section() && line) {
                let message =
                    "bending about the axes of the section and toward an actuator at once";
                let help = "take either \"bend_1\" and \"bend_2\" or \"toward\" and \"across\"";
                return Err((self.source).error_at(&key, message, Some(help.into())));
            }
        }
        Ok(())
    }

    /// Checks the numbers of the functions.
    fn check_functions(&self, own: &LearnedRest, section: &str) -> Checked {
        let key = |name: &str| format!("{section}.{name}");
        self.exactly_one(section, &given!(own: grid, centers, slopes))?;
        let [centers, slopes, grid] = given!(own: centers, slopes, grid);
        let [radii, offsets] = given!(own: radii, offsets);
        let radial = ("centers or grid", centers.1 || grid.1);
        self.relations(
            section,
            &[
                Needs(
                    centers,
                    radii,
                    "radial functions have a radius along every strain",
                ),
                Needs(slopes, offsets, "every row of slopes has a number b"),
                Needs(offsets, slopes, "they are the numbers b of its rows"),
                Needs(radii, radial, "they are the radii of radial functions"),
            ],
        )?;
        let n = own.strains.len();
        let wrong = |name: &str, found: usize, expected: usize, of: &str| {
            let message = format!("{found} numbers");
            Err((self.source)
                .error_at(&key(name), message, None)
                .expecting(format!("expected {expected}, one for every {of}")))
        };
        if let Some(grid) = &own.grid {
            if grid.len() != n {
                return wrong("grid", grid.len(), n, "strain");
            }
            for (at, &[least, largest, count]) in grid.iter().enumerate() {
                self.finite(&key(&format!("grid.{at}")), &[least, largest])?;
                if !(least < largest && count >= 1.0 && count.fract() == 0.0) {
                    return Err((self.source)
                        .error_at(&key(&format!("grid.{at}")), "no interval with points", None)
                        .expecting("expected [least, largest, number], the second above the first, the number whole and at least 1"));
                }
            }
            let many: f64 = grid.iter().map(|row| row[2]).product();
            if many > MOST_FUNCTIONS as f64 {
                return Err((self.source)
                    .error_at(&key("grid"), format!("{many} functions"), None)
                    .expecting(format!("expected at most {MOST_FUNCTIONS}")));
            }
        }
        for (name, rows) in [("centers", &own.centers), ("slopes", &own.slopes)] {
            for (at, row) in rows.iter().flatten().enumerate() {
                let name = format!("{name}.{at}");
                if row.len() != n {
                    return wrong(&name, row.len(), n, "strain");
                }
                self.finite(&key(&name), row)?;
            }
        }
        let count = own.n_functions();
        if count == 0 || count > MOST_FUNCTIONS {
            let name = if own.slopes.is_some() {
                "slopes"
            } else {
                "centers"
            };
            return Err((self.source)
                .error_at(&key(name), format!("{count} functions"), None)
                .expecting(format!("expected 1 to {MOST_FUNCTIONS}")));
        }
        if let Some(radii) = &own.radii {
            if radii.len() != n {
                return wrong("radii", radii.len(), n, "strain");
            }
            for (at, radius) in radii.iter().enumerate() {
                self.positive(&key(&format!("radii.{at}")), *radius, "radius", "")?;
            }
        }
        if let Some(offsets) = &own.offsets {
            if offsets.len() != count {
                return wrong("offsets", offsets.len(), count, "row of slopes");
            }
            self.finite(&key("offsets"), offsets)?;
        }
        if own.weights.len() != count {
            return wrong("weights", own.weights.len(), count, "function");
        }
        self.finite(&key("weights"), &own.weights)
    }
}

/// Files of weights.
mod file {
    use safetensors::{Dtype, SafeTensors};

    use super::{LearnedRest, SceneError, SceneSource, given, given_of};
    use crate::output::read_regular;

    /// Largest file, bytes.
    const LARGEST: u64 = 16 << 20;

    /// A tensor of a file.
    struct Array {
        shape: Vec<usize>,
        numbers: Vec<f64>,
    }

    /// Reads the arrays of a density from its file, if it has one.
    pub fn read(
        own: &mut LearnedRest,
        source: &SceneSource,
        index: usize,
    ) -> Result<(), SceneError> {
        let Some(name) = own.file.take() else {
            return Ok(());
        };
        let key = format!("learned.{index}.file");
        let refuse = |message: String, help: &str| {
            let help = (!help.is_empty()).then(|| help.to_string());
            source.error_at(&key, message, help)
        };
        let arrays = given!(own: grid, centers, radii, slopes, offsets);
        let both = given_of(&arrays).next().map(str::to_string);
        let both = both.or_else(|| (!own.weights.is_empty()).then(|| "weights".into()));
        if let Some(other) = both {
            let message = format!("file and {other} are two places of the same numbers");
            return Err(refuse(message, "leave one out"));
        }
        let path = source.beside(&name);
        let at = |words: String| format!("{}: {words}", path.display());
        let bytes =
            read_regular(&path, LARGEST).map_err(|error| refuse(at(error.to_string()), ""))?;
        let help = "a safetensors file has tensors weights [n], and centers [n, m] and radii [m], or slopes [n, m] and offsets [n], of F32 or F64";
        let tensors = SafeTensors::deserialize(&bytes)
            .map_err(|error| refuse(at(error.to_string()), help))?;
        let numbers = |name: &str, dimensions: usize| -> Result<Option<Array>, SceneError> {
            let Ok(own) = tensors.tensor(name) else {
                return Ok(None);
            };
            let shape = own.shape().to_vec();
            if shape.len() != dimensions {
                let words = format!("{name} has the shape {shape:?}, not {dimensions} dimensions");
                return Err(refuse(at(words), help));
            }
            let data = own.data();
            let numbers = match own.dtype() {
                Dtype::F64 => (data.chunks_exact(8))
                    .map(|own| f64::from_le_bytes(std::array::from_fn(|i| own[i])))
                    .collect(),
                Dtype::F32 => (data.chunks_exact(4))
                    .map(|own| f64::from(f32::from_le_bytes(std::array::from_fn(|i| own[i]))))
                    .collect(),
                other => {
                    let words = format!("{name} has numbers of the type {other:?}");
                    return Err(refuse(at(words), help));
                }
            };
            Ok(Some(Array { shape, numbers }))
        };
        let list = |name: &str| Ok(numbers(name, 1)?.map(|own| own.numbers));
        let rows = |name: &str| {
            let own = numbers(name, 2)?;
            Ok(own.map(|own| match own.shape[1] {
                0 => vec![Vec::new(); own.shape[0]],
                n => own.numbers.chunks(n).map(<[f64]>::to_vec).collect(),
            }))
        };
        let Some(weights) = list("weights")? else {
            return Err(refuse(at("no tensor is named weights".into()), help));
        };
        own.weights = weights;
        (own.centers, own.slopes) = (rows("centers")?, rows("slopes")?);
        (own.radii, own.offsets) = (list("radii")?, list("offsets")?);
        if own.centers.is_none() && own.slopes.is_none() {
            return Err(refuse(
                at("neither centers nor slopes are there".into()),
                help,
            ));
        }
        Ok(())
    }
}
