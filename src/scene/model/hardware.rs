//! Actuators that are built into the arm: tendons, chambers, muscles.

mod describing;
mod effort;
mod friction;
mod line;
mod range;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use self::describing::Described;
pub(in crate::scene) use self::describing::describe_hardware;
pub(super) use self::effort::EffortKeys;
pub use self::effort::{FollowKeys, RateBound};
pub use self::friction::Sliding;
use self::friction::{default_sliding, is_default_sliding};
pub use self::line::Offset;
pub use self::range::{InputError, InputRange, InputRanges};
use super::super::keys::{Checked, Excludes, Keys, Needs, given, given_of};
use super::super::values::{self, Fraction, NonNegative, Positive, digits, known};
use super::Scene;
use crate::control::Hold;
use crate::mechanics::{Density, Friction, Route, StrainActuator, Winch};
use crate::task::{EffortControl, Follows};

/// Writes the section of a kind of actuators: name, keys of its own, those of its line and of its effort, and more of its own. The words are the
/// name of the effort, the same at the beginning of a sentence, and its unit.
macro_rules! actuator {
    (
        $(#[$about:meta])*
        $Kind:ident = $section:literal;
        own { $($(#[$own_about:meta])* $own:ident: $Own:ty,)* }
        line {
            $(#[$offset:meta])* offset_m,
            $(#[$offset_to:meta])* offset_to_m,
            $(#[$turns:meta])* turns,
        }
        effort $effort:literal, $Effort:literal, $unit:literal {
            $(#[$bounds_about:meta])* $bounds:ident,
            $rate:ident in $rate_unit:literal,
            $(#[$lag:meta])* lag_s,
            $rest:ident,
        }
        more { $($(#[$more_about:meta])* $more:ident: $More:ty,)* }
    ) => {
        $(#[$about])*
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(deny_unknown_fields)]
        pub struct $Kind {
            #[doc = concat!("Name in results, one for each actuator. Absent: the word ", $section, " with its place in the list, from 0.")]
            pub name: Option<String>,
            $($(#[$own_about])* pub $own: $Own,)*
            $(#[$offset])*
            pub offset_m: Offset,
            $(#[$offset_to])*
            pub offset_to_m: Option<[f64; 2]>,
            $(#[$turns])*
            #[serde(default)]
            pub turns: f64,
            /// Start, as a fraction of `rod.length_m` from the base. Default: 0, the base.
            #[serde(default)]
            pub from: Fraction,
            /// End, as a fraction, after `from`. Default: 1, the tip.
            #[serde(default = "Fraction::one")]
            pub to: Fraction,
            $(#[$bounds_about])*
            pub $bounds: Option<[f64; 2]>,
            #[doc = concat!(
                "Largest rate of the ", $effort, " in ", $rate_unit, ", or the fastest fall, negative, and the fastest rise. With it the ",
                $effort, " begins at"
            )]
            #[doc = concat!("`", stringify!($rest), "`. Absent: it may jump.")]
            pub $rate: Option<RateBound>,
            $(#[$lag])*
            pub lag_s: Option<Positive<values::Time>>,
            /// Another actuator, the control of which drives this one too, as a motor that pulls one tendon in and lets another out. It has bounds of its
            /// own, which the control keeps as well. Absent: a control of its own.
            pub follows: Option<FollowKeys>,
            #[doc = concat!($Effort, $unit, " before the task begins, within the bounds, from which effort is counted. Default: 0.")]
            #[serde(default)]
            pub $rest: f64,
            #[doc = concat!(
                "Given ", $effort, " over time, as [t in s, ", $effort, $unit,
                "] with increasing t; linear in between and constant outside. It does not go with"
            )]
            #[doc = concat!("`", stringify!($bounds), "`.")]
            pub profile: Option<Vec<[f64; 2]>>,
            $($(#[$more_about])* pub $more: $More,)*
        }

        impl $Kind {
            /// Collects the keys that all kinds share.
            fn common(&self, index: usize, density: Density, scale: f64) -> Common<'_> {
                Common {
                    effort: EffortKeys {
                        section: $section,
                        index,
                        component: None,
                        bounds: (stringify!($bounds), self.$bounds),
                        rate: (stringify!($rate), self.$rate),
                        rest: (stringify!($rest), self.$rest),
                        profile: ("profile", self.profile.is_some()),
                        lag: self.lag_s.map(Positive::get),
                        winch: None,
                    },
                    name: &self.name,
                    routes: self.offset_m.routes(
                        [self.from.get(), self.to.get()],
                        self.offset_to_m,
                        self.turns,
                    ),
                    offset: (&self.offset_m, self.offset_to_m),
                    turns: self.turns,
                    density,
                    scale,
                    friction: None,
                    profile: &self.profile,
                    follows: &self.follows,
                }
            }

            /// Returns the section with these keys, and with those of its own in their order.
            #[allow(clippy::too_many_arguments, reason = "a kind may have many keys of its own")]
            fn describing(common: Described, $($own: $Own,)* $($more: $More,)*) -> Self {
                let Described { name, route, further, bounds, rate, lag_s, follows, rest, profile } = common;
                Self {
                    name,
                    $($own,)*
                    offset_m: match further.is_empty() {
                        true => Offset::Same(route.offset_from),
                        false => Offset::of_routes(std::iter::once(&route).chain(&further)),
                    },
                    offset_to_m: (further.is_empty() && route.offset_to != route.offset_from)
                        .then_some(route.offset_to),
                    turns: route.turns,
                    from: known(route.from),
                    to: known(further.last().unwrap_or(&route).to),
                    $bounds: bounds,
                    $rate: rate,
                    lag_s,
                    follows,
                    $rest: rest,
                    profile,
                    $($more,)*
                }
            }
        }
    };
}

actuator! {
    /// A tendon in the arm, or a rod in it that pushes: its line lies in the section and moves with it, without friction unless `friction` is
    /// given. A tendon pulls the
    /// section toward itself with the work of its tension as it gets shorter. With `tension_n` its tension is a control, with `profile` it is
    /// given, in simulations too. On a winch its length is the input instead, and the tension follows from its stretch: with `displacement_m` as a control, with
    /// `displacement_profile` given.
    Tendon = "tendon";
    own {}
    line {
        /// Place in the section at `from`, along its two axes, in m. Or rows [fraction of the length from 0 to 1, x, y], linear in between and constant
        /// outside; two rows at one fraction are a jump, as from one hole of a disk to another.
        offset_m,
        /// Place in the section at `to`, reached linearly, in m. Absent: `offset_m`.
        offset_to_m,
        /// Revolutions about the arm's axis from `from` to `to`, positive about +e3. Default: 0, parallel to the axis.
        turns,
    }
    effort "tension", "Tension", " in N" {
        /// Least and largest tension in N, which makes it a control; `inf` and `-inf` are no bounds, and a negative tension is that of a rod that
        /// pushes. Absent: the tension is given.
        tension_n,
        rate_n_s in "N/s",
        /// Time constant in s of the first-order lag with which the tension follows the command of its motor. With it the bounds hold for the
        /// command, the tension plus its rate times the lag, and the tension begins at `pretension_n`; not with `control.hold` = "constant".
        /// Absent: the tension is the command.
        lag_s,
        pretension_n,
    }
    more {
        /// Least and largest displacement of a winch in m, which makes it a control; where it is negative, the winch has pulled in. The least one
        /// is finite. With the length l of the tendon in the arm, l0 that in the arm at rest, the length b outside of it, and the displacement
        /// z, `l + b = (l0 + b + z)(1 + C T)`; where that would be a negative tension T, the tendon is slack. Not with keys of the tension, nor
        /// with `control.hold` = "constant"; the winch begins at `rest_displacement_m`.
        displacement_m: Option<[f64; 2]>,
        /// Largest speed of a winch in m/s, or the fastest way in, negative, and the fastest way out. Absent: unbounded.
        rate_m_s: Option<RateBound>,
        /// Displacement of a winch in m before the task begins, within the bounds, from which effort is counted. Default: 0.
        #[serde(default, skip_serializing_if = "values::is_default")]
        rest_displacement_m: f64,
        /// Given displacement of a winch over time, as [t in s, displacement in m] with increasing t; linear in between and constant outside. It
        /// does not go with `displacement_m`.
        displacement_profile: Option<Vec<[f64; 2]>>,
        /// Compliance C of the tendon on a winch in 1/N: its strain per tension.
        compliance_1_n: Option<Positive<values::TendonCompliance>>,
        /// Length b of the tendon on a winch outside of the arm in m, which stretches too. Default: 0.
        #[serde(default, skip_serializing_if = "values::is_default")]
        free_length_m: NonNegative<values::Length>,
        /// Distance in m of disks through which the tendon runs, straight from one to the next: where the arm bends by the curvature κ, it is
        /// shorter than its line in the section by κ² s²/24 of its length; at most the length along the arm from `from` to `to`. Default: 0, a
        /// channel along the whole arm.
        #[serde(default, skip_serializing_if = "values::is_default")]
        disk_spacing_m: NonNegative<values::Length>,
        /// Distance c in m by which the holes of the disks are wider than the tendon on every side; goes with `disk_spacing_m`. A pulled tendon lies
        /// on the side to which the arm bends, and its way is shorter by c times the curvature there, above a curvature of 8 c/s². Default: 0.
        #[serde(default, skip_serializing_if = "values::is_default")]
        hole_clearance_m: NonNegative<values::Length>,
        /// Coefficient of friction along the path: where the path has turned by the angle φ, the tension is by a factor `exp(-friction φ)` less
        /// than at the motor if the tendon is pulled in, and by the inverse more if it is let out. Motions of such an arm have implicit steps.
        /// Default: 0, without friction.
        #[serde(default, skip_serializing_if = "values::is_default")]
        friction: NonNegative<values::Factor>,
        /// Speed w in m/s at which friction acts by three quarters: where the tendon slides by v, it acts by `tanh(v/w)`. Below it a tendon creeps
        /// that in truth would stick. Default: 0.001.
        #[serde(default = "default_sliding", skip_serializing_if = "is_default_sliding")]
        sliding_speed_m_s: Positive<values::SlidingSpeed>,
        /// Direction in which the tendon slid before it came to rest, for equilibria: "pulled", "released", or "none" for a shape to which it
        /// has crept. Solves and closed loops hold an arm where it has crept to. Absent: "pulled".
        sliding: Option<Sliding>,
    }
}

impl Tendon {
    /// Tells whether its input is the displacement of a winch.
    fn is_on_winch(&self) -> bool {
        self.displacement_m.is_some() || self.displacement_profile.is_some()
    }

    /// Collects the keys of its tension, or else those of its winch.
    fn of_tension_or_winch(&self, index: usize) -> Common<'_> {
        let spacing = self.disk_spacing_m.get();
        let density = if spacing > 0.0 {
            let clearance = self.hole_clearance_m.get();
            Density::Threaded { spacing, clearance }
        } else {
            Density::Shortening
        };
        let by_tension = Common {
            friction: self.rubs(),
            ..self.common(index, density, 1.0)
        };
        if !self.is_on_winch() {
            return by_tension;
        }
        Common {
            effort: EffortKeys {
                bounds: ("displacement_m", self.displacement_m),
                rate: ("rate_m_s", self.rate_m_s),
                rest: ("rest_displacement_m", self.rest_displacement_m),
                profile: ("displacement_profile", self.displacement_profile.is_some()),
                winch: self.compliance_1_n.map(|compliance| Winch {
                    compliance: compliance.get(),
                    outside: self.free_length_m.get(),
                }),
                ..by_tension.effort
            },
            profile: &self.displacement_profile,
            ..by_tension
        }
    }

    /// Makes the effort the displacement of a winch.
    fn put_on(self, winch: Winch) -> Self {
        Self {
            tension_n: None,
            rate_n_s: None,
            pretension_n: 0.0,
            profile: None,
            displacement_m: self.tension_n,
            rate_m_s: self.rate_n_s,
            rest_displacement_m: self.pretension_n,
            displacement_profile: self.profile,
            compliance_1_n: Some(known(winch.compliance)),
            free_length_m: known(winch.outside),
            ..self
        }
    }
}

actuator! {
    /// A pneumatic or hydraulic chamber in the arm whose section stays plane and keeps its area. Its pressure lengthens the arm and bends it
    /// away from the chamber. With `pressure_pa` the pressure, above that of the surroundings, is a control, with `profile` it is given, in
    /// simulations too.
    Chamber = "chamber";
    own {
        /// Area of the chamber's section in m².
        area_m2: Positive<values::Area>,
    }
    line {
        /// Centroid of that area in the section at `from`, along its two axes, in m.
        offset_m,
        /// Centroid at `to`, reached linearly, in m. Absent: `offset_m`.
        offset_to_m,
        /// Revolutions about the arm's axis from `from` to `to`, positive about +e3. Default: 0.
        turns,
    }
    effort "pressure", "Pressure", " in Pa" {
        /// Least and largest pressure in Pa, which makes it a control; `inf` and `-inf` are no bounds. Absent: the pressure is given.
        pressure_pa,
        rate_pa_s in "Pa/s",
        /// Time constant in s of the first-order lag with which the pressure follows the command of its valve. With it the bounds hold for the
        /// command, the pressure plus its rate times the lag, and the pressure begins at `rest_pressure_pa`; not with `control.hold` = "constant".
        /// Absent: the pressure is the command.
        lag_s,
        rest_pressure_pa,
    }
    more {}
}

actuator! {
    /// A muscle in the arm, by the relation of active force and length of COOMM: a force `activation · stress_pa · area_m2 · w` along its
    /// fibre, with `w = 3.06 λ³ - 13.64 λ² + 18.01 λ - 6.44` where that is positive and the fibre's stretch `λ` below 1.6, otherwise 0. With
    /// `activation` the activation is a control, with `profile` it is given, in simulations too.
    Muscle = "muscle";
    own {
        /// Area of the muscle's section in m².
        area_m2: Positive<values::Area>,
        /// Largest active stress in Pa.
        stress_pa: Positive<values::ActiveStress>,
    }
    line {
        /// Place in the section at `from`, along its two axes, in m. Or rows [fraction of the length from 0 to 1, x, y], linear in between and constant
        /// outside; two rows at one fraction are a jump, as from one hole of a disk to another.
        offset_m,
        /// Place in the section at `to`, reached linearly, in m. Absent: `offset_m`.
        offset_to_m,
        /// Revolutions about the arm's axis from `from` to `to`, positive about +e3. Default: 0.
        turns,
    }
    effort "activation", "Activation", "" {
        /// Least and largest activation, which makes it a control, usually [0, 1]. Absent: the activation is given.
        activation,
        rate_1_s in "1/s",
        /// Time constant in s of the first-order lag with which the activation follows the command of its nerve. With it the bounds hold for the
        /// command, the activation plus its rate times the lag, and the activation begins at `rest_activation`; not with `control.hold` = "constant".
        /// Absent: the activation is the command.
        lag_s,
        rest_activation,
    }
    more {}
}

actuator! {
    /// A McKibben muscle or another tube with a braid of fibres that do not stretch (Chou and Hannaford 1996). Its pressure does the work of
    /// the volume inside: with a fibre `fibre` times as long as its line and `turns_1_m` turns of it, that is `π λ (fibre² - λ²)/(2π turns_1_m + κ)²`
    /// per length at the stretch λ of the line and the twist κ. It pulls by `pressure (3 λ² - fibre²)/(4π turns_1_m²)`, so that it shortens below
    /// an angle of 54.7 degrees between fibres and line and lengthens above it, and it twists the arm. Fibres that are wound both ways are two
    /// braids with opposite turns, each with half of the pressure; together they do not twist it. With `pressure_pa` the pressure, above that of
    /// the surroundings, is a control, with `profile` it is given, in simulations too.
    Braid = "braid";
    own {
        /// Length of a fibre over that of the line that it is wound about, above 1. The radius of the braid at rest is
        /// `sqrt(fibre² - 1)/(2π turns_1_m)`.
        fibre: Positive<values::Factor>,
        /// Turns of a fibre per length of the line in 1/m, not 0, positive about +e3.
        turns_1_m: f64,
    }
    line {
        /// Place of the line in the section at `from`, along its two axes, in m. Default: the center.
        #[serde(default)]
        offset_m,
        /// Place at `to`, reached linearly, in m. Absent: `offset_m`.
        offset_to_m,
        /// Revolutions of the line about the arm's axis from `from` to `to`, positive about +e3. Default: 0.
        turns,
    }
    effort "pressure", "Pressure", " in Pa" {
        /// Least and largest pressure in Pa, which makes it a control; `inf` and `-inf` are no bounds. Absent: the pressure is given.
        pressure_pa,
        rate_pa_s in "Pa/s",
        /// Time constant in s of the first-order lag with which the pressure follows the command of its valve, as that of a chamber.
        /// Absent: the pressure is the command.
        lag_s,
        rest_pressure_pa,
    }
    more {}
}

/// The keys that all actuators on strains share.
struct Common<'a> {
    effort: EffortKeys,
    name: &'a Option<String>,
    /// The parts of its line, one at least.
    routes: Vec<Route>,
    /// The keys of its line: offsets, and that at the end.
    offset: (&'a Offset, Option<[f64; 2]>),
    turns: f64,
    density: Density,
    scale: f64,
    friction: Option<Friction>,
    profile: &'a Option<Vec<[f64; 2]>>,
    follows: &'a Option<FollowKeys>,
}

impl Common<'_> {
    fn name(&self) -> String {
        let EffortKeys { section, index, .. } = self.effort;
        (self.name.clone()).unwrap_or_else(|| format!("{section} {index}"))
    }

    /// Where its line begins and ends.
    fn span(&self) -> [f64; 2] {
        [self.routes[0].from, self.routes[self.routes.len() - 1].to]
    }

    fn of_arm(&self) -> StrainActuator {
        let rows = self.profile.iter().flatten();
        let given: Vec<(f64, f64)> = rows.map(|&[t, effort]| (t, effort)).collect();
        StrainActuator {
            name: self.name(),
            density: self.density.clone(),
            scale: self.scale,
            route: self.routes[0],
            further: self.routes[1..].to_vec(),
            effort: if given.is_empty() {
                vec![(0.0, self.effort.rest.1)]
            } else {
                given
            },
            winch: self.effort.winch,
            friction: self.friction,
            largest: self.effort.largest(),
        }
    }
}

/// Sections of actuators in the arm, in their order along the inputs of a simulation.
pub(in crate::scene) const SECTIONS: [&str; 4] = ["tendon", "chamber", "muscle", "braid"];

/// Distance of an actuator from the axis, in lengths of the arm, above which it is probably a mistake.
const FAR_ASIDE: f64 = 0.25;

impl Scene {
    /// Describes the actuators whose lines are too far from the axis of the arm.
    pub(crate) fn far_aside(&self) -> Vec<String> {
        let length = self.rod.length_m.get();
        self.routes()
            .filter_map(|(key, routes)| {
                let ends = routes.iter().flat_map(|own| [own.offset_from, own.offset_to]);
                let far = ends.map(|[x, y]| x.hypot(y)).fold(0.0, f64::max) / length;
                (far > FAR_ASIDE).then(|| {
                    format!(
                        "{key}.offset_m: {far:.3e} lengths of the arm beside its axis are hardly meant (at most {FAR_ASIDE}); look for a unit \
                         that was mistaken"
                    )
                })
            })
            .collect()
    }

    /// The keys of the actuators in the arm, and the lines along which they lie.
    pub(crate) fn routes(&self) -> impl Iterator<Item = (String, Vec<Route>)> {
        (self.hardware().into_iter()).map(|own| {
            let EffortKeys { section, index, .. } = own.effort;
            (format!("{section}.{index}"), own.routes)
        })
    }

    /// The actuators in the arm, in the order of [`SECTIONS`].
    fn hardware(&self) -> Vec<Common<'_>> {
        let tendons =
            (self.tendon.iter().enumerate()).map(|(index, own)| own.of_tension_or_winch(index));
        let chambers = (self.chamber.iter().enumerate())
            .map(|(index, own)| own.common(index, Density::Volume, own.area_m2.get()));
        let muscles = (self.muscle.iter().enumerate()).map(|(index, own)| {
            let scale = own.area_m2.get() * own.stress_pa.get();
            own.common(index, Density::Muscle, scale)
        });
        let braids = (self.braid.iter().enumerate()).map(|(index, own)| {
            let (fibre, turns) = (own.fibre.get(), own.turns_1_m);
            own.common(index, Density::Braid { fibre, turns }, 1.0)
        });
        (tendons.chain(chambers))
            .chain(muscles)
            .chain(braids)
            .collect()
    }

    /// Returns the index among the actuators of the arm of the one of a section with a name; whether its effort is a control; and its effort
    /// at rest.
    pub(in crate::scene) fn hardware_named(
        &self,
        section: &str,
        name: &str,
    ) -> Option<(usize, bool, f64)> {
        let all = self.hardware();
        let index =
            (all.iter()).position(|own| own.effort.section == section && own.name() == name)?;
        let own = &all[index].effort;
        Some((index, own.bounds.1.is_some(), own.rest.1))
    }

    /// Returns the lags of the actuators on strains, s; of one that follows another, that of the other.
    pub(in crate::scene) fn lags(&self) -> Vec<Option<f64>> {
        let all = self.hardware();
        let leader = |own: &Common| {
            let keys = own.follows.as_ref()?;
            all.iter().find(|other| other.name() == keys.name)
        };
        (all.iter())
            .map(|own| leader(own).unwrap_or(own).effort.lag)
            .collect()
    }

    /// Returns the names of the actuators of a section.
    pub(in crate::scene) fn hardware_names(&self, section: &str) -> Vec<String> {
        let all = self.hardware();
        let own = all.iter().filter(|own| own.effort.section == section);
        own.map(Common::name).collect()
    }

    /// Returns the names of all actuators on strains.
    pub(super) fn strain_names(&self) -> Vec<String> {
        self.hardware().iter().map(Common::name).collect()
    }

    /// The actuators of the arm.
    pub(in crate::scene) fn strain_actuators(&self) -> Vec<StrainActuator> {
        self.hardware().iter().map(Common::of_arm).collect()
    }

    /// The efforts that the optimizer chooses.
    pub(crate) fn effort_controls(&self) -> Vec<EffortControl> {
        let strains = self.hardware();
        let index_of = |name: &str| strains.iter().position(|own| own.name() == name);
        let mut out: Vec<EffortControl> = (strains.iter().enumerate())
            .filter_map(|(index, own)| {
                let follows = own.follows.as_ref().and_then(|keys| {
                    let actuator = index_of(&keys.name)?;
                    let gain = keys.gain;
                    Some(Follows { actuator, gain })
                });
                let control = own.effort.of_task(index)?;
                Some(EffortControl { follows, ..control })
            })
            .collect();
        out.extend(self.pose_controls(strains.len()));
        out
    }
}

impl Keys<'_> {
    /// Checks all actuators in the arm.
    pub(in crate::scene) fn check_hardware(&self, scene: &Scene) -> Checked {
        for (index, tendon) in scene.tendon.iter().enumerate() {
            self.check_winch(&format!("tendon.{index}"), tendon)?;
            self.check_friction(index, tendon, scene)?;
            self.check_disks(index, tendon, scene)?;
        }
        for (index, braid) in scene.braid.iter().enumerate() {
            if braid.turns_1_m == 0.0 || !braid.turns_1_m.is_finite() {
                let key = format!("braid.{index}.turns_1_m");
                return Err(self.out_of_range(&key, braid.turns_1_m, "number other than 0", "1/m"));
            }
            if !(braid.fibre.get() > 1.0) {
                let key = format!("braid.{index}.fibre");
                let expected = "number above 1, since a wound fibre is longer than its line";
                return Err(self.out_of_range(&key, braid.fibre.get(), expected, ""));
            }
        }
        let hold = scene.control.as_ref().map(|control| control.hold);
        let mut names = Vec::new();
        let all = scene.hardware();
        for own in &all {
            self.check_common(own, hold)?;
            self.check_follower(own, &all)?;
            let EffortKeys { section, index, .. } = own.effort;
            names.push((own.name(), format!("{section}.{index}")));
        }
        self.check_poses(scene, &mut names)?;
        for (at, (name, key)) in names.iter().enumerate() {
            if let Some((_, other)) = names[..at].iter().find(|(other, _)| other == name) {
                let message = format!("its name, \"{name}\", is that of {other}");
                let help = "give every actuator a name of its own";
                return Err(self.source.error_at(key, message, Some(help.into())));
            }
        }
        Ok(())
    }

    /// Checks that a tendon has either the keys of a tension or those of a winch.
    fn check_winch(&self, section: &str, tendon: &Tendon) -> Checked {
        let key = |name: &str| format!("{section}.{name}");
        if !tendon.is_on_winch() {
            let of_winch =
                given!(tendon: compliance_1_n, free_length_m, rate_m_s, rest_displacement_m);
            if let Some(name) = given_of(&of_winch).next() {
                let relation = format!(
                    "{name} describes the tendon of a winch, whose input is displacement_m or displacement_profile"
                );
                return Err(self.missing(&key("displacement_m"), &relation));
            }
            return Ok(());
        }
        let [displacement, profile] = given!(tendon: displacement_m, displacement_profile);
        let input = if displacement.1 {
            displacement
        } else {
            profile
        };
        let of_tension = given!(tendon: tension_n, rate_n_s, pretension_n, profile);
        self.relations(section, &of_tension.map(|own| Excludes(input, own)))?;
        if let Some([least, _]) = tendon.displacement_m
            && !least.is_finite()
        {
            let message = "a winch that pulls in without end";
            return Err((self.source)
                .error_at(&key("displacement_m.0"), message, None)
                .expecting("expected a finite displacement, negative where it has pulled in"));
        }
        let reason = "the tension on a winch follows from the stretch of the tendon";
        self.relations(
            section,
            &[Needs(input, given!(tendon: compliance_1_n), reason)],
        )
    }

    /// Checks that the actuator which another one follows has a control of its own.
    fn check_follower(&self, own: &Common, all: &[Common]) -> Checked {
        let EffortKeys { section, index, .. } = own.effort;
        let Some(FollowKeys { name, gain }) = &own.follows else {
            return Ok(());
        };
        let key = |name: &str| format!("{section}.{index}.{name}");
        if *gain == 0.0 || !gain.is_finite() {
            return Err(self.out_of_range(&key("follows.gain"), *gain, "number other than 0", ""));
        }
        let reason =
            "an actuator that follows another one has bounds of its own, which may be infinite";
        let (follows, bounds) = (
            ("follows", true),
            (own.effort.bounds.0, own.effort.range().is_some()),
        );
        let lag = ("lag_s", own.effort.lag.is_some());
        let rows = [Needs(follows, bounds, reason), Excludes(lag, follows)];
        self.relations(&format!("{section}.{index}"), &rows)?;
        let leads = |other: &&Common| {
            other.effort.range().is_some() && other.follows.is_none() && other.name() != own.name()
        };
        if all.iter().filter(leads).any(|other| other.name() == *name) {
            return Ok(());
        }
        let message = match all.iter().any(|other| other.name() == *name) {
            true => format!("the effort of \"{name}\" is no control of its own"),
            false => format!("no actuator in the arm is named \"{name}\""),
        };
        let names: Vec<String> = all.iter().filter(leads).map(Common::name).collect();
        let help = match names.is_empty() {
            true => "give the bounds of its effort to the actuator that should lead".into(),
            false => format!("it may follow {}", names.join(", ")),
        };
        Err((self.source).error_at(&key("follows.name"), message, Some(help)))
    }

    fn check_common(&self, own: &Common, hold: Option<Hold>) -> Checked {
        let EffortKeys { section, index, .. } = own.effort;
        let key = |name: &str| format!("{section}.{index}.{name}");
        self.check_line(&format!("{section}.{index}"), own)?;
        self.part(&format!("{section}.{index}"), own.span())?;
        if let Some(rows) = own.profile {
            self.table(&key(own.effort.profile.0), rows, "a constant effort")?;
        }
        self.check_effort(&own.effort, hold)
    }

    /// Checks bounds, rate, rest and profile of an effort against each other.
    pub(super) fn check_effort(&self, own: &EffortKeys, hold: Option<Hold>) -> Checked {
        let EffortKeys { section, index, .. } = own;
        let key = |name: &str| format!("{section}.{index}.{name}");
        let part = |name: &str| match own.component {
            Some(component) => format!("{}.{component}", key(name)),
            None => key(name),
        };
        let (rest_key, rest) = own.rest;
        self.finite_number(&part(rest_key), rest)?;
        let (bounds_key, bounds) = own.bounds;
        let (rate_key, rate) = own.rate;
        let goes = format!("goes with {bounds_key}, which makes it a control");
        let lag_goes = format!("lag_s {goes}; a given effort is the one that acts");
        let is_control = (bounds_key, bounds.is_some());
        let rows = [
            Needs((rate_key, rate.is_some()), is_control, &goes),
            Needs(("lag_s", own.lag.is_some()), is_control, &lag_goes),
        ];
        self.relations(&format!("{section}.{index}"), &rows)?;
        let Some([least, most]) = bounds else {
            return Ok(());
        };
        if own.winch.is_some() && hold == Some(Hold::Constant) {
            let message = "a winch does not jump, as a constant hold does";
            let help = "set control.hold to \"linear\" or \"cubic\"";
            return Err((self.source).error_at(&key(bounds_key), message, Some(help.into())));
        }
        if own.lag.is_some() && hold == Some(Hold::Constant) {
            let message = "an effort with a lag does not jump, as a constant hold does";
            let help = "set control.hold to \"linear\" or \"cubic\", or leave lag_s out";
            return Err((self.source).error_at(&key("lag_s"), message, Some(help.into())));
        }
        self.relations(
            &format!("{section}.{index}"),
            &[Excludes(own.profile, is_control)],
        )?;
        let fixed = own.component.is_some() && least == most && least.is_finite();
        if !(least < most || fixed) {
            let message = format!("[{}, {}] is no range", digits(least), digits(most));
            return Err((self.source)
                .error_at(&part(bounds_key), message, None)
                .expecting("expected [least, largest], the second above the first"));
        }
        if !(least <= rest && rest <= most) {
            let message = format!(
                "{} is not within {bounds_key}, [{}, {}]",
                digits(rest),
                digits(least),
                digits(most)
            );
            return Err((self.source)
                .error_at(&part(rest_key), message, None)
                .expecting("expected a value within the bounds"));
        }
        if let Some([down, up]) = rate.map(RateBound::range)
            && !(down < 0.0 && up > 0.0)
        {
            let message = format!(
                "[{}, {}] lets it not change both ways",
                digits(down),
                digits(up)
            );
            return Err((self.source)
                .error_at(&key(rate_key), message, None)
                .expecting(
                    "expected a positive number, or [down, up] with down below 0 and up above 0",
                ));
        }
        Ok(())
    }
}
