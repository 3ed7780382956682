//! The second derivative of the Lagrangian: its terms against the scalar functions they belong to, and its reduction
//! to the controls against the motion itself.

use crate::common;

use common::differentiated::{Moved, energy};
use common::plain::Plain;
use common::plain_curvature::lagrangian_curvature;
use common::{
    Dice, Method, RULES, bases, busy_arm, exact_methods, laws, random_sources, random_state,
    random_trajectory,
};
use faer::Mat;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use softarm::mechanics::curvature::{
    MotionMultipliers, OwnCurvature, element_curvature, inertia_curvature, load_curvature,
    resistance_curvatures, stress_curvature,
};
use softarm::mechanics::element::{
    Element, ElementGradient, ElementPose, ElementStrain, IntervalStress,
};
use softarm::mechanics::implicit::IntervalWeights;
use softarm::mechanics::linearization::{AdjointSweep, Motion, RightHandSide, StateTangent};
use softarm::mechanics::resistance::Resistance;
use softarm::mechanics::rotation::{exp, log, log_tangent, vee};
use softarm::mechanics::sensitivity::{
    ControlColumns, Sensitivities, adjoint, defects, sensitivities,
};
use softarm::mechanics::stability::stable_step;
use softarm::mechanics::{
    BaseCondition, ControlSignal, FormTerm, Rod, RodModel, RodParameters, State, StateForm,
    Stepper, StrainRule, TimeGrid, Trajectory, Wrench,
};

/// Second difference `w''(0)` of a smooth function, extrapolated once: truncation `step⁴`, rounding `1e-16/step²`.
fn second_difference(step: f64, w: impl Fn(f64) -> f64) -> f64 {
    let at = |s: f64| (w(s) - 2.0 * w(0.0) + w(-s)) / (s * s);
    (4.0 * at(step) - at(2.0 * step)) / 3.0
}

/// Random pose with strains and bends up to order one, random covector and direction, both rules: the form of the
/// element is the second difference of `λ·∇U` along the chart, `1e-16/h² = 1e-10` of the terms at `h = 1e-3`.
#[test]
fn element_curvature_is_the_second_derivative() {
    let mut dice = Dice(11);
    let mut worst: f64 = 0.0;
    for trial in 0..200 {
        for (rule, model) in laws() {
            let (l, bend) = (0.13, [1.2, 1e-4, 0.0][trial % 3]);
            let first = Vector3::new(0.1, -0.05, 1.1);
            let element = Element {
                model,
                length: l,
                linear_stiffness: Vector3::new(2.0, 2.5, 7.0),
                angular_stiffness: Vector3::new(0.03, 0.02, 0.05),
                rest: ElementStrain {
                    linear: match rule {
                        StrainRule::Helical => [first; 2],
                        StrainRule::Trapezoidal => [first, Vector3::new(0.05, 0.02, 0.95)],
                    },
                    curvature: Vector3::new(0.4, -0.2, 0.6),
                },
            };
            let rotation_a = exp(&dice.vector(1.5));
            let rotation_b = rotation_a * exp(&dice.vector(bend));
            let dx = rotation_a * (Vector3::z() + dice.vector(0.4)) * l;
            let mut nine = |length: f64| {
                let (a, b, c) = (dice.vector(length), dice.vector(1.0), dice.vector(1.0));
                SVector::<f64, 9>::from_iterator(a.iter().chain(&b).chain(&c).copied())
            };
            let (covector, direction) = (nine(l), nine(l));
            let part =
                |v: &SVector<f64, 9>, i: usize| -> Vector3<f64> { v.fixed_rows::<3>(3 * i).into() };
            let w = |s: f64| {
                let gradient = element.gradient(
                    rule,
                    &ElementPose {
                        dx: dx + s * part(&direction, 0),
                        rotation_a: &(rotation_a * exp(&(s * part(&direction, 1)))),
                        rotation_b: &(rotation_b * exp(&(s * part(&direction, 2)))),
                    },
                );
                gradient.force.dot(&part(&covector, 0))
                    + gradient.moment_a.dot(&part(&covector, 1))
                    + gradient.moment_b.dot(&part(&covector, 2))
            };
            let pose = ElementPose {
                dx,
                rotation_a: &rotation_a,
                rotation_b: &rotation_b,
            };
            let (_, stiffness) = element.stiffness(rule, &pose);
            let q = element_curvature(&element, rule, &pose, &stiffness, &covector);
            assert_eq!(q, q.transpose());
            let size = direction.abs().dot(&(q.abs() * direction.abs()));
            let error = direction.dot(&(q * direction)) - second_difference(1e-3, w);
            worst = worst.max(error.abs() / size);
        }
    }
    assert!(worst < 1e-8, "{worst:e}");
}

