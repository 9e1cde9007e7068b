"""A camera file from a video of balls of known diameter: surveys their size, and finds scale, glint width and noise."""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from synthcam_shared.errors import InputError
from synthcam_shared.jobs import Progress, run_all_jobs, use_one_thread
from synthcam_shared.outputs import as_input_error, check_writable
from tracker.calibration.ball_outline import measure_outline
from tracker.camera.camera import Camera
from tracker.camera.camera_keys import read_json
from tracker.camera.film_options import FilmOptions
from tracker.camera.frames import GREY
from tracker.camera.recordings import Recording, RecordingSource, make_recording, open_source
from tracker.detection.choose import DISCS, GLINTS, choose_detector, select_channel
from tracker.detection.contact_distance import ContactDistance, contact_distances
from tracker.detection.detect import detect, find_detected_point, make_view
from tracker.detection.detector import OutlineRadius
from tracker.detection.link import link_into_tracks
from tracker.results import write_json

MAX_ROUGH_CLIPS = 12  # clips at most, from which scale, glint width and noise are first read
Ways: TypeAlias = dict[str, tuple[float, float]]  # scale and its standard error, m/px, by each of these methods


@dataclass(frozen=True)
class BallSighting:
    """One clip's part: balls found in all frames together, and how large they are seen."""

    index: int
    camera: Camera  # completed from the clip, as far as its detector does
    balls: int
    contact_distances: list[ContactDistance]
    outline: OutlineRadius | None
    encoded: bool  # with loss


@dataclass(frozen=True)
class Calibration:
    """The result of a calibration."""

    camera: Camera
    scale_std: float  # m/px
    scale_from: str  # "contact", "outline", or "" without a scale
    ways: Ways
    missing: tuple[str, ...]  # a line for each thing that the video does not show
    discs: bool = False  # whether balls are seen as discs, which show nothing of the sensor

    def to_dict(self) -> dict[str, Any]:
        """camera.json, with a key ``calibration`` that says how good it is."""
        whole = self.camera.to_dict()
        timed = () if "exposure" in self.camera.assumed else ("exposure",)
        kept = {key: whole[key] for key in ("scale", "size", "fps", "ball_diameter", *timed)}
        if not self.discs:
            kept |= _sensor_keys(self.camera)
        elif self.camera.sensor.gamma != 1:
            kept["sensor"] = {"gamma": self.camera.sensor.gamma}
        ways = {name: {"scale": value, "std": std} for name, (value, std) in self.ways.items()}
        found = {"scale_std": self.scale_std, "scale_from": self.scale_from, "ways": ways}
        return kept | {"scale_std": self.scale_std, "calibration": found | {"not_found": list(self.missing)}}

    def write(self, path: Path) -> None:
        """The camera file, written aside and moved into place. InputError where no scale was found."""
        if not self.scale_from:
            raise InputError(f"{path}: not written, for no scale was found: {self.missing[0]}")
        write_camera_file(path, self.to_dict())


