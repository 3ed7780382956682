//! Conversion of a plant's lines to states of the model or signals of sensors.

use nalgebra::{Matrix3, Vector3};

use super::message::{Given, Line, ReadingLine, Rows, Vector, rows};
use crate::estimator::comparison::FARTHEST;
use crate::sensor::SensorSettings;
use crate::signal::{Measurement, Quantity, Reading, Signal};
use control::rounding_of;
use mechanics::rod::BaseCondition;
use mechanics::rotation::{log, orthonormalized};
use mechanics::{Configuration, Rod, State};

/// The reason why a value is refused: its place, its fault, and a remedy.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Refusal {
    pub place: String,
    pub message: String,
    pub help: String,
}

impl Refusal {
    pub fn new(
        place: impl Into<String>,
        message: impl Into<String>,
        help: impl Into<String>,
    ) -> Self {
        Self {
            place: place.into(),
            message: message.into(),
            help: help.into(),
        }
    }
}

/// Largest `|RᵀR - 1|` of a matrix that is accepted as a rotation: entries that are off by 0.03 may have as much, by `|RᵀR - 1| ≤ 2 |E|`.
/// The steps to the nearest rotation converge below 1.
const LARGEST_EXCESS: f64 = 0.2;
/// `|RᵀR - 1|` of a rotation up to rounding: products of three terms.
const ROUNDING: f64 = 4.0 * f64::EPSILON;
/// Number of steps to the nearest rotation, each of which squares the excess: from 0.2, six steps end below rounding.
const STEPS: usize = 6;
/// Rotations are refused as transposed if their transposes fit the axis of the arm better by this mean cosine. Rotations that are right
/// have a mean cosine of 1 up to the shear, whose square counts: 0.05 is a shear of 0.3 in all elements, beyond the elastic law.
const BETTER_FIT: f64 = 0.05;
/// Largest distance of the base from the clamp of the model, divided by the length: as far as an arm that stays may be from its place by
/// default (`task.stays_m`).
const FARTHEST_BASE: f64 = 0.01;

/// The motion of all nodes: momenta, or velocities.
struct Moving {
    vectors: Vec<Vector3<f64>>,
    is_momentum: bool,
}

/// Cap on the readings of one line: an estimator processes each of them before the plant has its answer.
pub(super) const MOST_READINGS: usize = 1000;
/// Number of signals of one time that an estimator processes together. It factors a matrix of three times as many rows; successive blocks
/// give the same result in a time proportional to their number.
const BLOCK: usize = 128;

/// Converts lines to states and signals.
#[derive(Debug)]
pub(super) struct Intake {
    rod: Rod,
    places: Vec<f64>,
    sensors: Vec<SensorSettings>,
    /// Time and configuration of the last state, for velocities by differences.
    before: Option<(f64, Configuration)>,
    /// Largest distance of the present line's rotations from the nearest ones; `None` without rotations.
    pub rotation_change: Option<f64>,
}

impl Intake {
    pub fn new(rod: &Rod, sensors: Vec<SensorSettings>) -> Self {
        Self {
            places: rod.places(),
            rod: rod.clone(),
            sensors,
            before: None,
            rotation_change: None,
        }
    }

    pub fn sensors(&self) -> &[SensorSettings] {
        &self.sensors
    }

