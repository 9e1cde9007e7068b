"""The stages of a search, and `find`, which runs them: prepare, select, measure the gap, validate, summarise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from threadpoolctl import threadpool_limits

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.contacts import Contacts, read_contacts
from discrepancy.data.notes import SearchNote, SearchNoteKind, sort_notes
from discrepancy.data.reading import read_collisions
from discrepancy.data.study_design import note_uniform_conditions
from discrepancy.data.track_checks import detect_processing
from discrepancy.fitting.base_fit import check_clips, fit_base_model
from discrepancy.fitting.model_fit import WhitenedClips
from discrepancy.fitting.noise_refit import refit_noise
from discrepancy.fitting.parameters import candidates_by_name
from discrepancy.fitting.stretch_scatter import fit_scatter
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.law_summary import LawSummary, tabulate_and_refit
from discrepancy.outcome import Verdict, decide_verdict, more_is_missing
from discrepancy.planning.compare import advise_on_pair, compare_designs
from discrepancy.policy import SearchPolicy, applied_policy, current_policy
from discrepancy.preparation import SearchData, prepare_data
from discrepancy.results import SearchResult
from discrepancy.select.contact_effects import select_contact_laws
from discrepancy.select.effect_claim import EffectClaim
from discrepancy.select.free_law_contest import select_effects_and_law
from discrepancy.select.law_fit import fit_unseen_clips
from discrepancy.select.library_fits import LibraryFits
from discrepancy.select.library_search import InterruptedSearch, Selection, find_undetectable, make_selection
from discrepancy.time_left import ONLY_LAWS, Deadline, OutOfTime, Progress, in_stage, showing_stages
from discrepancy.validate.claim_tests import HeldOutClips, ValidatedSelection, validate
from discrepancy.validate.gap import GapFits, measure_gap
from discrepancy.validate.outlier_clips import find_outlier_clips
from discrepancy.validate.residual_map import find_disagreements
from synthcam.model import Model, as_model
from synthcam_shared.arguments import check_arguments
from synthcam_shared.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

    from tracker.camera.camera import CameraSource
    from tracker.recording import Result


@check_arguments
def find(
    results: Sequence[Result] | pd.DataFrame | str | Path,
    model: Model | Mapping[str, Any] | str | Path,
    camera: CameraSource | None = None,
    progress: Progress = lambda stage: None,
    minutes: float = math.inf,
    policy: SearchPolicy | None = None,
    stretches: bool = False,
) -> SearchResult:
    """Search for what a model lacks, from measured collisions.

    Parameters
    ----------
    results : sequence of tracker.Result, DataFrame, str or Path
        Results of `tracker.track` or `tracker.measure` for several clips of one camera; or a tracker's RESULTS;
        or, with `camera`, a table of tracks: a file, or a DataFrame with the columns clip, frame, particle, x, y.
    model : Model, dict, str or Path
        The model to compare with the measurement, its settings, or its file. Also a scene file, or the name of a scene
        that comes with synthcam. The search fits its base parameters that are not zero, and those in its ``free``.
    camera : Camera, dict, str or Path, optional
        Of a table: the keys of camera.json, or its path.
    progress : callable
        Called with the name of the stage, many times.
    minutes : float
        Time limit by the clock. A search that exceeds it is cut short, claims nothing, and reports how far it came.
    policy : SearchPolicy, optional
        The thresholds that decide; default: ``SearchPolicy()``.
    stretches : bool
        Search the free stretches of each ball between contacts, each with a start of its own. Use it where no one
        model fits whole collisions, as with cued strikers. The local estimates of `results` are then the evidence on
        the impact; a table of tracks has none.

    Returns
    -------
    SearchResult

    Raises
    ------
    InputError
        One line: the model is invalid, clips are unusable, or there are too few.

    Examples
    --------
    >>> import discrepancy
    >>> found = discrepancy.find("out/results", "painter_behringer")  # doctest: +SKIP
    >>> found.report("out/search")  # doctest: +SKIP
    >>> discrepancy.find([], "painter_behringer")
    Traceback (most recent call last):
    ...
    synthcam_shared.errors.InputError: results: no clip with a measured collision
    """
    source = Path(results) if isinstance(results, str) else results
    given = as_model(model)
    with applied_policy(policy or SearchPolicy()):
        clips, notes = read_collisions(source, Path(camera) if isinstance(camera, str) else camera, stretches)
        contacts = read_contacts(source) if stretches else None
        found = search(clips, given, progress, 60 * minutes, notes, stretches, contacts)
    measured, base_model = (str(each) if isinstance(each, str | Path) else "" for each in (results, model))
    return replace(found, measured=measured, base_model=base_model)


def search(
    clips: Sequence[MeasuredCollision],
    model: Model,
    progress: Progress = lambda stage: None,
    seconds: float = math.inf,
    notes: Sequence[SearchNote] = (),
    stretches: bool = False,
    contacts: Contacts | None = None,
) -> SearchResult:
    """Run all stages of a search on collisions from `read_collisions`, with its notes.

    stretches: the evidence is each free stretch between contacts, with a start of its own. contacts: the evidence on
    the impact, from `read_contacts`. The policy is that of the context (`applied_policy`). See `find`.
    """
    with (
        showing_stages(progress),
        threadpool_limits(1, "blas"),
    ):  # matrices are small: threads would wait for one another
        clips = check_clips(clips, model)
        data = prepare_data(clips, model, stretches)
        data, library, selection = select_until_stable(data, model, Deadline(seconds))
        data, gap = measure_held_out_gap(data, selection)
        validated = ValidatedSelection(selection)
        if not (data.is_smoothed or selection.interrupted):
            held_out = HeldOutClips(data.held_out, data.noise, gap.before)
            validated = validate(selection, library, held_out)
        result = finish_search(clips, data, validated, library, gap)
        given = sort_notes(notes)
        return replace(
            result,
            left_out=(*given.left_out, *data.left_out),
            processed=(*given.processed, *result.processed),
            uniform=(*given.common, *result.uniform),
            contacts=select_contact_laws(contacts) if contacts else (),
        )


def select_until_stable(
    data: SearchData, model: Model, deadline: Deadline, rounds: int = 4, scatter_rounds: int = 2
) -> tuple[SearchData, LibraryFits, Selection]:
    """Run the stages of base fit and selection until clips and noise stay the same, at most in so many rounds.

    After each round the search leaves out clips that deviate from all others. If there are none, it estimates the noise
    again from the residuals of the best model; of stretches, their scatter in the first rounds. For smoothed tracks it
    fits only the base model. If the deadline passes in a selection, the search ends and reports the best model so far.
    LibraryFits holds all models that were fitted.
    """
    removed = 0
    for turn in range(rounds):
        library, selection = select(data, model, deadline)
        if turn == rounds - 1 or data.is_smoothed or selection.interrupted:
            break
        clips = selection.explained_clips(data.clips)
        outliers = find_outlier_clips(clips, selection.base, selection.joint_fit, removed)
        if outliers:
            removed += len(outliers)
            data = data.without(outliers)
            continue
        if data.is_cut:
            scatter = fit_scatter(clips, selection.joint_fit, data.noise)
            if turn < scatter_rounds and not scatter.is_close_to(data.scatter):
                data = data.with_scatter(scatter, selection.joint_fit)
                continue
            if not scatter.is_none:
                break
        noise = refit_noise(clips, selection.joint_fit, data.noise)
        if noise is None and selection.near_law:  # the library's model may count the law's effect as noise
            law = selection.near_law
            noise = refit_noise(law.evidence.clips, law.joint_fit, data.noise)
        if noise is None:
            break
        data = replace(data, noise=noise)
    return data, library, selection


def select(data: SearchData, model: Model, deadline: Deadline) -> tuple[LibraryFits, Selection]:
    """Run the stage of selection: fit the base model, then select effects, and a free law if one explains more."""
    evidence = WhitenedClips.of(data.clips, data.noise)
    base = fit_base_model(data.clips, model, data.noise)
    library = LibraryFits(evidence, base)
    if data.is_smoothed:
        return library, make_selection(library, ())
    is_significant = any(test.sigma > library.required_sigma for test in library.ranking[:1])
    stage = "free laws" if is_significant else ONLY_LAWS
    try:
        with deadline.limited(), in_stage(stage):
            return library, select_effects_and_law(library)
    except OutOfTime:
        best = min(library.fits, key=library.cost_of)
        effects = tuple(sorted(c.name for c in best))
        interrupted = InterruptedSearch(effects, library.fits[best].chi2 / base.points, deadline.seconds)
        return library, replace(make_selection(library, ()), interrupted=interrupted)


@in_stage("gap")
def measure_held_out_gap(data: SearchData, selection: Selection) -> tuple[SearchData, GapFits]:
    """Run the stage that measures the gap on held-out clips, without clips that deviate from all others."""
    gap = _measure_gap(data, selection)
    outliers = find_outlier_clips(data.held_out, gap.before, gap.after, are_held_out=True)
    if not outliers:
        return data, gap
    kept = tuple(c for k, c in enumerate(data.held_out) if k not in outliers)
    notes = [replace(note, values=note.values | {"held_out": " (held out)"}) for note in outliers.values()]
    data = replace(data, held_out=kept, left_out=(*data.left_out, *notes))
    return data, _measure_gap(data, selection)


def _measure_gap(data: SearchData, selection: Selection) -> GapFits:
    law, clips = selection.free_law, data.held_out
    fit_law = None if law is None else lambda before: fit_unseen_clips(law, clips, before, data.noise)
    try:
        return measure_gap(clips, selection.base, selection.best, data.noise, fit_law)
    except ValueError as e:
        raise InputError(f"the fitted base model has no motion for the held-out collisions: {e}") from None


def finish_search(
    clips: Sequence[MeasuredCollision],
    data: SearchData,
    validated: ValidatedSelection,
    library: LibraryFits,
    gap: GapFits,
) -> SearchResult:
    """Run the last stage of a search: decide the verdict, and collect the data that the report needs.

    clips: all clips, before outliers are removed; gap: that of the selection before the validation.
    """
    selection, law, policy = validated.selection, validated.selection.free_law, current_policy()
    with in_stage("gap"):
        if validated.rejected:
            gap = _measure_gap(data, selection)
        with_table = tabulate_and_refit(law) if law else None
        if with_table:
            gap = measure_gap(data.held_out, selection.base, with_table, data.noise)
    with in_stage("where"):
        before = left = find_disagreements(data.clips, selection.base, data.noise)
        if not selection.is_empty:
            left = find_disagreements(selection.explained_clips(data.clips), selection.joint_fit, data.noise)
    more = more_is_missing(left, validated.rejected, policy)
    claims = validated.claims_by_scatter(data.is_cut) if more or data.is_cut else validated.claims
    is_within_noise = gap.gap.before <= gap.gap.floor
    verdict = decide_verdict(claims, law is not None, left, validated.rejected, policy, is_within_noise=is_within_noise)
    if selection.interrupted and any(c.sigma > library.required_sigma for c in library.ranking[:1]):
        verdict = Verdict.INADEQUATE
    smoothed = [SearchNote(SearchNoteKind.SMOOTHED)] if data.is_smoothed else []
    return SearchResult(
        verdict=verdict,
        data=data,
        base_fit=selection.base,
        best_fit=law.fit if law else selection.best,
        model=with_table.model if with_table else _free_owner(law) if law else selection.best.model,
        claims=claims,
        free_law=law,
        law_summary=LawSummary.of(law) if law else None,
        model_holds_law=with_table is not None or bool(law and law.law.frees),
        gap_fits=gap,
        base_disagreements=before,
        disagreements=left,
        accepted=validated.accepted,
        rejected=validated.rejected,
        scores=library.ranking,
        required_sigma=library.required_sigma,
        undetectable=find_undetectable(library, selection.state),
        experiment=_advise_experiment(selection, library, claims, data) if verdict is Verdict.AMBIGUOUS else "",
        uniform=tuple(note_uniform_conditions(clips)),
        processed=(*smoothed, *detect_processing(clips), *data.error_notes),
        interrupted=selection.interrupted,
        policy=policy,
    )


def _free_owner(law: FittedLaw) -> Model:
    """The model beside a free law that it cannot hold, with the parameter free by which it may express the law."""
    model = law.model_without_law
    return replace(model, free=tuple(dict.fromkeys((*model.free, *filter(None, [law.law.frees])))))


def _advise_experiment(
    selection: Selection, library: LibraryFits, claims: Sequence[EffectClaim], data: SearchData
) -> str:
    """Advise on an experiment that separates each claimed effect from its nearest alias."""
    base, best = selection.base, selection.best
    known = candidates_by_name(best.model, base.model, base.names)
    shapes = {c.effect: c.shapes for c in library.ranking}
    sentences = []
    for claim in claims:
        for rival in claim.aliases[1:2]:
            one, other = known[claim.effect], known[rival]
            pair = (one, claim.shapes), (other, shapes.get(rival, {}))
            sentences.append(advise_on_pair(one, other, compare_designs(data.clips, data.noise, best, *pair)))
    return " ".join(sentences)
