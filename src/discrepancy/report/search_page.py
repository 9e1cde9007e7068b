"""REPORT of a search: discrepancy.json, model.yaml and a self-contained index.html."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from discrepancy.fitting.parameters import find_parameter
from discrepancy.report.figures import draw_figures, name_of_best
from discrepancy.report.narrative import write_story
from discrepancy.results import SearchResult
from discrepancy.select.effect_claim import EffectClaim
from discrepancy.validate.claim_tests import ClaimTest
from discrepancy.validate.residual_map import Disagreement
from discrepancy.wording import describe_disagreement, describe_rejection, format_with_error
from synthcam.model import Model, write_model
from synthcam_shared.report.folder import replace_folder
from synthcam_shared.report.numbers import format_number
from synthcam_shared.report.page import Block, PageList, PageTable, Section, write_page

FILES = ("discrepancy.json", "index.html", "model.yaml")


def write(found: SearchResult, folder: Path) -> None:
    """Write the three files of the report.

    Parameters
    ----------
    found : SearchResult
    folder : Path
        Made where it is missing.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "discrepancy.json").write_text(json.dumps(found.document(), indent=1, allow_nan=False) + "\n")
    left_out = list(map(str, found.left_out))
    write_model(found.model, folder / "model.yaml")
    figures = draw_figures(found)
    named, base = _named_table(found), found.base_disagreements
    sections = [
        Section("Effects that the model lacks", [named, *_describe_similar(found)] if named else []),
        Section("Course of the search", [PageList(write_story(found), ordered=True)]),
        Section("Experiment that would distinguish the candidates", [found.experiment] if found.experiment else []),
        *(Section(figure.title, [figure]) for figure in figures),
        Section("Residuals of held-out collisions, in numbers", [_gap_table(found)]),
        Section("Tests of each claim on collisions that did not enter it", _test_table(found)),
        Section(
            "Disagreements of the base model",
            [_disagreement_table(base[:10], len(base))],
        ),
        Section(
            f"Disagreements that remain {name_of_best(found)}",
            [_disagreement_table(found.disagreements[:5], len(found.disagreements))] if not found.is_empty else [],
        ),
        Section("Fitted parameters of the model", [_parameter_table(found)]),
        Section("Collisions and positions that were not used", [PageList(left_out)] if left_out else []),
    ]
    write_page(folder / "index.html", "Search for missing physics", sections, "discrepancy find", [found.sentence()])


def write_report(found: SearchResult, folder: Path) -> Path:
    """Write a report, as `SearchResult.report` does.

    Parameters
    ----------
    found : SearchResult
    folder : Path
        Made, or replaced if it holds an earlier report.

    Returns
    -------
    Path
        Of ``index.html``.

    Examples
    --------
    >>> import discrepancy
    >>> found = discrepancy.find("out/results", "painter_behringer")  # doctest: +SKIP
    >>> discrepancy.write_report(found, "out/search")  # doctest: +SKIP
    """
    with replace_folder(folder, FILES, "a report of an earlier search") as place:
        write(found, place)
    return folder / "index.html"


def _named_table(found: SearchResult) -> PageTable | None:
    """Table of the claims: each parameter with its error and its own significance, and the joint one of the effect."""
    rows = []
    for claim in found.claims:
        once = claim.effect, f"{claim.sigma:.1f}", ", ".join(claim.aliases[1:])  # on the first line of an effect
        for name, value in (claim.values | claim.shapes).items():
            text, own = _format_parameter(found, claim, name, value)
            effect, joint, similar = once
            rows.append((effect, name.rpartition(".")[2], text, _unit(name), own, joint, similar))
            once = "", "", ""
    if not rows:
        return None
    heads = ["effect", "parameter", "value ± standard error", "unit"]
    heads += ["significance of the parameter, sigma", "significance of the effect, sigma", "effects that fit as well"]
    note = (
        "The significance of a parameter is its value over its standard error. The significance of the effect is that "
        "of all its strengths together. A 95 % interval is 1.96 standard errors wide on either side."
    )
    return PageTable(heads, rows, note=note)