    /// Returns the state of all nodes that a line gives at time `t`; `None` if it gives none.
    pub fn state(&mut self, t: f64, line: &Line) -> Result<Option<State>, Refusal> {
        let Some(configuration) = self.configuration(line)? else {
            return Ok(None);
        };
        let step = (self.before.as_ref()).map(|(before, _)| t - before);
        let earlier = self.before.as_ref().map(|(_, earlier)| earlier);
        let n = self.rod.n_nodes();
        let still = || vec![Vector3::zeros(); n];
        let velocity = |q: usize| match (earlier, step) {
            (Some(earlier), Some(step)) if step > 0.0 => {
                (configuration.positions[q] - earlier.positions[q]) / step
            }
            _ => Vector3::zeros(),
        };
        let spin = |q: usize| match (earlier, step) {
            (Some(earlier), Some(step)) if step > 0.0 => {
                log(&earlier.rotations[q].tr_mul(&configuration.rotations[q])) / step
            }
            _ => Vector3::zeros(),
        };
        let mut linear = still();
        let mut angular = still();
        let given = (&line.linear_momenta_kg_m_s, &line.velocities_m_s);
        match self.channel(given, ["linear_momenta_kg_m_s", "velocities_m_s"])? {
            Some(own) if own.is_momentum => linear = own.vectors,
            found => {
                let velocities = found.map(|own| own.vectors);
                for q in 0..n {
                    let v = velocities
                        .as_ref()
                        .map_or_else(|| velocity(q), |own| own[q]);
                    linear[q] = v * self.rod.nodes[q].mass;
                }
            }
        }
        let given = (
            &line.angular_momenta_kg_m2_s,
            &line.angular_velocities_rad_s,
        );
        let names = ["angular_momenta_kg_m2_s", "angular_velocities_rad_s"];
        match self.channel(given, names)? {
            Some(own) if own.is_momentum => angular = own.vectors,
            found => {
                let velocities = found.map(|own| own.vectors);
                for q in 0..n {
                    let w = velocities.as_ref().map_or_else(|| spin(q), |own| own[q]);
                    angular[q] = w.component_mul(&self.rod.nodes[q].rotary);
                }
            }
        }
        self.before = Some((t, configuration.clone()));
        Ok(Some(State {
            configuration,
            linear_momentum: linear,
            angular_momentum: angular,
        }))
    }

    /// Returns the signals of a line at time `t`, for an estimator that is at `known_at` (s), in the order of their times, and the refusals
    /// of unusable values.
    pub fn signals(
        &mut self,
        t: f64,
        known_at: f64,
        line: &Line,
    ) -> Result<(Vec<Measurement>, Vec<Refusal>), Refusal> {
        let n = line.readings.as_ref().map_or(0, Vec::len);
        if n > MOST_READINGS {
            return Err(Refusal::new(
                "readings",
                format!("{n} of them, and a line may have {MOST_READINGS}"),
                "give fewer places, or one mean of the readings of a sensor between two samples",
            ));
        }
        let mut readings: Vec<(String, ReadingLine)> = (line.readings.iter().flatten().enumerate())
            .map(|(i, reading)| (format!("readings[{i}]"), reading.clone()))
            .collect();
        if let Some(configuration) = self.configuration(line)? {
            readings.extend(self.readings_at_nodes(line, &configuration)?);
        }
        let (mut found, mut refusals): (Vec<Measurement>, _) = (Vec::new(), Vec::new());
        for (name, reading) in readings {
            let time = reading.time_s.unwrap_or(t);
            if !(time <= t + rounding_of(t)) {
                return Err(Refusal::new(
                    format!("{name}.time_s"),
                    format!("{time} s lies after the time of the sample, {t} s"),
                    "give the time at which the reading was true",
                ));
            }
            if time < known_at - rounding_of(known_at) {
                refusals.push(Refusal::new(
                    format!("{name}.time_s"),
                    format!("{time} s lies before the last measurement that the estimate has used, {known_at} s"),
                    "the reading is dropped; give age_s of its sensor in the scene, so that nothing newer is used before it",
                ));
                continue;
            }
            let at = found.partition_point(|other| other.time < time);
            if found.get(at).is_none_or(|other| other.time > time) {
                found.insert(
                    at,
                    Measurement {
                        time,
                        signals: Vec::new(),
                    },
                );
            }
            self.read(&name, &reading, &mut found[at].signals, &mut refusals)?;
        }
        let blocks = found.iter().flat_map(|measurement| {
            let blocks = measurement.signals.chunks(BLOCK);
            blocks.map(|signals| Measurement {
                time: measurement.time,
                signals: signals.to_vec(),
            })
        });
        Ok((blocks.collect(), refusals))
    }

