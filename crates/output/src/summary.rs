//! The summary objects: `summary.json`, and what `--json` prints.

mod check;

pub use self::check::{
    ActuatorSummary, CheckSummary, CostEstimate, MaterialSummary, NearestHeldSummary, OutputSize,
    ProblemSize, RestSummary, ScalesSummary, SolveCost, StaticNeedSummary,
};
use control::{Abandoned, ModelMismatch, TrackingError};
use mechanics::HOLDS;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use sqp::{Convergence, KktResidual, PhaseTimes, Progress};
use stop::Stop;

/// Version of the layout of every summary.
pub const SCHEMA_VERSION: u32 = 2;
/// The program that writes a result, as the summary in a result directory names it.
pub const TOOL: &str = mpc::TOOL;

/// Smallest and largest value over a run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Range {
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
}

impl Range {
    /// The empty range.
    pub const EMPTY: Self = Self {
        min: f64::INFINITY,
        max: f64::NEG_INFINITY,
    };

    /// Widens the range to hold `value`.
    pub fn include(&mut self, value: f64) {
        self.min = self.min.min(value);
        self.max = self.max.max(value);
    }
}

/// Pose of the tip at the end.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct TipPose {
    /// Position, m.
    pub position_m: [f64; 3],
    /// Orientation as a quaternion, scalar first.
    pub orientation_wxyz: [f64; 4],
}

/// Total energy over a run, J.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct EnergySummary {
    /// At the start.
    pub initial: f64,
    /// At the end.
    pub r#final: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
}

/// Summary of `simulate`.
#[derive(Clone, Debug, Serialize)]
pub struct SimulateSummary {
    /// [`SCHEMA_VERSION`]
    pub schema_version: u32,
    /// [`TOOL`]
    pub tool: &'static str,
    /// `simulate`
    pub command: &'static str,
    /// Name of the scene.
    pub scene: String,
    /// `completed`, `interrupted`, or `failed`.
    pub status: &'static str,
    /// Why the run failed, with node, step and time.
    pub error: Option<String>,
    /// Rod model.
    pub model: &'static str,
    /// Strain rule.
    pub strain: &'static str,
    /// Number of elements.
    pub elements: usize,
    /// Time step, s.
    pub step_s: f64,
    /// Steps taken, those before a resumption included.
    pub steps: usize,
    /// Wall time, s, since the start or the last resumption.
    pub wall_s: f64,
    /// Nodes times steps per second of the integrator's own time, without rows, extremes and files.
    pub node_steps_per_s: f64,
    /// Tip at the end; in a failed run, in the last row.
    pub tip: TipPose,
    /// Energy over the run, at every eighth step and the last.
    #[serde(rename = "energy_J")]
    pub energy: EnergySummary,
    /// Dilatation of any element over the run.
    pub dilatation: Range,
    /// Length of the polygon of nodes over the run, m.
    pub length_m: Range,
    /// Least distances from the obstacles of the scene, which the motion does not know; absent where there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub clearance: Vec<ClearanceSummary>,
    /// Largest depths in the bodies that the arm touches; absent where there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub contact: Vec<DepthSummary>,
    /// Energy, J, that the steps gave the arm from nowhere in contacts, and the energy that these took up; absent where the first is small.
    #[serde(rename = "contact_gives_J", skip_serializing_if = "Option::is_none")]
    pub contact_gives: Option<[f64; 2]>,
    /// Kinetic energy, J, that changes its sign from step to step at the end, if that is most of it; absent otherwise.
    #[serde(rename = "ringing_J", skip_serializing_if = "Option::is_none")]
    pub ringing: Option<f64>,
    /// A sentence on rows that are beyond what a learned density knows, which is among the warnings.
    #[serde(skip)]
    pub beyond_learned: Option<String>,
    /// Slack of the tendons on winches; absent where there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub slack: Vec<SlackSummary>,
    /// Sentences about what to know before and after the run.
    pub warnings: Vec<String>,
    /// The choice of the grid; absent if the scene gives it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accuracy: Option<AccuracySummary>,
    /// The result directory.
    pub directory: String,
}

/// The bodies that an arm touches, as far as they concern the step.
#[derive(Clone, Debug, Serialize)]
pub struct ContactFacts {
    /// Names, forces, N, and the penetrations at these, m.
    pub bodies: Vec<ContactFact>,
    /// Step that the contacts alone allow at their penetrations, s.
    pub step_s: f64,
    /// Stable step of the explicit integrator without them, s.
    pub stable_step_without_s: f64,
}

