//! Speed of the two kernels that everything rests on, in the units of the targets: nanoseconds per node-step of the
//! forward simulation, and GFlop/s of the sensitivity sweep. Run with `cargo bench --bench kernels`.

#[path = "../tests/common/mod.rs"]
mod common;
mod support;

use common::{RULES, laws, soft_arm};
use divan::counter::ItemsCount;
use softarm::mechanics::stability::stable_step;
use softarm::mechanics::{LaneIntegrator, Rod, RodParameters, Stepper, StrainRule};
use softarm::verify::ReferenceStepper;
use support::{
    Question, SensitivityCase, levels, median, moving, peak, push, simulate, simulate_lanes,
    simulate_reference, sorted_times,
};

fn main() {
    println!("SIMD level chosen at run time: {:?}", pulp::Arch::new());
    for (name, arch) in levels() {
        println!(
            "{name:8} {:6.1} GFlop/s at most on one core, multiplying and adding apart",
            peak(arch)
        );
    }
    forward_table();
    for rule in RULES {
        let rod = Rod::new(&soft_arm(rule, 20)).expect("a valid rod");
        let n_steps = 1000;
        let integrator = Stepper::new(&rod, 0.7 * stable_step(&rod), moving(&rod));
        let seconds = median(9, || simulate(&integrator, &push(&rod), n_steps));
        let ns = seconds * 1e9 / (n_steps * rod.n_nodes()) as f64;
        println!(
            "{:12} forward      K = 20          {ns:8.1} ns per node-step",
            rule.name()
        );
        let case = SensitivityCase::new(&rod, n_steps, 20);
        for (what, question) in [
            ("12 forms of the end", Question::End),
            ("6 forms at 100 time nodes", Question::OnTheWay),
            ("12 forms, curvature", Question::Curvature),
        ] {
            for n_threads in [1, 2] {
                let seconds = median(9, || {
                    case.run(question, n_threads);
                });
                let flops = case.run(question, n_threads) as f64;
                println!(
                    "{:12} sensitivity  K = 20, N = 1000, 120 columns, {n_threads} thread(s), {what:26} {:8.2} ms  {:6.1} GFlop/s",
                    rule.name(),
                    seconds * 1e3,
                    flops / seconds * 1e-9
                );
            }
        }
    }
    divan::main();
}

/// Nanoseconds per node-step of the forward simulation, median and minimum, for every length, law and instruction set.
fn forward_table() {
    println!("forward step, ns per node-step: median (minimum)");
    for (rule, model) in laws() {
        for n_elements in [10, 20, 40, 100, 400, 2000] {
            let rod = Rod::new(&RodParameters {
                model,
                ..soft_arm(rule, n_elements)
            })
            .expect("a valid rod");
            let (step, initial) = (0.7 * stable_step(&rod), moving(&rod));
            let n_steps = 400_000 / rod.n_nodes();
            let scale = 1e9 / (n_steps * rod.n_nodes()) as f64;
            let mut line = format!("{:12} {:11} K = {n_elements:4}", rule.name(), model.name());
            for (name, arch) in levels() {
                let integrator = LaneIntegrator::on(arch, &rod, step, &initial);
                let times = sorted_times(15, || simulate_lanes(&integrator, &push(&rod), n_steps));
                line += &format!(
                    "   {name} {:6.1} ({:6.1})",
                    times[7] * scale,
                    times[0] * scale
                );
            }
            let integrator = ReferenceStepper::new(&rod, step, initial.clone());
            let times = sorted_times(3, || simulate_reference(&integrator, &push(&rod), n_steps));
            line += &format!(
                "   check {:6.1} ({:6.1})",
                times[1] * scale,
                times[0] * scale
            );
            println!("{line}");
        }
    }
}

/// Forward simulation of 1000 steps; an item is a node-step.
#[divan::bench(args = [10, 20, 40, 160])]
fn forward_helical(bencher: divan::Bencher, n_elements: usize) {
    let rod = Rod::new(&soft_arm(StrainRule::Helical, n_elements)).expect("a valid rod");
    let integrator = Stepper::new(&rod, 0.7 * stable_step(&rod), moving(&rod));
    bencher
        .counter(ItemsCount::new(1000 * (n_elements + 1)))
        .bench(|| simulate(&integrator, &push(&rod), 1000));
}

/// All sensitivities of 20 blocks over 1000 steps, one thread; an item is a floating-point operation on the columns.
#[divan::bench(args = [10, 20, 40], sample_count = 20)]
fn sensitivity_helical(bencher: divan::Bencher, n_elements: usize) {
    let rod = Rod::new(&soft_arm(StrainRule::Helical, n_elements)).expect("a valid rod");
    let case = SensitivityCase::new(&rod, 1000, 20);
    let flops = case.run(Question::OnTheWay, 1);
    bencher
        .counter(ItemsCount::new(flops))
        .bench(|| case.run(Question::OnTheWay, 1));
}