    /// Returns positions and rotations of all nodes.
    fn configuration(&mut self, line: &Line) -> Result<Option<Configuration>, Refusal> {
        let others = [
            line.velocities_m_s.is_some(),
            line.angular_velocities_rad_s.is_some(),
            line.linear_momenta_kg_m_s.is_some(),
            line.angular_momenta_kg_m2_s.is_some(),
        ];
        let (positions, rotations) = match (&line.positions_m, &line.rotations) {
            (Some(positions), Some(rotations)) => (positions, rotations),
            (None, None) if !others.contains(&true) => return Ok(None),
            (positions, _) => {
                let missing = if positions.is_some() {
                    "rotations"
                } else {
                    "positions_m"
                };
                return Err(Refusal::new(
                    missing,
                    "missing: a state has the positions and the rotations of all nodes",
                    "give both, or only `readings`, which an estimator of the scene can use",
                ));
            }
        };
        self.fits("positions_m", positions.len())?;
        self.fits("rotations", rotations.len())?;
        let positions: Vec<Vector3<f64>> = positions.iter().map(|x| Vector3::from(*x)).collect();
        for (q, x) in positions.iter().enumerate() {
            if let Some(refusal) = self.unlikely(&format!("positions_m[{q}]"), x) {
                return Err(refusal);
            }
        }
        let rotations = (rotations.iter().enumerate())
            .map(|(q, given)| self.rotation(&format!("rotations[{q}]"), given))
            .collect::<Result<Vec<_>, _>>()?;
        let configuration = Configuration {
            positions,
            rotations,
        };
        self.at_the_clamp(&configuration)?;
        not_transposed(&configuration)?;
        Ok(Some(configuration))
    }

    fn fits(&self, name: &str, found: usize) -> Result<(), Refusal> {
        let n = self.rod.n_nodes();
        if found == n {
            return Ok(());
        }
        Err(Refusal::new(
            name,
            format!("{found} of them, and the model has {n} nodes"),
            "give one a node of the hello line, from the base to the tip",
        ))
    }

    /// Returns the refusal of a position that is not finite, or where no node can be.
    fn unlikely(&self, place: &str, x: &Vector3<f64>) -> Option<Refusal> {
        if let Some(refusal) = not_finite(place, x) {
            return Some(refusal);
        }
        let off = (x - self.rod.rest.positions[0]).norm();
        let length = self.rod.scales.length;
        if !matches!(self.rod.base, BaseCondition::Clamped) || off <= FARTHEST * length {
            return None;
        }
        Some(Refusal::new(
            place,
            format!("{off} m away from the clamp of the model, and the arm has {length} m"),
            "give positions in m and in the frame of the scene; a marker that was not seen is left out",
        ))
    }

    /// Refuses a base away from the clamp of the model, because the plant's frame is then another one.
    fn at_the_clamp(&self, configuration: &Configuration) -> Result<(), Refusal> {
        if !matches!(self.rod.base, BaseCondition::Clamped) {
            return Ok(());
        }
        let off = (configuration.positions[0] - self.rod.rest.positions[0]).norm();
        if off <= FARTHEST_BASE * self.rod.scales.length {
            return Ok(());
        }
        let at: Vector = self.rod.rest.positions[0].into();
        Err(Refusal::new(
            "positions_m[0]",
            format!("the base is {off} m away from the clamp of the model, {at:?} m"),
            "give positions in the frame of the scene, or move [base] of the scene",
        ))
    }

    /// Returns the nearest rotation, and stores its distance.
    fn rotation(&mut self, place: &str, given: &Rows) -> Result<Matrix3<f64>, Refusal> {
        let given = Matrix3::from_fn(|i, j| given[i][j]);
        let excess = (given.tr_mul(&given) - Matrix3::identity()).norm();
        let refuse = |message: String| {
            let help = "give the matrix row by row; its columns are the directors of the section in space, orthogonal and of length 1";
            Err(Refusal::new(place, message, help))
        };
        if !(excess <= LARGEST_EXCESS) {
            return refuse(format!(
                "not a rotation: RᵀR differs from the identity by {excess}"
            ));
        }
        if given.determinant() < 0.0 {
            return refuse("a reflection: its determinant is negative".into());
        }
        let mut nearest = given;
        // A matrix that is a rotation up to rounding is left unchanged.
        if excess > ROUNDING {
            for _ in 0..STEPS {
                nearest = orthonormalized(&nearest);
            }
        }
        let change = (nearest - given).norm();
        let before = self.rotation_change.unwrap_or(0.0);
        self.rotation_change = Some(before.max(change));
        Ok(nearest)
    }

