"""Where detectors are found, and a clip searched by one of them."""

from __future__ import annotations

import importlib
import inspect
import math
import pkgutil
from collections.abc import Callable
from dataclasses import fields, replace
from importlib.metadata import entry_points
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from synthcam_shared.errors import InputError, PluginError
from tracker.camera.camera import Camera
from tracker.camera.camera_keys import did_you_mean
from tracker.camera.recordings import Recording
from tracker.detection import detectors as detector_files
from tracker.detection import linkers as linker_files
from tracker.detection.autocalibrate import estimate_unknown_settings
from tracker.detection.candidates import EmptyPlate, estimate_empty_plate
from tracker.detection.glints import Detector, Glints, View
from tracker.detection.motion_blur import CURIOUS, PLAIN, SETTLED, SURE, MotionBlurEvidence
from tracker.detection.takes import find_takes

GROUP = "tracker.detectors"
DetectorChoice: TypeAlias = str | Callable[[View], Detector]  # a detector, by its name or itself
ROUNDS = 5  # of the search, until the motion blur is as long as it was taken to be
SWINGS = 0.8  # of the last change's logarithm, one back again that is too large
DEFAULT = "maximum_likelihood"


def list_detectors() -> dict[str, Callable[[View], Detector]]:
    """Every detector by name: the files of ``detectors/`` and the entry points of group tracker.detectors."""
    found: dict[str, Callable[[View], Detector]] = {}
    for module in pkgutil.iter_modules(detector_files.__path__):
        found[module.name] = _from_file(module.name)
    for point in entry_points(group=GROUP):
        found.setdefault(point.name, point.load())
    return found


def _from_file(name: str) -> Callable[[View], Detector]:
    module = importlib.import_module(f"{detector_files.__name__}.{name}")
    made: list[Any] = [c for c in vars(module).values() if inspect.isclass(c)]
    callables = [c for c in made if c.__module__ == module.__name__ and "__call__" in vars(c)]
    if len(callables) != 1:
        raise PluginError(f"{module.__file__}: expected one callable class, found {len(callables)}")
    found: Callable[[View], Detector] = callables[0]
    return found


def load_detector(name: DetectorChoice) -> Callable[[View], Detector]:
    """The detector of that name, or the one given; InputError lists those there are."""
    if not isinstance(name, str):
        return name
    name = name.partition("+")[0]
    if name in {module.name for module in pkgutil.iter_modules(detector_files.__path__)}:
        return _from_file(name)  # without reading every other
    known = list_detectors()
    if name not in known:
        near = did_you_mean(name, {k: k for k in known})
        raise InputError(f"--detector: no detector {name!r}, expected one of {', '.join(sorted(known))}{near}")
    return known[name]


def load_linker(name: DetectorChoice, camera: Camera) -> Callable[[Glints], NDArray[np.int64]] | None:
    """Of a name that ends in +LINKER that program; None where this package links. InputError lists those there are."""
    wanted = name.partition("+")[2] if isinstance(name, str) else ""
    if not wanted:
        return None
    there = sorted(module.name for module in pkgutil.iter_modules(linker_files.__path__))
    if wanted not in there:
        raise InputError(f"--detector: no linker {wanted!r} behind +, expected one of {', '.join(there)}")
    module = importlib.import_module(f"{linker_files.__name__}.{wanted}")
    made: list[Any] = [c for c in vars(module).values() if inspect.isclass(c) and c.__module__ == module.__name__]
    given: Callable[[Glints], NDArray[np.int64]] = made[0](camera)
    return given


def detector_name(name: DetectorChoice) -> str:
    """What messages and files call a detector."""
    return name if isinstance(name, str) else str(getattr(name, "__name__", type(name).__name__))


def make_view(clip: Recording, name: DetectorChoice = DEFAULT) -> View:
    """Plate and noise of a clip, and, for a detector of glints, from them what its camera file leaves open."""
    if detected_point(name, clip.camera) == "centre":
        takes = find_takes(clip.frames)
        return View(clip.camera, EmptyPlate(np.asarray(clip.frames[0]), takes.noise), clip.frames, takes)
    plate = estimate_empty_plate(clip.frames)
    if plate.level.shape != clip.frames.shape[1:]:
        raise InputError(f"clip {clip.number}: frames of unequal sizes")
    return View(estimate_unknown_settings(clip.camera, plate, clip.frames), plate, clip.frames)


