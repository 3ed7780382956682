//! Ranges of keys and relations between them that the types of a scene cannot express.

use super::accuracy::check_range;
use super::keys::{Checked, Keys};
use super::model::{
    AtRest, Base, BaseKind, BaseMotion, Continuation, DistributedLoad, FreeDuration, Initial,
    Limit, Load, LoadNode, Material, Objective, Obstacle, Price, Rod, Scene, Section, Solver, Task,
    Time, TimeStep, Via,
};
use super::values::{self, Number, Positive, digits};
use super::{SceneError, SceneSource};
use crate::mechanics::RodModel;
use crate::task::MOST_STEPS;

/// Elements beyond this number are a typing error rather than a wish.
pub(crate) const MOST_ELEMENTS: usize = 5000;

/// Blocks and iterations beyond this number are a typing error rather than a wish.
pub(super) const LARGEST_COUNT: usize = 1_000_000;

/// Stages of a continuation beyond this number are a typing error rather than a wish.
const MOST_STAGES: usize = 1000;

/// Times shorter than this, s, are typing errors rather than wishes: momenta of a step overflow.
const SHORTEST_TIME: f64 = 1e-200;

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
        for (index, load) in self.load.iter().enumerate() {
            keys.check_load("load", load, index, self.rod.elements)?;
        }
        for (index, load) in self.distributed_load.iter().enumerate() {
            keys.check_distributed_load(load, index)?;
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
        keys.check_closed_loop(self)
    }
}

