"""Closed loops from Python: a controller for a plant of one's own, and a simulated arm for a controller of one's own."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, overload

import numpy as np
import numpy.typing as npt

from . import _softarm

if TYPE_CHECKING:
    from .rollout import Motion, Rollout
    from .scene import Scene


class State(NamedTuple):
    """State of an arm with K elements."""

    x: np.ndarray
    """Positions, m, spatial, (K+1, 3)."""
    R: np.ndarray
    """Rotations, body to space, (K+1, 3, 3)."""
    v: np.ndarray
    """Velocities, m/s, spatial, (K+1, 3)."""
    w: np.ndarray
    """Angular velocities, rad/s, in the frame of the node, (K+1, 3)."""


class Command:
    """A command of the controller, which acts from `start` to `end` (s), linear in between.

    `controls` maps the name of every control to its values `(from, to)`: whole ones, such as a tension with its pretension, and for a component of a
    wrench `tip force x`. What they do to an arm is in two other forms as well: `wrenches` maps the place of a node on the arm (0 at the base to 1) to `(from, to)`, each `(6,)`: force in N, spatial, and moment in N m,
    in the frame of the node. `efforts` maps the name of an actuator to `(from, to)` in its unit. `fallback` is None, or the cause and action
    of a command that the controller did not compute, and `refused` has what the measurement had wrong. `answer` has all fields of
    `docs/serving.md`.
    """

    __slots__ = ("answer", "refused", "_places", "_names")

    def __init__(self, answer: dict[str, Any], refused: list[dict[str, Any]], places: Sequence[float], names: Sequence[str]):
        self.answer = answer
        self.refused = refused
        self._places = places
        self._names = names

    @property
    def start(self) -> float:
        return self.answer["from_s"]

    @property
    def end(self) -> float:
        return self.answer["to_s"]

    @property
    def controls(self) -> dict[str, tuple[float, float]]:
        return dict(zip(self._names, zip(self.answer["controls_from"], self.answer["controls_to"])))

    @property
    def wrenches(self) -> dict[float, tuple[np.ndarray, np.ndarray]]:
        return {
            self._places[own["node"]]: (
                np.array(own["force_from_n"] + own["moment_from_n_m"]),
                np.array(own["force_to_n"] + own["moment_to_n_m"]),
            )
            for own in self.answer["wrenches"]
        }

    @property
    def efforts(self) -> dict[str, tuple[float, float]]:
        return {own["name"]: (own["from"], own["to"]) for own in self.answer.get("efforts", [])}

    def _part(self, time: float) -> float:
        return min(max((time - self.start) / (self.end - self.start), 0.0), 1.0)

    def controls_at(self, time: float) -> np.ndarray:
        """Returns the values of all controls at a time in s, (m,), in the order of `Controller.controls`; after its end a command holds its last ones."""
        part = self._part(time)
        begin, end = np.array(self.answer["controls_from"]), np.array(self.answer["controls_to"])
        return begin + (end - begin) * part

    def wrenches_at(self, time: float) -> dict[float, np.ndarray]:
        """Returns the wrench `(6,)` at every place at a time in s; after its end a command holds its last values."""
        part = self._part(time)
        return {place: begin + (end - begin) * part for place, (begin, end) in self.wrenches.items()}

    def efforts_at(self, time: float) -> dict[str, float]:
        """Returns the effort of every actuator at a time in s."""
        part = self._part(time)
        return {name: begin + (end - begin) * part for name, (begin, end) in self.efforts.items()}

    @property
    def force(self) -> np.ndarray:
        """Mean force on the last actuated node, N, (3,)."""
        own = self.answer["wrenches"][-1]
        return 0.5 * (np.array(own["force_from_n"]) + np.array(own["force_to_n"]))

    @property
    def moment(self) -> np.ndarray:
        """Mean moment on the last actuated node, N m, in its frame, (3,)."""
        own = self.answer["wrenches"][-1]
        return 0.5 * (np.array(own["moment_from_n_m"]) + np.array(own["moment_to_n_m"]))

    @property
    def fallback(self) -> dict[str, str] | None:
        return self.answer["fallback"]

    @property
    def seconds(self) -> float:
        """Time that this sample took, s, its preparation after the sample before included. More than the controller's `period` is an overrun."""
        return sum(took for phase, took in self.answer["phases_s"].items() if phase != "read")

    @property
    def innovation(self) -> dict[str, Any] | None:
        """With an estimator: how far the last measurement was from what it expected, and how many signals of it were refused."""
        return self.answer["innovation"]

    @property
    def advice(self) -> list[str]:
        """Sentences on what is wrong over the last hundred samples: an estimate in doubt, and limits that no command keeps; empty if nothing is."""
        return self.answer.get("advice", [])

    def __repr__(self) -> str:
        acts = ", ".join(f"{name} {to:.4g}" for name, (_, to) in self.efforts.items())
        if self.answer["wrenches"]:
            acts = f"force {self.force}" + (f", {acts}" if acts else "")
        return f"<softarm.Command {self.start:.6g} s to {self.end:.6g} s: {acts}>"


