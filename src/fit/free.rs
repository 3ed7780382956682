//! The numbers that are fitted: keys of the scene, factors and summands of keys, plays and lags of actuators, offsets of markers, and clocks of recordings.

use super::data::{self, Case, Data, Marker};
use super::{FitError, FitOptions};
use crate::scene::{number, numbers, pairs};

/// A number that is fitted.
pub(crate) struct Free {
    pub key: String,
    /// The key of the list of numbers that is fitted as a whole, of which this one is the entry at the end of `key`.
    pub list: Option<String>,
    /// Paths of the numbers that it multiplies.
    pub times: Vec<String>,
    /// Paths of the numbers to which it is added.
    pub plus: Vec<String>,
    /// Keys of rows of whose actuators it is the play.
    pub play: Vec<String>,
    /// Keys of given inputs over time of whose actuators it is the lag.
    pub lag: Vec<String>,
    /// Marker and axis whose offset it is.
    pub marker: Option<(usize, usize)>,
    /// Recordings by whose clock it is.
    pub clock: Vec<usize>,
    pub start: f64,
    /// Unit of the search.
    pub scale: f64,
    pub bounds: [f64; 2],
    pub prior: Option<[f64; 2]>,
}

impl Free {
    /// Returns the number of this key, as the data describe it; `own` are the entries of the scene, and `tables` those of the cases.
    fn of(
        key: &str,
        list: Option<&str>,
        data: &Data,
        own: &toml::Table,
        (tables, cases): (&[toml::Table], &[Case]),
    ) -> Result<Self, FitError> {
        let refuse = |words: String| Err(FitError::Data(words));
        let described = (data.free.iter()).find(|free| free.key == list.unwrap_or(key));
        let times = described.map_or(&[][..], |free| &free.times);
        let plus = described.map_or(&[][..], |free| &free.plus);
        let play = described.map_or(&[][..], |free| &free.play);
        let lag = described.map_or(&[][..], |free| &free.lag);
        let relations = [times, plus, play, lag];
        if relations.iter().filter(|own| !own.is_empty()).count() > 1 {
            return refuse(format!(
                "{key} has more than one of times, plus, play and lag: give a number for each"
            ));
        }
        let is_set = |path: &String| {
            let rows = cases.iter().filter_map(Case::rows);
            rows.flat_map(|rows| &rows.keys).any(|key| key == path)
        };
        if let Some(path) = play.iter().find(|path| !is_set(path)) {
            return refuse(format!(
                "{path}, of which {key} is the play, is set by the rows of no table"
            ));
        }
        let lower = described.and_then(|free| free.lower).unwrap_or(0.0);
        let never_below_0 =
            ([("play", play), ("lag", lag)].into_iter()).find(|(_, paths)| !paths.is_empty());
        if let Some((noun, _)) = never_below_0.filter(|_| lower < 0.0) {
            return refuse(format!("{key} has lower = {lower}: a {noun} is at least 0"));
        }
        let moves = || {
            tables
                .iter()
                .zip(cases)
                .filter(|(_, case)| case.is_motion())
        };
        let is_given = |path: &String| moves().any(|(table, _)| pairs(table, path).is_some());
        if let Some(path) = lag.iter().find(|path| !is_given(path)) {
            return refuse(format!(
                "{path}, of which {key} is the lag, has no rows of time and input in any recording"
            ));
        }
        for path in times.iter().chain(plus) {
            let mut tables = tables.iter().chain([own]);
            if !is_set(path) && !tables.any(|table| number(table, path).is_some()) {
                let relation = match plus.is_empty() {
                    true => format!("of which {key} is a factor"),
                    false => format!("to which {key} is added"),
                };
                return refuse(format!("{path}, {relation}, has no number in this scene"));
            }
        }
        let marker = marker_axis(key, &data.marker)?;
        let clock = clocks(key, cases)?;
        let given = described
            .and_then(|free| free.start)
            .filter(|_| list.is_none())
            .or_else(|| match marker {
                Some((marker, axis)) => Some(data.marker[marker].offset_m[axis]),
                None if !clock.is_empty() => Some(0.0),
                None if !times.is_empty() => Some(1.0),
                None if !plus.is_empty() => Some(0.0),
                None if !play.is_empty() => Some(largest_play(cases, play)),
                None if !lag.is_empty() => Some(LAG * longest(moves().map(|(_, case)| case))),
                None => number(own, key),
            });
        let Some(start) = given else {
            return refuse(format!(
                "{key} has no number in this scene; give the key of a number, or its start in [[free]] of the data"
            ));
        };
        let part = |of: fn(&data::Free) -> Option<f64>| described.and_then(of);
        let is_positive = start > 0.0
            && marker.is_none()
            && clock.is_empty()
            && plus.is_empty()
            && lag.is_empty()
            && list.is_none();
        let bounds = [
            part(|free| free.lower).unwrap_or(if never_below_0.is_some() {
                0.0
            } else if is_positive {
                1e-3 * start
            } else {
                f64::NEG_INFINITY
            }),
            part(|free| free.upper).unwrap_or(if is_positive {
                1e3 * start
            } else {
                f64::INFINITY
            }),
        ];
        let prior = match [part(|free| free.prior), part(|free| free.prior_sigma)] {
            [Some(prior), Some(sigma)] if sigma > 0.0 && (prior + sigma).is_finite() => {
                Some([prior, sigma])
            }
            [None, None] => None,
            _ => {
                return refuse(format!(
                    "{key}: a prior has a value and a standard deviation above 0, prior and prior_sigma"
                ));
            }
        };
        let width = bounds[1] - bounds[0];
        let length = number(own, "rod.length_m").unwrap_or(1.0);
        let largest = |paths: &[String]| {
            let in_scenes = |path: &String| {
                let own = tables.iter().filter_map(|table| number(table, path));
                own.fold(0.0, |most: f64, value| most.max(value.abs()))
            };
            (paths.iter())
                .map(|path| largest_input(cases, path).max(in_scenes(path)))
                .fold(0.0, f64::max)
        };
        let of_inputs = largest(plus).max(PLAY * largest(play));
        let scale = if marker.is_some() {
            start.abs().max(OFFSET * length)
        } else if !clock.is_empty() {
            start
                .abs()
                .max(CLOCK * longest(clock.iter().map(|&case| &cases[case])))
        } else if let (Some(_), Some([_, sigma])) = (list, prior) {
            sigma
        } else if start != 0.0 {
            start.abs()
        } else if of_inputs > 0.0 {
            of_inputs
        } else if let Some([_, sigma]) = prior {
            sigma
        } else if width.is_finite() {
            width
        } else {
            1.0
        };
        Ok(Self {
            key: key.into(),
            list: list.map(Into::into),
            times: times.to_vec(),
            plus: plus.to_vec(),
            play: play.to_vec(),
            lag: lag.to_vec(),
            marker,
            clock,
            start,
            scale,
            bounds,
            prior,
        })
    }

