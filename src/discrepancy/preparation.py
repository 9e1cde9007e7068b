"""Prepare the collisions of a search: remove outliers, hold some clips out, and estimate the noise of the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from discrepancy.data.collisions import EvidenceUnit, MeasuredCollision
from discrepancy.data.notes import SearchNote, SearchNoteKind
from discrepancy.data.outlier_points import note_removed_points, remove_outliers
from discrepancy.data.stretches import cut_stretches
from discrepancy.data.study_design import split_held_out
from discrepancy.data.track_checks import covers_contact, remove_filtered_rows
from discrepancy.fitting.base_fit import fit_base_model, remove_outliers_beside_model
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.noise_refit import refit_noise
from discrepancy.fitting.stretch_moves import NO_SCATTER, StretchScatter, add_moves, find_moves
from discrepancy.fitting.stretch_scatter import add_scatter
from discrepancy.fitting.stretch_starts import choose_starts, fit_launches
from discrepancy.noise.error_trends import remove_frame_shift, rescale_errors
from discrepancy.noise.model import Noise, estimate_noise
from discrepancy.policy import current_policy
from discrepancy.select.scatter_beside_effects import fit_scatter_beside_effects, refit
from discrepancy.time_left import in_stage, report_progress
from synthcam.model import Model
from synthcam_shared.errors import InputError


@dataclass(frozen=True)
class SearchData:
    """The collisions of a search and their noise."""

    # the collisions to fit, and those to test on
    clips: tuple[MeasuredCollision, ...]
    held_out: tuple[MeasuredCollision, ...]
    noise: Noise
    left_out: tuple[SearchNote, ...]  # a note for each collision, or part of one, that is not used
    is_smoothed: bool = False  # true if the tracks were smoothed by a filter before the search
    error_notes: tuple[SearchNote, ...] = ()  # what the errors of the positions depend on
    scatter: StretchScatter = NO_SCATTER  # what differs from stretch to stretch, as part of the clips' covariance

    @property
    def is_cut(self) -> bool:
        """True if each clip is a free stretch of one ball."""
        return any(clip.is_stretch for clip in self.clips)

    @property
    def unit(self) -> EvidenceUnit:
        """What is fitted and held out."""
        return EvidenceUnit.STRETCH if self.is_cut else EvidenceUnit.COLLISION

    def without(self, outliers: Mapping[int, SearchNote]) -> SearchData:
        """Remove clips to fit, given by index, each with a note that says why."""
        clips = tuple(c for k, c in enumerate(self.clips) if k not in outliers)
        return replace(self, clips=clips, left_out=(*self.left_out, *outliers.values()))

    def with_scatter(self, scatter: StretchScatter, fit: ModelFit) -> SearchData:
        """Count this scatter from stretch to stretch as noise, with derivatives at a fit of the clips.

        All held-out clips get the accelerations of the median stretch. By its own residuals, a stretch that contradicts
        the claims of the fit would count less, and its chi^2 would not grow.
        """
        clips = add_scatter(self.clips, fit, scatter, self.noise)
        held_out = [replace(clip, scatter=None) for clip in self.held_out]
        if not scatter.is_none:
            try:
                launches = fit_launches(self.held_out, fit.model, self.noise).launches
            except ValueError:  # the model has no motion for one of them
                launches = np.array([clip.launch for clip in self.held_out])
            held_out = add_moves(self.held_out, find_moves(self.held_out, fit.model, launches), scatter.without_tails())
        return replace(self, clips=tuple(clips), held_out=tuple(held_out), scatter=scatter)


@in_stage("noise")
def prepare_data(clips: Sequence[MeasuredCollision], model: Model, stretches: bool = False) -> SearchData:
    """Remove outliers, hold some clips out, and estimate the noise of the others.

    stretches: cut each clip into its free stretches after some clips are held out, so that these share none.

    The noise is estimated from the smooth parts of the tracks, and again from the residuals of the base model. That
    comes before any claim, because a claim could absorb underestimated noise. If the tracks were smoothed, the stage
    removes the parts that the filter has moved instead.
    """
    report_progress()
    cleaned = remove_outliers(clips)
    fitted, held_out = split_held_out(cleaned)
    if not stretches and estimate_noise(fitted).is_smoothed:
        return _prepare_smoothed(cleaned, note_removed_points(clips, cleaned))
    odd = list[SearchNote]()
    every, error_notes = remove_frame_shift([*fitted, *held_out], fitted)
    fitted, held_out = every[: len(fitted)], every[len(fitted) :]
    if stretches:
        fitted, held_out = cut_stretches(fitted), cut_stretches(held_out)
        if not (fitted and held_out):
            raise InputError("no clip has free stretches that are long enough, before or after a contact")
        (fitted, odd), (held_out, odd_too) = choose_starts(fitted, model), choose_starts(held_out, model)
        odd += odd_too
    fitted, held_out = remove_outliers_beside_model(fitted, held_out, model)
    noise = estimate_noise(fitted)
    every, trends = rescale_errors([*fitted, *held_out], fitted, noise)
    if trends:
        fitted, held_out = every[: len(fitted)], every[len(fitted) :]
        noise, error_notes = estimate_noise(fitted), [*error_notes, *trends]
    base = fit_base_model(fitted, model, noise)
    scatter, beside = fit_scatter_beside_effects(fitted, base, noise) if stretches else (NO_SCATTER, base)
    if scatter.is_none:
        noise = refit_noise(fitted, beside, noise, explained=False) or noise
    left_out = [*note_removed_points(clips, cleaned if stretches else [*fitted, *held_out]), *odd]
    data = SearchData(tuple(fitted), tuple(held_out), noise, tuple(left_out), error_notes=tuple(error_notes))
    if scatter.is_none:
        return data
    data = data.with_scatter(scatter, beside)
    if not scatter.freedom:
        return data
    # few stretches with large accelerations decided that fit; now they count less
    return data.with_scatter(scatter, refit(WhitenedClips.of(data.clips, noise), beside))


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
