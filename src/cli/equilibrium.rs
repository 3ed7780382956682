//! `softarm equilibrium SCENE [--out DIR]`: statics, stability, the load factor at which it is lost, and a sweep over the load factor.

use std::time::Instant;

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};

use super::console::Console;
use super::error::CliError;
use super::{Global, Outcome, SceneAndOut, exit, scene_name};
use crate::mechanics::equilibrium::EquilibriumError;
use crate::mechanics::{Kept, LoadPath, Loss, Varied};
use crate::output::quantity::{digits, entry, quantity};
use crate::output::{ResultKind, RunDirectory, json_value, render_report};
use crate::scene::{Scene, SceneSource};
use crate::solve::learned::beyond_learned;
use crate::solve::scene_check::warnings;
use crate::solve::{
    EquilibriumSummary, Statics, StaticsError, StaticsOptions, equilibrium_page, statics,
    sweep_record, write_tables,
};
use crate::stop::StopSignal;
use crate::task::{Arm, Discretization};
use crate::tradeoff::accurate_statics;

#[derive(Debug, Args)]
pub(super) struct EquilibriumArguments {
    #[command(flatten)]
    pub(super) scene: SceneAndOut,
    /// The sweep ends at this load factor, 1 at least
    #[arg(
        long,
        value_name = "FACTOR",
        default_value_t = 1.0,
        allow_negative_numbers = true
    )]
    to: f64,
    /// Load factors of the sweep, evenly spread from 0 to its end; 1 is always among them
    #[arg(long, value_name = "N", default_value_t = 21, value_parser = clap::value_parser!(u32).range(2..=10_000))]
    points: u32,
    /// Loads that the load factor multiplies
    #[arg(long, default_value = "all", value_parser = varied())]
    vary: Varied,
    /// Time at which loads with a profile and a driven base are evaluated, s
    #[arg(
        long,
        value_name = "S",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    time: f64,
    /// Constant force across the tip, or across the node that gives way most where the tip is held, divided by EI/L²: with it a symmetric arm
    /// buckles gradually, to the side of the force
    #[arg(
        long,
        value_name = "PART",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    imperfection: f64,
}

/// Reads a choice of [`Varied`] by its name.
fn varied() -> impl TypedValueParser<Value = Varied> {
    let choices = Varied::EACH.map(|one| PossibleValue::new(one.name()).help(one.words()));
    PossibleValuesParser::new(choices).map(|name| Varied::named(&name).unwrap_or_default())
}

impl EquilibriumArguments {
    fn options(&self) -> Result<StaticsOptions, CliError> {
        let refuse = |words: String| Err(CliError::Directory(words));
        if !(self.to >= 1.0 && self.to <= crate::mechanics::load_path::LARGEST_FACTOR) {
            return refuse(format!(
                "--to {}: the sweep ends at a load factor from 1 to {:e}; 1 are the loads of the scene",
                self.to,
                crate::mechanics::load_path::LARGEST_FACTOR
            ));
        }
        if !(self.time.is_finite() && self.time >= 0.0) {
            return refuse(format!("--time {}: a time from 0 s on", self.time));
        }
        if !(self.imperfection.is_finite() && self.imperfection.abs() <= 1.0) {
            return refuse(format!(
                "--imperfection {}: a multiple of EI/L\u{b2} from -1 to 1; 1e-3 is a small one",
                self.imperfection
            ));
        }
        Ok(StaticsOptions {
            varied: self.vary,
            to: self.to,
            points: self.points as usize,
            time: self.time,
            imperfection: self.imperfection,
        })
    }
}

