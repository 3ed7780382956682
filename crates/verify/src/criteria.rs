//! The criteria of a certificate, and their limits.

use super::worse::worse;
use super::{ForwardCheck, contact, last_goal};
use control::{Enforcement, GoalPart, OptimalControlProblem, Stay};
use mechanics::StrainRule;
use serde::Serialize;
use sqp::{SADDLE_GAIN, SqpSettings};

/// Fraction of the limit of the energy residual below which the residual need not fall with the step.
const SMALL_ENERGY: f64 = 0.1;

/// One line of the certificate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CheckItem {
    /// Short name, as in the summary.
    pub name: &'static str,
    /// The value that was found, in `unit`.
    pub value: f64,
    /// The largest value that is acceptable, in `unit`.
    pub limit: f64,
    /// Unit of both; empty for pure numbers.
    pub unit: &'static str,
    /// The meaning of the criterion, in a sentence.
    #[serde(skip)]
    pub meaning: &'static str,
}

impl CheckItem {
    /// Returns the factor by which a grid of second order must be finer for the error to be within two thirds of its limit; at least two,
    /// since another grid has another solution.
    fn refinement(&self) -> f64 {
        (1.5 * self.value / self.limit).sqrt().clamp(2.0, 100.0)
    }

    /// Returns a remedy for the failed criterion, in the keys of the problem's scene.
    #[must_use]
    pub fn remedy(&self, problem: &OptimalControlProblem) -> String {
        let fixed = match self.name {
            "refined_space_m" if problem.rod.strain_rule == StrainRule::Trapezoidal => {
                "use rod.strain = \"helical\", or more rod.elements"
            }
            // The place where the wrench holds the arm changes with the elements.
            "refined_space_m" | "stays_m" | "refined_speed_m_s" | "refined_spin_rad_s" => {
                let elements = problem.rod.n_elements() as f64 * self.refinement();
                return format!("set rod.elements = {}", elements.ceil());
            }
            "refined_time_m" | "energy" | "energy_halving" => {
                let step = problem.grid.step / self.refinement();
                return format!("set time.step_s = {step:.2e}");
            }
            name if name.starts_with("kkt.") => {
                return format!(
                    "solve again, with a smaller solver.tolerance; where that changes nothing it is rounding, of a stiff arm: solver.tolerance = \
                     {:.0e} asks for what numbers of 16 digits can tell",
                    2.0 * self.value
                );
            }
            "stays_growth_1_s" => {
                "shorten task.stays_s, lower control.moment_max_n_m, or give the arm damping: moments that turn with the arm feed its motions"
            }
            "stiffer_contact_m" => {
                let factor = self.limit / (1.5 * self.value);
                return format!(
                    "multiply every penetration_m of [[contact]] by {factor:.2}, unless the bodies are as soft as that"
                );
            }
            "contact_through" => {
                "the arm passes through a body, or may: give its [[contact]] a smaller penetration_m, or a larger force_n"
            }
            "doubt" => {
                "give doubt.share a larger value, or the limits and the target more room; narrower ranges need better known numbers"
            }
            "momentum" => "the motion is not one of this rod: the files do not belong together",
            "second_order" => "solve again from elsewhere: --starts N, or another solver.guess",
            "same_grid_m" | "same_grid_rad" => {
                "the files were changed, or the motion is so unstable that it cannot be replayed"
            }
            "between_samples" => {
                "use a shorter time.step_s, more rod.elements, or a higher rate_hz of what is limited"
            }
            "controls.csv" | "trajectory.npz" | "summary.json" | "feedback.npz" => {
                "the file was changed, or belongs to another solution: solve again"
            }
            _ => "solve again, with a smaller solver.tolerance",
        };
        fixed.into()
    }

    /// Tells whether the value is within its limit; NaN is not.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.value <= self.limit
    }
}

