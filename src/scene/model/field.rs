//! Magnets in fields, and cables to points in space.

use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::keys::{Checked, Excludes, Keys, Needs, given};
use super::super::values::{self, Fraction, Positive, digits, known};
use super::Scene;
use super::hardware::{EffortKeys, InputRange, RateBound};
use crate::mechanics::{self, OfPose, Place, PoseActuator, Span};
use crate::task::EffortControl;

/// Vacuum permeability, N/A² (CODATA 2018).
const PERMEABILITY: f64 = 1.256_637_062_12e-6;
/// Names of the components of a field and of its gradient after that of the magnet.
const FIELD: [&str; 3] = ["Bx", "By", "Bz"];
const GRADIENT: [&str; 5] = ["Gxx", "Gxy", "Gxz", "Gyy", "Gyz"];

/// A magnet in the arm and the magnetic field in which it is. Its moment m turns with the section; in the field B(x) = B + G (x - center)
/// the arm has a force G m and a moment m × B there. The components of B are efforts, "NAME Bx", "NAME By" and "NAME Bz" in results: with
/// `field_t` they are controls, with `profile` they are given, in simulations too; those of G likewise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MagnetKeys {
    /// Name in results, one for each actuator. Absent: the word magnet with its place in the list, from 0.
    pub name: Option<String>,
    /// Place on the arm, as a fraction of `rod.length_m` from the base. An element ends there. Default: 1, the tip.
    pub at: Option<Fraction>,
    /// Instead of `at`: [start, end] of a stretch as fractions, over which the moment is spread evenly. Elements end at both.
    pub along: Option<[Fraction; 2]>,
    /// Magnetic moment in A m², in the axes of the section: the third one points to the tip.
    pub moment_a_m2: Option<[f64; 3]>,
    /// Instead of `moment_a_m2`: remanence Br in T; the moment is Br `volume_m3`/μ0 along `axis`.
    pub remanence_t: Option<Positive<values::Remanence>>,
    /// Volume of the magnet in m³, with `remanence_t`.
    pub volume_m3: Option<Positive<values::Volume>>,
    /// Direction of the moment in the axes of the section, with `remanence_t`. Default: [0, 0, 1], to the tip.
    pub axis: Option<[f64; 3]>,
    /// Name of another magnet, whose field this one feels; it then has no key of a field itself. Absent: it has its own.
    pub field_of: Option<String>,
    /// Least and largest value of each component of B in T, as [[least, largest] of x, of y, of z], which makes the components controls;
    /// one with two equal numbers stays at that value. Absent: the field is given.
    pub field_t: Option<[[f64; 2]; 3]>,
    /// Largest rate of a component of B in T/s, or the fastest fall, negative, and the fastest rise. With it the field begins at
    /// `rest_field_t`. Absent: it may jump.
    pub rate_t_s: Option<RateBound>,
    /// B in T before the task begins, within the bounds, from which effort is counted. Default: 0.
    #[serde(default)]
    pub rest_field_t: [f64; 3],
    /// Given B over time, as [t in s, Bx, By, Bz in T] with increasing t; linear in between and constant outside. It does not go with
    /// `field_t`.
    pub profile: Option<Vec<[f64; 4]>>,
    /// Least and largest value of Gxx, Gxy, Gxz, Gyy and Gyz in T/m, which makes them controls; the others follow, because G is symmetric
    /// and has no trace. Absent: the gradient is given.
    pub gradient_t_m: Option<[[f64; 2]; 5]>,
    /// Largest rate of a number of G in T/m/s, likewise.
    pub gradient_rate_t_m_s: Option<RateBound>,
    /// The five numbers of G in T/m before the task begins. Absent: 0, or no gradient at all.
    pub rest_gradient_t_m: Option<[f64; 5]>,
    /// Given G over time, as [t in s, its five numbers in T/m]. It does not go with `gradient_t_m`.
    pub gradient_profile: Option<Vec<[f64; 6]>>,
    /// Point in m at which the field is B alone. Default: the origin.
    #[serde(default)]
    pub center_m: [f64; 3],
}