    /// Returns the dotted paths of its key and of the numbers that it multiplies, to which it is added, or whose play or lag it is.
    fn paths(&self) -> Vec<String> {
        let sums = self.plus.iter().map(|path| format!("{path} plus"));
        let plays = self.play.iter().map(|path| format!("{path} play"));
        let lags = self.lag.iter().map(|path| format!("{path} lag"));
        let own = [&[self.key.clone()][..], &self.times].concat();
        own.into_iter()
            .chain(sums)
            .chain(plays)
            .chain(lags)
            .collect()
    }

    /// Returns the paths of the numbers that it multiplies, or to which it is added.
    pub fn related(&self) -> impl Iterator<Item = &String> {
        self.times.iter().chain(&self.plus)
    }

    /// Tells whether it is the number at its key in the scene.
    pub fn is_key(&self) -> bool {
        self.related().next().is_none()
            && self.play.is_empty()
            && self.lag.is_empty()
            && self.marker.is_none()
            && self.clock.is_empty()
    }

    pub fn scaled_bounds(&self) -> [f64; 2] {
        self.bounds.map(|bound| bound / self.scale)
    }
}

/// Scale of a play in the search, as a part of the largest command.
const PLAY: f64 = 1e-2;

/// Start of a lag in the search, as a part of the longest recording.
const LAG: f64 = 1e-2;

/// Scale of an offset of a marker in the search, as a part of the length of the arm.
const OFFSET: f64 = 1e-2;

/// Scale of the time by which a clock is ahead, as a part of the longest recording.
const CLOCK: f64 = 1e-2;

/// Returns the last time of some recordings, s.
pub fn longest<'a>(cases: impl Iterator<Item = &'a Case>) -> f64 {
    let last = cases.filter_map(|case| case.sights.last());
    last.map(|sight| sight.time).fold(0.0, f64::max)
}

/// Returns the numbers that are fitted, with their starts; `own` are the entries of the scene, and `tables` those of the cases.
pub fn parameters(
    own: &toml::Table,
    cases: (&[toml::Table], &[Case]),
    data: &Data,
    options: &FitOptions,
) -> Result<Vec<Free>, FitError> {
    let refuse = |words: String| Err(FitError::Data(words));
    let mut keys: Vec<&str> = options.free.iter().map(String::as_str).collect();
    for free in &data.free {
        if !keys.contains(&free.key.as_str()) {
            keys.push(&free.key);
        }
    }
    if keys.is_empty() {
        return refuse(
            "nothing is free: name keys by --free, as rod.material.youngs_modulus_pa".into(),
        );
    }
    let mut out: Vec<Free> = Vec::new();
    // A list of numbers is as many numbers.
    let all = keys.into_iter().flat_map(|key| match numbers(own, key) {
        None => vec![(key.to_string(), None)],
        Some(list) => (0..list.len())
            .map(|at| (format!("{key}.{at}"), Some(key)))
            .collect(),
    });
    for (key, list) in all {
        let free = Free::of(&key, list, data, own, cases)?;
        let taken: Vec<String> = out.iter().flat_map(Free::paths).collect();
        let new = free.paths();
        if let Some(path) = (new.iter().enumerate())
            .find(|(i, path)| taken.contains(path) || new[..*i].contains(path))
            .map(|(_, path)| path)
        {
            return refuse(format!("{path} is free twice"));
        }
        let (start, bounds) = (free.start, free.bounds);
        if !(start.is_finite() && bounds[0] <= start && start <= bounds[1] && bounds[0] < bounds[1])
        {
            return refuse(format!(
                "{key} starts at {start}, outside of its bounds {bounds:?}"
            ));
        }
        out.push(free);
    }
    Ok(out)
}

