"""Notes on the camera file: what it leaves out, and where a film contradicts it."""

from tracker.camera.camera import Camera
from tracker.notes import Note, NoteKind, make_notes


def describe_camera_gaps(camera: Camera) -> list[Note]:
    """Make notes of what the camera file leaves out and of what in it is not accounted for."""
    assumed = [name for name in camera.assumed if name != "ball_diameter" and camera.metric]
    notes = make_notes(NoteKind.ASSUMED, [f"assumed or estimated: {', '.join(assumed)}"] if assumed else [])
    if camera.metric and not camera.knows_diameter:
        text = "ball_diameter: not given; collisions are not measured, and glints are not taken to centres"
        notes.append(Note(NoteKind.MISSING, text))
    return notes + make_notes(NoteKind.UNMODELLED, camera.unmodelled)


def describe_exposure(camera: Camera, key: str) -> list[Note]:
    """Note that the motion blur differs from the exposure in the camera file; `key` holds the one seen."""
    if camera.exposure_from_blur is None:
        return []
    kind = "longer" if camera.exposure_from_blur > camera.exposure else "shorter"
    return [Note(NoteKind.TIMING, f"exposure: motion blur is {kind} than it makes it; taken as it is seen ({key})")]
