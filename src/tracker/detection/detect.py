"""Finds detectors and linkers by name, makes their view of a clip, and detects its balls."""

import importlib
import inspect
import math
import pkgutil
from collections.abc import Callable, Iterable
from dataclasses import fields, replace
from importlib.metadata import entry_points
from types import ModuleType
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Ints
from synthcam_shared.errors import InputError, PluginError
from synthcam_shared.settings import did_you_mean
from tracker.camera.camera import Camera
from tracker.camera.frames import spread_frames
from tracker.camera.recordings import Recording
from tracker.detection import detectors as detector_files
from tracker.detection import linkers as linker_files
from tracker.detection.autocalibrate import estimate_unknown_settings
from tracker.detection.background.takes import find_takes
from tracker.detection.candidates import EmptyPlate, estimate_empty_plate, median_of_nine
from tracker.detection.choose import find_radius
from tracker.detection.detector import AnyDetector, ClipDetector, Detections, DetectorClass, Point, SharedDetector, View
from tracker.detection.glints import Glints
from tracker.detection.own_detector import as_detector, describe_fault, is_outside_detector, load_outside, short_name
from tracker.detection.shared_frames import share_frames
from tracker.settings import LinkSettings, TrackerSettings

DetectorChoice: TypeAlias = str | DetectorClass | Callable[[NDArray[Any]], Any]
"""A detector: its name, FILE.py or MODULE:NAME, with +LINKER of another program, or the class or function itself."""
Linker: TypeAlias = Callable[[Glints], Ints]

DEFAULT = "maximum_likelihood"


def list_detectors() -> dict[str, DetectorClass]:
    """Every detector by name: the files of ``detectors/`` and the entry points of group ``tracker.detectors``."""
    own = {module.name: _load_file(module.name) for module in pkgutil.iter_modules(detector_files.__path__)}
    others = [point for point in entry_points(group="tracker.detectors") if point.name not in own]
    return own | {point.name: point.load() for point in others}


def _load_file(name: str) -> DetectorClass:
    module = importlib.import_module(f"{detector_files.__name__}.{name}")
    classes = [c for c in _own_classes(module) if {"__call__", "detect"} & set(vars(c))]
    if len(classes) != 1:
        raise PluginError(
            f"{module.__file__}: expected one class with __call__(frame) or detect(frames), found {len(classes)}"
        )
    found: DetectorClass = classes[0]
    return found


def _own_classes(module: ModuleType) -> list[Any]:
    return [c for c in vars(module).values() if inspect.isclass(c) and c.__module__ == module.__name__]


def load_detector(name: DetectorChoice) -> DetectorClass:
    """Load the class of a detector by its name. Raises InputError, which lists all names, for an unknown one."""
    if not isinstance(name, str):
        return as_detector(name)
    name = _split_linker(name)[0]
    if is_outside_detector(name):
        return load_outside(name)
    if name in {module.name for module in pkgutil.iter_modules(detector_files.__path__)}:
        return _load_file(name)  # without importing all others
    known = list_detectors()
    if name not in known:
        near = did_you_mean(name, known)
        raise InputError(
            f"--detector: no detector {name!r}, expected one of {', '.join(sorted(known))}{near}; your own: FILE.py"
        )
    return known[name]


def _split_linker(name: str) -> tuple[str, str]:
    """The detector and the linker of NAME+LINKER; a file may have a + in its path."""
    detector, _, linker = name.rpartition("+")
    return (detector, linker) if detector and linker.isidentifier() else (name, "")


def load_linker(name: DetectorChoice, camera: Camera, settings: LinkSettings | None = None) -> Linker | None:
    """The linker of a name that ends in +LINKER; None for the tracker's own. Raises InputError for an unknown one.

    A file of ``linkers/`` holds one class. It is made from the camera and `LinkSettings`; called with the `Glints` of a
    clip it returns their particles (n,), -1 for none.
    """
    wanted = _split_linker(name)[1] if isinstance(name, str) else ""
    if not wanted:
        return None
    there = sorted(module.name for module in pkgutil.iter_modules(linker_files.__path__))
    if wanted not in there:
        raise InputError(f"--detector: no linker {wanted!r} behind +, expected one of {', '.join(there)}")
    module = importlib.import_module(f"{linker_files.__name__}.{wanted}")
    linker: Linker = _own_classes(module)[0](camera, settings or LinkSettings())
    return linker


