//! Parts of a linearization that are the same for all strain rules, or stand in it more than once; each is compiled as a function of its own.

use std::marker::PhantomData;

use pulp::Simd;

use super::{Group, Reach};
use cosserat::part::{Part, apart};
use cosserat::vector::Lanes;

/// A part of a linearization.
pub trait Work<S: Simd> {
    /// Does it; counts what is irregular, lane by lane.
    fn run(group: &mut Group, simd: S) -> Lanes<S>;
}

/// Drifts of the nodes, with the curvatures of their inertia.
pub struct Drifts<P>(PhantomData<P>);

/// Spins of the nodes, where steps are solved for.
pub struct Spins<P>(PhantomData<P>);

/// Factors of what is solved for.
pub struct Factors;

/// Curvatures of the inertia of all nodes over the intervals; none is irregular.
pub struct Inertias;

impl<S: Simd, P: Reach<S>> Work<S> for Drifts<P> {
    #[inline(always)]
    fn run(group: &mut Group, simd: S) -> Lanes<S> {
        group.drifts::<S, P>(simd)
    }
}

impl<S: Simd, P: Reach<S>> Work<S> for Spins<P> {
    #[inline(always)]
    fn run(group: &mut Group, simd: S) -> Lanes<S> {
        group.spins::<S, P>(simd)
    }
}

impl<S: Simd> Work<S> for Factors {
    #[inline(always)]
    fn run(group: &mut Group, simd: S) -> Lanes<S> {
        group.factors(simd)
    }
}

impl<S: Simd> Work<S> for Inertias {
    #[inline(always)]
    fn run(group: &mut Group, simd: S) -> Lanes<S> {
        for node in 0..group.along.motion.rod.n_nodes() {
            group.inertia_curvatures(simd, node);
        }
        Lanes::splat(simd, 0.0)
    }
}

/// The arguments of [`Group::apart`].
struct Apart<'a, 'b, S, W> {
    group: &'a mut Group<'b>,
    simd: S,
    work: PhantomData<W>,
}

impl<S: Simd, W: Work<S>> Part for Apart<'_, '_, S, W> {
    type Output = Lanes<S>;

    #[inline(always)]
    fn run(self) -> Lanes<S> {
        W::run(self.group, self.simd)
    }
}

impl Group<'_> {
    /// Does a part of the linearization; counts what is irregular, lane by lane.
    #[inline(always)]
    pub(crate) fn apart<S: Simd, W: Work<S>>(&mut self, simd: S) -> Lanes<S> {
        let part = Apart {
            group: self,
            simd,
            work: PhantomData::<W>,
        };
        apart(simd, part)
    }
}
