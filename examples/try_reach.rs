#[path = "../tests/common/mod.rs"]
mod common;
use softarm::control::*;
use softarm::mechanics::*;
use softarm::sqp::*;
use std::ops::ControlFlow;
use nalgebra::Vector3;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let hess = match args.get(1).map(|s| s.as_str()) { Some("gn") => HessianChoice::GaussNewton, Some("exact") => HessianChoice::Exact, _ => HessianChoice::Auto };
    let guess = if args.get(2).map(|s| s.as_str()) == Some("rest") { Guess::Rest } else { Guess::StaticPath };
    let k: usize = args.get(3).and_then(|s| s.parse().ok()).unwrap_or(20);
    let blocks = 20;
    let mut p = common::soft_arm(StrainRule::Helical, k);
    p.viscous_damping = 1.0;
    let rod = Rod::new(&p).unwrap();
    let hs = 0.7 * stability::stable_step(&rod);
    let n = ((1.0 / hs / blocks as f64).ceil() as usize) * blocks;
    let grid = TimeGrid { step: 1.0 / n as f64, n_steps: n };
    println!("h {hs} N {n}");
    let control = ControlGrid::new(Hold::Constant, blocks, n, grid.step).unwrap();
    let sc = rod.scales;
    let problem = OptimalControlProblem {
        initial: State::at_rest(rod.rest.clone()),
        grid, control,
        force: Channel { scale: sc.force, bound: Some(Bound::Norm(20.0)) },
        moment: Channel { scale: sc.moment, bound: Some(Bound::Norm(5.0)) },
        target: TipTarget { position: Some(Vector3::new(0.5, 0.0, 0.8)), rotation: None, at_rest: true, enforcement: Enforcement::Hard },
        effort: 1.0, rate: 0.0, rod,
    };
    let t = std::time::Instant::now();
    let (start, used) = first_point(&problem, guess).unwrap();
    println!("guess {used:?} {:?}", t.elapsed());
    let program = Transcription::new(&problem, std::env::var("NT").map_or(2, |s| s.parse().unwrap()));
    let outcome = solve(&program, start, &SqpSettings { hessian: hess, max_iterations: 150, ..Default::default() }, &mut |r| {
        println!("{:3} J {:.6e} stat {:.2e} feas {:.2e} comp {:.2e} theta {:.2e} a {:.3} {:?} soc {} {} tr {:.1e} w {:.1e} slack {:.1e} qp {} t {:.3}", r.iteration, r.objective, r.residual.stationarity, r.residual.feasibility, r.residual.complementarity, r.infeasibility, r.step_length, r.hessian, r.corrections, if r.restored {"R"} else {"L"}, r.trust_radius, r.elastic_weight, r.slack, r.qp_iterations, r.elapsed);
        ControlFlow::Continue(())
    });
    println!("{:?} {:?} {:?}", outcome.status, outcome.phases, outcome.multipliers.constraints);
}