/// Strain derivative, pull of a given stress, gradient and stiffness of an element, by both rules and all laws, are those that automatic
/// differentiation finds: to a thousand roundings of the largest entry, which are lost where a bend of 1e-4 rad is a difference of rotations.
#[test]
fn derivatives_of_an_element_are_those_of_its_energy() {
    let mut dice = Dice(17);
    for trial in 0..60 {
        for (rule, model) in laws() {
            let (l, bend) = (0.13, [1.2, 2.9, 0.3, 1e-4, 0.0][trial % 5]);
            let first = Vector3::new(0.1, -0.05, 1.1);
            let second = Vector3::new(0.05, 0.02, 0.95);
            let element = Element {
                model,
                length: l,
                linear_stiffness: Vector3::new(2.0, 2.5, 7.0),
                angular_stiffness: Vector3::new(0.03, 0.02, 0.05),
                rest: ElementStrain {
                    linear: match rule {
                        StrainRule::Helical => [first; 2],
                        StrainRule::Trapezoidal => [first, second.normalize() * first.norm()],
                    },
                    curvature: Vector3::new(0.4, -0.2, 0.6),
                },
            };
            let rotation_a = exp(&dice.vector(1.5));
            let rotation_b = rotation_a * exp(&(dice.vector(1.0).normalize() * bend));
            let pose = ElementPose {
                dx: rotation_a * (Vector3::z() + dice.vector(0.4)) * l,
                rotation_a: &rotation_a,
                rotation_b: &rotation_b,
            };
            let stress = IntervalStress {
                linear: match rule {
                    StrainRule::Helical => [dice.vector(1.0); 2],
                    StrainRule::Trapezoidal => [dice.vector(1.0), dice.vector(1.0)],
                },
                angular: dice.vector(0.05),
            };
            let flat = |g: &ElementGradient| {
                let parts = g.force.iter().chain(&g.moment_a).chain(&g.moment_b);
                SVector::<f64, 9>::from_iterator(parts.copied())
            };
            let (gradient, stiffness) = element.stiffness(rule, &pose);
            let found = (
                rule.strain_derivative(l, &pose).1,
                flat(&element.gradient_under(rule, &pose, &stress)),
                flat(&gradient),
                stiffness,
            );
            let mut expected = (
                SMatrix::<f64, 9, 9>::zeros(),
                SVector::<f64, 9>::zeros(),
                SVector::<f64, 9>::zeros(),
                SMatrix::<f64, 9, 9>::zeros(),
            );
            for i in 0..9 {
                for j in 0..9 {
                    let moved = Moved::along(&pose, i, j);
                    let strains = moved.strains(rule, l);
                    let energy = energy(&element, &strains);
                    expected.3[(i, j)] = energy.eps1eps2;
                    expected.2[i] = energy.eps1;
                    for (row, strain) in strains.as_flattened().iter().enumerate() {
                        expected.0[(row, i)] = strain.eps1;
                    }
                }
                let along = |part: usize| -> Vector3<f64> {
                    expected.0.fixed_view::<3, 1>(3 * part, i).into()
                };
                let work = [0, 1].map(|end| 0.5 * stress.linear[end].dot(&along(end)));
                expected.1[i] = l * (work[0] + work[1] + stress.angular.dot(&along(2)));
            }
            let case = format!("{rule:?} {model:?} {bend}");
            // Near half a turn the cosine that the trapezoidal rule divides by has few digits.
            let tolerance = if bend > 2.0 { 1e-10 } else { 1e-12 };
            let close = |error: f64, size: f64, what: &str| {
                assert!(
                    error < tolerance * size,
                    "{case} {what}: {:e}",
                    error / size
                );
            };
            close((found.0 - expected.0).amax(), expected.0.amax(), "strain");
            close((found.1 - expected.1).amax(), expected.1.amax(), "pull");
            close((found.2 - expected.2).amax(), expected.2.amax(), "gradient");
            close(
                (found.3 - expected.3).amax(),
                expected.3.amax(),
                "stiffness",
            );
        }
    }
}