pub(super) fn run(arguments: &EquilibriumArguments, global: &Global, console: &Console) -> Outcome {
    let began = Instant::now();
    console.catch_interrupts();
    let options = arguments.options()?;
    let (scene, source) = console.load(&arguments.scene.scene, global)?;
    let stop = console.stop_signal(scene.deadline(began));
    let target = arguments.scene.directory("equilibrium");
    let arm = scene.arm(&source)?;
    let directory = RunDirectory::open(&target, ResultKind::Equilibrium)?;
    let found = accurate(&scene, &source, &arm, &options, &stop);
    let (scene, found) = match found {
        Ok(found) => found,
        Err(error) => {
            directory.remove()?;
            return Err(error);
        }
    };
    let beyond = beyond_learned(&found.rod, std::iter::once(found.own.shape.poses()));
    for warning in warnings(&scene, &found.rod, f64::NAN)
        .into_iter()
        .chain(beyond)
    {
        console.warn(&warning);
    }
    if scene.task.is_some() || scene.control.is_some() {
        console.warn("[task] and [control] play no part in statics: `softarm check` computes the wrench that holds a target, and a [[load]] prescribes a wrench");
    }
    if arm.loads.iter().any(|load| !load.profile.is_empty()) {
        console.warn(&format!(
            "load: loads with a profile are those at t = {} s; --time names another instant",
            options.time
        ));
    }
    let wall = began.elapsed().as_secs_f64();
    let names = [
        scene_name(&arguments.scene.scene),
        target.display().to_string(),
    ];
    let summary = EquilibriumSummary::of(&found, &options, names, wall);
    let path = LoadPath::new(
        &found.rod,
        options.varied,
        options.time,
        found.aside.clone(),
        &stop,
    )
    .map_err(|error| refused(&scene, &source, error.into()))?;
    let record = sweep_record(&found, |factor| path.rod_at(factor), options.time);
    let written = directory.publish(|result| {
        result.write_text("scene.toml", &scene.to_toml())?;
        record.write_npz(&result.path().join("trajectory.npz"))?;
        write_tables(result, &found.rod, &found.own.shape, &summary)?;
        result.write_json("summary.json", &summary)?;
        let value = json_value(&summary);
        let page = equilibrium_page(&scene, &arm, &found.rod, &record, &value)?;
        result.write_text("report.html", &render_report(&page))
    })?;
    tell(&summary, &found, &options, console);
    console.say(&format!(
        "report: {}",
        written.join("report.html").display()
    ));
    console.summary(&summary);
    Ok(exit::DONE)
}

/// Returns the statics of a scene, and the scene with the elements for which they were computed: with an accuracy, as many as the tip
/// needs.
fn accurate(
    scene: &Scene,
    source: &SceneSource,
    arm: &Arm,
    options: &StaticsOptions,
    stop: &StopSignal,
) -> Result<(Scene, Statics), CliError> {
    let own = scene.discretization();
    let refused = |error| refused(scene, source, error);
    let Some(accuracy) = scene.accuracy() else {
        let found = statics(arm, &own, options, stop).map_err(refused)?;
        return Ok((scene.resolved(arm, &own), found));
    };
    let (elements, found) =
        accurate_statics(arm, &own, accuracy, options, stop).map_err(refused)?;
    let chosen = Discretization { elements, ..own };
    let scene = scene.with_grid(&Discretization {
        step: None,
        ..chosen
    });
    Ok((scene.resolved(arm, &chosen), found))
}

fn refused(scene: &Scene, source: &SceneSource, error: StaticsError) -> CliError {
    match error {
        StaticsError::Rod(error) => CliError::Scene(scene.discretize_error(source, error.into())),
        StaticsError::Equilibrium(EquilibriumError::Stopped(stop)) => CliError::Stopped(stop),
        StaticsError::Equilibrium(EquilibriumError::FreeBase) => CliError::Scene(source.error_at(
            "base.kind",
            EquilibriumError::FreeBase.to_string(),
            None,
        )),
        StaticsError::Equilibrium(error) => CliError::Statics(error),
    }
}

