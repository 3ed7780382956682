//! User-defined actuators along a point: the columns of their controls, and their part of the Hessian of the Lagrangian.

use faer::Mat;
use nalgebra::Vector6;

use super::path::RowGradient;
use super::problem::{Component, OptimalControlProblem};
use mechanics::actuator::{StateView, flat};
use mechanics::curvature::OwnCurvature;
use mechanics::linearization::{AdjointSweep, Motion};
use mechanics::sensitivity::{EffortPulls, Sensitivities};
use mechanics::{
    ControlSignal, EffortLaw, FormTerm, PlacedFunction, Posed, StateForm, Trajectory, Wrench,
};

/// The thing that a component of the control acts on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Target {
    /// A node, and the component of its wrench.
    Node(usize, usize),
    /// A user-defined actuator, and the index of its control.
    Own(usize, usize),
    /// Actuators of the rod, those that the component [drives](OptimalControlProblem::driven_by).
    Efforts,
}

/// Returns the target of every component.
pub(super) fn targets(problem: &OptimalControlProblem, components: &[Component]) -> Vec<Target> {
    (components.iter())
        .map(
            |component| match (problem.of_wrench(component), problem.own_control(component)) {
                (Some((node, component)), _) => Target::Node(node, component),
                (None, Some((actuator, control))) => Target::Own(actuator, control),
                (None, None) => Target::Efforts,
            },
        )
        .collect()
}

/// Tells whether a driven actuator acts on the strains of the rod.
fn is_on_strains(problem: &OptimalControlProblem, index: usize) -> bool {
    let n_strains = problem.rod.actuators.strains().len();
    (problem.efforts.as_ref()).is_some_and(|efforts| efforts.actuators[index] < n_strains)
}

/// The user-defined actuators, and those of the rod, along a trajectory under a control.
pub(super) struct ActingAlong<'a> {
    problem: &'a OptimalControlProblem,
    /// The controls.
    pub signal: ControlSignal,
    /// Nodes of every actuator.
    nodes: Vec<Vec<usize>>,
    /// Derivative of the wrenches along the controls at every time node, actuator by actuator.
    jacobians: Vec<Vec<Mat<f64>>>,
    /// Wrenches of unit efforts of the driven actuators of the rod, if some of them act on strains.
    pulls: Option<EffortPulls>,
    /// Efforts of all actuators of the rod as functions of their inputs, in every set of pulls; empty without winches.
    laws: Vec<Vec<EffortLaw>>,
    /// The functions of poses that each driven actuator has.
    posed: Vec<Vec<&'a PlacedFunction>>,
    trajectory: &'a Trajectory,
}

impl<'a> ActingAlong<'a> {
    /// Evaluates the actuators along a trajectory; `None` if [nothing depends on it](OptimalControlProblem::acts_on_configuration).
    pub fn of(
        problem: &'a OptimalControlProblem,
        signal: ControlSignal,
        trajectory: &'a Trajectory,
    ) -> Option<Self> {
        if !problem.acts_on_configuration() {
            return None;
        }
        let rod = &problem.rod;
        let driven = problem
            .efforts
            .as_ref()
            .map_or(&[][..], |efforts| &efforts.actuators);
        let on_strains = (0..driven.len()).any(|index| is_on_strains(problem, index));
        let jacobians = (problem.acting.iter())
            .map(|acting| {
                (0..=problem.grid.n_steps)
                    .map(|k| {
                        let at = StateView::of(rod, &problem.grid, trajectory, k);
                        let u = acting.controls(signal.at(k).inputs);
                        acting.actuator.control_jacobian(&at, &u)
                    })
                    .collect()
            })
            .collect();
        let laws = if rod.actuators.follow_shape() {
            let motion = Motion {
                control: Some(&signal),
                ..problem.motion()
            };
            let mut inputs = vec![0.0; rod.actuators.len()];
            let mut state = rod.actuators.effort_state();
            let time = problem.grid.step;
            (0..motion.n_sets())
                .map(|set| {
                    motion.write_inputs_of_set(set, &mut inputs);
                    rod.write_effort_state_of_set(trajectory, (set, time), &mut state);
                    (inputs.iter().enumerate())
                        .map(|(i, input)| rod.actuators.law(i, *input, &state))
                        .collect()
                })
                .collect()
        } else {
            Vec::new()
        };
        Some(Self {
            laws,
            nodes: (problem.acting.iter())
                .map(|acting| acting.actuator.nodes(rod))
                .collect(),
            pulls: on_strains.then(|| EffortPulls::of(&problem.motion(), trajectory, driven, None)),
            posed: (driven.iter())
                .map(|&actuator| {
                    let all = rod.actuators.functions().iter();
                    all.filter(|own| own.actuator == Some(actuator)).collect()
                })
                .collect(),
            trajectory,
            problem,
            signal,
            jacobians,
        })
    }