def detector_name(name: DetectorChoice) -> str:
    """Name a detector for messages and files."""
    if not isinstance(name, str):
        return str(getattr(name, "__name__", type(name).__name__))
    return short_name(name) if is_outside_detector(name) else name


def find_detected_point(name: DetectorChoice, camera: Camera) -> Point:
    """Find by the name of a detector which point it finds with this camera: "glint" or "centre" of an outline.

    It is the optional attribute ``point`` of the detector's class; see `tracker.detection.detector`.
    """
    point = getattr(load_detector(name), "point", "glint")
    return "centre" if point == "centre" or (point == "either" and camera.matte) else "glint"


def make_view(clip: Recording, name: DetectorChoice = DEFAULT, settings: TrackerSettings | None = None) -> View:
    """Make the view of a clip; for a detector of glints it estimates what the camera file leaves open."""
    settings = settings or TrackerSettings()
    if find_detected_point(name, clip.camera) == "centre":
        takes, camera = find_takes(clip.frames), clip.camera
        if getattr(clip.frames, "lossy", False) and not camera.sensor.codec_noise:  # marks the tracks as encoded
            sensor = replace(camera.sensor, codec_noise=max(float(takes.noise), 0.5))
            camera = replace(camera, sensor=sensor, matte=True)
        plate = EmptyPlate(np.asarray(clip.frames[0]), takes.noise)
        return View(camera, plate, clip.frames, takes, settings, clip.area, find_radius(clip), clip.channel)
    plate = estimate_empty_plate(clip.frames)
    if plate.level.shape != clip.frames.shape[1:]:
        raise InputError(f"clip {clip.number}: frames of unequal sizes, expected all as the first")
    camera = estimate_unknown_settings(clip.camera, plate, clip.frames)
    return View(camera, plate, clip.frames, settings=settings, area=clip.area, channel=clip.channel)


def blank_outside(clip: Recording, view: View) -> Recording:
    """Blank the frames of a detection outside its area and a diameter around that, where a ball may reach into it.

    A detector then finds nothing there, whatever moves or shines. `discs` looks at the area by itself.
    """
    if clip.area is None:
        return clip
    reach = 2 * round(max(clip.camera.diameter_px, 8.0)) + 1
    outside = cv2.dilate(clip.area.view(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))) == 0
    frames = clip.frames
    sample = [view.plate.level] if view.takes is None else [np.array(frames[k]) for k in spread_frames(frames)]
    level = np.rint(sample[0] if view.takes is None else median_of_nine(sample)).astype(frames.dtype)

    def fetch(k: int) -> Any:
        return np.where(outside, level, frames[k])

    return replace(clip, frames=frames.with_fetch(fetch), helpers=None)


def detect(clip: Recording, view: View, name: DetectorChoice = DEFAULT) -> Detections:
    """Detect the balls of all frames of a clip, in order. Raises InputError for glints that are not consistent."""
    detector, numbers = load_detector(name)(view), clip.frames.numbers
    # A detector of glints predicts their motion blur from their motion: it has to know of missing frames.
    known = range(len(numbers)) if view.takes is not None else numbers.tolist()
    shares = clip.helpers is not None and _is_own(detector)
    if shares and isinstance(detector, SharedDetector) and detector.can_share:
        found = detector.gather(share_frames(clip, detector, known))
    else:
        found = run_detector(detector, zip(known, clip.watch_frames(), strict=True), detector_name(name))
    if view.takes is not None or numbers[-1] == len(numbers) - 1:
        return found
    return replace(found, glints=replace(found.glints, frame=np.searchsorted(numbers, found.glints.frame)))


