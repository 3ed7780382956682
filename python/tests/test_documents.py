"""Every Python program in docs/python.md, docs/fitting.md and docs/learning.md runs as it stands, where its packages are."""

import re
from pathlib import Path

import pytest

DOCUMENTS = [Path(__file__).parents[2] / "docs" / name for name in ("python.md", "fitting.md", "learning.md")]
PROGRAMS = [
    (document.name, program)
    for document in DOCUMENTS
    for program in re.findall(r"```python\n(.*?)```", document.read_text(encoding="utf-8"), re.DOTALL)
]


def test_there_are_programs():
    assert len(PROGRAMS) >= 12


@pytest.mark.parametrize("number", range(len(PROGRAMS)))
def test_programs_of_the_document_run(number, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name, program = PROGRAMS[number]
    if name == "learning.md":
        pytest.importorskip("gymnasium")
    if "render_mode" in program:
        pytest.importorskip("matplotlib")
    if "stable_baselines3" in program:
        pytest.importorskip("stable_baselines3")
    exec(compile(program, f"{name}, program {number + 1}", "exec"), {})