/// A body that an arm touches.
#[derive(Clone, Debug, Serialize)]
pub struct ContactFact {
    /// Name of the contact.
    pub contact: String,
    /// Force if all of the part that can touch is as deep as the penetration, N.
    pub force_n: f64,
    /// The penetration, m.
    pub penetration_m: f64,
}

impl ContactFacts {
    /// One line.
    #[must_use]
    pub fn in_words(&self) -> String {
        let bodies: Vec<String> = (self.bodies.iter())
            .map(|own| {
                let (force, depth) = (own.force_n, own.penetration_m);
                format!("{} pushes with {force:.3e} N at {depth:.3e} m", own.contact)
            })
            .collect();
        format!(
            "{}; it allows steps up to {:.3e} s (explicit without it: {:.3e} s)",
            bodies.join(", "),
            self.step_s,
            self.stable_step_without_s
        )
    }
}

/// Slack of a tendon on a winch.
#[derive(Clone, Debug, Serialize)]
pub struct SlackSummary {
    /// Name of the tendon.
    pub name: String,
    /// Fraction of the rows of `efforts.csv`, or of the time nodes of a solve, at which it has no tension.
    pub fraction: f64,
}

/// Distance of a node from a soft goal at its time.
#[derive(Clone, Debug, Serialize)]
pub struct SoftGoalSummary {
    /// Key of the goal.
    pub goal: String,
    /// Its weight.
    pub weight: f64,
    /// Distance from its position, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub left_m: Option<f64>,
    /// Angle to its orientation or direction, rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub left_rad: Option<f64>,
}

impl SoftGoalSummary {
    /// One line.
    #[must_use]
    pub fn in_words(&self) -> String {
        let parts = [(self.left_m, "m"), (self.left_rad, "rad")];
        let parts: Vec<String> = (parts.iter())
            .filter_map(|(left, unit)| Some(format!("{:.3e} {unit}", (*left)?)))
            .collect();
        let left = if parts.is_empty() {
            "nothing but its motion".into()
        } else {
            parts.join(" and ")
        };
        format!(
            "{} is soft, of weight {:.3e}: {left} left",
            self.goal, self.weight
        )
    }
}

/// Nearest approach of a simulated arm to an obstacle, at the times that have a row.
#[derive(Clone, Debug, Serialize)]
pub struct ClearanceSummary {
    /// Name of the obstacle.
    pub obstacle: String,
    /// Least distance between their surfaces, m; negative inside.
    pub least_m: f64,
    /// Time, s.
    pub at_s: f64,
    /// Place on the arm, as a fraction of its length from the base.
    pub place: f64,
}

impl ClearanceSummary {
    /// One line.
    #[must_use]
    pub fn in_words(&self) -> String {
        format!(
            "{}: the arm comes as near as {:.4e} m, at t = {:.4} s and {:.2} of its length",
            self.obstacle, self.least_m, self.at_s, self.place
        )
    }
}

/// Largest depth of a simulated arm in a body that it touches, anywhere along it.
#[derive(Clone, Debug, Serialize)]
pub struct DepthSummary {
    /// Name of the contact.
    pub contact: String,
    /// Largest depth of a chord after any step, m; negative: the distance that is left, at the times that have a row.
    pub penetration_m: f64,
    /// The same, divided by the penetration of the scene.
    pub over_penetration: f64,
    /// The depth divided by that at which the center line of the arm comes to the middle of the body, beyond which it is pushed out on the other side.
    pub through: f64,
    /// Shortest step that all contacts together allow at a time when the arm touches this one, or at their penetrations, s.
    pub allows_step_s: f64,
    /// Time, s.
    pub at_s: f64,
    /// Place on the arm, as a fraction of its length from the base.
    pub place: f64,
}

/// Elements that leave this range of dilatations are outside what any [model](mechanics::RodModel) describes: a
/// section of constant volume or size, and a linear material.
const CREDIBLE_DILATATION: [f64; 2] = [0.5, 2.0];

impl SimulateSummary {
    /// Says that elements left the range of dilatations in which any [model](mechanics::RodModel) describes them.
    fn stretched(&self) -> Option<String> {
        let [least, largest] = CREDIBLE_DILATATION;
        let found = &self.dilatation;
        (found.min < least || found.max > largest).then(|| {
            format!(
                "elements went from {:.3e} to {:.3e} of their length; rod models hold within about 0.7 to 1.3, and the standard \
                 one lets an element turn inside out; soften the loads, or stiffen the rod",
                found.min, found.max
            )
        })
    }