/// Random poses at both ends of an interval, random covectors and directions, weights of implicit steps and of damping, both
/// rules: the forms of the interval are the second difference of `w_start·B_startᵀσ + w_end·B_endᵀσ` along the charts.
#[test]
fn stress_curvature_is_the_second_derivative() {
    let mut dice = Dice(14);
    let mut worst: f64 = 0.0;
    let l = 0.13;
    for trial in 0..200 {
        for rule in RULES {
            let element = Element {
                model: RodModel::Standard,
                length: l,
                linear_stiffness: Vector3::new(2.0, 2.5, 7.0),
                angular_stiffness: Vector3::new(0.03, 0.02, 0.05),
                rest: ElementStrain {
                    linear: [Vector3::new(0.1, -0.05, 1.1); 2],
                    curvature: Vector3::new(0.4, -0.2, 0.6),
                },
            };
            let weights = [
                IntervalWeights {
                    start: 0.5,
                    end: 0.5,
                },
                IntervalWeights {
                    start: -1.3,
                    end: 2.3,
                },
            ][trial % 2];
            let bend = [1.2, 1e-4, 0.0][trial % 3];
            let poses: [_; 2] = std::array::from_fn(|_| {
                let a = exp(&dice.vector(1.5));
                let b = a * exp(&dice.vector(bend));
                (a * (Vector3::z() + dice.vector(0.4)) * l, a, b)
            });
            let mut nine = || {
                let (a, b, c) = (dice.vector(l), dice.vector(1.0), dice.vector(1.0));
                SVector::<f64, 9>::from_iterator(a.iter().chain(&b).chain(&c).copied())
            };
            let covectors = [nine(), nine()];
            let directions = [nine(), nine()];
            let part =
                |v: &SVector<f64, 9>, i: usize| -> Vector3<f64> { v.fixed_rows::<3>(3 * i).into() };
            let w = |s: f64| {
                let moved: [_; 2] = std::array::from_fn(|end| {
                    let ((dx, a, b), d) = (&poses[end], &directions[end]);
                    let turn = |r: &Matrix3<f64>, i: usize| r * exp(&(s * part(d, i)));
                    (dx + s * part(d, 0), turn(a, 1), turn(b, 2))
                });
                let poses = (moved.each_ref()).map(|(dx, a, b)| ElementPose {
                    dx: *dx,
                    rotation_a: a,
                    rotation_b: b,
                });
                let [start, end] = (poses.each_ref()).map(|pose| rule.strain(l, pose));
                let stress = element.interval_stress([&start, &end], [weights.start, weights.end]);
                (poses.iter().zip(&covectors))
                    .map(|(pose, covector)| {
                        let pull = element.gradient_under(rule, pose, &stress);
                        pull.force.dot(&part(covector, 0))
                            + pull.moment_a.dot(&part(covector, 1))
                            + pull.moment_b.dot(&part(covector, 2))
                    })
                    .sum::<f64>()
            };
            let ends: [_; 2] = std::array::from_fn(|end| {
                let (dx, a, b) = &poses[end];
                let pose = ElementPose {
                    dx: *dx,
                    rotation_a: a,
                    rotation_b: b,
                };
                (pose, covectors[end])
            });
            let q = stress_curvature(&element, rule, weights, &ends);
            assert_eq!(q.start, q.start.transpose());
            assert_eq!(q.end, q.end.transpose());
            let [a, b] = directions;
            let form = |q: [SMatrix<f64, 9, 9>; 3], a: &SVector<f64, 9>, b: &SVector<f64, 9>| {
                a.dot(&(q[0] * a)) + 2.0 * a.dot(&(q[1] * b)) + b.dot(&(q[2] * b))
            };
            let blocks = [q.start, q.cross, q.end];
            let size = form(blocks.map(|q| q.abs()), &a.abs(), &b.abs());
            let error = form(blocks, &a, &b) - second_difference(1e-3, w);
            worst = worst.max(error.abs() / size);
        }
    }
    assert!(worst < 1e-8, "{worst:e}");
}

