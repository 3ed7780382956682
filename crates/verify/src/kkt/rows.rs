//! The parts of the optimality conditions, each with the name of its worst row.

use nalgebra::Vector3;

/// A row of the conditions: its subject, place, time, and residual.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct NamedRow {
    /// Scene key of a constraint, name of a [control](control::NamedControl), or a description of the row.
    pub name: String,
    /// Node of the rod; absent for what acts on no single node.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub node: Option<usize>,
    /// Time, s.
    pub time_s: f64,
    /// `x`, `y` or `z`; empty for scalars. For a vector that is judged as a whole, its largest component.
    pub component: &'static str,
    /// Residual, in `unit`.
    pub value: f64,
    /// SI unit; the objective counts as a pure number.
    pub unit: String,
    /// Scaled residual.
    pub scaled: f64,
}

/// One part of the conditions.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct KktPart {
    /// `stationarity`, `equalities`, `inequalities`, `signs` or `complementarity`.
    pub name: &'static str,
    /// Residual that is judged: that of the worst row, except for the equations of motion, whose scaled defects add up.
    pub scaled: f64,
    /// The worst row; absent if every row holds exactly.
    pub worst: Option<NamedRow>,
}

/// Place of a row: all fields of a [`NamedRow`] but its scaled value.
pub(super) struct Place {
    pub(super) name: String,
    pub(super) node: Option<usize>,
    pub(super) time: f64,
    pub(super) component: &'static str,
    pub(super) value: f64,
    pub(super) unit: String,
}

/// The worst of the rows that it is shown; NaN is worse than any number.
#[derive(Clone, Default)]
pub(super) struct Worst {
    pub(super) scaled: f64,
    pub(super) row: Option<NamedRow>,
}

impl Worst {
    pub(super) fn note(&mut self, scaled: f64, place: impl FnOnce() -> Place) {
        if self.scaled.is_nan() || !(scaled > self.scaled || scaled.is_nan()) {
            return;
        }
        self.scaled = scaled;
        let Place {
            name,
            node,
            time,
            component,
            value,
            unit,
        } = place();
        self.row = Some(NamedRow {
            name,
            node,
            time_s: time,
            component,
            value,
            unit,
            scaled,
        });
    }

    /// Returns the worse of both.
    pub(super) fn or(self, other: Self) -> Self {
        if self.scaled.is_nan() || self.scaled >= other.scaled {
            self
        } else {
            other
        }
    }

    /// Divides the scaled value by `scale`.
    pub(super) fn over(mut self, scale: f64) -> Self {
        self.scaled /= scale;
        if let Some(row) = &mut self.row {
            row.scaled /= scale;
        }
        self
    }

    pub(super) fn part(self, name: &'static str) -> KktPart {
        KktPart {
            name,
            scaled: self.scaled,
            worst: self.row,
        }
    }
}

/// Names of the axes.
pub(super) const AXES: [&str; 3] = ["x", "y", "z"];

/// Returns the name of a vector's largest component.
pub(super) fn largest_axis(v: &Vector3<f64>) -> &'static str {
    AXES[v.iamax()]
}

/// Returns the unit of an objective per `unit`.
pub(super) fn per(unit: &str) -> String {
    match unit {
        "" => String::new(),
        _ => format!("1/({unit})"),
    }
}
