//! The numbers from which a rod is built: their ranges, and the elements and masses that follow from them.

use nalgebra::{Matrix3, Vector3};

use super::{
    DistributedLoad, Element, EndCondition, Mesh, NodeInertia, RodError, RodModel, RodParameters,
    RotaryInertia, Scales, require, rest_strain,
};
use crate::configuration::Configuration;
use crate::time::TimeScheme;

/// Largest `|RᵀR - I|` of a rotation.
const LARGEST_ROTATION_DEFECT: f64 = 1e-9;

const FRACTION: &str = "a fraction of the length";

fn is_fraction(s: f64) -> bool {
    (0.0..=1.0).contains(&s)
}

fn positive(x: f64) -> bool {
    x > 0.0
}

impl RodParameters {
    /// Checks all numbers, and returns the mesh.
    ///
    /// # Errors
    /// Those of [`Rod::new`](super::Rod::new) that do not need elements.
    pub(super) fn check(&self) -> Result<Mesh, RodError> {
        self.check_numbers()?;
        self.check_section()?;
        self.check_rows()?;
        let mesh = self.mesh();
        let k = self.n_elements;
        if mesh.n_elements() != k {
            return Err(RodError::FewElements {
                elements: k,
                least: mesh.n_pieces() * self.multiple,
            });
        }
        self.check_loads()?;
        self.check_ends()?;
        for q in 0..k {
            let psi = self.curvature(&mesh, q) * mesh.length(q, self.length);
            require(
                "rest_curvature",
                psi.norm(),
                |angle| angle < std::f64::consts::PI,
                "less than half a turn per element",
            )?;
        }
        Ok(mesh)
    }

    fn check_numbers(&self) -> Result<(), RodError> {
        require("length", self.length, positive, "a positive length")?;
        require(
            "n_elements",
            self.n_elements as f64,
            |k| k >= 1.0,
            "at least one element",
        )?;
        require(
            "rest_stretch",
            self.rest_stretch,
            positive,
            "a positive stretch",
        )?;
        require(
            "viscous_damping",
            self.viscous_damping,
            |c| c >= 0.0,
            "a non-negative damping",
        )?;
        require(
            "internal_damping",
            self.internal_damping,
            |tau| tau >= 0.0,
            "a non-negative time",
        )?;
        if self.model != RodModel::Standard {
            for (parameter, is_used) in [
                ("internal_damping", self.internal_damping > 0.0),
                ("scheme", self.scheme == TimeScheme::Implicit),
                (
                    "rotary_inertia",
                    self.rotary_inertia == RotaryInertia::Segment,
                ),
                ("tip", self.tip != EndCondition::Free),
                ("base", matches!(self.base, EndCondition::Pinned { .. })),
            ] {
                if is_used {
                    return Err(RodError::NeedsStandardModel { parameter });
                }
            }
        }
        for i in 0..3 {
            require("gravity", self.gravity[i], |_| true, "finite")?;
            require("base_position", self.base_position[i], |_| true, "finite")?;
            require("rest_curvature", self.rest_curvature[i], |_| true, "finite")?;
        }
        let defect = (self.base_rotation.tr_mul(&self.base_rotation) - Matrix3::identity()).norm();
        require(
            "|RᵀR - I| of base_rotation",
            defect,
            |defect| defect < LARGEST_ROTATION_DEFECT,
            "that of a rotation matrix, below 1e-9",
        )?;
        Ok(())
    }

    fn check_section(&self) -> Result<(), RodError> {
        let parts = self.section.parts().or_else(|end| {
            let expected = "the end of a segment, beyond that of the one before and at last 1";
            require("section segments", end, |_| false, expected).map(|()| Vec::new())
        })?;
        for (part, s) in parts
            .iter()
            .flat_map(|part| [0.0, 0.5, 1.0].map(|s| (part, s)))
        {
            let section = part.at(s);
            require("section mass", section.mass, positive, "positive")?;
            for i in 0..3 {
                let section = &section;
                require(
                    "section linear stiffness",
                    section.linear_stiffness[i],
                    positive,
                    "positive",
                )?;
                require(
                    "section angular stiffness",
                    section.angular_stiffness[i],
                    positive,
                    "positive",
                )?;
                require(
                    "section rotary inertia",
                    section.rotary[i],
                    positive,
                    "positive",
                )?;
            }
        }
        Ok(())
    }

    fn check_rows(&self) -> Result<(), RodError> {
        require(
            "multiple",
            self.multiple as f64,
            |m| m >= 1.0 && self.n_elements.is_multiple_of(self.multiple),
            "a divisor of the number of elements",
        )?;
        for &s in &self.breaks {
            require("breaks", s, is_fraction, FRACTION)?;
        }
        for (s, curvature) in &self.curvature_rows {
            require("curvature_rows", *s, is_fraction, FRACTION)?;
            for i in 0..3 {
                require("rest_curvature", curvature[i], |_| true, "finite")?;
            }
        }
        if let Some(pair) = self
            .curvature_rows
            .windows(2)
            .find(|pair| pair[1].0 < pair[0].0)
        {
            let expected = "a fraction that is not before that of the row before";
            require("curvature_rows", pair[1].0, |_| false, expected)?;
        }
        Ok(())
    }

