//! The files of `softarm equilibrium`: summary, tables of the shape, of the strains and stresses of elements, and of the sweep.

use nalgebra::Vector3;
use serde::Serialize;

use super::statics::{Statics, StaticsOptions};
use crate::mechanics::diagnostics::ElementStress;
use crate::mechanics::rotation::{quaternion, wxyz};
use crate::mechanics::{
    Configuration, Critical, Energy, Kept, LoadedShape, Loss, Rod, Stability, State, Varied,
};
use crate::output::summary::{Range, SCHEMA_VERSION, TOOL, TipPose};
use crate::output::{MotionRecord, OutputError, ResultDirectory};

/// `summary.json` of `softarm equilibrium`.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct EquilibriumSummary {
    /// [`SCHEMA_VERSION`]
    pub schema_version: u32,
    /// [`TOOL`]
    pub tool: &'static str,
    /// `equilibrium`
    pub command: &'static str,
    /// Name of the scene.
    pub scene: String,
    /// `found`, or `cut` if the sweep ends early.
    pub status: &'static str,
    /// Rod model.
    pub model: &'static str,
    /// Strain rule.
    pub strain: &'static str,
    /// Number of elements.
    pub elements: usize,
    /// Time at which loads and a driven base are evaluated, s.
    pub time_s: f64,
    /// Loads that the load factor multiplies: `all`, `loads` or `gravity`.
    pub varied: Varied,
    /// Pose of the tip at load factor 1.
    pub tip: TipPose,
    /// Distance of the tip from its place at load factor 0, m.
    pub tip_displacement_m: f64,
    /// Estimated error of the node that moves most by the discretization in elements, m; absent if twice as many have another equilibrium.
    pub refined_space_m: Option<f64>,
    /// Length of the arcs between the nodes, m.
    pub length_m: f64,
    /// Dilatation of the elements: that of their arcs.
    pub dilatation: Range,
    /// Energy, J.
    #[serde(rename = "energy_J")]
    pub energy: StaticEnergy,
    /// Wrench of the base on the arm.
    pub base: BaseWrench,
    /// Wrench of what holds the tip on the arm; absent for a free tip.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tip_reaction: Option<BaseWrench>,
    /// Largest bending curvature of any element, 1/m, including rest curvature.
    pub curvature_max_1_m: f64,
    /// Largest twist of any element, 1/m, including rest twist.
    pub twist_max_1_m: f64,
    /// Effort and coordinate of the actuators; absent without any.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub actuators: Vec<ActuatorAtRest>,
    /// Stability under the present loads.
    pub stability: StabilitySummary,
    /// Number of unstable equilibria that the arm left on its way to this one, each to a side of less energy; absent if there were none.
    #[serde(skip_serializing_if = "is_zero")]
    pub left_saddles: usize,
    /// Place to which a node moves after a small push, if the equilibrium is not stable and another one was found, m.
    pub goes_to_m: Option<[f64; 3]>,
    /// That node: the tip, or the node that moves most where the tip is held.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub goes_to_node: Option<usize>,
    /// The load factor at which stability is lost.
    pub buckling: BucklingSummary,
    /// Equilibria at the load factors of the sweep.
    pub sweep: Vec<SweepPoint>,
    /// The reason why the sweep ends early.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sweep_cut: Option<String>,
    /// Wall time, s.
    pub wall_s: f64,
    /// The result directory.
    pub directory: String,
}

/// Energy of an arm at rest, J.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct StaticEnergy {
    /// Elastic.
    pub elastic: f64,
    /// Potential energy of gravity.
    pub potential: f64,
}

/// An actuator of an arm at rest.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct ActuatorAtRest {
    /// Its name.
    pub name: String,
    /// Effort, in its unit; zero for a slack tendon. Of a tendon with friction it is the tension where it leaves its motor.
    pub effort: f64,
    /// Tension where a tendon with friction ends, N, at the end of its last element.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub end_effort: Option<f64>,
    /// Coordinate less that of the stress-free shape.
    pub coordinate: f64,
}

/// Wrench of a held end on the arm.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct BaseWrench {
    /// Spatial frame, N.
    pub force_n: [f64; 3],
    /// Moment, frame of that end, N m.
    pub moment_n_m: [f64; 3],
}

