//! The published benchmarks as Markdown tables, helical elements beside ten times as many trapezoidal ones, and rods of OpenCR-MuJoCo, two
//! to four minutes: `cargo bench --bench published > benches/published.md`; with `-- opencr` the latter alone, in seconds.

#[path = "../tests/common/mod.rs"]
mod common;

use common::published::dynamics::{
    SWINGS, Swing, bending_and_stretching, bending_and_stretching_rod, energy_at, errors, flights,
    planar_beam, states, stretching_error,
};
use common::published::frequencies::families;
use common::published::opencr::{median, references, rms};
use common::published::statics::{
    Benchmark, Elastica, Helix, bent_across, bent_along, buckled, critical_load_error, elastica,
    follower_error, forty_five_degree_bend, line_load, loads, paper_rod_table, post_buckling,
    roll_up_error, soft_arm_table,
};
use common::published::{MakeRod, largest};
use common::{cowper_arm, equilibrium, paper_rod, tip_load};
use softarm::mechanics::StrainRule::{self, Helical, Trapezoidal};
use softarm::mechanics::{
    Configuration, LoadFrame, NodeSpring, Rod, RodParameters, static_equilibrium,
};

const HELICAL: [usize; 3] = [5, 10, 20];

fn main() {
    if std::env::args().all(|argument| argument != "opencr") {
        rules();
    }
    opencr();
}

/// Helical and trapezoidal elements.
fn rules() {
    println!(
        "# Published benchmarks\n\n\
         Printed by `cargo bench --bench published > benches/published.md`. Do K helical elements do what 10 K trapezoidal \
         ones do? Standard model. Errors are of the tip over the length unless something else is named; a motion is judged by its largest \
         error, and both rules take the same step, short beside the shortest element, so that only elements are compared. \
         \"Gain\" is the factor of elements that the helical rule saves at K = 200, `sqrt(e_trapezoidal/e_helical)`, both \
         being of second order there. Tolerances are those of `tests/statics_and_modes` and `tests/rod/published_dynamics.rs`, at the K named. \
         Below {ROUNDING:e} an error is what the static solver leaves, and counts as none. The last column is measured where it gives a number: inertia that is half lumped, half consistent with \
         linear velocities leaves hardly an error of inertia to long waves.\n"
    );
    let head = [
        "benchmark",
        "reference",
        "tolerance",
        "K = 5, 10, 20 helical",
        "K = 50, 100, 200 trapezoidal",
        "holds",
        "gain",
        "why not",
    ];
    println!("| {} |\n|{}", head.join(" | "), " --- |".repeat(head.len()));
    statics();
    frequencies();
    dynamics();
}

/// Errors of the static solver, at 1e-9 of EI/L² a node, and of a time step below the least element's.
const ROUNDING: f64 = 1e-8;

/// One benchmark under both rules; `miss` says why ten times as many trapezoidal elements do better, where they do.
fn row(
    name: &str,
    reference: &str,
    tolerance: &str,
    miss: &str,
    error: impl Fn(StrainRule, usize) -> f64,
) {
    let helical = HELICAL.map(|n| error(Helical, n));
    let trapezoidal = HELICAL.map(|n| error(Trapezoidal, 10 * n));
    let holds = [0, 1, 2].map(|i| helical[i] <= trapezoidal[i].max(ROUNDING));
    let fine = error(Helical, 200);
    let show = |e: f64| {
        if e.is_nan() {
            "none found".to_string()
        } else {
            format!("{e:.1e}")
        }
    };
    let list = |errors: [f64; 3]| errors.map(show).join(", ");
    let verdict = match holds {
        [true, true, true] => "yes".to_string(),
        [false, false, false] => "no".to_string(),
        _ => HELICAL
            .iter()
            .zip(holds)
            .map(|(n, holds)| format!("{n}: {}", if holds { "yes" } else { "no" }))
            .collect::<Vec<_>>()
            .join(", "),
    };
    let gain = if fine < ROUNDING {
        "exact".to_string()
    } else {
        format!("{:.1}", (trapezoidal[2] / fine).sqrt())
    };
    let miss = if holds == [true; 3] { "" } else { miss };
    println!(
        "| {name} | {reference} | {tolerance} | {} | {} | {verdict} | {gain} | {miss} |",
        list(helical),
        list(trapezoidal)
    );
}

