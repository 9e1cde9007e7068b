"""pyrender without changes, for comparison: two balls, a point lamp, several samples a pixel.

Its highlight has no exact place; "places" (column, row) are for comparison with finer samples.
"""

import json
import os
import sys
import time
import warnings

os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
os.environ.setdefault("LP_NUM_THREADS", "0")

import numpy as np
import trimesh

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import pyrender

FINE, SIZE, R, SCALE, HEIGHT = int(sys.argv[2]), (512, 256), 1.19e-3, 1e-4, 0.5


def main() -> None:
    scene = pyrender.Scene(ambient_light=[0.01] * 3, bg_color=[0.0, 0.0, 0.0])
    steel = pyrender.MetallicRoughnessMaterial(metallicFactor=1.0, roughnessFactor=0.1)
    ball = pyrender.Mesh.from_trimesh(trimesh.creation.icosphere(4, R), material=steel)
    nodes = [scene.add(ball) for _ in range(2)]
    scene.add(pyrender.PointLight(intensity=5.0), pose=_at(0.05, 0, 0.45))
    focal = (HEIGHT - R) / SCALE * FINE
    middle = [FINE * side / 2 for side in SIZE]
    camera = pyrender.IntrinsicsCamera(focal, focal, *middle, znear=0.4, zfar=0.6)
    scene.add(camera, pose=_at(0, 0, HEIGHT))
    screen = pyrender.OffscreenRenderer(SIZE[0] * FINE, SIZE[1] * FINE)
    frames, rng = int(sys.argv[1]), np.random.default_rng(0)
    shifts, positions = SCALE * rng.uniform(-0.5, 0.5, (frames + 2, 2)), []
    for k, (x, y) in enumerate(shifts):
        if k == 2:  # the first two compile and upload
            started, used = time.perf_counter(), time.process_time()
        for node, at in zip(nodes, ((x, y, R), (-2 * R, 0, R)), strict=True):
            scene.set_pose(node, _at(*at))
        colour, _ = screen.render(scene)
        picture = colour[..., 0].reshape(SIZE[1], FINE, SIZE[0], FINE).mean(axis=(1, 3))
        positions.append(_brightest(picture))
    name = f"stock pyrender, {FINE} x {FINE} samples"
    clock, used = time.perf_counter() - started, time.process_time() - used
    found = {"ms a frame": 1e3 * clock / frames, "processor ms a frame": 1e3 * used / frames}
    print(json.dumps({f"{name}: {what}": value for what, value in found.items()} | {"places": positions}))


def _brightest(picture: np.ndarray) -> list[float]:
    """Centroid (column, row) of the highlight on the ball near the middle."""
    left, top, side = SIZE[0] // 2 - 4, SIZE[1] // 2 - 8, 16
    near = picture[top : top + side, left : left + side]
    weight = np.clip(near - 0.5 * near.max(), 0, None)
    rows, columns = np.mgrid[:side, :side]
    return [float((weight * axis).sum() / weight.sum()) for axis in (columns, rows)]


def _at(x: float, y: float, z: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


if __name__ == "__main__":
    main()