/// Nothing pulls: the curvature is zero, not a division by zero.
#[test]
fn element_curvature_of_nothing_is_zero() {
    for rule in RULES {
        let rod = Rod::new(&busy_arm(rule, 3)).unwrap();
        let (x, r) = (&rod.rest.positions, &rod.rest.rotations);
        let pose = Rod::element_pose(1, x, r);
        let (_, stiffness) = rod.elements[1].stiffness(rule, &pose);
        let q = element_curvature(&rod.elements[1], rule, &pose, &stiffness, &SVector::zeros());
        assert_eq!(q, q * 0.0);
    }
}

/// Random turn of less than a quarter, three different moments of inertia: the form is the second difference of
/// `μ·π(F) - λ·g(F)`, with the momenta written as in the equations of motion.
#[test]
fn inertia_curvature_is_the_second_derivative() {
    let mut dice = Dice(12);
    let h = 0.01;
    let mut worst: f64 = 0.0;
    for trial in 0..200 {
        let rotary = Vector3::new(0.3, 0.5, 0.7) + dice.vector(0.1);
        let turn = exp(&dice.vector([0.9, 1e-5, 0.0][trial % 3]));
        let (lambda, mu) = (dice.vector(1.0), dice.vector(1.0));
        let (before, after) = (dice.vector(1.0), dice.vector(1.0));
        let j_d =
            Matrix3::from_diagonal_element(0.5 * rotary.sum()) - Matrix3::from_diagonal(&rotary);
        let w = |s: f64| {
            let f = exp(&(-s * before)) * turn * exp(&(s * after));
            let g = vee(&(f * j_d - j_d * f.transpose())) / h;
            mu.dot(&(f.transpose() * g)) - lambda.dot(&g)
        };
        let q = inertia_curvature([&rotary; 2], h, &turn, &lambda, &mu);
        assert_eq!(q, q.transpose());
        let z = SVector::<f64, 6>::from_iterator(before.iter().chain(&after).copied());
        let error = z.dot(&(q * z)) - second_difference(1e-3, w);
        worst = worst.max(error.abs() / z.abs().dot(&(q.abs() * z.abs())));
    }
    assert!(worst < 1e-8, "{worst:e}");
}

/// A vector turned forward or back: its second difference against the form.
#[test]
fn load_curvature_is_the_second_derivative() {
    let mut dice = Dice(13);
    for _ in 0..100 {
        let (lambda, v, zeta) = (dice.vector(1.0), dice.vector(1.0), dice.vector(1.0));
        let q = load_curvature(&lambda, &v);
        for sign in [-1.0, 1.0] {
            let w = |s: f64| lambda.dot(&(exp(&(sign * s * zeta)) * v));
            let error = zeta.dot(&(q * zeta)) - second_difference(1e-3, w);
            assert!(error.abs() < 1e-8, "{error:e}");
        }
    }
}

/// Blocks of constant control, six components each, on one node.
struct Blocks {
    n_blocks: usize,
    n_steps: usize,
    node: usize,
}

impl ControlColumns for Blocks {
    fn n_columns(&self) -> usize {
        6 * self.n_blocks
    }

    fn visit(&self, k: usize, visit: &mut dyn FnMut(usize, usize, usize, f64)) {
        let block = (k * self.n_blocks / self.n_steps).min(self.n_blocks - 1);
        for component in 0..6 {
            visit(6 * block + component, self.node, component, 1.0);
        }
    }

    fn n_started(&self, k: usize) -> usize {
        6 * ((k * self.n_blocks / self.n_steps).min(self.n_blocks - 1) + 1)
    }
}

impl Blocks {
    /// The wrenches of one column, times `size`, added to `base`.
    fn added(&self, base: &ControlSignal, column: usize, size: f64) -> ControlSignal {
        let mut control = base.clone();
        for (k, wrench) in control.wrenches.iter_mut().enumerate() {
            self.visit(k, &mut |c, _, component, weight| {
                if c == column && component < 3 {
                    wrench.force[component] += size * weight;
                } else if c == column {
                    wrench.moment[component - 3] += size * weight;
                }
            });
        }
        control
    }

    /// No wrench at all.
    fn nothing(&self) -> ControlSignal {
        ControlSignal::on(vec![self.node], vec![Wrench::default(); self.n_steps + 1])
    }

