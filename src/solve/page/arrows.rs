//! Forces, moments and magnetic fields as arrows at the frames of a motion.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::FRAMES;
use super::fields::pose;
use crate::control::{Hold, OptimalControlProblem};
use crate::mechanics::{OfPose, Rod, StateView};
use crate::output::{ArrowKind, MotionRecord, ReportArrow};

/// Nodes with arrows of one name and kind, at most; of more, these are evenly spread.
const MOST_NODES: usize = 12;

/// Vectors of one name over the frames, by node.
struct Arrows<'a> {
    name: &'a str,
    n_frames: usize,
    /// Forces and moments, both in the spatial frame.
    by_node: BTreeMap<usize, [Vec<Vector3<f64>>; 2]>,
    /// Largest force and moment of a node between the frames, where they are known.
    peaks: BTreeMap<usize, [f64; 2]>,
}

impl<'a> Arrows<'a> {
    fn new(name: &'a str, n_frames: usize) -> Self {
        Self {
            name,
            n_frames,
            by_node: BTreeMap::new(),
            peaks: BTreeMap::new(),
        }
    }

    fn add(&mut self, frame: usize, node: usize, force: Vector3<f64>, moment: Vector3<f64>) {
        let zeros = || vec![Vector3::zeros(); self.n_frames];
        let [forces, moments] = (self.by_node.entry(node)).or_insert_with(|| [zeros(), zeros()]);
        forces[frame] += force;
        moments[frame] += moment;
    }

    fn note_peak(&mut self, node: usize, force: f64, moment: f64) {
        let peaks = self.peaks.entry(node).or_default();
        *peaks = [peaks[0].max(force), peaks[1].max(moment)];
    }

    fn finish(self) -> Vec<ReportArrow> {
        self.finish_as([ArrowKind::Force, ArrowKind::Moment])
    }

    fn finish_as(self, kinds: [ArrowKind; 2]) -> Vec<ReportArrow> {
        let mut out = Vec::new();
        for (part, kind) in kinds.into_iter().enumerate() {
            let acting: Vec<_> = (self.by_node.iter())
                .map(|(node, both)| (*node, &both[part]))
                .filter(|(_, vectors)| vectors.iter().any(|v| *v != Vector3::zeros()))
                .collect();
            let drawn = acting.len().min(MOST_NODES);
            for i in 0..drawn {
                // The last one is always among them.
                let (node, vectors) = acting[(i + 1) * acting.len() / drawn - 1];
                let drawn = vectors.iter().map(Vector3::norm).fold(0.0, f64::max);
                let known = (self.peaks.get(&node)).map_or(0.0, |peaks| peaks[part]);
                out.push(ReportArrow {
                    peak: drawn.max(known),
                    name: self.name.into(),
                    kind,
                    node: Some(node),
                    at: Vec::new(),
                    vectors: single(vectors),
                });
            }
        }
        out
    }
}

fn single(vectors: &[Vector3<f64>]) -> Vec<[f32; 3]> {
    vectors
        .iter()
        .map(|v| [v.x as f32, v.y as f32, v.z as f32])
        .collect()
}

/// Arrows of the controls.
pub(super) fn controls(
    problem: &OptimalControlProblem,
    coefficients: &[f64],
    record: &MotionRecord,
) -> Vec<ReportArrow> {
    let rows = record.thinned_rows(FRAMES);
    let signal = problem.signal(&problem.control, coefficients);
    let grid = problem.grid;
    let mut arrows = Arrows::new("control", rows.len());
    for (actuator, [force, moment]) in
        (problem.wrench_actuators().iter()).zip(largest_controls(problem, coefficients))
    {
        arrows.note_peak(actuator.node, force, moment);
    }
    for (frame, &row) in rows.iter().enumerate() {
        let (positions, rotations) = pose(record, row);
        let k = ((record.t[row] - grid.start) / grid.step).round().max(0.0) as usize;
        let at = signal.at(k.min(grid.n_steps));
        let view = StateView {
            rod: &problem.rod,
            time: record.t[row],
            positions: &positions,
            rotations: &rotations,
        };
        let acting = (at.iter().map(|(node, wrench)| (node, *wrench))).chain(at.acting_on(view));
        for (node, wrench) in acting {
            arrows.add(frame, node, wrench.force, rotations[node] * wrench.moment);
        }
    }
    arrows.finish()
}

