//! The measured limits of the rod as a Markdown table, about two minutes: `cargo bench --bench extremes > benches/extremes.md`.

#[path = "../tests/common/mod.rs"]
mod common;

use std::fmt::Display;
use std::time::Instant;

use common::extremes::{
    Law, arc_errors, assembled_limit, compliance, drift, fold, growth, half_turn_error,
    locked_bending_error, objectivity_error, orthonormalization_effect, release, rotation_defect,
    same_in_other_units, spin_error, unattended_defect, uneven_drift,
};
use common::{Dice, laws, random_state, soft_arm};
use nalgebra::Matrix3;
use softarm::mechanics::rotation::orthonormalized;
use softarm::mechanics::{
    BaseCondition, Rod, RodModel, RodParameters, StepError, StrainRule, stable_step,
};

const HELICAL: Law = (StrainRule::Helical, RodModel::Standard);
const TRAPEZOIDAL: Law = (StrainRule::Trapezoidal, RodModel::Standard);

fn main() {
    println!("# Extremes\n");
    println!(
        "Printed by `cargo bench --bench extremes > benches/extremes.md`; `tests/rod/extremes.rs` asserts the same measurements \
         with their error models. Errors are relative unless a unit is given; \"of all laws\" means the largest over both \
         strain rules and the three models. The paper's `dilatation` has no energy that it could keep; under `standard` an \
         element passes through zero length.\n"
    );
    row("extreme", "range", "measured");
    row("---", "---", "---");
    units();
    slenderness();
    loads();
    inertias();
    turns();
    stretches();
    steps();
    rotations();
}

fn row(extreme: &str, range: impl Display, measured: impl Display) {
    let cells = [extreme.to_string(), range.to_string(), measured.to_string()];
    let [extreme, range, measured] = cells.map(|cell| cell.replace('|', "\\|"));
    println!("| {extreme} | {range} | {measured} |");
}

fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.map(f64::abs).fold(0.0, f64::max)
}

fn message<T>(result: Result<T, StepError>) -> String {
    result.map_or_else(|error| format!("refused: {error}"), |_| "holds".into())
}

fn units() {
    let units = [
        [0, 240, 0],
        [0, -240, 0],
        [60, 0, 0],
        [-60, 0, 0],
        [0, 0, 120],
        [0, 0, -120],
    ];
    let same = laws().all(|law| units.iter().all(|&units| same_in_other_units(law, units)));
    row(
        "units, and with them E from 1e-66 to 1e78 Pa at least",
        "kilogram 2^±240, meter 2^±60, second 2^±120 of ours",
        if same {
            "the same bits, all laws"
        } else {
            "differs"
        },
    );
}

fn slenderness() {
    for slenderness in [5.0, 100.0, 5000.0] {
        for n_elements in [1, 40, 2000] {
            if slenderness > 1000.0 && n_elements == 2000 {
                continue;
            }
            let moduli = [1e3, 2e11];
            let arcs = moduli.map(|e| arc_errors(RodModel::Standard, n_elements, slenderness, e));
            let locked = moduli.map(|e| locked_bending_error(n_elements, slenderness, e));
            row(
                &format!("slenderness L/r = {slenderness}, K = {n_elements}"),
                "E = 1e3 and 2e11 Pa",
                format!(
                    "helical arc found to {:.1e} L, held over 200 steps to {:.1e} L; trapezoidal: EI + GA l²/4 to {:.1e}",
                    largest(arcs.iter().map(|errors| errors[0])),
                    largest(arcs.iter().map(|errors| errors[1])),
                    largest(locked.into_iter()),
                ),
            );
        }
    }
}

fn loads() {
    for force in [1e-290, 1e-12, 1e-6, 1.0] {
        let change = laws().map(|law| {
            let reference = compliance(law, 1e-4).unwrap_or(f64::NAN);
            compliance(law, force).unwrap_or(f64::NAN) / reference - 1.0
        });
        let change = largest(change);
        row(
            "lateral tip load",
            format!("{force:e} N"),
            format!("compliance that of 1e-4 N to {change:.1e}, all laws"),
        );
    }
    for force in [1e6, 1e12, 1e300] {
        row(
            "lateral tip load",
            format!("{force:e} N"),
            message(compliance(HELICAL, force)),
        );
    }
    for law in laws() {
        let mut limit = 1.0;
        while compliance(law, limit * 1.1).is_ok() {
            limit *= 1.1;
        }
        row(
            "largest lateral tip load, stepped on, 300 steps",
            format!("{} {}, arm of EI/L² = 4.9 N", law.0.name(), law.1.name()),
            format!("{limit:.0} N"),
        );
    }
}

fn inertias() {
    for orders in [0.0, 10.0, 20.0] {
        let drifts: Vec<_> = laws()
            .filter(|law| law.1.has_potential())
            .map(|law| uneven_drift(law, orders))
            .collect();
        let measured = drifts.iter().flatten();
        row(
            "masses and moments of inertia along a free rod",
            format!("{orders} orders of magnitude"),
            if drifts.iter().all(Result::is_ok) {
                format!(
                    "20 000 steps: momenta to {:.1e} and {:.1e}, energy within {:.1e}",
                    largest(measured.clone().map(|d| d.linear)),
                    largest(measured.clone().map(|d| d.angular)),
                    largest(measured.map(|d| d.energy)),
                )
            } else {
                drifts
                    .into_iter()
                    .find_map(Result::err)
                    .map_or_else(String::new, |e| e.to_string())
            },
        );
    }
}

