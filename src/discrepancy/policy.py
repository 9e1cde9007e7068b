"""The thresholds by which a search claims, rejects, estimates noise and leaves out clips, as one `SearchPolicy`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError

from synthcam_shared.settings import Positive, Settings, read_yaml, to_input_error

Share = Annotated[float, Field(gt=0, le=1)]
Count = Annotated[int, Field(ge=1)]


class SearchPolicy(Settings):
    """The thresholds of a search. `discrepancy.find(..., policy=SearchPolicy(significance_level=1e-4))` changes one.

    `discrepancy find --policy policy.yaml` reads the same fields from a file. Each field says where its value comes
    from: derived, a convention, chosen between cases on either side, or chosen.

    Notes
    -----
    Each value was halved and doubled (a cosine: its distance from 1) on four boxes of the eighth blind round. The boxes
    held nothing, an effect at its detection limit, and two laws of no library. No verdict changed except where the
    field says so. `benchmarks/search/sensitivity.py` repeats this on more boxes. `tests/discrepancy/test_policy.py` has
    a case on either side of most values.

    Numerical tolerances, grids, limits on memory and the priors of free laws are not here. They are local to the
    function that uses them.

    Examples
    --------
    >>> from discrepancy import SearchPolicy
    >>> SearchPolicy(significance_level=1e-4).changed()
    {'significance_level': 0.0001}
    """

    def changed(self) -> dict[str, float]:
        """The fields that differ from their defaults.

        Returns
        -------
        dict of str to float
        """
        return {name: value for name, value in self if value != type(self).model_fields[name].default}

    # --- What a claim needs ---

    significance_level: Share = 1e-3
    """Share of searches with nothing hidden that may claim something. It sets the required sigma, from the candidates'
    Gram matrix. A false-alarm target (docs/decisions/0009); blind rounds allow 2 in 300 (docs/blind.md)."""

    min_claim_sigma: Positive = 4.0
    """Least sigma of a claim, however few the candidates, because the noise itself is only estimated.
    A floor: the level of one in a thousand for the first, smaller library. Doubled, the search no longer names a true
    effect at its limit; it then reports it as outside the library."""

    max_effects: Count = 4
    """Most effects that one search names. More together can imitate a law of no library. Chosen; not derived."""

    max_shapes_tried: Count = 30
    """Values of the shape parameters of one effect at which strengths of a realistic size are tried. If there are more,
    those with the best score are. Derived: 30 hold all values of every effect of the motion with one strength."""

    max_linear_shapes_tried: Count = 5
    """The same for an effect that changes what the camera shows and not the motion, as a lost frame, which has 499
    values, or a lamp elsewhere, which has 27. It moves the tracks in proportion to its strength, so the score ranks its
    values rightly. Chosen; not derived."""

    unexplained_sigma: Positive = 5.0
    """Sigma beyond which a remaining disagreement, or a rejected claim, shows that something more is missing.
    Corrected for the trials: chance exceeds it once in two million. A convention (5 sigma)."""

    min_clips_for_trend: Count = 6
    """Clips that must show a residual before it is tested against speed, heading, position or impact parameter.
    Chosen; not derived."""

    max_disagreement_to_residual: Positive = 3.0
    """Largest ratio of a disagreement to the residuals for which a size is reported: launches absorb most of it.
    Chosen; not derived. Effects of the library have 1.3; models that are wrong throughout have 4 (pucks on air) and
    10 to 50 and more (real billiard balls)."""

    poor_chi2_per_dof: Positive = 2.0
    """chi^2 per degree of freedom, with an effect added by hand, above which more is missing.
    Chosen; not derived: twice what noise leaves."""

    # --- The cost of freedom ---

    choice_cost: Positive = 2.0
    """chi^2 per ln n: the cost of one choice among n equally likely effects, free laws or parts of one.
    Derived: -2 ln of a probability 1 / n."""

    rival_excluded_chi2: Positive = 9.5
    """chi^2, costs included, by which a rival must be worse to be excluded. Among closer models the search names the
    simplest and lists the others as its aliases. A rival replaces a named effect only if it is better by as much.
    Chosen; not derived: odds of 116 to 1."""

    effect_preferred_chi2: Positive = 5.0
    """chi^2, costs included, by which a free law must beat a library that explains everything: a known effect is more
    likely in advance. Chosen between 9.5 and 5.5 on blind rounds, where a law of no library fell short."""

    # --- Free laws ---

    free_law_sigma: Positive = 4.5
    """Sigma that a free law needs, and that an effect needs beside one. Chosen; not derived. It is corrected for the
    trials within one law: chance exceeds it, over 29 laws, in two of 10,000 searches. Doubled, the search no longer
    finds two laws of no library."""

    max_effects_beside_free_law: Count = 2
    """Most effects that are claimed beside a free law after it was found. Chosen; not derived."""

    beside_free_law_sigma: Positive = 20.0
    """Sigma that an effect needs beside a free law, beside a rejected one, or if the model still leaves something
    unexplained. A weaker effect may be part of an unknown law. Chosen between, on sealed boxes. True effects beside a
    free law had 27, 29 and 30 sigma. False ones, which imitated a second unknown law, had 11, 16, 17 and 18."""

    near_free_law_chi2: Positive = 10.0
    """chi^2, costs included, within which a free law may still overtake the library's model once the noise is better
    known. The noise is then estimated with that law. Chosen; not derived: twice `effect_preferred_chi2`."""

    formula_rejected_sigma: Positive = 4.0
    """Sigma at which the data distinguish a formula from the free curve and so reject it. As `min_claim_sigma`."""

    formula_tolerated_share: Share = 0.01
    """Share of the curve's chi^2 that a formula may lack without being rejected. Chosen; not derived."""

    # --- Held-out collisions ---

    hold_out_one_in: Count = 4
    """One collision in so many is held out of every fit, evenly over the speeds. Chosen; not derived: held-out
    collisions then see a claim at the detection limit at 2.5 sigma."""

    min_clips_to_hold_out_extremes: Count = 8
    """Collisions from which on the fastest and the most oblique are held out. Chosen; not derived: two of the
    collisions can then be held out."""

    max_shortfall_sigma: Positive = 2.0
    """Sigma by which held-out collisions that a claim predicts worse may fall short of what the claim promised.
    Derived: it rejects one true claim in 40 at the detection limit, and no strong one."""

    leave_one_out_sigma: Positive = 3.0
    """Sigma that a claim needs when each collision is left out once. If the model lacks more, or the search uses free
    stretches, its strengths must also differ from zero by as many sigma of their scatter between clips. A convention (3
    sigma)."""

    poor_chi2_per_point: Positive = 2.0
    """chi^2 per point above which a model does not describe the collisions, so that sigma says little.
    Chosen; not derived: real billiard hits had 50 and 3. In sealed boxes a true claim leaves 1.2 at most."""

    noise_chi2_per_point: Positive = 1.1
    """chi^2 per point up to which a free law leaves only noise, so that no search begins again from other effects.
    Chosen; not derived: a law that was hidden leaves 0.97, the nearest law in place of a lens a sixth of its excess."""

    min_closed_share: Share = 0.1
    """Share of the excess of chi^2 per point over one that a claim must then close.
    Chosen; not derived: a claim of 53 sigma closed 0.4 and 2 % of real billiard hits."""

    min_closed_share_of_weak_claim: Share = 0.5
    """The same for a claim of fewer sigma, by its scatter between collisions, than `beside_free_law_sigma`.
    Derived: the claim then explains more than it leaves."""

    max_strength_variation: Positive = 0.2
    """Share of a claim's sigma by which its strength may vary with position, heading, speed or clip, if that is more
    than `unexplained_sigma`. A strength that varies more belongs to another law. Chosen; not derived. In sealed boxes
    true claims of 9 to 28 sigma varied by 2.7 sigma at most. Friction that rises on half a plate, claimed as stribeck
    at 17 sigma, varied by 6.4."""

    min_gap_sigma: Positive = 3.0
    """Standard deviations of chi^2 per point that a gap must have before a share of it is reported as closed.
    A convention (3 sigma)."""

    # --- What these collisions cannot distinguish ---

    detection_limit_sigma: Positive = 5.0
    """Expected sigma of a strength at its detection limit. A convention: a search that asks 4.2 sees 79 in 100."""

    max_detection_limit: Positive = 10.0
    """Realistic sizes: an effect with a larger detection limit is undetectable. It is considered only where nothing
    else is significant. Chosen; not derived."""

    alias_cosine: Share = 0.9
    """Cosine of two signatures above which they are reported as similar, and rivals of the leader are fitted in full.
    Chosen; not derived: the naming limit is there 2.3 times the detection limit."""

    pair_alias_cosine: Share = 0.98
    """The same for the span of two other effects, which nearly always fits better than one.
    Chosen; not derived: the naming limit is there 5 times the detection limit."""

    separated_cosine: Share = 0.9
    """Cosine below which a proposed experiment separates two effects. As `alias_cosine`."""

    min_cosine_gain: Share = 0.02
    """Decrease of that cosine that all changes of an experiment together need over the best single one.
    Chosen; not derived."""

    same_speed_ratio: Positive = 1.2
    """Ratio of the largest to the least speed below which all clips count as equally fast. Chosen; not derived."""

    same_heading_deg: Positive = 30.0
    """Degrees from the mean heading within which all clips count as going one way. Chosen; not derived."""

    same_impact_parameter: Positive = 0.05
    """Span of the impact parameters below which all clips count as equally oblique. Chosen; not derived."""

    # --- The estimate of the noise ---

    min_stretch_positions: Count = 12
    """Positions of a stretch from which the noise is estimated; beside a cubic of 4 numbers a shorter one says little.
    Chosen; not derived."""

    min_short_stretch_positions: Count = 8
    """The same where no stretch is so long. Chosen; not derived: twice the cubic's numbers."""

    max_frame_gap: Count = 5
    """Frames from one position to the next within a stretch. Chosen; not derived: trackers lose a ball for a few."""

    event_margin_frames: Count = 2
    """Frames at either end of a phase that the noise estimate skips, since they may hold a misplaced event.
    Chosen; not derived."""

    max_clip_noise_power: Positive = 9.0
    """Ratio to the median clip's noise power above which a clip does not enter the noise estimate: it would outweigh
    all others. Chosen; not derived: 3 times the rms."""

    shared_noise_sigma: Positive = 4.0
    """Sigma against independence above which both balls are taken to share noise. Chosen; not derived. As
    `min_claim_sigma`, so that no search of a steady camera finds shared noise by chance."""

    max_shared_noise_growth: Positive = 3.0
    """Largest ratio of the noise shared over whole clips to that shared within phases; a larger one may be a force.
    Chosen between, on opened boxes: 1.5 at most where a camera shook, 7 where a table leant."""

    max_noise_growth: Positive = 5.0
    """Largest ratio of a ball's own noise over whole phases to that within pieces of 8 positions. A larger ratio is
    motion that no cubic follows. Chosen between, on drawn and real tracks. Noise correlated by up to 0.99 between
    frames gave at most 3. Slides that end 0.02 to 0.1 s early gave 9 and more, real pucks 20, real billiard balls 100.
    A drift of ten times the white noise beside it (5 to 8) counts as motion."""

    min_cubic_residual_ratio: Positive = 1.4
    """Ratio of the residuals of cubics over whole phases to the noise of the pieces. Motion must exceed this ratio too,
    because the scale of a noise with a correlation near one says little. Chosen between: 1.04 where a camera shook, 1.7
    and 1.8 for real balls and pucks. Not enough by itself: drawn drifts leave up to 1.7 over phases of 80 positions."""

    max_piece_noise_power: Positive = 3.0
    """Ratio to the median piece's noise power above which a piece of 8 positions holds an event.
    Chosen: white noise exceeds it in 1 piece of 200."""

    min_noise_gain: Positive = 9.0
    """-2 log likelihood that another noise must gain before everything is fitted again.
    Derived: 3 sigma of one number."""

    noise_excluded_by: Positive = 20.0
    """-2 log likelihood within the phases of motion by which they exclude a noise estimated over whole clips.
    Derived: one chance in a thousand for five numbers, the most that such a noise has."""

    frame_shift_sigma: Positive = 5.0
    """Sigma beyond which a shift of every second frame is removed. A convention (5 sigma)."""

    noise_trend_sigma: Positive = 5.0
    """Sigma beyond which the size of the noise counts as dependent on speed, position, ball or frame parity.
    A convention (5 sigma)."""

    min_noise_trend: Positive = 1.2
    """Factor by which the noise must change for that. Chosen; not derived: a smaller one changes sigma by less than the
    level of a search is uncertain."""

    smoothed_partial_correlation: Annotated[float, Field(gt=-1, lt=0)] = -0.12
    """Partial correlation of noise two positions apart below which tracks count as smoothed: a filter's window ends,
    as no noise does. Moving means, Gaussians and Savitzky-Golay filters give -1 to -0.17 on drawn tracks, unfiltered
    tracks none. Chosen between, on boxes of one secret; confirmed on hostile boxes of another."""

    smoothing_reach_frames: Count = 5
    """Frames on either side of a contact, a gap or an end that a search of smoothed tracks skips.
    Derived: half of a window of 11, the widest that is usual."""

    # --- Single positions that are left out ---

    outlier_position_sigma: Positive = 8.0
    """Sigma from a smooth path through its neighbours beyond which a position is an outlier, in units of the typical
    such number. Chosen; not derived: noise exceeds it in one Gaussian number of 10^15."""

    max_neighbour_rms: Positive = 2.0
    """Largest rms of the neighbours about that path, in the same units: a jump is no single position.
    Chosen; not derived."""

    max_model_error_sigma: Positive = 10.0
    """Largest median residual of a model, in claimed standard deviations, beside which outliers are sought.
    Chosen; not derived."""

    same_frame_clips: Count = 3
    """Clips with an outlier in the same frame from which on a clock is to blame, so none is an outlier.
    Chosen; not derived."""

    contact_error_frames: Positive = 0.25
    """Frames by which the first guess of the contact may be wrong; positions so close count as in an event.
    Chosen; not derived."""

    stray_jump_diameters: Positive = 0.8
    """Diameters that a ball must jump in a frame, and be off its path, for positions to count as another ball's. Two
    balls are at least a diameter apart. Chosen; not derived."""

    max_stray_positions: Count = 12
    """Most positions of another ball in a row. Chosen; not derived: a longer run is a track of its own."""

    max_straightness_diameters: Positive = 0.2
    """Diameters by which a ball may be off a straight line through the positions before and after those.
    Chosen; not derived: a ball that is hit in between is off by more."""

    # --- Whole clips that are left out ---

    outlier_clip_spreads: Positive = 8.0
    """Spreads of the logarithm of the clips' chi^2 that make one an outlier under every model. Chosen; not derived: a
    missing effect makes clips worse by factors and must not be taken out with the worst."""

    outlier_clip_sigma: Positive = 5.0
    """Sigma between the shared parameters of one clip and those of all others. A convention (5 sigma)."""

    outlier_clips_one_in: Count = 10
    """One clip in so many may be left out; if more are outliers, the model is wrong. Chosen; not derived."""

    # --- What is refused or doubted before any fit ---

    min_collisions: Count = 6
    """Least number of collisions: with fewer none would remain to show the gap. Chosen; not derived."""

    min_frames_before_contact: Count = 3
    """Frames that must show each ball before the contact. Chosen: a straight path and one more."""

    min_frames_after_hit: Count = 10
    """Frames that must show both balls after a hit that the tracks start at. Chosen: twice the numbers of two joined
    parabolas."""

    max_unseen_frames_after_hit: Positive = 5.0
    """Most frames between such a hit and the first one that shows both balls. Chosen; not derived."""

    slow_noise_ratio: Positive = 3.0
    """Ratio of the noise over whole phases to the part that is independent from frame to frame. Above it the report
    warns that the noise may be missing physics. Chosen; not derived: real billiard tracks had 2.8 mm beside 0.2 to 0.5
    mm."""

    max_uneven_frames: Positive = 0.1
    """Frames by which a clip's times may deviate from an even rate before its positions are moved to even times.
    Smaller deviations may be rounding. Chosen; not derived: a ball that covers half its diameter in a frame moves by
    5 % of a diameter in 0.1 frames."""

    max_time_shift_frames: Positive = 0.5
    """Most frames by which a position is moved to its even time; beyond, it is nearer to another frame's. Chosen."""

    max_grid_step_to_error: Positive = 0.5
    """Step of a grid, in claimed errors, above which the report says that positions are rounded.
    Chosen; not derived."""

    sliding_deceleration_m_s2: Positive = 0.3
    """m/s^2 by which a striker must slow down before the contact to count as sliding, where its clip is a misfit.
    Chosen; not derived: rolling takes 0.1, sliding with a friction of 0.05 takes 0.5."""

    spin_p_value: Share = 1e-6
    """p-value of the tracker's two fits of a misfit clip above which the search still accepts the striker's spin. The
    errors are scaled to the residuals of the free fit. Chosen between: 1e-4 and more in 25 clips with errors claimed a
    quarter too small, below 1e-50 where the spin was wrong."""

    spinning_strikers_share: Share = 0.5
    """Share of strikers that spin about the vertical above which every striker is fitted with a spin. Clips that are
    misfits, as a missing effect makes them, do not count. Chosen; not derived."""

    max_launch_speed_m_s: Positive = 20.0
    """m/s of the median clip above which scale or frame rate must be wrong. Chosen; not derived."""

    max_diameter_mismatch: Positive = 1e-3
    """Relative difference of the ball's diameter in camera.json and in the model that is refused: the fit would take
    it for an effect. Chosen; not derived."""

    max_unit_mismatch: Positive = 0.3
    """Natural logarithm of the ratio of the least distance of two balls to a diameter, within which a unit other than
    px is suggested. Chosen; not derived."""

    min_distance_diameters: Positive = 0.8
    """Diameters below which the least distance of two balls, over the clips, cannot be in px: balls would overlap.
    Geometry gives 1, less the errors of the positions. Chosen. Doubled, all tracks are refused, as they must be."""

    max_distance_diameters: Positive = 30.0
    """Diameters above which balls that never come nearer are measured in another unit. Chosen; not derived."""

    max_picture_sizes: Positive = 2.0
    """Sizes of the picture beyond which no track in px reaches. Chosen; not derived."""

    max_exchange_frames: Count = 3
    """Most frames between two sightings of both balls that can show an exchange of their names.
    Chosen; not derived."""


_default = SearchPolicy()
_current: ContextVar[SearchPolicy] = ContextVar("search_policy", default=_default)


def current_policy() -> SearchPolicy:
    """The policy of the search that is running; the default policy outside one."""
    return _current.get()


@contextmanager
def applied_policy(policy: SearchPolicy) -> Iterator[None]:
    """Within this context `current_policy` is `policy`, as `decimal.localcontext` sets the precision of arithmetic.

    Some sixty functions of a search need one or two fields each. So the policy is part of the context and not an
    argument of each call. It applies to this thread only and ends with the block.
    """
    before = _current.set(policy)
    try:
        yield
    finally:
        _current.reset(before)


def read_policy(path: Path) -> SearchPolicy:
    """Read a YAML file with fields of `SearchPolicy`; fields that it leaves out keep their defaults.

    Raises
    ------
    InputError
        One line: an unknown key, a wrong type, or a value out of range.
    """
    try:
        return SearchPolicy.model_validate(read_yaml(path))
    except ValidationError as error:
        raise to_input_error(error, str(path), SearchPolicy) from None
