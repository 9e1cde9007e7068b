"""The whole workflow: measured tracks and a model -> where they disagree, what is missing, the gap before and after."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.notes import Note, NoteKind
from discrepancy.data.outlier_points import note_removed_points, remove_outliers
from discrepancy.data.prior_processing import (
    covers_contact,
    detect_processing,
    remove_filtered_rows,
)
from discrepancy.data.study_design import find_uniform_conditions, split_held_out
from discrepancy.deadline import Deadline, OutOfTime
from discrepancy.fitting.base_fit import (
    Progress,
    check_clips,
    estimate_noise,
    fit_base_model,
    remove_outliers_beside_model,
)
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.noise_refit import refit_noise
from discrepancy.fitting.parameters import candidates_by_name
from discrepancy.found import InterruptedSearch, SearchData, SearchResult, more_missing
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.law_summary import LawSummary
from discrepancy.free_laws.tabulate import tabulate_and_refit
from discrepancy.planning.pair_advice import advise, compare_designs
from discrepancy.policy import current_policy
from discrepancy.select.effect_claim import EffectClaim
from discrepancy.select.fit_store import FitStore
from discrepancy.select.free_law_contest import FreeLawContest
from discrepancy.select.law_fit import fit_unseen_clips
from discrepancy.select.library_search import Selection, State, Stepwise
from discrepancy.validate.claim_tests import ValidatedSelection, Validation
from discrepancy.validate.gap import GapFits, measure_gap
from discrepancy.validate.held_out import ClaimTest
from discrepancy.validate.outlier_clips import outlier_clips
from discrepancy.validate.residual_map import Disagreement, locate, unexplained
from synthcam.model import Model
from synthcam_shared.errors import InputError

ROUNDS = 4  # searches, at most: again without clips that are unlike all others, again with the noise read anew


def find(
    clips: Sequence[MeasuredCollision], model: Model, progress: Progress = lambda stage: None, seconds: float = math.inf
) -> SearchResult:
    """Search for what `model` lacks. Its base parameters that are not zero and those in `model.free` are fitted.

    Noise, fit and selection are repeated until the noise and the clips stay; then what was selected is validated.

    Parameters
    ----------
    clips : sequence of Measured
    model : Model
    progress : callable
        Told the stage, many times.
    seconds : float
        How long the search may go on; then what it has come to is looked at, and if it has not ended nothing is named.

    Returns
    -------
    SearchResult

    Raises
    ------
    InputError
        As `check_clips` does.
    """
    clips = check_clips(clips, model)
    deadline = Deadline(progress, seconds)
    data = read(clips, model, progress)
    data, steps, chosen = unselected(data, model, deadline) if data.smoothed else converged(data, model, deadline)
    progress("gap")
    if data.smoothed or chosen.so_far is not None:
        return _unnamed(clips, data, steps, chosen, progress)
    data, shown = seen_apart(data, chosen, progress)
    stands = validated(data, steps, chosen, shown, progress)
    if stands.withdrawn:
        chosen = dataclasses.replace(chosen, selected=stands.selected, free_law=stands.free_law)
        shown = gap_of(data, chosen, progress)
    held = tabulate_and_refit(chosen.free_law, lambda: progress("gap")) if chosen.free_law else None
    if held:
        shown = _gap(data, chosen.selected.base, held, progress)
    progress("where")
    where = locate(data.clips, chosen.selected.base, data.noise)
    left = locate(chosen.cleaned(data), chosen.best, data.noise) if chosen.anything else where
    named = stands.unsure() if more_missing(left, stands.withdrawn) else stands.named
    verdict = _verdict(chosen.free_law, named, left, stands.withdrawn)
    return SearchResult(
        verdict,
        data,
        chosen.selected,
        chosen.free_law,
        LawSummary.of(chosen.free_law) if chosen.free_law else None,
        named,
        where,
        left,
        shown,
        _experiment(chosen.selected, named, data) if verdict == "ambiguous" else "",
        tuple(map(str, find_uniform_conditions(clips))),
        steps.unidentifiable(chosen.selected.state),
        stands.claims,
        stands.withdrawn,
        held,
        tuple(map(str, detect_processing(clips))),
    )


@dataclass(frozen=True)
class Chosen:
    """What one selection came to. nearly: a free law that explains nearly as much as the library's best model.

    so_far: what it had tried when the time was over; nothing is then selected.
    """

    selected: Selection
    free_law: FittedLaw | None
    nearly: FittedLaw | None
    so_far: InterruptedSearch | None = None

    @property
    def anything(self) -> bool:
        """Whether anything was found beside the base model."""
        return bool(self.selected.state or self.free_law)

    @property
    def best(self) -> ModelFit:
        """The fit with everything that was found."""
        return self.free_law.joint_fit if self.free_law else self.selected.best

    def cleaned(self, data: SearchData) -> tuple[MeasuredCollision, ...]:
        """The clips with what a free law moves taken out of them, where no effect can hold it."""
        return self.free_law.evidence.clips if self.free_law else data.clips


def read(clips: Sequence[MeasuredCollision], model: Model, progress: Progress) -> SearchData:
    """The clips without outlier points, some kept out, and the noise of the others."""
    progress("noise")
    usual = remove_outliers(clips)
    some, kept_out = split_held_out(usual)
    if estimate_noise(some).is_smoothed:
        return _beyond_reach(usual, [str(n) for n in note_removed_points(clips, usual)])
    some, kept_out = remove_outliers_beside_model(some, kept_out, model, progress)
    noise = estimate_noise(some)
    # read without any claim first: one made with too little noise could explain the rest of the noise away
    noise = refit_noise(some, fit_base_model(some, model, noise, progress), noise, explained=False) or noise
    return SearchData(
        tuple(some), tuple(kept_out), noise, tuple(map(str, note_removed_points(clips, [*some, *kept_out])))
    )


def _beyond_reach(smoothed: Sequence[MeasuredCollision], outliers: Sequence[str]) -> SearchData:
    """Of tracks that somebody has smoothed: what the filter has not moved, of clips of which enough is left."""
    clips = [remove_filtered_rows(clip) for clip in smoothed]
    kept = [clip for clip in clips if covers_contact(clip)]
    if len(kept) < current_policy().min_collisions:
        raise InputError(
            f"{Note(NoteKind.SMOOTHED)}: {len(kept)} of {len(clips)} collisions keep enough positions that "
            f"the filter does not move; expected {current_policy().min_collisions} or more"
        )
    lost = tuple(str(Note(NoteKind.LOST_TO_FILTER, clip.clip)) for clip in clips if not covers_contact(clip))
    some, kept_out = split_held_out(kept)
    return SearchData(tuple(some), tuple(kept_out), estimate_noise(some), (*outliers, *lost), smoothed=True)


def unselected(data: SearchData, model: Model, deadline: Deadline) -> tuple[SearchData, Stepwise, Chosen]:
    """The base model's fit alone: of such tracks nothing is named."""
    base = fit_base_model(data.clips, model, data.noise, deadline)
    steps = Stepwise.of(FitStore(WhitenedClips.of(data.clips, data.noise), base, lambda: deadline("search")))
    return data, steps, Chosen(steps.selection(()), None, None)


