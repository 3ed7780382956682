//! The quantities of section 5: differences (87) to (90) between two models of one rod that are simulated side by side.

use softarm::mechanics::rotation::cay_inverse;
use softarm::mechanics::{Configuration, NodeWrenches, Rod, RodModel, StepError, Stepper};
use softarm::scene::Simulation;

/// The three sums of equation (86), J, for the interval from time node `k` on.
///
/// With the misprints of (86) repaired: the mass of an interior node is `ρA l`, the bending term has `ψ = l κ`, and a standard
/// rod's interior nodes have `ē = 1/2`, as (73) says, so that they keep their whole inertia.
struct DiscreteEnergy {
    /// `Σ m |x^{k+1} - x^k|²/(2h²)`
    translation: f64,
    /// `Σ c_q tr((F - I)ᵀ J_d (F - I))/(2h²) = Σ f·J f/(2h²α)`, with the inertia of the dilatation at `k`.
    rotation: f64,
    /// Elastic energy at time node `k`.
    elastic: f64,
}

impl DiscreteEnergy {
    /// Returns the energy of two configurations that follow each other after `h` seconds.
    fn of(rod: &Rod, before: &Configuration, after: &Configuration, h: f64) -> Self {
        let rotary = rod.rotary_at(&before.positions);
        let mut out = Self {
            translation: 0.0,
            rotation: 0.0,
            elastic: rod.elastic_energy(&before.positions, &before.rotations),
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

    fn total(&self) -> f64 {
        self.translation + self.rotation + self.elastic
    }

    /// Returns the sum with the kinetic energy as (86) is printed: `ρA` in the place of `ρA l`.
    fn as_printed(&self, element_length: f64) -> f64 {
        self.translation / element_length + self.rotation + self.elastic
    }
}

/// Returns the area of the section over that at rest, at dilatation `e`: `1/e` where the section keeps its volume (the paper's (14)).
pub fn section_area(model: RodModel, e: f64) -> f64 {
    match model {
        RodModel::Standard => 1.0,
        RodModel::Dilatation | RodModel::Consistent => 1.0 / e,
    }
}

/// An extreme value with its element and time, s.
#[derive(Clone, Copy)]
pub struct Extreme {
    pub value: f64,
    pub element: usize,
    pub time: f64,
}

/// Two models of one rod over a whole experiment.
pub struct Comparison {
    /// Least dilatation of the modified rod.
    pub dilatation_min: Extreme,
    /// Greatest dilatation of the modified rod.
    pub dilatation_max: Extreme,
    /// Least and greatest dilatation of the standard rod.
    pub standard_dilatation: [f64; 2],
    /// Greatest `|L_m - L_s|/L₀`, (88).
    pub length_error: f64,
    /// Greatest `|V_m - V_s|/V₀` of any element, (89).
    pub volume_error: f64,
    /// Greatest `|H_m - H_s|`, J, (87).
    pub energy_error: f64,
    /// The same with (86) as printed, J.
    pub energy_error_as_printed: f64,
    /// Greatest distance between the free ends (of a free rod: the bases) of the two, m.
    pub deflection_error: f64,
    /// That distance when the loads end, m.
    pub deflection_error_unloaded: f64,
    /// Range of the modified rod's energy after the loads have ended, J.
    pub energy_unloaded: [f64; 2],
}

impl Comparison {
    /// Runs a standard and a modified rod on the same time grid; their loads end at `unloaded`, s.
    pub fn run(
        standard: &Simulation,
        modified: &Simulation,
        unloaded: f64,
    ) -> Result<Self, StepError> {
        const NO_RANGE: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];
        let [least, greatest] = NO_RANGE.map(|value| Extreme {
            value,
            element: 0,
            time: 0.0,
        });
        let mut out = Self {
            dilatation_min: least,
            dilatation_max: greatest,
            standard_dilatation: NO_RANGE,
            length_error: 0.0,
            volume_error: 0.0,
            energy_error: 0.0,
            energy_error_as_printed: 0.0,
            deflection_error: 0.0,
            deflection_error_unloaded: f64::NAN,
            energy_unloaded: NO_RANGE,
        };
        let (grid, element_length) = (standard.grid, standard.rod.elements[0].length);
        let unloaded = (unloaded / grid.step).round() as usize;
        let rods = [&standard.rod, &modified.rod];
        let mut now =
            [standard, modified].map(|simulation| simulation.initial.configuration.clone());
        let mut integrators = [standard, modified]
            .map(|simulation| Stepper::new(&simulation.rod, grid.step, simulation.initial.clone()));
        for k in 0..=grid.n_steps {
            out.observe(rods, &now, grid.time(k), k == unloaded);
            if k == grid.n_steps {
                break;
            }
            for integrator in &mut integrators {
                integrator.advance([NodeWrenches::NONE; 2])?;
            }
            let after = [0, 1].map(|i| integrators[i].state().configuration);
            let [h_s, h_m] =
                [0, 1].map(|i| DiscreteEnergy::of(rods[i], &now[i], &after[i], grid.step));
            widen(&mut out.energy_error, h_m.total() - h_s.total());
            widen(
                &mut out.energy_error_as_printed,
                h_m.as_printed(element_length) - h_s.as_printed(element_length),
            );
            if k >= unloaded {
                include(&mut out.energy_unloaded, h_m.total());
            }
            now = after;
        }
        Ok(out)
    }

    fn observe(&mut self, rods: [&Rod; 2], now: &[Configuration; 2], time: f64, unloaded: bool) {
        let [e_s, e_m] = [0, 1].map(|i| rods[i].dilatation(&now[i].positions));
        for (element, (&e_s, &value)) in e_s.iter().zip(&e_m).enumerate() {
            let here = Extreme {
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
            include(&mut self.standard_dilatation, e_s);
            let [v_s, v_m] =
                [(rods[0], e_s), (rods[1], value)].map(|(rod, e)| section_area(rod.model, e) * e);
            widen(&mut self.volume_error, v_m - v_s);
        }
        let [length_s, length_m] = [&e_s, &e_m].map(|e| e.iter().sum::<f64>() / e.len() as f64);
        widen(&mut self.length_error, length_m - length_s);
        let end = match rods[0].first_free_node() {
            0 => 0,
            _ => rods[0].tip(),
        };
        let distance = (now[1].positions[end] - now[0].positions[end]).norm();
        widen(&mut self.deflection_error, distance);
        if unloaded {
            self.deflection_error_unloaded = distance;
        }
    }
}

/// Sets `greatest` to `|value|` if that is more, or no number.
fn widen(greatest: &mut f64, value: f64) {
    if !(value.abs() <= *greatest) {
        *greatest = value.abs();
    }
}

/// Widens a range until it has `value` in it.
fn include([least, greatest]: &mut [f64; 2], value: f64) {
    *least = least.min(value);
    *greatest = greatest.max(value);
}