    /// What the columns see of an adjoint.
    fn gradient(&self, motion: &Motion, adjoint: &AdjointSweep) -> Vec<f64> {
        let mut gradient = vec![0.0; self.n_columns()];
        for k in 0..=self.n_steps {
            let wrench = adjoint.wrench(motion, k, self.node);
            self.visit(k, &mut |c, _, component, weight| {
                gradient[c] += weight
                    * if component < 3 {
                        wrench.force[component]
                    } else {
                        wrench.moment[component - 3]
                    };
            });
        }
        gradient
    }
}

struct Case {
    rod: Rod,
    grid: TimeGrid,
    initial: State,
    control: ControlSignal,
    /// Ascending in time.
    forms: Vec<StateForm>,
    own: Vec<OwnCurvature>,
    blocks: Blocks,
}

impl Case {
    /// Loads, damping, taper, gravity, an initial motion, a random control, and as outcome the sum of `forms`, of components of
    /// the tip at the end and of another node on the way, and of quadratic forms in `x - x₀` and `log(R₀ᵀR)` at both; `x₀` and
    /// `R₀` are those of the trajectory at which it is asked for.
    fn new(method: Method, base: BaseCondition, n_steps: usize, n_blocks: usize) -> Self {
        let rod = method.rod(RodParameters {
            base,
            ..busy_arm(method.rule, 4)
        });
        let mut dice = Dice(21);
        let initial = random_state(&rod, 0.05, 0.5, &mut dice);
        let tip = rod.tip();
        let on_the_way = 3 * n_steps / 4;
        let mut form = |time_node: usize, node: usize| {
            let mut covector = StateTangent::zeros(rod.n_nodes());
            covector.positions[node] = dice.vector(1.0);
            covector.rotations[node] = dice.vector(0.1);
            covector.linear[node] = dice.vector(0.1 / rod.nodes[node].mass);
            covector.angular[node] = dice.vector(0.01 / rod.nodes[node].rotary.x);
            StateForm::of_covector(time_node, &covector)
        };
        let forms = vec![form(on_the_way, 2), form(n_steps, tip)];
        let mut own = |time_node: usize, rows: Vec<(usize, usize)>| {
            let half = Mat::from_fn(rows.len(), rows.len(), |_, _| dice.vector(1.0).x);
            OwnCurvature {
                forms: Vec::new(),
                earlier: Vec::new(),
                time_node,
                rows,
                matrix: &half + half.transpose(),
            }
        };
        let own = vec![
            own(on_the_way, vec![(2, 0), (tip, 4), (2, 5), (tip, 1)]),
            own(on_the_way, vec![(1, 2)]),
            own(n_steps, vec![(tip, 3), (tip, 4), (tip, 5)]),
        ];
        let node = tip - 1;
        let wrenches = (0..=n_steps)
            .map(|_| Wrench {
                force: dice.vector(1.0),
                moment: dice.vector(0.1),
            })
            .collect();
        Self {
            grid: TimeGrid {
                start: 0.0,
                step: 0.5 * stable_step(&rod),
                n_steps,
            },
            initial,
            control: ControlSignal::on(vec![node], wrenches),
            forms,
            own,
            blocks: Blocks {
                n_blocks,
                n_steps,
                node,
            },
            rod,
        }
    }

