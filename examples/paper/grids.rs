//! The third experiment on other grids: locking of the strain rule, and the breakdown of the model `dilatation` on fine grids.

use nalgebra::Vector3;
use softarm::mechanics::{Energy, RodModel, StrainRule};

use super::study::{BENDING_STRETCHING, Outcome, Study, run};

/// The tip of the standard rod.
pub struct Tip {
    /// Factor by which bending is too stiff: `1 + GA l²/(4 EI)` under the trapezoidal rule, else 1.
    pub stiffening: f64,
    /// Position, m.
    pub position: Vector3<f64>,
}

/// Returns the tip at `time`, s.
pub fn tip_at(study: &Study, time: f64, strain: StrainRule, elements: usize) -> Outcome<Tip> {
    let own = [
        format!("rod.strain={}", strain.name()),
        format!("rod.elements={elements}"),
        format!("time.end_s={time}"),
    ];
    let simulation = study.simulation(BENDING_STRETCHING.scene, RodModel::Standard, &own)?;
    let mut position = Vector3::zeros();
    run(&simulation, |_, state| {
        position = state.configuration.positions[simulation.rod.tip()];
    })?;
    let stiffening = match strain {
        StrainRule::Trapezoidal => 1.0 + simulation.rod.locking_ratio(),
        StrainRule::Helical => 1.0,
    };
    Ok(Tip {
        stiffening,
        position,
    })
}

/// The energy of the unloaded rod.
pub struct Growth {
    /// Greatest energy after the loads have ended, over that at their end.
    pub ratio: f64,
    /// Time at which the motion broke down, s.
    pub breakdown: Option<f64>,
}

/// Steps between two looks at the energy.
const GLANCE: usize = 20;

/// Runs the experiment with a step (s) to its end or its breakdown, which is a result.
pub fn growth(study: &Study, model: RodModel, elements: usize, step: f64) -> Outcome<Growth> {
    let own = [
        format!("rod.elements={elements}"),
        format!("time.step_s={step}"),
    ];
    let simulation = study.simulation(BENDING_STRETCHING.scene, model, &own)?;
    let (mut time, mut energies) = (0.0, Vec::new());
    let outcome = run(&simulation, |k, state| {
        time = simulation.grid.time(k);
        if k % GLANCE == 0 && time >= BENDING_STRETCHING.unloaded {
            energies.push(Energy::of(&simulation.rod, state).total());
        }
    });
    Ok(Growth {
        ratio: energies.iter().copied().fold(0.0, f64::max)
            / energies.first().copied().unwrap_or(f64::NAN),
        breakdown: outcome.is_err().then_some(time),
    })
}
