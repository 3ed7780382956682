"""Motions under sequences of controls, with derivatives of any function of their states: along the controls, the state at the start, and
numbers of the arm. With PyTorch and JAX they are functions like any other of these."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from . import _softarm
from .control import State
from .scene import Scene


class Gradient(NamedTuple):
    """Derivatives of a function of the states of a motion."""

    efforts: np.ndarray
    """Along the efforts, in their shape; without columns where none were given."""
    wrenches: np.ndarray
    """Along the wrenches, `(..., rows, w, 6)`, also where none were given: then at zero."""
    values: np.ndarray
    """Along the numbers of the arm, `(..., p)`."""
    start: State
    """Along the state at the start. Only its part along rotations counts of `R`."""


class Motion:
    """A motion of `n` intervals: states at the ends of all, the start first, with the axis of a batch before that of time.

    Positions `x` are `(..., n+1, K+1, 3)` in m, rotations `R` `(..., n+1, K+1, 3, 3)`, velocities `v` in m/s and, in the frames of the nodes,
    angular velocities `w` in rad/s.
    """

    __slots__ = ("_native", "_is_batch", "x", "R", "v", "w")

    def __init__(self, native: _softarm.Motions, is_batch: bool):
        self._native, self._is_batch = native, is_batch
        self.x, self.R, self.v, self.w = (own if is_batch else own[0] for own in native.states())

    @property
    def tip(self) -> np.ndarray:
        """Position of the tip, m, `(..., n+1, 3)`."""
        return self.x[..., -1, :]

    @property
    def end(self) -> State:
        """The state at the end, from which another motion may start."""
        return State(self.x[..., -1, :, :], self.R[..., -1, :, :, :], self.v[..., -1, :, :], self.w[..., -1, :, :])

    def gradient(
        self,
        x: npt.ArrayLike | None = None,
        R: npt.ArrayLike | None = None,
        v: npt.ArrayLike | None = None,
        w: npt.ArrayLike | None = None,
        *,
        tip: npt.ArrayLike | None = None,
        values: bool = True,
        threads: int | None = None,
    ) -> Gradient:
        """Returns the derivatives of a function of the states, a sum over a batch, from its own along `x`, `R`, `v`, `w`, which have their shapes;
        `tip` is that along `tip`. Without `values` the numbers of the arm are left out.
        """
        given: list[np.ndarray | None] = []
        for name, own, like in [("x", x, self.x), ("R", R, self.R), ("v", v, self.v), ("w", w, self.w)]:
            array = None if own is None else np.asarray(own, float)
            if array is not None and array.shape != like.shape:
                raise ValueError(f"{name} has the shape {array.shape}; expected {like.shape}")
            given.append(array)
        if tip is not None:
            along = np.zeros_like(self.x) if given[0] is None else given[0].copy()
            along[..., -1, :] += np.asarray(tip, float)
            given[0] = along
        rx, rR, rv, rw = (own if own is None or self._is_batch else own[None] for own in given)
        efforts, wrenches, numbers, start = self._native.pull_back(rx, rR, rv, rw, numbers=values, threads=threads)
        if not self._is_batch:
            efforts, wrenches, numbers, start = efforts[0], wrenches[0], numbers[0], [own[0] for own in start]
        return Gradient(efforts, wrenches, numbers, State(*start))


class Rollout:
    """Motions of a scene's arm: that of its `[plant]`, if it has a closed loop, or of `[rod]`, as a `Plant` has.

    A control holds for `dt` seconds; with `linear` it goes linearly from one row to the next, and there is one more row than intervals. `numbers` are
    dotted keys of the scene, as `rod.material.youngs_modulus_pa` or `tendon.0.offset_m.1`, along which motions are to be differentiated. `nodes` are
    those on which wrenches act, counted from the base, or from the tip if negative.

        rollout = sa.Rollout(scene, 0.02, ["rod.material.youngs_modulus_pa"])
        motion = rollout(efforts)                             # (n, m), or (batch, n, m)
        gradient = motion.gradient(tip=2 * (motion.tip - goal))
        gradient.efforts, gradient.values

    Time begins at 0. The length of the time steps is that of the scene with its own numbers, also where others are given.
    """

    def __init__(
        self, scene: Scene, dt: float, numbers: Sequence[str] = (), *, linear: bool = False, nodes: Sequence[int] = ()
    ):
        self.scene, self.dt, self.numbers, self.linear = scene, float(dt), tuple(numbers), linear
        self.nodes = tuple(nodes)
        self._has_warned = False
        overrides = list(scene._overrides)
        self._native = _softarm.Rollout(
            scene._name, scene._text, overrides, self.dt, list(self.numbers), linear, list(self.nodes)
        )

    @property
    def actuators(self) -> list[str]:
        """Names of the actuators, in the order of efforts."""
        return self._native.actuators

    @property
    def values(self) -> np.ndarray:
        """Values of the numbers in the scene."""
        return self._native.values

    def __repr__(self) -> str:
        return f"<softarm.Rollout of {self.scene.name!r}: {self.dt} s, {len(self.numbers)} numbers>"

    def __reduce__(self) -> tuple[Any, ...]:
        return _again, (self.scene, self.dt, self.numbers, self.linear, self.nodes)

    def __call__(
        self,
        efforts: npt.ArrayLike | None = None,
        *,
        wrenches: npt.ArrayLike | None = None,
        values: npt.ArrayLike | None = None,
        start: State | None = None,
        intervals: int | None = None,
        threads: int | None = None,
    ) -> Motion:
        """Moves the arm under rows of efforts `(rows, m)` in the units of the actuators (of winches displacements in m) and of wrenches
        `(rows, w, 6)` on `nodes`: force in N, spatial, and moment in N m, in the frame of the node. Without efforts those of the scene act, and
        without both there are so many `intervals`.

        `values` are those of the numbers, `(p,)`, and `start` is a state in place of that of the scene. Each of these may have an axis of a batch
        first. A motion that has no next step raises `ModelError`. Efforts beyond bounds act as they are, so that a descent may pass there: a warning
        says so once.
        """
        own = None if efforts is None else np.asarray(efforts, float)
        pulls = None if wrenches is None else np.asarray(wrenches, float)
        numbers = None if values is None else np.asarray(values, float)
        begin = None if start is None else [np.asarray(part, float) for part in start]
        dimensions = [(own, 2), (pulls, 3), (numbers, 1), (None if begin is None else begin[0], 2)]
        batches = {len(array) for array, plain in dimensions if array is not None and array.ndim == plain + 1}
        if len(batches) > 1:
            raise ValueError(f"batches of {sorted(batches)} rows: give one length, or arrays without that axis")
        is_batch = bool(batches)
        batch = batches.pop() if is_batch else 1
        rows = {array.shape[array.ndim - plain] for array, plain in dimensions[:2] if array is not None}
        if len(rows) > 1:
            raise ValueError(f"efforts and wrenches have {sorted(rows)} rows: give as many of each")
        if not rows and intervals is None:
            raise ValueError("give efforts, wrenches, or the number of intervals")
        n_rows = rows.pop() if rows else int(intervals or 0) + self.linear

        def spread(array: np.ndarray | None, plain: int) -> np.ndarray | None:
            if array is None or array.ndim == plain + 1:
                return array
            return np.broadcast_to(array, (batch, *array.shape))

        begun = None if begin is None else [spread(part, 3 if i == 1 else 2) for i, part in enumerate(begin)]
        native = self._native.run(
            batch, n_rows, spread(own, 2), spread(pulls, 3), spread(numbers, 1), begun, threads
        )
        if own is not None and not self._has_warned and (beyond := self._native.beyond(own)):
            self._has_warned = True
            words = f"efforts beyond bounds, which a plant refuses and a rollout takes as they are: {beyond}; clip them where they matter"
            warnings.warn(words, stacklevel=2)
        return Motion(native, is_batch)

    def to_torch(self) -> Callable[..., tuple[Any, Any, Any, Any]]:
        """Returns the rollout as a function of tensors of PyTorch, which takes part in its differentiation: `f(efforts=None, wrenches=None, values=None,
        start=None, intervals=None)` returns `x`, `R`, `v`, `w` in the type of its first tensor.
        """
        import torch  # type: ignore[import-not-found,import-untyped,unused-ignore]

        def forward(context: Any, intervals: int | None, *tensors: Any) -> Any:
            arrays = [None if own is None else own.detach().cpu().numpy() for own in tensors]
            context.motion, context.given = self._of(arrays, intervals), tensors
            like = next((own for own in tensors if own is not None), torch.zeros(1, dtype=torch.float64))
            states = (context.motion.x, context.motion.R, context.motion.v, context.motion.w)
            return tuple(torch.as_tensor(own, dtype=like.dtype, device=like.device) for own in states)

        def backward(context: Any, *along: Any) -> Any:
            if torch.is_grad_enabled():
                raise RuntimeError("a rollout has no second derivatives: leave create_graph out")
            arrays = [own.detach().cpu().double().numpy() for own in along]
            values = context.given[2]
            found = context.motion.gradient(*arrays, values=values is not None and values.requires_grad)
            slopes: list[Any] = [None]
            for own, slope in zip(context.given, [found.efforts, found.wrenches, found.values, *found.start]):
                if own is None or not own.requires_grad:
                    slopes.append(None)
                    continue
                # What has no axis of a batch is the same for all of its rows.
                slope = slope.sum(axis=0) if slope.ndim > own.ndim else slope
                slopes.append(torch.as_tensor(slope, dtype=own.dtype, device=own.device))
            return tuple(slopes)

        parts = {"forward": staticmethod(forward), "backward": staticmethod(backward)}
        function: Any = type("Rollout", (torch.autograd.Function,), parts)

        def rolled(
            efforts: Any = None, wrenches: Any = None, values: Any = None, start: Any = None, intervals: int | None = None
        ) -> Any:
            return function.apply(intervals, efforts, wrenches, values, *(start or (None,) * 4))

        return rolled

    def to_jax(self) -> Callable[..., tuple[Any, Any, Any, Any]]:
        """Returns the rollout as a function of arrays of JAX, with its derivative backward: `f(efforts=None, values=None, wrenches=None, start=None,
        intervals=None)` returns `x`, `R`, `v`, `w` in the type of its first array. It runs outside of the compiled program, on the processor, and
        `jax.vmap` makes a batch of it. Axes of batches that not all arguments have are those of NumPy's rules.
        """
        import jax  # type: ignore[import-not-found,import-untyped,unused-ignore]
        import jax.numpy as jnp  # type: ignore[import-not-found,import-untyped,unused-ignore]

        plain, n_nodes = (2, 3, 1, 2, 3, 2, 2), self._native.n_nodes

        def made(given: tuple[int, ...], intervals: int | None) -> Any:
            """The function of the arguments at these places, which have the same axes of batches."""

            def lead(arrays: Sequence[Any]) -> tuple[int, ...]:
                return arrays[0].shape[: arrays[0].ndim - plain[given[0]]]

            def motion_of(arrays: Sequence[Any]) -> Motion:
                own: list[Any] = [None] * len(plain)
                for place, array in zip(given, arrays):
                    array = np.asarray(array, float)
                    inner = array.shape[array.ndim - plain[place] :]
                    own[place] = array.reshape((-1, *inner)) if array.ndim > plain[place] else array
                return self._of(own, intervals)

            def shapes(arrays: Sequence[Any]) -> Any:
                rows = next((a.shape[a.ndim - plain[i]] for i, a in zip(given, arrays) if i < 2), None)
                n = (intervals or 0) if rows is None else rows - self.linear
                times = (*lead(arrays), n + 1, n_nodes)
                return tuple(jax.ShapeDtypeStruct(times + own, arrays[0].dtype) for own in [(3,), (3, 3), (3,), (3,)])

            def states(*arrays: Any) -> Any:
                motion = motion_of(arrays)
                parts = zip((motion.x, motion.R, motion.v, motion.w), shapes(arrays))
                return tuple(own.reshape(like.shape).astype(like.dtype) for own, like in parts)

            def slopes(*both: Any) -> Any:
                arrays, along = both[: len(given)], both[len(given) :]
                motion = motion_of(arrays)
                parts = zip(along, (motion.x, motion.R, motion.v, motion.w))
                found = motion.gradient(*(np.asarray(own, float).reshape(like.shape) for own, like in parts), values=2 in given)
                every = [found.efforts, found.wrenches, found.values, *found.start]
                return tuple(every[i].reshape(array.shape).astype(array.dtype) for i, array in zip(given, arrays))

            def called(*arrays: Any) -> Any:
                return jax.pure_callback(states, shapes(arrays), *arrays, vmap_method="broadcast_all")

            rolled: Any = jax.custom_vjp(called)

            def forward(*arrays: Any) -> Any:
                return rolled(*arrays), arrays

            def backward(kept: Any, along: Any) -> Any:
                like = tuple(jax.ShapeDtypeStruct(own.shape, own.dtype) for own in kept)
                return jax.pure_callback(slopes, like, *kept, *along, vmap_method="broadcast_all")

            rolled.defvjp(forward, backward)
            return rolled

        known = functools.cache(made)

        def whole(
            efforts: Any = None, values: Any = None, wrenches: Any = None, start: State | None = None, intervals: int | None = None
        ) -> Any:
            every = [efforts, wrenches, values, *(start or (None,) * 4)]
            given = tuple(i for i, own in enumerate(every) if own is not None)
            if not given:
                raise ValueError("give efforts, wrenches, values or a start: without any there is nothing to differentiate along")
            first = jnp.asarray(every[given[0]])
            arrays = [jnp.asarray(every[i], first.dtype) for i in given]
            short = [i for i, own in zip(given, arrays) if own.ndim < plain[i]]
            if short:
                raise ValueError(f"{_ARGUMENTS[short[0]]} has too few axes: {plain[short[0]]} or more are expected")
            axes = jnp.broadcast_shapes(*(own.shape[: own.ndim - plain[i]] for i, own in zip(given, arrays)))
            spread = [jnp.broadcast_to(own, axes + own.shape[own.ndim - plain[i] :]) for i, own in zip(given, arrays)]
            return known(given, intervals)(*spread)

        return whole

    def _of(self, arrays: Sequence[Any], intervals: int | None) -> Motion:
        """Returns the motion of efforts, wrenches, values, and the four parts of the start."""
        efforts, wrenches, values, *start = arrays
        begin = None if start[0] is None else State(*start)
        return self(efforts, wrenches=wrenches, values=values, start=begin, intervals=intervals)


_ARGUMENTS = ("efforts", "wrenches", "values", "x of the start", "R of the start", "v of the start", "w of the start")


def _again(scene: Scene, dt: float, numbers: Sequence[str], linear: bool, nodes: Sequence[int]) -> Rollout:
    return Rollout(scene, dt, numbers, linear=linear, nodes=nodes)
