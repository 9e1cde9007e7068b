"""Notes on the camera file: what it leaves out, and where a film contradicts it."""

from __future__ import annotations

from tracker.camera.camera import Camera
from tracker.notes import Note, NoteKind, note_all


def describe_camera_gaps(camera: Camera) -> list[Note]:
    """Make notes of what the camera file leaves out and of what in it is not accounted for."""
    assumed = [name for name in camera.assumed if name != "ball_diameter" and camera.metric]
    notes = note_all(NoteKind.ASSUMED, [f"assumed or estimated: {', '.join(assumed)}"] if assumed else [])
    if camera.metric and not camera.knows_diameter:
        text = "ball_diameter: not given; collisions are not measured, and glints are not taken to centres"
        notes.append(Note(NoteKind.MISSING, text))
    return notes + note_all(NoteKind.UNMODELLED, camera.unmodelled)


def describe_exposure(camera: Camera, key: str) -> list[Note]:
    """Make a note where the motion blur differs from the exposure in the camera file; `key` holds the one seen."""
    if camera.exposure_from_blur is None:
        return []
    kind = "longer" if camera.exposure_from_blur > camera.exposure else "shorter"
    return [Note(NoteKind.TIMING, f"exposure: motion blur is {kind} than it makes it; taken as it is seen ({key})")]


def describe_frame_rate(camera: Camera, claimed: float, tolerance: float = 0.01) -> list[Note]:
    """Make a note where a video file claims another frame rate: slow motion, or a wrong camera file.

    claimed: in frames per second; NaN or 0 where the file claims none. tolerance: 29.97 counts as 30.
    """
    if not camera.metric or not claimed > 0 or abs(claimed / camera.fps - 1) < tolerance:
        return []
    text = f"fps: {camera.fps:g} in the camera file, {claimed:g} in the video's; check which is that of the exposures"
    return [Note(NoteKind.TIMING, text)]