def real(name: str, values: Any) -> Any:
    """Returns an array as it is, unless it is complex: its imaginary part would be lost."""
    if values is not None and np.iscomplexobj(values):
        raise ValueError(f"{name} is complex; expected real numbers")
    return values


def _finite(reading: Mapping[str, Any], place: str, faults: list[dict[str, Any]]) -> dict[str, Any] | None:
    """Returns a reading without the arrays that have numbers that are not finite; None where a single number is not,
    without which (such as its place) the rest means nothing.
    """
    out = {}
    for name, value in reading.items():
        real(f"{place}.{name}", value)
        if isinstance(value, (float, np.floating)) and not np.isfinite(value):
            faults.append({"type": "error", "where": f"{place}.{name}", "message": f"{value} is not finite", "help": "leave the reading out"})
            return None
        if name != "time_s" and isinstance(value, (list, tuple, np.ndarray)) and not np.isfinite(np.asarray(value, dtype=float)).all():
            message = f"{np.asarray(value).tolist()} is not finite"
            faults.append({"type": "error", "where": f"{place}.{name}", "message": message, "help": "leave out what was not measured"})
        else:
            out[name] = _plain(value)
    return out


def _plain(value: Any) -> Any:
    """Returns a value without types of numpy."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, Mapping):
        return {name: _plain(own) for name, own in value.items()}
    return [_plain(own) for own in value] if isinstance(value, (list, tuple)) else value


class Controller:
    """The controller of a scene, for a plant of one's own: `command = controller.step(state)` once every `period`."""

    def __init__(self, make: Callable[[], _softarm.Controller]):
        self._make = make
        self.reset()

    def reset(self) -> None:
        """Begins anew, at time 0 and without an estimate."""
        self._native = self._make()
        self.greeting: dict[str, Any] = json.loads(self._native.greeting)
        self._places = [node["place"] for node in self.greeting["nodes"]]
        self._names = [own["name"] for own in self.greeting["controls"]]
        self._sent: list[Command] = []

    @property
    def period(self) -> float:
        """Time between two samples, s."""
        return self.greeting["period_s"]

    @property
    def places(self) -> np.ndarray:
        """Places of the model's nodes along the arm, from 0 at the base to 1, (K+1,)."""
        return np.array(self._places)

    @property
    def controls(self) -> list[dict[str, Any]]:
        """The controls, in the order of `Command.controls_at`: `name`, `unit`, the value `rest` before the first command, `lag_s`, and bounds, as `hello` of
        `docs/serving.md` has them."""
        return list(self.greeting["controls"])

    @property
    def actuators(self) -> list[str]:
        """Names of the actuators whose efforts are commanded."""
        return [own["name"] for own in self.greeting.get("efforts", [])]

    @property
    def next_time(self) -> float:
        """Time of the next sample, s."""
        return self._native.next_time

    def step(
        self,
        state: State | None = None,
        *,
        time: float | None = None,
        positions: npt.ArrayLike | None = None,
        rotations: npt.ArrayLike | None = None,
        velocities: npt.ArrayLike | None = None,
        angular_velocities: npt.ArrayLike | None = None,
        readings: Sequence[Mapping[str, Any]] | None = None,
        reference: npt.ArrayLike | None = None,
        reference_wxyz: npt.ArrayLike | None = None,
        obstacles: Sequence[Mapping[str, Any]] | None = None,
        disturbance: Mapping[str, Any] | None = None,
    ) -> Command:
        """Answers a measurement at `time` (s; the next sample's if it is left out), and prepares the next sample.

        A measurement is a `state` on the nodes of the model (positions, rotations and, else unknown, velocities and angular velocities), poses of
        them, or `readings` of sensors. `reference` has rows (t, x, y, z) of another path for the tip, and `reference_wxyz` rows (t, w, x, y, z) of
        other orientations; fields of readings, obstacles and disturbance are those of `docs/serving.md`. A `disturbance` is what the caller has
        estimated of it, for a scene without an estimator; it holds until another one is given. A faulty measurement raises nothing, and numbers
        that are not finite are one: what cannot be used is left out or, if nothing is left, answered by a fallback, and `command.refused` says
        what was wrong. An array of another shape is a `ValueError`.
        """
        if state is not None:
            positions, rotations, velocities, angular_velocities = [*state, None, None][:4]
        given = {"positions": positions, "rotations": rotations, "velocities": velocities, "angular_velocities": angular_velocities}
        for name, values in given.items():
            real(name, values)
        faults: list[dict[str, Any]] = []
        more = None
        references = [("reference", "reference_m", reference, "(t, x, y, z)"), ("reference_wxyz", "reference_wxyz", reference_wxyz, "(t, w, x, y, z)")]
        if any(given is not None for given in (readings, reference, reference_wxyz, obstacles, disturbance)):
            fields: dict[str, Any] = {}
            if readings is not None:
                kept = [_finite(own, f"readings[{i}]", faults) for i, own in enumerate(readings)]
                fields["readings"] = [own for own in kept if own is not None]
            for name, field, values, columns in references:
                if values is None:
                    continue
                n = len(columns.split(","))
                rows = np.asarray(real(name, values), dtype=float)
                if rows.ndim != 2 or rows.shape[1] != n or not np.isfinite(rows).all():
                    raise ValueError(f"{name} has the shape {rows.shape}; expected rows {columns} of finite numbers, (n, {n})")
                fields[field] = rows.tolist()
            if obstacles is not None:
                fields["obstacles"] = _plain(obstacles)
            if disturbance is not None:
                fields["disturbance"] = _finite(disturbance, "disturbance", faults)
            more = fields
        refused, answer = self._native.step(time, positions, rotations, velocities, angular_velocities, more)
        command = Command(answer, faults + refused, self._places, self._names)
        # A command begins after its sample, and at the latest when the next is sent.
        self._sent = [*self._sent[-1:], command]
        return command

    def acting(self, time: float) -> Command | None:
        """Returns the command that acts at a time in s, from the sample before last on; None where none has begun yet.

        A command may begin later than it is computed, by the time that the loop is said to need; until then the one before acts.
        """
        begun = [command for command in self._sent if command.start <= time + 1e-9]
        return begun[-1] if begun else None

    def wrenches_at(self, time: float) -> dict[float, np.ndarray]:
        """Returns the wrench `(6,)` at every place that acts at a time in s; empty where no command has begun yet."""
        command = self.acting(time)
        return {} if command is None else command.wrenches_at(time)