    /// Returns the wrenches of unit efforts of the driven actuators, if some of them act on strains.
    pub fn pulls(&self) -> Option<&EffortPulls> {
        self.pulls.as_ref()
    }

    /// Calls `visit(coefficient, derivative)` for the coefficients of the control on which the effort of a driven actuator depends in a set
    /// of [pulls](Self::pulls), along the input of the actuator.
    pub fn visit_efforts(&self, set: usize, index: usize, visit: &mut dyn FnMut(usize, f64)) {
        let ends = self.problem.rod.scheme.n_ends();
        let slope = self.law(set, index).along_input / ends as f64;
        for time in set..set + ends {
            for (coefficient, weight) in self.problem.control.weights(time) {
                if weight != 0.0 {
                    visit(coefficient, weight * slope);
                }
            }
        }
    }

    /// Calls `visit(node, component, derivative)` for every component of a wrench at time node `k` that the control `component` changes by its
    /// value at `k`, without what it does by actuators on strains, which [`Self::pulls`] know.
    pub fn visit(
        &self,
        k: usize,
        (control, target): (&Component, Target),
        visit: &mut dyn FnMut(usize, usize, f64),
    ) {
        let (actuator, control) = match target {
            Target::Node(..) => return,
            Target::Own(actuator, control) => (actuator, control),
            Target::Efforts => {
                for (index, gain) in self.problem.driven_by(control) {
                    self.visit_posed(k, index, gain, visit);
                }
                return;
            }
        };
        let jacobian = &self.jacobians[actuator][k];
        for (i, &node) in self.nodes[actuator].iter().enumerate() {
            for component in 0..6 {
                let slope = jacobian[(6 * i + component, control)];
                if slope != 0.0 {
                    visit(node, component, slope);
                }
            }
        }
    }

    /// Calls `visit(node, component, derivative)` for every component of a wrench at time node `k` that the control `component` changes by
    /// actuators on strains, by its value anywhere.
    pub fn visit_pulls(
        &self,
        k: usize,
        component: &Component,
        visit: &mut dyn FnMut(usize, usize, f64),
    ) {
        let Some(pulls) = &self.pulls else {
            return;
        };
        for (index, gain) in self.problem.driven_by(component) {
            if is_on_strains(self.problem, index) {
                pulls.visit(k, index, &mut |[set, _], node, component, wrench| {
                    let slope = gain * self.law(set, index).along_input;
                    visit(node, component, wrench * slope);
                });
            }
        }
    }

    /// Calls `visit(node, component, derivative)` for every component of a wrench at time node `k` that a driven actuator on poses changes by an
    /// effort.
    fn visit_posed(
        &self,
        k: usize,
        index: usize,
        effort: f64,
        visit: &mut dyn FnMut(usize, usize, f64),
    ) {
        let (x, r) = (
            self.trajectory.positions_at(k),
            self.trajectory.rotations_at(k),
        );
        for own in &self.posed[index] {
            let wrench = own.wrench(&own.pose(x, r), own.weight * effort).to_array();
            for (component, slope) in wrench.into_iter().enumerate() {
                if slope != 0.0 {
                    visit(own.node, component, slope);
                }
            }
        }
    }

