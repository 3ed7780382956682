//! What the benches of kernels and the table of all times share.
#![allow(dead_code)] // no bench uses all of it

use std::time::Instant;

use softarm::mechanics::curvature::MotionMultipliers;
use softarm::mechanics::linearization::{AdjointSweep, Motion, RightHandSide};
use softarm::mechanics::sensitivity::{ControlColumns, adjoint, defects, sensitivities};
use softarm::mechanics::stability::stable_step;
use softarm::mechanics::{
    ControlSignal, FormTerm, LaneIntegrator, Rod, State, StateForm, Stepper, TimeGrid, Trajectory,
    Wrench,
};
use softarm::verify::ReferenceStepper;

pub fn median(runs: usize, work: impl FnMut()) -> f64 {
    sorted_times(runs, work)[runs / 2]
}

pub fn sorted_times(runs: usize, mut work: impl FnMut()) -> Vec<f64> {
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

/// Shows a line and adds it to a page.
pub fn say(page: &mut String, line: impl AsRef<str>) {
    eprintln!("{}", line.as_ref());
    page.push_str(line.as_ref());
    page.push('\n');
}

/// Writes a page into the folder of the benches.
pub fn write(page: &str, name: &str) {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("benches");
    std::fs::write(folder.join(name), page).expect("benches can be written");
}

/// Returns the name of the processor and the number of its threads.
pub fn machine() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = text.lines().find(|line| line.starts_with("model name"));
    let name = name.and_then(|line| line.split_once(": "));
    let name = name.map_or("a processor that does not name itself", |(_, name)| name);
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    format!("{name}, {threads} threads")
}

/// Instruction sets that this machine offers, the best first.
pub fn levels() -> Vec<(&'static str, pulp::Arch)> {
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
pub struct MultiplyAdd {
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
pub fn multiply_add(n_rounds: usize) -> usize {
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
pub fn peak(arch: pulp::Arch) -> f64 {
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

/// Every node moves and turns: where a wave has not arrived yet, numbers are subnormal, and slow.
pub fn moving(rod: &Rod) -> State {
    let mut state = State::at_rest(rod.rest.clone());
    for (q, node) in rod.nodes.iter().enumerate() {
        let x = q as f64;
        let wave = nalgebra::Vector3::new((3.0 * x).sin(), (5.0 * x).cos(), (7.0 * x).sin());
        state.linear_momentum[q] = wave * (0.01 * node.mass);
        state.angular_momentum[q] = node.rotary.component_mul(&wave);
    }
    state
}

pub fn push(rod: &Rod) -> ControlSignal {
    let push = Wrench {
        force: nalgebra::Vector3::new(0.2, 0.1, 0.0),
        ..Wrench::default()
    };
    ControlSignal::tip(rod, vec![push])
}

pub fn simulate_lanes(start: &LaneIntegrator, control: &ControlSignal, n_steps: usize) {
    let mut integrator = start.clone();
    for _ in 0..n_steps {
        integrator
            .advance([control.at(0); 2])
            .expect("a stable step");
    }
    divan::black_box(integrator.position(0));
}

pub fn simulate(start: &Stepper, control: &ControlSignal, n_steps: usize) {
    let mut integrator = start.clone();
    for _ in 0..n_steps {
        integrator
            .advance([control.at(0); 2])
            .expect("a stable step");
    }
    divan::black_box(&integrator.state());
}

/// The same by the integrator of the check.
pub fn simulate_reference(start: &ReferenceStepper, control: &ControlSignal, n_steps: usize) {
    let mut integrator = start.clone();
    for _ in 0..n_steps {
        integrator
            .advance([control.at(0); 2])
            .expect("a stable step");
    }
    divan::black_box(integrator.state());
}

pub struct SensitivityCase<'a> {
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
pub enum Question {
    /// Few forms: they go backward.
    End,
    /// Many: the columns go forward.
    OnTheWay,
    Curvature,
}

pub struct Blocks {
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
    pub fn new(rod: &'a Rod, n_steps: usize, n_blocks: usize) -> Self {
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
        let adjoint = adjoint(&motion, &trajectory, &end, 1).expect("a rod at rest");
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

    pub fn run(&self, question: Question, n_threads: usize) -> u64 {
        let motion = Motion {
            stop: None,
            rod: self.rod,
            grid: self.grid,
            initial: &self.initial,
            control: None,
        };
        let d = defects(&motion, &self.trajectory, &ControlSignal::default());
        let sources = RightHandSide::against(&d.expect("a rod at rest"));
        let multipliers = (question == Question::Curvature).then_some(MotionMultipliers {
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
