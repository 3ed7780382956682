"""Tasks for a policy: arms whose tips follow moving targets, with actions in N, N m/m or other units of their actuators.

`softarm.gym` makes environments of Gymnasium of them. A task of one's own is a subclass of `Task`.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from .scene import Scene, batch, override
from .shortcuts import arm


class ArmState(NamedTuple):
    """State of one arm with K elements, as functions of a task see it."""

    x: np.ndarray
    """Positions, m, spatial, (K+1, 3)."""
    R: np.ndarray
    """Rotations, body to space, (K+1, 3, 3)."""
    v: np.ndarray
    """Velocities, m/s, spatial, (K+1, 3)."""
    w: np.ndarray
    """Angular velocities, rad/s, in the frame of the node, (K+1, 3)."""
    efforts: np.ndarray
    """Efforts of the actuators, each in its unit, (m,)."""
    time: float
    """Time since the start of the episode, s."""


class Target(NamedTuple):
    """Target of a tip."""

    x: np.ndarray
    """Position, m, (3,)."""
    v: np.ndarray
    """Velocity, m/s, (3,)."""


Reward = Callable[[ArmState, np.ndarray, Target], float]
"""A reward, as a function of the state after an action, of the action, and of the target then."""
Observation = Callable[[ArmState, np.ndarray, Target], np.ndarray]
"""An observation `(o,)`, as a function of the state, of the last action, which is zero at the start, and of the target."""
Act = Callable[[ArmState, np.ndarray, Target], np.ndarray]
"""An action `(a,)` that is computed from the whole state, from the last action, and from the target."""


class Task:
    """An arm, its actions, and a target for its tip.

    A subclass sets the class attributes, and in its `__init__` calls that of the base; it gives `path`, a reward (`reward` of one arm, or
    `rewards` of many), and `commands`, unless its actions are the efforts themselves.
    """

    period: ClassVar[float]
    """Time of an action, s."""
    steps: ClassVar[int]
    """Number of actions in an episode."""
    near: ClassVar[float]
    """Distance of tip and target below which `info["is_success"]` is true, m."""
    lost: ClassVar[float]
    """Reward of the action under which the model breaks down; it ends the episode."""
    random: Mapping[str, Any] = {}
    """Keys of the scene that differ from episode to episode: each has `(low, high)`, between which values are uniform, or a function of a
    `numpy.random.Generator`.
    """

    def __init__(
        self,
        keys: Mapping[str, Any],
        *,
        low: Sequence[float],
        high: Sequence[float],
        observed: Sequence[float] = (1.0,),
        changes: Mapping[str, Any] | None = None,
    ):
        """`keys` are those of the scene, to which `changes` (dotted keys) are made; `low` and `high` bound the actions, and the nodes nearest to
        the places `observed` (0 at the base to 1) are observed.
        """
        self.scene = Scene({"time": {"end_s": self.period * self.steps}, **keys}).replace(changes)
        self.low, self.high = np.asarray(low, dtype=np.float32), np.asarray(high, dtype=np.float32)
        plant = self.scene.plant()
        self.places = plant.places
        self.n_efforts = len(plant.actuators)
        self.rest = np.zeros(self.n_efforts)
        """Efforts at the start of an episode."""
        self.nodes = [int(np.argmin(np.abs(self.places - place))) for place in observed]
        self._start = plant.state

    @property
    def n_observations(self) -> int:
        """Number of numbers in an observation."""
        if _is_own(self.observation, Task.observation):
            return 6 * len(self.nodes) + self.n_efforts + 6
        state = ArmState(*self._start, efforts=self.rest.copy(), time=0.0)
        course = self.path(np.random.default_rng(0))
        target = Target(course[0], (course[1] - course[0]) / self.period)
        return len(as_observation(self.observation(state, np.zeros(len(self.low)), target)))

    def path(self, rng: np.random.Generator) -> np.ndarray:
        """Returns a random course of the target, m, `(steps + 1, 3)`."""
        raise NotImplementedError

    def commands(self, actions: np.ndarray, efforts: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Returns the efforts `(n, m)` of the actuators under actions `(n, a)` within their bounds, and wrenches on all nodes `(n, K+1, 6)` or
        none; `efforts` are those until now. Unless a subclass says otherwise, actions are the efforts.
        """
        if actions.shape[1] != self.n_efforts:
            raise NotImplementedError(
                f"{type(self).__name__} has {actions.shape[1]} actions and {self.n_efforts} actuators: its method `commands` is to say what they do"
            )
        return actions, None

    def rewards(self, distances: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Returns the rewards `(n,)` of distances of tip and target, m, and of their rates, m/s."""
        raise NotImplementedError

    def reward(self, state: ArmState, action: np.ndarray, target: Target) -> float:
        """Returns the reward of one arm: unless a subclass or `replaced` says otherwise, that of `rewards`."""
        distances, rates = _distances(state.x[None, -1], state.v[None, -1], target.x[None], target.v[None])
        return float(self.rewards(distances, rates)[0])

    def observation(self, state: ArmState, action: np.ndarray, target: Target) -> np.ndarray:
        """Returns what is observed of one arm: the positions of the observed nodes, m, their velocities, m/s, the efforts of its actuators, and place
        and velocity of its target.
        """
        return np.concatenate([state.x[self.nodes].ravel(), state.v[self.nodes].ravel(), state.efforts, target.x, target.v])

    def replaced(
        self,
        *,
        reward: Reward | None = None,
        observation: Observation | None = None,
        random: Mapping[str, Any] | None = None,
    ) -> Task:
        """Returns the task with another reward, another observation, or other random keys."""
        other: Any = copy.copy(self)
        if reward is not None:
            other.reward = reward
        if observation is not None:
            other.observation = observation
        if random is not None:
            other.random = dict(random)
        return other

    def draw(self, rng: np.random.Generator) -> dict[str, Any]:
        """Returns random values of the keys in `random`."""
        drawn = {}
        for key, own in self.random.items():
            if callable(own):
                drawn[key] = own(rng)
                continue
            try:
                low, high = (np.asarray(end, dtype=float) for end in own)
                fits = low.shape == high.shape and np.isfinite(low).all() and np.isfinite(high).all() and (low <= high).all()
            except (TypeError, ValueError):
                fits = False
            if not fits:
                raise ValueError(f"random[{key!r}] = {own}; expected (low, high) with low <= high, or a function of a generator of random numbers")
            drawn[key] = rng.uniform(low, high) if low.ndim else float(rng.uniform(low, high))
        return drawn


def _is_own(method: Any, function: Any) -> bool:
    """Tells whether a method is still this function of the base class."""
    return getattr(method, "__func__", None) is function


def unscaled(actions: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Returns actions between the bounds for those between -1 and 1."""
    return low + 0.5 * (np.clip(actions, -1.0, 1.0) + 1.0) * (high - low)


def scaled(actions: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Returns actions between -1 and 1 for those between the bounds."""
    return 2.0 * (np.clip(actions, low, high) - low) / (high - low) - 1.0


def as_observation(observation: Any) -> np.ndarray:
    """Returns an observation in single precision."""
    numbers = np.asarray(observation, dtype=np.float32)
    if numbers.ndim != 1:
        raise ValueError(f"an observation has the shape {numbers.shape}; expected (o,)")
    return numbers


class ElasticaCase1(Task):
    """Case 1 of Naughton et al. 2021 (Elastica, IEEE Robotics and Automation Letters 6): a muscular arm follows a target that flies at 0.5 m/s
    within a box, and changes its direction without notice.

    Actions are couples per length, N m/m, at six points along the arm: about the first axis of the sections, then about the second.
    """

    period, steps, near, lost = 7 * 2e-4, 7142, 0.05, -10000.0
    box = np.array([[-0.6, 0.6], [0.3, 0.9], [-0.6, 0.6]])
    """Where the target flies, m."""
    ball = 0.05
    """Radius of the target, m."""
    speed = 0.5
    """Of the target, m/s."""
    straight = 500
    """Number of actions after which the target takes another direction."""

    def __init__(self, *, elements: int = 20, changes: Mapping[str, Any] | None = None):
        keys = arm(1.0, 0.05, 1e7, elements=elements, direction=(0.0, 1.0, 0.0), gravity=False, damping=21.6)
        keys["time"] = {"end_s": self.period * self.steps, "integrator": "explicit"}
        observed = (0.2, 0.4, 0.6, 0.8, 1.0)
        super().__init__(keys, low=12 * [-1500.0], high=12 * [1500.0], observed=observed, changes=changes)
        self._couples = couples(self.places, 6) * _shares(self.places, self.scene["rod.length_m"])[:, None]

    def path(self, rng: np.random.Generator) -> np.ndarray:
        low, high = self.box[:, 0] + self.ball, self.box[:, 1] - self.ball
        size = high - low
        rows = [rng.uniform(low, high)[None]]
        for first in range(0, self.steps, self.straight):
            a, b = np.pi * rng.uniform(0.0, 2.0, 2)
            velocity = self.speed * np.array([np.cos(a) * np.sin(b), np.sin(a) * np.sin(b), np.cos(b)])
            n = min(self.straight, self.steps - first)
            free = rows[-1][-1] - low + velocity * (self.period * np.arange(1, n + 1))[:, None]
            # Walls reflect: a straight course, folded into the box.
            rows.append(low + size - np.abs(free % (2.0 * size) - size))
        return np.concatenate(rows)

    def commands(self, actions: np.ndarray, efforts: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        return efforts, _moments(actions, self._couples)

    def rewards(self, distances: np.ndarray, rates: np.ndarray) -> np.ndarray:
        return -(distances**2) + 0.5 * (distances < 0.1) + 1.5 * (distances < 0.05)


class SoftArmTracking(Task):
    """SoftArmTracking of gym-softrobot: an arm of 1 m and 2 MPa, with hardly any damping, follows a target by couples along it.

    Actions are couples per length, N m/m, at four points along the arm: about the first axis of the sections, then about the second. The target
    stays where `target` (m) says, or else moves, each coordinate as a product of three sines of random frequencies.
    """

    period, steps, near, lost = 0.01, 500, 0.05, -100.0

    def __init__(
        self,
        *,
        target: Sequence[float] | None = None,
        elements: int = 20,
        changes: Mapping[str, Any] | None = None,
    ):
        # Damping: decays as the first mode under 0.2 kg/(m s) on velocities and 0.2 N s on angular velocities there.
        keys = arm(1.0, 0.05, 2e6, poisson_ratio=0.45, elements=elements, direction=(0.0, 1.0, 0.0), gravity=False, damping=0.144)
        keys["time"] = {"end_s": self.period * self.steps, "integrator": "explicit"}
        observed = (0.25, 0.5, 0.75, 1.0)
        super().__init__(keys, low=8 * [-40.0], high=8 * [40.0], observed=observed, changes=changes)
        self.target = None if target is None else np.array(target, dtype=float)
        if self.target is not None and not (self.target.shape == (3,) and np.isfinite(self.target).all()):
            raise ValueError(f"target = {target}; expected three finite numbers in m, or None for a target that moves")
        self._couples = couples(self.places, 4) * _shares(self.places, self.scene["rod.length_m"])[:, None]

    def path(self, rng: np.random.Generator) -> np.ndarray:
        if self.target is not None:
            return np.tile(self.target, (self.steps + 1, 1))
        times = self.period * np.arange(self.steps + 1) + rng.uniform(0.0, 3600.0)
        sines = [
            np.prod([np.sin(2.0 * np.pi * rate * times) for rate in 0.0025 * rng.uniform(2.0, 5.0, 3)], axis=0) for _ in range(3)
        ]
        return np.array([0.8, 0.4, 0.8]) * np.stack(sines, axis=1) + [0.0, 0.4, 0.0]

    def commands(self, actions: np.ndarray, efforts: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        return efforts, _moments(actions, self._couples)

    def rewards(self, distances: np.ndarray, rates: np.ndarray) -> np.ndarray:
        return -(distances**2)


class TendonTracking(Task):
    """Tendon tracking of SoRoMoX: four tendons bend an arm of 0.25 m, whose tip follows a target that moves on a hemisphere at 15 mm/s.

    Actions are changes of the four tensions, N; these stay between 0 and 25 N.
    """

    period, steps, near, lost = 1.0 / 15.0, 105, 0.01, -100.0
    most = 25.0
    """Largest tension, N."""
    center, radius = np.array([0.0, 0.0, 0.15]), 0.1
    """Of the hemisphere, m."""
    speed = 0.015
    """Of the target, m/s."""

    def __init__(self, *, elements: int = 10, changes: Mapping[str, Any] | None = None):
        keys = arm(0.25, 0.025, 2.5e5, density=1070.0, poisson_ratio=0.37, elements=elements, direction=(0.0, 0.0, 1.0), gravity=False)
        # Internal damping: 1e-3 N m^2 s against bending there, over EI = 0.0767 N m^2.
        keys["damping"] = {"internal_s": 0.013}
        offsets = [[0.02, 0.0], [-0.02, 0.0], [0.0, 0.02], [0.0, -0.02]]
        keys["tendon"] = [{"offset_m": offset, "tension_n": [0.0, self.most]} for offset in offsets]
        # The tip is off by 0.1 mm through the time step, and by 0.2 mm through ten elements.
        keys["time"] = {"end_s": self.period * self.steps, "integrator": "implicit", "step_s": self.period / 10}
        super().__init__(keys, low=4 * [-0.5], high=4 * [0.5], changes=changes)

    def path(self, rng: np.random.Generator) -> np.ndarray:
        turns, theta_0 = rng.uniform(0.5, 3.0), rng.uniform(0.15, 0.5 * np.pi - 0.25)
        swing, swings = rng.uniform(0.0, 0.35), rng.uniform(0.5, 3.0)
        phi_0, phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        s = np.linspace(0.0, 1.0, 30 * self.steps)
        phi = 2.0 * np.pi * turns * s + phi_0
        theta = np.clip(theta_0 + swing * np.sin(2.0 * np.pi * swings * s + phase), 1e-3, 0.5 * np.pi - 1e-3)
        course = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
        way = np.concatenate([[0.0], np.cumsum(self.radius * np.linalg.norm(np.diff(course, axis=0), axis=1))])
        at = self.speed * self.period * np.arange(self.steps + 1)
        points = np.stack([np.interp(at, way, course[:, i]) for i in range(3)], axis=1)
        return self.center + self.radius * points / np.linalg.norm(points, axis=1, keepdims=True)

    def commands(self, actions: np.ndarray, efforts: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        return np.clip(efforts + actions, 0.0, self.most), None

    def rewards(self, distances: np.ndarray, rates: np.ndarray) -> np.ndarray:
        return -(distances / 0.2 + np.maximum(rates, 0.0) / 0.3) + 1.5 * (distances < self.near)


class ChamberTracking(Task):
    """Three pressure chambers bend and stretch a STIFF-FLOP module of 50 mm, whose tip follows a target on a circle about the axis.

    Actions are changes of the three pressures, Pa; these stay between 0 and 100 kPa.
    """

    period, steps, near, lost = 0.05, 120, 0.001, -100.0
    most = 1e5
    """Largest pressure, Pa."""
    height, radii, turns = -0.0539, (0.002, 0.006), (2.0, 6.0)
    """Height of the circle, m, and between which bounds its radius, m, and the time of a turn, s, are."""

    def __init__(self, *, elements: int = 5, changes: Mapping[str, Any] | None = None):
        whole = Scene.load("stiff-flop").replace({"rod.elements": elements}).to_dict()
        keys = {name: whole[name] for name in ("rod", "base", "gravity", "damping", "payload", "chamber", "initial")}
        keys["time"] = {"end_s": self.period * self.steps, "integrator": "implicit", "step_s": 0.01}
        for chamber in keys["chamber"]:
            chamber["rest_pressure_pa"] = 4e4
        keys["initial"] = {"shape": "equilibrium"}
        super().__init__(keys, low=3 * [-5e3], high=3 * [5e3], changes=changes)
        self.rest = np.full(3, 4e4)

    def path(self, rng: np.random.Generator) -> np.ndarray:
        radius, turn, phase = rng.uniform(*self.radii), rng.uniform(*self.turns), rng.uniform(0.0, 2.0 * np.pi)
        angle = phase + rng.choice([-1.0, 1.0]) * 2.0 * np.pi / turn * self.period * np.arange(self.steps + 1)
        return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full_like(angle, self.height)], axis=1)

    def commands(self, actions: np.ndarray, efforts: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        return np.clip(efforts + actions, 0.0, self.most), None

    def rewards(self, distances: np.ndarray, rates: np.ndarray) -> np.ndarray:
        return -distances / 0.01 + 1.5 * (distances < self.near)


TASKS: dict[str, type[Task]] = {
    own.__name__: own for own in (ElasticaCase1, SoftArmTracking, TendonTracking, ChamberTracking)
}
"""The tasks by their names."""


class Arms:
    """Many arms at the same task, with values of their own for the keys of `each`. Numbers of an arm do not depend on how many others there are."""

    def __init__(self, task: Task, n: int, *, each: Mapping[str, Sequence[Any]] | None = None, threads: int | None = None):
        if both := sorted(set(each or {}) & set(task.random)):
            raise ValueError(f"{both} are in `each`, and random too; expected one of the two")
        self.task, self.n = task, n
        self.batch = batch(task.scene, n, each=each, threads=threads)
        self.taken = np.zeros(n, dtype=int)
        """Number of actions that every arm has taken."""
        self.efforts = np.zeros((n, task.n_efforts))
        self.actions = np.zeros((n, len(task.low)))
        """Last actions, cut off at their bounds."""
        self.parameters: list[dict[str, Any]] = [{} for _ in range(n)]
        """Random values of keys of the scene, of every arm in its episode."""
        self.episodes = np.zeros(n, dtype=int)
        """Number of episodes that every arm has begun."""
        self._paths = np.zeros((n, task.steps + 1, 3))

    def reset(self, indices: Iterable[int], generators: Sequence[np.random.Generator]) -> None:
        """Puts arms back to their start, each with another target, and with other values of the random keys, from its random numbers."""
        indices = [int(index) for index in indices]
        if not self.task.random:
            self.batch.reset(indices)
        for index in indices:
            self.taken[index] = 0
            self.episodes[index] += 1
            self.efforts[index] = self.task.rest
            self.actions[index] = 0.0
            self._paths[index] = self.task.path(generators[index])
            if self.task.random:
                self.parameters[index] = self.task.draw(generators[index])
                self.batch.change(index, [override(key, value) for key, value in self.parameters[index].items()])

    def step(self, actions: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[str | None]]:
        """Applies actions `(n, a)`, cut off at their bounds. Returns rewards, who broke down, whose time is over, and reasons of breakdowns."""
        task = self.task
        actions = np.asarray(actions, dtype=float)
        if actions.shape != (self.n, len(task.low)):
            raise ValueError(f"actions have the shape {actions.shape}; expected {(self.n, len(task.low))}")
        if not np.isfinite(actions).all():
            index = tuple(map(int, np.argwhere(~np.isfinite(actions))[0]))
            raise ValueError(f"actions{list(index)} is {actions[index]}; expected a finite number")
        self.actions = np.clip(actions, task.low, task.high)
        self.efforts, wrenches = task.commands(self.actions, self.efforts)
        errors = self.batch.step(task.period, wrenches, self.efforts if task.n_efforts else None)
        self.taken += 1
        terminated = np.array([error is not None for error in errors], dtype=bool)
        rewards = np.where(terminated, task.lost, self._rewards())
        return rewards, terminated, (self.taken >= task.steps) & ~terminated, errors

    def _rewards(self) -> np.ndarray:
        if _is_own(self.task.reward, Task.reward):
            return self.task.rewards(*self.distances())
        return np.array([float(self.task.reward(*moment)) for moment in self.moments()])

    def moments(self) -> list[tuple[ArmState, np.ndarray, Target]]:
        """Returns state, last action and target of every arm, as rewards and observations take them."""
        places, velocities = self.targets()
        times = self.task.period * self.taken
        states = [ArmState(*self.batch.state(i), efforts=self.efforts[i].copy(), time=float(times[i])) for i in range(self.n)]
        return [(state, self.actions[i].copy(), Target(places[i], velocities[i])) for i, state in enumerate(states)]

    def moment(self, index: int) -> tuple[ArmState, np.ndarray, Target]:
        """Returns state, last action and target of one arm."""
        return self.moments()[index]

    def course(self, index: int) -> np.ndarray:
        """Returns the whole course of the target of one arm, m, `(steps + 1, 3)`."""
        return self._paths[index]

    def targets(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns places, m, and velocities, m/s, of the targets: those until their next places, `(n, 3)`."""
        rows = np.arange(self.n)
        at = np.minimum(self.taken, self.task.steps - 1)
        step = self._paths[rows, at + 1] - self._paths[rows, at]
        return self._paths[rows, np.minimum(self.taken, self.task.steps)], step / self.task.period

    def distances(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns distances of tips and targets, m, and their rates, m/s, `(n,)`."""
        return _distances(self.batch.positions[:, -1], self.batch.velocities[:, -1], *self.targets())

    def observations(self) -> np.ndarray:
        """Returns for every arm what its task observes, `(n, o)`, in single precision."""
        if not _is_own(self.task.observation, Task.observation):
            return np.stack([as_observation(self.task.observation(*moment)) for moment in self.moments()])
        nodes = self.task.nodes
        parts = [self.batch.positions[:, nodes], self.batch.velocities[:, nodes], self.efforts, *self.targets()]
        return np.concatenate([part.reshape(self.n, -1) for part in parts], axis=1).astype(np.float32)


def _distances(x: np.ndarray, v: np.ndarray, places: np.ndarray, velocities: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns distances of tips `(n, 3)` with velocities from targets, and their rates."""
    off = x - places
    distances = np.sqrt(_dot(off, off))
    return distances, _dot(off, v - velocities) / np.maximum(distances, 1e-12)


def couples(places: np.ndarray, points: int) -> np.ndarray:
    """Returns `(K+1, points)` values at places (0 to 1) of the splines that are 1 at one of `points` equidistant inner points and 0 at the
    others and at both ends: those of `[control.distributed]`, cubic and "not a knot".
    """
    at = np.linspace(0.0, 1.0, points + 2)

    def powers(s: np.ndarray) -> np.ndarray:
        columns = [s**k for k in range(min(4, points + 2))]
        return np.stack(columns + [np.maximum(s - knot, 0.0) ** 3 for knot in at[2:-2]], axis=1)

    return powers(np.asarray(places, dtype=float)) @ np.linalg.solve(powers(at), np.eye(points + 2)[:, 1:-1])


def _shares(places: np.ndarray, length: float) -> np.ndarray:
    """Returns the lengths of an arm that belong to its nodes, m."""
    ends = np.concatenate([places[:1], 0.5 * (places[1:] + places[:-1]), places[-1:]])
    return length * np.diff(ends)


def _moments(actions: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Returns wrenches `(n, K+1, 6)` of couples at points: those about the first axis of the sections, then those about the second."""
    nodes, points = weights.shape
    wrenches = np.zeros((len(actions), nodes, 6))
    for axis in (0, 1):
        for point in range(points):
            # One product at a time: sums of matrix products depend on the number of rows.
            wrenches[:, :, 3 + axis] += actions[:, axis * points + point, None] * weights[:, point]
    return wrenches


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]
