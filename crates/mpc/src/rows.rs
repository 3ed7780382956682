//! Rows over one horizon: the residuals of tracks, targets and terms, and of each limit those rows that are nearest to being violated.
//!
//! A controller reads the same [residuals](Residual) and limits as the solver and evaluates them sample after sample in memory that is
//! reused. Every row is a sum of forms at one or two time nodes, whose derivatives one reverse sweep finds. Rows are in ascending order of
//! time: when the horizon shrinks toward its end, the last ones remain.

use faer::Mat;

use super::controller::MpcSettings;
use super::horizon::TerminalCost;
use super::limits::{LimitRow, Maxima, Prices, limit_rows};
use super::soft_rows::SoftRows;
use control::path::RodView;
use control::residual::{Residual, ResidualKind, States, cost_residuals, goal_residuals};
use control::{GoalPart, OptimalControlProblem};
use mechanics::forms::NODE_COMPONENTS;
use mechanics::linearization::StateTangent;
use mechanics::sensitivity::RepeatedReverse;
use mechanics::{ControlSignal, Rod, State, StateForm, TimeGrid, Wrench};

/// Number of terms of the form of a limit: six components of two nodes.
const LIMIT_TERMS: usize = 12;

/// Forms of a row: at its time node, and for a row of an interval also at the beginning of the interval.
type RowForms = [Option<usize>; 2];

/// The evaluated motion: that of a roll-out, with the times at which its states occur.
#[derive(Clone, Copy)]
pub(super) struct Evaluated<'a> {
    pub problem: &'a OptimalControlProblem,
    pub states: States<'a>,
    /// The grid for the motion of obstacles.
    pub grid: TimeGrid,
    /// Efforts of the plan at the time nodes.
    pub efforts: Option<&'a ControlSignal>,
    /// The state in which the motion ends.
    pub end: &'a State,
}

/// All rows of the longest horizon; those of the present one are the last.
#[derive(Debug)]
pub(super) struct Rows {
    /// Residuals in ascending order of time, on the longest grid.
    residuals: Vec<Residual>,
    /// First row of every residual.
    starts: Vec<usize>,
    row_forms: Vec<RowForms>,
    values: Vec<f64>,
    /// The cost of what comes after the horizon, whose rows are the last ones, and the scaled control in which the plan ends; `None` for a plan
    /// whose horizon is all.
    terminal: Option<TerminalCost>,
    terminal_counts: bool,
    last_control: Vec<f64>,
    limits: Vec<LimitRow>,
    limit_forms: Vec<RowForms>,
    limit_values: Vec<f64>,
    maxima: Maxima,
    /// By how much plans should keep inside of each limit, in the scale of its rows.
    margins: Vec<f64>,
    pub prices: Prices,
    /// Forms; their time nodes are on the present grid from `first.form` on.
    forms: Vec<StateForm>,
    form_nodes: Vec<usize>,
    /// Number of time nodes of the longest horizon that have passed.
    passed: usize,
    first: First,
    limits_along_start: Mat<f64>,
}

/// Indices of the first rows of the present horizon.
#[derive(Clone, Copy, Debug, Default)]
struct First {
    residual: usize,
    row: usize,
    limit: usize,
    form: usize,
}

/// Returns the residuals that a controller minimizes. `weight` is that of a target's scaled residual. A deviation from the shape in which
/// the arm stays counts as the distance by which it moves the tip: a deviation of energy `½ |r|²` moves it by `|r|` times the square root
/// of the tip's compliance.
fn residuals(problem: &OptimalControlProblem, weight: f64) -> Vec<Residual> {
    let mut out = cost_residuals(problem);
    out.extend(goal_residuals(problem, None).into_iter().map(|residual| {
        let scales = &problem.rod.scales;
        let factor = match (&problem.stay, residual.kind) {
            (
                Some(stay),
                ResidualKind::Goal {
                    part: GoalPart::Deviation(_),
                    ..
                },
            ) => stay.compliance * scales.moment / scales.length.powi(2),
            _ => 1.0,
        };
        Residual {
            weight: weight * factor,
            ..residual
        }
    }));
    out.sort_by_key(|residual| residual.time_node);
    out
}

