//! Condensing: the derivatives of all rows along the variables.

use faer::Mat;

use super::rows::{Columns, CostRow, Gathered, describe};
use super::{LiftedPoint, Transcription};
use crate::acting::ControlCurvature;
use crate::path::{RowCurvature, RowGradient};
use mechanics::StateForm;
use mechanics::curvature::{MotionMultipliers, resistance_curvatures};
use mechanics::linearization::{AdjointSweep, Defects, Motion, RightHandSide};
use mechanics::sensitivity::{ControlColumns, Sensitivities, adjoint, sensitivities};
use sqp::{Evaluation, Failure, Linearization, LinearizationRequest, Multipliers};
use stop::{LARGE, StopSignal};

/// Number of products from which a Gauss-Newton Hessian takes more than some hundredths of a second, so that it is computed where a stop
/// signal can leave it behind. The result is the same.
const MANY_PRODUCTS: usize = 100_000_000;

impl Transcription<'_> {
    /// Returns the total derivative of `J + yᵀ c + zᵀ h` along the variables, at a point that obeys its dynamics, by one adjoint sweep.
    /// Normals of the sets and penalties of soft rows are not included.
    ///
    /// # Errors
    /// Returns [`Failure`] if the trajectory cannot be linearized.
    pub fn lagrangian_gradient(
        &self,
        point: &LiftedPoint,
        multipliers: &Multipliers,
    ) -> Result<Vec<f64>, Failure> {
        let (_, own) = self.control_cost.value(&point.variables);
        let costs = self.state_costs(point);
        let costates = self.costates(point, &costs, multipliers)?;
        let through_states = self.through_states(point, &costates, multipliers);
        Ok((own.iter().zip(through_states))
            .map(|(own, rest)| own + rest)
            .collect())
    }

    /// Returns the multipliers of the equations of motion for given ones of goals and path constraints: the derivatives of `J + yᵀ c + zᵀ
    /// h` along the states, swept backward.
    ///
    /// # Errors
    /// Returns [`Failure`] if the trajectory cannot be linearized.
    pub(super) fn costates(
        &self,
        point: &LiftedPoint,
        costs: &[CostRow],
        multipliers: &Multipliers,
    ) -> Result<AdjointSweep, Failure> {
        let outcome = self.outcome(point, costs, multipliers);
        let own = (self.problem.depends_on_configuration()).then(|| self.signal(&point.variables));
        let motion = Motion {
            control: own.as_ref(),
            ..self.problem.motion()
        };
        adjoint(&motion, &point.trajectory, &outcome, self.n_threads).map_err(describe)
    }

    /// Returns the derivative of `J + yᵀ c + zᵀ h` along the variables, without the variables' own cost.
    pub(super) fn through_states(
        &self,
        point: &LiftedPoint,
        costates: &AdjointSweep,
        multipliers: &Multipliers,
    ) -> Vec<f64> {
        let mut gradient = vec![0.0; point.variables.len()];
        let motion = self.problem.motion();
        let acting = self.acting(point);
        let columns = Columns::new(self.problem, &self.components, acting.as_ref());
        for k in 0..=motion.grid.n_steps {
            columns.visit(k, &mut |column, node, component, weight| {
                let wrench = costates.wrench(&motion, k, node);
                let slope = if component < 3 {
                    wrench.force[component]
                } else {
                    wrench.moment[component - 3]
                };
                gradient[column] += weight * slope;
            });
        }
        if let Some((pulls, efforts)) = columns.efforts() {
            let n_nodes = motion.rod.n_nodes();
            for k in 0..=motion.grid.n_steps {
                let covectors: Vec<f64> = (0..n_nodes)
                    .flat_map(|node| costates.wrench(&motion, k, node).to_array())
                    .collect();
                for (set, end, share) in pulls.sets_at(k) {
                    for index in 0..pulls.n_actuators() {
                        let slope = share * dot(pulls.wrenches(set, end, index), &covectors);
                        efforts.visit(set, index, &mut |column, derivative| {
                            gradient[column] += derivative * slope;
                        });
                    }
                }
            }
        }
        if self.depends_on_inputs() {
            for (row, z) in multipliers.inequalities.iter().enumerate() {
                if *z != 0.0 {
                    for (column, slope) in self.path_columns(row) {
                        gradient[column] += slope * z;
                    }
                }
            }
        }
        let slacks = self.slack_variables.iter().zip(&self.slack_units);
        for ((variable, unit), y) in slacks.zip(&multipliers.constraints) {
            if let Some(variable) = *variable {
                gradient[variable] -= unit * y;
            }
        }
        if let (Some(relaxation), Some(along_shortfall)) = (&self.relaxation, gradient.last_mut()) {
            *along_shortfall -= dot(&relaxation.constraints, &multipliers.constraints)
                + dot(&relaxation.inequalities, &multipliers.inequalities);
        }
        gradient
    }

    /// Computes the linearization; `costates` belong to the multipliers of the request, if it has any.
    ///
    /// # Errors
    /// Returns [`Failure`] if the trajectory cannot be linearized.
    pub(super) fn linearize_by(
        &self,
        point: &LiftedPoint,
        evaluation: &Evaluation<Defects>,
        request: &LinearizationRequest,
        costates: Option<&AdjointSweep>,
    ) -> Result<Linearization, Failure> {
        let acting = self.acting(point);
        let motion = Motion {
            control: acting.as_ref().map(|acting| &acting.signal),
            ..self.problem.motion()
        };
        let rod_view = self.rod_view(point);
        let mut gathered = Gathered::default();
        for gradient in self.goal_gradients(&point.trajectory) {
            gathered.push(gradient);
        }
        for &row in request.rows {
            gathered.push(self.path_gradient(&rod_view, row));
        }
        let costs = self.state_costs(point);
        for row in &costs {
            gathered.push(row.gradient.clone());
        }
        let n_rows = gathered.rows.len();
        // Second derivatives of the rows themselves: those within one time node go into the sweep, those across two time nodes are added to
        // its result.
        let (mut own, mut across) = (Vec::new(), Vec::new());
        if let Some(multipliers) = request.multipliers {
            for curvature in self.own_curvature(point, multipliers) {
                match curvature.at_one_time() {
                    Some(curvature) => own.push(curvature),
                    None => across.push(curvature),
                }
            }
        }
        let mut along_controls: Vec<ControlCurvature> = Vec::new();
        if let (Some(acting), Some(costates)) = (&acting, costates) {
            let trajectory = &point.trajectory;
            let found = acting.curvature(&motion, trajectory, costates, &self.components);
            own.extend(found.0);
            along_controls = found.1;
        }
        if let Some(costates) = costates {
            own.extend(resistance_curvatures(&motion, &point.trajectory, costates));
        }
        own.sort_by_key(|curvature| curvature.time_node);
        for form in across.iter().flat_map(|curvature| &curvature.forms) {
            gathered.push(form.clone());
        }
        let mut first_bent = gathered.rows.len();
        for form in along_controls.iter().flat_map(ControlCurvature::gradients) {
            gathered.push(form);
        }
        let (forms, place) = gathered.sorted();
        let second_order = costates.map(|adjoint| MotionMultipliers { adjoint, own: &own });
        let sources = RightHandSide::against(&evaluation.defects);
        let mut found = sensitivities(
            &motion,
            &point.trajectory,
            &[&sources],
            &Columns::new(self.problem, &self.components, acting.as_ref()),
            &forms,
            second_order.as_ref(),
            self.n_threads,
        )
        .map_err(describe)?;
        let values = gathered.rows_of(&found.forms, &place);
        let responses = gathered.rows_of(&found.form_sources, &place);
        add_curvature_across(
            &across,
            n_rows,
            &values,
            &responses,
            &mut found,
            &self.problem.stop,
        );
        for curvature in &along_controls {
            curvature.add_to(first_bent, &values, &responses, &mut found);
            first_bent += curvature.forms.len();
        }
        self.problem
            .stop
            .check()
            .map_err(|stop| describe(stop.into()))?;
        let rows = RowValues {
            along_controls: values,
            responses,
        };
        let linearization = self.assemble(point, evaluation, request, &costs, &rows, found);
        self.problem
            .stop
            .check()
            .map_err(|stop| describe(stop.into()))?;
        Ok(linearization)
    }

    /// Returns the derivative of `J + yᵀ c + zᵀ h` with respect to the states alone.
    pub(super) fn outcome(
        &self,
        point: &LiftedPoint,
        costs: &[CostRow],
        multipliers: &Multipliers,
    ) -> Vec<StateForm> {
        let rod_view = self.rod_view(point);
        let mut out = Vec::new();
        let mut add = |gradient: RowGradient, weight: f64| {
            out.extend(gradient.into_iter().map(|mut form| {
                for term in &mut form.terms {
                    term.coefficient *= weight;
                }
                form
            }));
        };
        let goals = self.goal_gradients(&point.trajectory);
        for (gradient, &y) in goals.into_iter().zip(&multipliers.constraints) {
            add(gradient, y);
        }
        for (row, &z) in multipliers.inequalities.iter().enumerate() {
            if z != 0.0 {
                add(self.path_gradient(&rod_view, row), z);
            }
        }
        for row in costs {
            add(row.gradient.clone(), row.residual);
        }
        out.sort_by_key(|form| form.time_node);
        out
    }

    /// Assembles the condensed linearization.
    fn assemble(
        &self,
        point: &LiftedPoint,
        evaluation: &Evaluation<Defects>,
        request: &LinearizationRequest,
        costs: &[CostRow],
        rows: &RowValues,
        found: Sensitivities,
    ) -> Linearization {
        let n = point.variables.len();
        let n_goals = self.goal_rows.len();
        let offset = (evaluation.constraints.iter().enumerate())
            .map(|(i, c)| c + rows.responses[(i, 0)])
            .collect();
        let inequality_offset = (request.rows.iter().enumerate())
            .map(|(i, &row)| evaluation.inequalities[row] + rows.responses[(n_goals + i, 0)])
            .collect();
        let first_cost = n_goals + request.rows.len();
        let objective = self.objective(point, costs, rows, first_cost);
        // Adds the effect of the defects through the curvature of cost and Lagrangian.
        let mut model_gradient: Vec<f64> = (objective.gradient.iter())
            .zip(&objective.of_defects)
            .map(|(g, e)| g + e)
            .collect();
        if let Some(sources) = &found.curvature_sources {
            for (j, g) in model_gradient.iter_mut().enumerate().take(self.n_controls) {
                *g += sources[(j, 0)];
            }
        }
        let curvature = found.curvature.map(|controls| {
            Mat::from_fn(n, n, |i, j| {
                if i < self.n_controls && j < self.n_controls {
                    controls[(i, j)]
                } else {
                    0.0
                }
            })
        });
        Linearization {
            gradient: objective.gradient,
            model_gradient,
            defect_slope: objective.defect_slope,
            gauss_newton: objective.gauss_newton,
            curvature,
            jacobian: self.jacobian(&rows.along_controls, n),
            offset,
            rows: request.rows.to_vec(),
            inequality_jacobian: self.inequality_jacobian(request, &rows.along_controls, n),
            inequality_offset,
        }
    }

    /// Returns the derivative of the constraints along all `n` variables from that along the controls.
    fn jacobian(&self, values: &Mat<f64>, n: usize) -> Mat<f64> {
        let shortfall = self.relaxation.as_ref().map(|_| n - 1);
        Mat::from_fn(self.goal_rows.len(), n, |i, j| {
            if j < self.n_controls {
                values[(i, j)]
            } else if shortfall == Some(j) {
                self.relaxed_constraint(i)
            } else if self.slack_variables[i] == Some(j) {
                -self.slack_units[i]
            } else {
                0.0
            }
        })
    }

    /// Returns the derivative of the requested inequalities along all `n` variables from that along the controls.
    fn inequality_jacobian(
        &self,
        request: &LinearizationRequest,
        values: &Mat<f64>,
        n: usize,
    ) -> Mat<f64> {
        let shortfall = self.relaxation.as_ref().map(|_| n - 1);
        let n_goals = self.goal_rows.len();
        let mut jacobian = Mat::from_fn(request.rows.len(), n, |i, j| {
            if j < self.n_controls {
                values[(n_goals + i, j)]
            } else if shortfall == Some(j) {
                self.relaxed_inequality(request.rows[i])
            } else {
                0.0
            }
        });
        for (i, &row) in request.rows.iter().enumerate() {
            for (column, slope) in self.path_columns(row) {
                jacobian[(i, column)] += slope;
            }
        }
        jacobian
    }

    /// Returns the model of the objective: that of the controls, and that of the costs, whose values begin at `first_cost`.
    fn objective(
        &self,
        point: &LiftedPoint,
        costs: &[CostRow],
        rows: &RowValues,
        first_cost: usize,
    ) -> ObjectiveModel {
        let n = point.variables.len();
        let n_controls = self.n_controls;
        let (_, mut gradient) = self.control_cost.value(&point.variables);
        let mut gauss_newton = self.control_cost.hessian().clone();
        let mut defect_slope = 0.0;
        let mut of_defects = vec![0.0; n];
        if !costs.is_empty() {
            let values = rows.along_controls.subrows(first_cost, costs.len());
            let square = if costs.len() * n * n < MANY_PRODUCTS {
                values.transpose() * values
            } else {
                let (own, stop) = (values.to_owned(), &self.problem.stop);
                // The caller discards the result after a stop.
                stop.unless_raised(LARGE, move || own.transpose() * &own)
                    .unwrap_or_else(|_| Mat::zeros(values.ncols(), values.ncols()))
            };
            for j in 0..n_controls {
                for i in 0..n_controls {
                    gauss_newton[(i, j)] += square[(i, j)];
                }
            }
            for (i, cost) in costs.iter().enumerate() {
                let answer = rows.responses[(first_cost + i, 0)];
                defect_slope += cost.residual * answer;
                for j in 0..n_controls {
                    gradient[j] += values[(i, j)] * cost.residual;
                    of_defects[j] += values[(i, j)] * answer;
                }
            }
        }
        ObjectiveModel {
            gradient,
            gauss_newton,
            defect_slope,
            of_defects,
        }
    }
}