class Plant:
    """A simulated arm that a program moves, step by step."""

    def __init__(self, native: _softarm.Plant, scene: Scene | None = None):
        self._native, self._scene = native, scene
        self._sent: list[Command] = []
        self._rollouts: dict[Any, Rollout] = {}

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return self._native.time

    @property
    def longest_step(self) -> float:
        """Longest time step of the integrator, s; `step` divides its time into steps of at most this length."""
        return self._native.longest_step

    @property
    def places(self) -> np.ndarray:
        """Places of the nodes along the arm, from 0 at the base to 1, (K+1,)."""
        return self._native.places

    @property
    def masses(self) -> np.ndarray:
        """Masses of the nodes, kg, (K+1,)."""
        return self._native.masses

    @property
    def actuators(self) -> list[str]:
        """Names of the actuators, in the order of efforts."""
        return self._native.actuators

    @property
    def units(self) -> dict[str, str]:
        """Unit in which `step` takes the effort of every actuator, by name: "N", "Pa", "T", "T/m", "1" for an activation, "m" for a winch."""
        return dict(zip(self._native.actuators, self._native.units))

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """Least and largest effort that `step` takes, by name, in the unit of `units`; infinite where there is no bound."""
        return {name: (least, most) for name, (least, most) in zip(self._native.actuators, self._native.bounds.tolist())}

    @property
    def efforts(self) -> dict[str, float]:
        """The efforts that act now, by name: tensions in N, also of tendons on winches, pressures in Pa, activations, fields in T and T/m."""
        return dict(zip(self._native.actuators, self._native.efforts.tolist()))

    @property
    def displacements(self) -> dict[str, float]:
        """Displacements of the winches now, m, by name, negative where they have pulled in."""
        inputs = zip(self._native.actuators, self._native.inputs.tolist(), self._native.units)
        return {name: value for name, value, unit in inputs if unit == "m"}

    @property
    def state(self) -> State:
        """The state of all nodes."""
        return State(*self._native.state)

    def state_on(self, controller: Controller) -> State:
        """Returns the state on the nodes of a controller's model, which may have other elements."""
        return State(*self._native.state_on(controller._native))

    @property
    def tip(self) -> np.ndarray:
        """Position of the tip, m, (3,)."""
        return self._native.tip

    @property
    def energy(self) -> dict[str, float]:
        """Kinetic, elastic and potential energy, J."""
        return dict(zip(("kinetic", "elastic", "potential"), self._native.energy))

    @overload
    def step(
        self,
        dt: float,
        wrenches: npt.ArrayLike | None = None,
        efforts: npt.ArrayLike | None = None,
        *,
        wrenches_to: npt.ArrayLike | None = None,
        efforts_to: npt.ArrayLike | None = None,
        derivative: Literal[False] = False,
    ) -> State: ...

    @overload
    def step(
        self,
        dt: float,
        wrenches: npt.ArrayLike | None = None,
        efforts: npt.ArrayLike | None = None,
        *,
        wrenches_to: npt.ArrayLike | None = None,
        efforts_to: npt.ArrayLike | None = None,
        derivative: Literal[True] | Sequence[str],
    ) -> Motion: ...

    def step(
        self,
        dt: float,
        wrenches: npt.ArrayLike | None = None,
        efforts: npt.ArrayLike | None = None,
        *,
        wrenches_to: npt.ArrayLike | None = None,
        efforts_to: npt.ArrayLike | None = None,
        derivative: bool | Sequence[str] = False,
    ) -> State | Motion:
        """Moves the arm by `dt` seconds and returns its state.

        `wrenches` (K+1, 6) act on the nodes: force in N, spatial, and moment in N m, in the frame of the node; `efforts` (m,) are those of the
        actuators, each in its unit (`units`): N, Pa, T, T/m, an activation, and for a winch its displacement in m, negative where it pulls
        in; without them those of the scene act. They are constant, or go linearly to `wrenches_to` and
        `efforts_to`.

        An effort beyond the `bounds` of its actuator by more than rounding (a millionth) raises `ValueError`; without bounds that is the push of
        a tendon or a cable. The effort of an actuator that follows another one is the one by that relation, or NaN, which stands for it.
        """
        given = {"wrenches": wrenches, "efforts": efforts, "wrenches_to": wrenches_to, "efforts_to": efforts_to}
        for name, values in given.items():
            real(name, values)
        if derivative is False:
            self._native.step(dt, wrenches, efforts, wrenches_to, efforts_to)
            return self.state
        motion = self._motion(dt, [wrenches, wrenches_to], [efforts, efforts_to], () if derivative is True else tuple(derivative))
        self._native.step(dt, wrenches, efforts, wrenches_to, efforts_to)
        if np.abs(motion.x[-1] - self.state.x).max() > 1e-9 * np.abs(motion.x).max():
            raise ValueError("the arm has loads that change with time, or a memory, which the derivative of a step does not know")
        return motion

    def _motion(self, dt: float, wrenches: list[Any], efforts: list[Any], numbers: tuple[str, ...]) -> Motion:
        """Returns the motion of a step as that of a rollout."""
        from .rollout import Rollout

        if self._scene is None:
            raise ValueError("a plant without its scene has no derivative: make it by Scene.plant()")
        linear = wrenches[1] is not None or efforts[1] is not None
        key = (dt, linear, numbers)
        if key not in self._rollouts:
            self._rollouts = {key: Rollout(self._scene, dt, numbers, linear=linear, nodes=range(len(self.places)))}

        def rows(pair: list[Any]) -> np.ndarray | None:
            if pair[0] is None:
                return None
            own = [np.asarray(pair[0], float), np.asarray(pair[0] if pair[1] is None else pair[1], float)]
            if not all(np.isfinite(part).all() for part in own):
                raise ValueError("the derivative of a step needs every effort as a number")
            return np.stack(own if linear else own[:1])

        return self._rollouts[key](rows(efforts), wrenches=rows(wrenches), start=self.state, intervals=1)

    def apply(self, command: Command) -> State:
        """Sends a command of a controller, and moves the arm to the time of the controller's next sample.

        A command may begin later than it is sent, by the time that the loop is said to need; until then the one before acts. Before the first
        one nothing acts but the scene's own loads and efforts.
        """
        self._sent = [*self._sent[-1:], *([] if command in self._sent else [command])]
        until = command.answer["time_s"] + (command.end - command.start)
        begins = command.start
        if self.time < begins < until:
            self._move(begins, self._sent[-2] if len(self._sent) > 1 else None)
        self._move(until, command if begins < until else self._sent[-2] if len(self._sent) > 1 else None)
        return self.state

    def _move(self, until: float, command: Command | None) -> None:
        """Moves the arm under a command, whose last values hold after its end."""
        dt = until - self.time
        if dt <= 1e-9 * max(until, 1e-3):
            return
        ends: list[Any] = [None, None]
        efforts: list[Any] = [None, None]
        if command is not None:
            if command.wrenches:
                ends = [np.zeros((len(self.places), 6)) for _ in ends]
                for all_nodes, time in zip(ends, (self.time, until)):
                    for place, wrench in command.wrenches_at(time).items():
                        all_nodes[int(np.argmin(np.abs(self.places - place)))] += wrench
            if self.actuators and command.efforts:
                named = [command.efforts_at(time) for time in (self.time, until)]
                # What is given by the scene, and not commanded, stays as it is until the next sample.
                given = dict(zip(self.actuators, self._native.inputs.tolist()))
                efforts = [np.array([own.get(name, given[name]) for name in self.actuators]) for own in named]
        self._native.step(dt, ends[0], efforts[0], ends[1], efforts[1])

    def reset(self) -> State:
        """Puts the arm back to the start of its scene."""
        self._native.reset()
        self._sent = []
        return self.state

    def set_state(self, state: State | Sequence[npt.ArrayLike], time: float | None = None) -> None:
        """Puts the arm into a state (positions, rotations and, else zero, velocities and angular velocities), at a time in s."""
        positions, rotations, *rates = state
        velocities, angular_velocities = [*rates, None, None][:2]
        given = {"positions": positions, "rotations": rotations, "velocities": velocities, "angular_velocities": angular_velocities}
        for name, values in given.items():
            real(name, values)
        self._native.set_state(positions, rotations, velocities, angular_velocities, time)

    def copy(self) -> Plant:
        """Returns another arm in the same state."""
        other = Plant(self._native.copy(), self._scene)
        other._sent = list(self._sent)
        return other

    __copy__ = copy

    def __deepcopy__(self, _memo: dict[int, Any]) -> Plant:
        return self.copy()

    def __repr__(self) -> str:
        return repr(self._native)