    /// Returns momenta or velocities of all nodes, whichever are given.
    fn channel(
        &self,
        (first, second): (&Option<Vec<Vector>>, &Option<Vec<Vector>>),
        names: [&str; 2],
    ) -> Result<Option<Moving>, Refusal> {
        let (given, is_momentum) = match (first, second) {
            (None, None) => return Ok(None),
            (Some(given), None) => (given, true),
            (None, Some(given)) => (given, false),
            (Some(_), Some(_)) => {
                return Err(Refusal::new(
                    names[1],
                    format!("given beside {}", names[0]),
                    "give one of both, or none: velocities are then differences",
                ));
            }
        };
        let name = names[usize::from(!is_momentum)];
        self.fits(name, given.len())?;
        let vectors: Vec<Vector3<f64>> = given.iter().map(|v| Vector3::from(*v)).collect();
        for (q, v) in vectors.iter().enumerate() {
            if let Some(refusal) = not_finite(&format!("{name}[{q}]"), v) {
                return Err(refusal);
            }
        }
        Ok(Some(Moving {
            vectors,
            is_momentum,
        }))
    }

    /// Returns a state as readings at the free nodes.
    fn readings_at_nodes(
        &self,
        line: &Line,
        configuration: &Configuration,
    ) -> Result<Vec<(String, ReadingLine)>, Refusal> {
        let given = (&line.linear_momenta_kg_m_s, &line.velocities_m_s);
        let linear = self.channel(given, ["linear_momenta_kg_m_s", "velocities_m_s"])?;
        let given = (
            &line.angular_momenta_kg_m2_s,
            &line.angular_velocities_rad_s,
        );
        let names = ["angular_momenta_kg_m2_s", "angular_velocities_rad_s"];
        let angular = self.channel(given, names)?;
        let nodes = &self.rod.nodes;
        let velocity = |q: usize| {
            let own = linear.as_ref()?;
            let over = if own.is_momentum { nodes[q].mass } else { 1.0 };
            Some(own.vectors[q] / over)
        };
        let spin = |q: usize| {
            let own = angular.as_ref()?;
            Some(if own.is_momentum {
                own.vectors[q].component_div(&nodes[q].rotary)
            } else {
                own.vectors[q]
            })
        };
        // Only those quantities of a state are used that a sensor of the scene measures.
        let sees = |quantity| self.sensors.iter().any(|own| own.sigma(quantity).is_some());
        let (position, rotation) = (sees(Quantity::Position), sees(Quantity::Rotation));
        let (moves, turns) = (sees(Quantity::Velocity), sees(Quantity::AngularVelocity));
        if !(position || rotation) {
            return Err(Refusal::new(
                "positions_m",
                "no [[sensor]] of the scene measures positions or rotations",
                "give `readings` of what they measure, or another [[sensor]]",
            ));
        }
        Ok((self.rod.first_free_node()..self.rod.n_nodes())
            .map(|q| {
                let at = configuration;
                let rotation = rotation.then(|| Given::Rotation(rows(&at.rotations[q])));
                let vectors = [
                    (Quantity::Position, position.then_some(at.positions[q])),
                    (Quantity::Velocity, velocity(q).filter(|_| moves)),
                    (Quantity::AngularVelocity, spin(q).filter(|_| turns)),
                ];
                let mut values: Vec<(Quantity, Given)> = (vectors.into_iter())
                    .filter_map(|(own, v)| Some((own, Given::Vector(v?.into()))))
                    .collect();
                values.extend(rotation.map(|rows| (Quantity::Rotation, rows)));
                values.sort_by_key(|(own, _)| *own as usize);
                let reading = ReadingLine {
                    time_s: None,
                    place: Some(self.places[q]),
                    offset_m: None,
                    values,
                };
                (format!("nodes[{q}]"), reading)
            })
            .collect())
    }

