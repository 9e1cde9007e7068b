"""Write a clip in three dimensions for other programs: a glTF scene with the motion as an animation.

Khronos glTF 2.0 and KHR_lights_punctual. Lengths are m; glTF's y points up, so the world's axes hang in a turned node.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from synthcam.camera.lamp import Lamp

Array = NDArray[np.float64]
untyped: Any = trimesh
material: Any = untyped.visual.material.PBRMaterial

LAMP_MATERIAL = material(name="lamp", baseColorFactor=[0.0, 0.0, 0.0, 1.0], emissiveFactor=[1.0, 1.0, 1.0])


@dataclass(frozen=True)
class BallMotion:
    """The motion of one ball.

    Attributes
    ----------
    radius : float
        m.
    times, positions : ndarray of shape (T,), ndarray of shape (T, 3)
        Increasing times, s, of positions, m.
    turn_times, turns : ndarray of shape (S,), ndarray of shape (S, 4)
        Times, s, of unit quaternions x, y, z, w from the ball's axes to the world's.
    paint : callable or None
        Of matte balls: unit vectors (n, 3) on the ball's axes -> reflectance of red, green, blue (n, 3).
    """

    radius: float
    times: Array
    positions: Array
    turn_times: Array
    turns: Array
    paint: Callable[[Array], Array] | None = None


@dataclass(frozen=True)
class Appearance:
    """Lamps and materials in glTF's units: linear, 1 is white.

    lamps: each with its candela. steel, plate: base colours of metals; a dull plate is not a metal. roughness: glTF's.
    """

    lamps: tuple[tuple[Lamp, float], ...]
    steel: float
    roughness: float
    plate: float | tuple[float, ...]
    dull: bool = False


def glb(camera: dict[str, Any], balls: list[BallMotion], appearance: Appearance) -> bytes:
    """A binary glTF file of one clip. camera: the keys of camera.json; glTF has no lens distortion."""
    metals = {"plate": (appearance.plate, 1.0), "steel": (appearance.steel, appearance.roughness)}
    lights = {f"light{k or ''}": each for k, each in enumerate(appearance.lamps)}

    def animate(buffers: dict[Any, bytes], tree: dict[str, Any]) -> None:
        names = {node["name"]: k for k, node in enumerate(tree["nodes"])}
        tree["animations"] = [{"name": "motion", "samplers": [], "channels": []}]
        for k, ball in enumerate(balls):
            for path, times, values in (
                ("translation", ball.times, ball.positions),
                ("rotation", ball.turn_times, ball.turns),
            ):
                _channel(tree, buffers, names[f"ball{k}"], path, times, values)

    def complete(tree: dict[str, Any]) -> None:
        nodes = {node["name"]: node for node in tree["nodes"]}
        nodes["table"] |= {"rotation": [-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]}  # the world's z to glTF's y
        for k, ball in enumerate(balls):  # an animated node may not have a matrix
            nodes[f"ball{k}"].pop("matrix", None)
            nodes[f"ball{k}"] |= {"translation": ball.positions[0].tolist(), "rotation": ball.turns[0].tolist()}
        tree["cameras"] = [_perspective(camera)]
        nodes["camera"] |= {"camera": 0, "matrix": _pose(camera).T.ravel().tolist()}
        tree["extensionsUsed"] = [*tree.get("extensionsUsed", []), "KHR_lights_punctual"]
        punctual = []
        for k, (name, (lamp, candela)) in enumerate(lights.items()):
            punctual.append({"name": name, "type": "point", "intensity": candela, "color": [1.0, 1.0, 1.0]})
            nodes[name] |= {"extensions": {"KHR_lights_punctual": {"light": k}}, "translation": lamp.position.tolist()}
        tree.setdefault("extensions", {})["KHR_lights_punctual"] = {"lights": punctual}
        for made_of in tree["materials"]:  # trimesh would round colours to 255ths
            if made_of["name"] in metals:
                colour = np.broadcast_to(metals[made_of["name"]][0], 3).tolist()
                made_of["pbrMetallicRoughness"]["baseColorFactor"] = [*colour, 1.0]
            if made_of["name"] == "plate" and appearance.dull:
                made_of["pbrMetallicRoughness"]["metallicFactor"] = 0.0
        for k in (k for k, ball in enumerate(balls) if ball.paint):
            tree["meshes"][nodes[f"ball{k}"]["mesh"]]["primitives"][0]["material"] = len(tree["materials"])
            surface = {"metallicFactor": 0.0, "roughnessFactor": appearance.roughness}
            tree["materials"].append({"name": f"matte{k}", "pbrMetallicRoughness": surface})

    return bytes(
        untyped.exchange.gltf.export_glb(
            _scene(camera, balls, metals, lights),
            include_normals=True,
            buffer_postprocessor=animate,
            tree_postprocessor=complete,
        )
    )


def _scene(
    camera: dict[str, Any],
    balls: list[BallMotion],
    metals: dict[str, tuple[Any, float]],
    lights: dict[str, tuple[Lamp, float]],
) -> Any:
    """Plate, balls, lamps and camera as trimesh's scene. metals: base colour and roughness."""
    scene = untyped.Scene(base_frame="scene")
    scene.graph.update(frame_from="scene", frame_to="table")
    thickness = 1e-3  # of the plate, m
    subdivisions = 4  # of an icosahedron: outlines are then round to 1e-3 of the radius
    side = 1.5 * max(camera["size"]) * camera["scale"]
    plate = untyped.creation.box([side, side, thickness])
    plate.unmerge_vertices()  # with shared corners it would be shaded like a dome
    black, steel = (
        material(name=name, metallicFactor=1.0, roughnessFactor=rough) for name, (_, rough) in metals.items()
    )
    _add(scene, "plate", plate, black, _at([0.0, 0.0, -thickness / 2]))
    for k, ball in enumerate(balls):
        sphere = untyped.creation.icosphere(subdivisions + (ball.paint is not None), ball.radius)
        _add(scene, f"ball{k}", sphere, steel, _at(ball.positions[0]), ball.paint)
    for name, (lamp, _) in lights.items():
        _add(
            scene,
            name.replace("light", "lamp"),
            _shape(lamp),
            LAMP_MATERIAL,
            _at(lamp.position, lamp.axes * [1, 1, -1]),
        )
    for name in (*lights, "camera"):
        scene.graph.update(frame_from="table", frame_to=name)
    return scene


