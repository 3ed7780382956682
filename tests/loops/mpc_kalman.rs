//! The Kalman filter: what it carries its error with, whether the error is as large as it says, and what it finds.

use crate::commands::of_efforts;
use crate::estimating;
use crate::tracking::tendon_arm;

use estimating::{
    Truth, all_disturbances, at_rest, command, hanging, moving, normal, rod, scale, unit, upright,
    walk,
};
use nalgebra::{DMatrix, DVector, Vector3};
use softarm::mechanics::forces::NodalForces;
use softarm::mechanics::forms::NODE_COMPONENTS;
use softarm::mechanics::linearization::{Motion, StateTangent};
use softarm::mechanics::rotation::exp;
use softarm::mechanics::sensitivity::{RepeatedForward, transition};
use softarm::mechanics::stability::automatic_step;
use softarm::mechanics::strain_coordinates::{retract_shape, shape_difference};
use softarm::mechanics::{
    Configuration, Friction, Load, LoadFrame, NodeInertia, NodeWrenches, Rod, State, Stepper,
    TimeGrid, TimeScheme, Trajectory, Wrench,
};
use softarm::mpc::{
    Command, Disturbance, Estimator as _, KalmanFilter, KalmanSettings, Measurement, Predictor,
    Quantity, RandomWalk, Reading, Sensor, SensorPreset, SensorSettings, Unknown, Unknowns,
};
use softarm::task::{Arm, Discretization};

const PERIOD: f64 = 0.01;

/// The forward sweep that is done again and again gives the numbers of the one that is done once, over any number of steps of any length, with
/// any damping, in explicit and in implicit steps.
#[test]
fn repeated_sweeps_are_transitions() {
    for scheme in [TimeScheme::Explicit, TimeScheme::Implicit] {
        let mut repeated = None;
        for (n_steps, longer, viscous, internal) in [
            (3, 1.0, 0.0, 0.0),
            (40, 0.7, 1.0, 0.01),
            (7, 0.9, 5.0, 0.002),
        ] {
            let mut model = rod(&upright(), 5);
            model.scheme = scheme;
            model.viscous_damping = viscous;
            let mut step = longer * automatic_step(&model);
            if scheme == TimeScheme::Implicit {
                model.internal_damping = internal;
                step *= 5.0;
            }
            check_repeated_sweep(&model, (step, n_steps), &mut repeated);
        }
    }
}

fn check_repeated_sweep(
    model: &Rod,
    (step, n_steps): (f64, usize),
    repeated: &mut Option<RepeatedForward>,
) {
    let start = State::at_rest(model.rest.clone());
    let grid = TimeGrid {
        start: 0.0,
        step,
        n_steps,
    };
    let mut stepper = Stepper::new(model, grid, start.clone());
    let mut trajectory = Trajectory::with_capacity(model.n_nodes(), n_steps + 1);
    stepper.record(&mut trajectory);
    let push = [Wrench::from_array([3.0, 1.0, 0.0, 0.0, 0.5, 0.1])];
    for _ in 0..n_steps {
        let control = NodeWrenches::on(&[5], &push);
        stepper.advance([control; 2]).unwrap();
        stepper.record(&mut trajectory);
    }
    let motion = Motion {
        rod: model,
        grid,
        initial: &start,
        stop: None,
        control: None,
    };
    let inputs = [(5, 0), (2, 4)];
    let once = transition(&motion, &trajectory, 0..n_steps, &inputs, 1).unwrap();
    let sweep = repeated.get_or_insert_with(|| RepeatedForward::new(&motion, &trajectory, 2));
    sweep
        .sweep(&motion, &trajectory, &|_, visit| {
            for (index, (node, component)) in inputs.iter().enumerate() {
                visit(index, *node, *component, 1.0);
            }
        })
        .unwrap();
    let n = NODE_COMPONENTS * 5;
    let (mut state, mut input) = (faer::Mat::zeros(n, n), faer::Mat::zeros(n, 2));
    sweep.write(&mut state, &mut input);
    assert!(state == once.state && input == once.input, "{n_steps}");
}

/// Stiffness and inertia of the free nodes at rest, in their frames: by differences of the elastic forces about the shape at rest.
fn stiffness_and_inertia(model: &Rod) -> [DMatrix<f64>; 2] {
    const STEP: f64 = 1e-6;
    let first = model.first_free_node();
    let n = 6 * (model.n_nodes() - first);
    let forces = |component: usize, step: f64| {
        let mut at = model.rest.clone();
        let (node, axis) = (first + component / 6, component % 6);
        let vector = Vector3::ith(axis % 3, step);
        let rotation = at.rotations[node];
        if axis < 3 {
            at.positions[node] += rotation * vector;
        } else {
            at.rotations[node] *= exp(&vector);
        }
        let mut forces = NodalForces::zeros(model.n_nodes());
        forces.evaluate_elastic(model, &at.positions, &at.rotations);
        let all = (first..model.n_nodes()).flat_map(|q| {
            let force = model.rest.rotations[q].tr_mul(&forces.forces[q]);
            let moment = forces.moments[q];
            [force.x, force.y, force.z, moment.x, moment.y, moment.z]
        });
        DVector::from_iterator(n, all)
    };
    let columns: Vec<_> = (0..n)
        .map(|j| (forces(j, -STEP) - forces(j, STEP)) / (2.0 * STEP))
        .collect();
    let inertia = DMatrix::from_diagonal(&DVector::from_fn(n, |i, _| {
        let node = &model.nodes[first + i / 6];
        [node.mass, node.rotary[i % 3]][i % 6 / 3]
    }));
    [DMatrix::from_columns(&columns), inertia]
}

/// Poses or momenta of the free nodes, in the frames of the nodes of a shape or back: the first three of six components are spatial.
fn turned(model: &Rod, shape: &Configuration, of: &DVector<f64>, back: bool) -> DVector<f64> {
    DVector::from_fn(of.len(), |i, _| {
        if i % 6 >= 3 {
            return of[i];
        }
        let rotation = &shape.rotations[model.first_free_node() + i / 6];
        let at = 6 * (i / 6);
        let own = Vector3::new(of[at], of[at + 1], of[at + 2]);
        let own = if back {
            rotation * own
        } else {
            rotation.tr_mul(&own)
        };
        own[i % 6]
    })
}

