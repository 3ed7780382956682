//! Errors of a step.

use stop::Stop;

/// The reason why a step could not be taken, with node, step and time.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StepError {
    /// The discrete rotation has no regular solution.
    #[error(
        "node {node}, step {step} (t = {time} s): more than a quarter turn per step (h |moment| is {ratio:.3e} of the least \
         inertia, must stay below 1); shorten time.step_s, soften the load, or add elements"
    )]
    RotationTooLarge {
        /// Index of the rod's node.
        node: usize,
        /// Step, counted from 0.
        step: usize,
        /// Time at the start of the step, s.
        time: f64,
        /// `|h g| / min J`, which must be below 1.
        ratio: f64,
    },
    /// The given motion of a driven end is too fast for the step.
    #[error(
        "node {node}, step {step} (t = {time} s): the {end} turns {angle:.3e} rad in one step, must stay below a quarter turn; \
         shorten time.step_s or slow the {end} motion"
    )]
    EndTurnTooLarge {
        /// Index of the rod's node.
        node: usize,
        /// Name of the end, base or tip.
        end: &'static str,
        /// Step, counted from 0.
        step: usize,
        /// Time at the start of the step, s.
        time: f64,
        /// Rotation of the end in one step, rad.
        angle: f64,
    },
    /// An element is compressed so much that the time step no longer resolves its stiffness `EA/e²`.
    #[error(
        "element {element}, step {step} (t = {time} s): pressed to {dilatation:.3e} of its rest length, the time step resolves \
         {least:.3e}; shorten time.step_s or soften the load"
    )]
    ElementCollapsed {
        /// Index of the element, between nodes `element` and `element + 1`.
        element: usize,
        /// Step, counted from 0.
        step: usize,
        /// Time at the start of the step, s.
        time: f64,
        /// Dilatation of the element.
        dilatation: f64,
        /// Smallest dilatation that the step resolves: `h c/l`, with `c` the speed of axial waves.
        least: f64,
    },
    /// Newton's method for an implicit step did not converge.
    #[error(
        "node {node}, step {step} (t = {time} s): the implicit step leaves {residual:.1e} of the momentum after {iterations} \
         iterations; shorten time.step_s or soften the load"
    )]
    NotConverged {
        /// Index of the node with the largest residual.
        node: usize,
        /// Step, counted from 0.
        step: usize,
        /// Time at the start of the step, s.
        time: f64,
        /// Residual of the node, divided by the largest momentum of any node, linear or angular.
        residual: f64,
        /// Number of Newton iterations.
        iterations: usize,
    },
    /// The ends of an element have passed half a turn relative to each other, where the rotation vector of either strain rule ends.
    #[error(
        "element {element}, step {step} (t = {time} s): its ends have come past half a turn against each other, to {angle:.3} \
         rad; strains end there; soften the load, add elements, or shorten time.step_s"
    )]
    ElementFolded {
        /// Index of the element, between nodes `element` and `element + 1`.
        element: usize,
        /// Step, counted from 0.
        step: usize,
        /// Time at the start of the step, s.
        time: f64,
        /// Relative rotation of its ends at the end of the step, rad: above `π`.
        angle: f64,
    },
    /// An actuator has pressed the ends of an element together.
    #[error(
        "element {element}, step {step} (t = {time} s): its actuators press its ends together, to a stretch of {stretch:.3} along the arm; \
         lower the efforts, or stiffen the arm"
    )]
    ElementPressed {
        /// Index of the element, between nodes `element` and `element + 1`.
        element: usize,
        /// Step, counted from 0.
        step: usize,
        /// Time at the start of the step, s.
        time: f64,
        /// Component of the linear strain along the arm at the end of the step: at most 0.
        stretch: f64,
    },
    /// A force, moment or momentum is no longer finite.
    #[error(
        "node {node}, step {step} (t = {time} s): {quantity} is not finite; shorten time.step_s or check the loads"
    )]
    NotFinite {
        /// Index of the rod's node.
        node: usize,
        /// Step, counted from 0.
        step: usize,
        /// Time at the start of the step, s.
        time: f64,
        /// Name of the quantity.
        quantity: &'static str,
    },
    /// Contacts have given the arm energy that they never took up.
    #[error(
        "node {node}, step {step} (t = {time} s): what the arm touches has given it {gained:.3e} J from nowhere, and taken up {taken_up:.3e} J: at the \
         depths that the arm reaches, the bodies are too stiff for this step; shorten time.step_s, or give a [[contact]] a larger penetration_m or a \
         smaller force_n"
    )]
    ContactGives {
        /// Index of the node that is deepest in a body.
        node: usize,
        /// Step, counted from 0.
        step: usize,
        /// Time, s.
        time: f64,
        /// Energy from nowhere, J.
        gained: f64,
        /// Energy that the contacts have taken up, J.
        taken_up: f64,
    },
    /// The arm is so deep in a body that the contact allows steps that are too short for a run.
    #[error(
        "node {node}, step {step} (t = {time} s): the arm is {depth:.3e} m deep in {contact}, which is so stiff there that it allows steps up to \
         {allowed:.3e} s; give this [[contact]] a larger penetration_m or a smaller force_n, or let the arm begin farther away from it"
    )]
    ContactTooStiff {
        /// Index of the node that is deepest in a body.
        node: usize,
        /// Step, counted from 0.
        step: usize,
        /// Time, s.
        time: f64,
        /// Name of the contact.
        contact: String,
        /// Depth, m.
        depth: f64,
        /// The longest stable step, s.
        allowed: f64,
    },
    /// A stop signal ended the motion.
    #[error("stopped before the end: {0}")]
    Stopped(#[from] Stop),
}
