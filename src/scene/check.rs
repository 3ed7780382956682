//! Ranges of keys and relations between them that the types of a scene cannot express.

use super::model::{
    Base, BaseKind, BaseMotion, Bound, Continuation, Control, Damping, DistributedLoad,
    FreeDuration, Initial, Limit, Load, LoadNode, Material, Objective, Obstacle, Payload, Price,
    Rod, RodModel, Scene, Section, Solver, Task, Time, TimeStep, Via,
};
use super::{SceneError, SceneSource};
use crate::task::MOST_STEPS;

/// Elements beyond this number are a typing error rather than a wish.
pub(super) const MOST_ELEMENTS: usize = 5000;

/// Blocks and iterations beyond this number are a typing error rather than a wish.
const LARGEST_COUNT: usize = 1_000_000;

/// Stages of a continuation beyond this number are a typing error rather than a wish.
const MOST_STAGES: usize = 1000;

/// A clamped rod may stretch on its way to a target; a strain beyond this is outside what the rod models.
const LARGEST_STRETCH: f64 = 1.3;

impl Scene {
    /// Whether every number is finite and within range, and no key contradicts another; `source` says where they
    /// are written. Whatever was read by [`Scene::load`] or [`Scene::from_toml`] has passed this check.
    pub fn check(&self, source: &SceneSource) -> Result<(), SceneError> {
        let keys = Keys { source };
        keys.check_rod(&self.rod)?;
        keys.check_base(&self.base)?;
        if let Some(gravity) = &self.gravity {
            keys.finite("gravity.acceleration_m_s2", &gravity.acceleration_m_s2)?;
        }
        if let Some(damping) = &self.damping {
            keys.check_damping(damping)?;
        }
        for (index, load) in self.load.iter().enumerate() {
            keys.check_load(load, index, self.rod.elements)?;
        }
        for (index, load) in self.distributed_load.iter().enumerate() {
            keys.check_distributed_load(load, index)?;
        }
        if let Some(payload) = &self.payload {
            keys.check_payload(payload)?;
        }
        if let Some(initial) = &self.initial {
            keys.check_initial(initial, self.base.kind)?;
        }
        keys.check_time(&self.time)?;
        if let Some(task) = &self.task {
            keys.check_task(task, self)?;
        }
        if let Some(control) = &self.control {
            keys.check_control(control, self)?;
        }
        if let Some(objective) = &self.objective {
            keys.check_objective(objective, self)?;
        }
        for (index, obstacle) in self.obstacle.iter().enumerate() {
            keys.check_obstacle(obstacle, index)?;
        }
        for (index, limit) in self.limit.iter().enumerate() {
            keys.check_limit(limit, index, self.rod.elements)?;
        }
        if let Some(solver) = &self.solver {
            keys.check_solver(solver)?;
        }
        if let Some(rate) = self.output.as_ref().and_then(|output| output.rate_hz) {
            keys.positive("output.rate_hz", rate, "rate", "Hz")?;
        }
        Ok(())
    }
}

/// The keys of a scene, by dotted path. Each method names the key that does not hold.
struct Keys<'a> {
    source: &'a SceneSource,
}

type Checked = Result<(), SceneError>;