def detected_point(name: DetectorChoice, camera: Camera) -> str:
    """What a detector finds: the "glint", or the "centre" of a ball's outline; one of "either" that of matte balls."""
    point = str(getattr(load_detector(name), "point", "glint"))
    return ("centre" if camera.matte else "glint") if point == "either" else point


def detect(clip: Recording, view: View, name: DetectorChoice = DEFAULT) -> Glints:
    """All glints of a clip by the detector ``name``, in the order of frames."""
    return search_frames(clip, load_detector(name)(view), detector_name(name))


def detect_until_blur_converges(clip: Recording, view: View, name: DetectorChoice = DEFAULT) -> tuple[Glints, View]:
    """Find all glints of a clip, and the exposure that their motion blur shows where that is not the camera file's.

    That is so where they differ by more than SURE of its errors and by PLAIN. Else, or where the rounds do not
    converge, the view is the one given, and the glints are those of `detect`.

    Parameters
    ----------
    clip : Clip
    view : View
    name : str or callable
        The detector.

    Returns
    -------
    glints : Glints
        In the order of frames.
    view : View
    """
    finder: Any = load_detector(name)(view)
    first = search_frames(clip, finder, detector_name(name))
    if hasattr(finder, "notes"):
        view = replace(view, notes=tuple(finder.notes()))
    blur = getattr(finder, "motion_blur", None)
    if not isinstance(blur, MotionBlurEvidence):
        return first, view
    length, error, hint = blur.estimate_length()
    if hint < CURIOUS or abs(length - 1.0) < PLAIN:
        return first, view
    current = view
    for _ in range(ROUNDS):
        seen = min(current.camera.effective_exposure * length, 1.0 / current.camera.fps)
        current = replace(current, camera=replace(current.camera, exposure_from_blur=seen))
        finder, previous = load_detector(name)(current), length
        glints = search_frames(clip, finder, detector_name(name))
        length, error, _ = finder.motion_blur.estimate_length()
        if abs(length - 1.0) < SETTLED:
            change = abs(1.0 - view.camera.exposure / seen)
            return (glints, current) if change > max(PLAIN, SURE * error) else (first, view)
        if (length > 1.0) != (previous > 1.0) and abs(math.log(length)) > SWINGS * abs(math.log(previous)):
            break  # it swings about and will not settle: something else is wrong with the glints
    return first, view


def search_frames(clip: Recording, finder: Any, name: str) -> Glints:
    """All glints of a clip. Raises InputError where the detector returns anything but Glints as they must be."""
    frames = enumerate(clip.frames)
    if hasattr(finder, "many"):
        return _check_glints(finder.many(frames), f"detector {name}")
    parts = []
    for number, frame in frames:
        glints = _check_glints(finder(frame), f"detector {name}, frame {number}")
        parts.append(replace(glints, frame=np.full(len(glints), number, dtype=np.int64)))
    return Glints.join(parts)


def _check_glints(found: Any, said_by: str) -> Glints:
    if not isinstance(found, Glints):
        raise InputError(f"{said_by}: returned {type(found).__name__}, expected Glints")
    n = int(np.size(found.x))
    for field in fields(Glints):
        values = np.asarray(getattr(found, field.name))
        expected = (n, 2, 2) if field.name in ("cov", "fixed") else (n,)
        if values.shape != expected:
            raise InputError(f"{said_by}: {field.name} has shape {values.shape}, expected {expected} for {n} glints")
        if not np.isfinite(values).all():
            raise InputError(f"{said_by}: {field.name} holds NaN or infinity, expected finite numbers")
    if not (np.diagonal(found.cov, axis1=1, axis2=2) > 0).all():
        raise InputError(f"{said_by}: cov holds a variance of zero or less, expected px^2 above zero")
    return found
