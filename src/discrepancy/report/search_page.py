"""REPORT of a search: discrepancy.json, model.yaml, residuals.parquet and a self-contained index.html."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from discrepancy import wording
from discrepancy.fitting.parameters import find_parameter
from discrepancy.outcome import SearchOutcome, Verdict
from discrepancy.report.document import tabulate_residuals, to_document
from discrepancy.report.figures import draw_search_figures, list_models, name_best_model
from discrepancy.select.effect_claim import EffectClaim, is_at_limit
from discrepancy.validate.claim_tests import ClaimTest
from discrepancy.validate.residual_map import Disagreement, is_unexplained
from synthcam.model import Model, write_model
from synthcam_shared.outputs import replace_folder
from synthcam_shared.report.numbers import format_number, round_to_error
from synthcam_shared.report.page import Block, PageList, PageSection, PageTable, write_page

FILES = ("discrepancy.json", "index.html", "model.yaml", "residuals.parquet")


def write(found: SearchOutcome, folder: Path) -> None:
    """Write the report of a search into a folder: its page, discrepancy.json, model.yaml and residuals.parquet."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "discrepancy.json").write_text(json.dumps(to_document(found), indent=1, allow_nan=False) + "\n")
    left_out, unit = list(map(str, found.left_out)), found.data.unit
    write_model(found.model, folder / "model.yaml")
    tabulate_residuals(found).to_parquet(folder / "residuals.parquet")
    figures = draw_search_figures(found)
    named, base = _named_table(found), found.base_disagreements
    definitions = (
        f"Verdict {found.verdict}: {wording.VERDICT_MEANINGS[found.verdict]}.",
        "Ball 1 is struck, ball 2 strikes. The impact parameter b is in units of the sum of the radii.",
        f"A launch is the state of both balls at the contact. Each {unit.one} has its own, which is always fitted.",
        f"The fitted {unit} determine the shared parameters, which all {unit} have in common. The held-out {unit} "
        f"enter no fit of shared parameters; only their launches are fitted.{_describe_extremes(found)}",
        "χ² per point: a point is one coordinate of one position. Noise alone gives slightly less than 1, because the "
        "launches are fitted.",
        "Residual: measured less predicted position. Sigma: significance, as of a normal distribution.",
    )
    about_stretches = (
        "A stretch is the motion of one ball between two contacts. It has its own start, whatever the impact was."
    )
    sections = [
        PageSection("Effects that the model lacks", [named, *_describe_similar(found)] if named else []),
        PageSection(
            "How to read this page", [PageList([*([about_stretches] if found.data.is_cut else []), *definitions])]
        ),
        PageSection("Course of the search", [PageList(wording.write_story(found), ordered=True)]),
        PageSection("Experiment that would distinguish the candidates", [found.experiment] if found.experiment else []),
        *(PageSection(figure.title, [figure]) for figure in figures),
        PageSection(f"Residuals of held-out {unit}, in numbers", [_gap_table(found)]),
        PageSection(f"Tests of each claim on {unit} that its fit did not use", _test_table(found)),
        PageSection("Disagreements of the base model", _list_disagreements(found, base, 10)),
        PageSection(
            f"Disagreements that remain {name_best_model(found)}",
            _list_disagreements(found, found.disagreements, 5, " remains") if not found.is_empty else [],
        ),
        PageSection("Fitted parameters of the model", [_parameter_table(found)]),
        PageSection(
            f"{str(unit).capitalize()} and positions that were not used", [PageList(left_out)] if left_out else []
        ),
    ]
    sources = {"Tracks": found.measured, "Base model": found.base_model}
    given = " ".join(f"{name}: {path}." for name, path in sources.items() if path)
    verdict = f"Verdict: {wording.describe_verdict(found)}"
    summary = [verdict, wording.describe_search(found), *([given] if given else [])]
    write_page(folder / "index.html", "Search for missing physics", sections, "discrepancy find", summary)