fn turns() {
    for level in [0.5, 1.0 - 1e-12] {
        let error = largest(
            [HELICAL, TRAPEZOIDAL]
                .map(|law| spin_error(law.0, level).unwrap_or(f64::NAN))
                .into_iter(),
        );
        row(
            "rotation per step, h π over the least inertia",
            format!("{level}"),
            format!("angle after 100 steps to {error:.1e}"),
        );
    }
    row(
        "rotation per step",
        "1 + 1e-12",
        message(spin_error(StrainRule::Helical, 1.0 + 1e-12)),
    );
    for gap in [1.0, 1e-2, 1e-4, 1e-7] {
        row(
            "neighbors turned by π less",
            format!("{gap:e} rad"),
            format!(
                "energy to {:.1e} helical, {:.1e} trapezoidal",
                half_turn_error(StrainRule::Helical, gap).abs(),
                half_turn_error(StrainRule::Trapezoidal, gap).abs()
            ),
        );
    }
    for law in laws() {
        let (error, energy) = fold(law, 1.5);
        row(
            "nodes thrown together with 1.5 times the bending energy of half a turn",
            format!("{} {}", law.0.name(), law.1.name()),
            format!(
                "{}; energy to {energy:.1e} until then",
                error.map_or_else(|| "turned back".into(), |error| format!("refused: {error}"))
            ),
        );
    }
}

fn stretches() {
    for law in laws() {
        for start in [0.05, 5.0] {
            let (fraction, n_steps) = if law.1 == RodModel::Standard {
                (0.1, 2000)
            } else {
                (1e-3, 50_000)
            };
            let measured = release(law, start, fraction, n_steps).map_or_else(
                |error| format!("refused: {error}"),
                |s| {
                    format!(
                        "between {:.3} and {:.3}, energy to {:.1e}",
                        s.least, s.largest, s.energy
                    )
                },
            );
            row(
                &format!("element released at {start} of its length"),
                format!(
                    "{} {}, {fraction} of the stable step",
                    law.0.name(),
                    law.1.name()
                ),
                measured,
            );
        }
    }
    row(
        "the same from 5, consistent",
        "0.7 of the stable step",
        message(release(
            (StrainRule::Helical, RodModel::Consistent),
            5.0,
            0.7,
            2000,
        )),
    );
}

fn steps() {
    for law in [HELICAL, TRAPEZOIDAL] {
        if let Ok(rod) = Rod::new(&soft_arm(law.0, 6)) {
            let ratio = stable_step(&rod) / assembled_limit(&rod);
            row(
                "`stable_step` over 2/ω of the assembled rod",
                law.0.name(),
                format!("{ratio:.4}"),
            );
        }
    }
    for fraction in [0.9, 0.99, 1.0, 1.01] {
        let runs: Vec<_> = laws().map(|law| growth(law, fraction, 2000)).collect();
        let most = largest(runs.iter().map(|run| run.0));
        let failure = runs.into_iter().find_map(|run| run.1);
        row(
            "time step over 2/ω of the assembled rod, disturbance of 1e-9, 2000 steps",
            fraction,
            format!(
                "energy grows at most {most:.1e} times, all laws{}",
                failure.map_or_else(String::new, |error| format!("; then refused: {error}"))
            ),
        );
    }
}

fn rotations() {
    for n_steps in [1_000_000, 10_000_000] {
        row(
            "product of small turns, nothing done about it, |RᵀR - I|",
            format!("{n_steps} turns"),
            format!("{:.1e}", unattended_defect(n_steps)),
        );
    }
    for law in [HELICAL, (StrainRule::Trapezoidal, RodModel::Consistent)] {
        let rod = Rod::new(&RodParameters {
            model: law.1,
            base: BaseCondition::Free,
            ..soft_arm(law.0, 3)
        });
        let Ok(rod) = rod else { continue };
        let initial = random_state(&rod, 0.05, 0.1, &mut Dice(1));
        let measured = drift(&rod, initial, 0.5 * stable_step(&rod), 10_000_000).map_or_else(
            |error| error.to_string(),
            |d| {
                format!(
                    "|RᵀR - I| at most {:.1e}; momenta to {:.1e} and {:.1e}, energy within {:.1e}",
                    d.rotation, d.linear, d.angular, d.energy
                )
            },
        );
        row(
            "1e7 steps of a free rod, K = 3",
            format!("{} {}", law.0.name(), law.1.name()),
            measured,
        );
    }
    let effects: Vec<_> = laws()
        .filter(|law| law.1.has_potential())
        .map(orthonormalization_effect)
        .collect();
    row(
        "effect of one return to the group",
        "from |RᵀR - I| = 1e-14",
        format!(
            "energy changes by {:.1e}, angular momentum by {:.1e}",
            largest(effects.iter().map(|e| e[0])),
            largest(effects.iter().map(|e| e[1]))
        ),
    );
    let started = Instant::now();
    let mut r = Matrix3::identity();
    for _ in 0..1_000_000 {
        r = orthonormalized(&divan::black_box(r));
    }
    let ns = started.elapsed().as_secs_f64() * 1e3;
    row(
        "cost of a return to the group",
        "one in 64 steps",
        format!(
            "{ns:.1} ns, {:.2} ns per node-step (defect {:.0e})",
            ns / 64.0,
            rotation_defect(&r)
        ),
    );
    for angle in [1e-9, 3.0, 1e3] {
        row(
            "rigid turn of a deformed rod",
            format!("{angle:e} rad"),
            format!(
                "energy to {:.1e}, all laws",
                largest(laws().map(|law| objectivity_error(law, angle)))
            ),
        );
    }
}