/// A cable from the arm to a fixed point in space, which pulls the arm toward that point with its tension. With `tension_n` its tension is a
/// control, with `profile` it is given, in simulations too.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CableKeys {
    /// Name in results, one for each actuator. Absent: the word cable with its place in the list, from 0.
    pub name: Option<String>,
    /// Place on the arm where it is attached, as a fraction of `rod.length_m` from the base. An element ends there. Default: 1, the tip.
    #[serde(default = "Fraction::one")]
    pub at: Fraction,
    /// Place in the section where it is attached, along its two axes, in m. Default: the axis of the arm.
    #[serde(default)]
    pub offset_m: [f64; 2],
    /// The point in space in m.
    pub anchor_m: [f64; 3],
    /// Least and largest tension in N, which makes it a control; a cable pulls only. Absent: the tension is given.
    pub tension_n: Option<[f64; 2]>,
    /// Largest rate of the tension in N/s, or the fastest fall, negative, and the fastest rise. With it the tension begins at
    /// `pretension_n`. Absent: it may jump.
    pub rate_n_s: Option<RateBound>,
    /// Tension in N before the task begins, within the bounds, from which effort is counted. Default: 0.
    #[serde(default)]
    pub pretension_n: f64,
    /// Given tension over time, as [t in s, tension in N] with increasing t; linear in between and constant outside. It does not go with
    /// `tension_n`.
    pub profile: Option<Vec<[f64; 2]>>,
}

/// An effort on poses, with the keys that it comes from.
struct PoseEffort {
    keys: EffortKeys,
    name: String,
    unit: &'static str,
    parts: Vec<(Span, OfPose)>,
    /// Rows of its profile; empty without one.
    rows: Vec<(f64, f64)>,
}

impl MagnetKeys {
    fn name(&self, index: usize) -> String {
        (self.name.clone()).unwrap_or_else(|| format!("magnet {index}"))
    }

    fn span(&self) -> Span {
        match self.along {
            Some([from, to]) => Span::Along(from.get(), to.get()),
            None => Span::At(place(self.at.map_or(1.0, Fraction::get))),
        }
    }

    /// The moment in the axes of the section, A m².
    fn moment(&self) -> Vector3<f64> {
        let size = self.remanence_t.map_or(0.0, values::Number::get)
            * self.volume_m3.map_or(0.0, values::Number::get)
            / PERMEABILITY;
        let axis = Vector3::from(self.axis.unwrap_or([0.0, 0.0, 1.0]));
        self.moment_a_m2
            .map_or_else(|| axis.normalize() * size, Vector3::from)
    }

    fn has_gradient(&self) -> bool {
        self.gradient_t_m.is_some()
            || self.gradient_profile.is_some()
            || self.rest_gradient_t_m.is_some()
    }

    /// The component of the field or of its gradient that an effort is, for this magnet.
    fn in_field(&self, component: usize, center: [f64; 3]) -> OfPose {
        let (field, gradient) = unit_field(component);
        OfPose::Magnet(mechanics::Magnet {
            moment: self.moment(),
            field,
            gradient,
            center: center.into(),
        })
    }

    /// Efforts of the components of the field, then of those of its gradient if there is one.
    fn efforts(&self, index: usize, feeling: &[&Self]) -> Vec<PoseEffort> {
        let keys = |at, bounds, rate, rest, profile| EffortKeys {
            section: "magnet",
            index,
            component: Some(at),
            bounds,
            rate,
            rest,
            profile,
            lag: None,
            winch: None,
        };
        let field = (0..3).map(|at| {
            let bounds = ("field_t", self.field_t.map(|bounds| bounds[at]));
            let rate = ("rate_t_s", self.rate_t_s);
            let rest = ("rest_field_t", self.rest_field_t[at]);
            let profile = ("profile", self.profile.is_some());
            let rows = column(&self.profile, at);
            (keys(at, bounds, rate, rest, profile), FIELD[at], "T", rows)
        });
        let gradient = (0..5).filter(|_| self.has_gradient()).map(|at| {
            let bounds = ("gradient_t_m", self.gradient_t_m.map(|bounds| bounds[at]));
            let rate = ("gradient_rate_t_m_s", self.gradient_rate_t_m_s);
            let rest = self.rest_gradient_t_m.map_or(0.0, |rest| rest[at]);
            let rest = ("rest_gradient_t_m", rest);
            let profile = ("gradient_profile", self.gradient_profile.is_some());
            let rows = column(&self.gradient_profile, at);
            let keys = keys(at, bounds, rate, rest, profile);
            (keys, GRADIENT[at], "T/m", rows)
        });
        let all = field.chain(gradient).enumerate();
        all.map(|(component, (keys, suffix, unit, rows))| PoseEffort {
            keys,
            name: format!("{} {suffix}", self.name(index)),
            unit,
            parts: (std::iter::once(&self).chain(feeling))
                .map(|magnet| (magnet.span(), magnet.in_field(component, self.center_m)))
                .collect(),
            rows,
        })
        .collect()
    }
}

