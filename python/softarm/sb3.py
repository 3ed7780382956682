"""Both ways between stable-baselines3 and softarm: environments to train on, policies that move plants, and experts to learn from."""

from __future__ import annotations

from typing import Any

import numpy as np

from .environments import Act, Task, scaled, unscaled
from .gym import ArmVectorEnv, AutoresetMode, Box, VectorEnv
from .policies import Episodes

try:
    from stable_baselines3.common.vec_env import VecEnv  # type: ignore[import-not-found,import-untyped,unused-ignore]
except ImportError:
    VecEnv = object  # type: ignore[assignment,misc,unused-ignore]

__all__ = ["ArmVecEnv", "Expert", "Policy", "fill"]


class ArmVecEnv(VecEnv):
    """A `VectorEnv` of Gymnasium whose arms are reset by the same step, such as `ArmVectorEnv(..., autoreset_mode="SameStep")`, for algorithms
    of stable-baselines3.

    With `scaled` (the default) a policy acts between -1 and 1, which become the bounds of the actions: the random actions with which an
    algorithm begins are of order one.
    """

    def __init__(self, envs: VectorEnv[Any, Any, Any], *, scaled: bool = True):
        if VecEnv is object:
            raise ImportError("softarm.sb3 needs stable-baselines3: pip install stable-baselines3")
        mode = envs.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise ValueError(f"autoreset_mode is {mode}; stable-baselines3 expects AutoresetMode.SAME_STEP")
        self.envs = envs
        space: Any = envs.single_action_space
        self._bounds = (space.low.astype(float), space.high.astype(float)) if scaled else None
        self.metadata = envs.metadata
        if self._bounds is not None:
            space = Box(-1.0, 1.0, space.shape, np.float32)
        self._actions = np.zeros((envs.num_envs, *space.shape))
        super().__init__(envs.num_envs, envs.single_observation_space, space)

    def reset(self) -> np.ndarray:
        seeds: Any = self._seeds if any(seed is not None for seed in self._seeds) else None
        options = next((own for own in self._options if own), None)
        observations, infos = self.envs.reset(seed=seeds, options=options)
        self.reset_infos = [_of_arm(infos, index) for index in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        actions = np.asarray(actions, dtype=float)
        if self._bounds is not None:
            actions = unscaled(actions, *self._bounds)
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        observations, rewards, terminated, truncated, infos = self.envs.step(self._actions)
        done = terminated | truncated
        final = infos.get("final_info", {})
        told: list[dict[str, Any]] = []
        for index in range(self.num_envs):
            if done[index]:
                told.append(
                    {
                        **_of_arm(final, index),
                        "terminal_observation": infos["final_obs"][index],
                        "TimeLimit.truncated": bool(truncated[index] and not terminated[index]),
                    }
                )
                self.reset_infos[index] = _of_arm(infos, index)
            else:
                told.append({**_of_arm(infos, index), "TimeLimit.truncated": False})
        return observations, rewards, done, told

    def get_images(self) -> list[np.ndarray | None]:
        frames: Any = self.envs.render()
        return [None] * self.num_envs if frames is None else list(frames)

    def close(self) -> None:
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self.envs, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise AttributeError(f"{attr_name} of single arms cannot be set; make another environment")

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        raise AttributeError(f"single arms have no method {method_name}; call those of `envs`")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        return [False for _ in self._get_indices(indices)]


class Policy:
    """A model of stable-baselines3 as a policy for `softarm.policies.replay` and `Pilot`, whose actions are in the units of a task.

    `model` is what learned, or what `PPO.load` and the others return, and `normalize` the `VecNormalize` around its environments, if there was one.
    Actions between -1 and 1, those of an `ArmVecEnv`, become the bounds of the task; actions with its bounds stay.
    """

    def __init__(self, model: Any, task: Task, *, normalize: Any = None, deterministic: bool = True):
        space, seen = model.action_space, model.observation_space
        if seen.shape != (task.n_observations,):
            raise ValueError(f"observations of the model have the shape {seen.shape}; those of the task have {(task.n_observations,)}")
        if space.shape != task.low.shape:
            raise ValueError(f"actions of the model have the shape {space.shape}; those of the task have {task.low.shape}")
        as_they_are = np.array_equal(space.low, task.low) and np.array_equal(space.high, task.high)
        if not (as_they_are or ((space.low == -1.0).all() and (space.high == 1.0).all())):
            raise ValueError(f"actions of the model are between {space.low} and {space.high}; expected -1 and 1, or {task.low} and {task.high}")
        self.model, self.normalize, self.deterministic = model, normalize, deterministic
        self._bounds = None if as_they_are else (task.low.astype(float), task.high.astype(float))

    def predict(self, observation: np.ndarray) -> tuple[np.ndarray, None]:
        """Returns the action for an observation, in the units of the task."""
        if self.normalize is not None:
            observation = self.normalize.normalize_obs(observation)
        action = np.asarray(self.model.predict(observation, deterministic=self.deterministic)[0], dtype=float)
        return action if self._bounds is None else unscaled(action, *self._bounds), None


class Expert:
    """A function of `(state, action, target)` of every arm of an `ArmVecEnv`, wrapped or not, with the `predict` of a model: for
    `evaluate_policy` of stable-baselines3, and for whatever else takes a model that acts.

    The arms are those of an `ArmVectorEnv`. A function with a memory, such as a controller, is one for every arm: a list of `n`.
    """

    def __init__(self, envs: Any, function: Act | list[Act]):
        while not isinstance(envs, ArmVecEnv):
            if not hasattr(envs, "venv"):
                raise TypeError(f"{type(envs).__name__} is no ArmVecEnv, and none is in it")
            envs = envs.venv
        if not isinstance(envs.envs, ArmVectorEnv):
            raise TypeError(f"the environments are a {type(envs.envs).__name__}; expected an ArmVectorEnv, whose arms have a state")
        self.envs: ArmVecEnv = envs
        self.arms = envs.envs.arms
        self.functions = list(function) if isinstance(function, list) else [function] * envs.num_envs
        if len(self.functions) != envs.num_envs:
            raise ValueError(f"{len(self.functions)} functions; expected one for each of the {envs.num_envs} arms")

    def predict(
        self, observation: Any = None, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, None]:
        """Returns an action for every arm, which follows from its state rather than from its observation."""
        actions = np.array([function(*moment) for function, moment in zip(self.functions, self.arms.moments())], dtype=float)
        if self.envs._bounds is not None:
            actions = scaled(actions, *self.envs._bounds)
        return actions, None


def fill(buffer: Any, episodes: Episodes, task: Task) -> int:
    """Puts what an expert did, of `softarm.policies.replay`, into the replay buffer of an algorithm that learns from one, such as
    `SAC(...).replay_buffer`, and returns the number of its actions there.

    A buffer for `n` environments takes `n` actions at a time; up to `n - 1` at the end are left out.
    """
    n = buffer.n_envs
    actions = scaled(episodes.actions, task.low.astype(float), task.high.astype(float))
    over = episodes.terminated | episodes.truncated
    whole = len(actions) // n * n
    for first in range(0, whole, n):
        rows = slice(first, first + n)
        infos = [{"TimeLimit.truncated": bool(own)} for own in episodes.truncated[rows]]
        buffer.add(episodes.observations[rows], episodes.next_observations[rows], actions[rows], episodes.rewards[rows], over[rows], infos)
    return whole


def _of_arm(infos: dict[str, Any], index: int) -> dict[str, Any]:
    """Returns what infos of a vector tell of one arm."""
    own = (key for key in infos if not key.startswith(("_", "final_")) and infos.get(f"_{key}", ())[index])
    return {key: _of_arm(infos[key], index) if isinstance(infos[key], dict) else infos[key][index] for key in own}