/// The values of all rows, of goals, of the requested inequalities and of costs.
struct RowValues {
    along_controls: Mat<f64>,
    /// Along the response to the defects, in one column.
    responses: Mat<f64>,
}

/// First and second derivatives of the objective, by Gauss and Newton.
struct ObjectiveModel {
    gradient: Vec<f64>,
    gauss_newton: Mat<f64>,
    /// Change of the objective by the response to the defects.
    defect_slope: f64,
    /// What this response adds to the gradient.
    of_defects: Vec<f64>,
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Adds `Fᵀ C F` of the second derivatives whose forms are the rows from `first` on.
fn add_curvature_across(
    bent: &[RowCurvature],
    first: usize,
    values: &Mat<f64>,
    responses: &Mat<f64>,
    found: &mut Sensitivities,
    stop: &StopSignal,
) {
    let (Some(curvature), Some(sources)) =
        (found.curvature.as_mut(), found.curvature_sources.as_mut())
    else {
        return;
    };
    let mut first = first;
    for own in bent {
        if stop.is_raised() {
            return;
        }
        let m = own.forms.len();
        let rows = values.subrows(first, m);
        let matrix = Mat::from_fn(m, m, |i, j| own.matrix[(i, j)]);
        let weighted = &matrix * rows;
        *curvature += rows.transpose() * &weighted;
        *sources += weighted.transpose() * responses.subrows(first, m);
        first += m;
    }
}