impl CableKeys {
    fn effort(&self, index: usize) -> PoseEffort {
        let [x, y] = self.offset_m;
        PoseEffort {
            keys: EffortKeys {
                section: "cable",
                index,
                component: None,
                bounds: ("tension_n", self.tension_n),
                rate: ("rate_n_s", self.rate_n_s),
                rest: ("pretension_n", self.pretension_n),
                profile: ("profile", self.profile.is_some()),
                lag: None,
                winch: None,
            },
            name: (self.name.clone()).unwrap_or_else(|| format!("cable {index}")),
            unit: "N",
            parts: vec![(
                Span::At(place(self.at.get())),
                OfPose::Cable(mechanics::Cable {
                    offset: Vector3::new(x, y, 0.0),
                    anchor: self.anchor_m.into(),
                }),
            )],
            rows: column(&self.profile, 0),
        }
    }
}

/// The place at a fraction of the length.
fn place(fraction: f64) -> Place {
    match fraction {
        0.0 => Place::Base,
        1.0 => Place::Tip,
        _ => Place::Fraction(fraction),
    }
}

/// A column of a table after the times, as rows of an effort.
fn column<const N: usize>(rows: &Option<Vec<[f64; N]>>, at: usize) -> Vec<(f64, f64)> {
    let rows = rows.iter().flatten();
    rows.map(|row| (row[0], row[1 + at])).collect()
}

/// The field and the gradient of which one component is 1 and the others are 0.
fn unit_field(component: usize) -> (Vector3<f64>, Matrix3<f64>) {
    match component {
        0..3 => (Vector3::ith(component, 1.0), Matrix3::zeros()),
        _ => (Vector3::zeros(), unit_gradient(component - 3)),
    }
}

/// The symmetric matrix without trace of which one of the five numbers is 1 and the others are 0.
fn unit_gradient(number: usize) -> Matrix3<f64> {
    let [xx, xy, xz, yy, yz] = [0, 1, 2, 3, 4].map(|at| if at == number { 1.0 } else { 0.0 });
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, -xx - yy)
}

impl PoseEffort {
    fn of_arm(self) -> PoseActuator {
        PoseActuator {
            name: self.name,
            unit: self.unit,
            parts: self.parts,
            largest: self.keys.largest(),
            effort: if self.rows.is_empty() {
                vec![(0.0, self.keys.rest.1)]
            } else {
                self.rows
            },
        }
    }
}

impl Scene {
    /// The efforts on poses: magnets, then cables.
    fn pose_efforts(&self) -> Vec<PoseEffort> {
        let magnets = self.magnet.iter().enumerate();
        let magnets = magnets.filter(|(_, own)| own.field_of.is_none());
        let magnets = magnets.flat_map(|(index, own)| {
            let name = own.name(index);
            let feels = |other: &&MagnetKeys| other.field_of.as_ref() == Some(&name);
            let feeling: Vec<&MagnetKeys> = self.magnet.iter().filter(feels).collect();
            own.efforts(index, &feeling)
        });
        let cables = self.cable.iter().enumerate();
        magnets
            .chain(cables.map(|(index, own)| own.effort(index)))
            .collect()
    }

    /// The actuators on poses.
    pub(in crate::scene) fn pose_actuators(&self) -> Vec<PoseActuator> {
        (self.pose_efforts().into_iter())
            .map(PoseEffort::of_arm)
            .collect()
    }

    /// The inputs that the actuators on poses take.
    pub(super) fn pose_ranges(&self, force: f64) -> Vec<InputRange> {
        (self.pose_efforts().into_iter())
            .map(|own| {
                let given = own.rows.iter().map(|row| row.1);
                InputRange::of(&own.keys, own.name.clone(), own.unit, given, force)
            })
            .collect()
    }

