"""Environments of Gymnasium: `import softarm.gym` registers `softarm/ElasticaCase1-v0`, `softarm/SoftArmTracking-v0`,
`softarm/TendonTracking-v0` and `softarm/ChamberTracking-v0`, single ones and vectors of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import gymnasium  # type: ignore[import-not-found,import-untyped,unused-ignore]
import numpy as np
from gymnasium.spaces import Box  # type: ignore[import-not-found,import-untyped,unused-ignore]
from gymnasium.utils import seeding  # type: ignore[import-not-found,import-untyped,unused-ignore]
from gymnasium.vector import AutoresetMode, VectorEnv  # type: ignore[import-not-found,import-untyped,unused-ignore]
from gymnasium.vector.utils import batch_space  # type: ignore[import-not-found,import-untyped,unused-ignore]

from .environments import TASKS, Arms, Task

__all__ = ["ArmEnv", "ArmVectorEnv"]


def _task(task: str | Task, options: dict[str, Any]) -> Task:
    if isinstance(task, str):
        if task not in TASKS:
            raise ValueError(f"task = {task!r}; expected one of {sorted(TASKS)}, or a softarm.environments.Task")
        return TASKS[task](**options)
    if options:
        raise TypeError(f"{sorted(options)} are options of a task with a name; give them to {type(task).__name__}")
    return task


def _no_options(options: dict[str, Any] | None, known: Sequence[str] = ()) -> None:
    unknown = set(options or {}) - set(known)
    if unknown:
        raise ValueError(f"options of a reset are {list(known) or 'none'}, and no {sorted(unknown)}")


def _spaces(task: Task) -> tuple[Box, Box]:
    """Returns the spaces of observations and of actions."""
    return Box(-np.inf, np.inf, (task.n_observations,), np.float32), Box(task.low, task.high, dtype=np.float32)


class ArmEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One arm at a task, by its name with its options, or of one's own.

    An action beyond the bounds is cut off there. If the model breaks down, the episode ends with `terminated`, the last state that the arm had,
    and the reason in `info["error"]`; at the end of its time it is `truncated`. `info["distance_m"]` is the distance of tip and target.
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(self, task: str | Task, *, render_mode: None = None, **options: Any):
        self.task = _task(task, options)
        self.render_mode = render_mode
        self.observation_space, self.action_space = _spaces(self.task)
        self.arms = Arms(self.task, 1, threads=1)
        self._begun = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        _no_options(options)
        self.arms.reset([0], [self.np_random])
        self._begun = True
        return self.arms.observations()[0], self._info(None)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        if not self._begun:
            raise gymnasium.error.ResetNeeded("the episode has not begun; reset it")
        rewards, terminated, truncated, errors = self.arms.step(np.asarray(action)[None])
        return self.arms.observations()[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), self._info(errors[0])

    def _info(self, error: str | None) -> dict[str, Any]:
        distance = float(self.arms.distances()[0][0])
        info: dict[str, Any] = {"distance_m": distance, "is_success": distance < self.task.near}
        return info if error is None else {**info, "error": error}


class ArmVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Many arms at a task, which move at the same time on several threads; each does what an `ArmEnv` with its seed does, to the byte.

    `autoreset_mode` is that of Gymnasium: an arm whose episode has ended is reset by the next step, whose action it does not take (`NEXT_STEP`),
    by the same step, with its last observation in `infos["final_obs"]` (`SAME_STEP`), or by `reset` with
    `options={"reset_mask": mask}` (`DISABLED`). `each` has values of the scene that differ from arm to arm, such as
    `{"rod.material.youngs_modulus_pa": [2e5, 3e5]}` for two arms.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # type: ignore[misc,unused-ignore]

    def __init__(
        self,
        task: str | Task,
        num_envs: int = 1,
        *,
        each: Mapping[str, Sequence[Any]] | None = None,
        threads: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: None = None,
        **options: Any,
    ):
        self.task = _task(task, options)
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**type(self).metadata, "autoreset_mode": self.autoreset_mode}  # type: ignore[misc,unused-ignore]
        self.single_observation_space, self.single_action_space = _spaces(self.task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.arms = Arms(self.task, num_envs, each=each, threads=threads)
        self._generators: list[np.random.Generator] = []
        self._seeds: list[int] = []
        self._over = np.zeros(num_envs, dtype=bool)
        self._begun = np.zeros(num_envs, dtype=bool)

    @property  # type: ignore[misc,override,unused-ignore]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override,unused-ignore]
        """Random numbers of the arms."""
        self._seed([None] * self.num_envs)
        return tuple(self._generators)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override,unused-ignore]
        """Seeds of the arms."""
        self._seed([None] * self.num_envs)
        return tuple(self._seeds)

    def _seed(self, seeds: Sequence[int | None]) -> None:
        """Gives the arms with a seed their random numbers, and at first all."""
        if not self._generators:
            pairs = [seeding.np_random(seed) for seed in seeds]
            self._generators, self._seeds = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
            return
        for index, seed in enumerate(seeds):
            if seed is not None:
                self._generators[index], self._seeds[index] = seeding.np_random(seed)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Resets all arms, or those of `options={"reset_mask": mask}`. An integer seeds the arms with it and the numbers that follow."""
        _no_options(options, ["reset_mask"])
        n = self.num_envs
        mask = np.asarray((options or {}).get("reset_mask", np.ones(n, dtype=bool)))
        if mask.dtype != np.bool_ or mask.shape != (n,) or not mask.any():
            raise ValueError(f"reset_mask has {mask.dtype} of shape {mask.shape}; expected bool of shape ({n},) with at least one True")
        seeds = [seed + i for i in range(n)] if isinstance(seed, (int, np.integer)) else [None] * n if seed is None else list(seed)
        if len(seeds) != n:
            raise ValueError(f"seed has {len(seeds)} entries; expected one for each of the {n} arms")
        self._seed([own if chosen else None for own, chosen in zip(seeds, mask)])
        self._restart(mask)
        return self.arms.observations(), self._infos(mask, [None] * n)

    def _restart(self, mask: np.ndarray) -> None:
        self._seed([None] * self.num_envs)
        self.arms.reset(np.flatnonzero(mask), self._generators)
        self._over, self._begun = self._over & ~mask, self._begun | mask

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        before = self._over
        needed = ~self._begun if self.autoreset_mode == AutoresetMode.NEXT_STEP else before | ~self._begun
        if needed.any():
            index = int(np.flatnonzero(needed)[0])
            raise gymnasium.error.ResetNeeded(f"the episode of arm {index} is over, or has not begun; reset it")
        rewards, terminated, truncated, errors = self.arms.step(actions)
        if before.any():
            # What these arms did before their reset does not count.
            self._restart(before)
            rewards, terminated, truncated = np.where(before, 0.0, rewards), terminated & ~before, truncated & ~before
            errors = [None if over else error for over, error in zip(before, errors)]
        over = terminated | truncated
        self._over = over
        if self.autoreset_mode != AutoresetMode.SAME_STEP or not over.any():
            every = np.ones(self.num_envs, dtype=bool)
            return self.arms.observations(), rewards, terminated, truncated, self._infos(every, errors)
        last = np.full(self.num_envs, None, dtype=object)
        for index, observation in enumerate(self.arms.observations()):
            if over[index]:
                last[index] = observation
        final = self._infos(over, errors)
        self._restart(over)
        infos = self._infos(np.ones(self.num_envs, dtype=bool), [None] * self.num_envs)
        infos |= {"final_obs": last, "_final_obs": over, "final_info": final, "_final_info": over.copy()}
        return self.arms.observations(), rewards, terminated, truncated, infos

    def _infos(self, mask: np.ndarray, errors: Sequence[str | None]) -> dict[str, Any]:
        """Returns what is told of the arms of a mask."""
        distances = np.where(mask, self.arms.distances()[0], 0.0)
        near = mask & (distances < self.task.near)
        infos: dict[str, Any] = {"distance_m": distances, "_distance_m": mask.copy(), "is_success": near, "_is_success": mask.copy()}
        failed = np.array([error is not None for error in errors]) & mask
        if failed.any():
            reasons = [error if own else None for own, error in zip(failed, errors)]
            infos |= {"error": np.array(reasons, dtype=object), "_error": failed}
        return infos

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Returns an attribute for every arm, those of the vector; methods of single arms there are none."""
        value = getattr(self, name)
        if callable(value):
            raise AttributeError(f"{name} is a method of all arms; call it on the vector")
        return (value,) * self.num_envs

    def get_attr(self, name: str) -> tuple[Any, ...]:
        return self.call(name)


for _name in TASKS:
    if f"softarm/{_name}-v0" not in gymnasium.registry:
        gymnasium.register(
            f"softarm/{_name}-v0",
            entry_point="softarm.gym:ArmEnv",
            vector_entry_point="softarm.gym:ArmVectorEnv",
            kwargs={"task": _name},
        )