def _perspective(camera: dict[str, Any]) -> dict[str, Any]:
    """glTF's camera."""
    (width, height), focal = camera["size"], camera["K"][1][1]
    return {
        "type": "perspective",
        "perspective": {
            "aspectRatio": width / height * focal / camera["K"][0][0],
            "yfov": 2 * float(np.arctan(height / 2 / focal)),
            "znear": 0.01,
        },
    }


def _shape(lamp: Lamp) -> Any:
    """A lamp's mesh, flat along z."""
    if lamp.shape == "bar":
        turn = untyped.transformations.rotation_matrix(lamp.angle, [0, 0, 1])
        return untyped.creation.box([lamp.length, lamp.width, lamp.width / 100], transform=turn)
    if lamp.shape == "ring":
        return untyped.creation.annulus(lamp.inner, lamp.radius, lamp.radius / 100)
    return untyped.creation.cylinder(lamp.radius, lamp.radius / 100)


def _at(position: ArrayLike, axes: Array | None = None) -> Array:
    pose = np.eye(4)
    pose[:3, 3] = position
    if axes is not None:
        pose[:3, :3] = axes
    return pose


def _add(
    scene: Any, name: str, mesh: Any, made_of: Any, pose: Array, paint: Callable[[Array], Array] | None = None
) -> None:
    """paint: of BallMotion, as colours of the corners, which glTF takes as linear; its material is set later."""
    if paint:
        corners = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
        shown = np.rint(255 * np.broadcast_to(paint(corners), corners.shape)).astype(np.uint8)
        mesh.visual = untyped.visual.ColorVisuals(
            mesh, vertex_colors=np.pad(shown, ((0, 0), (0, 1)), constant_values=255)
        )
    else:
        mesh.visual = untyped.visual.TextureVisuals(material=made_of)
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
        "componentType": 5126,  # float32
        "count": len(data),
        "type": {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[data.shape[1]],
        "min": data.min(axis=0).tolist(),
        "max": data.max(axis=0).tolist(),
    }
    buffers[key] = data.tobytes()
    return number
