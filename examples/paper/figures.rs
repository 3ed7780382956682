//! The numbers that section 5 prints, each beside the recomputed one.

use softarm::mechanics::RodModel::{self, Consistent, Dilatation, Standard};

use super::comparison::Comparison;
use super::study::{BENDING_STRETCHING, Experiment, FLYING_BEAM, Outcome, STRETCHING, Study};

const AS_PRINTED: &str = "as printed";
const BODY_MOMENTS: &str = "body moments";

/// Runs of the experiments: name, model, and overrides of both models. The first of each experiment is the paper's.
pub const READINGS: [(Experiment, &str, RodModel, &[&str]); 9] = {
    const HELICAL: &[&str] = &["rod.strain=helical"];
    [
        (FLYING_BEAM, AS_PRINTED, Dilatation, &[]),
        (FLYING_BEAM, "consistent", Consistent, &[]),
        (
            FLYING_BEAM,
            BODY_MOMENTS,
            Dilatation,
            &["load.1.frame=body"],
        ),
        (STRETCHING, AS_PRINTED, Dilatation, &[]),
        (STRETCHING, "consistent", Consistent, &[]),
        (BENDING_STRETCHING, AS_PRINTED, Dilatation, &[]),
        (BENDING_STRETCHING, "consistent", Consistent, &[]),
        (BENDING_STRETCHING, "helical", Dilatation, HELICAL),
        (
            BENDING_STRETCHING,
            "helical, consistent",
            Consistent,
            HELICAL,
        ),
    ]
};

/// Compares every one of [`READINGS`] with the standard model.
pub fn readings(study: &Study) -> Outcome<Vec<Comparison>> {
    study.map(&READINGS, |&(experiment, _, model, overrides)| {
        let own: Vec<String> = overrides.iter().map(|text| text.to_string()).collect();
        let [standard, modified] =
            [Standard, model].map(|model| study.simulation(experiment.scene, model, &own));
        Ok(Comparison::run(
            &standard?,
            &modified?,
            experiment.unloaded,
        )?)
    })
}

/// A quantity that the paper prints.
#[derive(Clone, Copy)]
enum Quantity {
    DilatationMin,
    DilatationMax,
    Deflection,
    Length,
    Volume,
    Energy,
}

impl Quantity {
    /// Returns name with unit, equation, and value.
    fn of(self, comparison: &Comparison) -> (&'static str, &'static str, f64) {
        let c = comparison;
        match self {
            Self::DilatationMin => ("least dilatation", "(58)", c.dilatation_min.value),
            Self::DilatationMax => ("greatest dilatation", "(58)", c.dilatation_max.value),
            Self::Deflection => (
                "deflection error of the base, m",
                "section 5.1",
                c.deflection_error,
            ),
            Self::Length => ("ΔL_max", "(88)", c.length_error),
            Self::Volume => ("ΔV_max", "(89)", c.volume_error),
            Self::Energy => ("ΔH_max, J", "(87)", c.energy_error),
        }
    }
}

/// Tells whether a printed number follows from the paper's own equations and data as far as they can be told.
#[derive(Clone, Copy, PartialEq)]
enum Standing {
    Sound,
    Doubtful,
}

/// The printed numbers in the order of the sections.
const PRINTED: [(Experiment, Quantity, &str, Standing); 13] = {
    use Quantity::{Deflection, DilatationMax, DilatationMin, Energy, Length, Volume};
    use Standing::{Doubtful, Sound};
    [
        (FLYING_BEAM, DilatationMin, "0.9993", Doubtful),
        (FLYING_BEAM, DilatationMax, "1.0059", Doubtful),
        (FLYING_BEAM, Deflection, "0.0053", Doubtful),
        (FLYING_BEAM, Energy, "1.955", Doubtful),
        (STRETCHING, DilatationMin, "0.9920", Sound),
        (STRETCHING, DilatationMax, "1.1408", Sound),
        (STRETCHING, Length, "0.02070", Sound),
        (STRETCHING, Volume, "0.1247", Sound),
        (STRETCHING, Energy, "148.77", Sound),
        (BENDING_STRETCHING, DilatationMin, "0.9688", Doubtful),
        (BENDING_STRETCHING, DilatationMax, "1.1207", Sound),
        (BENDING_STRETCHING, Length, "0.0182", Sound),
        (BENDING_STRETCHING, Volume, "0.1073", Sound),
    ]
};

