"""Find what a model lacks: the stages read, noise, fit, select, validate and report, composed by `find`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from threadpoolctl import threadpool_limits

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.notes import SearchNote, SearchNoteKind
from discrepancy.data.outlier_points import note_removed_points, remove_outliers
from discrepancy.data.prior_processing import covers_contact, detect_processing, remove_filtered_rows
from discrepancy.data.reading import read_collisions
from discrepancy.data.study_design import find_uniform_conditions, split_held_out
from discrepancy.deadline import Deadline, OutOfTime
from discrepancy.fitting.base_fit import (
    Progress,
    check_clips,
    estimate_noise,
    fit_base_model,
    remove_outliers_beside_model,
)
from discrepancy.fitting.model_fit import WhitenedClips
from discrepancy.fitting.noise_refit import refit_noise
from discrepancy.fitting.parameters import candidates_by_name
from discrepancy.free_laws.law_summary import LawSummary
from discrepancy.free_laws.tabulate import tabulate_and_refit
from discrepancy.planning.pair_advice import advise, compare_designs
from discrepancy.policy import SearchPolicy, applied_policy, current_policy
from discrepancy.results import SearchData, SearchResult, Verdict, more_is_missing
from discrepancy.select.effect_claim import EffectClaim
from discrepancy.select.free_law_contest import FreeLawContest
from discrepancy.select.law_fit import fit_unseen_clips
from discrepancy.select.library_search import InterruptedSearch, LibrarySearch, Selection
from discrepancy.validate.claim_tests import ClaimTest, ValidatedSelection, validate
from discrepancy.validate.gap import GapFits, measure_gap
from discrepancy.validate.outlier_clips import find_outlier_clips
from discrepancy.validate.residual_map import Disagreement, find_disagreements, is_unexplained
from synthcam.model import Model, as_model
from synthcam_shared.errors import InputError

if TYPE_CHECKING:
    from tracker.recording import Result


def find(
    results: Sequence[Result] | str | Path,
    model: Model | Mapping[str, Any] | str | Path,
    camera: str | Path | None = None,
    progress: Progress = lambda stage: None,
    minutes: float = math.inf,
    policy: SearchPolicy | None = None,
) -> SearchResult:
    """Search for what a model lacks, from measured collisions.

    Parameters
    ----------
    results : sequence of tracker.Result, str or Path
        Results of `tracker.track` or `tracker.measure` for several clips of one camera; or a tracker's RESULTS;
        or, with `camera`, a table of tracks.
    model : Model, dict, str or Path
        The model to compare with the measurement: a model, its settings, a model or scene file, or the name of a scene
        that comes with synthcam. The search fits its base parameters that are not zero, and those in its ``free``.
    camera : str or Path, optional
        camera.json of a table.
    progress : callable
        Called with the name of the stage, many times.
    minutes : float
        Time limit. A search that exceeds it is cut short, claims nothing, and reports how far it came.
    policy : SearchPolicy, optional
        The thresholds that decide; default: ``SearchPolicy()``.

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
        clips, left_out = read_collisions(source, None if camera is None else Path(camera))
        return search(clips, given, progress, 60 * minutes, left_out)


def search(
    clips: Sequence[MeasuredCollision],
    model: Model,
    progress: Progress = lambda stage: None,
    seconds: float = math.inf,
    left_out: Sequence[SearchNote] = (),
) -> SearchResult:
    """Search collisions from `read_collisions`; left_out: its notes on unusable collisions.

    See `find`. The policy is that of the context (`applied_policy`).
    """
    with threadpool_limits(1, "blas"):  # matrices here are small: threads wait for one another longer than they work
        clips = check_clips(clips, model)
        data = prepare(clips, model, progress)
        data, library, selection = select_until_stable(data, model, Deadline(progress, seconds))
        progress("gap")
        data, gap = measure_held_out_gap(data, selection, progress)
        if data.is_smoothed or selection.interrupted:
            validated = ValidatedSelection(selection)
        else:
            validated = validate(selection, library, data.held_out, gap.before, data.noise, lambda: progress("gap"))
        result = summarise(clips, data, validated, library, gap, progress)
        return replace(result, left_out=(*left_out, *data.left_out))


def prepare(clips: Sequence[MeasuredCollision], model: Model, progress: Progress) -> SearchData:
    """Stage 1 and 2: remove outliers, hold some clips out, and estimate the noise of the others.

    The noise is estimated from the smooth parts of the tracks, and again from the residuals of the base model. That
    comes before any claim, because a claim could absorb underestimated noise. If the tracks were smoothed, the stage
    removes the parts that the filter has moved instead.

    Parameters
    ----------
    clips : sequence of MeasuredCollision
    model : Model
    progress : callable

    Returns
    -------
    SearchData
    """
    progress("noise")
    cleaned = remove_outliers(clips)
    fitted, held_out = split_held_out(cleaned)
    if estimate_noise(fitted).is_smoothed:
        return _prepare_smoothed(cleaned, note_removed_points(clips, cleaned))
    fitted, held_out = remove_outliers_beside_model(fitted, held_out, model, progress)
    noise = estimate_noise(fitted)
    base = fit_base_model(fitted, model, noise, progress)
    noise = refit_noise(fitted, base, noise, explained=False) or noise
    left_out = note_removed_points(clips, [*fitted, *held_out])
    return SearchData(tuple(fitted), tuple(held_out), noise, tuple(left_out))


