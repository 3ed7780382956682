//! Derivative of the equations of a step along the configuration at its end, one element per lane.

use std::marker::PhantomData;

use pulp::Simd;

use crate::lanes::active::ActiveBlocks;
use crate::lanes::element::{ANGULAR_STIFFNESS, LINEAR_STIFFNESS};
use crate::lanes::logarithm::Logarithm;
use crate::lanes::rule::{Rule, Strained, Stress};
use crate::lanes::vector::{Lanes, Mat3, Row, Vec3};
use cosserat::element::helical::HelicalChart;
use cosserat::element::{Helical, Trapezoidal};
use cosserat::part::Part;

/// Blocks over the motion and the rotation of end a, then of end b.
pub type Coupling<S> = [[Mat3<S>; 4]; 4];

/// An element at one instant: its strains, and `Rᵀ` of its ends.
#[derive(Clone, Copy)]
pub struct Instant<S: Simd> {
    pub strained: Strained<S>,
    pub to_body: [Mat3<S>; 2],
}

impl<S: Simd> Instant<S> {
    /// `Rᵀ` of one end, times `R` of the ends of the other instant.
    #[inline(always)]
    fn seen_from(&self, end: usize, start: &Self) -> [Mat3<S>; 2] {
        let to_body = self.to_body[end];
        let [a, b] = start.to_body;
        [to_body.product_transposed(a), to_body.product_transposed(b)]
    }
}

/// Derivative of one strain along some of the four motions of the ends.
struct Derivative<S: Simd, const N: usize> {
    along: [usize; N],
    blocks: [Mat3<S>; N],
}

/// A strain rule of steps that are solved for.
pub trait SolvedRule: Rule {
    /// `B_startᵀ C B_end` in the scale of the rule's constants. Motions are in the frames of the ends where the interval
    /// starts, rotations in their own.
    fn coupling<S: Simd>(constants: &[Row<S>], start: &Instant<S>, end: &Instant<S>)
    -> Coupling<S>;

    /// Adds `share B_startᵀ T B_end`, with the derivative `T` of the stress of the actuators of a block at a strain.
    fn add_active_coupling<S: Simd>(
        active: &ActiveBlocks<S>,
        block: usize,
        strain: &Stress<S>,
        share: Lanes<S>,
        instants: [&Instant<S>; 2],
        coupling: &mut Coupling<S>,
    );
}

/// Adds `share Lᵀ T R`, with the blocks of `T` over a linear strain and the angular one, and the derivatives `L` and `R` of both strains.
#[inline(always)]
fn add_tangent<S: Simd, const N: usize>(
    coupling: &mut Coupling<S>,
    left: (&Derivative<S, N>, &Derivative<S, 2>),
    [linear, mixed, angular]: [Mat3<S>; 3],
    right: (&Derivative<S, N>, &Derivative<S, 2>),
) {
    for (j, column) in right.0.along.into_iter().enumerate() {
        let moved = right.0.blocks[j];
        let stress = (linear.product(moved), mixed.transposed_product(moved));
        add_column(coupling, left, column, stress);
    }
    for (j, column) in right.1.along.into_iter().enumerate() {
        let turned = right.1.blocks[j];
        let stress = (mixed.product(turned), angular.product(turned));
        add_column(coupling, left, column, stress);
    }
}

/// Adds `Lᵀ` times the change of the linear and the angular stress along one motion.
#[inline(always)]
fn add_column<S: Simd, const N: usize>(
    coupling: &mut Coupling<S>,
    left: (&Derivative<S, N>, &Derivative<S, 2>),
    column: usize,
    (linear, angular): (Mat3<S>, Mat3<S>),
) {
    for (i, row) in left.0.along.into_iter().enumerate() {
        let block = &mut coupling[row][column];
        *block = *block + left.0.blocks[i].transposed_product(linear);
    }
    for (i, row) in left.1.along.into_iter().enumerate() {
        let block = &mut coupling[row][column];
        *block = *block + left.1.blocks[i].transposed_product(angular);
    }
}

/// The arguments of [`SolvedRule::add_active_coupling`].
pub struct ActiveCoupling<'a, S: Simd, R> {
    pub active: ActiveBlocks<'a, S>,
    pub block: usize,
    pub strain: Stress<S>,
    pub share: Lanes<S>,
    pub instants: [Instant<S>; 2],
    pub coupling: Coupling<S>,
    pub rule: PhantomData<R>,
}

impl<S: Simd, R: SolvedRule> Part for ActiveCoupling<'_, S, R> {
    type Output = Coupling<S>;

    #[inline(always)]
    fn run(self) -> Coupling<S> {
        let Self {
            active,
            block,
            strain,
            share,
            instants: [start, end],
            mut coupling,
            ..
        } = self;
        R::add_active_coupling(
            &active,
            block,
            &strain,
            share,
            [&start, &end],
            &mut coupling,
        );
        coupling
    }
}

#[inline(always)]
fn none<S: Simd>(simd: S) -> Coupling<S> {
    [[Mat3::zero(simd); 4]; 4]
}

/// Adds `B_startᵀ diag(stiffness) B_end` of one strain.
#[inline(always)]
fn add<S: Simd, const N: usize>(
    coupling: &mut Coupling<S>,
    start: &Derivative<S, N>,
    stiffness: Vec3<S>,
    end: &Derivative<S, N>,
) {
    for (j, column) in end.along.into_iter().enumerate() {
        let stressed = end.blocks[j].scale_rows(stiffness);
        for (i, row) in start.along.into_iter().enumerate() {
            let block = &mut coupling[row][column];
            *block = *block + start.blocks[i].transposed_product(stressed);
        }
    }
}

