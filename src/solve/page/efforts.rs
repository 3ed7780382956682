//! The actuators in the arm as a page shows them: their lines, and their efforts over time beside the bounds.

use serde_json::{Value, json};

use super::{FRAMES, ROWS, arrows};
use crate::mechanics::{Density, Drive, OfPose, PlacedFunction, Rod, SAME_PLACE, StrainActuator};
use crate::output::{Columns, MotionRecord, ReportArrow, ReportRoute};
use crate::solve::efforts::shape_of;
use crate::task::EffortControl;

/// Colors of curves by their names in the style sheet; a group with more curves begins anew.
const COLORS: [&str; 6] = ["x", "y", "z", "violet", "norm", "target"];

/// The actuators of a rod along a motion, for a page.
pub(super) struct Shown {
    /// Their lines and efforts in the picture.
    pub routes: Vec<ReportRoute>,
    /// Facts and curves, by kinds of actuators, for a template.
    pub groups: Value,
    /// Columns of the curves.
    pub columns: Columns,
    /// The fields at magnets.
    pub arrows: Vec<ReportArrow>,
}

/// Returns the efforts of all actuators of a rod for their inputs in a row of a record.
pub(super) fn of_inputs(
    rod: &Rod,
    record: &MotionRecord,
    row: usize,
    inputs: Vec<f64>,
) -> Vec<f64> {
    let shape = shape_of(record, row);
    rod.actuator_efforts(inputs, shape.poses())
}

/// Returns the actuators of `rod` along a motion; `efforts` gives those of all in a row of the record, `controls` are those
/// with bounds. Of a winch, whose input is a displacement, the tension is shown, without bounds.
pub(super) fn shown(
    rod: &Rod,
    record: &MotionRecord,
    controls: &[EffortControl],
    efforts: &dyn Fn(usize) -> Vec<f64>,
) -> Shown {
    let mut columns = Columns::new();
    if rod.actuators.is_empty() {
        return Shown {
            routes: Vec::new(),
            groups: Value::Array(Vec::new()),
            columns,
            arrows: Vec::new(),
        };
    }
    let largest = rod.largest_efforts();
    let frames: Vec<Vec<f64>> = (record.thinned_rows(FRAMES).into_iter())
        .map(efforts)
        .collect();
    let rows = record.thinned_rows(ROWS);
    let curves: Vec<Vec<f64>> = rows.iter().map(|&row| efforts(row)).collect();
    let t: Vec<f64> = rows.iter().map(|&row| record.t[row]).collect();
    let ends: Vec<f64> = t.first().into_iter().chain(t.last()).copied().collect();
    columns.insert("effort_t".into(), t);
    columns.insert("effort_ends".into(), ends.clone());
    let mut routes: Vec<ReportRoute> = Vec::new();
    // In the order of their first actuators.
    let mut groups: Vec<Group> = Vec::new();
    for (index, drive) in rod.actuators.iter().enumerate() {
        let own = ShownActuator::of(rod, index, drive, largest[index]);
        let column = |rows: &[Vec<f64>]| rows.iter().map(|row| row[index]).collect::<Vec<f64>>();
        let curve = column(&curves);
        let bound = (controls.iter())
            .find_map(|c| (c.actuator == index && drive.winch.is_none()).then_some(c.bounds));
        let kind = own.kind();
        let known = groups.iter().position(|group| group.kind == kind);
        let at = known.unwrap_or_else(|| {
            groups.push(Group {
                kind,
                members: Vec::new(),
                limits: Vec::new(),
            });
            groups.len() - 1
        });
        groups[at].add(&own, bound, &curve);
        columns.insert(own.column(), curve);
        routes.extend(own.line(column(&frames), &routes));
    }
    let groups = (groups.into_iter().enumerate())
        .map(|(number, group)| group.facts(number, ends.len(), &mut columns));
    let groups = groups.collect();
    Shown {
        routes,
        groups,
        columns,
        arrows: arrows::fields(rod, record, efforts),
    }
}

/// An actuator of a rod.
struct ShownActuator<'a> {
    rod: &'a Rod,
    index: usize,
    drive: &'a Drive,
    /// The actuator if it acts on strains, or else its functions of poses.
    strain: Option<&'a StrainActuator>,
    functions: Vec<&'a PlacedFunction>,
    /// Largest effort.
    largest: f64,
}

impl<'a> ShownActuator<'a> {
    fn of(rod: &'a Rod, index: usize, drive: &'a Drive, largest: f64) -> Self {
        Self {
            rod,
            index,
            drive,
            strain: rod.actuators.strains().get(index),
            functions: (rod.actuators.functions().iter())
                .filter(|own| own.actuator == Some(index))
                .collect(),
            largest,
        }
    }

