//! The quantities of section 5: differences (87) to (90) between two models of one rod that are simulated side by side.

use nalgebra::Vector3;

use crate::mechanics::rotation::cay_inverse;
use crate::mechanics::{Configuration, NodeWrenches, Rod, RodModel, StepError, Stepper};
use crate::scene::Simulation;

/// The three sums of equation (86), J, for the interval from time node `k` on.
///
/// With the misprints of (86) repaired: the mass of an interior node is `ρA l`, the bending term has `ψ = l κ`, and a standard
/// rod's interior nodes have `ē = 1/2`, as (73) says, so that they keep their whole inertia.
#[derive(Clone, Copy, Debug, Default)]
pub struct DiscreteEnergy {
    /// `Σ m |x^{k+1} - x^k|²/(2h²)`
    pub translation: f64,
    /// `Σ c_q tr((F - I)ᵀ J_d (F - I))/(2h²) = Σ f·J f/(2h²α)`, with the inertia of the dilatation at `k`.
    pub rotation: f64,
    /// Elastic energy at time node `k`.
    pub elastic: f64,
}

impl DiscreteEnergy {
    /// Of two configurations that follow each other after `h` seconds.
    #[must_use]
    pub fn of(rod: &Rod, before: &Configuration, after: &Configuration, h: f64) -> Self {
        let rotary = rod.rotary_at(&before.positions);
        let mut out = Self {
            elastic: rod.elastic_energy(&before.positions, &before.rotations),
            ..Self::default()
        };
        for q in rod.first_free_node()..rod.n_nodes() {
            let velocity = (after.positions[q] - before.positions[q]) / h;
            out.translation += 0.5 * rod.nodes[q].mass * velocity.norm_squared();
            let f = cay_inverse(&before.rotations[q].tr_mul(&after.rotations[q]));
            out.rotation += 0.5 * f.dot(&rotary[q].component_mul(&f))
                / (h * h * (1.0 + 0.25 * f.norm_squared()));
        }
        out
    }

    /// Their sum.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.translation + self.rotation + self.elastic
    }

    /// Their sum with the kinetic energy as (86) is printed: `ρA` in the place of `ρA l`.
    #[must_use]
    pub fn as_printed(&self, element_length: f64) -> f64 {
        self.translation / element_length + self.rotation + self.elastic
    }
}

/// Area of the section over that at rest, at dilatation `e`: `1/e` where the section keeps its volume (the paper's (14)).
#[must_use]
pub fn section_area(model: RodModel, e: f64) -> f64 {
    match model {
        RodModel::Standard => 1.0,
        RodModel::Dilatation | RodModel::Consistent => 1.0 / e,
    }
}

/// An extreme value, and where it was.
#[derive(Clone, Copy, Debug)]
pub struct Instant {
    /// The value.
    pub value: f64,
    /// Element.
    pub element: usize,
    /// Time, s.
    pub time: f64,
}

/// Two models of one rod over a whole experiment.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Least dilatation of the modified rod.
    pub dilatation_min: Instant,
    /// Its greatest dilatation.
    pub dilatation_max: Instant,
    /// Least and greatest dilatation of the standard rod.
    pub standard_dilatation: [f64; 2],
    /// Greatest `|L_m - L_s|/L₀`, (88).
    pub length_error: f64,
    /// Greatest `|V_m - V_s|/V₀` of any element, (89).
    pub volume_error: f64,
    /// Greatest `|H_m - H_s|`, J, (87).
    pub energy_error: f64,
    /// The same with (86) as printed, see [`DiscreteEnergy::as_printed`].
    pub energy_error_as_printed: f64,
    /// Greatest distance between the free ends (of a free rod: the bases) of the two, m.
    pub deflection_error: f64,
    /// That distance at the time asked for, m.
    pub deflection_error_then: f64,
    /// Range of the modified rod's energy from that time on, J.
    pub energy_then: [f64; 2],
}

