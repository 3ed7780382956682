"""Progress of a verb while it works: `scene.solve(on_event=softarm.progress())`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

__all__ = ["progress"]


def _words(event: dict[str, Any]) -> str:
    kind = event["event"]
    if kind == "progress":
        return f"t = {event['t_s']:.4g} s, step {event['step']} of {event['steps']}"
    if kind == "iteration":
        return f"iteration {event['iteration']}: objective {event['objective']:.6g}"
    if kind == "sample":
        off = "" if event["error_m"] is None else f", {1e3 * event['error_m']:.3g} mm off"
        return f"t = {event['t_s']:.4g} s{off}, a sample in {1e3 * event['sample_s']:.3g} ms"
    return kind


def progress(every: float = 1.0) -> Callable[[dict[str, Any]], None]:
    """Returns a listener for `on_event`: a bar of tqdm, if it is installed, or else a line on standard error every `every` seconds."""
    try:
        from tqdm.auto import tqdm  # type: ignore[import-not-found,import-untyped,unused-ignore]
    except ImportError:
        tqdm = None
    bar: Any = None
    last = -float("inf")

    def listen(event: dict[str, Any]) -> None:
        nonlocal bar, last
        if tqdm is not None:
            if bar is None:
                bar = tqdm(total=event.get("steps"))
            bar.update(event["step"] - bar.n if "step" in event else 1)
            bar.set_postfix_str(_words(event))
            if event.get("step") is not None and event["step"] == event.get("steps"):
                bar.close()
        elif time.monotonic() - last >= every:
            last = time.monotonic()
            print(_words(event), file=sys.stderr, flush=True)

    return listen
