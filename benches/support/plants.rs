//! Arms that differ from the model in two ways, loops over a minute, and normalized errors of what a filter finds.

use std::sync::atomic::{AtomicUsize, Ordering};

use nalgebra::Vector3;
use softarm::mechanics::{Material, NodeInertia, Rod};
use softarm::mpc::{
    Computing, Contender, Disturbance, Experiment, Innovations, MpcError, Outcome, Sample, Sensing,
    SensorChoice, SensorPreset, TipError, Unknown, Unknowns,
};
use softarm::task::{Arm, PointLoad};

use super::{FILTER, SOFT_ELEMENT, arm, arms, noisy, percent, run, scene, soften};

/// Mass of the arm, kg.
const MASS: f64 = 1000.0 * std::f64::consts::PI * 0.05 * 0.05;

fn payload(mass: f64) -> Option<NodeInertia> {
    Some(NodeInertia {
        mass,
        rotary: Vector3::repeat(1e-4),
    })
}

/// The arms of the circle, and eight with two faults each.
fn loops(seconds: f64, unknowns: Unknowns) -> Vec<(&'static str, Experiment)> {
    let usual = noisy(scene(seconds, 10), unknowns, SensorPreset::Mocap);
    let of = |plant: Arm| Experiment {
        plant,
        ..usual.clone()
    };
    let mut out: Vec<_> = (arms().into_iter())
        .map(|(name, plant)| {
            let adjust = (name == SOFT_ELEMENT).then_some(soften as fn(&mut Rod));
            let own = Experiment {
                adjust,
                ..of(plant)
            };
            (name, own)
        })
        .collect();
    let tapered = Arm {
        gravity: Vector3::zeros(),
        viscous_damping: 1.0,
        internal_damping: 0.015,
        ..Arm::cone(&Material::isotropic(1e6, 0.5, 1000.0), 1.0, [0.055, 0.045])
    };
    let heavy = Arm {
        gravity: Vector3::zeros(),
        viscous_damping: 1.0,
        ..Arm::cylinder(&Material::isotropic(0.8e6, 0.5, 1200.0), 1.0, 0.05)
    };
    let mut pushed = arm(1e6);
    pushed.rest_curvature.x = 0.2;
    pushed.loads.push(PointLoad {
        force: Vector3::new(1.0, 0.0, 0.0),
        ..PointLoad::default()
    });
    let mut late = of(arm(1e6));
    late.settings.computing = Computing::Fixed(0.02);
    if let (Sensing::Estimated { sensors, .. }, Ok(model)) =
        (&mut late.sensing, late.arm.rod(&late.discretization))
    {
        let mut own = SensorPreset::Mocap.settings(&model);
        for sigma in [&mut own.position, &mut own.rotation] {
            *sigma = sigma.map(|sigma| 3.0 * sigma);
        }
        *sensors = vec![SensorChoice::Own(own)];
    }
    let mut secretly_late = of(arm(0.6e6));
    secretly_late.actuators.delay = 0.01;
    out.extend([
        (
            "E x 0.75, payload 10 %",
            of(Arm {
                payload: payload(0.1 * MASS),
                ..arm(0.75e6)
            }),
        ),
        ("taper 55 to 45 mm, Kelvin-Voigt 15 ms", of(tapered)),
        ("rest curvature 0.2/m, tip force 1 N", of(pushed)),
        ("two periods of delay, threefold noise", late),
        (
            "E x 1.3, viscous 3/s",
            of(Arm {
                viscous_damping: 3.0,
                ..arm(1.3e6)
            }),
        ),
        ("density x 1.2, E x 0.8", of(heavy)),
        (
            "payload 20 %, rest curvature 0.15/m",
            of(Arm {
                payload: payload(0.2 * MASS),
                rest_curvature: Vector3::new(0.15, 0.0, 0.0),
                ..arm(1e6)
            }),
        ),
        ("E x 0.6, 10 ms late, which nobody knows", secretly_late),
    ]);
    out
}

/// Root mean square error of the samples from `from` (s) on, over so many seconds, m.
fn rms(samples: &[Sample], from: f64, seconds: f64) -> f64 {
    let within = |sample: &&Sample| sample.t >= from && sample.t < from + seconds - 1e-9;
    let own: Vec<_> = samples.iter().filter(within).cloned().collect();
    TipError::of(&own, from).rms
}

