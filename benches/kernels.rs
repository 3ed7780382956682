//! Speed of the two kernels that everything rests on, in the units of the targets: nanoseconds per node-step of the
//! forward simulation, and GFlop/s of the sensitivity sweep. Run with `cargo bench --bench kernels`.

#[path = "../tests/common/mod.rs"]
mod common;

use std::time::Instant;

use common::{RULES, laws, soft_arm};
use divan::counter::ItemsCount;
use softarm::mechanics::curvature::Multipliers;
use softarm::mechanics::linearization::{
    AdjointSweep, Motion, RightHandSide, adjoint_sweep, defects,
};
use softarm::mechanics::sensitivity::{ControlColumns, sensitivities};
use softarm::mechanics::stability::stable_step;
use softarm::mechanics::{
    ControlSignal, FormTerm, Integrator, LaneIntegrator, Rod, RodParameters, State, StateForm,
    StrainRule, TimeGrid, Trajectory, Wrench,
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
        let integrator = Integrator::new(&rod, 0.7 * stable_step(&rod), moving(&rod));
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

fn median(runs: usize, work: impl FnMut()) -> f64 {
    sorted_times(runs, work)[runs / 2]
}

fn sorted_times(runs: usize, mut work: impl FnMut()) -> Vec<f64> {
    work();
    let mut times: Vec<f64> = (0..runs)
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64()
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times
}

/// Instruction sets that this machine offers, the best first.
fn levels() -> Vec<(&'static str, pulp::Arch)> {
    let mut levels = Vec::new();
    #[cfg(target_arch = "x86_64")]
    {
        use pulp::x86::{V3, V4};
        levels.extend(V4::try_new().map(|simd| ("AVX-512", pulp::Arch::V4(simd))));
        levels.extend(V3::try_new().map(|simd| ("AVX2", pulp::Arch::V3(simd))));
    }
    levels.push(("baseline", pulp::Arch::Scalar));
    levels
}

/// Vectors of numbers in flight, enough for the latency of two units.
const IN_FLIGHT: usize = 12;

/// `x ← x a + b` without fused operations, as the lanes do it, with nothing to wait for.
struct MultiplyAdd {
    n_rounds: usize,
}

impl pulp::WithSimd for MultiplyAdd {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) -> usize {
        let (a, b) = (simd.splat_f64s(0.999), simd.splat_f64s(1e-3));
        let mut x = [simd.splat_f64s(2.0); IN_FLIGHT];
        for _ in 0..self.n_rounds {
            for x in &mut x {
                *x = simd.add_f64s(simd.mul_f64s(*x, a), b);
            }
        }
        for x in x {
            divan::black_box(simd.reduce_sum_f64s(x));
        }
        2 * IN_FLIGHT * S::F64_LANES * self.n_rounds
    }
}

/// The same without vectors of one's own: the compiler finds those of the baseline.
fn multiply_add(n_rounds: usize) -> usize {
    let mut x = [divan::black_box(2.0); 2 * IN_FLIGHT];
    for _ in 0..n_rounds {
        for x in &mut x {
            *x = *x * 0.999 + 1e-3;
        }
    }
    divan::black_box(x);
    2 * x.len() * n_rounds
}

/// GFlop/s of [`MultiplyAdd`] on one core.
fn peak(arch: pulp::Arch) -> f64 {
    let n_rounds = 1_000_000;
    let run = || match arch {
        pulp::Arch::Scalar => multiply_add(n_rounds),
        _ => arch.dispatch(MultiplyAdd { n_rounds }),
    };
    let seconds = median(9, || {
        divan::black_box(run());
    });
    run() as f64 / seconds * 1e-9
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
                let integrator = LaneIntegrator::on(arch, &rod, step, &initial)
                    .expect("a rod with explicit steps");
                let times = sorted_times(15, || simulate_lanes(&integrator, &push(&rod), n_steps));
                line += &format!(
                    "   {name} {:6.1} ({:6.1})",
                    times[7] * scale,
                    times[0] * scale
                );
            }
            let integrator = Integrator::new(&rod, step, initial.clone());
            let times = sorted_times(3, || simulate(&integrator, &push(&rod), n_steps));
            line += &format!(
                "   plain {:6.1} ({:6.1})",
                times[1] * scale,
                times[0] * scale
            );
            println!("{line}");
        }
    }
}