def _is_own(detector: AnyDetector) -> bool:
    """Return True for a class of this program. Others may not pickle, and a subclass may change any method."""
    return type(detector).__module__.startswith("tracker.detection.detectors")


def run_detector(detector: AnyDetector, frames: Iterable[tuple[int, NDArray[Any]]], name: str) -> Detections:
    """As `detect`, with a detector that is already made, for any numbered frames."""
    if isinstance(detector, ClipDetector):
        found = _call(detector, detector.detect, frames, f"detector {name}")
        if not isinstance(found, Detections):
            raise InputError(f"detector {name}: returned {type(found).__name__}, expected Detections")
        _check_glints(found.glints, f"detector {name}")
        return found
    parts = [Glints.none()]
    for number, frame in frames:
        source = f"detector {name}, frame {number}"
        glints = _check_glints(_call(detector, detector, frame, source), source)
        parts.append(replace(glints, frame=np.full(len(glints), number, dtype=np.int64)))
    return Detections(Glints.join(parts))


def _call(detector: AnyDetector, method: Callable[[Any], Any], given: Any, source: str) -> Any:
    """The result of a detector's method; an error in a user's own detector becomes one line."""
    try:
        return method(given)
    except (InputError, MemoryError):
        raise
    except Exception as error:
        if _is_own(detector):
            raise
        raise InputError(f"{source}: {describe_fault(error)}") from error


def detect_until_blur_converges(clip: Recording, view: View, name: DetectorChoice = DEFAULT) -> tuple[Detections, View]:
    """Detect the balls of a clip, and find the exposure from their motion blur where it contradicts the camera file.

    The exposure is taken from the blur where the two differ by more than ``blur_sigma`` standard errors and by more
    than ``min_blur_change`` (see `DetectionSettings`). Detection is repeated with each new exposure until the blur
    agrees with it. If that does not converge, the camera file's exposure holds. The second result is the view, with
    ``camera.exposure_from_blur`` where the exposure was taken from the blur.
    """
    settings = view.settings.detection
    first = detect(clip, view, name)
    if first.blur is None:
        return first, view
    length, error, significance = first.blur.estimate_length()
    # 2.5 sigma are enough for a second look: the first is made with a wrong exposure, which weakens the evidence.
    if significance < 2.5 or abs(length - 1.0) < settings.min_blur_change:
        return first, view
    current = view
    for _ in range(5):
        exposure = min(current.camera.effective_exposure * length, 1.0 / current.camera.fps)
        current = replace(current, camera=replace(current.camera, exposure_from_blur=exposure))
        found, previous = detect(clip, current, name), length
        if found.blur is None:
            break
        length, error, _ = found.blur.estimate_length()
        if abs(length - 1.0) < 0.02:  # less than half of the least change that is reported
            change = abs(1.0 - view.camera.exposure / exposure)
            agreed = change > max(settings.min_blur_change, settings.blur_sigma * error)
            return (replace(found, notes=first.notes), current) if agreed else (first, view)
        swings_back = (length > 1.0) != (previous > 1.0)
        if swings_back and abs(math.log(length)) > 0.8 * abs(math.log(previous)):
            break  # it oscillates and will not converge: something else is wrong with the glints
    return first, view


def _check_glints(found: Any, source: str) -> Glints:
    """The glints, checked. Raises InputError, which begins with their source."""
    if not isinstance(found, Glints):
        raise InputError(f"{source}: returned {type(found).__name__}, expected Glints")
    n = int(np.size(found.x))
    for field in fields(Glints):
        values = np.asarray(getattr(found, field.name))
        expected = (n, 2, 2) if field.name in ("cov", "fixed") else (n,)
        if values.shape != expected:
            raise InputError(f"{source}: {field.name} has shape {values.shape}, expected {expected} for {n} glints")
        if not np.isfinite(values).all():
            raise InputError(f"{source}: {field.name} holds NaN or infinity, expected finite numbers")
    if not (np.diagonal(found.cov, axis1=1, axis2=2) > 0).all():
        raise InputError(f"{source}: cov holds a variance of zero or less, expected px^2 above zero")
    return found