    /// The efforts on poses that the optimizer chooses; `first` is the index of the first actuator on poses.
    pub(super) fn pose_controls(&self, first: usize) -> Vec<EffortControl> {
        (self.pose_efforts().iter().enumerate())
            .filter_map(|(index, own)| own.keys.of_task(first + index))
            .collect()
    }
}

impl Keys<'_> {
    /// Checks magnets and cables; `names` are those of the other actuators with their keys.
    pub(super) fn check_poses(&self, scene: &Scene, names: &mut Vec<(String, String)>) -> Checked {
        for (index, magnet) in scene.magnet.iter().enumerate() {
            let section = format!("magnet.{index}");
            self.check_magnet(scene, magnet, &section)?;
            names.push((magnet.name(index), section));
        }
        for (index, cable) in scene.cable.iter().enumerate() {
            let key = |name: &str| format!("cable.{index}.{name}");
            self.finite(&key("offset_m"), &cable.offset_m)?;
            self.finite(&key("anchor_m"), &cable.anchor_m)?;
            let rows = cable.profile.as_deref();
            if let Some(rows) = rows {
                self.table(&key("profile"), rows, "a constant tension")?;
            }
            let lowest = [
                cable.tension_n.map(|bounds| bounds[0]),
                Some(cable.pretension_n),
            ];
            let given = rows.iter().flat_map(|rows| rows.iter()).map(|row| row[1]);
            let keys = ["tension_n", "pretension_n", "profile"];
            let mut pushing = (lowest.into_iter().flatten().zip(keys)).collect::<Vec<_>>();
            if cable.tension_n.is_none() {
                pushing = vec![(cable.pretension_n, "pretension_n")];
            }
            pushing.extend(given.map(|tension| (tension, "profile")));
            if let Some((tension, name)) = pushing.iter().find(|(tension, _)| *tension < 0.0) {
                let message = format!("a cable cannot push, with {} N", digits(*tension));
                return Err((self.source)
                    .error_at(&key(name), message, None)
                    .expecting("expected 0 or more"));
            }
            let effort = cable.effort(index);
            self.check_effort(&effort.keys, None)?;
            names.push((effort.name, format!("cable.{index}")));
        }
        Ok(())
    }

    fn check_magnet(&self, scene: &Scene, magnet: &MagnetKeys, section: &str) -> Checked {
        let key = |name: &str| format!("{section}.{name}");
        let [moment, remanence, volume, axis, along, at] =
            given!(magnet: moment_a_m2, remanence_t, volume_m3, axis, along, at);
        self.exactly_one(section, &[moment, remanence])?;
        if let Some(moment) = &magnet.moment_a_m2 {
            self.nonzero(&key("moment_a_m2"), moment)?;
        }
        let rows = [
            Needs(remanence, volume, "goes with remanence_t"),
            Excludes(volume, moment),
            Excludes(axis, moment),
            Excludes(along, at),
        ];
        self.relations(section, &rows)?;
        if let Some(axis) = &magnet.axis {
            self.nonzero(&key("axis"), axis)?;
        }
        if let Some([from, to]) = magnet.along.map(|ends| ends.map(Fraction::get))
            && to <= from
        {
            let message = format!("{} does not come after {}", digits(to), digits(from));
            return Err((self.source)
                .error_at(&key("along"), message, None)
                .expecting("expected [start, end], the end a larger fraction"));
        }
        self.finite(&key("center_m"), &magnet.center_m)?;
        if let Some(rows) = &magnet.profile {
            self.table(&key("profile"), rows, "a constant field")?;
        }
        if let Some(rows) = &magnet.gradient_profile {
            self.table(&key("gradient_profile"), rows, "a constant gradient")?;
        }
        let index = section.rsplit('.').next().and_then(|at| at.parse().ok());
        let index: usize = index.unwrap_or_default();
        if let Some(other) = &magnet.field_of {
            let mut all = scene.magnet.iter().enumerate();
            let found = all.find(|(at, own)| *at != index && own.name(*at) == *other);
            if found.is_none_or(|(_, own)| own.field_of.is_some()) {
                let names = (scene.magnet.iter().enumerate())
                    .filter(|(at, own)| *at != index && own.field_of.is_none())
                    .map(|(at, own)| format!("\"{}\"", own.name(at)));
                let names: Vec<String> = names.collect();
                let message = format!("no magnet with a field of its own is called \"{other}\"");
                return Err((self.source)
                    .error_at(&key("field_of"), message, None)
                    .expecting(match names.is_empty() {
                        true => "expected the name of another magnet".to_string(),
                        false => format!("expected one of {}", names.join(", ")),
                    }));
            }
            let own = given!(magnet: field_t, rate_t_s, rest_field_t, profile, gradient_t_m, gradient_rate_t_m_s,
                rest_gradient_t_m, gradient_profile, center_m);
            let field_of = given!(magnet: field_of);
            return self.relations(section, &own.map(|own| Excludes(own, field_of)));
        }
        let [rate, gradient] = given!(magnet: gradient_rate_t_m_s, gradient_t_m);
        let reason = "goes with gradient_t_m, which makes it a control";
        self.relations(section, &[Needs(rate, gradient, reason)])?;
        (magnet.efforts(index, &[]).iter())
            .try_for_each(|effort| self.check_effort(&effort.keys, None))
    }
}