impl Rows {
    /// Creates the rows of a controller with these settings, for a model with so many components of its state.
    pub fn new(
        problem: &OptimalControlProblem,
        states: &States,
        settings: &MpcSettings,
        n_states: usize,
        terminal: Option<TerminalCost>,
    ) -> Self {
        let residuals = residuals(problem, settings.target_weight);
        let prices = Prices::new(problem, settings.limit_price);
        let limits = limit_rows(problem, &prices, settings.period);
        let mut starts = Vec::with_capacity(residuals.len());
        // Time nodes of the forms of every row, the limits' last.
        let mut nodes: Vec<[Option<usize>; 2]> = Vec::new();
        for residual in &residuals {
            starts.push(nodes.len());
            let n_rows = residual.kind.n_rows(&problem.rod);
            nodes.extend((0..n_rows).map(|_| [Some(residual.time_node), residual.before]));
        }
        let n_residual_rows = nodes.len();
        let n_terminal = terminal.as_ref().map_or(0, TerminalCost::len);
        nodes.extend((0..n_terminal).map(|_| [Some(problem.grid.n_steps), None]));
        let n_rows = nodes.len();
        nodes.extend(limits.iter().map(|row| {
            let is_of_two = problem.path[row.limit].limit.n_instants() > 1;
            [Some(row.time_node), is_of_two.then_some(row.before)]
        }));
        let mut order: Vec<(usize, usize, usize)> = (nodes.iter().enumerate())
            .flat_map(|(row, nodes)| {
                let instants = nodes.iter().enumerate();
                instants.filter_map(move |(instant, node)| node.map(|node| (node, row, instant)))
            })
            .collect();
        order.sort_unstable();
        let mut row_forms: Vec<RowForms> = vec![[None; 2]; nodes.len()];
        let mut forms = Vec::with_capacity(order.len());
        for (form, &(time_node, row, instant)) in order.iter().enumerate() {
            row_forms[row][instant] = Some(form);
            let room = match row.checked_sub(n_rows) {
                None if row < n_residual_rows => 0,
                None => NODE_COMPONENTS * problem.rod.n_nodes(),
                Some(row) if problem.path[limits[row].limit].limit.depends_on_inputs() => {
                    NODE_COMPONENTS * problem.rod.n_nodes()
                }
                Some(_) => LIMIT_TERMS,
            };
            forms.push(StateForm {
                time_node,
                terms: Vec::with_capacity(room),
            });
        }
        let limit_forms = row_forms.split_off(n_rows);
        let mut out = Self {
            values: vec![0.0; n_rows],
            limit_values: vec![LimitRow::NOWHERE; limits.len()],
            maxima: Maxima::default(),
            margins: vec![0.0; problem.path.len()],
            prices,
            form_nodes: forms.iter().map(|form| form.time_node).collect(),
            passed: 0,
            first: First::default(),
            limits_along_start: Mat::zeros(limits.len(), n_states),
            last_control: vec![0.0; problem.actuated_components().len()],
            terminal,
            terminal_counts: false,
            residuals,
            starts,
            row_forms,
            limits,
            limit_forms,
            forms,
        };
        // All forms have their terms once, so that no later evaluation needs room.
        for index in 0..out.residuals.len() {
            let residual = out.residuals[index];
            out.write_slopes(index, &residual, problem, states);
        }
        out
    }

    /// Leaves out rows of the longest horizon before time node `passed`, at which the present one begins.
    pub fn place(&mut self, passed: usize) {
        let is_before = |residual: &Residual| residual.time_node < passed;
        let residual = self.residuals.partition_point(is_before);
        self.passed = passed;
        self.first = First {
            residual,
            row: (self.starts.get(residual)).map_or(self.row_forms.len(), |row| *row),
            limit: self.limits.partition_point(|row| row.time_node < passed),
            form: self.form_nodes.partition_point(|node| *node < passed),
        };
        let first = self.first.form;
        for (form, node) in (self.forms.iter_mut().zip(&self.form_nodes)).skip(first) {
            form.time_node = node - passed;
        }
    }

