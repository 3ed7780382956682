"""Exceptions. The outcome of a method, such as a solve that does not converge, is a status and no exception."""

from __future__ import annotations

from typing import Any

class SoftarmError(Exception):
    """Base of all exceptions of this package."""


class SceneError(SoftarmError, ValueError):
    """A scene that cannot be used. `key` is the dotted key, `line` the line in the text of the scene, `help` a remedy, and `nearest` the point
    nearest to a target that can be held, with `position_m` and `distance_m`; each may be None."""

    nearest: dict[str, Any] | None = None

    def __init__(self, message: str, key: str | None = None, line: int | None = None, help: str | None = None):
        super().__init__(message)
        self.key = key
        self.line = line
        self.help = help

    def __reduce__(self):
        return type(self), (str(self), self.key, self.line, self.help), {"nearest": self.nearest}


class ModelError(SoftarmError):
    """The rod, the solver or the check broke down, for instance at an element that collapses."""


class ResultError(SoftarmError):
    """A file or directory that cannot be read, or is not written."""


class Stopped(SoftarmError):
    """A deadline ended the work before there was a result."""


class InternalError(SoftarmError):
    """A fault of softarm itself; please report it."""