def converged(data: SearchData, model: Model, deadline: Deadline) -> tuple[SearchData, Stepwise, Chosen]:
    """The selection, made again without clips that are unlike all others, and again with the noise read anew.

    With the way there, which validation goes further along.
    """
    gone = 0
    for turn in range(ROUNDS):
        steps, chosen = select(data, model, deadline)
        if turn == ROUNDS - 1 or chosen.so_far is not None:
            break
        cleaned = chosen.cleaned(data)
        outliers = outlier_clips(cleaned, chosen.selected.base, chosen.best, gone)
        if outliers:
            gone += len(outliers)
            data = data.without(outliers)
            continue
        noise = refit_noise(cleaned, chosen.best, data.noise)
        if noise is None and chosen.nearly:  # the library's model may lack what the free law has, and call it noise
            noise = refit_noise(chosen.nearly.evidence.clips, chosen.nearly.joint_fit, data.noise)
        if noise is None:
            break
        data = dataclasses.replace(data, noise=noise)
    return data, steps, chosen


def select(data: SearchData, model: Model, deadline: Deadline) -> tuple[Stepwise, Chosen]:
    """What the library names, and the free law that explains more, if one does."""
    evidence, base = WhitenedClips.of(data.clips, data.noise), fit_base_model(data.clips, model, data.noise, deadline)
    store = FitStore(evidence, base, lambda: deadline("search"))
    steps = Stepwise.of(store)
    try:
        with deadline.limited():
            return steps, _chosen(steps, FreeLawContest.of(evidence, base, lambda: deadline("free laws")))
    except OutOfTime:
        best = min(store.fits, key=store.cost_of)
        tried = InterruptedSearch(
            tuple(sorted(c.name for c in best)), store.fits[best].chi2 / base.points, deadline.seconds
        )
        return steps, Chosen(steps.selection(()), None, None, tried)