    /// Returns what to know about lengths of elements, depths in bodies and waves after the run.
    #[must_use]
    pub fn concerns(&self) -> Vec<String> {
        let mut out = Vec::new();
        if let Some(ringing) = self.ringing {
            out.push(format!(
                "time.step_s: at the end {ringing:.3e} J of kinetic energy change their sign from step to step, in waves that implicit steps of \
                 {:.3e} s do not resolve and no damping takes; let what jumps grow over several steps, as a displacement or a load, or give a \
                 shorter step_s",
                self.step_s
            ));
        }
        if let Some([gained, taken_up]) = self.contact_gives {
            out.push(format!(
                "contact: the steps gave the arm {gained:.3e} J from nowhere, {:.1} % of the {taken_up:.3e} J that contacts took up; give a shorter \
                 time.step_s, or a larger penetration_m",
                100.0 * gained / taken_up
            ));
        }
        out.extend(self.stretched());
        out.extend(self.beyond_learned.clone());
        for contact in &self.contact {
            if !(contact.through <= HOLDS) {
                out.push(format!(
                    "{}: the arm comes {:.0} % of the way to its middle, at t = {:.4} s and {:.2} of its length, and is pushed out on the other side beyond it; \
                     give it a smaller penetration_m, or a larger force_n",
                    contact.contact,
                    100.0 * contact.through,
                    contact.at_s,
                    contact.place
                ));
            }
            if self.step_s > contact.allows_step_s {
                out.push(format!(
                    "{}: at the largest depth it is so stiff that steps are stable up to {:.3e} s alone; give a time.step_s below that, a larger \
                     penetration_m, or a smaller force_n",
                    contact.contact, contact.allows_step_s
                ));
            }
        }
        out
    }
}

impl DepthSummary {
    /// One line.
    #[must_use]
    pub fn in_words(&self) -> String {
        let (at, place) = (self.at_s, self.place);
        if self.penetration_m <= 0.0 {
            return format!(
                "{}: the arm does not touch it, {:.4e} m away",
                self.contact, -self.penetration_m
            );
        }
        format!(
            "{}: the arm touches it and is at most {:.4e} m deep in it, {:.2} of its penetration_m, at t = {at:.4} s and {place:.2} of its length",
            self.contact, self.penetration_m, self.over_penetration
        )
    }
}

/// The choice of elements and step if a scene asks for an accuracy; all errors are divided by the length.
#[derive(Clone, Debug, Serialize)]
pub struct AccuracySummary {
    /// The accuracy that the scene asks for.
    pub asked: f64,
    /// Estimated error of any place of the arm at any time.
    pub error: f64,
    /// Tells whether the error is within that accuracy.
    pub met: bool,
    /// The part of the error that elements make.
    pub error_of_elements: f64,
    /// The part that steps make.
    pub error_of_steps: f64,
    /// The grids that were tried, in order.
    pub levels: Vec<Level>,
    /// The choice in words, with its reason.
    pub why: String,
}

/// A grid that a search for an accuracy tried.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Level {
    /// Its elements.
    pub elements: usize,
    /// Its step, s.
    pub step_s: f64,
    /// Estimated error, over the length; absent where nothing was compared with it.
    pub error: Option<f64>,
}

/// Seconds per phase of a solve.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct PhaseSummary {
    /// The solver's own phases.
    #[serde(flatten)]
    pub solver: PhaseTimes,
    /// The forward check.
    pub certify: f64,
    /// Feedback gains and sensitivity; with several threads beside the check.
    pub feedback: f64,
}

/// Largest growth of the norm of a perturbation of the initial state.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SensitivitySummary {
    /// Up to the end of the horizon.
    pub horizon: f64,
    /// Up to any edge of the blocks.
    pub worst: f64,
}

impl SensitivitySummary {
    /// Returns the summary of the growth up to every edge of the blocks.
    #[must_use]
    pub fn of(growth: &[f64]) -> Self {
        Self {
            horizon: growth.last().copied().unwrap_or(f64::NAN),
            worst: growth.iter().copied().fold(f64::NAN, f64::max),
        }
    }
}

/// The forward check in the summary: what it found, or that there was no time for it.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum CheckRecord {
    /// The check was made.
    Made(Value),
    /// The check was not made, or not to its end.
    NotChecked {
        /// `not checked`
        verdict: &'static str,
        /// Why.
        reason: String,
    },
}

