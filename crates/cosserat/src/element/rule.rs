//! The common code of all strain rules: one element in each lane of a vector; with one lane it is the plain code.
//!
//! Strains are multiplied by the length of the element here, so that forces and moments are the derivatives along `(δdx, η_a, η_b)`
//! themselves.

use pulp::Simd;

use super::Element;
use crate::part::{Part, apart};
use crate::vector::{Lanes, Mat3, Quaternion, Vec3};

/// A matrix over `(dx; body a; body b)`, in blocks.
pub type Blocks<S> = [[Mat3<S>; 3]; 3];

/// The rule [`StrainRule::Helical`](crate::StrainRule::Helical).
pub struct Helical;

/// The rule [`StrainRule::Trapezoidal`](crate::StrainRule::Trapezoidal).
pub struct Trapezoidal;

/// A stress, or a strain times the length: linear at the two ends, and angular. The helical rule uses the first linear one only.
#[derive(Clone, Copy, Debug)]
pub struct Stress<S: Simd> {
    pub linear: [Vec3<S>; 2],
    pub angular: Vec3<S>,
}

impl<S: Simd> Stress<S> {
    #[inline(always)]
    pub fn zero(simd: S) -> Self {
        Self {
            linear: [Vec3::zero(simd); 2],
            angular: Vec3::zero(simd),
        }
    }

    #[inline(always)]
    pub fn plus(self, other: Self) -> Self {
        Self {
            linear: [
                self.linear[0] + other.linear[0],
                self.linear[1] + other.linear[1],
            ],
            angular: self.angular + other.angular,
        }
    }

    #[inline(always)]
    pub fn minus(self, other: Self) -> Self {
        self.plus(other.times(Lanes::splat(other.angular.x.simd, -1.0)))
    }

    #[inline(always)]
    pub fn times(self, factor: Lanes<S>) -> Self {
        Self {
            linear: [self.linear[0] * factor, self.linear[1] * factor],
            angular: self.angular * factor,
        }
    }
}

/// Stress per strain times the length, and the strain at rest times the length.
#[derive(Clone, Copy)]
pub struct Elasticity<S: Simd> {
    pub c1: Vec3<S>,
    pub c2: Vec3<S>,
    pub rest: Stress<S>,
}

impl<S: Simd> Elasticity<S> {
    #[inline(always)]
    pub fn of<R: TangentRule>(simd: S, element: &Element) -> Self {
        let l = element.length;
        let rest = |end: usize| Vec3::splat(simd, &(element.rest.linear[end] * l));
        Self {
            c1: Vec3::splat(simd, &(element.linear_stiffness * (R::END_WEIGHT / l))),
            c2: Vec3::splat(simd, &(element.angular_stiffness / l)),
            rest: Stress {
                linear: [rest(0), rest(1)],
                angular: Vec3::splat(simd, &(element.rest.curvature * l)),
            },
        }
    }

    /// Returns the stress of a strain from which that at rest was subtracted.
    #[inline(always)]
    pub fn stress(&self, strain: Stress<S>) -> Stress<S> {
        Stress {
            linear: [
                strain.linear[0].component_mul(self.c1),
                strain.linear[1].component_mul(self.c1),
            ],
            angular: strain.angular.component_mul(self.c2),
        }
    }

    /// Returns the law with `factor` times the stiffness.
    #[inline(always)]
    pub fn times(&self, factor: Lanes<S>) -> Self {
        Self {
            c1: self.c1 * factor,
            c2: self.c2 * factor,
            ..*self
        }
    }
}

/// A strain rule with its derivatives.
pub trait TangentRule {
    /// Data of an element's pose that the rule uses.
    type Pose<S: Simd>: Copy;
    /// Number of ends at which the linear strain is taken; that at one is the same at both.
    const ENDS: usize;
    /// Weight of each of these ends.
    const END_WEIGHT: f64 = 1.0 / Self::ENDS as f64;
    /// Nonzero blocks of [`Self::derivative`].
    const PATTERN: [[bool; 3]; 3];

    /// Computes the data of a pose whose ends are less than half a turn apart; near half a turn digits are lost.
    fn pose<S: Simd>(dx: Vec3<S>, a: Mat3<S>, b: Mat3<S>) -> Self::Pose<S>;

    /// Computes the data of any pose, with the quaternion of `R_aᵀ R_b`.
    fn pose_at<S: Simd>(
        dx: Vec3<S>,
        a: Mat3<S>,
        b: Mat3<S>,
        relative: Quaternion<S>,
    ) -> Self::Pose<S>;

    /// Returns the strain times the length.
    fn strain<S: Simd>(pose: &Self::Pose<S>) -> Stress<S>;

