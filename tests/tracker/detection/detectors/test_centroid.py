"""The errors that centroids claim in films of crowds, whose frames show too many balls for a fit of each."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from synthcam import Scene
from tracker.camera.camera import Camera
from tracker.camera.film_in_memory import wrap_frames
from tracker.camera.recordings import make_recording
from tracker.detection.detect import detect, make_view


@pytest.mark.parametrize(("scene", "frames"), [("crowd", 25), ("cooling", 6)])
def test_scores_have_the_size_that_is_claimed(scene, frames):
    clip = Scene.read(scene, timing={"frames": frames}).draw(seed=5)
    recording = make_recording(0, wrap_frames(clip.film()), Camera.from_dict(clip.camera_json))
    found = detect(recording, make_view(recording, "centroid"), "centroid").glints
    true = clip.tracks[clip.tracks.visible]
    shift = true[["x_mean_px", "y_mean_px"]].to_numpy() - true[["x_px", "y_px"]].to_numpy()
    glint = np.column_stack([1e4 * true.frame, true[["glint_x_px", "glint_y_px"]].to_numpy() + shift])
    apart, nearest = cKDTree(np.column_stack([1e4 * found.frame, found.xy])).query(glint)
    seen = apart < 1
    assert seen.mean() > 0.98
    off = found.xy[nearest[seen]] - glint[seen, 1:]
    z = off / np.sqrt(found.cov[nearest[seen]][:, [0, 1], [0, 1]])
    assert np.sqrt((z**2).mean()) == pytest.approx(1.0, abs=0.07)
    assert np.sqrt((z**2).mean(axis=0)).max() < 1.15