    fn kind(&self) -> Kind {
        match self.strain {
            Some(own) => kind(&own.density),
            None => kind_of_pose(&self.functions, self.drive.unit),
        }
    }

    /// Returns the name of the column of its efforts.
    fn column(&self) -> String {
        format!("effort_{}", self.index)
    }

    /// Returns its facts for a template; `curve` are its efforts.
    fn facts(&self, color: &str, bound: Option<[f64; 2]>, curve: &[f64]) -> Value {
        // In words an effort that does not count is none.
        let told = |effort: f64| {
            if is_slack(effort, self.largest) {
                0.0
            } else {
                effort
            }
        };
        let slack = curve
            .iter()
            .filter(|effort| !is_magnet(&self.functions) && is_slack(**effort, self.largest))
            .count();
        json!({
            "name": self.drive.name,
            "column": self.column(),
            "color": color,
            "route": self.strain.map(|own| json!({
                "from": own.route.from,
                "to": own.end(),
                "offset": own.route.offset_from,
                "offset_to": own.further.last().unwrap_or(&own.route).offset_to,
                "turns": own.routes().map(|route| route.turns).sum::<f64>(),
            })),
            "poses": poses(self.rod, &self.functions),
            "bounds": bound,
            "least": told(curve.iter().copied().fold(f64::INFINITY, f64::min)),
            "most": told(curve.iter().copied().fold(f64::NEG_INFINITY, f64::max)),
            "slack": slack as f64 / curve.len().max(1) as f64,
            "last": told(curve.last().copied().unwrap_or(0.0)),
        })
    }

    /// Returns its line in the picture, if there is one that is not among `others`.
    fn line(&self, efforts: Vec<f64>, others: &[ReportRoute]) -> Option<ReportRoute> {
        match self.strain {
            Some(own) => Some(route(self.rod, own, self.largest, efforts)),
            None => pose_route(&self.functions, &self.drive.name, self.largest, efforts)
                // The components of a field belong to one magnet.
                .filter(|route| !others.iter().any(|own| own.is_same_magnet(route))),
        }
    }
}

/// The actuators of a kind, for a template, and the bounds of their efforts.
struct Group {
    kind: Kind,
    members: Vec<Value>,
    limits: Vec<f64>,
}

impl Group {
    fn add(&mut self, own: &ShownActuator, bound: Option<[f64; 2]>, curve: &[f64]) {
        let color = COLORS[self.members.len() % COLORS.len()];
        self.members.push(own.facts(color, bound, curve));
        for limit in bound
            .into_iter()
            .flatten()
            .filter(|limit| limit.is_finite())
        {
            if !self.limits.contains(&limit) {
                self.limits.push(limit);
            }
        }
    }

    /// Returns the facts of the group of this number; every bound becomes a column of `n_ends` equal numbers.
    fn facts(self, number: usize, n_ends: usize, columns: &mut Columns) -> Value {
        let limits: Vec<Value> = (self.limits.iter().enumerate())
            .map(|(i, limit)| {
                let column = format!("effort_bound_{number}_{i}");
                columns.insert(column.clone(), vec![*limit; n_ends]);
                json!({ "column": column, "value": limit })
            })
            .collect();
        json!({
            "word": self.kind.word,
            "title": self.kind.title,
            "unit": self.kind.unit,
            "members": self.members,
            "bounds": limits,
        })
    }
}

/// A kind of actuators as pages show it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Kind {
    /// Word for one of them, and for its lines in the picture.
    word: &'static str,
    /// Title of the chart of their efforts.
    title: &'static str,
    /// Name of their color in the style sheet.
    color: &'static str,
    /// Unit of their efforts.
    unit: &'static str,
}

/// Returns the kind of an actuator on strains.
fn kind(density: &Density) -> Kind {
    let [word, title, color] = match density {
        Density::Shortening | Density::Threaded { .. } | Density::Lengthening => {
            ["tendon", "Tensions", "tendon"]
        }
        Density::Volume => ["chamber", "Pressures", "chamber"],
        Density::Braid { .. } => ["braid", "Pressures in braids", "chamber"],
        Density::Muscle => ["muscle", "Activations", "muscle"],
        Density::Learned(_) => ["learned density", "Learned densities", "muscle"],
    };
    Kind {
        word,
        title,
        color,
        unit: density.effort_unit(),
    }
}

