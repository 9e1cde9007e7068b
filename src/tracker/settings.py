"""The settings of the tracker that a user may change: how balls are detected, linked into tracks and measured."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from pydantic import Field

from synthcam_shared.settings import Fraction, NotNegative, Positive, Settings, build_settings, read_settings

Count = Annotated[int, Field(ge=1)]

USUAL_SPEED_M_S = 1.0
"""Greatest speed of a ball in its first frame, unless a film shows faster ones."""
USUAL_STEP_PX = 30.0
"""The same in px per frame, where no camera file gives a scale."""


class DetectionSettings(Settings):
    """How balls are found in frames. Detectors read these as ``view.settings.detection``.

    Examples
    --------
    >>> import tracker
    >>> tracker.DetectionSettings(glint_sigma=4.5).glint_sigma
    4.5
    """

    candidate_sigma: Positive = 6.5
    """How far a sum of pixels must exceed the plate to be a candidate, in standard deviations of its noise.
    At 6.5, noise makes about one false candidate in 10^10 pixels."""

    glint_sigma: Positive = 5.0
    """Least flux of a fitted glint, in its standard errors. Five is the usual threshold of a detection."""

    max_candidates_per_frame: Count | None = None
    """Most candidates of a frame, the brightest first. Default: 64 for maximum likelihood; 512 for linear fits
    and centroids, some two hundred steel balls with their secondary glints."""

    block_windows: Count = 1024
    """How many windows maximum likelihood fits at once. 1024 are 512 frames with two balls, some 100 MB of memory."""

    blur_sigma: Positive = 5.0
    """Significance of a difference between the motion blur and the camera file's exposure, in standard errors, above
    which the exposure is taken from the blur. Five, because a wrong exposure shifts every moving ball."""

    min_blur_change: Fraction = 0.05
    """The least such difference, relative to the exposure. Below 5 % it shifts positions by less than their errors."""

    disc_contrast_counts: Positive = 8.0
    """Least difference between a ball seen whole and the background, counts. Encoders leave up to about 5."""

    disc_contrast_sigma: Positive = 6.0
    """The same in standard deviations of the noise of a mean over 3 x 3 pixels. The larger of the two holds."""

    min_disc_radius_px: Positive = 3.0
    """Least radius of a ball seen whole, px. A smaller outline has too few pixels for its centre to be fitted."""

    disc_radius_tolerance: Fraction = 0.25
    """How far a ball's radius may be from that of the others, relative to it. What differs more is no ball."""

    max_objects_per_frame: Count = 40
    """Most objects in a frame that are looked at for balls, the largest first."""


class LinkSettings(Settings):
    """How the detections of successive frames are joined into tracks.

    Examples
    --------
    >>> import tracker
    >>> tracker.LinkSettings(max_gap_frames=8).max_gap_frames
    8
    """

    max_gap_frames: Annotated[int, Field(ge=0)] = 5
    """Frames for which a ball may stay undetected. Longer gaps make wrong links likely."""

    min_track_frames: Count = 3
    """Frames from which a track is a ball's whatever its brightness. Shorter tracks need the brightness of the others;
    of balls seen whole they are dropped."""

    min_relative_flux: Fraction = 0.25
    """Least brightness of a track over that of the brightest. Balls are of one kind and under one lamp."""

    speed_tolerance: Positive = 0.35
    """How far a glint may be from its predicted position, as a share of the distance moved in a frame.
    Friction and small hits change a velocity by less in one frame, and the prediction itself counts hits."""

    max_step_diameters: Positive = 5.0
    """How far a ball that is seen whole may move in its first frame, in diameters. Outlines are rarely false."""

    restitution: Fraction = 0.9
    """Coefficient of restitution with which two balls that meet are predicted to bounce. It only sets where they are
    searched for; the measurement does not use it. Steel balls have 0.85 to 0.95."""

    max_speed_m_s: Positive | None = None
    """Greatest speed of a ball in its first frame, m/s. Default: 1 m/s, or what a film with faster balls shows.
    Laboratory collisions have 0.1 to 0.7 m/s."""

    max_step_px: Positive | None = None
    """The same in px per frame where no camera file gives a scale; its default is 30 px, or what the film shows. At
    least two diameters are always allowed."""