/// Of a change of the state its slow part: `(M + θ K)⁻¹ M` of the poses and `M (M + θ K)⁻¹` of the momenta in the frames of the nodes, with `θ`
/// of the fifth bending mode.
fn slow_part(model: &Rod, shape: &Configuration, change: &[f64]) -> Vec<f64> {
    let [stiffness, inertia] = stiffness_and_inertia(model);
    let n = inertia.nrows();
    let theta = (model.scales.time / 199.859_530).powi(2);
    let both = (&inertia + stiffness * theta).lu();
    let part = |part: usize| {
        let own = DVector::from_fn(n, |i, _| change[12 * (i / 6) + 6 * part + i % 6]);
        turned(model, shape, &own, false)
    };
    let poses = both.solve(&(&inertia * part(0))).unwrap();
    let momenta = &inertia * both.solve(&part(1)).unwrap();
    let both = [poses, momenta].map(|own| turned(model, shape, &own, true));
    (0..2 * n)
        .map(|i| both[i % 12 / 6][6 * (i / 12) + i % 6])
        .collect()
}

/// A motion of a tenth of the size of others, mild enough for the elements to bear it.
fn moving_mildly(model: &Rod) -> State {
    let rest = State::at_rest(model.rest.clone());
    let mut tangent = moving(model, 1).difference(&rest);
    for part in [
        &mut tangent.positions,
        &mut tangent.rotations,
        &mut tangent.linear,
        &mut tangent.angular,
    ] {
        part.iter_mut().for_each(|v| *v *= 0.1);
    }
    rest.retract(&tangent)
}

/// What the filter carries its error with is the derivative of the motion that carries its estimate, along the state and along every
/// disturbance, along the parameters of the model the slow part of it, of a payload at the same velocity of the tip, and its covariance is `F P Fᵀ + Q` and
/// what the fast parts add to it; over more steps than it linearizes at once as well.
#[test]
fn predictions_are_the_linearized_motion() {
    for (arm, scheme) in [
        (upright(), TimeScheme::Explicit),
        (hanging(), TimeScheme::Explicit),
        (upright(), TimeScheme::Implicit),
        (hanging(), TimeScheme::Implicit),
    ] {
        let mut model = rod(&arm, 3);
        model.scheme = scheme;
        let damped = RandomWalk {
            initial: 0.01 * model.scales.time,
            change: 0.0,
        };
        let mut settings = all_disturbances(&model).with(Unknown::Internal, damped);
        let is_implicit = scheme == TimeScheme::Implicit;
        if is_implicit {
            model.internal_damping = 0.005 * model.scales.time;
            settings.longest_step *= 3.0;
        }
        let state = moving_mildly(&model);
        let mut filter = KalmanFilter::new(&model, 0.0, &state, &settings).unwrap();
        let before = dense(filter.covariance());
        let act = command(&model, 0.0, PERIOD);
        filter.advance(&act, PERIOD).unwrap();
        let [along_state, along_disturbance] = filter.transition().clone();
        let n_state = along_state.nrows();
        let n = before.nrows();
        let mut predictor = Predictor::new(&model, settings.longest_step);
        let mut end = |mut state: State, disturbance: &Disturbance| {
            let span = [0.0, PERIOD];
            predictor
                .advance(&mut state, span, &act, disturbance)
                .unwrap();
            state
        };
        assert_eq!(
            end(state.clone(), &Disturbance::NONE),
            filter.estimate().state
        );
        let first = model.first_free_node();
        let size: Vec<f64> = (0..n_state).map(|i| scale(&model, i)).collect();
        let compare = |column: usize, [minus, plus]: [State; 2], step: f64, unit: f64| {
            let tangent = plus.difference(&minus);
            let own = match column.checked_sub(n_state) {
                None => along_state.col(column),
                Some(column) => along_disturbance.col(column),
            };
            let mut slope: Vec<f64> = (tangent.components_from(first))
                .map(|value| value / (2.0 * step))
                .collect();
            let mut fast = DVector::zeros(n_state);
            if column >= n_state + 9 {
                let end = &filter.estimate().state;
                let at = NODE_COMPONENTS * (model.tip() - first) + 6;
                let velocity = |state: &State, axis: usize| {
                    let is_payload = column == n_state + 10;
                    let mass = model.nodes[model.tip()].mass;
                    f64::from(u8::from(is_payload)) * state.linear_momentum[model.tip()][axis]
                        / mass
                };
                for axis in 0..3 {
                    slope[at + axis] -= velocity(end, axis);
                }
                let slow = slow_part(&model, &end.configuration, &slope);
                fast = DVector::from_iterator(
                    n_state,
                    slope.iter().zip(&slow).map(|(all, slow)| all - slow),
                );
                slope = slow;
                for axis in 0..3 {
                    slope[at + axis] += velocity(end, axis);
                    for (row, slope) in slope.iter_mut().enumerate() {
                        *slope -= along_state[(row, at + axis)] * velocity(&state, axis);
                    }
                }
            }
            let scaled = |row: usize, value: f64| value * unit / size[row];
            let largest =
                (0..n_state).fold(1.0, |most: f64, row| most.max(scaled(row, own[row]).abs()));
            // Implicit steps are solved to the rounding of strains, which differences multiply.
            let most = if is_implicit { 1e-5 } else { 1e-6 };
            for (row, slope) in slope.iter().enumerate() {
                let error = scaled(row, own[row] - slope);
                // The differences, and those of the filter along the parameters, are good to their square and to rounding over them.
                assert!(
                    error.abs() < most * largest,
                    "{row} {column}: {error} of {largest}"
                );
            }
            fast
        };
        const STEP: f64 = 1e-5;
        for column in 0..n_state {
            let step = STEP * size[column];
            let ends = [-step, step].map(|step| {
                end(
                    state.retract(&unit(&model, column, step)),
                    &Disturbance::NONE,
                )
            });
            compare(column, ends, step, size[column]);
        }
        // What the fast parts of the parameters' columns add.
        let mut considered = DMatrix::zeros(n, n);
        for i in 0..12 + usize::from(is_implicit) {
            let unit = match i {
                0..3 => model.scales.force,
                3..6 => model.scales.moment,
                6..9 => model.scales.force / model.scales.length,
                9 => 1.0,
                10 => model.nodes[model.tip()].mass,
                11 => 1.0 / model.scales.time,
                _ => 0.01 * model.scales.time,
            };
            let step = STEP * unit;
            let ends = [-step, step].map(|step| {
                let mut disturbance = Disturbance::NONE;
                let (unknown, axis) = match i {
                    0..3 => (Unknown::TipForce, i),
                    3..6 => (Unknown::TipMoment, i - 3),
                    6..9 => (Unknown::Distributed, i - 6),
                    9 => (Unknown::Stiffness, 0),
                    10 => (Unknown::Payload, 0),
                    11 => (Unknown::Viscous, 0),
                    _ => (Unknown::Internal, 0),
                };
                disturbance.of_mut(unknown)[axis] += step;
                let mut start = state.clone();
                let tip = model.tip();
                start.linear_momentum[tip] *=
                    1.0 + disturbance.value(Unknown::Payload) / model.nodes[tip].mass;
                end(start, &disturbance)
            });
            let fast = compare(n_state + i, ends, step, unit);
            let mut own = considered.view_mut((0, 0), (n_state, n_state));
            own += &fast * fast.transpose() * before[(n_state + i, n_state + i)];
        }
        let mut whole = DMatrix::identity(n, n);
        whole
            .view_mut((0, 0), (n_state, n_state))
            .copy_from(&dense(&along_state));
        whole
            .view_mut((0, n_state), (n_state, n - n_state))
            .copy_from(&dense(&along_disturbance));
        let end = &filter.estimate().state.configuration;
        let root = noise_root(&model, &settings, end) * PERIOD.sqrt();
        // Internal damping comes last, and does not change.
        let noise = (&root * root.transpose()).resize(n, n, 0.0);
        let expected = &whole * &before * whole.transpose() + noise + considered;
        let found = dense(filter.covariance());
        for i in 0..n {
            for j in 0..n {
                let size = (expected[(i, i)] * expected[(j, j)]).sqrt();
                assert!(
                    (found[(i, j)] - expected[(i, j)]).abs() < 1e-5 * size,
                    "{i} {j}"
                );
                assert_eq!(found[(i, j)], found[(j, i)]);
            }
        }
        // Two parts, and the whole at once.
        let mut parts = KalmanFilter::new(&model, 0.0, &state, &settings).unwrap();
        let step = settings.longest_step;
        parts.advance(&act, 15.0 * step).unwrap();
        parts.advance(&act, 25.0 * step).unwrap();
        let mut once = KalmanFilter::new(&model, 0.0, &state, &settings).unwrap();
        once.advance(&act, 25.0 * step).unwrap();
        let (parts, once) = (dense(parts.covariance()), dense(once.covariance()));
        for i in 0..n {
            let error = parts[(i, i)] - once[(i, i)];
            assert!(error.abs() < 1e-6 * once[(i, i)], "{i}");
        }
    }
}

