"""What the site has beside the files in docs, for MkDocs: README and other pages of the repository, pages with what their programs print and draw,
formulas as MathML.

Links in the repository lead from file to file. Here a link to a file that is a page of the site leads to that page. One to another file or folder
leads into the repository on the web, whose address is `repo_url`, and is plain text without an address. `notebooks.is_chosen`
tells which programs are run.
"""

from __future__ import annotations

import hashlib
import html
import importlib.util
import logging
import posixpath
import re
import sys
from pathlib import Path

import nbformat
from latex2mathml.converter import convert
from mkdocs.structure.files import File

sys.path.insert(0, str(Path(__file__).parent))
import notebooks  # noqa: E402

ROOT = notebooks.ROOT
LOG = logging.getLogger("mkdocs.hooks.softarm")
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")
SOURCE = re.compile(r'(<img [^>]*?src=")([^"]+)"')
CODE = re.compile(r"(^```.*?^```$|`[^`\n]+`)", re.DOTALL | re.MULTILINE)
# Their Markdown lies outside of docs.
PAGES = {
    "README.md": "index.md",
    "ARCHITECTURE.md": "architecture.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "benches/peers/README.md": "benches/peers.md",
    **{f"benches/{path.name}": f"benches/{path.name}" for path in sorted((ROOT / "benches").glob("*.md"))},
}
PICTURES = (".png", ".svg")
WITH_PROGRAMS = ("tutorials/", "gallery/")

# Pages with programs, after their run: Markdown by path.
done: dict[str, str] = {}


def _ran(text: str) -> nbformat.NotebookNode:
    """Runs the programs of a page, unless the same ones ran before with the same build of the package."""
    package = importlib.util.find_spec("softarm")
    if package is None or package.origin is None:
        raise RuntimeError("the programs of pages need the package softarm: pip install '.[plot]'")
    state = hashlib.sha256(text.encode() + notebooks.PREPARATION.encode())
    for path in sorted(Path(package.origin).parent.glob("*")):
        if path.is_file():
            state.update(path.read_bytes())
    kept = ROOT / "target" / "site-pages" / f"{state.hexdigest()[:24]}.ipynb"
    if kept.is_file():
        return nbformat.read(kept, as_version=4)
    page = notebooks.run(notebooks.notebook(text))
    kept.parent.mkdir(parents=True, exist_ok=True)
    nbformat.write(page, kept)
    return page


def on_files(files, config):
    """Adds pages from outside of docs, runs programs, and adds notebooks, pictures and pages that these make."""
    for source, name in PAGES.items():
        files.append(File.generated(config, name, abs_src_path=str(ROOT / source)))
    done.clear()
    for file in list(files.documentation_pages()):
        if not file.src_uri.startswith(WITH_PROGRAMS):
            continue
        text = file.content_string
        if not notebooks.FENCE.search(text):
            continue
        stem = file.src_uri.removesuffix(".md")
        content = nbformat.writes(notebooks.notebook(text)) + "\n"
        files.append(File.generated(config, f"{stem}.ipynb", content=content))
        if not notebooks.is_chosen(file.src_uri):
            continue
        LOG.info("running the programs of %s", file.src_uri)
        page, made = notebooks.markdown(_ran(text), posixpath.basename(stem))
        done[file.src_uri] = page
        for name, content in made.items():
            files.append(File.generated(config, posixpath.join(posixpath.dirname(stem), name), content=content))
    return files


def _in_repository(uri: str) -> str:
    """Returns the path in the repository of the source of a page."""
    return next((source for source, name in PAGES.items() if name == uri), f"docs/{uri}")


def _rewrite(text: str, uri: str, config, files) -> str:
    """Returns a page with links that lead to pages and files of the site, to which it adds pictures from outside of docs."""
    source, here = posixpath.dirname(_in_repository(uri)), posixpath.dirname(uri)

    def target(link: str) -> str | None:
        if "://" in link or link.startswith(("#", "mailto:")):
            return link
        path, _, anchor = link.partition("#")
        path = posixpath.normpath(posixpath.join(source, path))
        place = PAGES.get(path)
        if place is None and path.startswith("docs/"):
            place = path.removeprefix("docs/")
        elif path.endswith(PICTURES) and (ROOT / path).is_file():
            place = path
            if files.get_file_from_path(path) is None:
                files.append(File.generated(config, path, abs_src_path=str(ROOT / path)))
        if place is not None:
            return posixpath.relpath(place, here or ".") + (f"#{anchor}" if anchor else "")
        if not (ROOT / path).exists():
            LOG.warning("%s: the link to %s leads nowhere", uri, link)
        if not config.repo_url:
            return None
        kind = "tree" if (ROOT / path).is_dir() else "blob"
        return f"{config.repo_url.rstrip('/')}/{kind}/main/{path}" + (f"#{anchor}" if anchor else "")

    def link(match: re.Match[str]) -> str:
        to = target(match[3])
        return match[2] if to is None else f"{match[1]}[{match[2]}]({to})"

    parts = CODE.split(text)
    # Code has no links; a link whose text is code is put together again.
    kept = parts[1::2]
    joined = "".join(part if i % 2 == 0 else f"\x00{i // 2}\x00" for i, part in enumerate(parts))
    joined = SOURCE.sub(lambda match: f'{match[1]}{target(match[2])}"', LINK.sub(link, joined))
    return re.sub(r"\x00(\d+)\x00", lambda match: kept[int(match[1])], joined)


def _pictures(folder: str) -> str:
    """Returns the first picture of every page of a folder that has run, as links to these pages."""
    rows = []
    for uri, text in sorted(done.items()):
        picture = re.search(r"^!\[[^\]]*\]\(([^)]+)\)$", text, re.MULTILINE)
        if posixpath.dirname(uri) == folder and picture:
            name = posixpath.basename(uri)
            rows.append(f"[![{name.removesuffix('.md')}]({picture[1]})]({name})")
    return '\n\n<div class="pictures" markdown>\n\n' + "\n".join(rows) + "\n\n</div>\n" if rows else ""


def on_page_markdown(markdown, page, config, files):
    """Puts in what programs print and draw, and the links of the site."""
    uri = page.file.src_uri
    text = _rewrite(done.get(uri, markdown), uri, config, files)
    notebook = uri.removesuffix(".md") + ".ipynb"
    if files.get_file_from_path(notebook) is not None:
        ran = "" if uri in done else " Its programs were not run in this build."
        head, _, rest = text.partition("\n")
        text = f"{head}\n\n*[This page as a notebook]({posixpath.basename(notebook)}).{ran}*\n{rest}"
    if uri == "gallery/index.md":
        text += _pictures("gallery")
    return text


def on_page_content(content, page, config, files):
    """Turns formulas into MathML, which browsers show without a script."""

    def formula(match: re.Match[str]) -> str:
        text, kind = html.unescape(match[2]).strip(), "block" if match[1] == "div" else "inline"
        return convert(text[2:-2].strip(), display=kind)

    return re.sub(r'<(span|div) class="arithmatex">(.*?)</\1>', formula, content, flags=re.DOTALL)
