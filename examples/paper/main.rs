//! Do the paper's equations and data give the numbers that it prints in its section 5?
//!
//! Prints those numbers beside ours, and what the same experiments do under other models, strain rules and grids.
//! `docs/paper.md` explains the tables, and `benches/paper.md` has them:
//!
//! ```text
//! cargo run --release --example paper -- --convergence --long > benches/paper.md
//! ```

mod comparison;
mod convergence;
mod figures;
mod grids;
mod long_run;
mod study;

use clap::Parser;
use softarm::mechanics::RodModel::{self, Consistent, Dilatation, Standard};
use softarm::mechanics::StrainRule::{self, Helical, Trapezoidal};

use convergence::{ConvergencePoint, against_the_last, order};
use figures::{Figure, READINGS, figures, readings};
use study::{Outcome, Study};

#[derive(Parser)]
struct Arguments {
    /// Also the convergence study of section 5.4: about a minute
    #[arg(long)]
    convergence: bool,
    /// Also the energy of the three models over ten million steps and more: some minutes
    #[arg(long)]
    long: bool,
    /// Runs at a time [default: as many as the machine has cores]
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Override a key of the scenes by its dotted path; any number of times
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
}

/// End of the third experiment's bending phase, s.
const BENT: f64 = 5.0;
/// Grids on which the bent rod is looked at.
const TIP_GRIDS: [(StrainRule, usize); 6] = [
    (Trapezoidal, 20),
    (Trapezoidal, 50),
    (Trapezoidal, 100),
    (Helical, 10),
    (Helical, 20),
    (Helical, 40),
];
/// The third experiment on finer grids: model, elements, step in s.
const FINE_GRIDS: [(RodModel, usize, f64); 6] = [
    (Dilatation, 20, 1e-4),
    (Dilatation, 50, 1e-4),
    (Dilatation, 100, 2e-4),
    (Dilatation, 100, 1e-4),
    (Standard, 100, 1e-4),
    (Consistent, 100, 1e-4),
];
/// Duration of the convergence study, s.
const STUDY_END: f64 = 2.0;
/// Elements of the study in time, and its steps, s; the last is the reference.
const TIME_STUDY: (usize, [f64; 6]) = (50, [1e-3, 5e-4, 1e-4, 5e-5, 1e-5, 1e-6]);
/// Step of the study in space, s, and its elements; the last are the reference.
const SPACE_STUDY: (f64, [usize; 10]) = (1e-4, [10, 100, 200, 300, 400, 500, 600, 700, 800, 900]);
/// Time step and steps of the long runs: ten million, and two pairs that show how the ripple depends on the step.
const LONG_RUNS: [(RodModel, f64, usize); 8] = [
    (Standard, 1e-3, 10_000_000),
    (Dilatation, 1e-3, 10_000_000),
    (Consistent, 1e-3, 10_000_000),
    (Standard, 5e-4, 20_000_000),
    (Standard, 2e-3, 500_000),
    (Standard, 1e-3, 1_000_000),
    (Consistent, 2e-3, 500_000),
    (Consistent, 1e-3, 1_000_000),
];
/// Period of the first bending mode of the paper's rod, s (0.64685 rad/s).
const PERIOD: f64 = 9.7135;

fn main() -> Outcome<()> {
    let arguments = Arguments::parse();
    let study = Study {
        overrides: arguments.set,
        threads: match arguments.threads {
            Some(threads) => threads.max(1),
            None => std::thread::available_parallelism().map_or(1, usize::from),
        },
    };
    let given: Vec<String> = std::env::args().skip(1).collect();
    println!("# The paper's section 5, recomputed\n");
    println!(
        "Printed by `cargo run --release --example paper -- {}`.",
        given.join(" ")
    );
    let figures = print_figures(&study)?;
    print_grids(&study)?;
    if arguments.convergence {
        print_convergence(&study)?;
    }
    if arguments.long {
        print_long_runs(&study)?;
    }
    let mut expected = figures.iter().filter(|figure| figure.reproducible);
    assert!(
        expected.all(Figure::reproduced),
        "a printed number that follows from the paper's equations and data is not reproduced"
    );
    Ok(())
}

/// Prints a table under a heading, its columns padded so that it reads well as it is.
fn table<const N: usize>(heading: &str, head: [&str; N], rows: &[[String; N]]) {
    let head = head.map(String::from);
    let widths: [usize; N] = std::array::from_fn(|column| {
        let cells = rows
            .iter()
            .chain([&head])
            .map(|row| row[column].chars().count());
        cells.fold(3, usize::max)
    });
    let rule = widths.map(|width| "-".repeat(width));
    println!("\n**{heading}**\n");
    for row in [&head, &rule].into_iter().chain(rows) {
        for (cell, width) in row.iter().zip(widths) {
            print!("| {cell:width$} ");
        }
        println!("|");
    }
}