/// Stability of an equilibrium.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct StabilitySummary {
    /// `stable`; `neutral`, where nothing brings the arm back and nothing grows; `unstable`; or `unknown`.
    pub verdict: &'static str,
    /// Smallest `ω²`, 1/s², of the symmetric part of the tangent stiffness and the inertia.
    pub squared_frequency_1_s2: Option<f64>,
    /// Lowest frequency without damping, Hz.
    pub first_frequency_hz: Option<f64>,
    /// Rate at which small deviations grow, 1/s, with damping.
    pub growth_rate_1_s: Option<f64>,
    /// The reason why they grow: the loads have no potential, or the arm topples or buckles under them.
    pub why: Option<&'static str>,
    /// Stiffness of a free tip along its softest direction against a dead force, N/m.
    pub tip_stiffness_n_m: Option<f64>,
}

/// The load factor at which stability is lost.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct BucklingSummary {
    /// Load factor from which stability was examined: 0, or 1 for an arm that is held elsewhere than its stress-free shape ends.
    pub from_factor: f64,
    /// Load factor; absent where none was found.
    pub factor: Option<f64>,
    /// `buckling`, `snapping` or `flutter`.
    pub how: Option<Loss>,
    /// Load factor up to which the equilibria are stable, if no loss was found.
    pub stable_up_to: Option<f64>,
    /// The reason why no larger factor was tried, if no loss was found: `to-the-end`, `out-of-range`, `not-followed` or `unloaded`.
    pub why: Option<Kept>,
}

/// An equilibrium of the sweep.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct SweepPoint {
    /// Load factor.
    pub factor: f64,
    /// Position of the tip, m.
    pub tip_m: [f64; 3],
    /// Stability of the equilibrium.
    #[serde(flatten)]
    pub stability: StabilitySummary,
    /// Tells whether the arm jumped to it, because the equilibria before end at a smaller factor.
    pub jumped: bool,
}

/// Reasons why small deviations grow.
const FALLS: &str = "the shape is no minimum of the energy, so that the arm topples or buckles";
const FED: &str = "a moment fixed in space or in the arm, or a force that turns with the arm, has no potential and feeds its motions; damping may \
                   hold them, and so may a load that has one";

/// Returns the verdict on a stability in a word.
fn verdict(stability: Option<&Stability>) -> &'static str {
    match stability {
        None => "unknown",
        Some(found) if found.is_stable => "stable",
        Some(found) if found.growth_rate.is_some() => "unstable",
        Some(_) => "neutral",
    }
}

impl StabilitySummary {
    fn of(stability: Option<&Stability>, tip_stiffness: Option<f64>) -> Self {
        Self {
            verdict: verdict(stability),
            squared_frequency_1_s2: stability.map(|found| found.least_squared_frequency),
            first_frequency_hz: stability
                .and_then(|found| found.first_frequency)
                .map(|omega| omega / std::f64::consts::TAU),
            growth_rate_1_s: stability.and_then(|found| found.growth_rate),
            why: stability
                .filter(|found| found.growth_rate.is_some())
                .map(|found| match found.has_potential {
                    true => FALLS,
                    false => FED,
                }),
            tip_stiffness_n_m: tip_stiffness,
        }
    }
}

impl BucklingSummary {
    fn of(critical: &Critical, from_factor: f64) -> Self {
        match *critical {
            Critical::Lost { factor, how } => Self {
                from_factor,
                factor: Some(factor),
                how: Some(how),
                stable_up_to: None,
                why: None,
            },
            Critical::Kept { factor, why } => Self {
                from_factor,
                factor: None,
                how: None,
                stable_up_to: Some(factor),
                why: Some(why),
            },
        }
    }
}