    /// Returns the derivative of the strain: rows of the linear strain at either end, of which the helical rule has one, and of the angular
    /// one.
    fn derivative<S: Simd>(pose: &Self::Pose<S>) -> Blocks<S>;

    /// Returns `Bᵀ` times a stress: `(F, M_a, M_b)`, see [`ElementGradient`](super::ElementGradient).
    fn pull<S: Simd>(pose: &Self::Pose<S>, stress: &Stress<S>) -> [Vec3<S>; 3];

    /// Returns the derivative of the pull along `(δdx, η_a, η_b)` if the stress changes with the stiffness of a law.
    fn stiffness_under<S: Simd>(
        law: &Elasticity<S>,
        pose: &Self::Pose<S>,
        stress: &Stress<S>,
    ) -> Blocks<S>;

    /// Returns `B_startᵀ C B_end`, the derivative of the pull at one instant along the pose at another.
    fn coupling<S: Simd>(
        law: &Elasticity<S>,
        start: &Self::Pose<S>,
        end: &Self::Pose<S>,
    ) -> Blocks<S>;

    /// Returns the gradient `(F, M_a, M_b)` of an element's energy in a pose.
    #[inline(always)]
    fn gradient<S: Simd>(element: &Element, dx: Vec3<S>, a: Mat3<S>, b: Mat3<S>) -> [Vec3<S>; 3]
    where
        Self: Sized,
    {
        let (pose, law) = (
            Self::pose(dx, a, b),
            Elasticity::of::<Self>(dx.x.simd, element),
        );
        Self::pull(&pose, &law.stress(Self::strain(&pose).minus(law.rest)))
    }

    /// Returns the stiffness of an element in a pose.
    #[inline(always)]
    fn stiffness<S: Simd>(element: &Element, dx: Vec3<S>, a: Mat3<S>, b: Mat3<S>) -> Blocks<S>
    where
        Self: Sized,
    {
        let (pose, law) = (
            Self::pose(dx, a, b),
            Elasticity::of::<Self>(dx.x.simd, element),
        );
        let stress = law.stress(Self::strain(&pose).minus(law.rest));
        stiffness_under::<S, Self>(&law, &pose, &stress)
    }
}

/// Returns [`TangentRule::stiffness_under`], compiled once.
#[inline(always)]
pub fn stiffness_under<S: Simd, R: TangentRule>(
    law: &Elasticity<S>,
    pose: &R::Pose<S>,
    stress: &Stress<S>,
) -> Blocks<S> {
    let part: StiffnessUnder<S, R> = StiffnessUnder { law, pose, stress };
    apart(law.c1.x.simd, part)
}

struct StiffnessUnder<'a, S: Simd, R: TangentRule> {
    law: &'a Elasticity<S>,
    pose: &'a R::Pose<S>,
    stress: &'a Stress<S>,
}

impl<S: Simd, R: TangentRule> Part for StiffnessUnder<'_, S, R> {
    type Output = Blocks<S>;

    #[inline(always)]
    fn run(self) -> Blocks<S> {
        R::stiffness_under(self.law, self.pose, self.stress)
    }
}

/// The poses of elements for whose ends a computation holds.
pub trait Turns<S: Simd> {
    /// Returns the data of a rule for a pose.
    fn pose<R: TangentRule>(dx: Vec3<S>, a: Mat3<S>, b: Mat3<S>) -> R::Pose<S>;
}

/// Elements whose ends are turned against each other by less than half a turn, with a margin.
pub struct MildTurn;

/// All elements, one at a time.
pub struct AnyTurn;

impl<S: Simd> Turns<S> for MildTurn {
    #[inline(always)]
    fn pose<R: TangentRule>(dx: Vec3<S>, a: Mat3<S>, b: Mat3<S>) -> R::Pose<S> {
        R::pose(dx, a, b)
    }
}

/// Step of the central difference, in strain and in radians: the cube root of the rounding unit, where truncation (step²) and rounding
/// (unit/step) are of the same size.
pub const DIFFERENCE_STEP: f64 = 6e-6;

/// The displaced pose for the element's curvature (`sensitivity::curvature::element_curvature`) along a covector.
#[derive(Clone, Copy)]
pub struct Displacement<S: Simd> {
    pub covector: [Vec3<S>; 3],
    size: Lanes<S>,
    step: Lanes<S>,
}

impl<S: Simd> Displacement<S> {
    #[inline(always)]
    pub fn along(covector: [Vec3<S>; 3], length: f64) -> Self {
        let one = Lanes::splat(covector[0].x.simd, 1.0);
        let turns = covector[1].norm().max(covector[2].norm());
        let size = (covector[0].norm() * (1.0 / length)).max(turns);
        // A zero covector has a zero difference.
        let size = size.select_below(f64::MIN_POSITIVE, one, size);
        Self {
            covector,
            size,
            step: one / size * DIFFERENCE_STEP,
        }
    }

