"""Write the map of the code in CONTRIBUTING.md from the first lines of module docstrings.

    python tools/plan.py            print the map
    python tools/plan.py --write    put it into CONTRIBUTING.md, between its two marks

Folders whose files are plug-ins (an effect, a free law, a detector, a format) are listed on one line each.
"""

from __future__ import annotations

import re
import sys
import textwrap
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "CONTRIBUTING.md"
BEGIN, END = "<!-- map of the code: python tools/plan.py --write -->", "<!-- end of the map -->"
FOLDERS = ("src/synthcam_shared", "src/synthcam", "src/tracker", "src/discrepancy", "benchmarks")  # lowest layer first
ABOUT = {  # folders without a package of their own
    "benchmarks": "Studies of speed and accuracy: python -m benchmarks.FOLDER.NAME, or make bench-...",
    "benchmarks/camera": "The pictures of the camera, against independent references",
    "benchmarks/paper": "The experiment of Painter & Behringer (2000) repeated: make paper",
    "benchmarks/paper/figures": "The figures of the paper, one file each",
    "benchmarks/paper/models": "Effects that the paper's model may lack, compared with its numbers",
    "benchmarks/paper/report": "The page and the PDF of the repeated experiment",
    "benchmarks/real": "Recordings of other laboratories",
    "benchmarks/regression": "The gate of the tracker: make gate",
    "benchmarks/search": "The search: blind trials, hidden effects, detection limits, thresholds",
    "benchmarks/simulation": "The simulation: speed, many bodies, random scenes, large datasets",
    "benchmarks/tracker": "The tracker: errors, error bars, speed, hostile films",
}
PLUGINS = ("effects", "exports", "formats", "detectors", "linkers", "laws")
WIDTH = 140


@cache
def summary(path: Path) -> str:
    """The first sentence of a module's docstring, without its full stop; empty where there is none."""
    found = re.match(r'r?"""(.*?)(\n\n|""")', path.read_text(encoding="utf-8"), re.DOTALL)  # quicker than to parse all
    return " ".join(found[1].split()).partition(". ")[0].rstrip(".") if found else ""


def folder_lines(folder: Path, depth: int = 0) -> list[str]:
    """Lines for a folder: its summary, its files, then its subfolders."""
    indent = "  " * depth
    name = folder.relative_to(ROOT) if depth == 0 else folder.name
    files = [p for p in sorted(folder.glob("*.py")) if p.stem not in ("__init__", "__main__")]
    package = folder / "__init__.py"
    about = summary(package) if package.is_file() else ABOUT.get(str(folder.relative_to(ROOT)), "")
    lines = entry(f"{indent}{name}/", about)
    if folder.name in PLUGINS:
        return lines + entry(f"{indent}  one file each:", ", ".join(p.stem for p in files))
    for path in files:
        lines += entry(f"{indent}  {path.stem}", summary(path))
    for inner in sorted(p for p in folder.iterdir() if p.is_dir() and any(p.glob("*.py"))):
        lines += folder_lines(inner, depth + 1)
    return lines


def entry(name: str, about: str) -> list[str]:
    """A name with its summary, folded under itself."""
    first = f"{name:<28} "
    return textwrap.wrap(f"{first}{about}".rstrip(), WIDTH, subsequent_indent=" " * len(first), drop_whitespace=True)


def plan() -> str:
    """The whole map, as a block of text."""
    lines = [line for name in FOLDERS for line in [*folder_lines(ROOT / name), ""]]
    return "\n".join(["```text", *lines[:-1], "```"])


def with_plan(text: str) -> str:
    """A page's text with the map between its marks."""
    before, _, rest = text.partition(BEGIN)
    _, mark, after = rest.partition(END)
    if not mark:
        sys.exit(f"{PAGE.name}: expected the lines {BEGIN!r} and {END!r}, which hold the map between them")
    return f"{before}{BEGIN}\n{plan()}\n{END}{after}"


if __name__ == "__main__":
    if sys.argv[1:] == ["--write"]:
        PAGE.write_text(with_plan(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    else:
        print(plan())
