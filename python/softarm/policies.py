"""Policies that move plants: what was learned in an environment, or an expert, on the simulated arm of any scene.

    from softarm.policies import replay
    episodes = replay(policy, task, plant=other_scene, seeds=range(10))
"""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from .control import Plant
from .environments import Act, ArmState, Target, Task, as_observation
from .errors import ModelError
from .scene import Scene


class Pilot:
    """A policy as the controller of a plant, whose tip follows a target: `pilot.drive(plant)` once every `task.period`.

    `policy` is a function of an observation, an object whose `predict(observation)` returns an action first, such as a model of
    stable-baselines3 whose actions are in the units of the task, which then acts without its noise, or `FromState`. The target goes along the course that the task
    has for a `seed`, as in an environment, or along `path`, `(steps + 1, 3)` in m. The plant may be that of another scene, with other elements,
    if it has the actuators of the task.
    """

    def __init__(self, policy: Any, task: Task, *, seed: int | None = None, path: Any = None):
        course = task.path(np.random.default_rng(seed)) if path is None else np.asarray(path, dtype=float)
        if course.ndim != 2 or course.shape[1] != 3 or len(course) < 2 or not np.isfinite(course).all():
            raise ValueError(f"path has the shape {course.shape}; expected finite rows (x, y, z) in m, at least two")
        space = getattr(policy, "action_space", None)
        if space is not None and not (np.array_equal(space.low, task.low) and np.array_equal(space.high, task.high)):
            raise ValueError(
                f"actions of the policy are between {space.low} and {space.high}, and those of the task between {task.low} and {task.high}; "
                "softarm.sb3.Policy(model, task) takes the ones to the others"
            )
        takes = inspect.signature(policy.predict).parameters if hasattr(policy, "predict") else {}
        self._words = {"deterministic": True} if "deterministic" in takes else {}
        self.policy, self.task, self.path = policy, task, course
        self.reset()

    def reset(self) -> None:
        """Begins at the start of the path."""
        self.taken = 0
        """Number of actions that were taken."""
        self.efforts = self.task.rest.copy()
        self.action = np.zeros(len(self.task.low))
        """Last action, cut off at its bounds."""

    @property
    def is_over(self) -> bool:
        """Tells whether the target is at the end of its path."""
        return self.taken >= len(self.path) - 1

    @property
    def target(self) -> Target:
        """The target now."""
        at = min(self.taken, len(self.path) - 2)
        return Target(self.path[min(self.taken, len(self.path) - 1)], (self.path[at + 1] - self.path[at]) / self.task.period)

    def moment(self, state: Sequence[np.ndarray], places: np.ndarray | None = None) -> tuple[ArmState, np.ndarray, Target]:
        """Returns what functions of the task take for a state of nodes at `places`: the state on the nodes of the task, action and target."""
        x, R, v, w = (np.asarray(own, dtype=float) for own in state)
        if places is not None and not np.array_equal(places, self.task.places):
            at = [int(np.argmin(np.abs(places - place))) for place in self.task.places]
            x, v, w = (np.stack([np.interp(self.task.places, places, own[:, i]) for i in range(3)], axis=1) for own in (x, v, w))
            R = R[at]
        return ArmState(x, R, v, w, self.efforts.copy(), self.taken * self.task.period), self.action.copy(), self.target

    def act(self, state: Sequence[np.ndarray], places: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray | None]:
        """Answers a state by the efforts `(m,)` of the actuators and wrenches `(K+1, 6)` on the nodes of the task, or none, for the next `period`."""
        task, moment = self.task, self.moment(state, places)
        if isinstance(self.policy, FromState):
            action = self.policy.function(*moment)
        else:
            observation = as_observation(task.observation(*moment))
            action = self.policy.predict(observation, **self._words)[0] if hasattr(self.policy, "predict") else self.policy(observation)
        action = np.asarray(action, dtype=float)
        if action.shape != task.low.shape or not np.isfinite(action).all():
            raise ValueError(f"the policy returned {action}; expected {len(task.low)} finite numbers")
        self.action = np.clip(action, task.low, task.high)
        efforts, wrenches = task.commands(self.action[None], self.efforts[None])
        self.efforts = np.asarray(efforts[0], dtype=float)
        self.taken += 1
        return self.efforts, None if wrenches is None else wrenches[0]

    def drive(self, plant: Plant) -> ArmState:
        """Answers the state of a plant, and moves it by a `period` under that. Returns its state on the nodes of the task."""
        if len(plant.actuators) != self.task.n_efforts:
            raise ValueError(f"the plant has the actuators {plant.actuators}; the task has {self.task.n_efforts}")
        places = plant.places
        efforts, wrenches = self.act(plant.state, places)
        if wrenches is not None:
            wrenches = _moved(wrenches, self.task.places, places)
        plant.step(self.task.period, wrenches, efforts if self.task.n_efforts else None)
        return self.moment(plant.state, places)[0]