impl CheckRecord {
    /// A check that was not made to its end.
    #[must_use]
    pub fn not_checked(stop: Stop) -> Self {
        Self::NotChecked {
            verdict: NOT_CHECKED,
            reason: stop.to_string(),
        }
    }
}

/// The verdict on what there was no time to check.
pub const NOT_CHECKED: &str = "not checked";

/// Tells of a summary whether the solve was checked: one that was stopped before says that it was not, and nothing about tips and energies.
#[must_use]
pub fn was_checked(summary: &Value) -> bool {
    let check = &summary["check"];
    !check.is_null() && check["verdict"] != NOT_CHECKED
}

/// Staying after the task, with the last wrench held.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StaysSummary {
    /// Duration of the stay, s.
    pub seconds: f64,
    /// Largest distance of the tip from its target during the stay, m.
    pub allowed_m: f64,
    /// The wrench that is held on every actuated node: force (N, spatial frame) and moment (N m, body frame); absent without one.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub wrench: Vec<[f64; 6]>,
    /// The controls that are held, in the order of `controls.csv`.
    pub controls: Vec<NamedValue>,
    /// Tells whether the equilibrium under these wrenches is stable: no small deviation grows, on the solution's grid or one of twice the
    /// elements.
    pub stable: bool,
    /// Rate at which deviations grow on either grid, 1/s; absent where none does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub growth_rate_1_s: Option<f64>,
    /// Largest compliance of the tip there, m/N.
    pub tip_compliance_m_n: f64,
    /// The motion after the task on a finer grid; absent without a check.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tip_error_m: Option<LargestDistance>,
    /// Largest speed of any node meanwhile.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub node_speed_m_s: Option<LargestSpeed>,
    /// Distance that the tip can reach from where the wrench holds it with the energy in which it arrives, m, to second order.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub energy_bound_m: Option<f64>,
    /// `stays`, `leaves`, or `not checked`.
    pub verdict: &'static str,
}

/// The value of a control.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NamedValue {
    /// Name of the [control](control::NamedControl).
    pub name: String,
    /// Its unit; `1` for a pure number.
    pub unit: &'static str,
    /// Value: a force, a moment, or a whole effort.
    pub value: f64,
}

/// Largest distance over a time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LargestDistance {
    /// m
    pub max: f64,
    /// Time, in s after the task.
    pub at_s: f64,
}

/// Largest speed over a time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LargestSpeed {
    /// m/s
    pub max: f64,
}

/// A constraint by name, with how far it is from holding.
#[derive(Clone, Debug, Serialize)]
pub struct NamedConstraint {
    /// Scene key, and what of it.
    pub name: String,
    /// Node of the rod.
    pub node: usize,
    /// Time, s.
    pub time_s: f64,
    /// Amount of the violation (bounds: negative inside).
    pub amount: f64,
    /// Its unit.
    pub unit: &'static str,
    /// Multiplier of the scaled constraint.
    pub multiplier: f64,
}

/// One start of a solve.
#[derive(Clone, Debug, Serialize)]
pub struct StartSummary {
    /// Its number, from 0.
    pub start: usize,
    /// Name of the first point.
    pub from: &'static str,
    /// The end of the solve.
    pub status: &'static str,
    /// Value of the objective.
    pub objective: f64,
    /// Iterations.
    pub iterations: usize,
    /// Result of the check; absent if a better solution was certified before.
    pub verdict: Option<&'static str>,
}

/// One solve of the start that the result is from.
#[derive(Clone, Debug, Serialize)]
pub struct AttemptSummary {
    /// Name of the first point.
    pub from: String,
    /// Iterations it took.
    pub iterations: usize,
    /// Outcome; for a start that is not the result, the reason why it was given up, or the point to which it led.
    pub ended: String,
    /// Tells whether it is the result.
    pub is_result: bool,
}

/// End of the tip in the forward simulation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TipEnd {
    /// Distance of the tip from its target, m.
    pub tip_error_m: f64,
    /// Angle from the target orientation or direction, rad.
    pub tip_angle_rad: f64,
    /// Speed of the tip at the end, m/s.
    pub tip_speed_m_s: f64,
}

