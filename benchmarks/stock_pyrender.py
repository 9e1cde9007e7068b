"""pyrender as it comes, for comparison: two balls, a point lamp, so many samples a pixel each way. Prints JSON."""

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
    scene = pyrender.Scene(ambient_light=[0.01] * 3)
    steel = pyrender.MetallicRoughnessMaterial(metallicFactor=1.0, roughnessFactor=0.1)
    ball = pyrender.Mesh.from_trimesh(trimesh.creation.icosphere(4, R), material=steel)
    nodes = [scene.add(ball) for _ in range(2)]
    scene.add(pyrender.PointLight(intensity=5.0), pose=_at(0.05, 0, 0.45))
    focal = (HEIGHT - R) / SCALE * FINE
    middle = [FINE * side / 2 for side in SIZE]
    camera = pyrender.IntrinsicsCamera(focal, focal, *middle, znear=0.4, zfar=0.6)
    scene.add(camera, pose=_at(0, 0, HEIGHT))
    screen = pyrender.OffscreenRenderer(SIZE[0] * FINE, SIZE[1] * FINE)
    frames = int(sys.argv[1])
    for k in range(frames + 2):
        if k == 2:  # the first two compile and upload
            started, used = time.perf_counter(), time.process_time()
        for node, x in zip(nodes, (1e-4 * k, -2 * R), strict=True):
            scene.set_pose(node, _at(x, 0, R))
        colour, _ = screen.render(scene)
        picture = colour[..., 0].reshape(SIZE[1], FINE, SIZE[0], FINE).mean(axis=(1, 3))
    assert picture.max() > 0
    name = f"stock pyrender, {FINE} x {FINE} samples"
    clock, used = time.perf_counter() - started, time.process_time() - used
    print(
        json.dumps({f"{name}: ms a frame": 1e3 * clock / frames, f"{name}: processor ms a frame": 1e3 * used / frames})
    )


def _at(x: float, y: float, z: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


if __name__ == "__main__":
    main()