/// Between two measurements a covariance is propagated once, along the motions under all commands meanwhile: by the product of their derivatives, along the
/// state and along loads. What the filter says of the uncertainty of its unknowns in between is that of the covariance.
#[test]
fn commands_between_measurements_are_one_motion() {
    let model = rod(&upright(), 3);
    let settings = all_disturbances(&model);
    let state = moving_mildly(&model);
    let ends = [0.25, 0.4, 1.0].map(|part| part * PERIOD);
    let commands = |k: usize| {
        let start = if k == 0 { 0.0 } else { ends[k - 1] };
        command(&model, start, ends[k])
    };
    let mut once = KalmanFilter::new(&model, 0.0, &state, &settings).unwrap();
    let mut singly = KalmanFilter::new(&model, 0.0, &state, &settings).unwrap();
    let mut product: Option<[DMatrix<f64>; 2]> = None;
    for (k, end) in ends.iter().enumerate() {
        once.advance(&commands(k), *end).unwrap();
        singly.advance(&commands(k), *end).unwrap();
        let [along_state, along_load] = singly.transition();
        let (along_state, along_load) = (dense(along_state), dense(along_load));
        product = Some(match product {
            None => [along_state, along_load],
            Some([before, loads]) => [&along_state * before, &along_state * loads + along_load],
        });
        let [own, expected] = [&once, &singly].map(|filter| filter.estimate().deviation);
        for unknown in [Unknown::TipForce, Unknown::Payload, Unknown::Viscous] {
            let (own, expected) = (own.value(unknown), expected.value(unknown));
            assert!((own - expected).abs() < 1e-12 * expected, "{unknown:?}");
        }
    }
    assert_eq!(once.estimate(), singly.estimate());
    let [along_state, along_load] = once.transition();
    let [expected, loads] = product.unwrap();
    let n_loads = 9;
    for (found, expected, n) in [
        (dense(along_state), expected, along_state.ncols()),
        (dense(along_load), loads, n_loads),
    ] {
        for j in 0..n {
            let (found, expected) = (found.column(j), expected.column(j));
            let scaled = |row: usize| (found[row] - expected[row]) / scale(&model, row);
            let size = (0..found.len()).fold(0.0f64, |most, row| {
                most.max((expected[row] / scale(&model, row)).abs())
            });
            let error = (0..found.len()).fold(0.0f64, |most, row| most.max(scaled(row).abs()));
            assert!(error < 1e-11 * size, "{j}: {error:e} of {size:e}");
        }
    }
}

fn dense(m: &faer::Mat<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| m[(i, j)])
}

