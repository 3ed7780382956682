"""Programs of the tutorials and of the gallery run, as notebooks, as they stand; and every page is found."""

import importlib.util
import sys
from pathlib import Path

import pytest

pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")
pytest.importorskip("matplotlib")

DOCS = Path(__file__).parents[2] / "docs"
# The package is tested from the repository, or copied without its documents.
if not (DOCS / "site" / "notebooks.py").is_file():
    pytest.skip("no docs beside python", allow_module_level=True)
spec = importlib.util.spec_from_file_location("notebooks", DOCS / "site" / "notebooks.py")
notebooks = importlib.util.module_from_spec(spec)
sys.modules["notebooks"] = notebooks
spec.loader.exec_module(notebooks)

PAGES = sorted(
    path.relative_to(DOCS).as_posix()
    for folder in ("tutorials", "gallery")
    for path in (DOCS / folder).glob("*.md")
    if notebooks.FENCE.search(path.read_text(encoding="utf-8"))
)
# Where time is short: SOFTARM_PAGES="tutorials/first-reach.md,gallery/stiff-flop.md".
CHOSEN = [page for page in PAGES if notebooks.is_chosen(page)]


def test_there_are_pages():
    assert len(PAGES) >= 15


@pytest.mark.parametrize("page", PAGES)
def test_a_page_is_its_notebook(page):
    """The cells of the notebook hold all of the page, in its order, and nothing else."""
    text = (DOCS / page).read_text(encoding="utf-8")
    whole = [f"```python\n{cell.source}\n```" if cell.cell_type == "code" else cell.source for cell in notebooks.notebook(text).cells]
    assert "\n\n".join(whole) + "\n" == text
    assert page.split("/")[1] in (DOCS / page.split("/")[0] / "index.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", CHOSEN)
def test_programs_of_a_page_run(page):
    """Each ends with an assertion about its own answer, which fails here too."""
    text = (DOCS / page).read_text(encoding="utf-8")
    assert "\nassert " in text or "\n    assert " in text
    ran = notebooks.run(notebooks.notebook(text))
    page, files = notebooks.markdown(ran, "page")
    assert files and all(name in page for name in files)
