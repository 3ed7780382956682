//! `rod.accuracy`, which stands in the place of `rod.elements` and `time.step_s`.

use toml::{Table, Value};

use super::model::{COARSEST, Control, EstimatorKind, FINEST, LoadNode, Scene};
use super::overrides::Override;
use super::values::{Number, known};
use super::{SceneError, SceneSource};
use crate::sqp::HessianChoice;
use crate::task::Discretization;
use crate::task::prediction::first_elements;

/// Default accuracy of a scene that gives neither elements nor an accuracy, as a fraction of the length of the arm.
const DEFAULT: f64 = 1e-3;

/// A key of a table, with its value.
struct Given {
    value: Value,
    /// Tells whether the command line set the key; keys of the command line replace those of the file.
    overrides: bool,
}

fn given(table: &Table, path: [&str; 2], overrides: &[Override]) -> Option<Given> {
    let value = table.get(path[0])?.get(path[1])?.clone();
    let overrides = overrides.iter().any(|setter| setter.sets(&path));
    Some(Given { value, overrides })
}

fn remove(table: &mut Table, [section, key]: [&str; 2]) {
    if let Some(Value::Table(section)) = table.get_mut(section) {
        section.remove(key);
    }
}

const ACCURACY: [&str; 2] = ["rod", "accuracy"];
const ELEMENTS: [&str; 2] = ["rod", "elements"];
const STEP: [&str; 2] = ["time", "step_s"];

/// Puts the elements with which a search for the accuracy begins where a scene has no elements; a scene that gives neither asks for
/// [`DEFAULT`].
///
/// # Errors
/// [`SceneError`] where an accuracy stands beside elements, a step, or the index of a node, which it leaves open.
pub(super) fn complete(
    table: &mut Table,
    overrides: &[Override],
    source: &SceneSource,
) -> Result<(), SceneError> {
    if !matches!(table.get("rod"), Some(Value::Table(_))) {
        return Ok(());
    }
    let accuracy = given(table, ACCURACY, overrides);
    let fixed_step = |given: &Given| given.value.is_float() || given.value.is_integer();
    for (path, key) in [(ELEMENTS, "rod.elements"), (STEP, "time.step_s")] {
        let Some(other) = given(table, path, overrides) else {
            continue;
        };
        if path == STEP && !fixed_step(&other) {
            continue;
        }
        match &accuracy {
            Some(accuracy) if accuracy.overrides && !other.overrides => remove(table, path),
            Some(accuracy) if other.overrides && !accuracy.overrides && path == ELEMENTS => {
                remove(table, ACCURACY);
                return Ok(());
            }
            Some(_) => {
                let help = format!(
                    "an accuracy chooses elements and time step; leave out {key}, or the accuracy"
                );
                return Err(source.error_at(
                    "rod.accuracy",
                    format!("contradicts {key}"),
                    Some(help),
                ));
            }
            None if path == ELEMENTS => return Ok(()),
            None => {
                let error = source.error_at(
                    "rod.elements",
                    "missing, although time.step_s is given",
                    Some("give rod.elements as well, or neither: rod.accuracy chooses both".into()),
                );
                return Err(error);
            }
        }
    }
    if let Some(path) = index_of_a_node(table) {
        let message = "the index of a node means nothing without rod.elements";
        let help = "give rod.elements in the place of an accuracy, or \"tip\" or \"base\"";
        return Err(source.error_at(&path, message, Some(help.into())));
    }
    let value = accuracy.map_or(Value::Float(DEFAULT), |accuracy| accuracy.value);
    // What is no number is refused where all keys are read.
    let number = (value.as_float()).or(value.as_integer().map(|number| number as f64));
    let number = number.map_or(DEFAULT, |number| number.clamp(FINEST, COARSEST));
    if let Some(Value::Table(rod)) = table.get_mut("rod") {
        let elements = first_elements(number) as i64;
        rod.insert("elements".into(), Value::Integer(elements));
        rod.insert("accuracy".into(), value);
    }
    Ok(())
}

/// The dotted path of a `node` that is an index.
fn index_of_a_node(table: &Table) -> Option<String> {
    fn within(value: &Value, path: &str) -> Option<String> {
        match value {
            Value::Table(table) => table.iter().find_map(|(key, value)| {
                let path = format!("{path}.{key}");
                if key == "node" && value.is_integer() {
                    Some(path)
                } else {
                    within(value, &path)
                }
            }),
            Value::Array(items) => (items.iter().enumerate())
                .find_map(|(index, item)| within(item, &format!("{path}.{index}"))),
            _ => None,
        }
    }
    table.iter().find_map(|(key, value)| within(value, key))
}

