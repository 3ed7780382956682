"""An environment of stable-baselines3 made of a vector environment of Gymnasium."""

from __future__ import annotations

from typing import Any

import numpy as np

from .gym import AutoresetMode, Box, VectorEnv

try:
    from stable_baselines3.common.vec_env import VecEnv  # type: ignore[import-not-found,import-untyped,unused-ignore]
except ImportError:
    VecEnv = object  # type: ignore[assignment,misc,unused-ignore]

__all__ = ["ArmVecEnv"]


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
            low, high = self._bounds
            actions = low + 0.5 * (np.clip(actions, -1.0, 1.0) + 1.0) * (high - low)
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


def _of_arm(infos: dict[str, Any], index: int) -> dict[str, Any]:
    """Returns what infos of a vector tell of one arm."""
    own = (key for key in infos if not key.startswith(("_", "final_")) and infos.get(f"_{key}", ())[index])
    return {key: infos[key][index] for key in own}