impl EquilibriumSummary {
    /// Creates the summary of statics; `names` are those of the scene and of the result directory.
    #[must_use]
    pub fn of(
        found: &Statics,
        options: &StaticsOptions,
        names: [String; 2],
        wall_s: f64,
    ) -> EquilibriumSummary {
        let [scene, directory] = names;
        let (rod, own) = (&found.rod, &found.own);
        let tip = rod.tip();
        let mut dilatation = Range::EMPTY;
        let mut length_m = 0.0;
        for (q, element) in rod.elements.iter().enumerate() {
            let ends = Rod::element_pose(q, &own.shape.positions, &own.shape.rotations);
            let ratio = rod.strain_rule.strain(element.length, &ends).linear[0].norm();
            dilatation.include(ratio);
            length_m += ratio * element.length;
        }
        let q = quaternion(&own.shape.rotations[tip]);
        let energy = Energy::of(rod, &State::at_rest(own.shape.clone()));
        let wrench = |node: usize| {
            let found = rod.static_reaction_at(node, &own.shape, options.time);
            BaseWrench {
                force_n: found.force.into(),
                moment_n_m: found.moment.into(),
            }
        };
        let (mut curvature, mut twist) = (0.0_f64, 0.0_f64);
        for (q, element) in rod.elements.iter().enumerate() {
            let ends = Rod::element_pose(q, &own.shape.positions, &own.shape.rotations);
            let bent = rod.strain_rule.strain(element.length, &ends).curvature;
            curvature = curvature.max(bent.xy().norm());
            twist = twist.max(bent.z.abs());
        }
        let is_stable = own.stability.is_some_and(|found| found.is_stable);
        let stiffness = found.tip_compliance.filter(|_| is_stable).map(|c| {
            (0.5 * (c + c.transpose()))
                .symmetric_eigenvalues()
                .max()
                .recip()
        });
        let start = found.sweep.first().unwrap_or(own);
        let goes_to = found.goes_to.as_ref().map(|there| {
            let places = &there.shape.positions;
            let node = match rod.has_free_tip() {
                true => tip,
                false => own.shape.farthest_node(places).0,
            };
            (node, places[node])
        });
        EquilibriumSummary {
            schema_version: SCHEMA_VERSION,
            tool: TOOL,
            command: "equilibrium",
            scene,
            status: if found.cut.is_some() { "cut" } else { "found" },
            model: rod.model.name(),
            strain: rod.strain_rule.name(),
            elements: rod.n_elements(),
            time_s: options.time,
            varied: options.varied,
            tip: TipPose {
                position_m: own.shape.positions[tip].into(),
                orientation_wxyz: wxyz(&q),
            },
            tip_displacement_m: (own.shape.positions[tip] - start.shape.positions[tip]).norm(),
            refined_space_m: found.refined_space,
            length_m,
            dilatation,
            energy: StaticEnergy {
                elastic: energy.elastic,
                potential: energy.potential,
            },
            base: wrench(0),
            tip_reaction: (!rod.has_free_tip()).then(|| wrench(tip)),
            curvature_max_1_m: curvature,
            twist_max_1_m: twist,
            actuators: actuators_at_rest(rod, &own.shape, options.time),
            stability: StabilitySummary::of(own.stability.as_ref(), stiffness),
            left_saddles: own.saddles,
            goes_to_m: goes_to.map(|(_, place)| place.into()),
            goes_to_node: goes_to.map(|(node, _)| node),
            buckling: BucklingSummary::of(&found.critical, found.from_factor),
            sweep: (found.sweep.iter())
                .map(|at| SweepPoint {
                    factor: at.factor,
                    tip_m: at.shape.positions[tip].into(),
                    stability: StabilitySummary::of(at.stability.as_ref(), None),
                    jumped: at.jumped,
                })
                .collect(),
            sweep_cut: found.cut.as_ref().map(ToString::to_string),
            wall_s,
            directory,
        }
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "as serde asks for it")]
fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// Returns efforts and coordinates of the actuators of an arm.
fn actuators_at_rest(rod: &Rod, shape: &Configuration, time: f64) -> Vec<ActuatorAtRest> {
    let state = rod.effort_state(shape.poses());
    let inputs = rod.actuators.efforts(time);
    let mut efforts = vec![0.0; rod.actuators.n_efforts()];
    rod.actuators.write_lines(&inputs, &state, &mut efforts);
    (rod.actuators
        .iter()
        .zip(rod.actuators.at_rest())
        .enumerate())
    .map(|(i, (actuator, at_rest))| ActuatorAtRest {
        name: actuator.name.clone(),
        effort: efforts[i],
        end_effort: end_tension(rod, i, &efforts),
        coordinate: state.coordinates[i] - at_rest,
    })
    .collect()
}