/// Returns magnets and cables that have these actuators on poses, the first of them with the index `first` among all, with the efforts that
/// are controls; `None` for actuators that no scene has, or in another order.
pub(in crate::scene) fn describing_poses(
    actuators: &[PoseActuator],
    first: usize,
    efforts: &[EffortControl],
) -> Option<(Vec<MagnetKeys>, Vec<CableKeys>)> {
    let control = |at: usize| efforts.iter().find(|own| own.actuator == first + at);
    let controls: Vec<_> = (0..actuators.len()).map(control).collect();
    if controls.iter().flatten().any(|own| own.scale.is_some()) {
        return None;
    }
    let all = DescribedPoses {
        actuators,
        controls,
    };
    let (mut magnets, mut cables) = (Vec::new(), Vec::new());
    let mut at = 0;
    while let Some(own) = actuators.get(at) {
        match own.parts[..] {
            [(Span::At(place), OfPose::Cable(cable))] if cable.offset.z == 0.0 => {
                cables.push(all.cable(at, place, &cable));
                at += 1;
            }
            _ if cables.is_empty() => {
                let (found, n) = all.magnets(at)?;
                magnets.extend(found);
                at += n;
            }
            _ => return None,
        }
    }
    Some((magnets, cables))
}

/// Actuators on poses with their controls, as far as their efforts are controls.
struct DescribedPoses<'a> {
    actuators: &'a [PoseActuator],
    controls: Vec<Option<&'a EffortControl>>,
}

impl DescribedPoses<'_> {
    fn bounds(&self, at: usize) -> Option<[f64; 2]> {
        self.controls[at].map(|control| control.bounds)
    }

    fn rate(&self, at: usize) -> Option<RateBound> {
        self.controls[at].and_then(|control| control.rate.map(RateBound::Each))
    }

    fn rest(&self, at: usize) -> f64 {
        match self.actuators[at].effort[..] {
            [(_, only)] => only,
            _ => 0.0,
        }
    }

    /// Bounds of the components of a field from an index on, if one of them is a control; another one stays at its value.
    fn ranges<const N: usize>(&self, from: usize) -> Option<[[f64; 2]; N]> {
        let range = |i| (self.bounds(from + i)).unwrap_or([self.rest(from + i); 2]);
        let any = (from..from + N).any(|at| self.controls[at].is_some());
        any.then(|| std::array::from_fn(range))
    }

    fn cable(&self, at: usize, place: Place, cable: &mechanics::Cable) -> CableKeys {
        let own = &self.actuators[at];
        let rows = own.effort.iter().map(|&(t, effort)| [t, effort]).collect();
        CableKeys {
            name: Some(own.name.clone()).filter(|name| !name.is_empty()),
            at: known(place.fraction()),
            offset_m: [cable.offset.x, cable.offset.y],
            anchor_m: cable.anchor.into(),
            tension_n: self.bounds(at),
            rate_n_s: self.rate(at),
            pretension_n: self.rest(at),
            profile: (own.effort.len() > 1).then_some(rows),
        }
    }

    /// Returns the magnets of the field whose first component has this index, and the number of its components.
    fn magnets(&self, at: usize) -> Option<(Vec<MagnetKeys>, usize)> {
        let name = (self.actuators[at].name.strip_suffix(FIELD[0])?.trim_end()).to_string();
        let are = |at: usize, suffixes: &[&str]| {
            suffixes.iter().enumerate().all(|(i, suffix)| {
                let own = self.actuators.get(at + i);
                own.is_some_and(|own| own.name == format!("{name} {suffix}"))
            })
        };
        if !are(at, &FIELD) {
            return None;
        }
        let has_gradient = are(at + 3, &GRADIENT);
        let n = if has_gradient { 8 } else { 3 };
        let group = &self.actuators[at..at + n];
        let parts = parts_of(group)?;
        let center = parts.first()?.1.center;
        let mut magnets: Vec<MagnetKeys> = (parts.into_iter().enumerate())
            .map(|(i, (span, magnet))| MagnetKeys {
                name: Some(match i {
                    0 => name.clone(),
                    _ => format!("{name} {i}"),
                }),
                field_of: (i > 0).then(|| name.clone()),
                ..MagnetKeys::describing(span, &magnet)
            })
            .collect();
        let owner = magnets.first_mut()?;
        owner.center_m = center.into();
        owner.field_t = self.ranges(at);
        owner.rate_t_s = (at..at + 3).find_map(|at| self.rate(at));
        owner.rest_field_t = [0, 1, 2].map(|i| self.rest(at + i));
        owner.profile = rows_of(&group[..3])?;
        if has_gradient {
            owner.gradient_t_m = self.ranges(at + 3);
            owner.gradient_rate_t_m_s = (at + 3..at + 8).find_map(|at| self.rate(at));
            owner.rest_gradient_t_m = Some([3, 4, 5, 6, 7].map(|i| self.rest(at + i)));
            owner.gradient_profile = rows_of(&group[3..])?;
        }
        Some((magnets, n))
    }
}

