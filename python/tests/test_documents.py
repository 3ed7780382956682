"""Every Python program in docs/python.md and docs/fitting.md runs as it stands."""

import re
from pathlib import Path

import pytest

DOCUMENTS = [Path(__file__).parents[2] / "docs" / name for name in ("python.md", "fitting.md")]
PROGRAMS = [
    (document.name, program)
    for document in DOCUMENTS
    for program in re.findall(r"```python\n(.*?)```", document.read_text(encoding="utf-8"), re.DOTALL)
]


def test_there_are_programs():
    assert len(PROGRAMS) >= 7


@pytest.mark.parametrize("number", range(len(PROGRAMS)))
def test_programs_of_the_document_run(number, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name, program = PROGRAMS[number]
    exec(compile(program, f"{name}, program {number + 1}", "exec"), {})