const LUMPED: &str =
    "lumped inertia, which both rules share, is most of what is left (see the free paper's rod)";
const STRETCH: &str = "nothing locks in stretch and torsion: both rules are the same chain";

fn statics() {
    let shooting = "shooting, residual 1e-14";
    for (table, reference) in [
        (paper_rod_table(), shooting),
        (
            soft_arm_table(),
            "shooting, residual 1e-14; planar rows Exudyn",
        ),
        (
            forty_five_degree_bend(),
            "Bathe and Bolourchi 1979; converged",
        ),
    ] {
        for benchmark in &table {
            let Benchmark {
                name,
                tolerance,
                helical,
                ..
            } = benchmark;
            row(
                name,
                reference,
                &format!("{tolerance:e} at {helical}"),
                "tension confines bending to sqrt(EI/F), a fifth of the arm, and locking with it",
                |rule, n| benchmark.error(rule, n),
            );
        }
    }
    type Shapes = fn(StrainRule, usize, f64, &[f64]) -> Vec<Configuration>;
    let along: Shapes = |rule, n, stiffness, loads| {
        let shape = |load: &f64| bent_along(rule, n, stiffness, *load);
        loads.iter().map(shape).collect()
    };
    let elliptic = "elliptic integrals";
    for (name, reference, tolerance, rows, shapes) in [
        (
            "elastica, load across, α up to 20",
            "Bisshopp and Drucker 1945; elliptic integrals",
            "5e-3 of the deflection at 20",
            elastica(),
            bent_across as Shapes,
        ),
        (
            "elastica, axial load, beyond buckling",
            elliptic,
            "2e-3 P/(P - P_c) at 20",
            post_buckling(),
            buckled,
        ),
        (
            "elastica, load along the rod",
            shooting,
            "1e-2 at 10",
            line_load(),
            along,
        ),
    ] {
        // The deepest bends of the tables need more than five elements.
        let rows: Vec<Elastica> = rows.into_iter().filter(|row| row.load <= 20.0).collect();
        let (soft, stiff) = (1e3, 1e7);
        row(
            &format!("{name}, EA = GA = {stiff:e} EI/L²"),
            reference,
            tolerance,
            "",
            |rule, n| {
                let shapes = shapes(rule, n, stiff, &loads(&rows));
                let pairs = rows.iter().zip(&shapes);
                largest(
                    &pairs
                        .map(|(row, shape)| row.position_error(shape))
                        .collect::<Vec<_>>(),
                )
            },
        );
        let [coarse, fine] = [160, 320].map(|n| shapes(Helical, n, soft, &loads(&rows)));
        let exact: Vec<_> = coarse
            .iter()
            .zip(&fine)
            .map(|(coarse, fine)| {
                let (coarse, fine) = (coarse.positions[160], fine.positions[320]);
                fine + (fine - coarse) / 3.0
            })
            .collect();
        row(
            &format!("the same, {soft:e} EI/L²"),
            "extrapolated from K = 160 and 320, helical",
            "",
            "",
            |rule, n| {
                let shapes = shapes(rule, n, soft, &loads(&rows));
                let errors = shapes
                    .iter()
                    .zip(&exact)
                    .map(|(shape, exact)| (shape.positions[n] - exact).norm());
                largest(&errors.collect::<Vec<_>>())
            },
        );
    }
    row(
        "end moment, two circles",
        "Simo and Vu-Quoc 1986; closed form",
        "1e-8 at 5",
        "",
        |rule, n| roll_up_error(rule, n, 2.0),
    );
    let helix = Helix::new(4.0 * std::f64::consts::PI, 0.3);
    row(
        "end wrench, two turns of a helix, torsion 0.3",
        "closed form",
        "1e-8 at 6",
        "",
        |rule, n| {
            let shape = static_equilibrium(
                &helix.rod(rule, n),
                &helix.shape(n),
                0.0,
                &NodeSpring::default(),
            );
            shape.map_or(f64::NAN, |shape| {
                (shape.positions[n] - helix.position(1.0)).norm()
            })
        },
    );
    for (force, moment) in [
        ([20.0, 0.0, 0.0], [0.0; 3]),
        ([5.0, 3.0, 10.0], [0.5, 4.0, 1.0]),
    ] {
        row(
            &format!("soft arm, follower force {force:?}, moment {moment:?}"),
            "integrated from the tip, 4000 steps",
            "2e-3 at 20",
            "",
            |rule, n| {
                follower_error(&RodParameters {
                    loads: tip_load(n, force, moment, LoadFrame::Body),
                    ..cowper_arm(rule, n)
                })
            },
        );
    }
    for (name, rod) in [
        ("soft arm", cowper_arm as MakeRod),
        ("paper's rod", paper_rod),
    ] {
        row(
            &format!("{name}, buckling load, relative"),
            "closed form (Euler, with shear and stretch)",
            "2.5e-3 at 10",
            "",
            |rule, n| critical_load_error(&rod(rule, n)),
        );
    }
    row(
        "soft arm hanging under gravity",
        "closed form",
        "1e-9 at 2",
        STRETCH,
        |rule, n| {
            let p = RodParameters {
                gravity: nalgebra::Vector3::new(0.0, 0.0, 9.81),
                ..cowper_arm(rule, n)
            };
            (equilibrium(&p, 1).1.positions[n].z - (1.0 + 1000.0 * 9.81 / 2e6)).abs()
        },
    );
}