fn print_figures(study: &Study) -> Outcome<Vec<Figure>> {
    let readings = readings(study)?;
    let figures = figures(&readings);
    let rows = figures.iter().map(|figure| {
        let (verdict, difference) = if figure.reproduced() {
            ("reproduced", String::new())
        } else {
            let paper: f64 = figure.paper.parse().unwrap_or(f64::NAN);
            let difference = format!("{:+.*}", figure.decimals(), figure.ours - paper);
            match figure.reproducible {
                true => ("NOT REPRODUCED", difference),
                false => ("differs", difference),
            }
        };
        [
            figure.section.into(),
            figure.quantity.into(),
            figure.equation.into(),
            figure.paper.into(),
            figure.rounded(),
            difference,
            verdict.into(),
            figure.remark.clone(),
        ]
    });
    table(
        "What the paper prints, and the same recomputed",
        [
            "section",
            "quantity",
            "equation",
            "paper",
            "ours",
            "difference",
            "verdict",
            "remark",
        ],
        &rows.collect::<Vec<_>>(),
    );
    let rows = READINGS
        .iter()
        .zip(&readings)
        .map(|((experiment, name, ..), c)| {
            let range = |[least, greatest]: [f64; 2], digits: usize| {
                format!("{least:.digits$} to {greatest:.digits$}")
            };
            [
                experiment.section.into(),
                name.to_string(),
                range(c.standard_dilatation, 4),
                range([c.dilatation_min.value, c.dilatation_max.value], 4),
                format!("{:.5}", c.length_error),
                format!("{:.4}", c.volume_error),
                format!("{:.3}", c.energy_error),
                format!("{:.4}", c.deflection_error),
                range(c.energy_unloaded, 3),
            ]
        });
    table(
        "The experiments under other models and strain rules, always against the standard model",
        [
            "section",
            "reading",
            "e, standard",
            "e, modified",
            "ΔL_max",
            "ΔV_max",
            "ΔH_max, J",
            "deflection, m",
            "energy after the loads, J",
        ],
        &rows.collect::<Vec<_>>(),
    );
    Ok(figures)
}

fn print_grids(study: &Study) -> Outcome<()> {
    let rows = study.map(&TIP_GRIDS, |&(strain, elements)| {
        let tip = grids::tip_at(study, BENT, strain, elements)?;
        Ok([
            strain.name().into(),
            elements.to_string(),
            format!("{:.2}", tip.stiffening),
            format!("{:.3}", tip.position.x),
            format!("{:.3}", tip.position.z),
        ])
    })?;
    table(
        "Section 5.3 at t = 5 s, standard model: shear locking of the paper's strain rule",
        [
            "strain",
            "K",
            "EI is multiplied by",
            "tip x1, m",
            "tip x3, m",
        ],
        &rows,
    );
    let rows = study.map(&FINE_GRIDS, |&(model, elements, step)| {
        let growth = grids::growth(study, model, elements, step)?;
        Ok([
            model.name().into(),
            elements.to_string(),
            format!("{step:.0e}"),
            format!("{:.4}", growth.ratio),
            match growth.breakdown {
                Some(time) => format!("breaks down at {time:.2} s"),
                None => "runs to its end, 20 s".into(),
            },
        ])
    })?;
    table(
        "Section 5.3 on finer grids: greatest energy after the loads have ended, over that at their end",
        ["model", "K", "h, s", "energy ratio", "outcome"],
        &rows,
    );
    Ok(())
}

fn print_convergence(study: &Study) -> Outcome<()> {
    let (elements, steps) = TIME_STUDY;
    for model in [Standard, Dilatation, Consistent] {
        let points =
            against_the_last(study, model, &steps.map(|step| (elements, step)), STUDY_END)?;
        print_errors(
            &format!("Section 5.4 in time, K = {elements}, {}", model.name()),
            &points,
            |p| p.step,
            ("h = 1e-4 to 1e-5", |p| p.step < 4e-4),
        );
    }
    let (step, elements) = SPACE_STUDY;
    let grids = elements.map(|elements| (elements, step));
    let points = against_the_last(study, Dilatation, &grids, STUDY_END)?;
    print_errors(
        &format!("Section 5.4 in space, h = {step:.0e} s, dilatation"),
        &points,
        |p| 1.0 / p.elements as f64,
        ("K = 100 to 400", |p| (100..=400).contains(&p.elements)),
    );
    Ok(())
}

/// Prints errors with their orders in `size`: from all points, and from those of a named range.
fn print_errors(
    heading: &str,
    points: &[ConvergencePoint],
    size: fn(&ConvergencePoint) -> f64,
    (range, is_in_range): (&str, fn(&ConvergencePoint) -> bool),
) {
    let errors = points.iter().map(|p| {
        [
            p.elements.to_string(),
            format!("{:.0e}", p.step),
            format!("{:.2e}", p.position),
            format!("{:.2e}", p.rotation),
        ]
    });
    let some: Vec<_> = points.iter().copied().filter(is_in_range).collect();
    let orders = [("all", points), (range, &some)].map(|(range, points)| {
        [
            format!("order, {range}"),
            String::new(),
            format!("{:.2}", order(points, size, |p| p.position)),
            format!("{:.2}", order(points, size, |p| p.rotation)),
        ]
    });
    let rows: Vec<_> = errors.chain(orders).collect();
    table(heading, ["K", "h, s", "ε_pos (94)", "ε_rot (95)"], &rows);
}

fn print_long_runs(study: &Study) -> Outcome<()> {
    let per_period =
        |[slope, error]: [f64; 2]| format!("{:+.1e} ± {:.0e}", slope * PERIOD, error * PERIOD);
    let rows = study.map(&LONG_RUNS, |&(model, step, steps)| {
        let run = long_run::long_run(study, model, step, steps)?;
        Ok([
            model.name().into(),
            format!("{step:.0e}"),
            format!("{:.0e}", steps as f64),
            format!("{:.6}", run.mean),
            format!("{:.2e}", run.ripple),
            per_period(run.trend),
            per_period(run.corrected),
            format!("{:.1e}", run.orthogonality),
        ])
    })?;
    table(
        "Section 5.3, K = 20, left to itself after its loads: energy (momenta at the nodes) and rotations",
        [
            "model",
            "h, s",
            "steps",
            "mean energy, J",
            "ripple, relative",
            "trend per period of 9.7 s, relative",
            "of the corrected energy",
            "greatest of RᵀR - I",
        ],
        &rows,
    );
    Ok(())
}