/// Errors over the whole time, the second ten seconds and the last ten, and innovations.
pub fn long(seconds: f64) -> Result<(), MpcError> {
    println!("## A minute on eighteen arms\n");
    println!(
        "Sensors and delay as above, {seconds} s, with the unknowns that a scene has by default. In % of the length, root mean square: after the \
         first turn / in the second ten seconds / in the last ten. Chi-square is that of the innovations over its numbers and, in brackets, that which a \
         consistent filter stays below; the loop says so where it is larger. Then the delay as it is found at the end. The last column has the \
         errors with ten times the price of rates, 0.03: commands that change more slowly.\n"
    );
    println!("| arm | error | chi-square | delay found, ms | smoother commands |");
    println!("|---|---|---|---|---|");
    let rows = in_parallel(&loops(seconds, FILTER), |(name, own)| {
        long_run(name, own, seconds)
    });
    for row in rows {
        println!("{}", row?);
    }
    println!();
    Ok(())
}

/// A row of the table of [`long`].
fn long_run(name: &str, own: &Experiment, seconds: f64) -> Result<String, MpcError> {
    let found = run(own, Contender::Mpc)?;
    let (None, Some(last)) = (&found.broke_down, found.samples.last()) else {
        return Ok(format!("| {name} | broke down | | | |"));
    };
    let errors = |found: &Outcome| {
        if found.broke_down.is_some() {
            return "broke down".into();
        }
        let parts = [
            found.tip_error.rms,
            rms(&found.samples, 10.0, 10.0),
            rms(&found.samples, seconds - 10.0, 10.0),
        ];
        parts.map(percent).join(" / ")
    };
    let mut smoother = own.clone();
    smoother.task.cost.rate *= 10.0;
    let smoother = run(&smoother, Contender::Mpc)?;
    let chi = (found.tally.innovations).map_or(String::new(), |found: Innovations| {
        format!("{:.2} ({:.2})", found.per_number, found.at_most)
    });
    Ok(format!(
        "| {name} | {} | {chi} | {:.1} ± {:.1} | {} |",
        errors(&found),
        1e3 * last.disturbance.delay(),
        1e3 * last.deviation.delay(),
        errors(&smoother)
    ))
}

/// The values of a function, by a thread for each of the machine.
fn in_parallel<T: Sync, R: Send>(items: &[T], value: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let next = AtomicUsize::new(0);
    let n_threads = std::thread::available_parallelism().map_or(1, usize::from);
    let work = || {
        let mut own = Vec::new();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(index) else {
                return own;
            };
            own.push((index, value(item)));
        }
    };
    let mut found: Vec<_> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..n_threads).map(|_| scope.spawn(work)).collect();
        (threads.into_iter())
            .flat_map(|thread| thread.join().unwrap())
            .collect()
    });
    found.sort_by_key(|(index, _)| *index);
    found.into_iter().map(|(_, value)| value).collect()
}

/// Unknowns of the model and of its commands.
const PARAMETERS: [Unknown; 5] = [
    Unknown::Stiffness,
    Unknown::Payload,
    Unknown::Viscous,
    Unknown::Internal,
    Unknown::Delay,
];

/// A plant, what is wrong with the model of it, and whether it has the model's own elements and steps.
struct Known {
    name: &'static str,
    plant: Arm,
    truth: Disturbance,
    is_model: bool,
}