fn frequencies() {
    for family in families() {
        let lumped = family.errors(Helical, 20);
        let elements = family.errors_of_elements(20);
        for mode in 0..family.exact.len() {
            let miss = if !family.name.contains("bending") {
                STRETCH.to_string()
            } else {
                format!(
                    "the error common to both rules grows with the frequency, that of locking does not; at K = 20 it is {:.1e} \
                     with lumped inertia, {:.1e} with half of it consistent",
                    lumped[mode], elements[mode]
                )
            };
            row(
                &format!("{}, frequency {}, relative", family.name, mode + 1),
                "Timoshenko beam, collocation, 8 digits",
                &format!("(βl)²/4 at {}", family.grids[0]),
                &miss,
                |rule, n| family.errors(rule, n)[mode],
            );
        }
    }
}

fn dynamics() {
    let step = 2.5e-4;
    let converged = "two discretizations, extrapolated";
    for flight in flights() {
        let name = flight.name;
        let reference = if name == "flying beam" {
            "Simo and Vu-Quoc 1988; two discretizations, extrapolated"
        } else {
            converged
        };
        row(
            &format!("{name}, both ends, m"),
            reference,
            "0.3 at 20",
            LUMPED,
            |rule, n| largest(&errors(&flight.rod(rule, n), step, &flight.table)),
        );
        row(
            &format!("{name}, energy at 6 s, relative"),
            reference,
            "1e-2 at 20",
            LUMPED,
            |rule, n| (energy_at(&flight.rod(rule, n), step, 6.0) / flight.energy - 1.0).abs(),
        );
    }
    let half = 2.5 / 10_000.5;
    let planar = |rule, n: usize| {
        let rod = Rod::new(&planar_beam(rule, n)).unwrap();
        states(&rod, half, &[5.0])[0].configuration.positions[n]
    };
    let [coarse, fine] = [160, 320].map(|n| planar(Helical, n));
    let exact = fine + (fine - coarse) / 3.0;
    row(
        "planar flying beam, tip at 5 s, m",
        "Simo and Vu-Quoc 1986; extrapolated from K = 160 and 320, helical",
        "",
        LUMPED,
        |rule, n| (planar(rule, n) - exact).norm(),
    );
    row(
        "pure stretching, tip, m",
        "d'Alembert, exact",
        "1e-3 at 50",
        STRETCH,
        |rule, n| stretching_error(rule, n, step),
    );
    let table = bending_and_stretching();
    for (until, rows) in [("2.5", 0..2), ("5", 0..3), ("8", 0..6)] {
        row(
            &format!("bending, then stretching, tip up to {until} s, m"),
            converged,
            if until == "8" { "1e-2 at 40" } else { "" },
            "",
            |rule, n| {
                largest(&errors(
                    &bending_and_stretching_rod(rule, n),
                    step,
                    &table[rows.clone()],
                ))
            },
        );
    }
    for swing in &SWINGS {
        let tips = |rule, n| swing.tips(rule, n, 1.25e-4);
        let exact = Swing::extrapolated(&tips(Helical, 100), &tips(Helical, 200));
        row(
            &format!("soft arm, {}, over the deflection", swing.name),
            "extrapolated from K = 100 and 200, helical",
            "2e-2 at 10",
            LUMPED,
            |rule, n| Swing::distance(&tips(rule, n), &exact),
        );
    }
}

