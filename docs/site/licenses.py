"""The packages of others in softarm and their licenses, from Cargo.lock, Cargo and the packages themselves; nothing is built.

    python3 docs/site/licenses.py                  prints the tables of docs/licenses.md
    python3 docs/site/licenses.py --write          writes them into docs/licenses.md, below its line "<!-- tables -->"
    python3 docs/site/licenses.py --check          fails if the page has other tables
    python3 docs/site/licenses.py --texts [TARGET] prints the license files of the packages in the program, of one target or of all

Cargo fetches packages of other systems when it sees them for the first time.
"""

import difflib
import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "licenses.md"
MARK = "<!-- tables -->\n"
# Those of .github/workflows/release.yml.
TARGETS = {
    "x86_64-unknown-linux-gnu": "Linux",
    "aarch64-unknown-linux-gnu": "Linux",
    "aarch64-apple-darwin": "macOS",
    "x86_64-apple-darwin": "macOS",
    "x86_64-pc-windows-msvc": "Windows",
}
SYSTEMS = sorted(set(TARGETS.values()))
FILES = ("license", "licence", "copying", "notice", "copyright", "unlicense")


def cargo(*arguments):
    return subprocess.run(["cargo", *arguments, "--locked"], cwd=ROOT, check=True, stdout=subprocess.PIPE, encoding="utf-8").stdout


def packages():
    """All packages of Cargo.lock that come from a registry, by name and version."""
    read = json.loads(cargo("metadata", "--format-version", "1"))["packages"]
    return {(package["name"], package["version"]): package for package in read if package["source"]}


def reached(package, edges, target):
    """Names and versions of the packages that a release build of `package` needs along some kinds of dependencies."""
    tree = cargo("tree", "--package", package, "--edges", edges, "--target", target, "--prefix", "none", "--no-dedupe", "--format", "{p}")
    words = (line.split() for line in tree.splitlines())
    return {(name, version.removeprefix("v")) for name, version, *_ in words}


def license_of(package):
    """An expression of SPDX, in which older packages write a slash for OR."""
    text = package["license"]
    return " OR ".join(part.strip() for part in text.split("/")) if text else f"file {package['license_file']}"


def tables(known):
    linked, built, wheel = {}, set(), set()
    for target, system in TARGETS.items():
        for package in reached("softarm", "normal,no-proc-macro", target) & known.keys():
            linked.setdefault(package, set()).add(system)
        wheel |= reached("softarm-python", "normal,no-proc-macro", target)
        for package in ("softarm", "softarm-python"):
            built |= reached(package, "normal,build", target)
    wheel = wheel & known.keys() - linked.keys()
    built = built & known.keys() - linked.keys() - wheel
    rest = known.keys() - linked.keys() - wheel - built
    text = ""
    for heading, said, rows in [
        ("In the program", "Linked into the program `softarm`, and into the module of the Python package.", linked),
        ("In the Python package alone", "Linked into the module of the Python package besides.", wheel),
        ("While it is built", "Macros and build scripts, which run while softarm is compiled and are not part of it.", built),
        ("Neither", "Only in tests and benchmarks, or only on systems for which nothing is released.", rest),
    ]:
        systems = rows is linked
        text += f"\n## {heading}\n\n{said}\n\n| package | version | license |{' systems |' if systems else ''}\n"
        text += f"| --- | --- | --- |{' --- |' if systems else ''}\n"
        for name, version in sorted(rows):
            where = sorted(linked.get((name, version), ()))
            end = f" {'all' if where == SYSTEMS else ', '.join(where)} |" if systems else ""
            text += f"| {name} | {version} | {license_of(known[name, version])} |{end}\n"
    return text


def texts(known, targets):
    """The license files of the packages in the program, the same text once, after the names of its packages."""
    linked = set().union(*(reached("softarm", "normal,no-proc-macro", target) for target in targets)) & known.keys()
    owners = {}
    for name, version in sorted(linked):
        package = known[name, version]
        folder = Path(package["manifest_path"]).parent
        files = [path for path in sorted(folder.iterdir()) if path.is_file() and path.name.lower().startswith(FILES)]
        said = f"{name} {version} ({license_of(package)})"
        for path in files:
            owners.setdefault(path.read_text(encoding="utf-8", errors="replace").strip(), []).append(f"{said}: {path.name}")
        if not files:
            authors = ", ".join(package["authors"]) or "see its repository"
            owners.setdefault("The package has no license file.", []).append(f"{said}: by {authors}, {package['repository']}")
    parts = ["\n".join(names) + f"\n\n{text}\n" for text, names in owners.items()]
    return "Licenses of the packages of others that are part of the program softarm.\n\n" + f"\n{'-' * 80}\n\n".join(parts)


def main(arguments):
    known = packages()
    if arguments[:1] == ["--texts"]:
        sys.stdout.reconfigure(encoding="utf-8", newline="\n")
        print(texts(known, arguments[1:] or TARGETS), end="")
        return 0
    page = PAGE.read_text(encoding="utf-8")
    whole = page.partition(MARK)[0] + MARK + tables(known)
    if arguments == ["--write"]:
        PAGE.write_text(whole, encoding="utf-8", newline="\n")
    elif arguments == ["--check"]:
        if page != whole:
            sys.stdout.writelines(difflib.unified_diff(page.splitlines(True), whole.splitlines(True), "docs/licenses.md", "Cargo.lock", n=0))
            print("docs/licenses.md is not what Cargo.lock says: python3 docs/site/licenses.py --write")
            return 1
    elif arguments:
        print(__doc__)
        return 2
    else:
        print(tables(known), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