class FitSettings(Settings):
    """How tracks are fitted, and what of a fit is believed.

    Examples
    --------
    >>> import tracker
    >>> tracker.FitSettings(outlier_sigma=5.0).outlier_sigma
    5.0
    """

    rejection_level: Annotated[float, Field(gt=0, lt=0.5)] = 1e-6
    """p-value below which the data reject a fit. The model describes one clip in a million so badly by chance."""

    impossible_sigma: Positive = 3.0
    """Standard errors by which a value must pass a physical limit, such as a restitution of 1, to be flagged.
    Such a restitution or spin transfer makes the collision a misfit."""

    outlier_sigma: Positive = 6.0
    """Distance from the fit, in standard errors, beyond which a position is left out.
    With normal errors that is one position in 10^8."""

    max_outlier_share: Fraction = 0.05
    """Most positions, as a share of all, that may be left out. If more are far off, the model is wrong."""

    rolling_loss_difference: NotNegative = 0.1
    """Typical difference of the rolling losses of two balls, relative to their loss, if they are not equal.
    Half of such pairs are expected to differ by less than a tenth. Losses on real plates scatter more, those of new
    balls on an even plate less. With 0 the losses count as equal, unless the tracks reject that."""

    friction_change: NotNegative = 0.3
    """Typical change of the sliding friction over the speeds of slip, relative to it, if it is not constant.
    Eight collisions of a hundred are expected to have such a friction. With 0 it counts as constant, unless the tracks
    reject that."""

    broken_law: Fraction = 0.5
    """Probability, before the tracks, that a law of the tied fit is broken that few positions do not test.
    The errors of the tied fit contain what such a break would change, unless the tracks confirm the laws. With 0 the
    laws count as true."""

    slide_end_chi2: Positive = 25.0
    """Rise of chi^2 without the end of a slide from which on the tracks show that end: five standard errors."""

    noise_sigma: Positive = 5.0
    """Standard errors by which the scatter of the positions must differ from the claimed errors to replace them."""

    max_relative_error: Positive = 0.2
    """Largest standard error of a quantity, relative to it, that is reported. Beyond it errors of first order no
    longer describe the estimate. Quantities that may be zero have limits of their own."""

    local_window_s: NotNegative = 0.5
    """Longest stretch on either side of a contact from which the local estimate is made, s. With 0 none is made, which
    saves a third of the time."""

    local_friction: Positive = 0.2
    """Prior of the friction coefficient of the plate in the local estimate, known within a factor of 2. Cloth, glass
    and steel have 0.1 to 0.35."""

    local_friction_factor: Positive = 0.7
    """Standard error of the logarithm of that prior."""

    local_rolling_loss_m_s2: Positive = 0.05
    """Prior of the deceleration of a rolling ball in the local estimate, m/s^2, with a standard error of the same size.
    Cloth has 0.03 to 0.12."""

    local_velocity_error: NotNegative = 0.0125
    """Error of each component of a local velocity beyond its residuals, over v0, in a recording alone whose tracks
    claim no errors. Sets of billiard balls and of pucks show 0.006 to 0.010."""

    min_local_velocity_error: NotNegative = 0.003
    """The same where the residuals are as large as the claimed errors. The best of three sets of real tracks shows
    0.003. Zero is right for simulated tracks."""

    contact_distance_tolerance: Positive = 0.03
    """Deviation from one diameter, in diameters, at which balls that touch are not yet flagged."""

    crowd_particles: Count = 6
    """Particles of a clip from which on it is a crowd: the local estimate alone measures each contact. Fits of whole
    collisions take seconds each, and other contacts disturb most of them."""

    max_particles: Count = 2000
    """Most particles of a clip that are measured. 2000 take some 20 s; the time grows with the square of the number."""

    lone_ball_sigma: Positive = 10.0
    """Standard deviations of chi^2 beyond which a ball that meets no other does not roll freely."""


class TrackerSettings(Settings):
    """All settings of the tracker: ``tracker.track(film, camera, settings=...)``, ``tracker track --settings FILE``.

    Examples
    --------
    >>> import tracker
    >>> settings = tracker.TrackerSettings(link=tracker.LinkSettings(max_gap_frames=8))
    >>> settings.changed()
    {'link': {'max_gap_frames': 8}}
    """

    detection: DetectionSettings = DetectionSettings()
    """How balls are found in frames."""

    link: LinkSettings = LinkSettings()
    """How detections are joined into tracks."""

    fit: FitSettings = FitSettings()
    """How tracks are measured."""

    def changed(self) -> dict[str, Any]:
        """List the keys and values, by section, that differ from their defaults.

        Returns
        -------
        dict
        """
        return self.model_dump(exclude_defaults=True)

    @staticmethod
    def of(given: SettingsSource | None) -> TrackerSettings:
        """Make settings from an object, from keys and values, or from a YAML file; None gives the defaults.

        An InputError names the file and the key that is unknown, of a wrong type or out of range.

        Parameters
        ----------
        given : TrackerSettings, dict, str, Path or None

        Returns
        -------
        TrackerSettings
        """
        if given is None:
            return TrackerSettings()
        if isinstance(given, TrackerSettings):
            return given
        if isinstance(given, str | Path):
            return read_settings(Path(given), TrackerSettings)
        return build_settings(given, TrackerSettings, "settings")


SettingsSource: TypeAlias = TrackerSettings | Mapping[str, Any] | str | Path