def _prepare_smoothed(smoothed: Sequence[MeasuredCollision], left_out: Sequence[SearchNote]) -> SearchData:
    """Keep the rows of smoothed tracks that the filter has not moved, in clips that have enough of them."""
    clips = [remove_filtered_rows(clip) for clip in smoothed]
    kept, least = [clip for clip in clips if covers_contact(clip)], current_policy().min_collisions
    if len(kept) < least:
        raise InputError(
            f"{SearchNote(SearchNoteKind.SMOOTHED)}: {len(kept)} of {len(clips)} collisions keep enough positions that "
            f"the filter does not move; expected {least} or more"
        )
    lost = tuple(SearchNote(SearchNoteKind.LOST_TO_FILTER, clip.clip) for clip in clips if not covers_contact(clip))
    fitted, held_out = split_held_out(kept)
    noise = estimate_noise(fitted)
    return SearchData(tuple(fitted), tuple(held_out), noise, (*left_out, *lost), is_smoothed=True)


def select_until_stable(
    data: SearchData, model: Model, deadline: Deadline, rounds: int = 4
) -> tuple[SearchData, LibrarySearch, Selection]:
    """Stage 3 and 4: fit the base model and select, repeated until clips and noise stay the same.

    After each round the search leaves out clips that deviate from all others, or else estimates the noise again from
    the residuals of the best model. For smoothed tracks it fits only the base model.

    Parameters
    ----------
    data : SearchData
    model : Model
    deadline : Deadline
        If it raises OutOfTime in the selection, the search ends and reports the best model so far.
    rounds : int
        At most.

    Returns
    -------
    (SearchData, LibrarySearch, Selection)
        The library search holds all models that were fitted, for the validation.
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
        noise = refit_noise(clips, selection.joint_fit, data.noise)
        if noise is None and selection.near_law:  # the library's model may count the law's effect as noise
            law = selection.near_law
            noise = refit_noise(law.evidence.clips, law.joint_fit, data.noise)
        if noise is None:
            break
        data = replace(data, noise=noise)
    return data, library, selection


def select(data: SearchData, model: Model, deadline: Deadline) -> tuple[LibrarySearch, Selection]:
    """Select the effects of the library, and a free law if one explains more.

    Each larger model of the library competes with the free laws. The library's search ends when a free law beats two of
    its models in a row.

    Parameters
    ----------
    data : SearchData
    model : Model
    deadline : Deadline

    Returns
    -------
    (LibrarySearch, Selection)
    """
    evidence = WhitenedClips.of(data.clips, data.noise)
    base = fit_base_model(data.clips, model, data.noise, deadline)
    library = LibrarySearch(evidence, base, lambda: deadline("search"))
    if data.is_smoothed:
        return library, library.select(())
    try:
        with deadline.limited():
            return library, _select_effects_and_law(
                library, FreeLawContest.of(evidence, base, lambda: deadline("free laws"))
            )
    except OutOfTime:
        best = min(library.fits, key=library.cost_of)
        effects = tuple(sorted(c.name for c in best))
        interrupted = InterruptedSearch(effects, library.fits[best].chi2 / base.points, deadline.seconds)
        return library, replace(library.select(()), interrupted=interrupted)


def _select_effects_and_law(library: LibrarySearch, contest: FreeLawContest) -> Selection:
    state: tuple[Any, ...] = ()
    for state in library.states():
        contest = contest.against(library.fit(state), library.rivals(state))
        if contest.ended:
            break
    selection = library.select(state)
    free_law, contest = contest.outcome(selection.best)
    beside = free_law.significances_of_effects(library.base) if free_law else {}
    again = library.search_from(selection, beside, free_law.model_without_law) if free_law and beside else None
    if again:  # effects beside the free law gave a better start
        selection, contest = again, contest.against(again.best, library.rivals(again.state))
        free_law, contest = contest.outcome(selection.best)
    return replace(selection, free_law=free_law, near_law=None if free_law else contest.nearly(selection.best))


def measure_held_out_gap(data: SearchData, selection: Selection, progress: Progress) -> tuple[SearchData, GapFits]:
    """Measure the gap on the held-out clips, without clips that deviate from all others.

    Returns
    -------
    (SearchData, GapFits)

    Raises
    ------
    InputError
        The base model has no motion for the held-out clips.
    """
    gap = _measure_gap(data, selection, progress)
    outliers = find_outlier_clips(data.held_out, gap.before, gap.after)
    if not outliers:
        return data, gap
    kept = tuple(c for k, c in enumerate(data.held_out) if k not in outliers)
    notes = [replace(note, values=note.values | {"held_out": " (held out)"}) for note in outliers.values()]
    data = replace(data, held_out=kept, left_out=(*data.left_out, *notes))
    return data, _measure_gap(data, selection, progress)


def _measure_gap(data: SearchData, selection: Selection, progress: Progress) -> GapFits:
    law, clips = selection.free_law, data.held_out
    fit_law = None if law is None else lambda before: fit_unseen_clips(law, clips, before, data.noise)
    show_gap = partial(progress, "gap")
    try:
        return measure_gap(clips, selection.base, selection.best, data.noise, show_gap, fit_law)
    except ValueError as e:
        raise InputError(f"the fitted base model has no motion for the held-out collisions: {e}") from None


def summarise(
    clips: Sequence[MeasuredCollision],
    data: SearchData,
    validated: ValidatedSelection,
    library: LibrarySearch,
    gap: GapFits,
    progress: Progress,
) -> SearchResult:
    """Stage 6: collect the data that the report needs.

    Parameters
    ----------
    clips : sequence of MeasuredCollision
        All clips, before outliers are removed.
    data : SearchData
    validated : ValidatedSelection
        The claims that passed.
    library : LibrarySearch
    gap : GapFits
        The gap with the selection before the validation.
    progress : callable

    Returns
    -------
    SearchResult
    """
    selection, law = validated.selection, validated.selection.free_law
    base, best = selection.base, selection.best
    if validated.rejected:
        gap = _measure_gap(data, selection, progress)
    with_table = tabulate_and_refit(law, lambda: progress("gap")) if law else None
    if with_table:
        gap = measure_gap(data.held_out, base, with_table, data.noise, lambda: progress("gap"))
    progress("where")
    before = find_disagreements(data.clips, base, data.noise)
    left = before
    nothing_tested = data.is_smoothed or selection.interrupted is not None
    if not (selection.is_empty or nothing_tested):
        left = find_disagreements(selection.explained_clips(data.clips), selection.joint_fit, data.noise)
    more = more_is_missing(left, validated.rejected)
    claims = validated.claims_without_errors() if more else validated.claims
    verdict = decide_verdict(claims, law is not None, left, validated.rejected)
    if nothing_tested:  # a search that was cut short, or of smoothed tracks, claims nothing
        missing = is_unexplained(before) or (selection.interrupted is not None and selection.promising)
        verdict = Verdict.INADEQUATE if missing else Verdict.NONE
    if with_table:
        found = with_table.model
    elif law:
        free = dict.fromkeys((*law.model_without_law.free, *filter(None, [law.law.frees])))
        found = replace(law.model_without_law, free=tuple(free))
    else:
        found = best.model
    return SearchResult(
        verdict=verdict,
        data=data,
        base_fit=base,
        best_fit=law.fit if law else best,
        model=found,
        claims=claims,
        free_law=law,
        law_summary=LawSummary.of(law) if law else None,
        model_holds_law=with_table is not None or bool(law and law.law.frees),
        gap_fits=gap,
        base_disagreements=before,
        disagreements=left,
        accepted=validated.accepted,
        rejected=validated.rejected,
        scores=selection.ranking,
        required_sigma=selection.required_sigma,
        undetectable=library.undetectable(selection.state),
        experiment=_advise_experiment(selection, claims, data) if verdict is Verdict.AMBIGUOUS else "",
        uniform=tuple(find_uniform_conditions(clips)),
        processed=(*([SearchNote(SearchNoteKind.SMOOTHED)] if data.is_smoothed else []), *detect_processing(clips)),
        interrupted=selection.interrupted,
        policy=current_policy(),
    )


def decide_verdict(
    claims: Sequence[EffectClaim], has_law: bool, left: Sequence[Disagreement], rejected: Sequence[ClaimTest]
) -> Verdict:
    """Decide the verdict from accepted claims, a free law, remaining disagreements, and rejected claims.

    Parameters
    ----------
    claims : sequence of EffectClaim
    has_law : bool
        True if a free law passed.
    left : sequence of Disagreement
        The disagreements that remain with all claims.
    rejected : sequence of ClaimTest
        A test below `unexplained_sigma` may be chance or a bad clip. It does not show that something is missing.

    Returns
    -------
    Verdict
    """
    if has_law or (claims and more_is_missing(left, rejected)):
        return Verdict.OUTSIDE_LIBRARY
    if not claims:
        missing = is_unexplained(left) or any(t.sigma > current_policy().unexplained_sigma for t in rejected)
        return Verdict.INADEQUATE if missing else Verdict.NONE
    return Verdict.AMBIGUOUS if any(len(c.aliases) > 1 for c in claims) else Verdict.NAMED


def _advise_experiment(selection: Selection, claims: Sequence[EffectClaim], data: SearchData) -> str:
    """Advise on an experiment that separates each claimed effect from its nearest alias."""
    base, best = selection.base, selection.best
    known = candidates_by_name(best.model, base.model, base.names)
    shapes = {c.effect: c.shapes for c in selection.ranking}
    sentences = []
    for claim in claims:
        for rival in claim.aliases[1:2]:
            one, other = known[claim.effect], known[rival]
            pair = (one, claim.shapes), (other, shapes.get(rival, {}))
            sentences.append(advise(one, other, compare_designs(data.clips, data.noise, best, *pair)))
    return " ".join(sentences)