/// The part of a summary that follows from the motion and its check.
#[derive(Clone, Debug, Serialize)]
pub struct Reached {
    /// End of the tip; NaN without a check.
    #[serde(flatten)]
    pub tip: TipEnd,
    /// Staying after the task; absent where the arm need not stay.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stays: Option<StaysSummary>,
    /// Errors along every path of `[[objective.track]]`, in their order; absent if there is none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub tracking: Vec<TrackingError>,
    /// Residuals of soft goals; absent if there is none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub soft_goals: Vec<SoftGoalSummary>,
    /// Slack of the tendons on winches; absent where there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub slack: Vec<SlackSummary>,
    /// The forward check; absent when it could not be made.
    pub check: Option<CheckRecord>,
}

/// The part of a summary that follows from the regulator.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct RegulatorFacts {
    /// Growth of perturbations without feedback, in the norm of their energy; absent if no gains were computed.
    pub open_loop_sensitivity: Option<SensitivitySummary>,
    /// Growth of perturbations with feedback, in the same norm; absent if no gains were computed.
    pub closed_loop_sensitivity: Option<SensitivitySummary>,
}

/// The part of a summary that follows from the discrete problem and the multipliers of its target.
#[derive(Clone, Debug, Serialize)]
pub struct ProblemFacts {
    /// Rod model.
    pub model: &'static str,
    /// Strain rule.
    pub strain: &'static str,
    /// Number of elements.
    pub elements: usize,
    /// Time step, s.
    pub step_s: f64,
    /// Steps of the horizon.
    pub steps: usize,
    /// Duration of the horizon, s: where it is free, the one that was found.
    pub duration_s: f64,
    /// Blocks of the control.
    pub control_blocks: usize,
    /// Variables of the solver: the controls, and the residuals of soft goals and of goals within a tolerance.
    pub variables: usize,
    /// Multipliers of the target's scaled residuals, in the order position, orientation, velocity, angular velocity.
    pub multipliers: Vec<f64>,
}

/// Summary of `solve`.
#[derive(Clone, Debug, Serialize)]
pub struct SolveSummary {
    /// [`SCHEMA_VERSION`]
    pub schema_version: u32,
    /// [`TOOL`]
    pub tool: &'static str,
    /// `solve`
    pub command: &'static str,
    /// Name of the scene.
    pub scene: String,
    /// The status of the solver.
    pub status: &'static str,
    /// Message in words, if there is more to say.
    pub message: Option<String>,
    /// The nearest point to the target at which the arm can be held, where nothing was found that holds it at the target as it should, or no
    /// motion that reaches the target.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nearest: Option<NearestHeldSummary>,
    /// Remarks on the motion if the solve did not converge, or the check rejects it: places, amounts, and changes that may help.
    pub advice: Vec<String>,
    /// Iterations.
    pub iterations: usize,
    /// Value of the objective.
    pub objective: f64,
    /// Wall time, s.
    pub wall_s: f64,
    /// Median wall time of an iteration, s.
    pub iteration_s: f64,
    /// Times of the phases.
    pub phases_s: PhaseSummary,
    /// The solver's own residuals.
    pub kkt: KktResidual,
    /// Ratio of the last two steps, and the observed order of convergence.
    pub convergence: Convergence,
    /// The results of the motion, and the check of it.
    #[serde(flatten)]
    pub reached: Reached,
    /// The choice of the grid; absent if the scene gives it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accuracy: Option<AccuracySummary>,
    /// Tells whether residuals were still decreasing when a solve was stopped.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub progress: Option<Progress>,
    /// Every how many time nodes the motion of a solve that was stopped has a row, where that is not every one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps_per_row: Option<usize>,
    /// Growth of perturbations.
    #[serde(flatten)]
    pub sensitivities: RegulatorFacts,
    /// Final positions of the tip on arms that differ from the model, with and without the gains; absent if no gains were computed.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub model_mismatch: Vec<ModelMismatch>,
    /// The worst constraints by name.
    pub worst_constraints: Vec<NamedConstraint>,
    /// The form of the quadratic subproblems.
    pub qp_backend: &'static str,
    /// The Hessian of the quadratic subproblems.
    pub hessian: &'static str,
    /// The first point of the result.
    pub guess: &'static str,
    /// Solves from other first points that were given up before; `iterations` has theirs as well.
    pub abandoned: Vec<Abandoned>,
    /// All solves of this start, in the order in which they were made; `iterations.csv` counts them from 1.
    pub attempts: Vec<AttemptSummary>,
    /// The end of every start.
    pub starts: Vec<StartSummary>,
    /// The discrete problem.
    #[serde(flatten)]
    pub facts: ProblemFacts,
    /// The result directory.
    pub directory: String,
}