/// Returns the tension where a tendon with friction ends, N: behind the middle of its last element the path turns as much per length as before it.
///
/// With the tensions `T_a` and `T_b` in the middles of the last two elements, of the lengths `a` and `b`, it is `T_b (T_b/T_a)^(b/(a + b))`, since
/// `T_b/T_a = exp(-μ σ θ)` for the turn `θ` from one middle to the other.
fn end_tension(rod: &Rod, actuator: usize, efforts: &[f64]) -> Option<f64> {
    let own = (rod.actuators.rubbing()).find(|own| own.actuator == actuator)?;
    let last = own.n_pieces.checked_sub(1)?;
    let end = *efforts.get(own.line + last)?;
    if last == 0 || end == 0.0 {
        return Some(end);
    }
    let [a, b] = [last - 1, last].map(|piece| rod.elements[own.first + piece].length);
    Some(end * (end / efforts[own.line + last - 1]).powf(b / (a + b)))
}

/// Returns the sweep as a motion, with the load factor in the place of the time.
#[must_use]
pub(crate) fn sweep_record(
    found: &Statics,
    rod_at: impl Fn(f64) -> Rod,
    time: f64,
) -> MotionRecord {
    let mut record = MotionRecord::empty(found.rod.n_nodes());
    for LoadedShape { factor, shape, .. } in &found.sweep {
        record.push_at_rest(*factor, &rod_at(*factor), shape, time);
    }
    record
}

/// Writes `shape.csv`, `elements.csv` and `sweep.csv`.
///
/// # Errors
/// [`OutputError`] where a file cannot be written.
pub(crate) fn write_tables(
    result: &ResultDirectory,
    rod: &Rod,
    own: &Configuration,
    summary: &EquilibriumSummary,
) -> Result<(), OutputError> {
    let table = |name: &str, head: &str, rows: &mut dyn Iterator<Item = Vec<String>>| {
        let mut text = String::from(head);
        text.push('\n');
        for row in rows {
            text += &row.join(",");
            text.push('\n');
        }
        result.write_text(name, &text)
    };
    let mut nodes = (own.positions.iter().zip(&own.rotations).enumerate()).map(|(node, (x, r))| {
        let [w, i, j, k] = wxyz(&quaternion(r));
        let numbers = [rod.mesh.fraction(node), x.x, x.y, x.z, w, i, j, k];
        let mut row = vec![node.to_string()];
        row.extend(numbers.map(|value| value.to_string()));
        row
    });
    table("shape.csv", "node,s,x_m,y_m,z_m,qw,qx,qy,qz", &mut nodes)?;
    let mut elements = (rod.elements.iter().enumerate()).map(|(q, element)| {
        let ends = Rod::element_pose(q, &own.positions, &own.rotations);
        let stress = ElementStress::of(element, rod.strain_rule, &ends);
        let curvature = rod.strain_rule.strain(element.length, &ends).curvature;
        let three = |v: Vector3<f64>| [v.x, v.y, v.z].map(|value| value.to_string());
        let mut row = vec![q.to_string(), rod.mesh.along(q, 0.5).to_string()];
        for vector in [curvature, stress.linear_strain, stress.force, stress.moment] {
            row.extend(three(vector));
        }
        row
    });
    table(
        "elements.csv",
        "element,s,curvature_1_1_m,curvature_2_1_m,twist_1_m,shear_1,shear_2,stretch,shear_force_1_n,shear_force_2_n,tension_n,\
         bending_moment_1_n_m,bending_moment_2_n_m,twisting_moment_n_m",
        &mut elements,
    )?;
    let mut sweep = summary.sweep.iter().map(|point| {
        let [x, y, z] = point.tip_m;
        let number = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
        vec![
            point.factor.to_string(),
            x.to_string(),
            y.to_string(),
            z.to_string(),
            point.stability.verdict.to_string(),
            number(point.stability.squared_frequency_1_s2),
            number(point.stability.first_frequency_hz),
            number(point.stability.growth_rate_1_s),
            point.jumped.to_string(),
        ]
    });
    table(
        "sweep.csv",
        "factor,tip_x_m,tip_y_m,tip_z_m,verdict,squared_frequency_1_s2,first_frequency_hz,growth_rate_1_s,jumped",
        &mut sweep,
    )
}