def write_report(found: SearchOutcome, folder: Path) -> Path:
    """Write the report of a search, as `SearchResult.report` does.

    Parameters
    ----------
    found : SearchOutcome
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


def _describe_extremes(found: SearchOutcome) -> str:
    """Say which collisions are held out on purpose; empty if there are too few, or if they are stretches."""
    count = len(found.data.clips) + len(found.data.held_out)
    if found.data.is_cut or count < found.policy.min_clips_to_hold_out_extremes:
        return ""
    return " The fastest and the most oblique collision are among them, so the test extrapolates."


def _named_table(found: SearchOutcome) -> PageTable | None:
    """Table of the claims: each parameter with its error and its own significance, and the joint one of the effect."""
    rows = []
    for claim in found.claims:
        aliases = ", ".join(claim.aliases[1:]) or "none"
        once = claim.effect, wording.format_sigma(claim.sigma), aliases  # on the first line of an effect
        for name, value in (claim.values | claim.shapes).items():
            text, own = _format_parameter(claim, name, value)
            effect, joint, similar = once
            rows.append((effect, name.rpartition(".")[2], text, _unit(name), own, joint, similar))
            once = "", "", ""
    if not rows:
        return None
    heads = ["effect", "parameter", "value ± standard error", "unit"]
    heads += ["significance of the parameter, sigma", "significance of the effect, sigma", "effects that fit as well"]
    note = (
        f"All values are from the {len(found.data.clips)} fitted {found.data.unit}. The significance of a parameter is "
        "its value over its standard error. The significance of the effect is that of all its strengths together. A "
        "95 % interval is 1.96 standard errors wide on either side."
    )
    return PageTable(heads, rows, note=f"{note} {wording.describe_error_source(found)}".rstrip())


def _format_parameter(claim: EffectClaim, name: str, value: float) -> tuple[str, str]:
    """Value with its error, or the reason why it has none; and its own significance."""
    std = (claim.std | claim.shape_std)[name]
    if name in claim.shapes and not np.isfinite(std):
        return "undetermined", ""
    number = round_to_error(value, std, 2)
    if claim.at_limit(name):
        return f"{number}, at the limit of its range", ""
    if not (np.isfinite(std) and std > 0):
        return f"{number}, without an error: more is missing", ""
    return f"{number} ± {std:.2g}", wording.format_sigma(abs(value) / std) if name in claim.values else ""


def _describe_similar(found: SearchOutcome) -> list[Block]:
    """Effects with a similar signature: in the claim's place one leaves at least 1 - cosine² of its chi^2."""
    out: list[Block] = []
    for claim in found.claims:
        excluded: list[str] = []
        others: list[str] = []
        for names, cosine in claim.alike:
            is_alias = len(names) == 1 and names[0] in claim.aliases
            remaining_chi2 = (1 - cosine**2) * claim.sigma**2
            is_excluded = not is_alias and remaining_chi2 > found.policy.rival_excluded_chi2
            text = f"{' with '.join(names)} (cosine {cosine:.3f})"
            (excluded if is_excluded else others).append(text)
        text = f"Some effects change the tracks similarly to {claim.effect} (cosine of the angle between both changes)."
        if excluded:
            text += f" The data exclude each of these in place of {claim.effect}: {', '.join(excluded)}."
        if others:
            text += f" The data do not exclude: {', '.join(others)}."
        if claim.alike:
            out.append(text)
    return out


def _gap_table(found: SearchOutcome) -> PageTable:
    gap, models = found.gap, [*list_models(found), "noise alone"]
    heads = ["phase", *(f"χ² per point: {model}" for model in models), *(f"rms / µm: {model}" for model in models)]
    keys = ["before", "floor"] if found.is_empty else ["before", "after", "floor"]
    rows = []
    for name, part in {**gap.by_phase, "all phases": gap}.items():
        chi2 = [wording.format_chi2(getattr(part, key)) for key in keys]
        rms = [format_number(getattr(part, f"{key}_um")) for key in keys]
        rows.append(["before the contact" if name == "before" else name, *chi2, *rms])
    note = f"The {len(found.data.held_out)} held-out {found.data.unit}. Rms of the residuals in x and y."
    return PageTable(heads, rows, note=note)