    fn motion(&self) -> Motion<'_> {
        Motion {
            stop: None,
            rod: &self.rod,
            grid: self.grid,
            initial: &self.initial,
            control: None,
        }
    }

    fn roll_out(&self, control: &ControlSignal) -> Trajectory {
        let mut trajectory = Trajectory::with_capacity(self.rod.n_nodes(), self.grid.n_steps + 1);
        trajectory.push(&self.initial.configuration);
        let mut integrator = Stepper::new(&self.rod, self.grid.step, self.initial.clone());
        for k in 0..self.grid.n_steps {
            integrator
                .advance([control.at(k), control.at(k + 1)])
                .unwrap();
            trajectory.push(&integrator.state().configuration);
        }
        trajectory
    }

    fn sources(&self, trajectory: &Trajectory) -> [RightHandSide; 2] {
        let d = defects(&self.motion(), trajectory, &self.control).unwrap();
        let dice = &mut Dice(31);
        let other = random_sources(&self.rod, self.grid.n_steps, 1e-3, dice);
        [RightHandSide::against(&d), other]
    }

    fn sweep(&self, trajectory: &Trajectory, n_threads: usize) -> Sensitivities {
        let motion = self.motion();
        let adjoint = adjoint(&motion, trajectory, &self.forms, 1).unwrap();
        let mut own = self.own.clone();
        own.extend(resistance_curvatures(&motion, trajectory, &adjoint));
        own.sort_by_key(|own| own.time_node);
        let multipliers = MotionMultipliers {
            adjoint: &adjoint,
            own: &own,
        };
        let sources = self.sources(trajectory);
        sensitivities(
            &motion,
            trajectory,
            &sources.each_ref(),
            &self.blocks,
            &self.forms,
            Some(&multipliers),
            n_threads,
        )
        .unwrap()
    }

    fn sweep_curvature(&self, trajectory: &Trajectory, n_threads: usize) -> Mat<f64> {
        self.sweep(trajectory, n_threads).curvature.unwrap()
    }

    /// `x - x₀` or a component of `log(R₀ᵀR)`.
    fn coordinate(
        trajectory: &Trajectory,
        start: &Trajectory,
        k: usize,
        (node, component): (usize, usize),
    ) -> f64 {
        if component < 3 {
            (trajectory.positions_at(k)[node] - start.positions_at(k)[node])[component]
        } else {
            let r = start.rotations_at(k)[node].tr_mul(&trajectory.rotations_at(k)[node]);
            log(&r)[component - 3]
        }
    }

    /// Derivative of the outcome, all of it, at another trajectory than the one where it starts.
    fn forms_at(&self, trajectory: &Trajectory, start: &Trajectory) -> Vec<StateForm> {
        // ∂/∂ζ of log(R₀ᵀR)·y is S y.
        let pulled = |k: usize, node: usize, y: Vector3<f64>| {
            let psi = log(&start.rotations_at(k)[node].tr_mul(&trajectory.rotations_at(k)[node]));
            log_tangent(&psi) * y
        };
        let mut forms = self.forms.clone();
        for own in &self.own {
            let z: Vec<f64> = (own.rows.iter())
                .map(|row| Self::coordinate(trajectory, start, own.time_node, *row))
                .collect();
            let terms = (own.rows.iter().enumerate()).map(|(i, &(node, component))| FormTerm {
                node,
                component,
                coefficient: (0..z.len()).map(|j| own.matrix[(i, j)] * z[j]).sum(),
            });
            forms.push(StateForm {
                time_node: own.time_node,
                terms: terms.collect(),
            });
        }
        for form in &mut forms {
            let k = form.time_node;
            form.terms = (form.terms.iter())
                .flat_map(|term| {
                    if !(3..6).contains(&term.component) {
                        return vec![*term];
                    }
                    let y = Vector3::ith(term.component - 3, term.coefficient);
                    let covector = pulled(k, term.node, y);
                    (0..3)
                        .map(|axis| FormTerm {
                            component: 3 + axis,
                            coefficient: covector[axis],
                            ..*term
                        })
                        .collect()
                })
                .collect();
        }
        forms.sort_by_key(|form| form.time_node);
        forms
    }

    /// `dφ/du` of the rolled-out motion.
    fn gradient(&self, control: &ControlSignal, start: &Trajectory) -> Vec<f64> {
        let trajectory = self.roll_out(control);
        let forms = self.forms_at(&trajectory, start);
        let adjoint = adjoint(&self.motion(), &trajectory, &forms, 1).unwrap();
        self.blocks.gradient(&self.motion(), &adjoint)
    }

    /// `L(u, q)`, the multipliers held; without the momenta on the way, which the defects do not tell.
    fn lagrangian(
        &self,
        trajectory: &Trajectory,
        start: &Trajectory,
        control: &ControlSignal,
        multipliers: &MotionMultipliers,
    ) -> f64 {
        let d = defects(&self.motion(), trajectory, control).unwrap();
        let rows: f64 = (d.linear.iter().zip(&multipliers.adjoint.linear))
            .chain(d.angular.iter().zip(&multipliers.adjoint.angular))
            .map(|(r, lambda)| r.dot(lambda))
            .sum();
        let linear: f64 = (self.forms.iter())
            .flat_map(|form| form.terms.iter().map(|term| (form.time_node, term)))
            .map(|(k, term)| {
                let axis = term.component % 3;
                let value = match term.component / 3 {
                    0 => trajectory.positions_at(k)[term.node][axis],
                    1 => Self::coordinate(trajectory, start, k, (term.node, term.component)),
                    2 => d.terminal_linear[term.node][axis],
                    _ => d.terminal_angular[term.node][axis],
                };
                term.coefficient * value
            })
            .sum();
        let mut quadratic = 0.0;
        for own in &self.own {
            let z = |i: usize| Self::coordinate(trajectory, start, own.time_node, own.rows[i]);
            for i in 0..own.rows.len() {
                for j in 0..own.rows.len() {
                    quadratic += 0.5 * own.matrix[(i, j)] * z(i) * z(j);
                }
            }
        }
        linear + quadratic - rows
    }
}

