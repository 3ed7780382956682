//! The stress, the coordinates and the energy of the actuators of a rod.

use nalgebra::{SMatrix, Vector3};
use pulp::Scalar;

use super::Rod;
use super::strain_actuator::{EffortState, of_actuator, stretched};
use crate::configuration::{Poses, Trajectory};
use crate::element::{
    ActivePoint, ActiveTangent, ElementGradient, ElementPose, ElementStiffness, ElementStrain,
    IntervalStress, StrainRule, Stress,
};
use crate::time::TimeScheme;
use crate::vector::Lanes;

impl Rod {
    /// Returns the rod with constant given inputs of its actuators: efforts, of winches displacements.
    #[must_use]
    pub fn with_inputs(&self, inputs: &[f64]) -> Self {
        let mut out = self.clone();
        out.actuators.give(inputs);
        out
    }

    /// Returns the stress that the actuators with the given efforts have in element `q` at a strain: `-Σ u ∂y/∂(v, κ)` per length. `None`
    /// if none passes the element.
    #[must_use]
    pub fn active_stress(
        &self,
        q: usize,
        strain: &ElementStrain,
        efforts: &[f64],
    ) -> Option<IntervalStress> {
        self.active_stress_under(q, strain, &|line| efforts[line])
    }

    /// Returns [`Self::active_stress`] where `effort` gives the effort of a line.
    pub(crate) fn active_stress_under(
        &self,
        q: usize,
        strain: &ElementStrain,
        effort: &dyn Fn(usize) -> f64,
    ) -> Option<IntervalStress> {
        let points = self.actuators.on(q);
        if points.is_empty() {
            return None;
        }
        let length = self.elements[q].length;
        let (linear, psi) = stretched(strain, length);
        let mut out = IntervalStress {
            linear: [Vector3::zeros(); 2],
            angular: Vector3::zeros(),
        };
        for point in points {
            let at = point.in_element(Scalar, length);
            // Stresses at the ends count half under the trapezoidal rule.
            let (slopes, ends) = match self.strain_rule {
                StrainRule::Helical => (at.slopes::<1>(&point.density, linear, psi), 1.0),
                StrainRule::Trapezoidal => (at.slopes::<2>(&point.density, linear, psi), 2.0),
            };
            let effort = effort(point.line);
            if effort == 0.0 {
                continue;
            }
            for (out, n) in out.linear.iter_mut().zip(slopes.linear) {
                *out -= n.vector() * (ends * effort);
            }
            out.angular -= slopes.angular.vector() * effort;
        }
        Some(out)
    }

    /// Returns the derivative of [`Self::active_stress`], times the weights of the ends and the length, along `(v_a, v_b, κ)`: minus the
    /// second derivative of `Σ u y`.
    fn active_tangent(
        &self,
        q: usize,
        strain: &ElementStrain,
        effort: &dyn Fn(usize) -> f64,
    ) -> SMatrix<f64, 9, 9> {
        let length = self.elements[q].length;
        let (linear, psi) = stretched(strain, length);
        let (mut sum, mut stress) = (ActiveTangent::zero(Scalar), Stress::zero(Scalar));
        for point in self.actuators.on(q) {
            let at: ActivePoint<Scalar> = point.in_element(Scalar, length);
            let factor = Lanes::splat(Scalar, -effort(point.line));
            let (density, strain) = (&point.density, (linear, psi));
            match self.strain_rule {
                StrainRule::Helical => {
                    at.add_derivatives::<1>(density, strain, factor, &mut stress, &mut sum);
                }
                StrainRule::Trapezoidal => {
                    at.add_derivatives::<2>(density, strain, factor, &mut stress, &mut sum);
                }
            }
        }
        let mut out = SMatrix::<f64, 9, 9>::zeros();
        let mut put = |i: usize, j: usize, block: nalgebra::Matrix3<f64>| {
            let mut part = out.fixed_view_mut::<3, 3>(3 * i, 3 * j);
            part.copy_from(&(block * (length * length)));
        };
        for end in 0..2 {
            put(end, end, sum.linear[end].matrix());
            put(end, 2, sum.mixed[end].matrix());
            put(2, end, sum.mixed[end].transpose().matrix());
        }
        put(2, 2, sum.angular.matrix());
        out
    }

    /// Returns the gradient of `-Σ u y` of the actuators in element `q`; `None` if none passes it.
    #[must_use]
    pub fn active_gradient(
        &self,
        q: usize,
        pose: &ElementPose,
        efforts: &[f64],
    ) -> Option<ElementGradient> {
        let element = &self.elements[q];
        let strain = self.strain_rule.strain(element.length, pose);
        let stress = self.active_stress(q, &strain, efforts)?;
        Some(element.gradient_under(self.strain_rule, pose, &stress))
    }

