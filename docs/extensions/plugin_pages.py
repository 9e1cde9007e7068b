"""Pages of what is found by its being there: effects, free laws, detectors and export formats."""

from __future__ import annotations

import inspect
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

from myst_text import paragraphs, plain, table

from discrepancy.free_laws.library import list_free_laws as free_laws
from synthcam.dataset.effect_drawing import draw_effect
from synthcam.effect import with_typical_values
from synthcam.library import library as effects
from tracker.detection.detect import list_detectors

PICTURE = {"camera", "clock", "exposure", "measure"}  # laws of the picture; the others are of the motion


def pages(root: Path) -> dict[str, str | bytes]:
    """By name under docs/generated."""
    return effect_pages() | {"free_laws.md": free_law_page(), "detectors.md": detector_page()}


def effect_pages() -> dict[str, str | bytes]:
    """All effects on a page, each with a sketch of what it does to the tracks."""
    made: dict[str, str | bytes] = {}
    rows, parts = [], []
    for name, effect in effects().items():
        kind = "picture" if PICTURE & set(effect.laws) else "motion"
        sizes = ", ".join(
            f"{p.name} {p.typical:g} {p.unit if p.unit != '1' else ''}".strip() for p in effect.strengths()
        )
        rows.append([f"[`{name}`](#effect-{name.replace('_', '-')})", kind, plain(paragraphs(effect)[0]), plain(sizes)])
        picture, most = drawn(effect)
        made[f"effects/{name}.png"] = picture
        parts.append(section(name, effect, most))
    head = (
        "# Effects\n\nAn effect is something that the base model lacks and that a search can find. The list is "
        "made of the files of `src/synthcam/effects` when the site is built; `synthcam effects` shows it in a "
        "terminal. A strength is zero where the effect is absent; a shape parameter says where or how it acts. "
        "One of your own: [](../howto/effect.md).\n"
    )
    made["effects.md"] = "\n".join([head, table(["effect", "of the", "law", "typical size"], rows), *parts])
    return made


def section(name: str, effect: Any, most: float) -> str:
    """The section of one effect."""
    rows = [
        [f"`{name}.{p.name}`", kind_of(p), plain(p.unit), f"{p.typical:g}", limits(p), f"{p.default:g}"]
        for p in effect.parameters()
    ]
    laws = ", ".join(f"`{law}`" for law in effect.laws)
    text = "\n\n".join(plain(p) for p in paragraphs(effect))
    return (
        f"\n(effect-{name.replace('_', '-')})=\n## {name}\n\n{plain(paragraphs(sys.modules[effect.__module__])[0])}\n\n"
        f"{text}\n\n"
        f"It changes {laws}. At its typical size it moves the tracks by up to {most:.3g} µm.\n\n"
        f"{table(['parameter', 'kind', 'unit', 'typical', 'from, to', 'default'], rows)}\n\n"
        f"![tracks with and without {name}](effects/{name}.png)\n"
    )


def kind_of(parameter: Any) -> str:
    if not parameter.fixed:
        return "strength"
    return "shape, given" if parameter.given else "shape"


def limits(parameter: Any) -> str:
    low, high = (f"{v:g}" if math.isfinite(v) else "any" for v in (parameter.low, parameter.high))
    return "any" if low == high == "any" else f"{low}, {high}"


def drawn(effect: Any) -> tuple[bytes, float]:
    """The sketch of `synthcam effects NAME -o FILE`, and by how many micrometres the effect moves things."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sketch.png"
        most = draw_effect(with_typical_values(effect), path)
        return path.read_bytes(), most


def free_law_page() -> str:
    """All free laws in a table."""
    rows = []
    for law in free_laws():
        depends = f"`{law.bends[0]}` by `{law.bends[1]}`" if law.bends and law.bends[1] else "none: of no effect"
        owners = ", ".join(f"`{owner}`" for owner, _ in law.owners) or "none: it adds"
        balls = "both, a or b" if law.one_ball else "both"
        rows.append([f"`{law.base_name}`", plain(law.description), plain(law.unit), depends, owners, balls])
    head = (
        "# Free laws\n\nLaws that a search leaves free, as a curve or a map, if no effect of the library explains "
        "the residuals ([](../discrepancy.md)). The list is made of the modules of "
        "`src/discrepancy/free_laws/laws` when the site is built. One of your own: [](../howto/free_law.md).\n\n"
    )
    titles = ["free law", "meaning", "unit", "law that it changes", "parameters that it replaces", "balls"]
    return head + table(titles, rows) + "\n"


def detector_page() -> str:
    """All detectors in a table."""
    rows = []
    for name, detector in list_detectors().items():
        point = str(getattr(detector, "point", "glint"))
        module = inspect.getmodule(detector)
        rows.append([f"`{name}`", plain(paragraphs(module)[0]), point])
    head = (
        "# Detectors\n\nHow `tracker track --detector NAME` can find balls. The list is made of the files of "
        "`src/tracker/detection/detectors` when the site is built. Their accuracy: "
        "[](../benchmark.md); one of your own: [](../howto/detector.md).\n\n"
    )
    return head + table(["detector", "method", "point that it finds"], rows) + "\n"
