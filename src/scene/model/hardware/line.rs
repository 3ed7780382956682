//! The lines of actuators in the section: one place, or rows of places along the arm.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::super::keys::{Checked, Excludes, Keys};
use super::super::super::values::digits;
use super::super::Scene;
use super::{Common, Tendon};
use crate::mechanics::Route;

/// The line of an actuator in the section.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(
    untagged,
    expecting = "expected the place along the two axes of the section, [x, y], or rows [fraction of the length, x, y]"
)]
pub enum Offset {
    /// One place, along the two axes of the section.
    Same([f64; 2]),
    /// Places by fractions of the length.
    Rows(Vec<[f64; 3]>),
}

impl Default for Offset {
    fn default() -> Self {
        Self::Same([0.0; 2])
    }
}

impl Offset {
    /// Returns the parts of a line between two fractions, one at least.
    pub(super) fn routes(
        &self,
        [from, to]: [f64; 2],
        offset_to: Option<[f64; 2]>,
        turns: f64,
    ) -> Vec<Route> {
        let whole = |offset: [f64; 2]| Route {
            from,
            to,
            offset_from: offset,
            offset_to: offset_to.unwrap_or(offset),
            turns,
        };
        let rows = match self {
            Self::Same(offset) => return vec![whole(*offset)],
            Self::Rows(rows) => rows,
        };
        let mut out = Vec::new();
        let mut add = |[start, end]: [[f64; 3]; 2]| {
            let (a, b) = (start[0].max(from), end[0].min(to));
            if !(b > a) {
                return;
            }
            // The section's axes have turned by so much where this part begins.
            let (sin, cos) = (std::f64::consts::TAU * turns * (a - from) / (to - from)).sin_cos();
            let at = |s: f64| {
                let part = (s - start[0]) / (end[0] - start[0]);
                let [x, y] = [1, 2].map(|i| start[i] + (end[i] - start[i]) * part);
                [cos * x - sin * y, sin * x + cos * y]
            };
            out.push(Route {
                from: a,
                to: b,
                offset_from: at(a),
                offset_to: at(b),
                turns: turns * (b - a) / (to - from),
            });
        };
        if let (Some(first), Some(last)) = (rows.first(), rows.last()) {
            add([[f64::min(from, first[0]) - 1.0, first[1], first[2]], *first]);
            rows.windows(2).for_each(|pair| add([pair[0], pair[1]]));
            add([*last, [f64::max(to, last[0]) + 1.0, last[1], last[2]]]);
        }
        // Of rows or ends that make no line, which the check refuses.
        if out.is_empty() {
            out.push(whole([0.0; 2]));
        }
        // Parts meet to the bit.
        for i in 1..out.len() {
            out[i].from = out[i - 1].to;
        }
        out
    }

    /// Returns the rows of parts of a line that do not turn.
    pub(super) fn of_routes<'a>(routes: impl Iterator<Item = &'a Route>) -> Self {
        let ends = routes.flat_map(|own| {
            [(own.from, own.offset_from), (own.to, own.offset_to)].map(|(s, [x, y])| [s, x, y])
        });
        let mut rows: Vec<[f64; 3]> = ends.collect();
        rows.dedup();
        Self::Rows(rows)
    }
}

/// Part by which a fraction or a distance that was computed may be too large.
const ROUNDING: f64 = 1e-9;

impl Keys<'_> {
    /// Checks that disks are no farther from one another than the tendon is long, and that holes have disks.
    pub(super) fn check_disks(&self, index: usize, tendon: &Tendon, scene: &Scene) -> Checked {
        let (spacing, length) = (tendon.disk_spacing_m.get(), scene.rod.length_m.get());
        if tendon.hole_clearance_m.get() > 0.0 && spacing == 0.0 {
            let help = "give the distance of the disks that have the holes".to_string();
            let message = "without disk_spacing_m there are no holes".to_string();
            let key = format!("tendon.{index}.hole_clearance_m");
            return Err(self.source.error_at(&key, message, Some(help)));
        }
        let along = (tendon.to.get() - tendon.from.get()) * length;
        // Ends in the wrong order are refused by themselves.
        if !(along > 0.0 && spacing > (1.0 + ROUNDING) * along) {
            return Ok(());
        }
        let message = format!(
            "disks {} m apart do not guide a tendon along {} m of the arm",
            digits(spacing),
            digits(along)
        );
        Err((self.source)
            .error_at(&format!("tendon.{index}.disk_spacing_m"), message, None)
            .expecting(format!(
                "expected at most {} m, from `from` to `to` of the tendon",
                digits(along)
            )))
    }

    /// Checks the keys of the line of an actuator in a section of the scene.
    pub(super) fn check_line(&self, section: &str, own: &Common) -> Checked {
        let key = |name: &str| format!("{section}.{name}");
        let (offset, end) = own.offset;
        match offset {
            Offset::Same(offset) => self.finite(&key("offset_m"), offset)?,
            Offset::Rows(rows) => {
                for (i, row) in rows.iter().enumerate() {
                    self.finite(&key(&format!("offset_m.{i}")), row)?;
                }
                let outside = |row: &[f64; 3]| !(-ROUNDING..=1.0 + ROUNDING).contains(&row[0]);
                if let Some(i) = rows.iter().position(outside) {
                    let message = format!("{} is no fraction of the length", digits(rows[i][0]));
                    return Err((self.source)
                        .error_at(&key(&format!("offset_m.{i}.0")), message, None)
                        .expecting("expected rows [fraction, x in m, y in m] with fractions of the length of the arm from 0 to 1"));
                }
                let given = ("offset_m", true);
                self.relations(section, &[Excludes(("offset_to_m", end.is_some()), given)])?;
                let falls = rows.windows(2).position(|pair| pair[1][0] < pair[0][0]);
                if rows.len() < 2 || falls.is_some() {
                    let at = falls.map_or(0, |i| i + 1);
                    let message =
                        "rows of a line need increasing fractions of the length, two rows at least";
                    return Err((self.source)
                        .error_at(&key(&format!("offset_m.{at}")), message, None)
                        .expecting("expected [fraction, x, y] after the row before; two rows at one fraction are a jump"));
                }
            }
        }
        self.finite(&key("offset_to_m"), &end.unwrap_or_default())?;
        self.finite_number(&key("turns"), own.turns)
    }
}