def _moved(wrenches: np.ndarray, here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Returns wrenches on nodes at other places, each divided between the two beside it."""
    if np.array_equal(here, there):
        return wrenches
    out = np.zeros((len(there), 6))
    after = np.clip(np.searchsorted(there, here), 1, len(there) - 1)
    part = np.clip((here - there[after - 1]) / (there[after] - there[after - 1]), 0.0, 1.0)[:, None]
    np.add.at(out, after - 1, (1.0 - part) * wrenches)
    np.add.at(out, after, part * wrenches)
    return out


class FromState:
    """A policy that sees the whole state: `function(state, action, target)` returns the next action, such as an expert that others learn from."""

    def __init__(self, function: Act):
        self.function = function


class Episodes(NamedTuple):
    """What a policy saw and did: `n` rows, one for every action, of one episode after the other."""

    observations: np.ndarray
    """Observations before the actions, (n, o)."""
    actions: np.ndarray
    """Actions within their bounds, (n, a)."""
    rewards: np.ndarray
    """Rewards, (n,)."""
    next_observations: np.ndarray
    """Observations after the actions, (n, o)."""
    terminated: np.ndarray
    """Whether the model broke down, (n,)."""
    truncated: np.ndarray
    """Whether the time of the episode was over, (n,)."""
    distances: np.ndarray
    """Distances of tip and target after the actions, m, (n,)."""
    times: np.ndarray
    """Times after the actions since the start of the episode, s, (n,)."""
    tips: np.ndarray
    """Positions of the tip after the actions, m, (n, 3)."""


def replay(
    policy: Any,
    task: Task,
    *,
    plant: Plant | Scene | None = None,
    seeds: Iterable[int] = (0,),
) -> Episodes:
    """Runs a policy, as `Pilot` takes it, for an episode with every seed on a plant: that of the task's scene, of another scene, or any plant,
    which is reset before every episode. On the plant of the task an episode has the numbers of an environment with its seed, its random keys
    included; those do not change a plant that is given.
    """
    moving = task.scene.plant() if plant is None else plant.plant() if isinstance(plant, Scene) else plant
    rows: list[tuple[Any, ...]] = []
    places = moving.places
    for seed in seeds:
        dice = np.random.default_rng(seed)
        pilot = Pilot(policy, task, path=task.path(dice))
        if plant is None and task.random:
            moving = task.scene.replace(task.draw(dice)).plant()
        moving.reset()
        seen = as_observation(task.observation(*pilot.moment(moving.state, places)))
        lost = False
        while not (pilot.is_over or lost):
            try:
                pilot.drive(moving)
            except ModelError:
                lost = True
            moment = pilot.moment(moving.state, places)
            state, action, target = moment
            after = as_observation(task.observation(*moment))
            reward = task.lost if lost else task.reward(*moment)
            off = float(np.linalg.norm(state.x[-1] - target.x))
            rows.append((seen, action, reward, after, lost, pilot.is_over and not lost, off, state.time, state.x[-1].copy()))
            seen = after
    if not rows:
        raise ValueError("seeds is empty; expected one for every episode")
    return Episodes(*(np.array(column) for column in zip(*rows)))