impl MagnetKeys {
    /// Returns the keys of a magnet in no field.
    fn describing(span: Span, magnet: &mechanics::Magnet) -> Self {
        let (at, along) = match span {
            Span::At(place) => (Some(known(place.fraction())), None),
            Span::Along(from, to) => (None, Some([known(from), known(to)])),
        };
        Self {
            name: None,
            at,
            along,
            moment_a_m2: Some(magnet.moment.into()),
            remanence_t: None,
            volume_m3: None,
            axis: None,
            field_of: None,
            field_t: None,
            rate_t_s: None,
            rest_field_t: [0.0; 3],
            profile: None,
            gradient_t_m: None,
            gradient_rate_t_m_s: None,
            rest_gradient_t_m: None,
            gradient_profile: None,
            center_m: [0.0; 3],
        }
    }
}

/// The magnets of the efforts of one field, if each of them has every effort as [`MagnetKeys::in_field`] does.
fn parts_of(group: &[PoseActuator]) -> Option<Vec<(Span, mechanics::Magnet)>> {
    let first = group.first()?;
    let magnets: Option<Vec<_>> = (first.parts.iter())
        .map(|(span, function)| match function {
            OfPose::Magnet(magnet) => Some((*span, *magnet)),
            OfPose::Cable(_) | OfPose::Own(_) => None,
        })
        .collect();
    let magnets = magnets?;
    let center = magnets.first()?.1.center;
    for (component, own) in group.iter().enumerate() {
        let (field, gradient) = unit_field(component);
        let expected: Vec<_> = (magnets.iter())
            .map(|&(span, magnet)| {
                let in_field = mechanics::Magnet {
                    field,
                    gradient,
                    center,
                    ..magnet
                };
                (span, OfPose::Magnet(in_field))
            })
            .collect();
        if own.parts != expected {
            return None;
        }
    }
    Some(magnets)
}

/// Rows of given efforts, times and values, if they are at the same times: `Some(None)` for constant ones, `None` for others.
#[expect(
    clippy::option_option,
    reason = "no rows, and no rows that a scene has"
)]
fn rows_of<const N: usize>(group: &[PoseActuator]) -> Option<Option<Vec<[f64; N]>>> {
    if group.iter().all(|own| own.effort.len() <= 1) {
        return Some(None);
    }
    let times = |own: &PoseActuator| own.effort.iter().map(|row| row.0).collect::<Vec<_>>();
    if !group.iter().all(|own| times(own) == times(&group[0])) {
        return None;
    }
    let row = |(row, (t, _)): (usize, &(f64, f64))| {
        std::array::from_fn(|i| i.checked_sub(1).map_or(*t, |i| group[i].effort[row].1))
    };
    Some(Some(group[0].effort.iter().enumerate().map(row).collect()))
}
