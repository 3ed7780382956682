"""Environments of Gymnasium: `import softarm.gym` registers `softarm/ElasticaCase1-v0`, `softarm/SoftArmTracking-v0`,
`softarm/TendonTracking-v0` and `softarm/ChamberTracking-v0`, single ones and vectors of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium  # type: ignore[import-not-found,import-untyped,unused-ignore]
import numpy as np
from gymnasium.spaces import Box  # type: ignore[import-not-found,import-untyped,unused-ignore]
from gymnasium.utils import seeding  # type: ignore[import-not-found,import-untyped,unused-ignore]
from gymnasium.vector import AutoresetMode, VectorEnv  # type: ignore[import-not-found,import-untyped,unused-ignore]
from gymnasium.vector.utils import batch_space  # type: ignore[import-not-found,import-untyped,unused-ignore]

from .environments import TASKS, Arms, Observation, Reward, Task, unscaled
from .scene import LOG

if TYPE_CHECKING:
    from .pictures import Picture

__all__ = ["ArmEnv", "ArmVectorEnv"]


def _task(
    task: str | Task,
    options: dict[str, Any],
    reward: Reward | None,
    observation: Observation | None,
    random: Mapping[str, Any] | None,
) -> Task:
    if isinstance(task, str):
        if task not in TASKS:
            raise ValueError(f"task = {task!r}; expected one of {sorted(TASKS)}, or a softarm.environments.Task")
        task, options = TASKS[task](**options), {}
    if options:
        raise TypeError(f"{sorted(options)} are options of a task with a name; give them to {type(task).__name__}")
    task = task.replaced(reward=reward, observation=observation, random=random)
    if task.random:
        # A key that the scene does not have is an error now, and not in the first episode.
        task.scene.replace(task.draw(np.random.default_rng(0)))
    return task


def _no_options(options: dict[str, Any] | None, known: Sequence[str] = ()) -> None:
    unknown = set(options or {}) - set(known)
    if unknown:
        raise ValueError(f"options of a reset are {list(known) or 'none'}, and no {sorted(unknown)}")


def _spaces(task: Task, scaled: bool) -> tuple[Box, Box]:
    """Returns the spaces of observations and of actions."""
    most = float(np.finfo(np.float32).max)
    low, high = (-np.ones_like(task.low), np.ones_like(task.high)) if scaled else (task.low, task.high)
    return Box(-most, most, (task.n_observations,), np.float32), Box(low, high, dtype=np.float32)


def _in_units(actions: Any, bounds: tuple[np.ndarray, np.ndarray] | None) -> Any:
    """Returns actions in the units of the task, whose bounds they have for -1 and 1 if bounds are given."""
    if bounds is None or np.shape(actions)[-1:] != bounds[0].shape:
        return actions
    return unscaled(np.asarray(actions, dtype=float), *bounds)


def _render_mode(mode: str | None, known: Sequence[str]) -> str | None:
    if mode is not None and mode not in known:
        raise ValueError(f"render_mode = {mode!r}; expected None or one of {list(known)}")
    return mode


def _frames_a_second(task: Task) -> int:
    """Returns the frames a second with one for every action, as fast as the arm moves."""
    return max(1, round(1.0 / task.period))


class _Screen:
    """Pictures of arms. They are made when they are first asked for, and a copy of an environment makes its own."""

    def __init__(self) -> None:
        self._pictures: dict[int, tuple[int, Picture]] = {}
        self._window: Any = None

    def __reduce__(self) -> tuple[type[_Screen], tuple[()]]:
        return _Screen, ()

    def frame(self, arms: Arms, index: int) -> np.ndarray:
        """Returns a picture of an arm, its target and obstacles as bytes `(h, w, 3)`."""
        from .pictures import Picture

        task, episode = arms.task, int(arms.episodes[index])
        state, _, target = arms.moment(index)
        course = arms.course(index)
        if self._pictures.get(index, (None,))[0] != episode:
            scene = task.scene.replace(arms.parameters[index]) if arms.parameters[index] else task.scene
            # Where the target goes, and room for the tip to swing.
            swing = 0.3 * scene["rod.length_m"]
            points = np.concatenate([state.x, course, state.x[-1:] - swing, state.x[-1:] + swing])
            self._pictures[index] = episode, Picture(scene, points.min(axis=0), points.max(axis=0))
        picture = self._pictures[index][1]
        off = float(arms.distances()[0][index])
        title = f"t = {state.time:.2f} s, {1e3 * off:.1f} mm off"
        path = course[: int(arms.taken[index]) + 1]
        picture.draw(state.x, state.R, target=target.x, near=task.near, time=state.time, path=path, title=title)
        return picture.pixels()

    def show(self, frame: np.ndarray, seconds: float) -> None:
        """Shows a frame in a window of matplotlib, for this time at least; without a screen no window opens, and the logger says so."""
        import matplotlib.pyplot as plt  # type: ignore[import-not-found,import-untyped,unused-ignore]

        if self._window is None:
            figure = plt.figure("softarm", figsize=(frame.shape[1] / 100, frame.shape[0] / 100))
            axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
            axes.set_axis_off()
            self._window = figure, axes.imshow(frame)
            self._has_screen = getattr(figure.canvas, "required_interactive_framework", None) is not None
            if not self._has_screen:
                LOG.warning("no window: matplotlib draws by %s, which has none", plt.get_backend())
        figure, image = self._window
        image.set_data(frame)
        if self._has_screen:
            plt.pause(seconds)

    def close(self) -> None:
        """Closes the window, and forgets the pictures."""
        self._pictures.clear()
        if self._window is not None:
            import matplotlib.pyplot as plt  # type: ignore[import-not-found,import-untyped,unused-ignore]

            plt.close(self._window[0])
            self._window = None


class ArmEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One arm at a task, by its name with its options, or of one's own.

    An action beyond the bounds is cut off there. If the model breaks down, the episode ends with `terminated`, the last state that the arm had,
    and the reason in `info["error"]`; at the end of its time it is `truncated`. `info["distance_m"]` is the distance of tip and target.

    `reward` and `observation` replace those of the task by functions of `(state, action, target)`, and `random` has keys of the scene that differ from
    episode to episode, as `Task.random`; `info["parameters"]` has their values. Actions are in the units of the task, or with `scaled` between -1
    and 1, which become its bounds. `render_mode` is "rgb_array", with which `render` returns a picture,
    or "human", which shows every action in a window; both need matplotlib. An environment can be pickled and deep-copied at any time, and its copy
    goes on to the bit as it would.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 25}

    def __init__(
        self,
        task: str | Task,
        *,
        render_mode: str | None = None,
        reward: Reward | None = None,
        observation: Observation | None = None,
        random: Mapping[str, Any] | None = None,
        scaled: bool = False,
        **options: Any,
    ):
        self.task = _task(task, options, reward, observation, random)
        self.render_mode = _render_mode(render_mode, self.metadata["render_modes"])
        self.metadata = {**type(self).metadata, "render_fps": _frames_a_second(self.task)}
        self._screen = _Screen()
        self.observation_space, self.action_space = _spaces(self.task, scaled)
        self._bounds = (self.task.low.astype(float), self.task.high.astype(float)) if scaled else None
        self.arms = Arms(self.task, 1, threads=1)
        self._begun = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        _no_options(options)
        self.arms.reset([0], [self.np_random])
        self._begun = True
        self._show()
        return self.arms.observations()[0], self._info(None)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        if not self._begun:
            raise gymnasium.error.ResetNeeded("the episode has not begun; reset it")
        rewards, terminated, truncated, errors = self.arms.step(_in_units(np.asarray(action)[None], self._bounds))
        self._show()
        return self.arms.observations()[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), self._info(errors[0])

    def render(self) -> Any:
        """Returns a picture of the arm, its target and obstacles, bytes `(h, w, 3)`, in the mode "rgb_array"; in the mode "human" every action is
        shown without it.
        """
        if not self._begun:
            raise gymnasium.error.ResetNeeded("the episode has not begun; reset it")
        if self.render_mode is None:
            gymnasium.logger.warn('render() does nothing without a render_mode: make the environment with render_mode="rgb_array" or "human"')
        return self._screen.frame(self.arms, 0) if self.render_mode == "rgb_array" else None

    def _show(self) -> None:
        if self.render_mode == "human":
            self._screen.show(self._screen.frame(self.arms, 0), 1.0 / self.metadata["render_fps"])

    def close(self) -> None:
        self._screen.close()

    def _info(self, error: str | None) -> dict[str, Any]:
        distance = float(self.arms.distances()[0][0])
        info: dict[str, Any] = {"distance_m": distance, "is_success": distance < self.task.near}
        if self.task.random:
            info["parameters"] = dict(self.arms.parameters[0])
        return info if error is None else {**info, "error": error}


class ArmVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Many arms at a task, which move at the same time on several threads; each does what an `ArmEnv` with its seed does, to the byte.

    `autoreset_mode` is that of Gymnasium: an arm whose episode has ended is reset by the next step, whose action it does not take (`NEXT_STEP`),
    by the same step, with its last observation in `infos["final_obs"]` (`SAME_STEP`), or by `reset` with
    `options={"reset_mask": mask}` (`DISABLED`). `each` has values of the scene that differ from arm to arm, such as
    `{"rod.material.youngs_modulus_pa": [2e5, 3e5]}` for two arms. `reward`, `observation`, `random`, `scaled` and copies are as in `ArmEnv`, and with
    `render_mode="rgb_array"` `render` returns a picture for every arm.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 25, "autoreset_mode": AutoresetMode.NEXT_STEP}  # type: ignore[misc,unused-ignore]

    def __init__(
        self,
        task: str | Task,
        num_envs: int = 1,
        *,
        each: Mapping[str, Sequence[Any]] | None = None,
        threads: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        reward: Reward | None = None,
        observation: Observation | None = None,
        random: Mapping[str, Any] | None = None,
        scaled: bool = False,
        **options: Any,
    ):
        self.task = _task(task, options, reward, observation, random)
        self.num_envs = num_envs
        self.render_mode = _render_mode(render_mode, type(self).metadata["render_modes"])
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        own = {"autoreset_mode": self.autoreset_mode, "render_fps": _frames_a_second(self.task)}
        self.metadata = {**type(self).metadata, **own}  # type: ignore[misc,unused-ignore]
        self._screen = _Screen()
        self.single_observation_space, self.single_action_space = _spaces(self.task, scaled)
        self._bounds = (self.task.low.astype(float), self.task.high.astype(float)) if scaled else None
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
        rewards, terminated, truncated, errors = self.arms.step(_in_units(actions, self._bounds))
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
        if self.task.random:
            for index in np.flatnonzero(mask):
                infos = self._add_info(infos, {"parameters": self.arms.parameters[index]}, int(index))
        failed = np.array([error is not None for error in errors]) & mask
        if failed.any():
            reasons = [error if own else None for own, error in zip(failed, errors)]
            infos |= {"error": np.array(reasons, dtype=object), "_error": failed}
        return infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Returns a picture of every arm, bytes `(h, w, 3)`, in the mode "rgb_array"."""
        if self.render_mode is None:
            gymnasium.logger.warn('render() does nothing without a render_mode: make the environments with render_mode="rgb_array"')
            return None
        if not self._begun.all():
            raise gymnasium.error.ResetNeeded("not all episodes have begun; reset them")
        return tuple(self._screen.frame(self.arms, index) for index in range(self.num_envs))

    def close_extras(self, **_: Any) -> None:
        self._screen.close()

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