/// Largest acceptable values; all of them are reported beside the values that were found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CheckLimits {
    /// Scaled KKT residuals.
    pub kkt: f64,
    /// Distance between the solution and its replay on the same grid, divided by the length of the rod.
    pub same_grid: f64,
    /// Derivative of the Lagrangian along a free duration, divided by its largest term.
    pub duration: f64,
    /// Estimated discretization error in time, and in space, divided by the length.
    pub refined: f64,
    /// Tip error of the replay against a hard target, divided by the length (rad for the orientation).
    pub tip: f64,
    /// Speed and angular speed of the tip of the finest rod at the end, divided by the highest ones before, beyond the tolerance of the
    /// goal. The turning of a single node contains the shortest waves, so that it converges last.
    pub rest: [f64; 2],
    /// Energy residual divided by the energy that passed through.
    pub energy: f64,
    /// Largest energy residual with the step halved, divided by the largest one: 1/4 for a method of second order, 1/2 for first, 1 for
    /// none. Not applied to a residual below a tenth of its limit.
    pub energy_halving: f64,
    /// Violation of a path constraint between nodes and samples, divided by the radius of obstacle and arm, or by the limit.
    pub between: f64,
    /// Possible gain at a saddle, divided by the objective.
    pub saddle_gain: f64,
}

impl CheckLimits {
    /// Returns the limits for a solution of these settings: those of optimality are proportional to the solver's tolerance, up to
    /// [`Self::LOOSEST_KKT`].
    #[must_use]
    pub fn of(settings: &SqpSettings) -> Self {
        let limits = Self::default();
        Self {
            kkt: settings.tolerance.clamp(limits.kkt, Self::LOOSEST_KKT),
            saddle_gain: settings.saddle_gain,
            ..limits
        }
    }

    /// Upper limit of the residuals of a stationary point, for any tolerance of a scene.
    pub const LOOSEST_KKT: f64 = 1e-3;
}

/// Usual limit of the violation of a path constraint between nodes and samples, divided by the radius of obstacle and arm, or by the limit.
pub(super) const BETWEEN: f64 = 0.01;

impl Default for CheckLimits {
    fn default() -> Self {
        Self {
            kkt: 1e-6,
            same_grid: 1e-9,
            duration: 1e-5,
            refined: 0.02,
            tip: 1e-4,
            rest: [0.2, 0.5],
            energy: 0.02,
            energy_halving: 0.8,
            between: BETWEEN,
            saddle_gain: SADDLE_GAIN,
        }
    }
}

/// Returns the criteria that [`ForwardCheck`] can tell at once, in the order of the terminal.
pub(super) fn criteria(
    problem: &OptimalControlProblem,
    check: &ForwardCheck,
    limits: &CheckLimits,
) -> Vec<CheckItem> {
    let judged = Judged {
        problem,
        check,
        limits,
        length: problem.rod.scales.length,
    };
    let mut items = Vec::new();
    items.extend(judged.optimality());
    items.extend(judged.same_grid());
    items.extend(judged.finer_grids());
    items.extend(judged.energy());
    items.push(judged.momentum());
    items.extend(judged.between_samples());
    items.extend(judged.contact());
    items.extend(judged.target());
    items.extend(judged.stay());
    items.extend(judged.rest());
    items.extend(judged.velocity());
    items
}

/// A check without criteria, and what it is measured by.
struct Judged<'a> {
    problem: &'a OptimalControlProblem,
    check: &'a ForwardCheck,
    limits: &'a CheckLimits,
    /// Length of the rod, m.
    length: f64,
}