    /// Returns the effort of a driven actuator, by its index among those, as a function of its input in a set of pulls.
    fn law(&self, set: usize, index: usize) -> EffortLaw {
        let actuator = self
            .problem
            .efforts
            .as_ref()
            .map(|own| own.actuators[index]);
        let law = self.laws.get(set).zip(actuator).map(|(laws, i)| laws[i]);
        law.unwrap_or(EffortLaw {
            along_input: 1.0,
            ..EffortLaw::default()
        })
    }

    /// Returns the first-order change of all wrenches with a change of the controls.
    pub fn change(&self, change: &ControlSignal) -> ControlSignal {
        let n_nodes = self.problem.rod.n_nodes();
        let driven = self
            .problem
            .efforts
            .as_ref()
            .map(|efforts| efforts.actuators.len());
        let mut nodes = change.nodes.clone();
        nodes.extend(self.nodes.iter().flatten());
        nodes.extend(0..if driven.is_some() { n_nodes } else { 0 });
        let mut wrenches = Vec::with_capacity(nodes.len() * (self.problem.grid.n_steps + 1));
        for k in 0..=self.problem.grid.n_steps {
            let here = change.at(k);
            wrenches.extend(here.iter().map(|(_, wrench)| *wrench));
            for (acting, jacobians) in self.problem.acting.iter().zip(&self.jacobians) {
                let du = acting.controls(here.inputs);
                let row = |i: usize| -> f64 {
                    (du.iter().enumerate())
                        .map(|(j, du)| jacobians[k][(i, j)] * du)
                        .sum()
                };
                wrenches
                    .extend((0..jacobians[k].nrows() / 6).map(|node| {
                        Wrench::from_array(std::array::from_fn(|c| row(6 * node + c)))
                    }));
            }
            let Some(driven) = driven else {
                continue;
            };
            let mut sums = vec![[0.0; 6]; n_nodes];
            for index in 0..driven {
                if !is_on_strains(self.problem, index) {
                    self.visit_posed(k, index, 1.0, &mut |node, component, slope| {
                        sums[node][component] += slope * here.effort(index);
                    });
                } else if let Some(pulls) = &self.pulls {
                    pulls.visit(k, index, &mut |[set, time], node, component, wrench| {
                        let slope = wrench * self.law(set, index).along_input;
                        sums[node][component] += slope * change.at(time).effort(index);
                    });
                }
            }
            wrenches.extend(sums.into_iter().map(Wrench::from_array));
        }
        ControlSignal::on(nodes, wrenches)
    }