    /// Returns the derivative of [`Self::active_gradient`]; `None` if no actuator passes the element.
    #[must_use]
    pub fn active_stiffness(
        &self,
        q: usize,
        pose: &ElementPose,
        efforts: &[f64],
    ) -> Option<ElementStiffness> {
        let (element, rule) = (&self.elements[q], self.strain_rule);
        let (strain, b) = rule.strain_derivative(element.length, pose);
        let stress = self.active_stress(q, &strain, efforts)?;
        let bent = element.stiffness_under(rule, pose, &stress, 0.0);
        let tangent = self.active_tangent(q, &strain, &|line| efforts[line]);
        Some(bent + b.transpose() * tangent * b)
    }

    /// Returns the derivatives of the pulls of the stress at the mean strain of an interval on the poses at its two ends: of that at the
    /// start along the pose there and along the pose at the end, and of that at the end along the pose there. `None` if no actuator
    /// passes the element.
    pub fn interval_active_stiffness(
        &self,
        q: usize,
        poses: &[ElementPose; 2],
        effort: &dyn Fn(usize) -> f64,
    ) -> Option<[ElementStiffness; 3]> {
        let (element, rule) = (&self.elements[q], self.strain_rule);
        let [(start, b), (end, b_end)] =
            (poses.each_ref()).map(|pose| rule.strain_derivative(element.length, pose));
        let mean = start.mean(&end);
        let stress = self.active_stress_under(q, &mean, effort)?;
        let bent = |end: usize| element.stiffness_under(rule, &poses[end], &stress, 0.0);
        // The weight of a strain in the mean is one half.
        let tangent = self.active_tangent(q, &mean, effort) * 0.5;
        Some([
            bent(0) + b.transpose() * tangent * b,
            b.transpose() * tangent * b_end,
            bent(1) + b_end.transpose() * tangent * b_end,
        ])
    }

    /// Returns the largest efforts of the actuators at any time. Of a winch it is the tension that the arm at rest puts up against the
    /// farthest displacement.
    #[must_use]
    pub fn largest_efforts(&self) -> Vec<f64> {
        (self.actuators.iter().enumerate())
            .map(|(i, own)| {
                let most = own.largest_input();
                match self.winch_flexibility(i, -most) {
                    Some(flexibility) => most / flexibility,
                    None => most,
                }
            })
            .collect()
    }

    /// Returns the displacement of a winch per tension in the arm at rest, m/N: that of the tendon, pulled in to a `displacement`, and that
    /// of the arm under a unit tension, `∫ (n·C₁⁻¹n + m·C₂⁻¹m) ds`. `None` for another actuator.
    #[must_use]
    pub fn winch_flexibility(&self, actuator: usize, displacement: f64) -> Option<f64> {
        let winch = self.actuators.drives[actuator].winch?;
        let unit = self.actuators.unit_effort(actuator);
        let of_arm: f64 = (self.elements.iter().enumerate())
            .filter_map(|(q, element)| {
                let stress = self.active_stress(q, &element.rest, &unit)?;
                let [n, m] = [&stress.linear[0], &stress.angular];
                let shear = n.dot(&n.component_div(&element.linear_stiffness));
                let bend = m.dot(&m.component_div(&element.angular_stiffness));
                Some(element.length * (shear + bend))
            })
            .sum();
        let length = winch.unstretched(displacement, self.actuators.at_rest[actuator]);
        Some(winch.compliance * length + of_arm)
    }

    /// Returns the coordinates `y` of the actuators in a configuration, each in the unit of work over that of its effort.
    #[must_use]
    pub fn actuator_coordinates(
        &self,
        positions: &[Vector3<f64>],
        rotations: &[nalgebra::Matrix3<f64>],
    ) -> Vec<f64> {
        let mut out = vec![0.0; self.actuators.len()];
        self.write_actuator_coordinates((positions, rotations), &mut out);
        out
    }

    fn write_actuator_coordinates(&self, (positions, rotations): Poses, out: &mut [f64]) {
        out.fill(0.0);
        let strain = |q: usize| {
            let pose = Self::element_pose(q, positions, rotations);
            let length = self.elements[q].length;
            self.strain_rule.strain(length, &pose)
        };
        let elements = (self.strain_rule, &self.elements[..]);
        (self.actuators).add_strain_coordinates(elements, &strain, &of_actuator, out);
        for own in self.actuators.functions() {
            if let Some(actuator) = own.actuator {
                let at = own.pose(positions, rotations);
                out[actuator] += own.weight * own.function.function().value(&at);
            }
        }
    }