impl Scene {
    /// Returns the scene with elements and a longest time step of its own in the place of an accuracy; indices of nodes become those of the
    /// nodes at the same places.
    #[must_use]
    pub fn with_grid(&self, discretization: &Discretization) -> Self {
        let mut out = self.clone();
        out.rod.accuracy = None;
        out.rod.elements = discretization.elements;
        out.rod.strain = discretization.strain_rule;
        let (before, after) = (self.mesh(), out.mesh());
        for index in out.indices() {
            *index = after.nearest(before.fraction(*index));
        }
        out.time.step_s = None;
        out.take_steps(discretization);
        let own = self.discretization();
        let is_other = (own.hold, own.blocks) != (discretization.hold, discretization.blocks);
        if self.control.is_none() && self.has_controls() && is_other {
            // Efforts alone are controls without this section.
            out.control = Some(Control::default());
        }
        if let Some(control) = &mut out.control {
            control.hold = discretization.hold;
            control.blocks = discretization.blocks;
        }
        out
    }

    /// Returns the accuracy that the scene asks for in the place of elements and a step, as a fraction of the length of the arm.
    #[must_use]
    pub fn accuracy(&self) -> Option<f64> {
        self.rod.accuracy.map(Number::get)
    }

    /// Tells whether every node that the scene names by its index is a node of a rod of so many elements too.
    #[must_use]
    pub fn names_nodes_of(&self, elements: usize) -> bool {
        let mut nodes = self.clone();
        nodes.rod.elements = elements;
        let (own, other) = (self.mesh(), nodes.mesh());
        let mut nodes = nodes
            .indices()
            .into_iter()
            .map(|index| own.fraction(*index));
        nodes.all(|s| other.node_at(s).is_some())
    }

    /// Nodes that the scene names by their index.
    fn indices(&mut self) -> Vec<&mut usize> {
        let nodes = (self.load.iter_mut().map(|load| &mut load.node))
            .chain(self.disturbance.iter_mut().map(|load| &mut load.node))
            .chain(
                (self.task.iter_mut())
                    .flat_map(|task| task.via.iter_mut().map(|via| &mut via.node)),
            )
            .chain(
                (self.objective.iter_mut())
                    .flat_map(|objective| objective.track.iter_mut().map(|track| &mut track.node)),
            )
            .chain(
                self.limit
                    .iter_mut()
                    .filter_map(|limit| limit.node.as_mut()),
            )
            .filter_map(|node| match node {
                LoadNode::Index(index) => Some(index),
                LoadNode::Tip | LoadNode::Base | LoadNode::Fraction(_) => None,
            });
        let actuators = (self.control.iter_mut()).flat_map(|control| {
            control
                .actuator
                .iter_mut()
                .map(|actuator| &mut actuator.node)
        });
        nodes.chain(actuators).collect()
    }
}

impl Scene {
    /// Tolerance and Hessian of the solver, where they are given.
    pub(crate) fn set_solver(&mut self, tolerance: Option<f64>, hessian: Option<HessianChoice>) {
        if tolerance.is_none() && hessian.is_none() {
            return;
        }
        let mut solver = self.solver.clone().unwrap_or_default();
        solver.tolerance = tolerance.map_or(solver.tolerance, known);
        solver.hessian = hessian.unwrap_or(solver.hessian);
        self.solver = Some(solver);
    }

    /// Horizon and blocks (s), terminal cost, iterations and estimator of a controller, where they are given.
    pub(crate) fn set_loop(
        &mut self,
        [horizon, block]: [Option<f64>; 2],
        terminal_cost: Option<bool>,
        iterations: Option<usize>,
        estimator: Option<EstimatorKind>,
    ) {
        if let Some(mpc) = &mut self.mpc {
            mpc.horizon_s = horizon.map(known).or(mpc.horizon_s);
            mpc.block_s = block.map(known).or(mpc.block_s);
            mpc.terminal_cost = terminal_cost.unwrap_or(mpc.terminal_cost);
            mpc.iterations = iterations.unwrap_or(mpc.iterations);
        }
        if let (Some(own), Some(kind)) = (&mut self.estimator, estimator) {
            own.kind = kind;
        }
    }

    /// Duration of a closed loop, s.
    pub(crate) fn set_duration(&mut self, duration: f64) {
        if let Some(mpc) = &mut self.mpc {
            mpc.duration_s = Some(known(duration));
        }
    }

    /// Sets the number of elements of the plant.
    pub(crate) fn set_plant_elements(&mut self, elements: usize) {
        self.plant.get_or_insert_default().elements = Some(elements);
    }
}
