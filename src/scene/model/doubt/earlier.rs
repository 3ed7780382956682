//! Margins of a loop from earlier runs of it.
//!
//! A run leaves a limit by the residual `e = excess + margin` of what its plans aimed at. With the root mean square `s` of the positive part of the
//! residuals of each limit, the score of a run is `c = max e/s` over the limits, and the margins are `γ s` with the smallest `γ` that no more than
//! `⌊ε(n+1)⌋ - 1` of `n` scores exceed: if a further run is of the same kind as these, its score is at most `γ` with a probability of `1 - ε`
//! (split conformal prediction; Vovk, Gammerman and Shafer 2005).

use serde::Deserialize;

use super::super::Scene;
use crate::control::PathEnforcement;
use crate::output::read_regular;
use crate::scene::{SceneError, SceneSource};
use crate::verify::doubt::Margins;

/// Largest summary, bytes.
const LARGEST: u64 = 16 << 20;

/// A summary, as far as margins follow from it.
#[derive(Deserialize)]
struct Run {
    /// End of the run, in a word; absent in a file of one's own.
    status: Option<String>,
    limits: Vec<Peak>,
}

#[derive(Deserialize)]
struct Peak {
    name: String,
    excess: f64,
    #[serde(default)]
    margin: f64,
}

impl Scene {
    /// Replaces earlier runs by the margins that follow from them.
    pub(in crate::scene) fn read_earlier_runs(
        &mut self,
        source: &SceneSource,
    ) -> Result<(), SceneError> {
        let names: Vec<(String, bool)> = (self.limits().into_iter())
            .map(|limit| (limit.name, limit.enforcement == PathEnforcement::Hard))
            .collect();
        let Some(doubt) = &mut self.doubt else {
            return Ok(());
        };
        let Some(runs) = doubt.runs.take() else {
            return Ok(());
        };
        let refuse = |key: &str, message: String, help: &str| {
            Err(source.error_at(key, message, Some(help.into())))
        };
        if self.mpc.is_none() {
            let help = "a solve takes its margins from the numbers in doubt";
            return refuse("doubt.runs", "runs are those of a closed loop".into(), help);
        }
        if doubt.margins.is_some() {
            let help = "leave one out";
            let message = "runs and margins are two places of the same numbers".into();
            return refuse("doubt.margins", message, help);
        }
        let Some(share) = doubt.share else {
            let help = "give doubt.share: the part of further runs that may leave a limit";
            return refuse("doubt.runs", "a share is missing".into(), help);
        };
        let Some(most) = Margins::most_violating(share, runs.len()) else {
            let message = format!("{} runs cannot tell a share of {share}", runs.len());
            let help = format!("give at least {:.0}", (1.0 / share).ceil() - 1.0);
            return refuse("doubt.runs", message, &help);
        };
        let mut residuals = Vec::with_capacity(runs.len());
        let mut known = Vec::with_capacity(runs.len());
        for (index, run) in runs.iter().enumerate() {
            let place = source.beside(run);
            let place = place.canonicalize().unwrap_or(place);
            if known.contains(&place) {
                let help = "each further run needs to be a run of its own";
                let message = format!("{run} is there twice");
                return refuse(&format!("doubt.runs.{index}"), message, help);
            }
            known.push(place);
            let own = residuals_of(run, source, &names).map_err(|(message, help)| {
                source.error_at(&format!("doubt.runs.{index}"), message, Some(help))
            })?;
            residuals.push(own);
        }
        match margins(&residuals, most, names.len()) {
            Some(margins) => doubt.margins = Some(margins),
            None => {
                let message = format!("more than {most} of the runs broke down");
                return refuse(
                    "doubt.runs",
                    message,
                    "no margin helps an arm that breaks down",
                );
            }
        }
        Ok(())
    }
}