    /// Adds the signals of a reading; a vector that cannot be is left out with its refusal.
    fn read(
        &mut self,
        name: &str,
        reading: &ReadingLine,
        signals: &mut Vec<Signal>,
        refusals: &mut Vec<Refusal>,
    ) -> Result<(), Refusal> {
        let place = reading.place.unwrap_or(1.0);
        if !(0.0..=1.0).contains(&place) {
            return Err(Refusal::new(
                format!("{name}.place"),
                format!("{place} is not between 0 and 1"),
                "give the arc length from the base over the length of the arm; without it the place is the tip, 1",
            ));
        }
        let offset = reading.offset_m.unwrap_or_default();
        if offset.iter().any(|x| !x.is_finite()) {
            return Err(Refusal::new(
                format!("{name}.offset_m"),
                format!("{offset:?} is not finite"),
                "give the place in the section, from its center; without it the place is the center",
            ));
        }
        for &(quantity, given) in &reading.values {
            let field = format!("{name}.{}", quantity.row().field);
            let reading = match given {
                Given::Rotation(rows) => Reading::Rotation(self.rotation(&field, &rows)?),
                Given::Vector(vector) => {
                    let vector = Vector3::from(vector);
                    let refusal = match quantity {
                        Quantity::Position => self.unlikely(&field, &vector),
                        _ => not_finite(&field, &vector),
                    };
                    if let Some(refusal) = refusal {
                        refusals.push(refusal);
                        continue;
                    }
                    Reading::Vector(quantity, vector)
                }
            };
            let Some(sigma) = self.sensors.iter().find_map(|own| own.sigma(quantity)) else {
                return Err(Refusal::new(
                    field,
                    "no [[sensor]] of the scene measures it, so that its standard deviation is not known",
                    "leave it out, or give its standard deviation to a [[sensor]]",
                ));
            };
            signals.push(Signal {
                place,
                offset,
                reading,
                sigma,
            });
        }
        Ok(())
    }
}

/// Returns the refusal of a vector that is not finite.
fn not_finite(place: &str, v: &Vector3<f64>) -> Option<Refusal> {
    let help = "leave out what was not measured";
    (!v.iter().all(|x| x.is_finite())).then(|| {
        let words = format!("{:?} is not finite", v.as_slice());
        Refusal::new(place, words, help)
    })
}

/// Refuses transposed rotations. The third director of a section points along the arm, up to a small shear; if that of the transposed
/// matrices fits better, rows and columns were exchanged.
fn not_transposed(at: &Configuration) -> Result<(), Refusal> {
    let n = at.positions.len() - 1;
    let mut fits = [0.0; 2];
    for q in 0..n {
        let chord = at.positions[q + 1] - at.positions[q];
        let [a, b] = [at.rotations[q], at.rotations[q + 1]];
        let axes = [
            a.column(2) + b.column(2),
            a.row(2).transpose() + b.row(2).transpose(),
        ];
        for (fit, axis) in fits.iter_mut().zip(axes) {
            let cosine = axis.dot(&chord) / (axis.norm() * chord.norm());
            // Coinciding nodes have no direction.
            if cosine.is_finite() {
                *fit += cosine / n as f64;
            }
        }
    }
    let [given, transposed] = fits;
    if transposed <= given + BETTER_FIT {
        return Ok(());
    }
    Err(Refusal::new(
        "rotations",
        format!(
            "the third directors are off the axis of the arm, with a mean cosine of {given:.3}, and those of the transposed matrices are not: \
             {transposed:.3}"
        ),
        "transpose them: a rotation takes the body frame to space, and its columns are the directors",
    ))
}