/// The strains along the motions of the ends, by their [chart](HelicalChart).
#[inline(always)]
fn helical<S: Simd>(
    instant: &Instant<S>,
    start: &Instant<S>,
) -> (Derivative<S, 4>, Derivative<S, 2>) {
    let Strained {
        chord: [y, _],
        psi,
        angle_squared,
        c,
        slope,
        ..
    } = instant.strained;
    let log = Logarithm {
        psi,
        angle_squared,
        c,
        slope,
        bend: slope,
    };
    let chart = HelicalChart::at(&log, y);
    let [seen_a, seen_b] = instant.seen_from(0, start);
    let (from_a, from_b) = (chart.s.product(seen_a), chart.s.product(seen_b));
    let [near, far] = chart.linear();
    let linear = Derivative {
        along: [0, 1, 2, 3],
        blocks: [-from_a, near, from_b, far],
    };
    let angular = Derivative {
        along: [1, 3],
        blocks: chart.angular(),
    };
    (linear, angular)
}

impl SolvedRule for Helical {
    #[inline(always)]
    fn coupling<S: Simd>(
        constants: &[Row<S>],
        start: &Instant<S>,
        end: &Instant<S>,
    ) -> Coupling<S> {
        let simd = start.strained.w.simd;
        let (ended, started) = (helical(end, start), helical(start, start));
        let mut coupling = none(simd);
        let stiffness = Vec3::load(simd, constants, LINEAR_STIFFNESS);
        add(&mut coupling, &started.0, stiffness, &ended.0);
        let stiffness = Vec3::load(simd, constants, ANGULAR_STIFFNESS);
        add(&mut coupling, &started.1, stiffness, &ended.1);
        coupling
    }

    #[inline(always)]
    fn add_active_coupling<S: Simd>(
        active: &ActiveBlocks<S>,
        block: usize,
        strain: &Stress<S>,
        share: Lanes<S>,
        [start, end]: [&Instant<S>; 2],
        coupling: &mut Coupling<S>,
    ) {
        let tangent = active.tangent::<1>(block, strain.linear, strain.angular);
        let blocks = [
            tangent.linear[0] * share,
            tangent.mixed[0] * share,
            tangent.angular * share,
        ];
        let (ended, started) = (helical(end, start), helical(start, start));
        add_tangent(
            coupling,
            (&started.0, &started.1),
            blocks,
            (&ended.0, &ended.1),
        );
    }
}

/// `δy_i = R_iᵀ δdx + ŷ_i η_i` at end `i`.
#[inline(always)]
fn stretch<S: Simd>(instant: &Instant<S>, start: &Instant<S>, end: usize) -> Derivative<S, 3> {
    let [from_a, from_b] = instant.seen_from(end, start);
    let turned = Mat3::hat(instant.strained.chord[end]);
    if end == 0 {
        Derivative {
            along: [0, 1, 2],
            blocks: [-from_a, turned, from_b],
        }
    } else {
        Derivative {
            along: [0, 2, 3],
            blocks: [-from_a, from_b, turned],
        }
    }
}

/// `δψ = P η_b - Pᵀ η_a`
#[inline(always)]
fn bend<S: Simd>(instant: &Instant<S>) -> Derivative<S, 2> {
    let psi = instant.strained.psi * 2.0;
    let one = Mat3::multiple(Lanes::splat(psi.x.simd, 1.0));
    let p = one + Mat3::hat(psi) * 0.5 + Mat3::outer(psi, psi) * 0.25;
    Derivative {
        along: [1, 3],
        blocks: [-p.transpose(), p],
    }
}

impl SolvedRule for Trapezoidal {
    #[inline(always)]
    fn coupling<S: Simd>(
        constants: &[Row<S>],
        start: &Instant<S>,
        end: &Instant<S>,
    ) -> Coupling<S> {
        let simd = start.strained.w.simd;
        let mut coupling = none(simd);
        let stiffness = Vec3::load(simd, constants, LINEAR_STIFFNESS);
        for at in 0..2 {
            let (started, ended) = (stretch(start, start, at), stretch(end, start, at));
            add(&mut coupling, &started, stiffness, &ended);
        }
        // That of the rule is for the measure ψ/2.
        let stiffness = Vec3::load(simd, constants, ANGULAR_STIFFNESS) * 0.5;
        add(&mut coupling, &bend(start), stiffness, &bend(end));
        coupling
    }

    #[inline(always)]
    fn add_active_coupling<S: Simd>(
        active: &ActiveBlocks<S>,
        block: usize,
        strain: &Stress<S>,
        share: Lanes<S>,
        [start, end]: [&Instant<S>; 2],
        coupling: &mut Coupling<S>,
    ) {
        let tangent = active.tangent::<2>(block, strain.linear, strain.angular * 2.0);
        let (turned, turning) = (bend(start), bend(end));
        let none = Mat3::zero(share.simd);
        for at in 0..2 {
            let (started, ended) = (stretch(start, start, at), stretch(end, start, at));
            let angular = if at == 0 { tangent.angular } else { none };
            let blocks = [
                tangent.linear[at] * share,
                tangent.mixed[at] * share,
                angular * share,
            ];
            add_tangent(coupling, (&started, &turned), blocks, (&ended, &turning));
        }
    }
}