    /// Forms of the longest horizon.
    pub fn forms(&self) -> &[StateForm] {
        &self.forms
    }

    /// Forms of the present horizon, in ascending order of time.
    pub fn present_forms(&self) -> &[StateForm] {
        &self.forms[self.first.form..]
    }

    /// Returns the number of rows of residuals in the longest horizon.
    pub fn len(&self) -> usize {
        self.row_forms.len()
    }

    /// Values of the residuals of the present horizon.
    pub fn present(&self) -> &[f64] {
        &self.values[self.first.row..]
    }

    /// Returns the number of rows of limits in the longest horizon.
    pub fn n_limits(&self) -> usize {
        self.limits.len()
    }

    /// Sets by how much plans should keep inside of a limit, in the scale of its rows. A row then costs from there on, and its price rises only
    /// where the limit itself is violated: the margin gives way first.
    pub fn set_margin(&mut self, limit: usize, margin: f64) {
        self.margins[limit] = margin;
    }

    /// Returns the cost if every tracked or targeted distance and angle has the constant error `off`, divided by the rod's length, or in
    /// rad.
    pub fn cost_of(&self, off: f64) -> f64 {
        let places = (self.residuals.iter()).filter(|residual| residual.kind.is_place());
        // Half of the square of each of three components.
        places
            .map(|place| 0.5 * 3.0 * place.weight * off * off)
            .sum()
    }

    /// Evaluates values and forms of all rows of the present horizon.
    pub fn evaluate(&mut self, at: &Evaluated) {
        for form in &mut self.forms[self.first.form..] {
            form.terms.clear();
        }
        for index in self.first.residual..self.residuals.len() {
            self.evaluate_residual(index, at);
        }
        self.evaluate_terminal(at);
        for index in self.first.limit..self.limits.len() {
            self.evaluate_limit(index, at);
        }
    }

    fn evaluate_terminal(&mut self, at: &Evaluated) {
        let grid = &at.states.view.grid;
        let end = grid.time(grid.n_steps);
        self.terminal_counts = (self.terminal.as_ref()).is_some_and(|own| own.counts(end));
        self.write_terminal_values(at.end);
        let Some(terminal) = self.terminal.as_ref().filter(|_| self.terminal_counts) else {
            return;
        };
        let forms = &mut self.forms;
        let first = self.row_forms.len() - terminal.len();
        for (row, own) in self.row_forms[first..].iter().enumerate() {
            if let [Some(form), _] = own {
                let terms = &mut forms[*form].terms;
                terminal.write_slopes(row, at.end, &mut |term| terms.push(term));
            }
        }
    }

    fn write_terminal_values(&mut self, end: &State) {
        let Some(terminal) = &self.terminal else {
            return;
        };
        let first = self.values.len() - terminal.len();
        for (row, value) in self.values[first..].iter_mut().enumerate() {
            *value = if self.terminal_counts {
                terminal.value(row, end, &self.last_control)
            } else {
                0.0
            };
        }
    }

    /// Notes the state and the scaled control in which the plan ends, and the control that costs no effort there for the model of `rod` with
    /// wrenches on its nodes: terminal costs count from these.
    pub fn note_end(
        &mut self,
        (rod, disturbing): (&Rod, &[Wrench]),
        [last, free]: [&[f64]; 2],
        end: &State,
    ) {
        if let Some(terminal) = &mut self.terminal {
            terminal.move_to(rod, disturbing, free);
            self.last_control.copy_from_slice(last);
            self.write_terminal_values(end);
        }
    }

