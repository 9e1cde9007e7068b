"""A clip as bodies for other programs: plate, balls, lamp and camera in a glTF scene, the motion as its animation.

Khronos glTF 2.0 and KHR_lights_punctual. Lengths are m; glTF's y points up, so the world's axes hang in a turned node.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

Array = NDArray[np.float64]
untyped: Any = trimesh
material: Any = untyped.visual.material.PBRMaterial

FLOAT = 5126  # glTF's componentType of float32
ROUND = 4  # subdivisions of an icosahedron: a ball's outline is then round to 1e-3 of its radius
BEYOND = 1.5  # of the view's longer side, the plate's
THICK = 1e-3  # m, of the plate
STEEL = material(name="steel", baseColorFactor=[0.56, 0.57, 0.58, 1.0], metallicFactor=1.0, roughnessFactor=0.05)
BLACK = material(name="plate", baseColorFactor=[0.02, 0.02, 0.02, 1.0], metallicFactor=0.0, roughnessFactor=0.9)
LIGHT = material(name="lamp", baseColorFactor=[0.0, 0.0, 0.0, 1.0], emissiveFactor=[1.0, 1.0, 1.0])
CANDELA = 1.0  # of the lamp: nothing in a scene tells it
Z_UP = [-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]  # turns the world's z to glTF's y


@dataclass(frozen=True)
class Motion:
    """One ball. times: (T,) s, increasing, of places (T, 3) m; turn_times: (S,) s, of turns (S, 4), unit quaternions
    x, y, z, w from the ball's axes to the world's."""

    radius: float
    times: Array
    places: Array
    turn_times: Array
    turns: Array


def glb(camera: dict[str, Any], balls: list[Motion]) -> bytes:
    """A binary glTF file of one clip. camera: the keys of camera.json; its lens distortion has no place in glTF."""
    width, height = camera["size"]
    scene = untyped.Scene(base_frame="scene")
    scene.graph.update(frame_from="scene", frame_to="table")
    side = BEYOND * max(width, height) * camera["scale"]
    plate = untyped.creation.box([side, side, THICK])
    _add(scene, "plate", plate, BLACK, np.array([0.0, 0.0, -THICK / 2]))
    for k, ball in enumerate(balls):
        _add(scene, f"ball{k}", untyped.creation.icosphere(ROUND, ball.radius), STEEL, ball.places[0])
    lamp = camera["lamp"]
    disc = untyped.creation.cylinder(lamp["radius"], lamp["radius"] / 100)
    _add(scene, "lamp", disc, LIGHT, np.array(lamp["position"]))
    for name in ("light", "camera"):
        scene.graph.update(frame_from="table", frame_to=name)

    def animate(buffers: dict[Any, bytes], tree: dict[str, Any]) -> None:
        names = {node["name"]: k for k, node in enumerate(tree["nodes"])}
        tree["animations"] = [{"name": "motion", "samplers": [], "channels": []}]
        for k, ball in enumerate(balls):
            for path, times, values in (
                ("translation", ball.times, ball.places),
                ("rotation", ball.turn_times, ball.turns),
            ):
                _channel(tree, buffers, names[f"ball{k}"], path, times, values)

    def place(tree: dict[str, Any]) -> None:
        nodes = {node["name"]: node for node in tree["nodes"]}
        nodes["table"] |= {"rotation": Z_UP}
        for k, ball in enumerate(balls):  # what is animated may have no matrix
            nodes[f"ball{k}"].pop("matrix", None)
            nodes[f"ball{k}"] |= {"translation": ball.places[0].tolist(), "rotation": ball.turns[0].tolist()}
        focal = camera["K"][1][1]
        tree["cameras"] = [
            {
                "type": "perspective",
                "perspective": {
                    "aspectRatio": width / height * focal / camera["K"][0][0],
                    "yfov": 2 * float(np.arctan(height / 2 / focal)),
                    "znear": 0.01,
                },
            }
        ]
        nodes["camera"] |= {"camera": 0, "matrix": _pose(camera).T.ravel().tolist()}
        tree["extensionsUsed"] = [*tree.get("extensionsUsed", []), "KHR_lights_punctual"]
        punctual = {"name": "lamp", "type": "point", "intensity": CANDELA, "color": [1.0, 1.0, 1.0]}
        tree.setdefault("extensions", {})["KHR_lights_punctual"] = {"lights": [punctual]}
        nodes["light"] |= {"extensions": {"KHR_lights_punctual": {"light": 0}}, "translation": lamp["position"]}

    return bytes(
        untyped.exchange.gltf.export_glb(
            scene, include_normals=True, buffer_postprocessor=animate, tree_postprocessor=place
        )
    )


def _add(scene: Any, name: str, mesh: Any, made_of: Any, place: Array) -> None:
    mesh.visual = untyped.visual.TextureVisuals(material=made_of)
    pose = np.eye(4)
    pose[:3, 3] = place
    scene.add_geometry(mesh, node_name=name, geom_name=name, parent_node_name="table", transform=pose)


def _pose(camera: dict[str, Any]) -> Array:
    """Camera to world (4, 4): glTF's cameras look along -z with y up, OpenCV's along z with y down."""
    turn, shift = np.array(camera["R"], float), np.array(camera["t"], float)
    pose = np.eye(4)
    pose[:3, :3] = turn.T @ np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = -turn.T @ shift
    return pose


def _channel(
    tree: dict[str, Any], buffers: dict[Any, bytes], node: int, path: str, times: Array, values: Array
) -> None:
    motion = tree["animations"][0]
    sampler = {
        "input": _accessor(tree, buffers, f"{node} {path} times", times[:, None]),
        "output": _accessor(tree, buffers, f"{node} {path}", values),
        "interpolation": "LINEAR",
    }
    motion["channels"].append({"sampler": len(motion["samplers"]), "target": {"node": node, "path": path}})
    motion["samplers"].append(sampler)


def _accessor(tree: dict[str, Any], buffers: dict[Any, bytes], key: str, values: Array) -> int:
    """Number of a new accessor to float32 values (n, m)."""
    data = np.ascontiguousarray(values, "<f4")
    number = len(tree["accessors"])
    tree["accessors"][key] = {
        "bufferView": len(buffers),
        "componentType": FLOAT,
        "count": len(data),
        "type": {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[data.shape[1]],
        "min": data.min(axis=0).tolist(),
        "max": data.max(axis=0).tolist(),
    }
    buffers[key] = data.tobytes()
    return number