/// One printed number beside its recomputed one.
pub struct Figure {
    /// Section of the paper.
    pub section: &'static str,
    /// Name and unit.
    pub quantity: &'static str,
    /// Equation that defines it.
    pub equation: &'static str,
    /// Number as printed.
    pub paper: &'static str,
    /// Number as computed.
    pub ours: f64,
    /// Tells whether the paper's equations and data, as far as they can be told, give the printed number.
    pub reproducible: bool,
    /// What was measured about a difference; empty without one.
    pub remark: String,
}

impl Figure {
    /// Returns the number of digits after the point of the printed number.
    pub fn decimals(&self) -> usize {
        self.paper.split_once('.').map_or(0, |(_, d)| d.len())
    }

    /// Returns our number rounded like the printed one.
    pub fn rounded(&self) -> String {
        format!("{:.*}", self.decimals(), self.ours)
    }

    /// Tells whether all printed digits agree.
    pub fn reproduced(&self) -> bool {
        self.rounded() == self.paper
    }
}

/// Sets every printed number beside the one of these [`readings`].
pub fn figures(readings: &[Comparison]) -> Vec<Figure> {
    let reading = |experiment: Experiment, name: &str| {
        let is_it =
            |reading: &(Experiment, &str, _, _)| (reading.0, reading.1) == (experiment, name);
        &readings[READINGS
            .iter()
            .position(is_it)
            .expect("a name of the table")]
    };
    let figure = |(experiment, quantity, paper, standing): (Experiment, Quantity, _, _)| {
        let comparison = reading(experiment, AS_PRINTED);
        let (name, equation, ours) = quantity.of(comparison);
        let mut figure = Figure {
            section: experiment.section,
            quantity: name,
            equation,
            paper,
            ours,
            reproducible: standing == Standing::Sound,
            remark: String::new(),
        };
        let body_moments = quantity.of(reading(FLYING_BEAM, BODY_MOMENTS)).2;
        figure.remark = match (experiment, quantity) {
            (FLYING_BEAM, Quantity::DilatationMin) => {
                let at = comparison.dilatation_min;
                format!(
                    "element {} at t = {:.2} s, where the end force alone presses it by {:.4}; with body moments {body_moments:.4}",
                    at.element,
                    at.time,
                    FLYING_BEAM_PEAK_FORCE / AXIAL_STIFFNESS,
                )
            }
            (FLYING_BEAM, Quantity::DilatationMax) => {
                let at = comparison.dilatation_max;
                format!(
                    "{:.6}, element {} at t = {:.2} s; with body moments {body_moments:.4}",
                    at.value, at.element, at.time,
                )
            }
            (FLYING_BEAM, Quantity::Deflection) => format!(
                "greatest over 15 s; at t = 5 s, where the loads end, it is {:.4}",
                comparison.deflection_error_unloaded
            ),
            (FLYING_BEAM, Quantity::Energy) => format!(
                "(86) corrected; as printed {:.3}; with body moments {body_moments:.3}",
                comparison.energy_error_as_printed,
            ),
            (STRETCHING, Quantity::Energy) => format!(
                "(86) corrected; as printed {:.2}",
                comparison.energy_error_as_printed
            ),
            _ if exchanged(paper, &figure.rounded()) => {
                "two digits of the printed number are exchanged".into()
            }
            _ => String::new(),
        };
        figure
    };
    PRINTED.into_iter().map(figure).collect()
}

/// Tells whether one number becomes the other when two of its digits that differ change places.
fn exchanged(a: &str, b: &str) -> bool {
    let differing: Vec<_> = a.bytes().zip(b.bytes()).filter(|(x, y)| x != y).collect();
    a.len() == b.len() && matches!(differing[..], [(p, q), (r, s)] if (p, q) == (s, r))
}

const FLYING_BEAM_PEAK_FORCE: f64 = 20.0; // N, (91)
const AXIAL_STIFFNESS: f64 = 1e4; // N, section 5.1
