//! The commands of a table of shapes at rest, and the play by which actuators lag behind them.
//!
//! An actuator with play does not follow a command that turns back until it has come back by twice the play: the value `z` that acts under the
//! command `u` is the one before, moved as little as `|z - u| ≤ play` asks for. Rows therefore have an order, in which those that are compared
//! only count as well; an actuator begins in the middle of its play, `z = u`. (M. A. Krasnosel'skii and A. V. Pokrovskii, Systems with
//! Hysteresis, 1989.)

use std::collections::BTreeMap;

use serde::Deserialize;

use super::data::one;
use crate::mpc::follow_with_play;

/// Commands and sums of them that differ by less than this part are the same.
const SAME: f64 = 1e-9;

/// A column of commands.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InputColumn {
    /// Key of the scene that the column sets: the effort of an actuator before the task, or the displacement of a winch.
    pub key: String,
    /// Factor from the numbers of the column to the unit of the key.
    #[serde(default = "one")]
    pub times: f64,
    /// Value of the key where the column has zero.
    #[serde(default)]
    pub plus: f64,
    /// Play of the actuator in the unit of the key: it follows a command that turns back after twice this.
    #[serde(default)]
    pub play: f64,
}

/// The commands of a table of shapes at rest.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rows {
    /// Keys of the scene that its rows set.
    pub keys: Vec<String>,
    /// Play of every key, in its unit.
    pub play: Vec<f64>,
    /// Tells whether tendons slide as their commands have last changed.
    pub slides_in_order: bool,
    /// Values of these keys in every row of the file, also in rows of another case, row by row.
    pub commands: Vec<f64>,
    /// Index of every row among those of the file.
    pub places: Vec<usize>,
    /// Line of the file of every row.
    pub lines: Vec<u64>,
    /// Group of every row; empty without groups.
    pub groups: Vec<String>,
}

impl Rows {
    pub fn len(&self) -> usize {
        self.lines.len()
    }

    /// Returns the values of the keys in a row.
    pub fn row(&self, row: usize) -> &[f64] {
        let n = self.keys.len();
        &self.commands[self.places[row] * n..][..n]
    }

    /// Tells of every row whether the sum of its commands is more than in the row before it of the same group; `None` where it is the same, and
    /// in the first row of a group.
    pub fn rises(&self) -> Vec<Option<bool>> {
        let mut before: BTreeMap<Option<&String>, f64> = BTreeMap::new();
        (0..self.len())
            .map(|row| {
                let commands = self.row(row);
                let sum: f64 = commands.iter().sum();
                let size: f64 = commands.iter().map(|command| command.abs()).sum();
                let last = before.insert(self.groups.get(row), sum)?;
                ((sum - last).abs() > SAME * size.max(last.abs())).then_some(sum > last)
            })
            .collect()
    }

    /// Returns the direction in which every key has last changed in every row of this case, in the order of the file: 1 up, -1 down, and 0 before
    /// it has changed.
    pub fn directions(&self) -> Vec<Vec<i8>> {
        let n = self.keys.len().max(1);
        let mut now = vec![0; n];
        let mut all: Vec<Vec<i8>> = Vec::new();
        for (place, row) in self.commands.chunks(n).enumerate() {
            let before = &self.commands[place.saturating_sub(1) * n..][..n];
            for ((own, last), command) in now.iter_mut().zip(before).zip(row) {
                let change = command - last;
                if change.abs() > SAME * command.abs().max(last.abs()) {
                    *own = if change > 0.0 { 1 } else { -1 };
                }
            }
            all.push(now.clone());
        }
        (self.places.iter())
            .map(|&place| all[place].clone())
            .collect()
    }

    /// Returns the values that act in all rows of the file, row by row: `given` changes the value of a key, and `play` has that of every key.
    pub fn acting(&self, given: &dyn Fn(&str, f64) -> f64, play: &[f64]) -> Vec<f64> {
        let n = self.keys.len();
        let mut out: Vec<f64> = Vec::with_capacity(self.commands.len());
        for (place, &value) in self.commands.iter().enumerate() {
            let key = place % n;
            let command = given(&self.keys[key], value);
            let before = place.checked_sub(n).map(|before| out[before]);
            out.push(follow_with_play(
                before.unwrap_or(command),
                command,
                play[key],
            ));
        }
        out
    }
}