impl Comparison {
    /// Runs a standard and a modified rod on the same time grid; `then` is a time to look at more closely, s.
    ///
    /// # Errors
    /// Where one of them breaks down.
    pub fn run(standard: &Simulation, modified: &Simulation, then: f64) -> Result<Self, StepError> {
        let grid = standard.grid;
        let mut rods = [Running::new(standard), Running::new(modified)];
        let nowhere = |value| Instant {
            value,
            element: 0,
            time: 0.0,
        };
        let mut out = Self {
            dilatation_min: nowhere(f64::INFINITY),
            dilatation_max: nowhere(f64::NEG_INFINITY),
            standard_dilatation: [f64::INFINITY, f64::NEG_INFINITY],
            length_error: 0.0,
            volume_error: 0.0,
            energy_error: 0.0,
            energy_error_as_printed: 0.0,
            deflection_error: 0.0,
            deflection_error_then: f64::NAN,
            energy_then: [f64::INFINITY, f64::NEG_INFINITY],
        };
        let then = (then / grid.step).round() as usize;
        for k in 0..=grid.n_steps {
            out.observe(&rods, grid.time(k), k == then);
            if k == grid.n_steps {
                break;
            }
            let [s, m] = &mut rods;
            let (h_s, h_m) = (s.advance()?, m.advance()?);
            let l = standard.rod.elements[0].length;
            widen(&mut out.energy_error, h_m.total() - h_s.total());
            widen(
                &mut out.energy_error_as_printed,
                h_m.as_printed(l) - h_s.as_printed(l),
            );
            if k >= then {
                out.energy_then[0] = out.energy_then[0].min(h_m.total());
                out.energy_then[1] = out.energy_then[1].max(h_m.total());
            }
        }
        Ok(out)
    }

    fn observe(&mut self, [standard, modified]: &[Running; 2], time: f64, then: bool) {
        let [e_s, e_m] = [standard, modified].map(|r| r.rod.dilatation(&r.positions()));
        for (element, &value) in e_m.iter().enumerate() {
            let here = Instant {
                value,
                element,
                time,
            };
            if value < self.dilatation_min.value {
                self.dilatation_min = here;
            }
            if value > self.dilatation_max.value {
                self.dilatation_max = here;
            }
        }
        for &e in &e_s {
            self.standard_dilatation[0] = self.standard_dilatation[0].min(e);
            self.standard_dilatation[1] = self.standard_dilatation[1].max(e);
        }
        let n = e_s.len() as f64;
        let mean_difference = (e_m.iter().sum::<f64>() - e_s.iter().sum::<f64>()) / n;
        widen(&mut self.length_error, mean_difference);
        for (e_m, e_s) in e_m.iter().zip(&e_s) {
            let [v_m, v_s] =
                [(modified, e_m), (standard, e_s)].map(|(r, &e)| section_area(r.rod.model, e) * e);
            widen(&mut self.volume_error, v_m - v_s);
        }
        let end = match standard.rod.first_free_node() {
            0 => 0,
            _ => standard.rod.tip(),
        };
        let distance = (modified.positions()[end] - standard.positions()[end]).norm();
        widen(&mut self.deflection_error, distance);
        if then {
            self.deflection_error_then = distance;
        }
    }
}

/// `greatest` becomes `|value|` if that is more, or no number.
fn widen(greatest: &mut f64, value: f64) {
    if !(value.abs() <= *greatest) {
        *greatest = value.abs();
    }
}

/// A rod on its way.
struct Running<'a> {
    rod: &'a Rod,
    step: f64,
    integrator: Stepper<'a>,
    before: Configuration,
}

impl<'a> Running<'a> {
    fn new(simulation: &'a Simulation) -> Self {
        let step = simulation.grid.step;
        Self {
            rod: &simulation.rod,
            step,
            integrator: Stepper::new(&simulation.rod, step, simulation.initial.clone()),
            before: simulation.initial.configuration.clone(),
        }
    }

    fn positions(&self) -> Vec<Vector3<f64>> {
        self.integrator.state().configuration.positions
    }

    /// One step; its discrete energy.
    fn advance(&mut self) -> Result<DiscreteEnergy, StepError> {
        let now = &self.integrator.state().configuration;
        self.before.positions.clone_from(&now.positions);
        self.before.rotations.clone_from(&now.rotations);
        self.integrator.advance([NodeWrenches::NONE; 2])?;
        let after = &self.integrator.state().configuration;
        Ok(DiscreteEnergy::of(self.rod, &self.before, after, self.step))
    }
}