/// Every node moves and turns: where a wave has not arrived yet, numbers are subnormal, and slow.
fn moving(rod: &Rod) -> State {
    let mut state = State::at_rest(rod.rest.clone());
    for (q, node) in rod.nodes.iter().enumerate() {
        let x = q as f64;
        let wave = nalgebra::Vector3::new((3.0 * x).sin(), (5.0 * x).cos(), (7.0 * x).sin());
        state.linear_momentum[q] = wave * (0.01 * node.mass);
        state.angular_momentum[q] = node.rotary.component_mul(&wave);
    }
    state
}

fn push(rod: &Rod) -> ControlSignal {
    let push = Wrench {
        force: nalgebra::Vector3::new(0.2, 0.1, 0.0),
        ..Wrench::default()
    };
    ControlSignal::tip(rod, vec![push])
}

fn simulate_lanes(start: &LaneIntegrator, control: &ControlSignal, n_steps: usize) {
    let mut integrator = start.clone();
    for _ in 0..n_steps {
        integrator
            .advance([control.at(0); 2])
            .expect("a stable step");
    }
    divan::black_box(integrator.position(0));
}

fn simulate(start: &Integrator, control: &ControlSignal, n_steps: usize) {
    let mut integrator = start.clone();
    for _ in 0..n_steps {
        integrator
            .advance([control.at(0); 2])
            .expect("a stable step");
    }
    divan::black_box(integrator.state());
}

struct SensitivityCase<'a> {
    rod: &'a Rod,
    grid: TimeGrid,
    initial: State,
    trajectory: Trajectory,
    blocks: Blocks,
    end: Vec<StateForm>,
    on_the_way: Vec<StateForm>,
    adjoint: AdjointSweep,
}

/// What is asked of the columns.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Question {
    /// Few forms: they go backward.
    End,
    /// Many: the columns go forward.
    OnTheWay,
    Curvature,
}

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

impl<'a> SensitivityCase<'a> {
    fn new(rod: &'a Rod, n_steps: usize, n_blocks: usize) -> Self {
        let initial = State::at_rest(rod.rest.clone());
        let mut trajectory = Trajectory::with_capacity(rod.n_nodes(), n_steps + 1);
        for _ in 0..=n_steps {
            trajectory.push(&initial.configuration);
        }
        let grid = TimeGrid {
            start: 0.0,
            step: 0.7 * stable_step(rod),
            n_steps,
        };
        let form = |time_node: usize, component: usize| StateForm {
            time_node,
            terms: vec![FormTerm {
                node: rod.tip(),
                component,
                coefficient: 1.0,
            }],
        };
        let motion = Motion {
            stop: None,
            rod,
            grid,
            initial: &initial,
            control: None,
        };
        let end: Vec<_> = (0..12).map(|component| form(n_steps, component)).collect();
        let adjoint = adjoint_sweep(&motion, &trajectory, &end).expect("a rod at rest");
        Self {
            rod,
            grid,
            trajectory,
            blocks: Blocks {
                n_blocks,
                n_steps,
                node: rod.tip(),
            },
            on_the_way: (1..=100)
                .flat_map(|i| (0..6).map(move |component| (i, component)))
                .map(|(i, component)| form(i * n_steps / 100, component))
                .collect(),
            end,
            adjoint,
            initial,
        }
    }

    fn run(&self, question: Question, n_threads: usize) -> u64 {
        let motion = Motion {
            stop: None,
            rod: self.rod,
            grid: self.grid,
            initial: &self.initial,
            control: None,
        };
        let d = defects(&motion, &self.trajectory, &ControlSignal::default());
        let sources = RightHandSide::against(&d.expect("a rod at rest"));
        let multipliers = (question == Question::Curvature).then_some(Multipliers {
            adjoint: &self.adjoint,
            own: &[],
        });
        sensitivities(
            &motion,
            &self.trajectory,
            &[&sources],
            &self.blocks,
            match question {
                Question::OnTheWay => &self.on_the_way,
                Question::End | Question::Curvature => &self.end,
            },
            multipliers.as_ref(),
            n_threads,
        )
        .expect("a rod at rest")
        .flops
    }
}

/// Forward simulation of 1000 steps; an item is a node-step.
#[divan::bench(args = [10, 20, 40, 160])]
fn forward_helical(bencher: divan::Bencher, n_elements: usize) {
    let rod = Rod::new(&soft_arm(StrainRule::Helical, n_elements)).expect("a valid rod");
    let integrator = Integrator::new(&rod, 0.7 * stable_step(&rod), moving(&rod));
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