/// Largest entry per kind of column, force or moment.
fn sizes(h: &Mat<f64>) -> [[f64; 2]; 2] {
    let mut sizes = [[0.0f64; 2]; 2];
    for j in 0..h.ncols() {
        for i in 0..h.nrows() {
            let size = &mut sizes[i % 6 / 3][j % 6 / 3];
            *size = size.max(h[(i, j)].abs());
        }
    }
    sizes
}

/// Largest difference relative to the largest entry of the same kinds of columns.
fn distance(a: &Mat<f64>, b: &Mat<f64>) -> f64 {
    let sizes = sizes(b);
    let mut worst: f64 = 0.0;
    for j in 0..b.ncols() {
        for i in 0..b.nrows() {
            worst = worst.max((a[(i, j)] - b[(i, j)]).abs() / sizes[i % 6 / 3][j % 6 / 3]);
        }
    }
    worst
}

/// Integrated motions with loads, damping and taper, clamped, free and driven: the reduced second derivative is the central
/// difference, extrapolated once, of the adjoint gradient of an outcome of the end and of the way, and it is symmetric.
#[test]
fn reduced_curvature_is_the_hessian_of_the_outcome() {
    for (method, resists) in exact_methods().flat_map(|own| [(own, false), (own, true)]) {
        for base in bases() {
            let mut case = Case::new(method, base.clone(), 70, 4);
            if resists {
                case.rod.resistances = (case.rod.nodes.iter())
                    .map(|own| Resistance {
                        normal: 3.0 * own.mass,
                        tangential: own.mass,
                    })
                    .collect();
            }
            let start = case.roll_out(&case.control);
            let curvature = case.sweep_curvature(&start, 1);
            let n = case.blocks.n_columns();
            let mut differences = Mat::zeros(n, n);
            for j in 0..n {
                let step = if j % 6 < 3 { 1e-2 } else { 1e-3 };
                let at = |step: f64| -> Vec<f64> {
                    let plus = case.gradient(&case.blocks.added(&case.control, j, step), &start);
                    let minus = case.gradient(&case.blocks.added(&case.control, j, -step), &start);
                    (plus.iter().zip(&minus))
                        .map(|(p, m)| (p - m) / (2.0 * step))
                        .collect()
                };
                let (fine, coarse) = (at(step), at(2.0 * step));
                for i in 0..n {
                    differences[(i, j)] = (4.0 * fine[i] - coarse[i]) / 3.0;
                    assert_eq!(curvature[(i, j)], curvature[(j, i)]);
                }
            }
            let error = distance(&curvature, &differences);
            assert!(error < 1e-7, "{method:?} {base:?} {resists}: {error:e}");
        }
    }
}

