//! The comparison of a measurement with its prediction.

use nalgebra::{Matrix3, Vector3};

use crate::signal::{EXACT, EXACT_VELOCITY, Measurement, Quantity, Reading, Signal};
use mechanics::Rod;

use super::covariance::{Row, Rows};
use super::readings::{Layout, Reader};
use super::{Estimate, EstimateError, Innovation};

/// Largest `|RᵀR - I|` of a measured rotation, which is that of entries with four digits; up to there it is projected to the nearest
/// rotation by one step that squares it, so that 1e-6 is left, the least standard deviation.
const LARGEST_ROTATION_DEFECT: f64 = 1e-3;

/// Largest distance of a measured position from the base, divided by the arm's length: that of an arm that is stretched to twice its
/// length, where no elastic law of the model holds.
pub(crate) const FARTHEST: f64 = 2.0;

/// Compares measurements with estimates, in memory that is reused.
#[derive(Debug)]
pub(super) struct Comparison {
    reader: Reader,
    /// Signals of the last comparison.
    pub rows: Rows,
    /// Place and size of the innovation of the position nearest to the tip.
    nearest: Option<(f64, f64)>,
    /// Time between two measurements, s, where sensors are not believed to be more exact than the model.
    pub interval: Option<f64>,
}

impl Comparison {
    pub fn new(model: &Rod) -> Self {
        Self {
            reader: Reader::new(model),
            rows: Rows::default(),
            nearest: None,
            interval: None,
        }
    }

    /// Returns the largest distance of the innovations from `expected`, divided by their standard deviations; NaN if one is NaN.
    pub fn distance(&self, expected: &[Vector3<f64>]) -> f64 {
        (self.rows.signals.iter().zip(expected)).fold(0.0, |most, (row, expected)| {
            let distance = (row.residual - expected).norm() / row.sigma;
            let is_more = distance > most || distance.is_nan();
            if is_more { distance } else { most }
        })
    }

    /// Computes measured minus expected for every signal, with its derivatives in the order of a layout. `rod` has the stiffness of the
    /// estimate.
    ///
    /// # Errors
    /// Returns [`EstimateError::NotFinite`] and [`EstimateError::Signal`].
    pub fn compare(
        &mut self,
        rod: &Rod,
        estimate: &Estimate,
        measurement: &Measurement,
        layout: &Layout,
    ) -> Result<(), EstimateError> {
        for (index, signal) in measurement.signals.iter().enumerate() {
            check(index, signal)?;
            if let (Reading::Vector(Quantity::Position, x), true) =
                (&signal.reading, rod.first_free_node() > 0)
            {
                let distance = (x - estimate.state.configuration.positions[0]).norm();
                if distance > FARTHEST * rod.scales.length {
                    return Err(EstimateError::Signal {
                        index,
                        name: "the distance of its position from the base in m",
                        value: distance,
                        expected: "within twice the length of the arm",
                    });
                }
            }
        }
        self.rows.clear();
        self.nearest = None;
        for signal in &measurement.signals {
            let (quantity, site) = (signal.reading.quantity(), (signal.place, signal.offset));
            let Estimate {
                time,
                state,
                disturbance,
                ..
            } = estimate;
            let expected = (self.reader).read(rod, *time, state, disturbance, quantity, site);
            let residual = signal.reading.minus(&expected);
            let of = (quantity, site);
            let terms = &mut self.rows.terms;
            (self.reader).derive(rod, state, disturbance, of, layout, terms);
            self.rows.signals.push(Row {
                end: self.rows.terms.len(),
                residual,
                numbers: quantity.row().numbers,
                sigma: believable(signal.sigma, quantity, rod, self.interval),
            });
            if quantity == Quantity::Position
                && self.nearest.is_none_or(|(other, _)| other <= signal.place)
            {
                self.nearest = Some((signal.place, residual.norm()));
            }
        }
        Ok(())
    }

    /// Returns the last comparison without the values that need a covariance.
    pub fn innovation(&self) -> Innovation {
        let signals = &self.rows.signals;
        let n = signals.iter().map(|row| row.numbers).sum();
        let sum: f64 = (signals.iter())
            .map(|row| (row.residual / row.sigma).norm_squared())
            .sum();
        Innovation {
            n,
            rms: if n > 0 { (sum / n as f64).sqrt() } else { 0.0 },
            normalized: None,
            distance: self.nearest.map(|(_, distance)| distance),
            refused: 0,
        }
    }
}

fn check(index: usize, signal: &Signal) -> Result<(), EstimateError> {
    if !signal.reading.is_finite() {
        let what = format!("the value of signal {index}");
        return Err(EstimateError::NotFinite { what });
    }
    let require = |name, value: f64, holds: bool, expected| {
        if value.is_finite() && holds {
            Ok(())
        } else {
            Err(EstimateError::Signal {
                index,
                name,
                value,
                expected,
            })
        }
    };
    let (place, sigma) = (signal.place, signal.sigma);
    let is_place = (0.0..=1.0).contains(&place);
    require("place", place, is_place, "a part of the length, 0 to 1")?;
    for offset in signal.offset {
        require("offset", offset, true, "a finite number")?;
    }
    require("sigma", sigma, sigma >= 0.0, "a number of at least 0")?;
    if let Reading::Rotation(r) = &signal.reading {
        let defect = (r.tr_mul(r) - Matrix3::identity()).norm();
        let expected = "that of a rotation from body to space, below 1e-3";
        let holds = defect < LARGEST_ROTATION_DEFECT && r.determinant() > 0.0;
        require("|RᵀR - I| of its rotation", defect, holds, expected)?;
    }
    Ok(())
}

/// Returns the standard deviation of a reading: that of the sensor, or the smallest that the filter accepts if the sensor claims to be more
/// exact than the model.
fn believable(sigma: f64, quantity: Quantity, rod: &Rod, interval: Option<f64>) -> f64 {
    let is_velocity = matches!(quantity, Quantity::Velocity | Quantity::AngularVelocity);
    let exact = EXACT * quantity.scale(rod);
    match interval {
        _ if is_velocity && sigma > exact => sigma,
        // A sensor that is less exact than an error of the model, be it once or again and again, says how exact it is.
        Some(interval) if sigma < quantity.model_error(rod, f64::INFINITY) => {
            quantity.model_error(rod, interval)
        }
        Some(_) => sigma.max(exact),
        None if is_velocity => EXACT_VELOCITY * quantity.scale(rod),
        None => sigma.max(exact),
    }
}
