"""Show by pyrender, from the glTF file alone, its plate and the glint on ball0: JSON on stdout.

python plain_viewer.py FILE WIDTH HEIGHT. Light is linear, 1 is white.
"""

import json
import struct
import sys
import warnings
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from synthcam.camera.render import windowless

windowless.choose_opengl()
with warnings.catch_warnings(), windowless.without_viewer():
    warnings.simplefilter("ignore")
    import pyrender


def pose(nodes, name):
    """Node to world (4, 4): every node but the root hangs in `table`."""
    node, out = nodes[name], np.eye(4)
    if "matrix" in node:
        return (np.eye(4) if name == "table" else pose(nodes, "table")) @ np.reshape(node["matrix"], (4, 4)).T
    out[:3, :3] = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix()
    out[:3, 3] = node.get("translation", [0, 0, 0])
    return out if name == "table" else pose(nodes, "table") @ out


def stage(path):
    """A file in pyrender's own scene, with its lights; its camera's pose and perspective."""
    data = path.read_bytes()
    tree = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])
    nodes = {node["name"]: node for node in tree["nodes"]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # NumPy's, of pyrender's reading
        scene = pyrender.Scene.from_trimesh_scene(trimesh.load_scene(path), bg_color=[0, 0, 0, 0])
    lights = tree["extensions"]["KHR_lights_punctual"]["lights"]
    for name, node in nodes.items():
        for extension in node.get("extensions", {}).values():
            lamp = lights[extension["light"]]
            scene.add(pyrender.PointLight(lamp["color"], lamp["intensity"]), pose=pose(nodes, name))
    return scene, nodes, tree["cameras"][0]["perspective"]


def drawn(scene, eye, yfov, shape, brightness=1.0):
    """Linear light (h, w), 1 is white: pyrender's shader writes the power 1 / 2.2 of it."""
    node = scene.add(pyrender.PerspectiveCamera(yfov, znear=0.01, zfar=2.0, aspectRatio=shape[1] / shape[0]), pose=eye)
    usual = {light: light.light.intensity for light in scene.light_nodes}
    for light, intensity in usual.items():
        light.light.intensity = intensity * brightness
    renderer = pyrender.OffscreenRenderer(shape[1], shape[0])
    grey = renderer.render(scene)[0][..., 0]
    renderer.delete()
    scene.remove_node(node)
    for light, intensity in usual.items():
        light.light.intensity = intensity
    return (grey / 255.0) ** 2.2 / brightness


def facing(eye, position):
    """Pose of a camera at an eye that looks at a position."""
    out = np.eye(4)
    out[:3, 2] = (eye - position) / np.linalg.norm(eye - position)
    out[:3, 0] = np.cross([0, 0, -1], out[:3, 2])
    out[:3, 0] /= np.linalg.norm(out[:3, 0])
    out[:3, 1] = np.cross(out[:3, 2], out[:3, 0])
    out[:3, 3] = eye
    return out


def main(path, width, height):
    scene, nodes, lens = stage(path)
    eye, ball = pose(nodes, "camera"), pose(nodes, "ball0")[:3, 3]
    at = [(2, 2), (2, width - 3), (height - 3, 2)]
    plate = drawn(scene, eye, lens["yfov"], (height, width), 20.0)
    away, half, side = np.linalg.norm(eye[:3, 3] - ball), 6e-4, 768
    glint = drawn(scene, facing(eye[:3, 3], ball), 2 * np.arctan(half / away), (side, side), 1e-4)
    across = 2 * half / side / away * height / (2 * np.tan(lens["yfov"] / 2))  # the picture's pixels to one here
    said = {"at": at, "plate": [plate[position] for position in at]}
    print(json.dumps(said | {"flux": glint.sum() * across**2, "brightest": glint.max()}))


main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