def _chosen(steps: Stepwise, contest: FreeLawContest) -> Chosen:
    store, state = steps.store, State()
    for state in steps.states():
        contest = contest.against(store.settled(state), store.rivals(state))
        if contest.ended:
            break
    selected = steps.selection(state)
    free_law, contest = contest.outcome(selected.best)
    beside = free_law.significances_of_effects(store.base) if free_law else {}
    again = steps.from_there(selected, beside, free_law.model_without_law) if free_law and beside else None
    if again:  # the free law led to effects that the library's search has not begun with
        selected, contest = again, contest.against(again.best, store.rivals(again.state))
        free_law, contest = contest.outcome(selected.best)
    return Chosen(selected, free_law, None if free_law else contest.nearly(selected.best))


def _unnamed(
    clips: Sequence[MeasuredCollision], data: SearchData, steps: Stepwise, chosen: Chosen, progress: Progress
) -> SearchResult:
    """Nothing is claimed by a search that was cut short: what it has tried was held to no other collisions.

    Nor of tracks that a filter has smoothed.
    """
    data, shown = seen_apart(data, chosen, progress)
    progress("where")
    where = tuple(locate(data.clips, chosen.selected.base, data.noise))
    alike = tuple(map(str, find_uniform_conditions(clips)))
    missing = unexplained(where) or (chosen.so_far is not None and chosen.selected.promising)
    processed = [*([Note(NoteKind.SMOOTHED)] if data.smoothed else []), *detect_processing(clips)]
    return SearchResult(
        "inadequate" if missing else "none", data, chosen.selected, None, None, (), where, where, shown, "",
        alike, steps.unidentifiable(()), processed=tuple(map(str, processed)),
        so_far=chosen.so_far,
    )  # fmt: skip


def seen_apart(data: SearchData, chosen: Chosen, progress: Progress) -> tuple[SearchData, GapFits]:
    """The gap on the clips kept out, without those of them that are unlike all others."""
    shown = gap_of(data, chosen, progress)
    outliers = outlier_clips(data.kept_out, shown.before, shown.after)
    if not outliers:
        return data, shown
    kept = tuple(c for k, c in enumerate(data.kept_out) if k not in outliers)
    lines = tuple(f"{line} (kept out)" for line in outliers.values())
    data = dataclasses.replace(data, kept_out=kept, left_out=(*data.left_out, *lines))
    return data, gap_of(data, chosen, progress)


def gap_of(data: SearchData, chosen: Chosen, progress: Progress) -> GapFits:
    """The gap on the clips kept out. Raises InputError where the base model has no motion for them."""
    clips, law = data.kept_out, chosen.free_law
    outside = None if law is None else lambda before: fit_unseen_clips(law, clips, before, data.noise)
    return _gap(data, chosen.selected.base, chosen.selected.best, progress, outside)


def _gap(
    data: SearchData,
    base: ModelFit,
    best: ModelFit,
    progress: Progress,
    outside: Callable[[ModelFit], ModelFit] | None = None,
) -> GapFits:
    try:
        return measure_gap(data.kept_out, base, best, data.noise, lambda: progress("gap"), outside)
    except ValueError as e:
        raise InputError(f"the fitted base model has no motion for the collisions kept out: {e}") from None


def validated(
    data: SearchData, steps: Stepwise, chosen: Chosen, shown: GapFits, progress: Progress
) -> ValidatedSelection:
    """What stands of a selection before collisions that had no part in it."""
    evidence = WhitenedClips.of(data.clips, data.noise)
    held_to = Validation(steps, evidence, data.kept_out, shown.before, data.noise, lambda: progress("gap"))
    return held_to.standing(chosen.selected, chosen.free_law)


def _verdict(
    free_law: FittedLaw | None,
    named: Sequence[EffectClaim],
    left: Sequence[Disagreement],
    withdrawn: Sequence[ClaimTest],
) -> str:
    if free_law or (named and more_missing(left, withdrawn)):
        return "outside_library"
    if not named:
        # what chance or a bad clip may do is no claim, and no sign that something is missing
        return (
            "inadequate"
            if unexplained(left) or any(c.own > current_policy().unexplained_sigma for c in withdrawn)
            else "none"
        )
    return "ambiguous" if any(len(n.aliases) > 1 for n in named) else "named"


def _experiment(selected: Selection, named: Sequence[EffectClaim], data: SearchData) -> str:
    """What would part each class's effect from its nearest alias."""
    base, best = selected.base, selected.best
    known = candidates_by_name(best.model, base.model, base.names)
    shapes = {c.effect: c.shapes for c in selected.ranking}
    said = []
    for n in named:
        for rival in n.aliases[1:2]:
            one, other = known[n.effect], known[rival]
            pair = (one, n.shapes), (other, shapes.get(rival, {}))
            said.append(advise(one, other, compare_designs(data.clips, data.noise, best, *pair)))
    return " ".join(said)