def _test_table(found: SearchOutcome) -> list[Block]:
    tests: list[ClaimTest] = [*found.accepted, *found.rejected]
    if not tests:
        return []
    unit = found.data.unit
    heads = [
        "claim",
        *(f"held-out {unit}, χ² per point: {which}" for which in ("without the claim", "with it")),
        f"held-out {unit}: observed significance, sigma (expected)",
        *(f"all {unit}, each left out of the fit, χ² per point: {which}" for which in ("without the claim", "with it")),
        f"all {unit}, each left out of the fit: significance, sigma",
        "result",
    ]
    rows = []
    for test in tests:
        held_out, each = test.held_out, test.leave_one_out
        rows.append(
            (
                test.name,
                *(wording.format_chi2(chi2) for chi2 in held_out.gap),
                f"{wording.format_sigma(held_out.sigma)} ({wording.format_sigma(held_out.promised)})",
                *(wording.format_chi2(chi2) for chi2 in each.gap),
                wording.format_sigma(each.sigma),
                f"rejected: {wording.describe_rejection(test, unit)}" if test.rejection else "passed all tests",
            )
        )
    fitted, predicted = len(found.data.clips), len(found.data.held_out)
    note = (
        f"The table shows two of the tests; the result is that of all tests. The first test predicts the {predicted} "
        f"held-out {unit}. The expected significance is the one that the claimed strength would give there. The error "
        "of that strength lowers both, so they are less than the root of the fall of chi². The second test predicts "
        f"all {fitted + predicted} {unit}, each by a fit that "
        f"did not use it. For a fitted {unit.one} that is the fit to the other {fitted - 1}. The second significance "
        f"may exceed that of the effect in the fit: it counts more {unit}, and neither model was fitted to them."
    )
    return [PageTable(heads, rows, note=note)]


def _list_disagreements(
    found: SearchOutcome, disagreements: Sequence[Disagreement], rows_shown: int, remains: str = ""
) -> list[Block]:
    """A table of the most significant disagreements; one sentence where none is significant."""
    if is_unexplained(disagreements, found.policy):
        rows = []
        for one in disagreements[:rows_shown]:
            size = format_number(one.size, 2) if np.isfinite(one.size) and one.size else ""
            where = wording.describe_disagreement(one, found.base_fit.model)
            rows.append((where, wording.format_sigma(one.sigma), size))
        note = (
            f"Residuals of the {len(found.data.clips)} fitted {found.data.unit}. The significance is corrected for "
            f"{len(disagreements)} tests. The rms is that of the terms that the test fits, noise subtracted: within a "
            "phase only terms that curve the path. Along and across: relative to the motion of the ball in this phase. "
            "Position: its mean position in this phase. Speed, heading and impact parameter: of the striker."
        )
        return [PageTable(["disagreement", "significance, sigma", "rms / µm"], rows, note=note)]
    if not disagreements:
        return []
    worst = wording.format_sigma(disagreements[0].sigma)
    chance = ", what chance gives" if disagreements[0].sigma == 0 else ""
    return [
        f"No significant disagreement{remains} (largest: {worst} sigma{chance}, corrected for "
        f"{len(disagreements)} tests; significant is above {found.policy.unexplained_sigma:g}). The test uses the "
        f"{len(found.data.clips)} fitted {found.data.unit}."
    ]


def _parameter_table(found: SearchOutcome) -> PageTable:
    rows = []
    for name in found.best_fit.names:
        base = f"{found.base_fit.model.value(name):.6g}" if name in found.base_fit.names else ""
        best = f"{found.best_fit.model.value(name):.6g}"
        std = found.best_fit.std[name] if _has_errors(found) else math.nan
        if std > 0 and not is_at_limit(name, found.best_fit.model.value(name)):
            best = f"{round_to_error(found.best_fit.model.value(name), std, 2)} ± {std:.2g}"
        rows.append([name, _unit(name), *([best] if found.is_empty else [base, best])])
    known = {name: text for name, text in wording.BASE_MEANINGS.items() if name in found.best_fit.names}
    note = "; ".join(f"{name}: {text}" for name, text in known.items())
    note = f"{note[:1].upper()}{note[1:]}. " if note else ""
    if not _has_errors(found):
        note += "No errors are given, because errors from noise alone are too small here."
    elif not found.is_empty:
        note += "± is one standard error. The base model does not describe the data, so its values have no errors."
    return PageTable(["parameter", "unit", *list_models(found)], rows, note=note)


def _has_errors(found: SearchOutcome) -> bool:
    """Tell if errors that follow from noise are valid for the shared parameters of the best model."""
    return (
        found.is_complete and not found.data.is_cut and not found.free_law and found.verdict is not Verdict.INADEQUATE
    )


def _unit(name: str) -> str:
    """Unit of a parameter by its dotted name; "" for a pure number."""
    unit = find_parameter(Model(), name).unit
    return "" if unit == "1" else unit