/// Returns the kind of an actuator on poses; those of one's own may have any unit, which is not told.
fn kind_of_pose(functions: &[&PlacedFunction], unit: &'static str) -> Kind {
    let ([word, title, color], unit) = match functions.first().map(|own| &own.function) {
        Some(OfPose::Magnet(_)) => {
            let title = match unit {
                "T/m" => "Components of the gradient of the field",
                _ => "Components of the field",
            };
            (["magnet", title, "magnet"], unit)
        }
        Some(OfPose::Cable(_)) => (["cable", "Tensions of cables", "cable"], unit),
        _ => (["actuator", "Efforts", "cable"], ""),
    };
    Kind {
        word,
        title,
        color,
        unit,
    }
}

fn is_magnet(functions: &[&PlacedFunction]) -> bool {
    matches!(
        functions.first().map(|own| &own.function),
        Some(OfPose::Magnet(_))
    )
}

/// Returns the facts of a template about the functions of an actuator on poses: where they are, and the vector that tells them.
fn poses(rod: &Rod, functions: &[&PlacedFunction]) -> Vec<Value> {
    let places = rod.places();
    (functions.iter())
        .map(|own| {
            let (moment, anchor) = match &own.function {
                OfPose::Magnet(magnet) => (Some(magnet.moment.norm() * own.weight), None),
                OfPose::Cable(cable) => (None, Some(<[f64; 3]>::from(cable.anchor))),
                OfPose::Own(_) => (None, None),
            };
            json!({ "at": places[own.node], "moment": moment, "anchor": anchor })
        })
        .collect()
}

/// Part of the largest effort below which an actuator is slack: far above the tolerance of a solve, and not to be seen in a picture.
const SLACK: f64 = 1e-4;

/// Tells whether an actuator, whose largest effort is `most`, does nothing that counts.
fn is_slack(effort: f64, most: f64) -> bool {
    effort.abs() <= SLACK * most
}

/// Returns the line of an actuator through the nodes that it passes, with its effort at the frames of the picture.
fn route(rod: &Rod, own: &StrainActuator, most: f64, efforts: Vec<f64>) -> ReportRoute {
    let places = rod.places();
    let nodes: Vec<usize> = (0..places.len())
        .filter(|&q| {
            places[q] >= own.route.from - SAME_PLACE && places[q] <= own.end() + SAME_PLACE
        })
        .collect();
    let length = rod.scales.length;
    ReportRoute {
        name: own.name.clone(),
        kind: kind(&own.density).word,
        color: kind(&own.density).color,
        first: nodes.first().copied().unwrap_or(0),
        offsets: (nodes.iter())
            .map(|&q| {
                let [x, y] = own.offset_at(places[q], length).map(|part| part as f32);
                [x, y, 0.0]
            })
            .collect(),
        anchor: None,
        moment: None,
        radius: radius(own),
        slack: efforts
            .iter()
            .map(|effort| is_slack(*effort, most))
            .collect(),
        most,
        efforts: efforts.into_iter().map(|effort| effort as f32).collect(),
    }
}

/// Returns the radius with which an actuator on strains is drawn, m; zero for a line.
fn radius(own: &StrainActuator) -> f64 {
    match own.density {
        // As wide as a circle of its area.
        Density::Volume => (own.scale / std::f64::consts::PI).sqrt(),
        Density::Braid { fibre, turns } => {
            (fibre * fibre - 1.0).max(0.0).sqrt() / (std::f64::consts::TAU * turns).abs()
        }
        Density::Shortening
        | Density::Threaded { .. }
        | Density::Lengthening
        | Density::Muscle
        | Density::Learned(_) => 0.0,
    }
}

/// Returns the picture of an actuator on poses; `None` of a function of one's own, of which nobody knows how it looks.
fn pose_route(
    functions: &[&PlacedFunction],
    name: &str,
    most: f64,
    efforts: Vec<f64>,
) -> Option<ReportRoute> {
    let first = functions.first()?;
    let (offsets, anchor, moment) = match &first.function {
        OfPose::Cable(cable) => {
            let offset: [f64; 3] = cable.offset.into();
            let offsets = vec![offset.map(|part| part as f32)];
            (offsets, Some(cable.anchor.into()), None)
        }
        OfPose::Magnet(magnet) => {
            let offsets = vec![[0.0; 3]; functions.len()];
            let way = magnet.moment.normalize();
            (offsets, None, Some(way.into()))
        }
        OfPose::Own(_) => return None,
    };
    let Kind { word, color, .. } = kind_of_pose(functions, "");
    Some(ReportRoute {
        name: name.into(),
        kind: word,
        color,
        first: first.node,
        offsets,
        anchor,
        moment,
        radius: 0.0,
        slack: (efforts.iter())
            .map(|effort| !is_magnet(functions) && is_slack(*effort, most))
            .collect(),
        most,
        efforts: efforts.into_iter().map(|effort| effort as f32).collect(),
    })
}