/// What the filter carries the friction of tendons with is the slow part of the derivative of its motion along their coefficient: of an arm
/// whose tendons slide while it moves. A model whose tendons have none has no such component.
#[test]
fn predictions_know_the_friction_of_tendons() {
    const STEP: f64 = 1e-5;
    let asked = Discretization {
        scheme: Some(TimeScheme::Implicit),
        ..Discretization::with_elements(4)
    };
    let mut arm = tendon_arm(3e5);
    let settings = |model: &Rod| KalmanSettings {
        longest_step: 2e-3,
        ..Unknowns::of(&[Unknown::Friction]).settings(model, PERIOD)
    };
    let without = arm.rod(&asked).unwrap();
    let filter = KalmanFilter::new(&without, 0.0, &at_rest(&without), &settings(&without));
    let n_state = NODE_COMPONENTS * (without.n_nodes() - without.first_free_node());
    assert_eq!(filter.unwrap().covariance().nrows(), n_state);
    // Their coefficients differ, and what is added is the same.
    for (tendon, coefficient) in arm.actuators.iter_mut().zip([0.1, 0.2, 0.1, 0.3]) {
        tendon.friction = Some(Friction {
            coefficient,
            ..Friction::default()
        });
    }
    let model = arm.rod(&asked).unwrap();
    let settings = settings(&model);
    let state = moving_mildly(&model);
    let added: [&[f64]; 2] = [&[0.0, 0.2, 0.0, -0.1], &[1.0, 0.0, 0.5, -0.1]];
    let act = of_efforts(&model, [0.0, PERIOD], added);
    let mut filter = KalmanFilter::new(&model, 0.0, &state, &settings).unwrap();
    filter.advance(&act, PERIOD).unwrap();
    let [_, along_disturbance] = filter.transition().clone();
    let mut predictor = Predictor::new(&model, settings.longest_step);
    let [minus, plus] = [-STEP, STEP].map(|added| {
        let mut end = state.clone();
        let disturbance = Disturbance::NONE.with(Unknown::Friction, &[added]);
        (predictor.advance(&mut end, [0.0, PERIOD], &act, &disturbance)).unwrap();
        end
    });
    let difference = plus.difference(&minus);
    let slope: Vec<f64> = (difference.components_from(model.first_free_node()))
        .map(|value| value / (2.0 * STEP))
        .collect();
    let expected = slow_part(&model, &filter.estimate().state.configuration, &slope);
    assert_eq!(along_disturbance.ncols(), 1);
    let scaled = |row: usize, value: f64| value / scale(&model, row);
    let rows = expected.iter().enumerate();
    let largest = rows.fold(0.0, |most: f64, (row, own)| {
        most.max(scaled(row, *own).abs())
    });
    assert!(largest > 1e-3, "{largest}");
    for (row, expected) in expected.iter().enumerate() {
        let error = scaled(row, along_disturbance[(row, 0)] - expected);
        // Differences of 1e-4 and 1e-5 in the coefficient, to their square and to rounding over them.
        assert!(error.abs() < 1e-6 * largest, "{row}: {error} of {largest}");
    }
}

