//! What a quadratic subproblem costs by either route, over the numbers of elements, steps and controls.
//!
//! ```text
//! cargo bench --bench qp_routes
//! ```

use nalgebra::Vector3;
use softarm::control::{
    Channel, ControlGrid, Goal, Guess, Hold, OptimalControlProblem, Transcription, first_point,
};
use softarm::mechanics::stability::automatic_step;
use softarm::mechanics::{Material, Rod, RodParameters, Section, SectionProfile, State, TimeGrid};
use softarm::sqp::quadratic_program::{KeptStates, QuadraticProgram};
use softarm::sqp::{LiftedProgram as _, LinearizationRequest};

fn main() {
    divan::main();
}

/// Elements, steps, blocks.
#[derive(Clone, Copy, Debug)]
struct Size(usize, usize, usize);

impl std::fmt::Display for Size {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(
            f,
            "K = {}, N = {}, {} variables",
            self.0,
            self.1,
            6 * self.2
        )
    }
}

const SIZES: [Size; 8] = [
    Size(4, 200, 10),
    Size(4, 200, 20),
    Size(4, 200, 50),
    Size(4, 200, 100),
    Size(4, 400, 20),
    Size(8, 200, 20),
    Size(12, 200, 20),
    Size(20, 100, 20),
];

impl Size {
    /// A silicone arm of 1 m on the way to a point at its side.
    fn problem(self) -> OptimalControlProblem {
        let Self(n_elements, n_steps, blocks) = self;
        let material = Material::isotropic(1e6, 0.5, 1000.0);
        let section = SectionProfile::Uniform(Section::circle(&material, 0.05));
        let parameters = RodParameters {
            viscous_damping: 1.0,
            ..RodParameters::straight(1.0, n_elements, section)
        };
        let rod = Rod::new(&parameters).expect("a rod");
        let grid = TimeGrid {
            start: 0.0,
            step: automatic_step(&rod),
            n_steps,
        };
        let goal = Goal::reach(&rod, grid, Vector3::new(0.1, 0.03, 0.985));
        let control = ControlGrid::new(Hold::Constant, blocks, n_steps, grid.step).expect("blocks");
        let channels = [rod.scales.force, rod.scales.moment].map(|scale| Channel::new(scale, None));
        let initial = State::at_rest(rod.rest.clone());
        OptimalControlProblem::least_effort(rod, grid, initial, control, channels, goal)
    }
}

#[divan::bench(args = SIZES, sample_count = 3, sample_size = 1)]
fn condensed(bencher: divan::Bencher, size: Size) {
    step(bencher, size, false);
}

#[divan::bench(args = SIZES, sample_count = 3, sample_size = 1)]
fn sparse(bencher: divan::Bencher, size: Size) {
    step(bencher, size, true);
}

/// The first subproblem from rest.
fn step(bencher: divan::Bencher, size: Size, with_states: bool) {
    let problem = size.problem();
    let program = Transcription::new(&problem, 1);
    let (point, _) = first_point(&problem, Guess::Rest, None).expect("a start");
    let evaluation = program.evaluate(&point).expect("numbers");
    let request = LinearizationRequest::default();
    let linearization = program
        .linearize(&point, &evaluation, &request)
        .expect("numbers");
    let kept = (program.keep_states(&point, &[]).expect("numbers")).expect("explicit steps");
    let subproblem = QuadraticProgram {
        elastic_weight: 1e3,
        states: with_states.then_some(KeptStates {
            linearization: &kept,
            replaces_hessian: true,
        }),
        ..QuadraticProgram::of(&linearization, &point.variables, program.sets(), &[], &[])
    };
    bencher.bench_local(|| subproblem.solve());
}