    /// Replaces the terminal cost by that of another reference, of which as many rows count; with `None` nothing counts after the horizon. Without
    /// effect on a controller without a terminal cost.
    pub fn replace_terminal(&mut self, other: Option<TerminalCost>) {
        if let Some(own) = &mut self.terminal {
            let n = own.len();
            *own = match other {
                Some(other) => other.with_rows(n),
                None => own.clone().that_never_counts(),
            };
        }
    }

    /// Adds the slopes of the terminal cost along a component of the last control to a column of the present residuals.
    pub fn add_along_last_control(&self, component: usize, out: &mut [f64]) {
        let Some(terminal) = self.terminal.as_ref().filter(|_| self.terminal_counts) else {
            return;
        };
        let first = out.len() - terminal.len();
        for (row, out) in out[first..].iter_mut().enumerate() {
            *out += terminal.along_control(row, component);
        }
    }

    fn evaluate_residual(&mut self, index: usize, at: &Evaluated) {
        let whole = self.residuals[index];
        let start = self.starts[index];
        let n_rows = whole.kind.n_rows(&at.problem.rod);
        self.values[start..][..n_rows].fill(0.0);
        // Of an interval that has begun before the horizon the velocity is not known.
        let before = whole.before.map(|before| before.checked_sub(self.passed));
        let residual = Residual {
            time_node: whole.time_node - self.passed,
            before: before.flatten(),
            ..whole
        };
        let is_whole = before.is_none_or(|before| before.is_some());
        if !is_whole || !residual.counts(at.problem, &at.states.view.grid) {
            return;
        }
        residual.values(at.problem, &at.states, &mut |row, value| {
            self.values[start + row] = value;
        });
        self.write_slopes(index, &residual, at.problem, &at.states);
    }

    fn write_slopes(
        &mut self,
        index: usize,
        residual: &Residual,
        problem: &OptimalControlProblem,
        states: &States,
    ) {
        let row_forms = &self.row_forms[self.starts[index]..];
        let forms = &mut self.forms;
        residual.slopes(problem, states, &mut |row, instant, term| {
            if let Some(form) = row_forms[row][instant] {
                forms[form].terms.push(term);
            }
        });
    }

    fn evaluate_limit(&mut self, index: usize, at: &Evaluated) {
        let row = self.limits[index];
        let limit = &at.problem.path[row.limit].limit;
        self.limit_values[index] = LimitRow::NOWHERE;
        let k = row.time_node - self.passed;
        let from = match row.before.checked_sub(self.passed) {
            Some(from) => from,
            // Of an interval that has begun before the horizon the mean is not known.
            None if limit.n_instants() > 1 => return,
            None => k,
        };
        let view = RodView {
            grid: at.grid,
            ..at.states.view
        };
        let Some(item) = self.maxima.item(limit, &view, [from, k], row.rank) else {
            return;
        };
        let of_input = limit.along_input(&at.problem.rod, item).zip(at.efforts);
        let from_input = of_input.map_or(0.0, |((actuator, slope), efforts)| {
            let n = at.problem.rod.actuators.len();
            slope * efforts.inputs[k * n + actuator]
        });
        self.limit_values[index] = limit.value_since(&view, [from, k], item) + from_input;
        let (of_row, forms) = (self.limit_forms[index], &mut self.forms);
        limit.slopes(&view, [from, k], item, &mut |instant, term| {
            if let Some(form) = of_row[instant] {
                forms[form].terms.push(term);
            }
        });
    }

    /// Returns the sum of the slopes of a row's forms; `along` returns that of a form of the present horizon.
    fn slope(&self, forms: &RowForms, along: impl Fn(usize) -> f64) -> f64 {
        let present = forms.iter().flatten();
        present
            .filter_map(|form| form.checked_sub(self.first.form))
            .map(along)
            .sum()
    }

    /// Writes the slopes of the present residuals along a column of the last sweep.
    pub fn write_along_column(&self, sweep: &RepeatedReverse, column: usize, out: &mut [f64]) {
        let present = self.row_forms[self.first.row..].iter();
        for (forms, out) in present.zip(out) {
            *out = self.slope(forms, |form| sweep.along_column(form, column));
        }
    }