    /// Writes what efforts depend on in a configuration at rest.
    pub fn write_effort_state(&self, poses: Poses, out: &mut EffortState) {
        self.write_actuator_coordinates(poses, &mut out.coordinates);
        self.write_shares([poses; 2], None, out);
    }

    /// Returns what efforts depend on in a configuration at rest.
    #[must_use]
    pub fn effort_state(&self, poses: Poses) -> EffortState {
        let mut out = self.actuators.effort_state();
        self.write_effort_state(poses, &mut out);
        out
    }

    /// Writes what efforts depend on over an interval of the time `time`, s: the coordinates of the actuators on strains at the mean strains
    /// (those on poses have none), and the shares of tensions.
    pub fn write_interval_effort_state(&self, ends: [Poses; 2], time: f64, out: &mut EffortState) {
        out.coordinates.fill(0.0);
        let strain = |q: usize| {
            let length = self.elements[q].length;
            let [start, end] = ends.map(|(x, r)| {
                let pose = Self::element_pose(q, x, r);
                self.strain_rule.strain(length, &pose)
            });
            start.mean(&end)
        };
        let elements = (self.strain_rule, &self.elements[..]);
        let coordinates = &mut out.coordinates;
        (self.actuators).add_strain_coordinates(elements, &strain, &of_actuator, coordinates);
        self.write_shares(ends, Some(time), out);
    }

    /// Writes what efforts depend on in a set of pulls (`sensitivity::EffortPulls`): at a time node, or under the implicit scheme
    /// over an interval of the time `time`, s.
    pub fn write_effort_state_of_set(
        &self,
        trajectory: &Trajectory,
        (set, time): (usize, f64),
        out: &mut EffortState,
    ) {
        match self.scheme {
            TimeScheme::Explicit => self.write_effort_state(trajectory.poses_at(set), out),
            TimeScheme::Implicit => {
                let ends = [set, set + 1].map(|k| trajectory.poses_at(k));
                self.write_interval_effort_state(ends, time, out);
            }
        }
    }

    /// Returns the efforts of all lines in a configuration at rest for the inputs of the actuators, which are efforts already but for those of
    /// winches and of tendons with friction.
    #[must_use]
    pub fn efforts_at(
        &self,
        inputs: Vec<f64>,
        positions: &[Vector3<f64>],
        rotations: &[nalgebra::Matrix3<f64>],
    ) -> Vec<f64> {
        if !self.actuators.follow_shape() {
            return inputs;
        }
        let state = self.effort_state((positions, rotations));
        let mut out = vec![0.0; self.actuators.n_efforts()];
        self.actuators.write_lines(&inputs, &state, &mut out);
        out
    }

    /// Returns the efforts of all actuators in a configuration at rest for their inputs: of tendons with friction the tensions where they leave
    /// their motors.
    #[must_use]
    pub fn actuator_efforts(&self, inputs: Vec<f64>, poses: Poses) -> Vec<f64> {
        let mut out = self.efforts_at(inputs, poses.0, poses.1);
        out.truncate(self.actuators.len());
        out
    }

    /// Replaces the inputs of actuators without friction by the [efforts](Self::efforts_at); `state` is memory.
    pub fn turn_into_efforts(&self, inputs: &mut [f64], poses: Poses, state: &mut EffortState) {
        self.write_effort_state(poses, state);
        for (i, input) in inputs.iter_mut().enumerate() {
            *input = self.actuators.law(i, *input, state).effort;
        }
    }

    /// Returns the potential of the actuators for their inputs, J: `-Σ u y`, and of winches the energy of their tendons, `½ C a T²`.
    #[must_use]
    pub fn actuator_energy(
        &self,
        positions: &[Vector3<f64>],
        rotations: &[nalgebra::Matrix3<f64>],
        inputs: &[f64],
    ) -> f64 {
        let coordinates = self.actuator_coordinates(positions, rotations);
        let own = self.actuators.iter().zip(self.actuators.at_rest());
        (own.zip(coordinates.iter().zip(inputs)))
            .map(|((actuator, at_rest), (y, input))| match &actuator.winch {
                None => -(y * input),
                Some(winch) => {
                    let tension = winch.law(*input, *y, *at_rest).effort;
                    let length = winch.unstretched(*input, *at_rest);
                    0.5 * winch.compliance * length * tension * tension
                }
            })
            .sum::<f64>()
    }
}