/// Prints the findings in a few lines.
fn tell(
    summary: &EquilibriumSummary,
    found: &Statics,
    options: &StaticsOptions,
    console: &Console,
) {
    let say = |word: &str, text: &str| console.say(&entry(word, text));
    let error = summary.refined_space_m.map_or_else(
        || "twice the elements have another equilibrium or none".to_string(),
        |error| format!("elements put a node up to {} off", quantity(error, "m")),
    );
    say(
        "tip",
        &format!(
            "{}, {} from where it is unloaded; {error}",
            place_in_words(summary.tip.position_m),
            quantity(summary.tip_displacement_m, "m")
        ),
    );
    let norm = |v: [f64; 3]| nalgebra::Vector3::from(v).norm();
    say(
        "base",
        &format!(
            "holds the arm with {} and {}",
            quantity(norm(summary.base.force_n), "N"),
            quantity(norm(summary.base.moment_n_m), "N m")
        ),
    );
    if let Some(tip) = &summary.tip_reaction {
        say(
            "",
            &format!(
                "and its tip is held with {} and {}",
                quantity(norm(tip.force_n), "N"),
                quantity(norm(tip.moment_n_m), "N m")
            ),
        );
    }
    say("rests", &stability_in_words(summary));
    if let Some(place) = summary.goes_to_m {
        let place = place_in_words(place);
        say(
            "",
            &match summary.goes_to_node {
                Some(node) if node != found.rod.tip() => {
                    format!("pushed a little, its node {node} goes to {place}")
                }
                _ => format!("pushed a little, its tip goes to {place}"),
            },
        );
    }
    if summary.left_saddles > 0 {
        say(
            "",
            &format!(
                "unstable equilibria that it left on its way here: {}, each to a side of less energy; of two equal sides it took the one along the \
                 base's first axis",
                summary.left_saddles
            ),
        );
    }
    let buckling = &summary.buckling;
    say("loads", &buckling_in_words(summary, options));
    if buckling.from_factor > 0.0 {
        say(
            "",
            "between its ends the arm may have several stable shapes; of those that it found this one has the least energy",
        );
    }
    if let Some(jump) = found.sweep.iter().find(|point| point.jumped) {
        console.warn(&format!(
            "at load factor {} the sweep continues on another equilibrium, because the {} factor",
            digits(jump.factor),
            if jump.factor < buckling.from_factor {
                "next one ends at a larger"
            } else {
                "previous one ends at a smaller"
            }
        ));
    }
    if let Some(cut) = &summary.sweep_cut {
        console.warn(&format!(
            "the sweep ends at load factor {}: {cut}",
            digits(summary.sweep.last().map_or(0.0, |point| point.factor))
        ));
    }
}

fn place_in_words(x: [f64; 3]) -> String {
    let [x, y, z] = x.map(digits);
    format!("[{x}, {y}, {z}] m")
}

fn stability_in_words(summary: &EquilibriumSummary) -> String {
    let stability = &summary.stability;
    match (stability.growth_rate_1_s, stability.first_frequency_hz) {
        (Some(rate), _) => format!(
            "UNSTABLE: deviations grow e-fold in {}{}",
            quantity(rate.recip(), "s"),
            (stability.why).map_or_else(String::new, |why| format!("; {why}"))
        ),
        (None, Some(frequency)) => format!(
            "stable: sways at {}{}",
            quantity(frequency, "Hz"),
            stability
                .tip_stiffness_n_m
                .map_or_else(String::new, |stiffness| format!(
                    ", and the tip gives way by {} per newton at most",
                    quantity(stiffness.recip(), "m")
                ))
        ),
        (None, None) => "neutral: nothing brings the arm back, and nothing grows".to_string(),
    }
}

fn buckling_in_words(summary: &EquilibriumSummary, options: &StaticsOptions) -> String {
    let buckling = &summary.buckling;
    match (buckling.factor, buckling.how, buckling.why) {
        (Some(factor), how, _) => format!(
            "at load factor {} it {} ({} vary)",
            digits(factor),
            match how {
                Some(Loss::Snapping) => "snaps through",
                Some(Loss::Flutter) => "flutters",
                Some(Loss::Buckling) | None => "buckles",
            },
            options.varied.words()
        ),
        (None, _, Some(Kept::Unloaded)) => "nothing loads the arm".to_string(),
        (None, _, why) => format!(
            "stable {}up to load factor {}{}",
            match buckling.from_factor {
                0.0 => String::new(),
                from => format!("from load factor {} ", digits(from)),
            },
            digits(buckling.stable_up_to.unwrap_or(0.0)),
            match why {
                Some(Kept::OutOfRange) => ", where elements leave the range of rod models",
                Some(Kept::NotFollowed) => ", beyond which no equilibrium was found",
                _ => "",
            }
        ),
    }
}