impl Judged<'_> {
    fn optimality(&self) -> [CheckItem; 3] {
        let (kkt, limit) = (&self.check.kkt, self.limits.kkt);
        [
            item(
                "kkt.stationarity",
                kkt.stationarity,
                limit,
                "",
                "gradient of the Lagrangian, recomputed from the energy itself, divided by its largest term",
            ),
            item(
                "kkt.feasibility",
                kkt.feasibility,
                limit,
                "",
                "equations of motion (77), (81), target and bounds, recomputed, scaled",
            ),
            item(
                "kkt.complementarity",
                kkt.complementarity,
                limit,
                "",
                "slack of a bound times its multiplier, scaled",
            ),
        ]
    }

    fn same_grid(&self) -> [CheckItem; 2] {
        let limit = self.limits.same_grid;
        [
            item(
                "same_grid_m",
                self.check.same_grid,
                limit * self.length,
                "m",
                "largest distance of any node at any time from the forward simulation of the controls",
            ),
            item(
                "same_grid_rad",
                self.check.same_grid_turn,
                // Rotation of an element with this distance at one end.
                limit * self.problem.rod.n_elements() as f64,
                "",
                "largest distance of any rotation at any time from that of the forward simulation",
            ),
        ]
    }

    fn finer_grids(&self) -> [CheckItem; 2] {
        let limit = self.limits.refined * self.length;
        [
            item(
                "refined_time_m",
                self.check.refined_time,
                limit,
                "m",
                "estimated error of any node at any time from the time step (step halved)",
            ),
            item(
                "refined_space_m",
                self.check.refined_space,
                limit,
                "m",
                "estimated error of any node at any time from the elements (elements doubled)",
            ),
        ]
    }

    fn energy(&self) -> Vec<CheckItem> {
        // Without a potential there is no energy to balance.
        if !self.problem.rod.model.has_potential() {
            return Vec::new();
        }
        let energy = &self.check.energy;
        let mut items = vec![item(
            "energy",
            energy.relative_residual,
            self.limits.energy,
            "",
            "work in minus change of energy minus dissipation, divided by the energy that passed through",
        )];
        // As small as this it may be what the shortest waves do, which shorter steps only resolve.
        let is_small = energy.relative_residual <= SMALL_ENERGY * self.limits.energy;
        if !is_small {
            items.push(item(
                "energy_halving",
                energy.halving_ratio_largest,
                self.limits.energy_halving,
                "",
                "largest energy residual with the step halved, divided by the largest one: 1/4 for a method of second order",
            ));
        }
        items
    }

    fn momentum(&self) -> CheckItem {
        item(
            "momentum",
            self.check.momentum.over_rounding,
            1.0,
            "",
            "impulse in minus change of linear and angular momentum over any step, divided by the effect of rounding",
        )
    }

    fn between_samples(&self) -> Option<CheckItem> {
        let largest = (self.check.between.iter())
            .map(|between| between.excess.max(0.0) / between.reference)
            .reduce(worse)?;
        Some(item(
            "between_samples",
            largest,
            self.limits.between,
            "",
            "largest violation of a path constraint anywhere on the finest replay, divided by the radius or by the limit",
        ))
    }

    fn contact(&self) -> Vec<CheckItem> {
        let Some(contact) = &self.check.contact else {
            return Vec::new();
        };
        vec![
            item(
                "stiffer_contact_m",
                contact.stiffer_m,
                contact::SHOWN * self.limits.refined * self.length,
                "m",
                "distance of the tip at the end from that with twice the stiffness of all contacts: at most 0.29 of what bodies that are not rigid change",
            ),
            item(
                "contact_through",
                contact.through,
                contact::HELD,
                "",
                "largest depth in a body, anywhere along the arm and at any time, divided by the one from which on the arm is pushed out on the other side",
            ),
        ]
    }

    /// Returns the distance, m, and the angle, rad, that goals at the end allow to place and orientation; `None` where there is no such
    /// goal, or only a soft one.
    fn allowed(&self) -> [Option<f64>; 2] {
        let [place, turn] = [
            last_goal(self.problem, |goal| goal.position.map(|_| ())),
            last_goal(self.problem, |goal| goal.turns().then_some(())),
        ]
        .map(|goal| match goal?.1 {
            Enforcement::Hard => Some([0.0; 2]),
            Enforcement::Within {
                distance, angle, ..
            } => Some([distance, angle]),
            Enforcement::Soft { .. } => None,
        });
        [
            place.map(|[distance, _]| distance),
            turn.map(|[_, angle]| angle),
        ]
    }

    fn target(&self) -> Vec<CheckItem> {
        let limit = self.limits.tip;
        let [distance, angle] = self.allowed();
        let place = distance.map(|distance| {
            item(
                "tip_error_m",
                self.check.tip_error,
                distance + limit * self.length,
                "m",
                "distance of the simulated tip from the target",
            )
        });
        let turn = angle.map(|angle| {
            item(
                "tip_angle_rad",
                self.check.tip_angle,
                angle + limit,
                "rad",
                "angle between the simulated tip and the target orientation, or between its axis and the target direction",
            )
        });
        place.into_iter().chain(turn).collect()
    }

    fn stay(&self) -> Vec<CheckItem> {
        let (Some(held), Some(stay)) = (&self.check.stays, &self.problem.stay) else {
            return Vec::new();
        };
        let [distance, _] = self.allowed();
        let mut items = vec![item(
            "stays_m",
            held.tip_error,
            stay.distance + distance.unwrap_or(0.0),
            "m",
            "largest distance of the tip from the target after the task, with the last wrench held, on a finer grid",
        )];
        if self.problem.rod.is_held() {
            items.push(item(
                "stays_growth_1_s",
                self.check.held.map_or(f64::NAN, |held| held.rate()),
                Stay::ROOM.ln() / stay.seconds,
                "1/s",
                "rate at which small deviations from the held equilibrium grow on this grid or on a finer one, all motions counted; at its limit              they double over the stay",
            ));
        }
        items
    }

    fn velocity(&self) -> Vec<CheckItem> {
        let (target, allowed) = match last_goal(self.problem, |goal| goal.velocity) {
            Some((target, Enforcement::Within { speed, .. })) => (target, speed),
            Some((target, Enforcement::Hard)) => (target, 0.0),
            Some((_, Enforcement::Soft { .. })) | None => return Vec::new(),
        };
        let limit = allowed + self.limits.tip * self.problem.goal_scale(GoalPart::Velocity);
        let finest = &self.check.finest_tip;
        vec![
            item(
                "tip_velocity_m_s",
                self.check.tip_velocity_error,
                limit,
                "m/s",
                "difference of the velocity of the simulated tip at the end from the target velocity",
            ),
            item(
                "refined_velocity_m_s",
                (finest.velocity - target).norm(),
                limit + self.limits.rest[0] * finest.highest_speed,
                "m/s",
                "difference of the velocity of the tip at the end from the target velocity on a finer grid",
            ),
        ]
    }

    fn rest(&self) -> Vec<CheckItem> {
        let (problem, check) = (self.problem, self.check);
        let at_rest = last_goal(problem, |goal| goal.at_rest.then_some(()));
        let [speed, spin] = match at_rest {
            Some((_, Enforcement::Within { speed, spin, .. })) => [speed, spin],
            Some((_, Enforcement::Hard)) => [0.0; 2],
            Some((_, Enforcement::Soft { .. })) | None => return Vec::new(),
        };
        let speed = speed + self.limits.tip * problem.goal_scale(GoalPart::Velocity);
        let spin = spin + self.limits.tip * problem.goal_scale(GoalPart::AngularVelocity);
        let mut items = vec![
            item(
                "tip_speed_m_s",
                check.tip_speed,
                speed,
                "m/s",
                "speed of the simulated tip at the end",
            ),
            item(
                "tip_spin_rad_s",
                check.tip_spin,
                spin,
                "rad/s",
                "angular speed of the simulated tip at the end",
            ),
        ];
        // An arm that stays is followed after the task instead.
        if problem.stay.is_none() {
            let tip = &check.finest_tip;
            let [over_speed, over_spin] = self.limits.rest;
            items.push(item(
                "refined_speed_m_s",
                tip.speed,
                speed + over_speed * tip.highest_speed,
                "m/s",
                "speed of the tip at the end on a finer grid, where it should stop",
            ));
            items.push(item(
                "refined_spin_rad_s",
                tip.spin,
                spin + over_spin * tip.highest_spin,
                "rad/s",
                "angular speed of the tip at the end on a finer grid, where it should stop",
            ));
        }
        items
    }
}

fn item(
    name: &'static str,
    value: f64,
    limit: f64,
    unit: &'static str,
    meaning: &'static str,
) -> CheckItem {
    CheckItem {
        name,
        value,
        limit,
        unit,
        meaning,
    }
}