/// More than one tile, several rounds and chunks, on a lifted trajectory: the sweep equals the clear reduction of
/// the columns of the forward sweep, and the number of threads changes no bit. Both take differences of the stiffness by themselves, each
/// good to about 1e-10; the stress that damps and the elastic one bend against each other.
#[test]
fn fast_reduction_equals_the_clear_one() {
    for method in exact_methods() {
        for base in bases() {
            let case = Case::new(method, base.clone(), 70, 6);
            let trajectory = random_trajectory(&case.rod, &case.initial, case.grid, &mut Dice(5));
            let found = case.sweep(&trajectory, 1);
            let [fast, mixed, between] = [
                found.curvature,
                found.curvature_sources,
                found.source_curvature,
            ]
            .map(Option::unwrap);
            for n_threads in [2, 3, 50] {
                let again = case.sweep(&trajectory, n_threads);
                let same = found.forms == again.forms
                    && Some(&fast) == again.curvature.as_ref()
                    && Some(&mixed) == again.curvature_sources.as_ref()
                    && Some(&between) == again.source_curvature.as_ref();
                assert!(same, "{method:?} {base:?} {n_threads}");
            }
            let motion = case.motion();
            let nothing = case.blocks.nothing();
            let plain = Plain::along(&motion, &trajectory);
            let sweep = |sources: Option<&RightHandSide>, change: &ControlSignal| {
                plain.forward_sweep(sources, change).0
            };
            let mut columns: Vec<_> = (0..case.blocks.n_columns())
                .map(|j| sweep(None, &case.blocks.added(&nothing, j, 1.0)))
                .collect();
            let sources = case.sources(&trajectory);
            columns.extend(sources.each_ref().map(|s| sweep(Some(s), &nothing)));
            let adjoint = plain.adjoint_sweep(&case.forms);
            let multipliers = MotionMultipliers {
                adjoint: &adjoint,
                own: &case.own,
            };
            let clear = lagrangian_curvature(&motion, &trajectory, &multipliers, &columns);
            let n = case.blocks.n_columns();
            let tolerance = if method.internal_damping == 0.0 {
                2e-9
            } else {
                1e-8
            };
            let error = distance(&fast, &clear.submatrix(0, 0, n, n).to_owned());
            assert!(error < tolerance, "{method:?} {base:?}: {error:e}");
            for j in 0..2 {
                for i in 0..n {
                    let size = (0..n).fold(0.0f64, |m, i| m.max(clear[(i, n + j)].abs()));
                    assert!((mixed[(i, j)] - clear[(i, n + j)]).abs() < tolerance * size);
                }
                for i in 0..2 {
                    let size = clear[(n, n)].abs().max(clear[(n + 1, n + 1)].abs());
                    let error = (between[(i, j)] - clear[(n + i, n + j)]).abs() / size;
                    assert!(error < tolerance, "{method:?} {base:?}: {error:e}");
                }
            }
        }
    }
}

/// A lifted trajectory whose defects do not vanish: along the linearized answer to a change of the control, the
/// second difference of the Lagrangian's value is the form, and its first difference is the adjoint's gradient
/// (so `L` is stationary in the configurations). Both are good to `1e-16 |L|/s²` and the truncation `s⁴`, `s` in radians
/// of the largest rotation.
#[test]
fn curvature_is_that_of_the_lagrangian_on_a_lifted_trajectory() {
    for method in exact_methods() {
        for base in bases() {
            let mut case = Case::new(method, base.clone(), 40, 2);
            let forms = &mut case.forms;
            (forms[0].terms).retain(|term| term.component < 6);
            let trajectory = random_trajectory(&case.rod, &case.initial, case.grid, &mut Dice(6));
            let motion = case.motion();
            let plain = Plain::along(&motion, &trajectory);
            let adjoint = plain.adjoint_sweep(&case.forms);
            let multipliers = MotionMultipliers {
                adjoint: &adjoint,
                own: &case.own,
            };
            let curvature = case.sweep_curvature(&trajectory, 1);
            let gradient = case.blocks.gradient(&motion, &adjoint);
            let largest: Vec<f64> = (0..2).map(|i| sizes(&curvature)[i][i]).collect();
            let zero = case.blocks.nothing();
            for j in 0..case.blocks.n_columns() {
                let change = case.blocks.added(&zero, j, 1.0);
                let (direction, _) = plain.forward_sweep(None, &change);
                // A size at which the largest rotation is one: the chart's own unit.
                let unit = 1.0 / direction.largest_rotation();
                let value = |s: f64| {
                    case.lagrangian(
                        &trajectory.retract(&direction, s * unit),
                        &trajectory,
                        &case.blocks.added(&case.control, j, s * unit),
                        &multipliers,
                    )
                };
                let slope = (value(1e-4) - value(-1e-4)) / (2e-4 * unit);
                let slope_size = gradient.iter().fold(0.0f64, |m, g| m.max(g.abs()));
                let bend = second_difference(3e-3, value) / (unit * unit);
                let error = (bend - curvature[(j, j)]).abs() / largest[j % 6 / 3];
                assert!((slope - gradient[j]).abs() < 1e-6 * slope_size);
                assert!(error < 1e-6, "{method:?} {base:?} {j}: {error:e}");
            }
        }
    }
}
