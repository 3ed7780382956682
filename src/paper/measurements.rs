//! The third experiment beyond its printed numbers: locking of the strain rule, and the breakdown of the model `dilatation` on fine grids.

use super::{PaperError, Study};
use crate::mechanics::{NodeWrenches, RodModel, StepError, Stepper, StrainRule};

const SCENE: &str = "paper-bending-stretching";

/// Where the tip of the third experiment's rod is.
#[derive(Clone, Debug)]
pub struct Tip {
    /// Strain rule.
    pub strain: &'static str,
    /// Number of elements.
    pub elements: usize,
    /// `1 + GA l²/(4 EI)` under the trapezoidal rule, else 1: by how much bending is too stiff.
    pub stiffening: f64,
    /// Position of the tip, m.
    pub position: [f64; 3],
}

/// The tip of the third experiment at `time` (s), standard model, for every strain rule and number of elements.
///
/// # Errors
/// A scene or a step that is not possible.
pub fn tip_at(
    study: &Study,
    time: f64,
    grids: &[(StrainRule, usize)],
) -> Result<Vec<Tip>, PaperError> {
    study
        .map(grids, |&(strain, elements)| {
            let mut posed = study.posed(SCENE)?;
            posed.arm.model = RodModel::Standard;
            posed.discretization.strain_rule = strain;
            posed.discretization.elements = elements;
            posed.end = time;
            let (rod, grid, start) = posed.discretize()?;
            let mut integrator = Stepper::new(&rod, grid.step, start);
            for _ in 0..grid.n_steps {
                advance(&mut integrator)?;
            }
            Ok(Tip {
                strain: strain.name(),
                elements,
                stiffening: if strain == StrainRule::Trapezoidal {
                    1.0 + rod.locking_ratio()
                } else {
                    1.0
                },
                position: integrator.state().configuration.positions[rod.tip()].into(),
            })
        })
        .into_iter()
        .collect()
}

/// How the third experiment goes on a finer grid.
#[derive(Clone, Debug)]
pub struct BlowUp {
    /// Model of the rod.
    pub model: RodModel,
    /// Number of elements.
    pub elements: usize,
    /// Time step, s.
    pub step: f64,
    /// Greatest energy after the loads have ended, over that at their end.
    pub growth: f64,
    /// Where and why the run ended before its time.
    pub failure: Option<StepError>,
}

impl BlowUp {
    /// Time of the failure, s.
    #[must_use]
    pub fn time(&self) -> Option<f64> {
        self.failure.as_ref().and_then(|error| match error {
            StepError::RotationTooLarge { time, .. }
            | StepError::BaseTurnTooLarge { time, .. }
            | StepError::ElementCollapsed { time, .. }
            | StepError::ElementFolded { time, .. }
            | StepError::NotConverged { time, .. }
            | StepError::NotFinite { time, .. } => Some(*time),
            StepError::Stopped(_) => None,
        })
    }
}

/// Steps between two looks at the energy.
const GLANCE: usize = 20;

/// The third experiment to its end, or to its breakdown, for every model, number of elements and time step (s).
///
/// # Errors
/// A scene that is not possible; a breakdown is a result.
pub fn blow_up(study: &Study, runs: &[(RodModel, usize, f64)]) -> Result<Vec<BlowUp>, PaperError> {
    study
        .map(runs, |&(model, elements, step)| {
            let mut posed = study.posed(SCENE)?;
            posed.arm.model = model;
            posed.discretization.elements = elements;
            posed.discretization.step = Some(step);
            let (rod, grid, start) = posed.discretize()?;
            let rod = &rod;
            let mut integrator = Stepper::new(rod, grid.step, start);
            let unloaded = super::Experiment::BendingStretching.unloaded();
            let mut energies = Vec::new();
            let mut failure = None;
            for k in 0..grid.n_steps {
                if k % GLANCE == 0 && grid.time(k) >= unloaded {
                    energies.push(crate::mechanics::Energy::of(rod, &integrator.state()).total());
                }
                failure = integrator.advance([NodeWrenches::NONE; 2]).err();
                if failure.is_some() {
                    break;
                }
            }
            Ok(BlowUp {
                model,
                elements,
                step: grid.step,
                growth: energies.iter().copied().fold(0.0, f64::max)
                    / energies.first().copied().unwrap_or(f64::NAN),
                failure,
            })
        })
        .into_iter()
        .collect()
}

fn advance(integrator: &mut Stepper) -> Result<(), PaperError> {
    integrator
        .advance([NodeWrenches::NONE; 2])
        .map_err(|error| PaperError::Step {
            scene: SCENE,
            error,
        })
}
