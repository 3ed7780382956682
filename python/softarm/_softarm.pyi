from collections.abc import Callable
from typing import Any, final

import numpy as np
import numpy.typing as npt

from .control import State

__all__ = [
    "Batch",
    "Controller",
    "Motions",
    "Plant",
    "Program",
    "Rollout",
    "__version__",
    "builtin_scenes",
    "call",
    "inputs",
    "main",
    "parse",
    "schema",
    "shapes",
]

__version__: str

def call(
    words: list[str],
    scene: tuple[str, str] | None = None,
    hears: Callable[[str, str], Any] | None = None,
) -> int: ...
def main(words: list[str]) -> int: ...
def parse(name: str, text: str | None = None, overrides: list[str] = ...) -> tuple[str, dict[str, Any]]: ...
def builtin_scenes() -> list[str]:
    """Returns the names of the built-in scenes."""

def schema() -> str: ...
def inputs(name: str, text: str | None = None, overrides: list[str] = ...) -> list[tuple[str, str, bool]]: ...
def shapes(
    name: str,
    text: str | None,
    overrides: list[str],
    inputs: npt.ArrayLike | None,
    columns: list[tuple[str, list[float]]] = ...,
    along: list[str] = ...,
    jacobian: bool = False,
    stability: bool = False,
    threads: int | None = None,
) -> tuple[
    npt.NDArray[np.float64],
    npt.NDArray[np.float64],
    npt.NDArray[np.float64] | None,
    npt.NDArray[np.bool_] | None,
    tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]] | None,
]: ...

@final
class Plant:
    def __new__(cls, name: str, text: str | None = None, overrides: list[str] = ...) -> Plant: ...
    @property
    def time(self) -> float: ...
    @property
    def longest_step(self) -> float: ...
    @property
    def actuators(self) -> list[str]: ...
    @property
    def places(self) -> npt.NDArray[np.float64]: ...
    @property
    def masses(self) -> npt.NDArray[np.float64]: ...
    @property
    def state(
        self,
    ) -> tuple[
        npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]
    ]: ...
    def state_on(
        self, controller: Controller
    ) -> tuple[
        npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]
    ]: ...
    @property
    def units(self) -> list[str]: ...
    @property
    def bounds(self) -> npt.NDArray[np.float64]: ...
    @property
    def efforts(self) -> npt.NDArray[np.float64]: ...
    @property
    def inputs(self) -> npt.NDArray[np.float64]: ...
    @property
    def tip(self) -> npt.NDArray[np.float64]: ...
    @property
    def energy(self) -> list[float]: ...
    def step(
        self,
        dt: float,
        wrenches: npt.ArrayLike | None = None,
        efforts: npt.ArrayLike | None = None,
        wrenches_to: npt.ArrayLike | None = None,
        efforts_to: npt.ArrayLike | None = None,
    ) -> None: ...
    def reset(self) -> None: ...
    def set_state(
        self,
        positions: npt.ArrayLike,
        rotations: npt.ArrayLike,
        velocities: npt.ArrayLike | None = None,
        angular_velocities: npt.ArrayLike | None = None,
        time: float | None = None,
    ) -> None: ...
    def copy(self) -> Plant: ...
    def __copy__(self) -> Plant: ...
    def __deepcopy__(self, _memo: Any) -> Plant: ...
    def __getnewargs__(self) -> tuple[str, str | None, list[str]]: ...
    def __getstate__(self) -> npt.NDArray[np.float64]: ...
    def __setstate__(self, numbers: Any) -> None: ...