    /// Writes the slopes of the present residuals along a component of the state at the start, and keeps those of limits.
    pub fn write_along_start(
        &mut self,
        sweep: &RepeatedReverse,
        component: usize,
        out: &mut [f64],
    ) {
        let present = self.row_forms[self.first.row..].iter();
        for (forms, out) in present.zip(out) {
            *out = self.slope(forms, |form| sweep.along_start(form, component));
        }
        for index in self.first.limit..self.limits.len() {
            let forms = &self.limit_forms[index];
            self.limits_along_start[(index, component)] =
                self.slope(forms, |form| sweep.along_start(form, component));
        }
    }

    /// Writes the limits of the present horizon as rows of a subproblem of `n` variables, except for their values.
    pub fn write_limits(&self, sweep: &RepeatedReverse, n: usize, soft: &mut SoftRows) {
        let present = self.first.limit..self.limits.len();
        self.write_prices(soft);
        soft.values.clear();
        soft.values.resize(soft.prices.len(), LimitRow::NOWHERE);
        for (at, index) in present.enumerate() {
            let slopes = soft.slopes.col_as_slice_mut(at);
            slopes[n..].fill(0.0);
            for (j, slope) in slopes[..n].iter_mut().enumerate() {
                let forms = &self.limit_forms[index];
                *slope = self.slope(forms, |form| sweep.along_column(form, j));
            }
        }
    }

    /// Calls `visit` for the present rows of limits that depend on the input of an actuator: with the index of the row among these, its time
    /// node, the actuator, and the slope of the row along the input.
    pub fn write_along_inputs(
        &self,
        problem: &OptimalControlProblem,
        visit: &mut dyn FnMut(usize, usize, usize, f64),
    ) {
        for (at, row) in self.limits[self.first.limit..].iter().enumerate() {
            let limit = &problem.path[row.limit].limit;
            if let Some((actuator, slope)) = limit.along_input(&problem.rod, row.rank) {
                visit(at, row.time_node - self.passed, actuator, slope);
            }
        }
    }

    fn write_prices(&self, soft: &mut SoftRows) {
        let present = self.limits[self.first.limit..].iter();
        soft.prices.clear();
        soft.prices.extend(present.map(|row| self.prices.of(row)));
    }

    /// Raises the prices of the limits that the plan last seen violates; returns `false` if none can rise.
    pub fn raise_prices(&mut self, soft: &mut SoftRows) -> bool {
        let rose = self.prices.rise();
        if rose {
            self.write_prices(soft);
        }
        rose
    }

    /// Looks at the limits along the plan at `x`, the solution of a subproblem with these rows; `bounded` tells whether a set or a row bounds
    /// it. Returns the largest violation, 0 for none.
    pub fn see(&mut self, soft: &SoftRows, x: &[f64], bounded: bool) -> f64 {
        let mut largest = 0.0f64;
        self.prices.begin();
        for (at, row) in self.limits[self.first.limit..].iter().enumerate() {
            let share = if bounded { soft.share(at) } else { 0.0 };
            let value = soft.value(at, x) - self.margins[row.limit];
            self.prices.see(row.limit, value, share);
            largest = largest.max(value);
        }
        largest
    }

    /// Writes the values of the present limits, narrowed by their margins, for a start that deviates.
    pub fn write_limit_values(
        &self,
        first_free_node: usize,
        deviation: &StateTangent,
        out: &mut [f64],
    ) {
        for (index, out) in (self.first.limit..self.limits.len()).zip(out) {
            let moved: f64 = (deviation.components_from(first_free_node).enumerate())
                .map(|(i, d)| self.limits_along_start[(index, i)] * d)
                .sum();
            let margin = self.margins[self.limits[index].limit];
            *out = self.limit_values[index] + moved + margin;
        }
    }
}