    /// Returns displacements along two covectors at once, by the same step.
    #[inline(always)]
    pub fn along_both(start: [Vec3<S>; 3], end: [Vec3<S>; 3], length: f64) -> [Self; 2] {
        let (start, end) = (Self::along(start, length), Self::along(end, length));
        let one = Lanes::splat(start.size.simd, 1.0);
        let size = start.size_or_zero().max(end.size_or_zero());
        let size = size.select_below(f64::MIN_POSITIVE, one, size);
        let step = one / size * DIFFERENCE_STEP;
        let (start, end) = (start.covector, end.covector);
        [
            Self {
                covector: start,
                size,
                step,
            },
            Self {
                covector: end,
                size,
                step,
            },
        ]
    }

    /// Returns the size of the covector; a zero one has size one otherwise, which is no size to compare with.
    #[inline(always)]
    fn size_or_zero(&self) -> Lanes<S> {
        let [dx, a, b] = self.covector;
        let square = dx.dot(dx) + a.dot(a) + b.dot(b);
        let zero = Lanes::splat(self.size.simd, 0.0);
        square.select_below(f64::MIN_POSITIVE, zero, self.size)
    }

    /// Returns the pose moved by `sign` steps.
    #[inline(always)]
    pub fn moved(&self, dx: Vec3<S>, [a, b]: [Mat3<S>; 2], sign: f64) -> (Vec3<S>, [Mat3<S>; 2]) {
        let step = self.step * sign;
        let turned_a = a.product(small_turn(self.covector[1] * step));
        let turned_b = b.product(small_turn(self.covector[2] * step));
        (dx + self.covector[0] * step, [turned_a, turned_b])
    }

    /// Returns the derivative along the covector, from the values ahead and behind.
    #[inline(always)]
    pub fn difference(&self, ahead: Mat3<S>, behind: Mat3<S>) -> Mat3<S> {
        (ahead - behind) * (self.size * (0.5 / DIFFERENCE_STEP))
    }

    /// Returns the derivative along the pose of the gradient's product with the covector, from the gradients here, ahead and behind: `Kᵀ λ =
    /// E_λ g + λ × g`, the second term for rotations only.
    #[inline(always)]
    pub fn slope(&self, [here, ahead, behind]: &[[Vec3<S>; 3]; 3]) -> [Vec3<S>; 3] {
        let scale = self.size * (0.5 / DIFFERENCE_STEP);
        [
            (ahead[0] - behind[0]) * scale,
            (ahead[1] - behind[1]) * scale + self.covector[1].cross(here[1]),
            (ahead[2] - behind[2]) * scale + self.covector[2].cross(here[2]),
        ]
    }

    /// Returns the block of the curvature with rows along the pose of this displacement and columns along that of another one, which moved
    /// by the same step, from the derivatives of the gradient here, ahead and behind.
    #[inline(always)]
    pub fn mixed_curvature(
        &self,
        other: &Self,
        [here, ahead, behind]: &[Blocks<S>; 3],
    ) -> Blocks<S> {
        let simd = self.size.simd;
        let mut k = [[Mat3::zero(simd); 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                let mut block = self.difference(ahead[i][j], behind[i][j]);
                if j > 0 {
                    block = block - here[i][j].product_hat(other.covector[j]);
                }
                if i > 0 {
                    block = block + Mat3::hat_product(self.covector[i], here[i][j]);
                }
                k[i][j] = block;
            }
        }
        k
    }

    /// Returns the curvature, from the stiffness here, ahead and behind.
    #[inline(always)]
    pub fn curvature(&self, found: &[Blocks<S>; 3]) -> Blocks<S> {
        let mut k = self.mixed_curvature(self, found);
        for i in 0..3 {
            k[i][i] = k[i][i].symmetric();
            for j in 0..i {
                k[i][j] = (k[i][j] + k[j][i].transpose()) * 0.5;
                k[j][i] = k[i][j].transpose();
            }
        }
        k
    }
}

/// Returns `exp(v̂)` for a vector of at most [`DIFFERENCE_STEP`]: `I + (1 - θ²/6) v̂ + v̂²/2`, with the error `θ⁴/24`.
#[inline(always)]
fn small_turn<S: Simd>(v: Vec3<S>) -> Mat3<S> {
    let square = v.dot(v);
    let one = Lanes::splat(v.x.simd, 1.0);
    Mat3::multiple(one - square * 0.5)
        + Mat3::outer(v, v) * 0.5
        + Mat3::hat(v) * (one - square * (1.0 / 6.0))
}
