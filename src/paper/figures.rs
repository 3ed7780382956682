//! The numbers that section 5 prints, each beside the recomputed one.

use super::comparison::Comparison;
use super::{PaperError, Study};
use crate::mechanics::RodModel;

/// The three experiments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Experiment {
    /// Section 5.1.
    FlyingBeam,
    /// Section 5.2.
    Stretching,
    /// Section 5.3.
    BendingStretching,
}

impl Experiment {
    /// In the paper's order.
    pub const ALL: [Self; 3] = [Self::FlyingBeam, Self::Stretching, Self::BendingStretching];

    /// Its section in the paper.
    #[must_use]
    pub fn section(self) -> &'static str {
        match self {
            Self::FlyingBeam => "5.1",
            Self::Stretching => "5.2",
            Self::BendingStretching => "5.3",
        }
    }

    /// Its built-in scene.
    #[must_use]
    pub fn scene(self) -> &'static str {
        match self {
            Self::FlyingBeam => "paper-flying-beam",
            Self::Stretching => "paper-stretching",
            Self::BendingStretching => "paper-bending-stretching",
        }
    }

    /// Time from which on nothing acts any more, s.
    #[must_use]
    pub fn unloaded(self) -> f64 {
        match self {
            Self::FlyingBeam | Self::Stretching => 5.0,
            Self::BendingStretching => 10.0,
        }
    }
}

/// A quantity that the paper prints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Quantity {
    DilatationMin,
    DilatationMax,
    Deflection,
    Length,
    Volume,
    Energy,
}

impl Quantity {
    /// Name, unit and equation.
    fn label(self) -> (&'static str, &'static str) {
        match self {
            Self::DilatationMin => ("least dilatation", "(58)"),
            Self::DilatationMax => ("greatest dilatation", "(58)"),
            Self::Deflection => ("deflection error of the base, m", "section 5.1"),
            Self::Length => ("ΔL_max", "(88)"),
            Self::Volume => ("ΔV_max", "(89)"),
            Self::Energy => ("ΔH_max, J", "(87)"),
        }
    }

    fn of(self, comparison: &Comparison) -> f64 {
        match self {
            Self::DilatationMin => comparison.dilatation_min.value,
            Self::DilatationMax => comparison.dilatation_max.value,
            Self::Deflection => comparison.deflection_error,
            Self::Length => comparison.length_error,
            Self::Volume => comparison.volume_error,
            Self::Energy => comparison.energy_error,
        }
    }
}

/// Whether equations, data and printed number belong together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Standing {
    /// They do.
    Sound,
    /// The number does not follow from the paper's own equations and data as far as they can be told.
    Doubtful,
}

/// What the paper prints, in the order of the sections.
const PRINTED: [(Experiment, Quantity, &str, Standing); 13] = {
    use Experiment::{BendingStretching, FlyingBeam, Stretching};
    use Quantity::{Deflection, DilatationMax, DilatationMin, Energy, Length, Volume};
    use Standing::{Doubtful, Sound};
    [
        (FlyingBeam, DilatationMin, "0.9993", Doubtful),
        (FlyingBeam, DilatationMax, "1.0059", Doubtful),
        (FlyingBeam, Deflection, "0.0053", Doubtful),
        (FlyingBeam, Energy, "1.955", Doubtful),
        (Stretching, DilatationMin, "0.9920", Sound),
        (Stretching, DilatationMax, "1.1408", Sound),
        (Stretching, Length, "0.02070", Sound),
        (Stretching, Volume, "0.1247", Sound),
        (Stretching, Energy, "148.77", Sound),
        (BendingStretching, DilatationMin, "0.9688", Doubtful),
        (BendingStretching, DilatationMax, "1.1207", Sound),
        (BendingStretching, Length, "0.0182", Sound),
        (BendingStretching, Volume, "0.1073", Sound),
    ]
};

/// One printed number beside its recomputed one.
#[derive(Clone, Debug)]
pub struct Figure {
    /// The experiment.
    pub experiment: Experiment,
    /// What it is, and its unit.
    pub quantity: &'static str,
    /// Where the paper defines it.
    pub equation: &'static str,
    /// As printed.
    pub paper: &'static str,
    /// As computed.
    pub ours: f64,
    /// Whether the paper's equations and data, as far as they can be told, give the printed number.
    pub reproducible: bool,
    /// What was measured about a difference; empty without one.
    pub remark: String,
}

impl Figure {
    /// Digits after the point of the printed number.
    #[must_use]
    pub fn decimals(&self) -> usize {
        self.paper.split_once('.').map_or(0, |(_, d)| d.len())
    }

    /// Ours, rounded like the printed number.
    #[must_use]
    pub fn rounded(&self) -> String {
        format!("{:.*}", self.decimals(), self.ours)
    }

    /// Whether all printed digits agree.
    #[must_use]
    pub fn reproduced(&self) -> bool {
        self.rounded() == self.paper
    }

    /// Ours less the paper's.
    #[must_use]
    pub fn difference(&self) -> f64 {
        self.ours - self.paper.parse::<f64>().unwrap_or(f64::NAN)
    }
}

/// A run of an experiment with something other than in the paper.
#[derive(Clone, Debug)]
pub struct Reading {
    /// The experiment.
    pub experiment: Experiment,
    /// What is other.
    pub name: &'static str,
    /// Its quantities against the standard model under the same change, or why there are none.
    pub result: Result<Comparison, String>,
}