/// The table has the order of the unknowns, the names of scenes, a symbol for every column, and no name twice; a disturbance that is written
/// and read again as JSON is the same, and a number that is left out is that of the model.
#[test]
fn unknowns_are_rows_of_one_table() {
    let mut names = std::collections::BTreeSet::new();
    let mut disturbance = Disturbance::NONE;
    for (i, row) in Unknown::TABLE.iter().enumerate() {
        assert_eq!(row.unknown as usize, i);
        assert_eq!(serde_json::to_value(row.unknown).unwrap(), row.key);
        assert_eq!(row.symbols.len(), row.columns.len());
        assert!(
            names.insert(row.field)
                && row
                    .columns
                    .iter()
                    .all(|own| names.insert(*own) || *own == row.field)
        );
        for (axis, value) in disturbance.of_mut(row.unknown).iter_mut().enumerate() {
            *value += 0.1 / (i + axis + 3) as f64;
        }
    }
    let text = serde_json::to_string(&disturbance).unwrap();
    assert_eq!(
        serde_json::from_str::<Disturbance>(&text).unwrap(),
        disturbance
    );
    let part: Disturbance = serde_json::from_str(r#"{"payload_kg": 0.2}"#).unwrap();
    assert_eq!(part, Disturbance::NONE.with(Unknown::Payload, &[0.2]));
    for wrong in [
        r#"{"payload": 0.2}"#,
        r#"{"payload_kg": 0.2, "payload_kg": 0.2}"#,
        r#"{"tip_force_n": [1.0, 2.0]}"#,
        r#"{"delay_s": [1.0]}"#,
        "[]",
    ] {
        assert!(
            serde_json::from_str::<Disturbance>(wrong).is_err(),
            "{wrong}"
        );
    }
}

/// Covariance that the components of the error gain within a second, at a shape, as `S Sᵀ`, from the definitions: the momenta
/// `2 e (ω₁² M K⁻¹ M + M / 10)`, `e = 3 EI/L³ σ²`, in the frames of the nodes.
fn noise_root(model: &Rod, settings: &KalmanSettings, shape: &Configuration) -> DMatrix<f64> {
    let [stiffness, inertia] = stiffness_and_inertia(model);
    let energy = 3.0 * model.scales.force / model.scales.length * settings.change.powi(2);
    let frequency = 3.516_015 / model.scales.time;
    let stiffness = (&stiffness + stiffness.transpose()) * 0.5;
    let compliance = stiffness.cholesky().unwrap().inverse();
    let smooth = &inertia * compliance * &inertia * frequency.powi(2);
    let all = (smooth + inertia * 0.1) * (2.0 * energy);
    let momenta = all.cholesky().unwrap().unpack();
    let disturbances: Vec<f64> = estimated(settings)
        .flat_map(|unknown| {
            let change = settings.walk(unknown).map(|walk| walk.change);
            std::iter::repeat_n(change, unknown.row().n()).flatten()
        })
        .collect();
    let n_state = 2 * momenta.nrows();
    let n = n_state + disturbances.len();
    let mut root = DMatrix::zeros(n, n);
    for (j, column) in momenta.column_iter().enumerate() {
        let column = turned(model, shape, &column.into_owned(), true);
        for (i, value) in column.iter().enumerate() {
            root[(12 * (i / 6) + 6 + i % 6, j)] = *value;
        }
    }
    for (i, deviation) in disturbances.into_iter().enumerate() {
        root[(n_state + i, n_state + i)] = deviation;
    }
    root
}

/// The unknowns that are estimated.
fn estimated(settings: &KalmanSettings) -> impl Iterator<Item = Unknown> {
    Unknown::all().filter(|unknown| settings.walk(*unknown).is_some())
}

/// A tangent and a change of the disturbances from all components of an error.
fn split(
    model: &Rod,
    settings: &KalmanSettings,
    error: &DVector<f64>,
) -> (StateTangent, Disturbance) {
    let mut tangent = StateTangent::zeros(model.n_nodes());
    let first = model.first_free_node();
    let vector = |at: usize| Vector3::new(error[at], error[at + 1], error[at + 2]);
    for node in first..model.n_nodes() {
        let at = NODE_COMPONENTS * (node - first);
        tangent.positions[node] = vector(at);
        tangent.rotations[node] = vector(at + 3);
        tangent.linear[node] = vector(at + 6);
        tangent.angular[node] = vector(at + 9);
    }
    let mut at = NODE_COMPONENTS * (model.n_nodes() - first);
    let mut change = Disturbance::ZERO;
    for unknown in estimated(settings) {
        for value in change.of_mut(unknown) {
            *value = error[at];
            at += 1;
        }
    }
    (tangent, change)
}

/// The state that a tangent leads to along the strains, as a filter takes its error.
fn along_strains(from: &State, tangent: &StateTangent) -> State {
    let mut to = from.retract(tangent);
    let (positions, rotations) = (&tangent.positions, &tangent.rotations);
    retract_shape(
        &from.configuration,
        positions,
        rotations,
        &mut to.configuration,
    );
    to
}

/// The rod as the truth has it: as stiff, and with what the distributed force does to the clamp.
fn disturbed(model: &Rod, truth: &Truth) -> Rod {
    let mut rod = model.clone();
    truth.disturbance.change_model(model, &mut rod);
    rod.loads.push(Load {
        node: 0,
        force: truth.disturbance.vector(Unknown::Distributed) * (0.5 * model.elements[0].length),
        moment: Vector3::zeros(),
        frame: LoadFrame::Spatial,
        profile: Vec::new(),
    });
    rod
}

fn added(a: &Disturbance, b: &Disturbance) -> Disturbance {
    let mut out = *a;
    for unknown in Unknown::all() {
        for (out, change) in out.of_mut(unknown).iter_mut().zip(b.of(unknown)) {
            *out += change;
        }
    }
    out
}

/// The error of a filter over all components of its covariance.
fn error_of(
    model: &Rod,
    settings: &KalmanSettings,
    truth: &Truth,
    filter: &KalmanFilter,
) -> DVector<f64> {
    let estimate = filter.estimate();
    let mut tangent = truth.state.difference(&estimate.state);
    shape_difference(
        &truth.state.configuration,
        &estimate.state.configuration,
        &mut tangent.positions,
        &mut tangent.rotations,
    );
    let mut all: Vec<f64> = tangent.components_from(model.first_free_node()).collect();
    let (true_one, found) = (&truth.disturbance, &estimate.disturbance);
    for unknown in estimated(settings) {
        let pairs = true_one.of(unknown).iter().zip(found.of(unknown));
        all.extend(pairs.map(|(true_one, found)| true_one - found));
    }
    DVector::from_vec(all)
}

/// `eᵀ P⁻¹ e`, over standard deviations.
fn normalized(error: &DVector<f64>, covariance: &DMatrix<f64>) -> f64 {
    let root = covariance.diagonal().map(f64::sqrt);
    let scaled = DMatrix::from_fn(error.len(), error.len(), |i, j| {
        covariance[(i, j)] / (root[i] * root[j])
    });
    let factor = scaled.cholesky().expect("a covariance");
    let e = error.component_div(&root);
    factor.solve(&e).dot(&e)
}

/// A sum of squares of `n` standard normal numbers is within so many standard deviations of `n`.
fn deviation(sum: f64, n: usize) -> f64 {
    (sum - n as f64) / (2.0 * n as f64).sqrt()
}

/// Normalized errors and innovations of seeded runs in which the filter knows the truth's statistics: what its settings say is what the
/// truth is drawn from, noise and all; `trust` are factors on the standard deviations of the sensor and of unknown forces that it is told instead.
///
/// Returns sums over the runs: of the normalized error at some times, one after the other, and of all normalized innovations; and the numbers
/// of squares in them.
fn monte_carlo(
    arm: &Arm,
    settings: &KalmanSettings,
    sensor: &SensorSettings,
    trust: [f64; 2],
) -> (Vec<(f64, usize)>, (f64, usize)) {
    const RUNS: usize = 40;
    const SAMPLES: usize = 40;
    let model = rod(arm, 4);
    let mut errors = vec![(0.0, 0); 4];
    let mut innovations = (0.0, 0);
    let mean = at_rest(&model);
    for run in 0..RUNS {
        let told = KalmanSettings {
            change: trust[1] * settings.change,
            ..*settings
        };
        let mut filter = KalmanFilter::new(&model, 0.0, &mean, &told).unwrap();
        let mut dice = fastrand::Rng::with_seed(1000 + run as u64);
        let mut seeds = dice.fork();
        let covariance = dense(filter.covariance());
        let n = covariance.nrows();
        let root = covariance.diagonal().map(|v| v.sqrt().max(1e-300));
        let scaled = DMatrix::from_fn(n, n, |i, j| covariance[(i, j)] / (root[i] * root[j]));
        let factor = scaled.cholesky().unwrap().l();
        let mut draw = || DVector::from_fn(n, |_, _| normal(&mut dice));
        let first = (factor * draw()).component_mul(&root);
        let (tangent, disturbance) = split(&model, settings, &first);
        let mut truth = Truth::new(
            &model,
            along_strains(&mean, &tangent),
            added(&Disturbance::NONE, &disturbance),
        );
        let mut measurement = Measurement::default();
        for k in 0..SAMPLES {
            let (start, end) = (k as f64 * PERIOD, (k + 1) as f64 * PERIOD);
            let act = command(&model, start, PERIOD);
            truth.advance(&act, end);
            let shape = &truth.state.configuration;
            let shock = noise_root(&model, settings, shape) * PERIOD.sqrt() * draw();
            let (tangent, disturbance) = split(&model, settings, &shock);
            truth.state = along_strains(&truth.state, &tangent);
            truth.disturbance = added(&truth.disturbance, &disturbance);
            filter.advance(&act, end).unwrap();
            let settings_now = SensorSettings {
                seed: seeds.u64(..),
                ..sensor.clone()
            };
            let mut sensor = Sensor::new(&settings_now, &disturbed(&model, &truth)).unwrap();
            sensor.measure(end, &truth.state, &mut measurement).unwrap();
            for signal in &mut measurement.signals {
                signal.sigma *= trust[0];
            }
            let innovation = filter.correct(&measurement).unwrap();
            innovations.0 += innovation.normalized.unwrap();
            innovations.1 += innovation.n;
            if (k + 1) % 10 == 0 {
                let error = error_of(&model, settings, &truth, &filter);
                let (sum, count) = &mut errors[k / 10];
                *sum += normalized(&error, &dense(filter.covariance()));
                *count += n;
            }
        }
    }
    (errors, innovations)
}

/// Where the model is right, the errors of state and disturbances and the innovations are as large as the filter says: their normalized squares
/// are chi-square distributed, over seeded runs, by every sensor; with the parameters of the model by those that see slow motions, as the filter
/// learns them from these. Told a wrong noise of the sensor, or of the forces, the same runs show it.
#[test]
fn errors_are_as_large_as_the_filter_says() {
    for (name, mut arm) in [("upright", upright()), ("hanging", hanging())] {
        // Less of it than the model has is a payload too.
        arm.payload = Some(NodeInertia {
            mass: 0.1 * rod(&arm, 4).mass(),
            rotary: Vector3::zeros(),
        });
        let model = rod(&arm, 4);
        let (length, force, moment) =
            (model.scales.length, model.scales.force, model.scales.moment);
        // Small enough for a linear filter.
        let forces = KalmanSettings {
            initial: 0.001 * length,
            change: 0.001 * length,
            ..KalmanSettings::of(&model)
        };
        let along = force / length;
        let forces = forces
            .with(Unknown::TipForce, walk(0.01 * force, 0.003 * force))
            .with(Unknown::TipMoment, walk(0.003 * moment, 0.001 * moment))
            .with(Unknown::Distributed, walk(0.01 * along, 0.003 * along));
        let (mass, time) = (model.mass(), model.scales.time);
        let all = forces
            .with(Unknown::Stiffness, walk(0.005, 0.001))
            .with(Unknown::Payload, walk(0.005 * mass, 0.001 * mass))
            .with(Unknown::Viscous, walk(0.05 / time, 0.01 / time));
        let cases = [
            (SensorPreset::Mocap, all),
            (SensorPreset::Em, all),
            (SensorPreset::Camera, all),
            (SensorPreset::Fbg, forces),
            (SensorPreset::BaseWrench, forces),
            (SensorPreset::Imu, forces),
        ];
        for (preset, settings) in cases {
            let sensor = preset.settings(&model);
            let (errors, (innovations, n)) = monte_carlo(&arm, &settings, &sensor, [1.0; 2]);
            // One in ten thousand for each of the numbers.
            let bound = 4.0;
            for (sum, n) in errors {
                let off = deviation(sum, n);
                assert!(off.abs() < bound, "{name} {preset:?}: {sum} of {n}");
            }
            let off = deviation(innovations, n);
            assert!(off.abs() < bound, "{name} {preset:?}: {innovations} of {n}");
        }
        let sensor = SensorPreset::Mocap.settings(&model);
        let (_, (innovations, n)) = monte_carlo(&arm, &all, &sensor, [0.9, 1.0]);
        assert!(deviation(innovations, n) > 10.0);
        let louder = KalmanSettings {
            change: 0.005 * length,
            ..all
        };
        let (errors, _) = monte_carlo(&arm, &louder, &sensor, [1.0, 0.2]);
        let (sum, n) = errors[3];
        assert!(deviation(sum, n) > 10.0);
    }
}

/// A run of a filter against a plant that is disturbed and whose commands are late, by what the filter does not know of: the filter at the end.
fn follow(
    plant: &Rod,
    model: &Rod,
    disturbance: Disturbance,
    settings: &KalmanSettings,
    sensor: &SensorSettings,
    duration: f64,
) -> KalmanFilter {
    let mut filter = KalmanFilter::new(model, 0.0, &at_rest(model), settings).unwrap();
    let mut truth = Truth::new(plant, at_rest(plant), disturbance);
    let mut sensor = Sensor::new(sensor, plant).unwrap();
    let mut measurement = Measurement::default();
    let late = |start: f64, delay: f64| Command {
        start,
        end: start + PERIOD,
        ..command(model, start - delay, PERIOD)
    };
    for k in 0..(duration / PERIOD) as usize {
        let start = k as f64 * PERIOD;
        let act = late(start, disturbance.delay());
        truth.advance(&act, act.end);
        let said = late(start, filter.estimate().disturbance.delay());
        filter.advance(&said, said.end).unwrap();
        if sensor.is_due(act.end) {
            sensor
                .measure(act.end, &truth.state, &mut measurement)
                .unwrap();
            filter.correct(&measurement).unwrap();
        }
    }
    filter
}

/// A constant force at the tip of 1 N (of the upright arm), a distributed force and a stiffness of 0.8, one at a time and together, are found by
/// motion capture while the arm swings, with an error that is within four of the filter's own standard deviations, which are a tenth of what is
/// found at most.
#[test]
fn disturbances_are_found() {
    for (name, arm) in [("upright", upright()), ("hanging", hanging())] {
        let model = rod(&arm, 6);
        let force = model.scales.force;
        let unit = 0.2 * force; // 1 N of the upright arm
        let along = unit / model.scales.length;
        let nothing = KalmanSettings {
            initial: 0.003 * model.scales.length,
            change: 1e-3 * model.scales.length,
            ..KalmanSettings::of(&model)
        };
        let sensor = SensorSettings {
            seed: 3,
            ..SensorPreset::Mocap.settings(&model)
        };
        let tip = Vector3::new(0.6, -0.8, 0.0) * unit;
        let distributed = Vector3::new(-0.6, 0.0, 0.8) * along;
        let cases = [
            (true, false, false),
            (false, true, false),
            (false, false, true),
            (true, false, true),
            (false, true, true),
        ];
        for (has_tip, has_distributed, is_soft) in cases {
            let mut settings = nothing;
            let mut disturbance = Disturbance::NONE;
            if has_tip {
                settings = settings.with(Unknown::TipForce, walk(2.0 * unit, 0.01 * unit));
                disturbance = disturbance.with(Unknown::TipForce, tip.as_slice());
            }
            if has_distributed {
                settings = settings.with(Unknown::Distributed, walk(2.0 * along, 0.01 * along));
                disturbance = disturbance.with(Unknown::Distributed, distributed.as_slice());
            }
            if is_soft {
                settings = settings.with(Unknown::Stiffness, walk(0.2, 0.003));
                disturbance = disturbance.with(Unknown::Stiffness, &[0.8]);
            }
            let duration = 4.0 * model.scales.time;
            let filter = follow(&model, &model, disturbance, &settings, &sensor, duration);
            let (found, sigma) = (filter.estimate().disturbance, filter.estimate().deviation);
            let within = |error: f64, sigma: f64, most: f64| {
                assert!(
                    error.abs() < 4.0 * sigma,
                    "{name}: {error} {sigma}, {found:?}"
                );
                assert!(sigma <= most, "{name}: {sigma} of {most}");
            };
            for axis in 0..3 {
                let most = if has_tip { 0.1 * unit } else { 0.0 };
                let part = |of: &Disturbance, unknown| of.vector(unknown)[axis];
                let error = |unknown| part(&found, unknown) - part(&disturbance, unknown);
                if has_tip {
                    let sigma = part(&sigma, Unknown::TipForce);
                    within(error(Unknown::TipForce), sigma, most);
                }
                if has_distributed {
                    let sigma = part(&sigma, Unknown::Distributed);
                    within(error(Unknown::Distributed), sigma, 0.2 * along);
                }
            }
            if is_soft {
                let error = found.value(Unknown::Stiffness) - 0.8;
                within(error, sigma.value(Unknown::Stiffness), 0.02);
            }
            assert_eq!(found.vector(Unknown::TipMoment), Vector3::zeros());
        }
    }
}

/// A coarse model of a fine plant, all sensors at their own rates and noise, and a stiffness that is a fifth too high: the filter finds it to two
/// hundredths, from poses, positions alone, curvatures or a gyroscope.
#[test]
fn coarse_models_find_the_stiffness() {
    let (plant, model) = (rod(&upright(), 40), rod(&upright(), 10));
    let disturbance = Disturbance::NONE.with(Unknown::Stiffness, &[0.8]);
    for preset in [
        SensorPreset::Mocap,
        SensorPreset::Em,
        SensorPreset::Camera,
        SensorPreset::Fbg,
        SensorPreset::Imu,
    ] {
        let settings = KalmanSettings::of(&model).with(Unknown::Stiffness, walk(0.2, 0.02));
        let sensor = preset.settings(&model);
        let filter = follow(&plant, &model, disturbance, &settings, &sensor, 6.0);
        let found = filter.estimate().disturbance.value(Unknown::Stiffness);
        assert!((found - 0.8).abs() < 0.03, "{preset:?}: {found}");
    }
}

/// A payload of a fifth of the arm's mass, or damping three times the model's, that a filter knows nothing of: it finds them, within what it says
/// and to a twentieth of the mass and a fifth of the damping, hanging under gravity as upright without any.
#[test]
fn payloads_and_damping_are_found() {
    for (name, arm) in [("upright", upright()), ("hanging", hanging())] {
        let model = rod(&arm, 8);
        let (mass, time) = (model.mass(), model.scales.time);
        let settings = KalmanSettings::of(&model)
            .with(Unknown::Payload, walk(0.2 * mass, 0.01 * mass))
            .with(Unknown::Viscous, walk(1.0 / time, 0.02 / time));
        let sensor = SensorPreset::Mocap.settings(&model);
        for (payload, viscous) in [(0.2 * model.mass(), 0.0), (0.0, 2.0)] {
            let disturbance = (Disturbance::NONE.with(Unknown::Payload, &[payload]))
                .with(Unknown::Viscous, &[viscous]);
            let duration = 8.0 * model.scales.time;
            let filter = follow(&model, &model, disturbance, &settings, &sensor, duration);
            let (found, sigma) = (filter.estimate().disturbance, filter.estimate().deviation);
            for (unknown, most) in [(Unknown::Payload, 0.05 * mass), (Unknown::Viscous, 0.6)] {
                let off = found.value(unknown) - disturbance.value(unknown);
                let sigma = sigma.value(unknown);
                assert!(
                    off.abs() < (4.0 * sigma).min(most),
                    "{name}, {payload} kg, {viscous}/s: {off}, {sigma}"
                );
            }
        }
    }
}

/// Commands that act 12 ms later than they are said to on an arm with internal damping of 15 ms, or both of neither: a filter with implicit steps
/// finds them, within four of its standard deviations and to 3 ms each, if it is told of every command when it finds it to act.
#[test]
fn delays_and_internal_damping_are_found() {
    let mut model = rod(&upright(), 8);
    model.scheme = TimeScheme::Implicit;
    let usual = Unknowns::of(&[Unknown::Internal, Unknown::Delay]);
    let settings = usual.settings(&model, PERIOD);
    for (delay, internal) in [(0.0, 0.0), (0.012, 0.0), (0.0, 0.015), (0.012, 0.015)] {
        let disturbance =
            (Disturbance::NONE.with(Unknown::Internal, &[internal])).with(Unknown::Delay, &[delay]);
        let sensor = SensorPreset::Mocap.settings(&model);
        let filter = follow(&model, &model, disturbance, &settings, &sensor, 6.0);
        let (found, sigma) = (filter.estimate().disturbance, filter.estimate().deviation);
        for unknown in [Unknown::Delay, Unknown::Internal] {
            let off = found.value(unknown) - disturbance.value(unknown);
            let sigma = sigma.value(unknown);
            assert!(
                off.abs() < (4.0 * sigma).min(3e-3),
                "{off} {sigma} {found:?}"
            );
        }
    }
}

/// Normalized errors of the parameters over seeds, with the settings of a loop and all unknowns, of plants of the model's own elements: the means of
/// `eᵀ P⁻¹ e` and of each normalized square are not above those of chi-square (four standard deviations of a mean of `RUNS`). They are below, because the
/// filter expects parameters to change and forces that nobody knows, and these plants have neither. Where it expects forces, the noise of the sensors passes
/// for motions that are damped (Ljung 1979), so that the internal damping of a plant without any is found too high: by less than three deviations
/// in the root mean square, and by four where unknown forces are as strong in fast motions as in slow ones.
#[test]
fn parameters_are_not_surer_than_the_filter_says() {
    const RUNS: u64 = 4;
    const N: usize = 5;
    let mut model = rod(&upright(), 6);
    model.scheme = TimeScheme::Implicit;
    let settings = Unknowns::ALL.settings(&model, PERIOD);
    let mass = model.mass();
    let parameters = [
        Unknown::Stiffness,
        Unknown::Payload,
        Unknown::Viscous,
        Unknown::Internal,
        Unknown::Delay,
    ];
    let wrong = |stiffness: f64, payload: f64, viscous: f64, internal: f64| {
        let values = [stiffness, payload * mass, viscous, internal];
        (parameters.into_iter().zip(values)).fold(Disturbance::NONE, |out, (unknown, value)| {
            out.with(unknown, &[value])
        })
    };
    let pushed = wrong(0.9, 0.0, 0.0, 0.0).with(Unknown::TipForce, &[1.0]);
    let late = wrong(0.8, 0.0, 0.0, 0.0).with(Unknown::Delay, &[0.01]);
    let plants = [
        ("nothing wrong", wrong(1.0, 0.0, 0.0, 0.0)),
        ("soft", wrong(0.8, 0.0, 0.0, 0.0)),
        ("loaded", wrong(1.0, 0.15, 0.0, 0.0)),
        ("damped", wrong(1.0, 0.0, 1.0, 0.0)),
        ("damped inside", wrong(1.0, 0.0, 0.0, 0.015)),
        ("stiff and loaded", wrong(1.2, 0.1, 0.0, 0.0)),
        ("pushed and soft", pushed),
        ("late and soft", late),
    ];
    let above = |n: usize| n as f64 + 4.0 * (2.0 * n as f64 / RUNS as f64).sqrt();
    for (name, truth) in plants {
        let (mut sum, mut squares) = (0.0, [0.0; N]);
        for seed in 0..RUNS {
            let sensor = SensorSettings {
                seed,
                ..SensorPreset::Mocap.settings(&model)
            };
            let mut filter = follow(&model, &model, truth, &settings, &sensor, 6.0);
            let found = filter.estimate().disturbance;
            let error = parameters.map(|of| found.value(of) - truth.value(of));
            let error = DVector::from_column_slice(&error);
            let at = NODE_COMPONENTS * (model.n_nodes() - 1) + 9;
            let covariance = dense(filter.covariance())
                .view((at, at), (N, N))
                .into_owned();
            sum += normalized(&error, &covariance) / RUNS as f64;
            for (i, square) in squares.iter_mut().enumerate() {
                *square += error[i].powi(2) / covariance[(i, i)] / RUNS as f64;
            }
        }
        println!("{name}: {sum:.2} of {N}, each {squares:.2?}");
        assert!(sum < above(N), "{name}: {sum}");
        let [stiffness, payload, viscous, internal, delay] = squares;
        let largest = [stiffness, payload, viscous, delay];
        let largest = largest.into_iter().fold(0.0, f64::max);
        assert!(largest < above(1) && internal < 9.0, "{name}: {squares:?}");
    }
}

/// A filter that refuses what cannot be true is left as it is by one pose that is far off and takes what is right of the same measurement; what
/// goes on to be far off is believed after three times.
#[test]
fn impossible_signals_are_refused() {
    let model = rod(&upright(), 6);
    let settings = KalmanSettings {
        refuses: true,
        // The arm is the model: unknown forces need not explain another one.
        change: Unknowns::ALL.settings(&model, PERIOD).change,
        ..Unknowns::NONE.settings(&model, PERIOD)
    };
    let truth = at_rest(&model);
    let mut sensor = Sensor::new(&SensorPreset::Mocap.settings(&model), &model).unwrap();
    let mut filter = KalmanFilter::new(&model, 0.0, &truth, &settings).unwrap();
    let mut measurement = Measurement::default();
    let mut found = Vec::new();
    for k in 1..=24 {
        let act = Command {
            from: vec![0.0; 6],
            to: vec![0.0; 6],
            acting: vec![0.0; 6],
            ..command(&model, PERIOD * f64::from(k - 1), PERIOD)
        };
        filter.advance(&act, act.end).unwrap();
        sensor.measure(act.end, &truth, &mut measurement).unwrap();
        for signal in &mut measurement.signals {
            let is_bad = k == 10 && signal.place == 1.0 || k > 20;
            if let (Reading::Vector(Quantity::Position, x), true) = (&mut signal.reading, is_bad) {
                x.x += 0.1;
            }
        }
        let innovation = filter.correct(&measurement).unwrap();
        assert_eq!(innovation.n + 3 * innovation.refused, 18);
        let tip = filter.estimate().state.configuration.positions[model.tip()];
        found.push((innovation.refused, tip.x));
    }
    for (k, (refused, off)) in found.iter().enumerate().take(23) {
        let expected = match k {
            9 => 1,
            20..23 => 3,
            _ => 0,
        };
        assert_eq!(*refused, expected, "{k}");
        // A few standard deviations of one measurement.
        assert!(off.abs() < 1e-3, "{k}: {off}");
    }
    assert!(found[23].0 == 0 && found[23].1 > 3e-3, "{found:?}");
}
