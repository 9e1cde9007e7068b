"""Write a clip in three dimensions for other programs: a glTF scene with the motion as an animation.

Khronos glTF 2.0 and KHR_lights_punctual. Lengths are m; glTF's y points up, so the world's axes hang in a turned node.
Colours are linear, and 1 is white.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from synthcam.camera.lamp import Lamp
from synthcam_shared.arrays import Array

untyped: Any = trimesh
material: Any = untyped.visual.material.PBRMaterial


@dataclass(frozen=True)
class BallMotion:
    """The motion of one ball of `radius` m, or of a disc of a `height`, m."""

    radius: float
    height: float  # 0 of a ball
    times: Array  # increasing (T,), s
    positions: Array  # at these times (T, 3), m
    turn_times: Array  # increasing (S,), s
    turns: Array  # unit quaternions x, y, z, w (S, 4) from the ball's axes to the world's
    # From unit vectors (n, 3) on a matte ball's axes to the reflectance of red, green, blue (n, 3).
    paint: Callable[[Array], Array] | None = None


def make_glb(
    camera: dict[str, Any],
    balls: list[BallMotion],
    lamps: list[tuple[Lamp, float]],
    steel: float,
    roughness: float,
    plate: float | tuple[float, ...],
    dull: bool,
    plate_z: float = 0.0,
) -> bytes:
    """A binary glTF file of one clip.

    camera: the keys of camera.json; glTF has no lens distortion.
    lamps: each with its candela.
    steel, plate: base colours of metals; a `dull` plate is not a metal.
    roughness: glTF's, of the balls.
    plate_z: m.
    """
    colours = {"plate": plate, "steel": steel}
    lights = {f"light{k or ''}": each for k, each in enumerate(lamps)}

    def animate(buffers: dict[Any, bytes], tree: dict[str, Any]) -> None:
        names = {node["name"]: k for k, node in enumerate(tree["nodes"])}
        motion: dict[str, Any] = {"name": "motion", "samplers": [], "channels": []}
        for k, ball in enumerate(balls):
            keys = {"translation": (ball.times, ball.positions), "rotation": (ball.turn_times, ball.turns)}
            for path, (times, values) in keys.items():
                node, number = names[f"ball{k}"], len(motion["samplers"])
                at = _add_accessor(tree, buffers, f"{node} {path} times", times[:, None])
                to = _add_accessor(tree, buffers, f"{node} {path}", values)
                motion["channels"].append({"sampler": number, "target": {"node": node, "path": path}})
                motion["samplers"].append({"input": at, "output": to, "interpolation": "LINEAR"})
        tree["animations"] = [motion]

    def complete(tree: dict[str, Any]) -> None:
        nodes = {node["name"]: node for node in tree["nodes"]}
        nodes["table"] |= {"rotation": [-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]}  # the world's z to glTF's y
        for k, ball in enumerate(balls):  # an animated node may not have a matrix
            nodes[f"ball{k}"].pop("matrix", None)
            nodes[f"ball{k}"] |= {"translation": ball.positions[0].tolist(), "rotation": ball.turns[0].tolist()}
        (width, height), focal = camera["size"], camera["K"][1][1]
        aspect, yfov = width / height * focal / camera["K"][0][0], 2 * float(np.arctan(height / 2 / focal))
        perspective = {"aspectRatio": aspect, "yfov": yfov, "znear": 0.01}
        tree["cameras"] = [{"type": "perspective", "perspective": perspective}]
        turn = np.array(camera["R"], float).T  # glTF's cameras look along -z with y up, OpenCV's along z with y down
        pose = _at(-turn @ np.array(camera["t"], float), turn @ np.diag([1.0, -1.0, -1.0]))
        nodes["camera"] |= {"camera": 0, "matrix": pose.T.ravel().tolist()}
        tree["extensionsUsed"] = [*tree.get("extensionsUsed", []), "KHR_lights_punctual"]
        punctual = []
        for k, (name, (lamp, candela)) in enumerate(lights.items()):
            punctual.append({"name": name, "type": "point", "intensity": candela, "color": [1.0, 1.0, 1.0]})
            nodes[name] |= {"extensions": {"KHR_lights_punctual": {"light": k}}, "translation": lamp.position.tolist()}
        tree.setdefault("extensions", {})["KHR_lights_punctual"] = {"lights": punctual}
        for made_of in tree["materials"]:  # trimesh would round colours to 255ths
            if made_of["name"] in colours:
                colour = np.broadcast_to(colours[made_of["name"]], 3).tolist()
                made_of["pbrMetallicRoughness"]["baseColorFactor"] = [*colour, 1.0]
            if made_of["name"] == "plate" and dull:
                made_of["pbrMetallicRoughness"]["metallicFactor"] = 0.0
        for k in (k for k, ball in enumerate(balls) if ball.paint):
            tree["meshes"][nodes[f"ball{k}"]["mesh"]]["primitives"][0]["material"] = len(tree["materials"])
            surface = {"metallicFactor": 0.0, "roughnessFactor": roughness}
            tree["materials"].append({"name": f"matte{k}", "pbrMetallicRoughness": surface})

    scene = _scene(camera, balls, lights, roughness, plate_z)
    export = untyped.exchange.gltf.export_glb
    return bytes(export(scene, include_normals=True, buffer_postprocessor=animate, tree_postprocessor=complete))


def _scene(
    camera: dict[str, Any], balls: list[BallMotion], lights: dict[str, tuple[Lamp, float]], rough: float, plate_z: float
) -> Any:
    """Plate, balls, lamps and camera as trimesh's scene. rough: glTF's roughness of the balls."""
    scene = untyped.Scene(base_frame="scene")
    scene.graph.update(frame_from="scene", frame_to="table")

    def add(name: str, mesh: Any, position: ArrayLike, made_of: Any, axes: ArrayLike | None = None) -> None:
        if made_of:
            mesh.visual = untyped.visual.TextureVisuals(material=made_of)
        pose = _at(position, np.eye(3) if axes is None else axes)
        scene.add_geometry(mesh, node_name=name, geom_name=name, parent_node_name="table", transform=pose)

    thickness = 1e-3  # of the plate, m
    side = 1.5 * max(camera["size"]) * camera["scale"]
    plate = untyped.creation.box([side, side, thickness])
    plate.unmerge_vertices()  # with shared corners it would be shaded like a dome
    steel = material(name="steel", metallicFactor=1.0, roughnessFactor=rough)
    black = material(name="plate", metallicFactor=1.0, roughnessFactor=1.0)
    add("plate", plate, [0.0, 0.0, plate_z - thickness / 2], black)
    for k, ball in enumerate(balls):
        body = _body(ball)
        if ball.paint:  # as colours of the corners, which glTF takes as linear; its material is set later
            corners = body.vertices / ball.radius
            shown = np.rint(255 * np.broadcast_to(ball.paint(corners), corners.shape)).astype(np.uint8)
            opaque = np.pad(shown, ((0, 0), (0, 1)), constant_values=255)
            body.visual = untyped.visual.ColorVisuals(body, vertex_colors=opaque)
        add(f"ball{k}", body, ball.positions[0], None if ball.paint else steel)
    lamp_material = material(name="lamp", baseColorFactor=[0.0, 0.0, 0.0, 1.0], emissiveFactor=[1.0, 1.0, 1.0])
    for name, (lamp, _) in lights.items():
        add(name.replace("light", "lamp"), _shape(lamp), lamp.position, lamp_material, lamp.axes * [1, 1, -1])
    for name in (*lights, "camera"):
        scene.graph.update(frame_from="table", frame_to=name)
    return scene


def _body(ball: BallMotion) -> Any:
    """A body's mesh, fine enough for its colours. A disc lies flat once its first turn has been applied."""
    subdivisions = 4  # of an icosahedron: outlines are then round to 1e-3 of the radius
    if not ball.height:
        return untyped.creation.icosphere(subdivisions + (ball.paint is not None), ball.radius)
    disc = untyped.creation.cylinder(ball.radius, ball.height, sections=64)
    for _ in range(subdivisions - 1 if ball.paint else 0):
        disc = disc.subdivide()
    disc.vertices = Rotation.from_quat(ball.turns[0]).inv().apply(disc.vertices)
    return disc


def _shape(lamp: Lamp) -> Any:
    """A lamp's mesh, flat along z."""
    if lamp.shape == "bar":
        turn = untyped.transformations.rotation_matrix(lamp.angle, [0, 0, 1])
        return untyped.creation.box([lamp.length, lamp.width, lamp.width / 100], transform=turn)
    if lamp.shape == "ring":
        return untyped.creation.annulus(lamp.inner, lamp.radius, lamp.radius / 100)
    return untyped.creation.cylinder(lamp.radius, lamp.radius / 100)


def _at(position: ArrayLike, axes: ArrayLike) -> Array:
    """Transformation (4, 4) to the world."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = axes, position
    return pose


def _add_accessor(tree: dict[str, Any], buffers: dict[Any, bytes], key: str, values: Array) -> int:
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