fn known() -> Vec<Known> {
    let nothing = Disturbance::NONE;
    let one = |name, plant: Arm, truth, is_model| Known {
        name,
        plant,
        truth,
        is_model,
    };
    let soft = |factor: f64| arm(1e6 * factor);
    let wrong = |stiffness: f64, payload: f64, viscous: f64, internal: f64| {
        let values = [stiffness, payload, viscous, internal];
        (PARAMETERS.into_iter().zip(values))
            .fold(nothing, |out, (unknown, value)| out.with(unknown, &[value]))
    };
    let mut out = Vec::new();
    for (is_model, [nothing_wrong, softer, loaded, damped, inner, both]) in [
        (
            true,
            [
                "as the model",
                "E x 0.8",
                "payload 15 %",
                "viscous 3/s",
                "Kelvin-Voigt 15 ms",
                "E x 1.2, payload 10 %",
            ],
        ),
        (
            false,
            [
                "40 elements",
                "40 elements, E x 0.8",
                "40 elements, payload 15 %",
                "40 elements, viscous 3/s",
                "40 elements, Kelvin-Voigt 15 ms",
                "40 elements, E x 1.2, payload 10 %",
            ],
        ),
    ] {
        out.extend([
            one(nothing_wrong, soft(1.0), nothing, is_model),
            one(softer, soft(0.8), wrong(0.8, 0.0, 0.0, 0.0), is_model),
            one(
                loaded,
                Arm {
                    payload: payload(0.15 * MASS),
                    ..soft(1.0)
                },
                wrong(1.0, 0.15 * MASS, 0.0, 0.0),
                is_model,
            ),
            one(
                damped,
                Arm {
                    viscous_damping: 3.0,
                    ..soft(1.0)
                },
                wrong(1.0, 0.0, 2.0, 0.0),
                is_model,
            ),
            one(
                inner,
                Arm {
                    internal_damping: 0.015,
                    ..soft(1.0)
                },
                wrong(1.0, 0.0, 0.0, 0.015),
                is_model,
            ),
            one(
                both,
                Arm {
                    payload: payload(0.1 * MASS),
                    ..soft(1.2)
                },
                wrong(1.2, 0.1 * MASS, 0.0, 0.0),
                is_model,
            ),
        ]);
    }
    out.push(one(
        "40 elements, Kelvin-Voigt 15 ms, rest curvature 0.2/m",
        Arm {
            internal_damping: 0.015,
            rest_curvature: Vector3::new(0.2, 0.0, 0.0),
            ..soft(1.0)
        },
        wrong(1.0, 0.0, 0.0, 0.015),
        false,
    ));
    out
}

/// Normalized errors of what the filter finds, over so many seeds of the noise.
pub fn seeds(count: usize, seconds: f64) -> Result<(), MpcError> {
    println!("## Normalized errors of the parameters\n");
    let most = 1.0 + 4.0 * (2.0 / count as f64).sqrt();
    println!(
        "The loop of the circle with all unknowns, {seconds} s, {count} seeds of the noise: means of the squares of the errors of stiffness, payload, viscous and internal \
         damping and delay at the end over the filter's variances, and in brackets the means of the errors over the deviations. Consistent is at most \
         {most:.2} (four standard deviations of the mean). Then the largest root mean square error of the tip in % of the length and the largest \
         chi-square of the innovations over its numbers.\n"
    );
    println!("| arm | stiffness | payload | viscous | internal | delay | tip | innovations |");
    println!("|---|---|---|---|---|---|---|---|");
    let rows = in_parallel(&known(), |known| normalized_errors(known, count, seconds));
    for row in rows {
        println!("{}", row?);
    }
    println!();
    Ok(())
}

/// A row of the table of [`seeds`].
fn normalized_errors(known: &Known, count: usize, seconds: f64) -> Result<String, MpcError> {
    let mut own = noisy(scene(seconds, 10), FILTER, SensorPreset::Mocap);
    own.plant = known.plant.clone();
    if known.is_model {
        own.plant_discretization = own.discretization;
    }
    let (mut squares, mut means) = ([0.0; 5], [0.0; 5]);
    let (mut worst, mut chi) = (0.0f64, 0.0f64);
    for number in 0..count {
        if let Sensing::Estimated { seed, .. } = &mut own.sensing {
            *seed = 1 + number as u64;
        }
        let found = run(&own, Contender::Mpc)?;
        let Some(last) = found.samples.last() else {
            continue;
        };
        let of = |d: &Disturbance| PARAMETERS.map(|unknown| d.value(unknown));
        let numbers = (of(&last.disturbance).into_iter())
            .zip(of(&known.truth))
            .zip(of(&last.deviation));
        for (i, ((found, truth), sigma)) in numbers.enumerate() {
            let off = (found - truth) / sigma;
            squares[i] += off * off / count as f64;
            means[i] += off / count as f64;
        }
        worst = worst.max(found.tip_error.rms);
        chi = chi.max((found.tally.innovations).map_or(0.0, |found| found.per_number));
    }
    let cells: Vec<_> = (squares.iter().zip(means))
        .map(|(square, mean)| format!("{square:.2} ({mean:.1})"))
        .collect();
    Ok(format!(
        "| {} | {} | {} | {chi:.2} |",
        known.name,
        cells.join(" | "),
        percent(worst)
    ))
}
