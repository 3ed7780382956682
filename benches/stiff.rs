//! A nitinol wire (E = 75 GPa, L = 0.5 m, r = 0.5 mm) that swings in its first three bending modes, by either scheme: wall time
//! against the error of the tip, time step and elements together. Run with `cargo bench --bench stiff`.

use std::time::Instant;

use nalgebra::Vector3;
use softarm::mechanics::stability::{AUTO_STEP_FRACTION, automatic_step, stable_step};
use softarm::mechanics::{
    LaneIntegrator, Material, NodeWrenches, Rod, RodParameters, Section, SectionProfile,
    SolverWork, State, TimeScheme,
};

/// Duration, s: two periods of the third mode.
const END: f64 = 0.06;
const ELEMENTS: usize = 20;

fn main() {
    let reference = swing(&wire(4 * ELEMENTS, TimeScheme::Implicit), 6400).0;
    let report = |scheme: TimeScheme, n_steps: usize, runs: usize| {
        let rod = wire(ELEMENTS, scheme);
        let mut times = Vec::new();
        let mut found = (Vector3::zeros(), SolverWork::default());
        for _ in 0..runs {
            let start = Instant::now();
            found = swing(&rod, n_steps);
            times.push(start.elapsed().as_secs_f64());
        }
        times.sort_by(f64::total_cmp);
        let seconds = times[runs / 2];
        let (tip, work) = found;
        println!(
            "{:9} {n_steps:7} steps of {:8.2e} s ({:7.1} times the explicit limit)  {:9.2e} s  {:7.1} ns per node-step  {:4.2} corrections \
             and {:5.3} factorizations a step  tip error {:.2e} m",
            scheme.name(),
            END / n_steps as f64,
            END / n_steps as f64 / stable_step(&rod),
            seconds,
            seconds * 1e9 / (n_steps * rod.n_nodes()) as f64,
            work.corrections as f64 / n_steps as f64,
            work.factorizations as f64 / n_steps as f64,
            (tip - reference).norm()
        );
    };
    let rod = wire(ELEMENTS, TimeScheme::Implicit);
    let steps = |longest: f64| (END / longest).ceil() as usize;
    report(
        TimeScheme::Explicit,
        steps(AUTO_STEP_FRACTION * stable_step(&rod)),
        3,
    );
    report(TimeScheme::Implicit, steps(50.0 * stable_step(&rod)), 5);
    report(TimeScheme::Implicit, steps(automatic_step(&rod)), 5);
    for longer in [4, 16] {
        report(
            TimeScheme::Implicit,
            steps(automatic_step(&rod)) / longer,
            5,
        );
    }
}

fn wire(n_elements: usize, scheme: TimeScheme) -> Rod {
    let material = Material::isotropic(75e9, 0.33, 6450.0);
    let section = SectionProfile::Uniform(Section::circle(&material, 0.5e-3));
    Rod::new(&RodParameters {
        scheme,
        ..RodParameters::straight(0.5, n_elements, section)
    })
    .expect("a valid wire")
}

/// Where the tip is at the end, and what the solutions of the steps took.
fn swing(rod: &Rod, n_steps: usize) -> (Vector3<f64>, SolverWork) {
    let mut initial = State::at_rest(rod.rest.clone());
    for (q, p) in initial.linear_momentum.iter_mut().enumerate() {
        let s = q as f64 / rod.tip() as f64;
        // Two polynomials that vanish with their slopes at the clamp: all of the slow modes, tip speed about 3 m/s.
        *p = Vector3::new(3.0 * s.powi(2), 2.0 * s.powi(3) * (1.0 - 2.0 * s), 0.0)
            * rod.nodes[q].mass;
    }
    let step = END / n_steps as f64;
    let mut integrator = LaneIntegrator::new(rod, step, &initial);
    for _ in 0..n_steps {
        integrator
            .advance([NodeWrenches::NONE; 2])
            .expect("a stable step");
    }
    (integrator.position(rod.tip()), integrator.solver_work())
}