impl Keys<'_> {
    fn check_rod(&self, rod: &Rod) -> Checked {
        self.positive("rod.length_m", rod.length_m, "length", "meters")?;
        self.count("rod.elements", rod.elements, MOST_ELEMENTS)?;
        match (&rod.material, &rod.section, &rod.stiffness, &rod.inertia) {
            (Some(material), Some(section), None, None) => {
                self.check_material(material)?;
                self.check_section(section)?;
                if rod.display_radius_m.is_some() {
                    return Err(self.contradiction("rod.display_radius_m", "rod.section"));
                }
            }
            (None, None, Some(stiffness), Some(inertia)) => {
                self.positive("rod.stiffness.ea_n", stiffness.ea_n, "stiffness", "N")?;
                self.positive("rod.stiffness.ga_n", stiffness.ga_n, "stiffness", "N")?;
                self.positive(
                    "rod.stiffness.ei_n_m2",
                    stiffness.ei_n_m2,
                    "stiffness",
                    "N m²",
                )?;
                self.positive(
                    "rod.stiffness.gj_n_m2",
                    stiffness.gj_n_m2,
                    "stiffness",
                    "N m²",
                )?;
                self.positive(
                    "rod.inertia.mass_kg_m",
                    inertia.mass_kg_m,
                    "mass per length",
                    "kg/m",
                )?;
                for (axis, rotary) in inertia.rotary_kg_m.into_iter().enumerate() {
                    self.positive(
                        &format!("rod.inertia.rotary_kg_m.{axis}"),
                        rotary,
                        "rotary inertia",
                        "kg m",
                    )?;
                }
                self.positive_if_given(
                    "rod.display_radius_m",
                    rod.display_radius_m,
                    "radius",
                    "meters",
                )?;
            }
            (Some(_), _, Some(_), _) => {
                return Err(self.contradiction("rod.stiffness", "rod.material"));
            }
            (Some(_), _, _, Some(_)) => {
                return Err(self.contradiction("rod.inertia", "rod.material"));
            }
            (_, Some(_), Some(_), _) => {
                return Err(self.contradiction("rod.stiffness", "rod.section"));
            }
            (_, Some(_), _, Some(_)) => {
                return Err(self.contradiction("rod.inertia", "rod.section"));
            }
            (Some(_), None, None, None) => {
                return Err(self.missing("rod.section", "goes with rod.material"));
            }
            (None, Some(_), None, None) => {
                return Err(self.missing("rod.material", "goes with rod.section"));
            }
            (None, None, Some(_), None) => {
                return Err(self.missing("rod.inertia", "goes with rod.stiffness"));
            }
            (None, None, None, Some(_)) => {
                return Err(self.missing("rod.stiffness", "goes with rod.inertia"));
            }
            (None, None, None, None) => {
                return Err(self.missing(
                    "rod.material",
                    "a rod has either rod.material and rod.section, or rod.stiffness and rod.inertia",
                ));
            }
        }
        if let Some(reference) = &rod.reference {
            self.finite("rod.reference.curvature_1_m", &reference.curvature_1_m)?;
            self.positive("rod.reference.stretch", reference.stretch, "stretch", "")?;
        }
        Ok(())
    }

    fn check_material(&self, material: &Material) -> Checked {
        let given = |key: &str, value: Option<f64>| {
            value.ok_or_else(|| self.missing(key, "or else give rod.material.preset"))
        };
        let key = "rod.material.youngs_modulus_pa";
        let youngs_modulus = given(key, material.youngs_modulus())?;
        self.positive(key, youngs_modulus, "Young's modulus", "Pa")?;
        match (material.poisson_ratio, material.shear_modulus_pa) {
            (Some(ratio), None) => {
                if !(ratio > -1.0 && ratio <= 0.5) {
                    let message = format!("{} is not a Poisson's ratio", number(ratio));
                    return Err(self
                        .source
                        .error_at("rod.material.poisson_ratio", message, None)
                        .expecting("expected a number above -1 and up to 0.5"));
                }
            }
            (None, Some(modulus)) => {
                self.positive(
                    "rod.material.shear_modulus_pa",
                    modulus,
                    "shear modulus",
                    "Pa",
                )?;
            }
            (Some(_), Some(_)) => {
                return Err(self.contradiction(
                    "rod.material.shear_modulus_pa",
                    "rod.material.poisson_ratio",
                ));
            }
            (None, None) if material.preset.is_some() => {}
            (None, None) => {
                return Err(self.missing(
                    "rod.material.poisson_ratio",
                    "or else give rod.material.shear_modulus_pa",
                ));
            }
        }
        let key = "rod.material.density_kg_m3";
        self.positive(key, given(key, material.density())?, "density", "kg/m³")?;
        self.positive(
            "rod.material.shear_factor",
            material.shear_factor,
            "factor",
            "",
        )
    }

    fn check_section(&self, section: &Section) -> Checked {
        let places = [
            ("", section.radius_m, section.diameter_m),
            ("base_", section.radius_base_m, section.diameter_base_m),
            ("tip_", section.radius_tip_m, section.diameter_tip_m),
        ];
        let key = |quantity: &str, place: &str| format!("rod.section.{quantity}_{place}m");
        // The keys that are given: what they measure, and where.
        let mut given = Vec::new();
        for (place, radius, diameter) in places {
            for (quantity, value) in [("radius", radius), ("diameter", diameter)] {
                if let Some(value) = value {
                    self.positive(&key(quantity, place), value, quantity, "meters")?;
                    given.push((quantity, place));
                }
            }
        }
        // Only both ends in the same measure go together.
        let together =
            |a: (&str, &str), b: (&str, &str)| a.0 == b.0 && !a.1.is_empty() && !b.1.is_empty();
        for (at, &second) in given.iter().enumerate() {
            if let Some(&first) = given[..at].iter().find(|first| !together(**first, second)) {
                return Err(self.contradiction(&key(second.0, second.1), &key(first.0, first.1)));
            }
        }
        match given[..] {
            [] => Err(self.missing(
                &key("radius", ""),
                "or else give rod.section.radius_base_m and rod.section.radius_tip_m, or diameters",
            )),
            [(quantity, place)] if !place.is_empty() => {
                let other = if place == "base_" { "tip_" } else { "base_" };
                let relation = format!("goes with {}", key(quantity, place));
                Err(self.missing(&key(quantity, other), &relation))
            }
            _ => Ok(()),
        }
    }

    fn check_base(&self, base: &Base) -> Checked {
        self.finite("base.position_m", &base.position_m)?;
        if let Some(direction) = &base.direction {
            self.nonzero("base.direction", direction)?;
        }
        if let Some(roll) = base.roll_rad {
            self.finite_number("base.roll_rad", roll)?;
        }
        if let Some(orientation) = &base.orientation_wxyz {
            self.nonzero("base.orientation_wxyz", orientation)?;
            if base.direction.is_some() {
                return Err(self.contradiction("base.orientation_wxyz", "base.direction"));
            }
            if base.roll_rad.is_some() {
                return Err(self.contradiction("base.orientation_wxyz", "base.roll_rad"));
            }
        }
        match (&base.motion, base.kind) {
            (Some(motion), BaseKind::Driven) => self.check_motion(motion),
            (None, BaseKind::Driven) => Err(self.missing(
                "base.motion",
                "a driven base needs to know how it moves, for example velocity_m_s = [0.1, 0, 0]",
            )),
            (Some(_), BaseKind::Clamped | BaseKind::Free) => Err(self.source.error_at(
                "base.motion",
                "only a driven base has a given motion",
                Some("set base.kind = \"driven\", or leave base.motion out".to_string()),
            )),
            (None, BaseKind::Clamped | BaseKind::Free) => Ok(()),
        }
    }

    fn check_motion(&self, motion: &BaseMotion) -> Checked {
        self.finite("base.motion.velocity_m_s", &motion.velocity_m_s)?;
        self.finite(
            "base.motion.angular_velocity_rad_s",
            &motion.angular_velocity_rad_s,
        )?;
        if let Some(table) = &motion.translation_m {
            self.table("base.motion.translation_m", table, "no translation")?;
        }
        if let Some(table) = &motion.rotation_rad {
            self.table("base.motion.rotation_rad", table, "no rotation")?;
        }
        for (index, oscillation) in motion.oscillation.iter().enumerate() {
            let key = |name: &str| format!("base.motion.oscillation.{index}.{name}");
            self.finite(&key("translation_m"), &oscillation.translation_m)?;
            self.finite(&key("rotation_rad"), &oscillation.rotation_rad)?;
            let frequency = oscillation.frequency_hz;
            self.positive(&key("frequency_hz"), frequency, "frequency", "Hz")?;
            self.finite_number(&key("phase_rad"), oscillation.phase_rad)?;
        }
        Ok(())
    }

    fn check_damping(&self, damping: &Damping) -> Checked {
        self.not_negative(
            "damping.viscous_1_s",
            damping.viscous_1_s,
            "damping rate",
            "1/s",
        )?;
        self.not_negative("damping.internal_s", damping.internal_s, "time", "seconds")
    }

    fn check_load(&self, load: &Load, index: usize, elements: usize) -> Checked {
        self.node(&format!("load.{index}.node"), load.node, elements)?;
        self.finite(&format!("load.{index}.force_n"), &load.force_n)?;
        self.finite(&format!("load.{index}.moment_n_m"), &load.moment_n_m)?;
        load.profile.as_ref().map_or(Ok(()), |profile| {
            self.table(&format!("load.{index}.profile"), profile, "a constant load")
        })
    }

    fn check_distributed_load(&self, load: &DistributedLoad, index: usize) -> Checked {
        let key = |name: &str| format!("distributed_load.{index}.{name}");
        let fraction = |name: &str, value: f64| {
            if (0.0..=1.0).contains(&value) {
                return Ok(());
            }
            Err(self.out_of_range(&key(name), value, "fraction from 0 to 1", ""))
        };
        fraction("from", load.from)?;
        fraction("to", load.to)?;
        if load.to <= load.from {
            let message = format!(
                "{} does not come after from, {}",
                number(load.to),
                number(load.from)
            );
            return Err(self
                .source
                .error_at(&key("to"), message, None)
                .expecting("expected a larger fraction, up to 1 (tip)"));
        }
        self.finite(&key("force_n_per_m"), &load.force_n_per_m)?;
        self.finite(&key("moment_n_m_per_m"), &load.moment_n_m_per_m)?;
        load.profile.as_ref().map_or(Ok(()), |profile| {
            self.table(&key("profile"), profile, "a constant load")
        })
    }

    fn check_payload(&self, payload: &Payload) -> Checked {
        self.not_negative("payload.mass_kg", payload.mass_kg, "mass", "kg")?;
        for (axis, inertia) in payload.inertia_kg_m2.into_iter().enumerate() {
            let key = format!("payload.inertia_kg_m2.{axis}");
            self.not_negative(&key, inertia, "moment of inertia", "kg m²")?;
        }
        Ok(())
    }

    fn check_initial(&self, initial: &Initial, base: BaseKind) -> Checked {
        for (name, velocity) in [
            ("initial.velocity_m_s", &initial.velocity_m_s),
            (
                "initial.angular_velocity_rad_s",
                &initial.angular_velocity_rad_s,
            ),
        ] {
            self.finite(name, velocity)?;
            if *velocity == [0.0; 3] {
                continue;
            }
            let (message, help) = match base {
                BaseKind::Free => continue,
                BaseKind::Clamped => (
                    "a clamped arm cannot start as a moving rigid body",
                    "set base.kind = \"free\", or \"driven\" with a base.motion",
                ),
                BaseKind::Driven => (
                    "an arm on a driven base starts with the velocity of its base",
                    "give the velocity in base.motion",
                ),
            };
            return Err(self.source.error_at(name, message, Some(help.to_string())));
        }
        Ok(())
    }

    /// Rows that begin with an increasing time; `without` is what there is without the table.
    fn table<const N: usize>(&self, key: &str, rows: &[[f64; N]], without: &str) -> Checked {
        if rows.is_empty() {
            let help = format!("leave it out for {without}");
            return Err(self
                .source
                .error_at(key, "a table without points", Some(help)));
        }
        for (point, row) in rows.iter().enumerate() {
            self.finite(&format!("{key}.{point}"), row)?;
        }
        for (point, pair) in rows.windows(2).enumerate() {
            if pair[1][0] <= pair[0][0] {
                let message = format!(
                    "{} s does not come after {} s",
                    number(pair[1][0]),
                    number(pair[0][0])
                );
                return Err(self
                    .source
                    .error_at(&format!("{key}.{}", point + 1), message, None)
                    .expecting("expected increasing times"));
            }
        }
        Ok(())
    }

    fn check_time(&self, time: &Time) -> Checked {
        self.not_negative("time.end_s", time.end_s, "duration", "seconds")?;
        let TimeStep::Seconds(step) = time.step_s else {
            return Ok(());
        };
        self.positive("time.step_s", step, "time step", "seconds")?;
        if time.end_s > 0.0 && step > time.end_s {
            let message = format!(
                "a step of {} s is longer than time.end_s, {} s",
                number(step),
                number(time.end_s)
            );
            return Err(self.source.error_at("time.step_s", message, None));
        }
        if time.end_s / step > MOST_STEPS {
            let message = format!(
                "makes {} steps up to time.end_s, {} s",
                number(time.end_s / step),
                number(time.end_s)
            );
            return Err(self
                .source
                .error_at("time.step_s", message, None)
                .expecting(format!("expected at most {} steps", number(MOST_STEPS))));
        }
        Ok(())
    }

    fn check_task(&self, task: &Task, scene: &Scene) -> Checked {
        if task.position_m.is_none() && task.orientation_wxyz.is_none() {
            return Err(self.missing(
                "task.position_m",
                "or else, or as well, give task.orientation_wxyz",
            ));
        }
        if let Some(position) = &task.position_m {
            self.finite("task.position_m", position)?;
            self.check_reach("task.position_m", position, LoadNode::default(), scene)?;
        }
        if let Some(orientation) = &task.orientation_wxyz {
            self.nonzero("task.orientation_wxyz", orientation)?;
        }
        let end = scene.time.end_s;
        if let Some(instant) = task.at_s {
            self.positive("task.at_s", instant, "instant", "seconds")?;
            if instant > end {
                let message = format!("{} s is after the end of the scene", number(instant));
                return Err(self
                    .source
                    .error_at("task.at_s", message, None)
                    .expecting(format!("expected at most time.end_s, {}", number(end))));
            }
        } else if end == 0.0 {
            let message = "a task cannot be reached in no time";
            return Err(self
                .source
                .error_at("time.end_s", message, None)
                .expecting("expected a positive duration"));
        }
        if let Some(free) = &task.free_duration {
            self.check_free_duration(free, task.instant(end))?;
        }
        self.check_enforcement(
            "task",
            task.hard,
            task.weight,
            [
                (task.tolerance_m, task.position_m.is_some()),
                (task.tolerance_rad, task.orientation_wxyz.is_some()),
            ],
        )?;
        for (key, tolerance, unit) in [
            ("task.tolerance_m_s", task.tolerance_m_s, "m/s"),
            ("task.tolerance_rad_s", task.tolerance_rad_s, "rad/s"),
        ] {
            let Some(tolerance) = tolerance else {
                continue;
            };
            self.not_negative(key, tolerance, "tolerance", unit)?;
            if !task.at_rest {
                return Err(self.contradiction(key, "task.at_rest"));
            }
            if !task.hard {
                return Err(self.contradiction(key, "task.hard"));
            }
        }
        for (index, via) in task.via.iter().enumerate() {
            self.check_via(via, index, task.instant(end), scene)?;
        }
        Ok(())
    }

    fn check_free_duration(&self, free: &FreeDuration, start: f64) -> Checked {
        let key = |name: &str| format!("task.free_duration.{name}");
        self.positive(&key("shortest_s"), free.shortest_s, "duration", "seconds")?;
        self.positive(&key("longest_s"), free.longest_s, "duration", "seconds")?;
        self.not_negative(&key("price"), free.price, "price", "per second")?;
        if free.longest_s < free.shortest_s {
            let message = format!("{} s is below shortest_s", number(free.longest_s));
            return Err(self.source.error_at(&key("longest_s"), message, None));
        }
        if !(free.shortest_s..=free.longest_s).contains(&start) {
            let message = format!("the search begins at {} s, outside", number(start));
            return Err(self
                .source
                .error_at("task.free_duration", message, None)
                .expecting("expected shortest_s and longest_s around task.at_s (or time.end_s)"));
        }
        Ok(())
    }

    fn check_via(&self, via: &Via, index: usize, end: f64, scene: &Scene) -> Checked {
        let key = |name: &str| format!("task.via.{index}.{name}");
        if via.position_m.is_none() && via.orientation_wxyz.is_none() {
            return Err(self.missing(
                &key("position_m"),
                &format!("or else, or as well, give {}", key("orientation_wxyz")),
            ));
        }
        if let Some(orientation) = &via.orientation_wxyz {
            self.nonzero(&key("orientation_wxyz"), orientation)?;
        }
        self.node(&key("node"), via.node, scene.rod.elements)?;
        if let Some(position) = &via.position_m {
            self.finite(&key("position_m"), position)?;
            self.check_reach(&key("position_m"), position, via.node, scene)?;
        }
        self.positive(&key("at_s"), via.at_s, "instant", "seconds")?;
        if via.at_s >= end {
            let message = format!("{} s is not before the task's own time", number(via.at_s));
            return Err(self
                .source
                .error_at(&key("at_s"), message, None)
                .expecting(format!("expected less than {}", number(end))));
        }
        self.check_enforcement(
            &format!("task.via.{index}"),
            via.hard,
            via.weight,
            [
                (via.tolerance_m, via.position_m.is_some()),
                (via.tolerance_rad, via.orientation_wxyz.is_some()),
            ],
        )
    }

    /// `tolerances` in m and rad, each with whether there is anything that it belongs to.
    fn check_enforcement(
        &self,
        section: &str,
        hard: bool,
        weight: Option<f64>,
        tolerances: [(Option<f64>, bool); 2],
    ) -> Checked {
        let key = |name: &str| format!("{section}.{name}");
        self.positive_if_given(&key("weight"), weight, "weight", "")?;
        if hard && weight.is_some() {
            let help = format!(
                "set {} = false to make it a term of the objective",
                key("hard")
            );
            return Err(self.source.error_at(
                &key("weight"),
                "what is hard has no weight",
                Some(help),
            ));
        }
        let names = [
            ("tolerance_m", "position_m", "meters"),
            ("tolerance_rad", "orientation_wxyz", "radians"),
        ];
        for ((name, owner, unit), (tolerance, owned)) in names.into_iter().zip(tolerances) {
            self.positive_if_given(&key(name), tolerance, "tolerance", unit)?;
            if tolerance.is_some() && !owned {
                return Err(self.missing(&key(owner), &format!("goes with {}", key(name))));
            }
            if tolerance.is_some() && !hard {
                return Err(self.contradiction(&key(name), &key("hard")));
            }
        }
        if let Some(angle) = tolerances[1].0
            && angle >= std::f64::consts::PI
        {
            return Err(self.out_of_range(
                &key("tolerance_rad"),
                angle,
                "angle below π",
                "radians",
            ));
        }
        Ok(())
    }

    fn check_obstacle(&self, obstacle: &Obstacle, index: usize) -> Checked {
        self.check_numbers_of_obstacle(obstacle, index)
            .map_err(|error| error.of_item("obstacle", &obstacle.name(index)))
    }

    fn check_numbers_of_obstacle(&self, obstacle: &Obstacle, index: usize) -> Checked {
        let key = |name: &str| format!("obstacle.{index}.{name}");
        let shapes = [
            ("sphere", obstacle.sphere.is_some()),
            ("capsule", obstacle.capsule.is_some()),
            ("half_space", obstacle.half_space.is_some()),
            ("box", obstacle.cuboid.is_some()),
        ];
        self.exactly_one(&format!("obstacle.{index}"), &shapes)?;
        let radius = |shape: &str, radius: f64| {
            self.positive(
                &key(&format!("{shape}.radius_m")),
                radius,
                "radius",
                "meters",
            )
        };
        if let Some(sphere) = &obstacle.sphere {
            self.finite(&key("sphere.center_m"), &sphere.center_m)?;
            radius("sphere", sphere.radius_m)?;
        }
        if let Some(capsule) = &obstacle.capsule {
            self.finite(&key("capsule.from_m"), &capsule.from_m)?;
            self.finite(&key("capsule.to_m"), &capsule.to_m)?;
            radius("capsule", capsule.radius_m)?;
        }
        if let Some(half_space) = &obstacle.half_space {
            self.finite(&key("half_space.point_m"), &half_space.point_m)?;
            self.nonzero(&key("half_space.normal"), &half_space.normal)?;
        }
        if let Some(cuboid) = &obstacle.cuboid {
            self.finite(&key("box.center_m"), &cuboid.center_m)?;
            for (axis, size) in cuboid.size_m.into_iter().enumerate() {
                self.positive(&key(&format!("box.size_m.{axis}")), size, "edge", "meters")?;
            }
            if let Some(orientation) = &cuboid.orientation_wxyz {
                self.nonzero(&key("box.orientation_wxyz"), orientation)?;
            }
        }
        self.not_negative(&key("margin_m"), obstacle.margin_m, "clearance", "meters")?;
        self.check_price(&key("soft"), obstacle.soft)?;
        self.positive_if_given(&key("rate_hz"), obstacle.rate_hz, "rate", "Hz")
    }

    /// Errors say which limit they mean by its name as well: indices count from 0, and readers from 1.
    fn check_limit(&self, limit: &Limit, index: usize, elements: usize) -> Checked {
        self.check_numbers_of_limit(limit, index, elements)
            .map_err(|error| error.of_item("limit", &limit.name()))
    }

    fn check_numbers_of_limit(&self, limit: &Limit, index: usize, elements: usize) -> Checked {
        let key = |name: &str| format!("limit.{index}.{name}");
        let kinds = [
            ("stretch", limit.stretch.is_some()),
            ("curvature_max_1_m", limit.curvature_max_1_m.is_some()),
            ("twist_max_1_m", limit.twist_max_1_m.is_some()),
            ("speed_max_m_s", limit.speed_max_m_s.is_some()),
        ];
        self.exactly_one(&format!("limit.{index}"), &kinds)?;
        if let Some([least, largest]) = limit.stretch {
            self.not_negative(&key("stretch.0"), least, "stretch", "")?;
            self.positive(&key("stretch.1"), largest, "stretch", "")?;
            if largest <= least {
                let message = format!("{} is not above {}", number(largest), number(least));
                return Err(self.source.error_at(&key("stretch.1"), message, None));
            }
        }
        for (name, value, unit) in [
            ("curvature_max_1_m", limit.curvature_max_1_m, "1/m"),
            ("twist_max_1_m", limit.twist_max_1_m, "1/m"),
            ("speed_max_m_s", limit.speed_max_m_s, "m/s"),
        ] {
            self.positive_if_given(&key(name), value, "limit", unit)?;
        }
        if let Some(node) = limit.node {
            self.node(&key("node"), node, elements)?;
            if limit.speed_max_m_s.is_none() {
                return Err(self.missing(&key("speed_max_m_s"), "goes with node"));
            }
        }
        self.check_price(&key("soft"), limit.soft)?;
        self.positive_if_given(&key("rate_hz"), limit.rate_hz, "rate", "Hz")
    }

    fn check_price(&self, key: &str, price: Option<Price>) -> Checked {
        let Some(price) = price else {
            return Ok(());
        };
        self.not_negative(&format!("{key}.linear"), price.linear, "price", "")?;
        self.not_negative(&format!("{key}.quadratic"), price.quadratic, "price", "")?;
        if price.linear == 0.0 && price.quadratic == 0.0 {
            return Err(self
                .source
                .error_at(key, "a violation that costs nothing", None)
                .expecting("expected linear or quadratic above 0"));
        }
        Ok(())
    }

    fn exactly_one(&self, section: &str, keys: &[(&str, bool)]) -> Checked {
        let mut given = keys.iter().filter(|(_, given)| *given);
        match (given.next(), given.next()) {
            (Some(_), None) => Ok(()),
            (Some((first, _)), Some((second, _))) => Err(self.contradiction(
                &format!("{section}.{second}"),
                &format!("{section}.{first}"),
            )),
            _ => {
                let names: Vec<&str> = keys.iter().map(|(name, _)| *name).collect();
                Err(self
                    .source
                    .error_at(section, "nothing is given", None)
                    .expecting(format!("expected one of {}", names.join(", "))))
            }
        }
    }

    fn node(&self, key: &str, node: LoadNode, elements: usize) -> Checked {
        match node {
            LoadNode::Index(node) if node > elements => Err(self
                .source
                .error_at(key, format!("there is no node {node}"), None)
                .expecting(format!("expected 0 (base) to {elements} (tip)"))),
            _ => Ok(()),
        }
    }

    fn check_reach(
        &self,
        key: &str,
        position: &[f64; 3],
        node: LoadNode,
        scene: &Scene,
    ) -> Checked {
        let elements = scene.rod.elements;
        let fraction = node.index(elements) as f64 / elements as f64;
        let stretch = scene
            .rod
            .reference
            .as_ref()
            .map_or(1.0, |reference| reference.stretch.max(1.0));
        let reach = LARGEST_STRETCH * stretch * fraction * scene.rod.length_m;
        let [x, y, z] = std::array::from_fn(|axis| position[axis] - scene.base.position_m[axis]);
        let distance = x.hypot(y).hypot(z);
        if scene.base.kind == BaseKind::Clamped && distance > reach {
            let message = format!("{} m from the base is out of reach", rounded(distance));
            let help = format!(
                "rod.length_m is {} and base.position_m is the clamped end",
                number(scene.rod.length_m)
            );
            return Err(self
                .source
                .error_at(key, message, Some(help))
                .expecting(format!(
                    "expected at most {} m, the largest reach of {}",
                    rounded(reach),
                    match node.index(elements) {
                        tip if tip == elements => "this arm".to_string(),
                        node => format!("node {node}"),
                    }
                )));
        }
        Ok(())
    }

    fn check_control(&self, control: &Control, scene: &Scene) -> Checked {
        self.count("control.blocks", control.blocks, LARGEST_COUNT)?;
        self.check_bounds("control", control.force_max_n, control.moment_max_n_m)?;
        for (key, bound, unit) in [
            (
                "control.force_rate_max_n_s",
                control.force_rate_max_n_s,
                "N/s",
            ),
            (
                "control.moment_rate_max_n_m_s",
                control.moment_rate_max_n_m_s,
                "N m/s",
            ),
        ] {
            match bound {
                None => {}
                Some(Bound::Norm(norm)) => self.positive(key, norm, "rate", unit)?,
                Some(Bound::PerAxis(bounds)) => {
                    for (axis, bound) in bounds.into_iter().enumerate() {
                        self.positive(&format!("{key}.{axis}"), bound, "rate", unit)?;
                    }
                }
            }
        }
        if let Some(feedback) = &control.feedback {
            self.not_negative("control.feedback.state", feedback.state, "weight", "")?;
            self.positive("control.feedback.input", feedback.input, "weight", "")?;
            self.positive(
                "control.feedback.tolerance",
                feedback.tolerance,
                "tolerance",
                "",
            )?;
        }
        let acts =
            |parts: [Option<Bound>; 2]| parts.into_iter().flatten().any(|part| !part.is_zero());
        let mut nothing = !acts([control.force_max_n, control.moment_max_n_m]);
        let elements = scene.rod.elements;
        for (index, actuator) in control.actuator.iter().enumerate() {
            let key = format!("control.actuator.{index}");
            let held = scene.base.kind != BaseKind::Free && actuator.node == 0;
            let earlier = &control.actuator[..index];
            let message = if actuator.node > elements {
                format!("there is no node {}", actuator.node)
            } else if actuator.node == elements {
                "the tip has the control's own force and moment".to_string()
            } else if held {
                "a held or driven base does not answer to forces".to_string()
            } else if earlier.iter().any(|other| other.node == actuator.node) {
                format!("node {} is given twice", actuator.node)
            } else {
                self.check_bounds(&key, actuator.force_max_n, actuator.moment_max_n_m)?;
                let parts = [actuator.force_max_n, actuator.moment_max_n_m];
                if parts == [None; 2] {
                    return Err(self.source.error_at(
                        &key,
                        "names neither force_max_n nor moment_max_n_m, so that nothing acts on this node",
                        Some(NAME_A_PART.into()),
                    ));
                }
                nothing &= !acts(parts);
                continue;
            };
            return Err(self
                .source
                .error_at(&format!("{key}.node"), message, None)
                .expecting(format!(
                    "expected another node, below the tip's index {elements}"
                )));
        }
        if nothing {
            let message = "force_max_n and moment_max_n_m are 0 or not named, so that there is nothing to control with";
            return Err((self.source).error_at("control", message, Some(NAME_A_PART.into())));
        }
        Ok(())
    }

    fn check_bounds(&self, section: &str, force: Option<Bound>, moment: Option<Bound>) -> Checked {
        for (name, bound, unit) in [
            ("force_max_n", force, "N"),
            ("moment_max_n_m", moment, "N m"),
        ] {
            let key = format!("{section}.{name}");
            match bound {
                None => {}
                Some(Bound::Norm(norm)) => self.not_below_zero(&key, norm, "bound", unit)?,
                Some(Bound::PerAxis(bounds)) => {
                    for (axis, bound) in bounds.into_iter().enumerate() {
                        self.not_below_zero(&format!("{key}.{axis}"), bound, "bound", unit)?;
                    }
                }
            }
        }
        Ok(())
    }

    fn check_objective(&self, objective: &Objective, scene: &Scene) -> Checked {
        self.not_negative("objective.effort", objective.effort, "weight", "")?;
        self.not_negative("objective.rate", objective.rate, "weight", "")?;
        self.not_negative("objective.energy", objective.energy, "weight", "")?;
        if objective.energy > 0.0 && scene.rod.model != RodModel::Standard {
            return Err(self.contradiction("objective.energy", "rod.model"));
        }
        self.count("objective.samples", objective.samples, LARGEST_COUNT)?;
        for (index, track) in objective.track.iter().enumerate() {
            let key = |name: &str| format!("objective.track.{index}.{name}");
            self.node(&key("node"), track.node, scene.rod.elements)?;
            self.table(&key("path_m"), &track.path_m, "no path")?;
            self.positive_if_given(&key("weight"), track.weight, "weight", "")?;
        }
        let free = scene.task.as_ref().and_then(|task| task.free_duration);
        let has_price = free.is_some_and(|free| free.price > 0.0);
        if objective.effort == 0.0 && objective.rate == 0.0 && !has_price {
            let message =
                "both this and objective.rate are 0, so that there is nothing to make small";
            return Err(self.source.error_at("objective.effort", message, None));
        }
        self.positive_if_given(
            "objective.force_scale_n",
            objective.force_scale_n,
            "force",
            "N",
        )?;
        self.positive_if_given(
            "objective.moment_scale_n_m",
            objective.moment_scale_n_m,
            "moment",
            "N m",
        )
    }

    fn check_solver(&self, solver: &Solver) -> Checked {
        self.positive("solver.tolerance", solver.tolerance, "tolerance", "")?;
        self.positive("solver.saddle_gain", solver.saddle_gain, "part", "")?;
        if solver.saddle_gain > MOST_SADDLE_GAIN {
            return Err(self.out_of_range(
                "solver.saddle_gain",
                solver.saddle_gain,
                "part up to 0.1 of the objective",
                "",
            ));
        }
        self.count(
            "solver.max_iterations",
            solver.max_iterations,
            LARGEST_COUNT,
        )?;
        match solver.continuation {
            None => {}
            Some(Continuation::Target(stages)) => {
                self.count("solver.continuation.target", stages, MOST_STAGES)?;
            }
            Some(Continuation::Load(stages)) => {
                self.count("solver.continuation.load", stages, MOST_STAGES)?;
            }
        }
        self.positive_if_given(
            "solver.deadline_s",
            solver.deadline_s,
            "duration",
            "seconds",
        )
    }

    fn positive(&self, key: &str, value: f64, quantity: &str, unit: &str) -> Checked {
        if !value.is_finite() || value <= 0.0 {
            return Err(self.out_of_range(key, value, &format!("positive {quantity}"), unit));
        }
        Ok(())
    }

    fn positive_if_given(
        &self,
        key: &str,
        value: Option<f64>,
        quantity: &str,
        unit: &str,
    ) -> Checked {
        value.map_or(Ok(()), |value| self.positive(key, value, quantity, unit))
    }

    fn not_negative(&self, key: &str, value: f64, quantity: &str, unit: &str) -> Checked {
        if !value.is_finite() || value < 0.0 {
            return Err(self.out_of_range(key, value, &format!("non-negative {quantity}"), unit));
        }
        Ok(())
    }

    /// Infinity is as good as any.
    fn not_below_zero(&self, key: &str, value: f64, quantity: &str, unit: &str) -> Checked {
        if !(value >= 0.0) {
            return Err(self.out_of_range(key, value, &format!("non-negative {quantity}"), unit));
        }
        Ok(())
    }

    /// `unit` is empty for numbers without one.
    fn out_of_range(&self, key: &str, value: f64, quantity: &str, unit: &str) -> SceneError {
        let unit = if unit.is_empty() {
            String::new()
        } else {
            format!(" in {unit}")
        };
        self.source
            .error_at(key, format!("{} is not a {quantity}", number(value)), None)
            .expecting(format!("expected a {quantity}{unit}"))
    }

    fn count(&self, key: &str, value: usize, most: usize) -> Checked {
        if !(1..=most).contains(&value) {
            return Err(self
                .source
                .error_at(key, format!("{value} is out of range"), None)
                .expecting(format!("expected a whole number from 1 to {most}")));
        }
        Ok(())
    }

    fn finite_number(&self, key: &str, value: f64) -> Checked {
        if !value.is_finite() {
            let message = format!("{value} is not a finite number");
            return Err(self
                .source
                .error_at(key, message, None)
                .expecting("expected a finite number"));
        }
        Ok(())
    }

    fn finite(&self, key: &str, values: &[f64]) -> Checked {
        for (index, value) in values.iter().enumerate() {
            self.finite_number(&format!("{key}.{index}"), *value)?;
        }
        Ok(())
    }

    fn nonzero(&self, key: &str, values: &[f64]) -> Checked {
        self.finite(key, values)?;
        if values.iter().all(|value| *value == 0.0) {
            return Err(self
                .source
                .error_at(key, "all components are zero", None)
                .expecting("expected any other vector"));
        }
        Ok(())
    }

    fn missing(&self, key: &str, relation: &str) -> SceneError {
        self.source
            .error_at(key, format!("missing; {relation}"), None)
    }

    fn contradiction(&self, key: &str, other: &str) -> SceneError {
        self.source.error_at(
            key,
            format!("contradicts {other}"),
            Some("give one or the other".to_string()),
        )
    }
}

/// A saddle with more to gain than this part of the objective is no result.
const MOST_SADDLE_GAIN: f64 = 0.1;

/// What to do where no part of a wrench acts.
const NAME_A_PART: &str = "a force or moment acts only where it is named; give its largest magnitude, or `inf` for no bound: \
force_max_n = inf";

/// The shortest digits that read back as the same number, in powers of ten where it is very large or small.
fn number(value: f64) -> String {
    if value == 0.0 || !value.is_finite() || (1e-4..1e7).contains(&value.abs()) {
        value.to_string()
    } else {
        format!("{value:e}")
    }
}

/// Four significant digits or so, for derived lengths.
fn rounded(value: f64) -> String {
    if (0.1..1e4).contains(&value) {
        format!("{value:.3}")
    } else {
        format!("{value:.3e}")
    }
}