/// Largest force (N) and moment (N m) of every wrench actuator.
pub(super) fn largest_controls(
    problem: &OptimalControlProblem,
    coefficients: &[f64],
) -> Vec<[f64; 2]> {
    let control = &problem.control;
    let wrenches = if control.hold == Hold::Cubic {
        problem.signal(control, coefficients).wrenches
    } else {
        // The size of a linear function is largest at an end.
        problem.wrenches(coefficients)
    };
    let n = problem.actuated_nodes().len();
    (0..n)
        .map(|at| {
            let own = wrenches.iter().skip(at).step_by(n);
            own.fold([0.0, 0.0], |m: [f64; 2], wrench| {
                [
                    m[0].max(wrench.force.norm()),
                    m[1].max(wrench.moment.norm()),
                ]
            })
        })
        .collect()
}

/// Force (N, spatial) and moment (N m, body frame) on the tip in a row.
#[cfg(feature = "cli")]
fn tip_wrench(record: &MotionRecord, row: usize) -> [Vector3<f64>; 2] {
    [&record.tip_force, &record.tip_moment]
        .map(|values| Vector3::from_column_slice(&values[3 * row..3 * row + 3]))
}

/// Arrows of the actuators of a closed loop at the tip.
#[cfg(feature = "cli")]
pub(super) fn on_tip(record: &MotionRecord) -> Vec<ReportArrow> {
    let rows = record.thinned_rows(FRAMES);
    let tip = record.n_nodes - 1;
    let mut arrows = Arrows::new("control", rows.len());
    for (frame, &row) in rows.iter().enumerate() {
        let (_, rotations) = pose(record, row);
        let [force, moment] = tip_wrench(record, row);
        arrows.add(frame, tip, force, rotations[tip] * moment);
    }
    for row in 0..record.n_rows() {
        let [force, moment] = tip_wrench(record, row);
        arrows.note_peak(tip, force.norm(), moment.norm());
    }
    arrows.finish()
}

/// Names of the loads that are given beside a control.
pub(super) const LOAD: &str = "load";

/// The loads, the `i`-th of them by the name `name(i)`, and the weight.
pub(super) fn given<'a>(
    rod: &Rod,
    record: &MotionRecord,
    name: impl Fn(usize) -> &'a str,
) -> Vec<ReportArrow> {
    let rows = record.thinned_rows(FRAMES);
    let mut by_name: BTreeMap<&str, Arrows> = BTreeMap::new();
    let weight = rod.gravity * rod.mass();
    let mut centers = Vec::new();
    for (frame, &row) in rows.iter().enumerate() {
        let (positions, rotations) = pose(record, row);
        for (i, load) in rod.loads.iter().enumerate() {
            let wrench = load.wrench(record.t[row], &rotations[load.node]);
            let moment = rotations[load.node] * wrench.moment;
            (by_name.entry(name(i)))
                .or_insert_with_key(|name| Arrows::new(name, rows.len()))
                .add(frame, load.node, wrench.force, moment);
        }
        centers.push(rod.center_of_mass(&positions));
    }
    let mut out: Vec<ReportArrow> = by_name.into_values().flat_map(Arrows::finish).collect();
    if weight != Vector3::zeros() {
        out.push(ReportArrow {
            name: "weight".into(),
            kind: ArrowKind::Force,
            node: None,
            at: single(&centers),
            vectors: single(&vec![weight; centers.len()]),
            peak: weight.norm(),
        });
    }
    out
}

/// The fields at the magnets, under the efforts of all actuators in a row of the record.
pub(super) fn fields(
    rod: &Rod,
    record: &MotionRecord,
    efforts: &dyn Fn(usize) -> Vec<f64>,
) -> Vec<ReportArrow> {
    let magnets: Vec<_> = (rod.actuators.functions().iter())
        .filter_map(|own| match (&own.function, own.actuator) {
            (OfPose::Magnet(magnet), Some(actuator)) => Some((own.node, magnet, actuator)),
            _ => None,
        })
        .collect();
    if magnets.is_empty() {
        return Vec::new();
    }
    let rows = record.thinned_rows(FRAMES);
    let mut arrows = Arrows::new("field", rows.len());
    for (frame, &row) in rows.iter().enumerate() {
        let (positions, _) = pose(record, row);
        let efforts = efforts(row);
        for (node, magnet, actuator) in &magnets {
            let field = magnet.field_at(&positions[*node]) * efforts[*actuator];
            arrows.add(frame, *node, field, Vector3::zeros());
        }
    }
    arrows.finish_as([ArrowKind::Field, ArrowKind::Moment])
}