def _format_parameter(found: SearchResult, claim: EffectClaim, name: str, value: float) -> tuple[str, str]:
    """Value with its error, or the reason why it has none; and its own significance."""
    std = (claim.std | claim.shape_std)[name]
    if name in claim.shapes and not np.isfinite(std):
        return "undetermined", ""
    number = format_with_error(value, std, 2)
    if claim.at_limit(name):
        return f"{number}, at the limit of its range", ""
    if not (np.isfinite(std) and std > 0) or not found.is_complete:
        return f"{number}, without an error: more is missing", ""
    return f"{number} ± {std:.2g}", f"{abs(value) / std:.1f}" if name in claim.values else ""


def _describe_similar(found: SearchResult) -> list[Block]:
    out: list[Block] = []
    for claim in found.claims:
        if claim.alike:
            pairs = ", ".join(f"{' with '.join(names)} (cosine {cosine:.3f})" for names, cosine in claim.alike)
            out.append(f"Effects whose signatures are nearly that of {claim.effect}: {pairs}.")
    return out


def _gap_table(found: SearchResult) -> PageTable:
    gap, best = found.gap, name_of_best(found)
    models = ["base model", *([best] if not found.is_empty else []), "noise alone"]
    heads = ["phase", *(f"χ² per point: {model}" for model in models), *(f"rms / µm: {model}" for model in models)]
    keys = ["before", *(["after"] if not found.is_empty else []), "floor"]
    rows = []
    for name, part in {**gap.by_phase, "all phases": gap}.items():
        chi2 = [f"{getattr(part, key):.4g}" for key in keys]
        rms = [format_number(getattr(part, f"{key}_um")) for key in keys]
        rows.append(["before the contact" if name == "before" else name, *chi2, *rms])
    note = "These collisions entered no fit of the shared parameters. Rms of the residuals in x and y."
    return PageTable(heads, rows, note=note)


def _test_table(found: SearchResult) -> list[Block]:
    tests: list[ClaimTest] = [*found.accepted, *found.rejected]
    if not tests:
        return []
    heads = [
        "claim",
        *(f"held-out collisions, χ² per point: {which}" for which in ("without it", "with it")),
        "held-out collisions: observed significance, sigma (expected)",
        *(f"leave one out, χ² per point: {which}" for which in ("without it", "with it")),
        "leave one out: significance, sigma",
        "result",
    ]
    rows = []
    for test in tests:
        held_out, each = test.held_out, test.leave_one_out
        rows.append(
            (
                test.name,
                *(f"{chi2:.4f}" for chi2 in held_out.gap),
                f"{held_out.sigma:.1f} ({held_out.promised:.1f})",
                *(f"{chi2:.4f}" for chi2 in each.gap),
                f"{each.sigma:.1f}",
                f"rejected: {describe_rejection(test)}" if test.rejection else "passed",
            )
        )
    note = (
        "Two tests of each claim. Held-out collisions entered no fit. In the second test, a fit to all other "
        "collisions predicts each collision in turn. The expected significance is the one that the claimed strength "
        "would give."
    )
    return [PageTable(heads, rows, note=note)]


def _disagreement_table(disagreements: Sequence[Disagreement], trials: int) -> PageTable:
    rows = []
    for one in disagreements:
        size = format_number(one.size, 2) if np.isfinite(one.size) and one.size else ""
        rows.append((describe_disagreement(one), f"{one.sigma:.1f}", size))
    note = f"The significance is corrected for {trials} trials."
    return PageTable(["disagreement", "significance, sigma", "rms / µm"], rows, note=note)


def _parameter_table(found: SearchResult) -> PageTable:
    base, best = found.base_fit, found.best_fit
    rows = []
    for name in best.names:
        values = [f"{base.model.value(name):.6g}" if name in base.names else ""]
        values += [f"{best.model.value(name):.6g}"] if not found.is_empty else []
        rows.append([name, _unit(name), *values])
    return PageTable(["parameter", "unit", "base model", *([name_of_best(found)] if not found.is_empty else [])], rows)


def _unit(name: str) -> str:
    """Unit of a parameter by its dotted name; "" for a pure number."""
    unit = find_parameter(Model(), name).unit
    return "" if unit == "1" else unit