    /// Returns the second derivatives of the wrenches' term in the Lagrangian: those along the configuration alone, and those along
    /// controls.
    pub fn curvature(
        &self,
        motion: &Motion,
        trajectory: &Trajectory,
        costates: &AdjointSweep,
        components: &[Component],
    ) -> (Vec<OwnCurvature>, Vec<ControlCurvature>) {
        let problem = self.problem;
        let own = targets(problem, components);
        let (mut along_states, mut along_controls) = (Vec::new(), Vec::new());
        for k in 0..=problem.grid.n_steps {
            let at = StateView::of(&problem.rod, &motion.grid, trajectory, k);
            for (index, (acting, nodes)) in problem.acting.iter().zip(&self.nodes).enumerate() {
                let u = acting.controls(self.signal.at(k).inputs);
                let covector: Vec<Wrench> = (nodes.iter())
                    .map(|&node| costates.wrench(motion, k, node))
                    .collect();
                if flat(&covector).iter().all(|entry| *entry == 0.0) {
                    continue;
                }
                let matrix = acting.actuator.curvature(&at, &u, &covector);
                let rows: Vec<(usize, usize)> = (nodes.iter())
                    .flat_map(|&node| (0..6).map(move |component| (node, component)))
                    .collect();
                let n = rows.len();
                along_states.push(OwnCurvature {
                    time_node: k,
                    forms: Vec::new(),
                    earlier: Vec::new(),
                    matrix: Mat::from_fn(n, n, |i, j| matrix[(i, j)]),
                    rows: rows.clone(),
                });
                let columns = (0..u.len())
                    .map(|control| {
                        let mut entries = Vec::new();
                        for (coefficient, weight) in problem.control.weights(k) {
                            for (i, component) in components.iter().enumerate() {
                                if own[i] == Target::Own(index, control) && weight != 0.0 {
                                    let unit = problem.channel(component).unit();
                                    entries
                                        .push((coefficient * components.len() + i, weight * unit));
                                }
                            }
                        }
                        entries
                    })
                    .collect();
                let bent: Vec<usize> = (0..n)
                    .filter(|&i| (0..u.len()).any(|c| matrix[(i, n + c)] != 0.0))
                    .collect();
                along_controls.push(ControlCurvature {
                    forms: (bent.iter())
                        .map(|&i| {
                            vec![StateForm {
                                time_node: k,
                                terms: vec![FormTerm {
                                    node: rows[i].0,
                                    component: rows[i].1,
                                    coefficient: 1.0,
                                }],
                            }]
                        })
                        .collect(),
                    cross: Mat::from_fn(bent.len(), u.len(), |i, c| matrix[(bent[i], n + c)]),
                    own: Mat::from_fn(u.len(), u.len(), |i, j| matrix[(n + i, n + j)]),
                    columns,
                });
            }
            self.posed_curvature(
                k,
                (motion, trajectory, costates),
                components,
                &mut along_states,
                &mut along_controls,
            );
        }
        self.winch_curvature(motion, trajectory, costates, &mut along_states);
        self.input_curvature(motion, costates, components, &mut along_controls);
        (along_states, along_controls)
    }

    /// Appends the second derivatives along the configuration of the tensions of winches that couple all elements of their tendons:
    /// `k' (g bᵀ + b gᵀ)` at every time node, with the derivative `k'` of the tension along its coordinate, its pull `g`, and the derivative
    /// `b` of the costates' product with `g`. Under the implicit scheme it is one half of that over every interval, with pulls and
    /// derivatives at both of its ends.
    fn winch_curvature(
        &self,
        motion: &Motion,
        trajectory: &Trajectory,
        costates: &AdjointSweep,
        out: &mut Vec<OwnCurvature>,
    ) {
        if self.laws.is_empty() {
            return;
        }
        let rod = &self.problem.rod;
        let winches: Vec<usize> = (rod.actuators.iter().enumerate())
            .filter(|(_, own)| own.winch.is_some())
            .map(|(i, _)| i)
            .collect();
        let covector = |set: usize, end: usize, node: usize| {
            let wrench = costates.wrench(motion, set + end, node);
            let share = rod.scheme.share(set + end, motion.grid.n_steps);
            Wrench {
                force: wrench.force * share,
                moment: wrench.moment * share,
            }
        };
        let pulls = EffortPulls::of(motion, trajectory, &winches, Some(&covector));
        let rows: Vec<(usize, usize)> = (0..6 * rod.n_nodes()).map(|i| (i / 6, i % 6)).collect();
        let ends = rod.scheme.n_ends();
        for (set, laws) in self.laws.iter().enumerate() {
            for (at, &winch) in winches.iter().enumerate() {
                // The coordinate at the mean strain has one half of the pull at either end for its derivative.
                let slope = laws[winch].along_coordinate / ends as f64;
                if slope == 0.0 {
                    continue;
                }
                let forms = |end: usize| {
                    let both = [pulls.wrenches(set, end, at), pulls.slopes(set, end, at)];
                    both.map(<[f64]>::to_vec).to_vec()
                };
                out.push(OwnCurvature {
                    time_node: set + ends - 1,
                    rows: rows.clone(),
                    earlier: if ends == 2 { forms(0) } else { Vec::new() },
                    forms: forms(ends - 1),
                    matrix: Mat::from_fn(2, 2, |i, j| if i == j { 0.0 } else { slope }),
                });
            }
        }
    }