def write_camera_file(path: Path, keys: dict[str, Any]) -> None:
    """Write the camera file of a calibration aside and move it into place."""
    check_output(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with as_input_error(path):
        write_json(path, keys)


def check_output(path: Path) -> None:
    """Check that a calibration may write its camera file there. Raises InputError, as for another file's place."""
    try:
        keys = read_json(path) if path.exists() or path.is_symlink() else {"calibration": {}}
    except (OSError, ValueError, TypeError):
        keys = None
    if not isinstance(keys, dict) or not isinstance(keys.get("calibration"), dict):
        raise InputError(f"{path}: exists and was not made by tracker calibrate, expected a new file")
    check_writable(path)


def keys_from_options(diameter: float, fps: float, exposure: float | None = None, gamma: float = 1.0) -> dict[str, Any]:
    """Make the keys of camera.json that the user of a calibration gives as options. Raises InputError.

    diameter: of the balls, m.
    fps: frames a second.
    exposure: of a frame, s, which separates motion blur from the glint's width.
    gamma: counts are light to the power of 1/gamma.
    """
    for name, value in (("--diameter", diameter), ("--fps", fps)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"{name}: expected a number over 0, not {value!r}")
    if diameter > 0.5:
        raise InputError(f"--diameter: expected metres, as in 2.38e-3, not {diameter!r}")
    if exposure is not None and not 0 <= exposure <= 1.0 / fps * (1 + 1e-9):
        raise InputError(f"--exposure: expected 0 to one frame time, {1 / fps:g} s, not {exposure!r}")
    if not 0.2 <= gamma <= 5:
        raise InputError(f"--gamma: expected 0.2 to 5, as of most video 2.2, not {gamma!r}")
    given: dict[str, Any] = {"fps": fps, "ball_diameter": diameter}
    given |= {} if gamma == 1 else {"sensor": {"gamma": gamma}}
    return given if exposure is None else given | {"exposure": exposure}


def calibrate(
    video: Path,
    given: dict[str, Any],
    workers: int = 1,
    progress: Progress = lambda done, of: None,
    select: str = "",
) -> Calibration:
    """Find scale, glint width and noise from a video of balls of known diameter.

    video: a video, stack, folder of pictures, clip or dataset.
    given: `keys_from_options`.
    workers: processes, or 0 for one a core, where so many are quicker.
    progress: takes clips done and clips in all, of which those that are looked at twice count twice.
    select: channel or plane of a stack, as "C=1".

    Raises InputError for what cannot be read, or has no glints.
    """
    diameter, fps, is_timed = given["ball_diameter"], given["fps"], "exposure" in given
    source = open_source(video, options=FilmOptions(select=select))
    number, frames = source.open_film(0)
    width, height = frames.shape[:0:-1]
    given = given | {"size": [width, height], "scale": diameter / Camera.unknown((width, height), 8).diameter_px}
    last = len(source) - 1
    rough = sorted({round(i * last / (MAX_ROUGH_CLIPS - 1)) for i in range(MAX_ROUGH_CLIPS)})
    rest = sorted({*range(len(source))} - {*rough})
    steps, total, ways = count(1), 2 * len(rough) + len(rest), Ways()

    def survey_all(picks: Sequence[int], known: dict[str, Any], detector: str) -> list[BallSighting]:
        found = []
        look = functools.partial(survey_sizes, source, known, detector, bool(ways))
        for one in run_all_jobs(look, picks, workers, video):
            found.append(one)
            progress(min(next(steps), total), total)
        return sorted(found, key=lambda one: one.index)

    first_by, then_by = "centroid", GLINTS
    first = without_scale(make_recording(number, frames, Camera.from_dict(given), options=source.options))
    if choose_detector((coloured := select_channel(first, None)[0]).frames, first.camera)[0] == DISCS:
        source, first_by, then_by = replace(source, channel=coloured.channel), DISCS, DISCS
    guess = given["scale"]
    for detector in (first_by, then_by):  # the second time with the size of the balls known
        seen = survey_all(rough, given, detector)
        ways = _ways(seen, diameter)
        if ways:
            given["scale"] = min(ways.values(), key=lambda way: way[1])[0]
    if not ways and given["scale"] != guess:  # noise that passed for contacts gave a wrong size
        seen = survey_all(rough, given | {"scale": guess}, then_by)
        ways = _ways(seen, diameter)
        given["scale"] = min(ways.values(), key=lambda way: way[1])[0] if ways else guess
    if rest:
        seen += survey_all(rest, given | (_sensor_keys(_middle(seen)) if then_by == GLINTS else {}), then_by)
        ways = _ways(seen, diameter)
    result = _combine(seen, ways, video, is_timed, then_by)
    # the rate that the user says, not that of a film with every second frame
    return replace(result, camera=replace(result.camera, fps=fps))


def survey_sizes(source: RecordingSource, known: dict[str, Any], name: str, sized: bool, index: int) -> BallSighting:
    """Survey the size of the balls in clip ``index`` of a source, found by the detector ``name``.

    known: keys of camera.json; sized: whether the scale among them is more than a guess.
    """
    use_one_thread()
    number, frames = source.open_film(index)
    clip = make_recording(number, frames, Camera.from_dict(known), options=source.options)
    clip = clip.select_channel(source.channel or GREY)
    return _survey_discs(clip, index, sized) if name == DISCS else _survey_glints(clip, name, index)


def without_scale(clip: Recording) -> Recording:
    """Return the recording for a survey of sizes, in which nothing ties pixels to metres."""
    bare = Camera.unknown(clip.camera.size, clip.camera.sensor.bits)
    return replace(clip, camera=replace(bare, sensor=clip.camera.sensor))


def _survey_glints(clip: Recording, name: str, index: int) -> BallSighting:
    view = make_view(clip)
    glints = detect(clip, view, name).glints
    tracks = link_into_tracks(glints, view.camera)
    encoded = view.camera.sensor.codec_noise > 0
    seen = None if encoded else measure_outline(clip.frames, view.plate, glints, view.sigma)
    if seen is not None:
        # 1/m, scatter of 1/height of the lamp less that of the camera: distances of glints differ from those of balls
        seen = replace(seen, std=math.hypot(seen.std, 2.5 * clip.camera.ball_diameter / 4 * seen.radius))
    return BallSighting(index, view.camera, len(tracks), contact_distances(tracks), seen, encoded)


def _survey_discs(clip: Recording, index: int, sized: bool) -> BallSighting:
    looked_at = clip if sized else without_scale(clip)
    view = make_view(looked_at, DISCS)
    found = detect(looked_at, view, DISCS)
    lossy = clip.frames.lossy
    takes = view.takes.spans if view.takes else ()
    tracks = link_into_tracks(found.glints, view.camera, find_detected_point(DISCS, view.camera), takes)
    # px, of a contact in lossy video: read from ten drawn films of discs at H.264, crf 28
    contacts = [replace(c, std=math.hypot(c.std, 0.3 * lossy)) for c in contact_distances(tracks)]
    outline = found.outline_radius
    if outline is not None:
        # 2 % of the radius: a ball is darker at its limb, and encoders move edges
        outline = replace(outline, std=math.hypot(outline.std, 0.02 * outline.radius))
    return BallSighting(index, clip.camera, len(tracks), contacts, outline, lossy)


def _middle(seen: Sequence[BallSighting]) -> Camera:
    """The camera of the clip whose glints are of middle width."""
    return sorted(seen, key=lambda s: s.camera.psf_sigma or 0.0)[len(seen) // 2].camera


def _sensor_keys(camera: Camera) -> dict[str, Any]:
    """The keys of camera.json that say how a film shows a glint."""
    whole = camera.to_dict()
    names = ("bits", "gain", "read_noise", "black_level", "codec_noise", "gamma")
    sensor = {"sensor": {k: v for k, v in whole["sensor"].items() if k in names}}
    return sensor if camera.psf_sigma is None else {"psf": whole["psf"], **sensor}


def _ways(seen: Sequence[BallSighting], diameter: float) -> Ways:
    """Scale and standard error by each way that some clip allows."""
    out = {}
    contacts = [(t.distance, t.std) for s in seen for t in s.contact_distances]
    if contacts:
        distance, std = average_contact_distances(contacts)  # of the glints, which are what is tracked without a lamp
        if any(s.encoded for s in seen):
            # encoders show slow balls late, so that all contacts share a quarter of the error of one
            std = math.hypot(std, 0.25 * float(np.median([one for _, one in contacts])))
        out["contact"] = (diameter / distance, diameter / distance**2 * std)
    outlines = [(2.0 * s.outline.radius, 2.0 * s.outline.std) for s in seen if s.outline is not None]
    if outlines:
        width = float(np.median([w for w, _ in outlines]))
        std = min(std for _, std in outlines)
        out["outline"] = (diameter / width, diameter / width**2 * std)
    return out


def average_contact_distances(values: list[tuple[float, float]]) -> tuple[float, float]:
    """Average the distances at the contacts of a calibration, with the error, without strays."""
    value, std = np.array(values).T
    off = np.abs(value - np.median(value))
    # contacts more than four deviations from the median are strays; 1.4826 turns a median deviation into a standard one
    kept = off <= 4.0 * np.maximum(std, 1.4826 * np.median(off))
    value, std = value[kept], std[kept]
    weight = 1.0 / std**2
    mean = float(np.sum(weight * value) / np.sum(weight))
    chi2 = float(np.sum(weight * (value - mean) ** 2)) / max(len(value) - 1, 1)
    return mean, math.sqrt(max(1.0, chi2) / float(np.sum(weight)))


def _combine(seen: Sequence[BallSighting], ways: Ways, video: Path, timed: bool, detector: str) -> Calibration:
    found, discs = sum(s.balls for s in seen), detector == DISCS
    # fewer balls show nothing reliable
    if found < 10:
        what = "glints found, expected balls with a bright glint on a darker ground, or seen whole on a still one"
        raise InputError(f"{video}: {found} {'discs found, expected balls on a still background' if discs else what}")
    best = min(ways, key=lambda name: ways[name][1]) if ways else ""
    missing = _of_scale(seen, ways, best, discs)
    if not timed:
        blurred = "" if discs else "; the glint's width includes the motion blur"
        missing.append(f"exposure: a video does not show it{blurred}")
    missing += [] if discs else ["lamp: its position is not known; tracks will be those of glints, not of centres"]
    missing.append("height: the camera's is not known; it is assumed straight above, without distortion")
    missing += [] if discs else ["sensor: prnu, dsnu and dark current cannot be separated from the noise"]
    scale, std = ways[best] if best else (math.nan, math.nan)
    return Calibration(replace(_middle(seen), scale=scale), std, best, ways, tuple(missing), discs)


def _of_scale(seen: Sequence[BallSighting], ways: Ways, best: str, discs: bool) -> list[str]:
    """Lines about methods that give no scale, or disagree."""
    unseen = "no outline is bright enough to be seen"
    if discs:
        unseen = "no outline is seen whole, for the balls are darker on one side or too few"
    if not best:
        return [f"scale: no two balls are seen to hit each other, and {unseen}"]
    if len(ways) == 1:
        unseen = "an encoder has changed the outlines" if not discs and all(s.encoded for s in seen) else unseen
        other = {"contact": unseen, "outline": "no two balls are seen to hit each other"}[best]
        return [f"scale: from the {best} alone, {other}"]
    (one, one_std), (two, two_std) = ways["contact"], ways["outline"]
    # standard errors
    if abs(one - two) > 3.0 * math.hypot(one_std, two_std):
        return ["scale: contact and outline disagree; are the balls equal, and of that diameter?"]
    return []


def summarise_calibration(result: Calibration) -> list[str]:
    """Summarise a calibration in lines for people."""
    sensor = result.camera.sensor
    lines = [
        f"{name}: scale {value:.6g} m/px +- {100 * std / value:.2g} %" for name, (value, std) in result.ways.items()
    ]
    if not result.discs:
        lines.append(f"glint: sigma {result.camera.sigma or math.nan:.3g} px")
        noise = math.sqrt(float(sensor.variance(np.array(sensor.black_level))))
        lines.append(
            f"noise: {noise:.3g} counts on black at {sensor.black_level:.3g}, gain about {sensor.gain:.3g} e-/count"
        )
    return lines + [f"not found - {line}" for line in result.missing]
