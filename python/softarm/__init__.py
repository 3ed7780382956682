"""Optimal and model-predictive control of soft arms.

A scene is a dictionary with the keys of a scene file (`softarm schema --markdown` explains all of them):

    >>> import softarm as sa
    >>> scene = sa.Scene.load("reach").replace(**{"rod.elements": 10})
    >>> result = scene.solve()              # doctest: +SKIP
    >>> result.status, result.certificate   # doctest: +SKIP

All numbers are in SI units. Positions `x` are spatial and in C order, `(n, K+1, 3)` for `n` times and `K` elements; rotations `R` are
`(n, K+1, 3, 3)` and take the frame of a node, whose third axis points along the arm, to space.
"""

from ._softarm import Batch, __version__, builtin_scenes
from .control import Command, Controller, Plant, State
from .errors import InternalError, ModelError, ResultError, SceneError, SoftarmError, Stopped
from .profiles import follow_with_play, profile
from .program import Component, Derivatives, Program, Quadratic
from .progress import progress
from .results import Certificate, Result, load, verify
from .rollout import Gradient, Motion, Rollout
from .scene import Scene, Shapes, batch, run, schema
from .shortcuts import arm, figure_eight, reach

__all__ = [
    "Batch",
    "Certificate",
    "Command",
    "Component",
    "Controller",
    "Derivatives",
    "Gradient",
    "InternalError",
    "ModelError",
    "Motion",
    "Plant",
    "Program",
    "Quadratic",
    "Result",
    "ResultError",
    "Rollout",
    "Scene",
    "SceneError",
    "Shapes",
    "SoftarmError",
    "State",
    "Stopped",
    "__version__",
    "arm",
    "batch",
    "builtin_scenes",
    "figure_eight",
    "follow_with_play",
    "load",
    "profile",
    "progress",
    "reach",
    "run",
    "schema",
    "verify",
]