    /// Appends the second derivatives of the wrenches of functions of poses and of contacts at time node `k`: along the configuration, and for every driven
    /// actuator along its effort and the configuration.
    fn posed_curvature(
        &self,
        k: usize,
        (motion, trajectory, costates): (&Motion, &Trajectory, &AdjointSweep),
        components: &[Component],
        along_states: &mut Vec<OwnCurvature>,
        along_controls: &mut Vec<ControlCurvature>,
    ) {
        let problem = self.problem;
        let rod = &problem.rod;
        if !rod.actuators.act_on_poses() {
            return;
        }
        let (x, r) = (trajectory.positions_at(k), trajectory.rotations_at(k));
        let along = Motion {
            control: Some(&self.signal),
            ..*motion
        };
        let efforts = along.efforts_at(k);
        for (own, factor) in rod.posed(Posed::All, &efforts) {
            let covector = costates.wrench(motion, k, own.node);
            let bent = own
                .function
                .curvature(&own.pose(x, r), &covector, rod.scales.length);
            along_states.push(OwnCurvature {
                time_node: k,
                rows: (0..6).map(|component| (own.node, component)).collect(),
                forms: Vec::new(),
                earlier: Vec::new(),
                matrix: Mat::from_fn(6, 6, |i, j| factor * bent[(i, j)]),
            });
        }
        for touch in rod.touches() {
            let ends = [touch.element, touch.element + 1];
            let [a, b] = ends.map(|node| costates.wrench(motion, k, node).force);
            let Some(bent) = touch.curvature(ends.map(|node| &x[node]), [&a, &b]) else {
                continue;
            };
            along_states.push(OwnCurvature {
                time_node: k,
                rows: (ends.into_iter())
                    .flat_map(|node| (0..3).map(move |component| (node, component)))
                    .collect(),
                forms: Vec::new(),
                earlier: Vec::new(),
                matrix: Mat::from_fn(6, 6, |i, j| -bent[(i, j)]),
            });
        }
        let n_components = components.len();
        for (index, functions) in self
            .posed
            .iter()
            .enumerate()
            .filter(|(_, own)| !own.is_empty())
        {
            let terms = (functions.iter()).flat_map(|own| {
                let covector = Vector6::from(costates.wrench(motion, k, own.node).to_array());
                let tangent = own.function.tangent(&own.pose(x, r));
                let slope = tangent.tr_mul(&covector) * own.weight;
                (0..6).map(move |component| FormTerm {
                    node: own.node,
                    component,
                    coefficient: slope[component],
                })
            });
            let mut column = Vec::new();
            for (coefficient, weight) in problem.control.weights(k) {
                for (at, component) in components.iter().enumerate() {
                    for (_, gain) in problem.driven_by(component).filter(|own| own.0 == index) {
                        if weight != 0.0 {
                            let unit = gain * problem.channel(component).unit();
                            column.push((coefficient * n_components + at, weight * unit));
                        }
                    }
                }
            }
            along_controls.push(ControlCurvature {
                forms: vec![vec![StateForm {
                    time_node: k,
                    terms: terms.filter(|term| term.coefficient != 0.0).collect(),
                }]],
                cross: Mat::identity(1, 1),
                own: Mat::zeros(1, 1),
                columns: vec![column],
            });
        }
    }