/// Rods of OpenCR-MuJoCo, at rest and released.
fn opencr() {
    println!(
        "\n## Rods that SoRoSim computed\n\n\
         Alone by `cargo bench --bench published -- opencr`. OpenCR-MuJoCo has them beside its simulator \
         ([data](../examples/opencr/references/README.md)): a rod is held by wrenches in the middle and at the tip, and by gravity. Errors are \
         distances of the tip over the length. \"Rounding\" is the distance by which tips move when loads and positions change within half \
         of the fourth place, to which the data are written.\n"
    );
    let show = |errors: &[f64]| {
        [median, rms, largest]
            .map(|of| format!("{:.1e}", of(errors)))
            .join(" / ")
    };
    println!(
        "| shapes at rest: median / rms / largest | number | rounding | K = 20 | K = 40 | K = 80 |\n|{}",
        " --- |".repeat(6)
    );
    for reference in references() {
        let shapes = reference.shapes();
        let cells = [20, 40, 80].map(|n| show(&reference.static_errors(n, &shapes)));
        let rounding = show(&reference.static_rounding(40, &shapes));
        println!(
            "| {} | {} | {rounding} | {} |",
            reference.name,
            shapes.len(),
            cells.join(" | ")
        );
    }
    println!(
        "\nA release takes the wrenches away; the rod moves for 10 s under its weight and internal damping. Root mean square over the motion, \
         with implicit steps of 1 ms. The references neither shear nor stretch; the last columns have a rod that does both, and one that \
         is stiffer.\n"
    );
    println!(
        "| release | K = 20 | K = 40 | K = 80 | K = 40, half the step | K = 40, shears and stretches | K = 80, 0.1 % stiffer |\n|{}",
        " --- |".repeat(7)
    );
    for reference in references() {
        for number in reference.releases {
            let release = reference.release(number);
            let [mut shearing, mut stiffer] = [(); 2].map(|()| reference.clone());
            shearing.shears = true;
            stiffer.stiffness = 1.001;
            let cells = [
                (&reference, 20, 1e-3),
                (&reference, 40, 1e-3),
                (&reference, 80, 1e-3),
                (&reference, 40, 5e-4),
                (&shearing, 40, 1e-3),
                (&stiffer, 80, 1e-3),
            ]
            .map(|(rod, n, step)| format!("{:.1e}", rod.release_error(n, step, &release)));
            println!("| {}, {number} | {} |", reference.name, cells.join(" | "));
        }
    }
}
