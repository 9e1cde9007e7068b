"""REPORT: discrepancy.json, model.yaml and a self-contained index.html."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from discrepancy.fitting.parameters import find_parameter
from discrepancy.found import SearchResult
from discrepancy.report.figures import drawn
from discrepancy.report.narrative import rounded, story
from discrepancy.select.effect_claim import format_with_error
from synthcam.model import Model, write_model
from synthcam_shared.report.page import render


def write(found: SearchResult, folder: Path, left_out: Sequence[str]) -> None:
    """Write the report's three files into a folder, made if need be. left_out: a line for each clip, or part of one."""
    folder.mkdir(parents=True, exist_ok=True)
    content = document(found, left_out)
    (folder / "discrepancy.json").write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
    write_model(found.model, folder / "model.yaml")
    page = render(
        Path(__file__).with_name("report.html"),
        found=found,
        document=found.document() | {"clips": content["clips"]},
        story=story(found),
        figures=drawn(found),
        finite=np.isfinite,
        format_with_error=format_with_error,
        rounded=rounded,
        unit=_unit,
        made="discrepancy find",
    )
    (folder / "index.html").write_text(page, encoding="utf-8")


def document(found: SearchResult, left_out: Sequence[str]) -> dict[str, Any]:
    """The keys of discrepancy.json, plain; None for what is not finite."""
    whole: dict[str, Any] = plain(found.document())
    whole["clips"]["left_out"] = list(left_out)
    return whole


def _unit(name: str) -> str:
    """Of a parameter by its dotted name; empty for a pure number."""
    unit = find_parameter(Model(), name).unit
    return "" if unit == "1" else unit


def plain(value: Any) -> Any:
    """For JSON: no numpy, NaN and infinity as null."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value
