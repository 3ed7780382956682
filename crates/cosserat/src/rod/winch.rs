//! Winches: tendons whose input is a displacement.

/// A winch that pulls a tendon in and lets it out.
///
/// With the length `ℓ` of the tendon in the arm, `ℓ₀` that in the stress-free arm, the length `b` outside of it, and the displacement `z`
/// of the winch, positive where it lets out, the tendon would have the length `a = ℓ₀ + b + z` without tension. Its tension stretches it:
///
/// ```text
/// ℓ + b = a (1 + C T),   T ≥ 0        T = <ℓ - ℓ₀ - z>₊ / (C a)
/// ```
///
/// (Till et al. 2019, ContinuumRobotExamples, 02_Dynamics). The potential is that of a spring, `½ <ℓ - ℓ₀ - z>₊² / (C a)`, and a tendon
/// that is longer than its way is slack.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Winch {
    /// `C`, strain of the tendon per tension, 1/N.
    pub compliance: f64,
    /// `b`, m.
    pub outside: f64,
}

/// The effort of an actuator as a function of its input and its coordinate, with derivatives.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EffortLaw {
    /// `u`
    pub effort: f64,
    /// `∂u/∂y`, not positive.
    pub along_coordinate: f64,
    /// `∂u/∂z` along the input `z`.
    pub along_input: f64,
    /// `∂²u/∂y∂z`
    pub mixed: f64,
    /// `∂²u/∂z²`
    pub bend: f64,
}

impl Winch {
    /// Returns the length of the tendon without tension, m, for a displacement and the coordinate `-ℓ₀` of the stress-free arm.
    pub(super) fn unstretched(&self, displacement: f64, at_rest: f64) -> f64 {
        self.outside - at_rest + displacement
    }

    /// Returns the tension at a displacement (m) and a coordinate `y = -ℓ` (m), with `-ℓ₀` in the stress-free arm: zero if it is slack.
    #[must_use]
    pub fn law(&self, displacement: f64, coordinate: f64, at_rest: f64) -> EffortLaw {
        if !(at_rest - coordinate - displacement > 0.0) {
            return EffortLaw::default();
        }
        self.law_of_a_spring(displacement, coordinate, at_rest)
    }

    /// Returns [`Self::law`] of a tendon that pushes where it is too long: the smooth continuation of that of a taut one.
    pub(super) fn law_of_a_spring(
        &self,
        displacement: f64,
        coordinate: f64,
        at_rest: f64,
    ) -> EffortLaw {
        let length = self.unstretched(displacement, at_rest);
        let stretched = self.outside - coordinate;
        let beyond = at_rest - coordinate - displacement;
        let stiffness = 1.0 / (self.compliance * length);
        let ratio = stretched / length;
        EffortLaw {
            effort: beyond * stiffness,
            along_coordinate: -stiffness,
            along_input: -ratio * stiffness,
            mixed: stiffness / length,
            bend: 2.0 * ratio * stiffness / length,
        }
    }

    /// Returns by how much a tendon is too long for a tension `T` (N), m: `(ℓ₀ + b + z)(1 + C T) - (ℓ + b)`, not positive where its tension
    /// is at least `T`.
    pub(super) fn too_long(
        &self,
        tension: f64,
        displacement: f64,
        coordinate: f64,
        at_rest: f64,
    ) -> f64 {
        let stretch = self.compliance * tension * self.unstretched(displacement, at_rest);
        coordinate + displacement - at_rest + stretch
    }

    /// Returns the displacement at which a tendon with a tension (N) and a coordinate is as long as it is, m: `(ℓ + b)/(1 + C T) - ℓ₀ - b`.
    #[must_use]
    pub fn displacement(&self, tension: f64, coordinate: f64, at_rest: f64) -> f64 {
        // Without the cancellation of two lengths.
        let stretch = self.compliance * tension;
        (at_rest - coordinate - stretch * self.unstretched(0.0, at_rest)) / (1.0 + stretch)
    }
}