@final
class Batch:
    """Many arms of one scene, which move at the same time on several threads, as far as that is faster."""

    def __new__(
        cls,
        n: int,
        name: str,
        text: str | None = None,
        overrides: list[str] = ...,
        threads: int | None = None,
        each: list[list[str]] | None = None,
    ) -> Batch: ...
    def __len__(self) -> int: ...
    @property
    def times(self) -> npt.NDArray[np.float64]:
        """Time of every arm since its start, s, (n,)."""
    @property
    def positions(self) -> npt.NDArray[np.float64]:
        """Positions of the nodes, m, spatial, (n, K+1, 3)."""
    @property
    def velocities(self) -> npt.NDArray[np.float64]:
        """Velocities of the nodes, m/s, spatial, (n, K+1, 3)."""
    @property
    def actuators(self) -> list[str]:
        """Names of the actuators, in the order of efforts."""
    def state(self, index: int) -> State:
        """Returns the state of one arm."""
    def step(
        self, dt: float, wrenches: npt.ArrayLike | None = None, efforts: npt.ArrayLike | None = None
    ) -> list[str | None]:
        """Moves every arm by `dt` seconds, under wrenches (n, 6) on the tips and efforts (n, m) of the actuators, as `Plant.step` does.

        Returns for every arm None, or why it broke down, now or before; such an arm stays where it was until its reset. Ctrl-C ends the call;
        arms that were not done yet stay where they were.
        """
    def set_state(
        self,
        index: int,
        positions: npt.ArrayLike,
        rotations: npt.ArrayLike,
        velocities: npt.ArrayLike | None = None,
        angular_velocities: npt.ArrayLike | None = None,
        time: float | None = None,
    ) -> None:
        """Puts one arm into a state, as `Plant.set_state`; an arm that broke down moves again."""
    def reset(self, indices: list[int] | None = None) -> None:
        """Puts the arms with these indices, or all, back to the start of the scene."""
    def change(self, index: int, overrides: list[str]) -> None:
        """Makes one arm anew at the start of the scene, with other values of some keys: overrides `KEY=VALUE`, after those of `each`. Those of
        the change before no longer hold, and a reset keeps them. Nodes and actuators stay as many as they are.
        """
    def copy(self) -> Batch:
        """Returns other arms in the same states."""
    def __copy__(self) -> Batch: ...
    def __deepcopy__(self, _memo: Any) -> Batch: ...
    def __getnewargs__(
        self,
    ) -> tuple[int, str, str | None, list[str], int | None, list[list[str]] | None]: ...
    def __getstate__(self) -> list[tuple[npt.NDArray[np.float64], str | None, list[str]]]: ...
    def __setstate__(self, saved: Any) -> None: ...

@final
class Controller:
    def __new__(cls, name: str, text: str | None = None, overrides: list[str] = ...) -> Controller: ...
    @property
    def greeting(self) -> str: ...
    @property
    def next_time(self) -> float: ...
    def step(
        self,
        time: float | None = None,
        positions: npt.ArrayLike | None = None,
        rotations: npt.ArrayLike | None = None,
        velocities: npt.ArrayLike | None = None,
        angular_velocities: npt.ArrayLike | None = None,
        more: dict[str, Any] | None = None,
    ) -> tuple[list[dict[str, Any]], dict[str, Any]]: ...

@final
class Rollout:
    """Motions of a scene's arm: `Rollout(name, text, overrides, dt, keys, linear, nodes)`."""

    def __new__(
        cls, name: str, text: str | None, overrides: list[str], dt: float, keys: list[str], linear: bool, nodes: list[int]
    ) -> Rollout: ...
    @property
    def actuators(self) -> list[str]: ...
    @property
    def values(self) -> npt.NDArray[np.float64]: ...
    @property
    def n_nodes(self) -> int: ...
    @property
    def steps(self) -> tuple[float, int]: ...
    def beyond(self, efforts: npt.ArrayLike) -> str | None: ...
    def run(
        self,
        batch: int,
        rows: int,
        efforts: npt.ArrayLike | None = None,
        wrenches: npt.ArrayLike | None = None,
        values: npt.ArrayLike | None = None,
        start: list[Any] | None = None,
        threads: int | None = None,
    ) -> Motions: ...

@final
class Motions:
    """Motions of a batch of arms."""

    def states(self) -> list[npt.NDArray[np.float64]]: ...
    def pull_back(
        self,
        x: npt.ArrayLike | None = None,
        r: npt.ArrayLike | None = None,
        v: npt.ArrayLike | None = None,
        w: npt.ArrayLike | None = None,
        numbers: bool = True,
        threads: int | None = None,
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64], list[npt.NDArray[np.float64]]]: ...

@final
class Program:
    """The discrete problem of a scene: `Program(name, text=None, overrides=[])`."""

    def __new__(cls, name: str, text: str | None = None, overrides: list[str] = ...) -> Program: ...
    @property
    def n_variables(self) -> int: ...
    def solution(self, directory: str) -> npt.NDArray[np.float64]: ...
    @property
    def n_controls(self) -> int: ...
    @property
    def times(self) -> npt.NDArray[np.float64]: ...
    @property
    def blocks(self) -> npt.NDArray[np.float64]: ...
    @property
    def components(self) -> list[tuple[str, int | None, float, float]]: ...
    @property
    def sets(self) -> list[dict[str, Any]]: ...
    def guess(self) -> npt.NDArray[np.float64]: ...
    def rollout(self, variables: npt.ArrayLike) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]: ...
    def evaluate(
        self, variables: npt.ArrayLike
    ) -> tuple[float, npt.NDArray[np.float64], npt.NDArray[np.float64]]: ...
    def linearize(
        self,
        variables: npt.ArrayLike,
        constraint_multipliers: npt.ArrayLike | None = None,
        inequality_multipliers: npt.ArrayLike | None = None,
        rows: list[int] | None = None,
    ) -> dict[str, Any]: ...
    def sensitivity(
        self, variables: npt.ArrayLike, change: npt.ArrayLike
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]: ...
    def transitions(
        self, variables: npt.ArrayLike
    ) -> list[tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]]: ...