/// What each experiment is run with: name, model, further overrides. The first is the paper's.
const READINGS: [(Experiment, &str, RodModel, &[&str]); 9] = {
    use Experiment::{BendingStretching, FlyingBeam, Stretching};
    use RodModel::{Consistent, Dilatation};
    const HELICAL: &[&str] = &["rod.strain=helical"];
    [
        (FlyingBeam, AS_PRINTED, Dilatation, &[]),
        (FlyingBeam, "consistent", Consistent, &[]),
        (FlyingBeam, BODY_MOMENTS, Dilatation, &["load.1.frame=body"]),
        (Stretching, AS_PRINTED, Dilatation, &[]),
        (Stretching, "consistent", Consistent, &[]),
        (BendingStretching, AS_PRINTED, Dilatation, &[]),
        (BendingStretching, "consistent", Consistent, &[]),
        (BendingStretching, "helical", Dilatation, HELICAL),
        (
            BendingStretching,
            "helical, consistent",
            Consistent,
            HELICAL,
        ),
    ]
};

const AS_PRINTED: &str = "as printed";
const BODY_MOMENTS: &str = "body moments";

/// All printed numbers, and the readings they were computed from.
///
/// # Errors
/// Where one of the paper's own runs is not possible; other readings report their failure themselves.
pub fn figures(study: &Study) -> Result<(Vec<Figure>, Vec<Reading>), PaperError> {
    let results = study.map(&READINGS, |&(experiment, _, model, overrides)| {
        let simulation = |model: RodModel| {
            let mut all: Vec<String> = overrides.iter().map(|text| text.to_string()).collect();
            all.push(format!("rod.model={}", model.name()));
            study.simulation(experiment.scene(), &all)
        };
        let (standard, modified) = (simulation(RodModel::Standard)?, simulation(model)?);
        Comparison::run(&standard, &modified, experiment.unloaded()).map_err(|error| {
            PaperError::Step {
                scene: experiment.scene(),
                error,
            }
        })
    });
    let mut readings = Vec::with_capacity(READINGS.len());
    for ((experiment, name, ..), result) in READINGS.into_iter().zip(results) {
        let result = match result {
            Err(error) if name == AS_PRINTED => return Err(error),
            other => other.map_err(|error| error.to_string()),
        };
        readings.push(Reading {
            experiment,
            name,
            result,
        });
    }
    let of = |experiment: Experiment, name: &str| {
        readings
            .iter()
            .find(|r| r.experiment == experiment && r.name == name)
            .and_then(|r| r.result.as_ref().ok())
    };
    let figures = PRINTED
        .into_iter()
        .filter_map(|(experiment, quantity, paper, standing)| {
            let comparison = of(experiment, AS_PRINTED)?;
            let (label, equation) = quantity.label();
            let mut figure = Figure {
                experiment,
                quantity: label,
                equation,
                paper,
                ours: quantity.of(comparison),
                reproducible: standing == Standing::Sound,
                remark: String::new(),
            };
            let other = of(experiment, BODY_MOMENTS);
            figure.remark = remark(&figure, quantity, comparison, other);
            Some(figure)
        })
        .collect();
    Ok((figures, readings))
}

/// What was measured about a difference.
fn remark(
    figure: &Figure,
    quantity: Quantity,
    ours: &Comparison,
    body_moments: Option<&Comparison>,
) -> String {
    use Experiment::{FlyingBeam, Stretching};
    let with_body_moments = |digits: usize| {
        body_moments.map_or(String::new(), |c| {
            format!("; with body moments {:.*}", digits, quantity.of(c))
        })
    };
    match (figure.experiment, quantity) {
        (FlyingBeam, Quantity::DilatationMin) => {
            let at = ours.dilatation_min;
            format!(
                "element {} at t = {:.2} s, where the end force alone presses it by {:.4}{}",
                at.element,
                at.time,
                FLYING_BEAM_PEAK_FORCE / AXIAL_STIFFNESS,
                with_body_moments(4)
            )
        }
        (FlyingBeam, Quantity::DilatationMax) => {
            let at = ours.dilatation_max;
            format!(
                "{:.6}, element {} at t = {:.2} s{}",
                at.value,
                at.element,
                at.time,
                with_body_moments(4)
            )
        }
        (FlyingBeam, Quantity::Deflection) => format!(
            "greatest over 15 s; at t = 5 s, where the loads end, it is {:.4}",
            ours.deflection_error_then
        ),
        (FlyingBeam, Quantity::Energy) => format!(
            "(86) corrected; as printed {:.3}{}",
            ours.energy_error_as_printed,
            with_body_moments(3)
        ),
        (Stretching, Quantity::Energy) => format!(
            "(86) corrected; as printed {:.2}",
            ours.energy_error_as_printed
        ),
        _ if !figure.reproduced() && exchanged(figure.paper, &figure.rounded()) => {
            "two digits of the printed number are exchanged".into()
        }
        _ => String::new(),
    }
}

/// Whether one number becomes the other when two of its digits change places.
fn exchanged(a: &str, b: &str) -> bool {
    let differing: Vec<_> = a.bytes().zip(b.bytes()).filter(|(x, y)| x != y).collect();
    a.len() == b.len() && matches!(differing[..], [(p, q), (r, s)] if (p, q) == (s, r))
}

const FLYING_BEAM_PEAK_FORCE: f64 = 20.0; // N, (91)
const AXIAL_STIFFNESS: f64 = 1e4; // N, section 5.1