    /// Appends the second derivatives along the inputs of winches that follow from the curvature of their tensions: along two inputs, and
    /// along an input and the configuration. The other mixed ones, of the pulls of efforts, belong to the linearized steps, and those along
    /// the configuration alone to the elements.
    fn input_curvature(
        &self,
        motion: &Motion,
        costates: &AdjointSweep,
        components: &[Component],
        out: &mut Vec<ControlCurvature>,
    ) {
        let Some(pulls) = self.pulls.as_ref().filter(|_| !self.laws.is_empty()) else {
            return;
        };
        let problem = self.problem;
        let n_components = components.len();
        let scheme = problem.rod.scheme;
        let ends = scheme.n_ends();
        for set in 0..self.laws.len() {
            let driven = components.iter().enumerate().flat_map(|(at, component)| {
                let own = problem.driven_by(component);
                own.map(move |(index, gain)| (at, index, gain * problem.channel(component).unit()))
            });
            for (at, index, unit) in driven.filter(|own| is_on_strains(problem, own.1)) {
                let law = self.law(set, index);
                if law.mixed == 0.0 && law.bend == 0.0 {
                    continue;
                }
                // The work of the costates in the pull of a unit effort.
                let work: f64 = (0..ends)
                    .map(|end| {
                        let share = scheme.share(set + end, motion.grid.n_steps);
                        let pull = pulls.wrenches(set, end, index).chunks_exact(6);
                        let works = pull.enumerate().map(|(node, wrench)| {
                            let own = costates.wrench(motion, set + end, node).to_array();
                            own.iter().zip(wrench).map(|(a, b)| a * b).sum::<f64>()
                        });
                        share * works.sum::<f64>()
                    })
                    .sum();
                let mixed = law.mixed * work / ends as f64;
                let form = (0..ends)
                    .map(|end| {
                        let pull = pulls.wrenches(set, end, index).iter().enumerate();
                        let terms = pull.map(|(place, pull)| FormTerm {
                            node: place / 6,
                            component: place % 6,
                            coefficient: mixed * pull,
                        });
                        StateForm {
                            time_node: set + end,
                            terms: terms.filter(|term| term.coefficient != 0.0).collect(),
                        }
                    })
                    .collect();
                let unit = unit / ends as f64;
                let weights = (set..set + ends).flat_map(|k| problem.control.weights(k));
                out.push(ControlCurvature {
                    forms: vec![form],
                    cross: Mat::identity(1, 1),
                    own: Mat::from_fn(1, 1, |_, _| law.bend * work),
                    columns: vec![
                        weights
                            .filter(|(_, weight)| *weight != 0.0)
                            .map(|(coefficient, weight)| {
                                (coefficient * n_components + at, weight * unit)
                            })
                            .collect(),
                    ],
                });
            }
        }
    }
}

/// Second derivatives of an actuator's term in the Lagrangian at one time node, with respect to its controls and to controls and
/// configuration.
pub(super) struct ControlCurvature {
    /// Forms of the configuration on which the wrenches depend, each a sum.
    pub forms: Vec<RowGradient>,
    /// Mixed derivatives, forms by controls.
    cross: Mat<f64>,
    /// Derivatives along two controls.
    own: Mat<f64>,
    /// Columns that move each control, with their coefficients.
    columns: Vec<Vec<(usize, f64)>>,
}

impl ControlCurvature {
    /// Returns the forms as rows of a sweep.
    pub fn gradients(&self) -> impl Iterator<Item = RowGradient> {
        self.forms.iter().cloned()
    }

    /// Adds these derivatives to a Hessian over the columns. The forms are the rows from `first` on of `values` (by columns) and of
    /// `responses` (by sources).
    pub fn add_to(
        &self,
        first: usize,
        values: &Mat<f64>,
        responses: &Mat<f64>,
        found: &mut Sensitivities,
    ) {
        let (Some(curvature), Some(sources)) =
            (found.curvature.as_mut(), found.curvature_sources.as_mut())
        else {
            return;
        };
        for (control, entries) in self.columns.iter().enumerate() {
            for &(column, weight) in entries {
                for i in 0..self.forms.len() {
                    let factor = weight * self.cross[(i, control)];
                    if factor == 0.0 {
                        continue;
                    }
                    for other in 0..values.ncols() {
                        let product = factor * values[(first + i, other)];
                        curvature[(column, other)] += product;
                        curvature[(other, column)] += product;
                    }
                    for source in 0..responses.ncols() {
                        sources[(column, source)] += factor * responses[(first + i, source)];
                    }
                }
                for (other, others) in self.columns.iter().enumerate() {
                    for &(at, factor) in others {
                        curvature[(column, at)] += weight * factor * self.own[(control, other)];
                    }
                }
            }
        }
    }
}