    fn check_loads(&self) -> Result<(), RodError> {
        let k = self.n_elements;
        for load in &self.loads {
            require(
                "load node",
                load.node as f64,
                |node| node <= k as f64,
                "a node of the rod",
            )?;
        }
        for load in &self.distributed_loads {
            check_distributed(load)?;
        }
        let not_negative = |x: f64| x >= 0.0;
        let payload = self
            .payload
            .iter()
            .map(|body| ("payload mass", "payload inertia", body));
        let bodies = (self.bodies.iter()).map(|(_, body)| ("body mass", "body inertia", body));
        for (mass, inertia, body) in payload.chain(bodies) {
            require(mass, body.mass, not_negative, "zero or more")?;
            for i in 0..3 {
                require(inertia, body.rotary[i], not_negative, "zero or more")?;
            }
        }
        for (at, _) in &self.bodies {
            require("body place", *at, is_fraction, FRACTION)?;
        }
        Ok(())
    }

    fn check_ends(&self) -> Result<(), RodError> {
        for end in [&self.base, &self.tip] {
            match end {
                EndCondition::Driven(motion) => motion.check()?,
                EndCondition::Pinned { axis: Some(axis) } => {
                    let size = axis.norm();
                    require("length of a hinge's axis", size, positive, "positive")?;
                }
                _ => {}
            }
        }
        if let Some(position) = &self.tip_position {
            for i in 0..3 {
                require("tip_position", position[i], |_| true, "finite")?;
            }
        }
        if let Some(rotation) = &self.tip_rotation {
            let defect = (rotation.tr_mul(rotation) - Matrix3::identity()).norm();
            require(
                "|RᵀR - I| of tip_rotation",
                defect,
                |defect| defect < LARGEST_ROTATION_DEFECT,
                "that of a rotation matrix, below 1e-9",
            )?;
        }
        Ok(())
    }

    /// Returns the elements, whose strain is that of the stress-free shape `rest`.
    pub(super) fn elements(&self, mesh: &Mesh, rest: &Configuration) -> Vec<Element> {
        let k = self.n_elements;
        (0..k)
            .map(|q| {
                let section = self.section.at(mesh.along(q, 0.5));
                let l = mesh.length(q, self.length);
                Element {
                    model: self.model,
                    length: l,
                    linear_stiffness: section.linear_stiffness,
                    angular_stiffness: section.angular_stiffness,
                    rest: rest_strain(self, mesh, rest, q),
                }
            })
            .collect()
    }

    /// Returns mass and inertia of both halves of every element.
    pub(super) fn element_inertia(&self, mesh: &Mesh) -> Vec<[NodeInertia; 2]> {
        let k = self.n_elements;
        (0..k)
            .map(|q| {
                let (start, l) = (mesh.along(q, 0.0), mesh.length(q, self.length));
                let share = mesh.length(q, 1.0);
                let (middle, end) = (start + 0.5 * share, start + share);
                [(start, middle), (middle, end)].map(|(from, to)| {
                    let mut share = self.section.inertia_between(from, to, self.length);
                    if self.rotary_inertia == RotaryInertia::Segment {
                        share.rotary.add_scalar_mut(share.mass * l * l / 12.0);
                    }
                    share
                })
            })
            .collect()
    }
}

/// Returns masses and inertias of nodes: those of the halves of the elements beside them.
pub(super) fn lumped(element_inertia: &[[NodeInertia; 2]]) -> Vec<NodeInertia> {
    let k = element_inertia.len();
    let mut nodes = vec![
        NodeInertia {
            mass: 0.0,
            rotary: Vector3::zeros()
        };
        k + 1
    ];
    for (q, ends) in element_inertia.iter().enumerate() {
        for (end, share) in ends.iter().enumerate() {
            nodes[q + end].mass += share.mass;
            nodes[q + end].rotary += share.rotary;
        }
    }
    nodes
}

/// Checks that products of the numbers neither overflow nor vanish.
pub(super) fn check_computable(
    (elements, rest_chords): (&[Element], &[f64]),
    element_inertia: &[[NodeInertia; 2]],
    scales: &Scales,
) -> Result<(), RodError> {
    let computable = "positive and finite: the parameters are too far apart to be computed with";
    for shares in element_inertia.iter().flatten() {
        require("mass of a node", shares.mass, positive, computable)?;
        require(
            "inertia of a node",
            shares.rotary.min(),
            positive,
            computable,
        )?;
        require(
            "inertia of a node",
            shares.rotary.max(),
            positive,
            computable,
        )?;
    }
    for (element, &chord) in elements.iter().zip(rest_chords) {
        require("length of an element", chord, positive, computable)?;
        let stiffness = element.linear_stiffness / element.length;
        require(
            "stiffness of an element",
            stiffness.min(),
            positive,
            computable,
        )?;
        require(
            "stiffness of an element",
            stiffness.max(),
            positive,
            computable,
        )?;
    }
    for scale in [scales.force, scales.moment, scales.time] {
        require(
            "scale EI/L², EI/L or L² sqrt(ρA/EI)",
            scale,
            positive,
            computable,
        )?;
    }
    Ok(())
}

fn check_distributed(load: &DistributedLoad) -> Result<(), RodError> {
    let end = "a fraction of the length, the end after the start";
    require("distributed load start", load.from, |from| from >= 0.0, end)?;
    require(
        "distributed load end",
        load.to,
        |to| to > load.from && to <= 1.0,
        end,
    )?;
    for i in 0..3 {
        require("distributed force", load.force[i], |_| true, "finite")?;
        require("distributed moment", load.moment[i], |_| true, "finite")?;
    }
    Ok(())
}