/// Refuses a key that is free and that a shape or recording sets, itself, in part, or as a part of a list or table: the fitted value would
/// replace what was measured. Factors multiply what is set, and are not refused.
pub fn refuse_set(parameters: &[Free], cases: &[Case]) -> Result<(), FitError> {
    let parts = |path: &str| -> Vec<String> {
        (path.split('.'))
            .map(|part| part.trim().trim_matches(['"', '\'']).to_string())
            .collect()
    };
    for own in parameters.iter().filter(|own| own.is_key()) {
        let key = parts(&own.key);
        for case in cases {
            let set = case.set.iter().filter_map(|set| set.split_once('='));
            let rows = case.rows().into_iter().flat_map(|rows| &rows.keys);
            for path in set.map(|(path, _)| path).chain(rows.map(String::as_str)) {
                let set = parts(path);
                let shared = key.len().min(set.len());
                if key[..shared] == set[..shared] {
                    return Err(FitError::Data(format!(
                        "{0} is free, and {1} sets {2}: the fit would replace what was measured; take {2} out of `set`, or fit a \
                         factor of it: [[free]] with a name as its key and times = [\"{0}\"]",
                        own.key,
                        case.name,
                        path.trim()
                    )));
                }
            }
        }
    }
    Ok(())
}

/// Returns the marker and the axis of a key as `marker.tip.offset_m.2`.
///
/// # Errors
/// Returns [`FitError`] for another marker, or another number of it.
fn marker_axis(key: &str, markers: &[Marker]) -> Result<Option<(usize, usize)>, FitError> {
    let Some(path) = key.strip_prefix("marker.") else {
        return Ok(None);
    };
    let found = path.split_once(".offset_m.").and_then(|(name, axis)| {
        let marker = markers.iter().position(|own| own.name == name)?;
        Some((marker, axis.parse().ok().filter(|axis: &usize| *axis < 3)?))
    });
    match found {
        Some(found) => Ok(Some(found)),
        None => Err(FitError::Data(format!(
            "{key}: expected marker.NAME.offset_m.0, .1 or .2, with the name of a marker"
        ))),
    }
}

/// Returns the recordings by whose clock a key is: all of them for `clock_s`, and one for `recording.NAME.clock_s`; none for another key.
///
/// # Errors
/// Returns [`FitError`] where there is no recording, or none of this name.
fn clocks(key: &str, cases: &[Case]) -> Result<Vec<usize>, FitError> {
    let name = (key.strip_prefix("recording.")).and_then(|rest| rest.strip_suffix(".clock_s"));
    if key != "clock_s" && name.is_none() {
        return Ok(Vec::new());
    }
    let moves = |case: &usize| cases[*case].is_motion();
    let all: Vec<usize> = (0..cases.len()).filter(moves).collect();
    let is_own = |case: &usize| name.is_none_or(|name| cases[*case].name == name);
    let found: Vec<usize> = all.iter().copied().filter(is_own).collect();
    if found.is_empty() {
        let names: Vec<&str> = all.iter().map(|&case| &cases[case].name[..]).collect();
        return Err(FitError::Data(format!(
            "{key}: a clock is that of a recording, and the data have {names:?}"
        )));
    }
    Ok(found)
}

/// Returns the size of the largest command of a key in tables.
fn largest_input(cases: &[Case], key: &str) -> f64 {
    let mut largest = 0.0f64;
    for rows in cases.iter().filter_map(Case::rows) {
        for (index, _) in rows.keys.iter().enumerate().filter(|(_, own)| *own == key) {
            let column = (0..rows.len()).map(|row| rows.row(row)[index].abs());
            largest = column.fold(largest, f64::max);
        }
    }
    largest
}

/// Returns the largest play that tables give the actuators of some keys.
fn largest_play(cases: &[Case], keys: &[String]) -> f64 {
    let rows = cases.iter().filter_map(Case::rows);
    let all = rows.flat_map(|rows| rows.keys.iter().zip(&rows.play));
    let own = all.filter(|(key, _)| keys.contains(key));
    own.map(|(_, play)| *play).fold(0.0, f64::max)
}