/// Returns the residuals of the limits of a run, 0 for soft ones; `None` of one that broke down.
fn residuals_of(
    run: &str,
    source: &SceneSource,
    names: &[(String, bool)],
) -> Result<Option<Vec<f64>>, (String, String)> {
    let mut path = source.beside(run);
    if path.is_dir() {
        path = path.join("summary.json");
    }
    let help = "a run is a result directory of softarm mpc, or a file with `limits`, each with name, excess and margin, as its summary.json";
    let at = |words: String| (format!("{}: {words}", path.display()), help.to_string());
    let bytes = read_regular(&path, LARGEST).map_err(|error| at(error.to_string()))?;
    let found: Run = serde_json::from_slice(&bytes).map_err(|error| at(error.to_string()))?;
    match found.status.as_deref() {
        None | Some("completed") => {}
        Some("failed") => return Ok(None),
        Some(other) => return Err(at(format!("the run is {other}, not completed"))),
    }
    let known: Vec<&str> = found.limits.iter().map(|own| &own.name[..]).collect();
    if known != names.iter().map(|(name, _)| &name[..]).collect::<Vec<_>>() {
        let own: Vec<&str> = names.iter().map(|(name, _)| &name[..]).collect();
        let words = format!(
            "limits [{}], and the scene has [{}]",
            known.join(", "),
            own.join(", ")
        );
        return Err(at(words));
    }
    let residual = |(peak, (_, is_hard)): (&Peak, &(String, bool))| match is_hard {
        true => peak.excess + peak.margin,
        false => 0.0,
    };
    let out: Vec<f64> = found.limits.iter().zip(names).map(residual).collect();
    match out.iter().all(|own| own.is_finite()) {
        true => Ok(Some(out)),
        false => Err(at("an excess is not a finite number".into())),
    }
}

/// Returns the margins of so many limits from the residuals of runs, of which `most` may have a larger score; `None` if more than these broke down.
fn margins(runs: &[Option<Vec<f64>>], most: usize, n_limits: usize) -> Option<Vec<f64>> {
    let spread: Vec<f64> = (0..n_limits)
        .map(|limit| {
            let known = runs.iter().flatten();
            let squares = known.map(|own| own[limit].max(0.0).powi(2));
            (squares.sum::<f64>() / runs.len() as f64).sqrt()
        })
        .collect();
    let score = |own: &Vec<f64>| {
        (own.iter().zip(&spread).filter(|(_, s)| **s > 0.0))
            .map(|(e, s)| e / s)
            .fold(0.0, f64::max)
    };
    let mut scores: Vec<f64> = (runs.iter())
        .map(|own| own.as_ref().map_or(f64::INFINITY, score))
        .collect();
    scores.sort_by(f64::total_cmp);
    let factor = scores[runs.len() - 1 - most];
    (factor.is_finite()).then(|| spread.iter().map(|s| factor * s).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A part of at most `share` of further runs of the same kind needs more than the margins, in the mean over sets of runs: for residuals of two
    /// limits of which one has heavy tails, and of which one run in twenty breaks down.
    #[test]
    fn a_share_of_further_runs_needs_more() {
        let mut random = fastrand::Rng::with_seed(7);
        let mut run = || {
            let [a, b, c] = [(); 3].map(|()| random.f64());
            (c > 0.05).then(|| vec![1e-3 * (a + b - 0.8), 0.2 * (b / (1.01 - a) - 0.5)])
        };
        for (n, share) in [(9, 0.1), (25, 0.2), (40, 0.1)] {
            let most = Margins::most_violating(share, n).unwrap();
            let (mut leaves, mut tried) = (0, 0);
            for _ in 0..4000 {
                let runs: Vec<_> = (0..n).map(|_| run()).collect();
                let further = run();
                // Without margins nothing is promised.
                let leaves_them = margins(&runs, most, 2).is_some_and(|margins| {
                    further.is_none_or(|own| own.iter().zip(&margins).any(|(e, m)| e > m))
                });
                tried += 1;
                leaves += usize::from(leaves_them);
            }
            let part = f64::from(leaves as u32) / f64::from(tried);
            // Three standard deviations of the count above the share.
            let room = 3.0 * (share * (1.0 - share) / f64::from(tried)).sqrt();
            assert!(part < share + room, "{n} {share}: {part}");
            assert!(part > 0.3 * share, "{n} {share}: {part}");
        }
    }
}
