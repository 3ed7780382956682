"""Pages with programs as notebooks: a Markdown file is read as a notebook, run, and written again with what its programs print and draw.

    python docs/site/notebooks.py docs/tutorials/first-reach.md first-reach.ipynb    # the notebook, to work with
    python docs/site/notebooks.py --run docs/tutorials/*.md docs/gallery/*.md        # runs each, and says how long it took

A fenced block of Python is a cell of code, and what stands between two of them a cell of text. Needs nbformat, and for runs nbclient, ipykernel
and the package softarm with matplotlib.
"""

from __future__ import annotations

import fnmatch
import html
import os
import re
import sys
import time
from pathlib import Path

import nbformat
from nbformat import v4

ROOT = Path(__file__).resolve().parents[2]
FENCE = re.compile(r"^```python\n(.*?)^```\n?", re.DOTALL | re.MULTILINE)
LONGEST_S = 600  # time of a cell
# Pictures as SVG: they are sharp at any size, and do not depend on the screen.
PREPARATION = "%config InlineBackend.figure_formats = ['svg']\n%config InlineBackend.print_figure_kwargs = {'bbox_inches': 'tight'}"


def is_chosen(page: str) -> bool:
    """Tells whether the programs of a page, such as "gallery/stiff-flop.md", are run: SOFTARM_PAGES has patterns of pages, and without it all are."""
    return any(fnmatch.fnmatch(page, pattern.strip()) for pattern in os.environ.get("SOFTARM_PAGES", "*").split(","))


def notebook(text: str) -> nbformat.NotebookNode:
    """Returns a page as a notebook without outputs."""
    cells = []
    for index, part in enumerate(FENCE.split(text)):
        # Every second part is what the expression has in its group.
        if index % 2:
            cells.append(v4.new_code_cell(part.rstrip("\n")))
        elif part.strip():
            cells.append(v4.new_markdown_cell(part.strip("\n")))
    for number, cell in enumerate(cells):
        cell["id"] = f"cell-{number}"
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return v4.new_notebook(cells=cells, metadata={"kernelspec": kernel, "language_info": {"name": "python"}})


def run(page: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Runs a notebook at the root of the repository, and returns it with outputs.

    Raises `nbclient.exceptions.CellExecutionError` with the cell and its traceback.
    """
    from nbclient import NotebookClient

    own = v4.new_notebook(cells=[v4.new_code_cell(PREPARATION), *page.cells], metadata=page.metadata)
    NotebookClient(
        own,
        timeout=LONGEST_S,
        kernel_name="python3",
        extra_arguments=["--log-level=ERROR"],
        resources={"metadata": {"path": str(ROOT)}},
    ).execute()
    return v4.new_notebook(cells=own.cells[1:], metadata=page.metadata)


def markdown(page: nbformat.NotebookNode, stem: str) -> tuple[str, dict[str, str]]:
    """Returns a notebook with outputs as Markdown, and its pictures and pages as files by name, which begins with `stem`."""
    parts: list[str] = []
    files: dict[str, str] = {}
    for cell in page.cells:
        if cell.cell_type == "markdown":
            parts.append(cell.source)
            continue
        parts.append(f"```python\n{cell.source}\n```")
        printed = ""
        for output in cell.outputs:
            data = output.get("data", {})
            if output.output_type == "stream":
                # Warnings of scenes go to standard error, and stand in notebooks only.
                printed += output.text if output.name == "stdout" else ""
            elif "image/svg+xml" in data:
                name = f"{stem}-{len(files) + 1}.svg"
                files[name] = data["image/svg+xml"]
                parts.append(f"![Drawn by the program above]({name})")
            elif "text/html" in data:
                name = f"{stem}-{len(files) + 1}.html"
                files[name] = data["text/html"]
                parts.append(f'<iframe class="output" src="{name}" title="Shown by the program above" loading="lazy"></iframe>')
            else:
                printed += data.get("text/plain", "") + "\n"
        if printed.strip():
            parts.append(f'<pre class="output">{html.escape(printed.rstrip())}</pre>')
    return "\n\n".join(parts) + "\n", files


def main(words: list[str]) -> None:
    if words[:1] == ["--run"] and len(words) > 1:
        for path in map(Path, words[1:]):
            if not FENCE.search(path.read_text(encoding="utf-8")):
                continue
            start = time.perf_counter()
            run(notebook(path.read_text(encoding="utf-8")))
            print(f"{path}: {time.perf_counter() - start:.1f} s", flush=True)
    elif len(words) == 2:
        nbformat.write(notebook(Path(words[0]).read_text(encoding="utf-8")), words[1])
    else:
        sys.exit(__doc__)


if __name__ == "__main__":
    main(sys.argv[1:])