impl Keys<'_> {
    fn check_rod(&self, rod: &Rod) -> Checked {
        self.count("rod.elements", rod.elements, MOST_ELEMENTS)?;
        check_range(rod.accuracy.map(Number::get), self.source)?;
        match (&rod.material, &rod.section, &rod.stiffness, &rod.inertia) {
            (Some(material), Some(section), None, None) => {
                self.check_material(material)?;
                self.check_section("rod.section", section)?;
                if rod.display_radius_m.is_some() {
                    return Err(self.contradiction("rod.display_radius_m", "rod.section"));
                }
            }
            (None, None, Some(_), Some(_)) => {}
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
        }
        Ok(())
    }

    fn check_material(&self, material: &Material) -> Checked {
        if material.youngs_modulus().is_none() {
            let key = "rod.material.youngs_modulus_pa";
            return Err(self.missing(key, NAME_A_PRESET));
        }
        match (material.poisson_ratio, material.shear_modulus_pa) {
            (Some(_), Some(_)) => {
                return Err(self.contradiction(
                    "rod.material.shear_modulus_pa",
                    "rod.material.poisson_ratio",
                ));
            }
            (None, None) if material.preset.is_none() => {
                return Err(self.missing(
                    "rod.material.poisson_ratio",
                    "or else give rod.material.shear_modulus_pa",
                ));
            }
            _ => {}
        }
        if material.density().is_none() {
            return Err(self.missing("rod.material.density_kg_m3", NAME_A_PRESET));
        }
        Ok(())
    }

    /// `name` is the section's key.
    pub(super) fn check_section(&self, name: &str, section: &Section) -> Checked {
        let key = |quantity: &str, place: &str| format!("{name}.{quantity}_{place}m");
        // The keys that are given: what they measure, and where.
        let given: Vec<(&str, &str)> = [
            ("radius", "", section.radius_m.is_some()),
            ("diameter", "", section.diameter_m.is_some()),
            ("radius", "base_", section.radius_base_m.is_some()),
            ("diameter", "base_", section.diameter_base_m.is_some()),
            ("radius", "tip_", section.radius_tip_m.is_some()),
            ("diameter", "tip_", section.diameter_tip_m.is_some()),
        ]
        .into_iter()
        .filter_map(|(quantity, place, is_given)| is_given.then_some((quantity, place)))
        .collect();
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
                &format!("or else give {name}.radius_base_m and {name}.radius_tip_m, or diameters"),
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
            self.finite_number(&key("phase_rad"), oscillation.phase_rad)?;
        }
        Ok(())
    }

    /// `list` is the section's name.
    pub(super) fn check_load(
        &self,
        list: &str,
        load: &Load,
        index: usize,
        elements: usize,
    ) -> Checked {
        let key = |name: &str| format!("{list}.{index}.{name}");
        self.node(&key("node"), load.node, elements)?;
        self.finite(&key("force_n"), &load.force_n)?;
        self.finite(&key("moment_n_m"), &load.moment_n_m)?;
        load.profile.as_ref().map_or(Ok(()), |profile| {
            self.table(&key("profile"), profile, "a constant load")
        })
    }

    fn check_distributed_load(&self, load: &DistributedLoad, index: usize) -> Checked {
        let key = |name: &str| format!("distributed_load.{index}.{name}");
        let (from, to) = (load.from.get(), load.to.get());
        if to <= from {
            let message = format!("{} does not come after from, {}", digits(to), digits(from));
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

    fn check_time(&self, time: &Time) -> Checked {
        let end = time.end_s.get();
        let is_long_enough = |key: &'static str, seconds: f64| {
            if seconds == 0.0 || seconds >= SHORTEST_TIME {
                return Ok(());
            }
            let message = format!("{} s is too short a time for a step", digits(seconds));
            let expected = format!("expected at least {} s", digits(SHORTEST_TIME));
            Err((self.source.error_at(key, message, None)).expecting(expected))
        };
        is_long_enough("time.end_s", end)?;
        let TimeStep::Seconds(step) = time.step_s else {
            return Ok(());
        };
        self.positive("time.step_s", step, "time step", "seconds")?;
        is_long_enough("time.step_s", step)?;
        if end > 0.0 && step > end {
            let message = format!(
                "a step of {} s is longer than time.end_s, {} s",
                digits(step),
                digits(end)
            );
            return Err(self.source.error_at("time.step_s", message, None));
        }
        if end / step > MOST_STEPS {
            let message = format!(
                "makes {} steps up to time.end_s, {} s",
                digits(end / step),
                digits(end)
            );
            return Err(self
                .source
                .error_at("time.step_s", message, None)
                .expecting(format!("expected at most {} steps", digits(MOST_STEPS))));
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
        let end = scene.time.end_s.get();
        if let Some(instant) = task.at_s.map(Positive::get) {
            if instant > end {
                let message = format!("{} s is after the end of the scene", digits(instant));
                return Err(self
                    .source
                    .error_at("task.at_s", message, None)
                    .expecting(format!("expected at most time.end_s, {}", digits(end))));
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
            task.weight.is_some(),
            (task.tolerance_m.is_some(), task.position_m.is_some()),
            (task.tolerance_rad, task.orientation_wxyz.is_some()),
        )?;
        for (key, is_given) in [
            ("task.tolerance_m_s", task.tolerance_m_s.is_some()),
            ("task.tolerance_rad_s", task.tolerance_rad_s.is_some()),
        ] {
            if is_given && task.at_rest != AtRest::Tip {
                return Err(self.contradiction(key, "task.at_rest"));
            }
            if is_given && !task.hard {
                return Err(self.contradiction(key, "task.hard"));
            }
        }
        for (key, is_given) in [
            ("task.stays_s", task.stays_s.is_some()),
            ("task.stays_m", task.stays_m.is_some()),
        ] {
            if is_given && task.at_rest != AtRest::Staying {
                return Err(self.contradiction(key, "task.at_rest"));
            }
        }
        for (index, via) in task.via.iter().enumerate() {
            self.check_via(via, index, task.instant(end), scene)?;
        }
        Ok(())
    }

    fn check_free_duration(&self, free: &FreeDuration, start: f64) -> Checked {
        let key = |name: &str| format!("task.free_duration.{name}");
        let (shortest, longest) = (free.shortest_s.get(), free.longest_s.get());
        if longest < shortest {
            let message = format!("{} s is below shortest_s", digits(longest));
            return Err(self.source.error_at(&key("longest_s"), message, None));
        }
        if !(shortest..=longest).contains(&start) {
            let message = format!("the search begins at {} s, outside", digits(start));
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
        if via.at_s.get() >= end {
            let message = format!(
                "{} s is not before the task's own time",
                digits(via.at_s.get())
            );
            return Err(self
                .source
                .error_at(&key("at_s"), message, None)
                .expecting(format!("expected less than {}", digits(end))));
        }
        self.check_enforcement(
            &format!("task.via.{index}"),
            via.hard,
            via.weight.is_some(),
            (via.tolerance_m.is_some(), via.position_m.is_some()),
            (via.tolerance_rad, via.orientation_wxyz.is_some()),
        )
    }

    /// `tolerances` to a position and to an orientation, each with whether there is one.
    fn check_enforcement(
        &self,
        section: &str,
        hard: bool,
        has_weight: bool,
        distance: (bool, bool),
        angle: (Option<Positive<values::Angle>>, bool),
    ) -> Checked {
        let key = |name: &str| format!("{section}.{name}");
        if hard && has_weight {
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
        let (has_distance, has_position) = distance;
        let (angle, has_orientation) = angle;
        for (name, is_given, owner, owned) in [
            ("tolerance_m", has_distance, "position_m", has_position),
            (
                "tolerance_rad",
                angle.is_some(),
                "orientation_wxyz",
                has_orientation,
            ),
        ] {
            if is_given && !owned {
                return Err(self.missing(&key(owner), &format!("goes with {}", key(name))));
            }
            if is_given && !hard {
                return Err(self.contradiction(&key(name), &key("hard")));
            }
        }
        if let Some(angle) = angle.map(Positive::get)
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
        if let Some(velocity) = &obstacle.velocity_m_s {
            self.finite(&key("velocity_m_s"), velocity)?;
        }
        if let Some(sphere) = &obstacle.sphere {
            self.finite(&key("sphere.center_m"), &sphere.center_m)?;
        }
        if let Some(capsule) = &obstacle.capsule {
            self.finite(&key("capsule.from_m"), &capsule.from_m)?;
            self.finite(&key("capsule.to_m"), &capsule.to_m)?;
        }
        if let Some(half_space) = &obstacle.half_space {
            self.finite(&key("half_space.point_m"), &half_space.point_m)?;
            self.nonzero(&key("half_space.normal"), &half_space.normal)?;
        }
        if let Some(cuboid) = &obstacle.cuboid {
            self.finite(&key("box.center_m"), &cuboid.center_m)?;
            if let Some(orientation) = &cuboid.orientation_wxyz {
                self.nonzero(&key("box.orientation_wxyz"), orientation)?;
            }
        }
        self.check_price(&key("soft"), obstacle.soft)
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
            if !(least.is_finite() && least >= 0.0) {
                let key = key("stretch.0");
                return Err(self.out_of_range(&key, least, "non-negative stretch", ""));
            }
            self.positive(&key("stretch.1"), largest, "stretch", "")?;
            if largest <= least {
                let message = format!("{} is not above {}", digits(largest), digits(least));
                return Err(self.source.error_at(&key("stretch.1"), message, None));
            }
        }
        if let Some(node) = limit.node {
            self.node(&key("node"), node, elements)?;
            if limit.speed_max_m_s.is_none() {
                return Err(self.missing(&key("speed_max_m_s"), "goes with node"));
            }
        }
        self.check_price(&key("soft"), limit.soft)
    }

    fn check_price(&self, key: &str, price: Option<Price>) -> Checked {
        let Some(price) = price else {
            return Ok(());
        };
        if price.linear.get() == 0.0 && price.quadratic.get() == 0.0 {
            return Err(self
                .source
                .error_at(key, "a violation that costs nothing", None)
                .expecting("expected linear or quadratic above 0"));
        }
        Ok(())
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
            .map_or(1.0, |reference| reference.stretch.get().max(1.0));
        let reach = LARGEST_STRETCH * stretch * fraction * scene.rod.length_m.get();
        let [x, y, z] = std::array::from_fn(|axis| position[axis] - scene.base.position_m[axis]);
        let distance = x.hypot(y).hypot(z);
        if scene.base.kind == BaseKind::Clamped && distance > reach {
            let message = format!("{} m from the base is out of reach", rounded(distance));
            let help = format!(
                "rod.length_m is {} and base.position_m is the clamped end",
                digits(scene.rod.length_m.get())
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

    fn check_objective(&self, objective: &Objective, scene: &Scene) -> Checked {
        if objective.energy.get() > 0.0 && scene.rod.model != RodModel::Standard {
            return Err(self.contradiction("objective.energy", "rod.model"));
        }
        self.count("objective.samples", objective.samples, LARGEST_COUNT)?;
        for (index, track) in objective.track.iter().enumerate() {
            let section = format!("objective.track.{index}");
            let node = format!("{section}.node");
            self.node(&node, track.node, scene.rod.elements)?;
            self.check_path(&section, track)?;
        }
        let free = scene.task.as_ref().and_then(|task| task.free_duration);
        let has_price = free.is_some_and(|free| free.price.get() > 0.0);
        if objective.effort.get() == 0.0 && objective.rate.get() == 0.0 && !has_price {
            let message =
                "both this and objective.rate are 0, so that there is nothing to make small";
            return Err(self.source.error_at("objective.effort", message, None));
        }
        Ok(())
    }

    fn check_solver(&self, solver: &Solver) -> Checked {
        let gain = solver.saddle_gain.get();
        if gain > MOST_SADDLE_GAIN {
            return Err(self.out_of_range(
                "solver.saddle_gain",
                gain,
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
        Ok(())
    }
}

/// A saddle with more to gain than this part of the objective is no result.
const MOST_SADDLE_GAIN: f64 = 0.1;

/// What to do where a figure of a material is missing.
const NAME_A_PRESET: &str = "or else give rod.material.preset";

/// Four significant digits or so, for derived lengths.
fn rounded(value: f64) -> String {
    if (0.1..1e4).contains(&value) {
        format!("{value:.3}")
    } else {
        format!("{value:.3e}")
    }
}
