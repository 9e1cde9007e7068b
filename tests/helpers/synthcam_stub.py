"""Datasets for tests that need pictures but no OpenGL: a dot where each ball is."""

import numpy as np

from synthcam.dataset import generate
from synthcam.dataset.generate import GenerationPlan, generate_dataset
from synthcam.scene.clip import Clip
from synthcam.scene.scene import check_scene

SCENE = {
    "name": "stub",
    "launch": {"v0": {"uniform": [0.1, 0.4]}, "b": {"uniform": [-0.3, 0.3]}, "striker": {"choice": ["a", "b"]}},
    "timing": {"frames": 20, "contact_frame": {"uniform": [8, 10]}},
    "camera": {"size": [128, 64], "scale": 3.0e-4},
}


def film(clip, every=1):
    """Stands in for Clip.pictures: noise from (seed, clip, frame), a Gaussian dot on each ball."""
    width, height = clip.camera.size
    rows, columns = np.mgrid[:height, :width]
    top = 2**clip.sensor.bits - 1
    for k in range(0, clip.frames, every):
        rng = np.random.default_rng((clip.seed, clip.number, k))
        picture = rng.normal(0.04, 0.004, (height, width))
        at = np.array([(k + 0.05) / clip.camera.fps])
        for x, y in clip.camera.project(clip.view.at(at)[:, 0, :3]):
            picture += 0.7 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 2.4)
        counts = (np.clip(picture, 0, 1) * top).astype(np.uint8 if clip.sensor.bits == 8 else np.uint16)
        yield np.stack([counts, counts // 2, counts // 3], axis=-1) if clip.drawn["camera"].get("colour") else counts


def quiet(done, total):
    pass


def plan(clips=4, seed=5, video=True, scene=SCENE, **more):
    return GenerationPlan((check_scene(scene, "s.yaml"),), clips, seed, video, **more)


def with_dots(monkeypatch):
    """Let films be dots."""
    monkeypatch.setattr(Clip, "pictures", film)
    monkeypatch.setattr(generate, "describe_machine", lambda video: {"gl": {"renderer": "dots"}, "machine": {}})


def make(folder, monkeypatch, withheld=None, **settings):
    """A finished dataset with dots for pictures."""
    with_dots(monkeypatch)
    outcome = generate_dataset(plan(**settings), folder, 1, quiet, withheld)
    assert outcome.failed == ()
    return folder


def sums(folder):
    return (folder / "SHA256SUMS").read_text()
