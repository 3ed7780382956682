//! The plant: the system that a controller acts on.

use super::command::{Command, ControlList, ControlOrder, Controls, Placed};
use super::transfer::Transfer;
use mechanics::{Rod, State, StepError, Stepper, TimeGrid, Wrench};

/// A system that executes commands and reports its state: a simulated arm, another simulator, or hardware.
pub trait Plant {
    /// Error of a command that could not be applied.
    type Error;

    /// Applies a command from its start to its end.
    ///
    /// # Errors
    /// Returns an error if the command cannot be applied.
    fn apply(&mut self, command: &Command) -> Result<(), Self::Error>;

    /// Returns the present state on the nodes of the controller's model.
    fn measure(&mut self) -> State;
}

/// A simulated arm: a rod with its own grid, step, stiffness, mass and damping, which the controller knows only by a model with other
/// elements.
#[derive(Clone, Debug)]
pub struct RodPlant<'a> {
    rod: &'a Rod,
    stepper: Stepper<'a>,
    step: f64,
    transfer: Transfer,
    /// Nearest own node of every node of the model.
    nearest: Vec<usize>,
    order: ControlOrder,
    /// The last command and its controls, on the nodes of the order.
    command: Command,
    placed: Placed,
    controls: [Controls; 2],
}

impl<'a> RodPlant<'a> {
    /// Creates an arm that starts at time 0 from `initial`, a state on its own nodes, with steps of at most `longest_step` (s) that divide
    /// the sample period; `model` is the rod of the controller.
    #[must_use]
    pub fn new(rod: &'a Rod, initial: State, period: f64, longest_step: f64, model: &Rod) -> Self {
        let step = TimeGrid::covering(period, longest_step, 1).step;
        let transfer = Transfer::new(rod, model);
        Self {
            stepper: Stepper::new(rod, step, initial),
            nearest: transfer.nearest(),
            transfer,
            order: ControlOrder::on(Vec::new(), rod),
            command: Command::default(),
            placed: Placed::default(),
            controls: [Controls::default(), Controls::default()],
            rod,
            step,
        }
    }

    /// Returns the arm's rod.
    #[must_use]
    pub fn rod(&self) -> &'a Rod {
        self.rod
    }

    /// Returns the state on the arm's own nodes.
    #[must_use]
    pub fn state(&self) -> State {
        self.stepper.state()
    }

    /// Returns the error of the present shape on the model's nodes, m: see [`Transfer::error`].
    #[must_use]
    pub fn transfer_error(&self) -> f64 {
        self.transfer.error(&self.stepper.state().configuration)
    }
}

impl Plant for RodPlant<'_> {
    type Error = StepError;

    fn apply(&mut self, command: &Command) -> Result<(), StepError> {
        let Self {
            order,
            nearest,
            placed,
            command: own,
            controls: [now, next],
            ..
        } = self;
        order.place(command.nodes().iter().map(|node| nearest[*node]));
        let at = |list: &ControlList, node| list.nodes().iter().position(|own| *own == node);
        let place = |list: &ControlList| list.placed(|node| at(list, node).map(|at| (at, 1.0)));
        placed.write(command, place, own);
        for controls in [&mut *now, &mut *next] {
            (controls.wrenches).resize(order.nodes.len(), Wrench::default());
            controls.efforts.resize(order.n_efforts(), 0.0);
        }
        let steps = ((command.end - command.start) / self.step).round() as usize;
        for k in 0..steps {
            let at = |k: usize| command.start + k as f64 * self.step;
            for (t, out) in [(at(k), &mut *now), (at(k + 1), &mut *next)] {
                out.clear();
                own.add_at(t, out);
            }
            self.stepper.advance([order.of(now), order.of(next)])?;
        }
        Ok(())
    }

    fn measure(&mut self) -> State {
        self.transfer.state(&self.stepper.state())
    }
}
