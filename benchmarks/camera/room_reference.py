"""How true is room light? Light on matte balls and their plate against a path tracer that shares no line with it.

python -m benchmarks.camera.room_reference [--paths 40000] [-o out/room.json]    about two minutes
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from benchmarks.harness import ROOT, save
from synthcam.camera.lamp import Lamp
from synthcam.camera.room.finish import BallFinish, SurfaceFinish
from synthcam.camera.room.illumination import Illumination

Array = NDArray[np.float64]
Index = NDArray[np.intp]

R = 0.01
BOUNCES = 10
NUDGE = 1e-7  # m, off a surface
PLATE, SKY = -1, -2


class Room:
    """Balls (N, 3) of radius R and reflectances (N,), a plate, a disc lamp that faces down, an even sky.

    Light is irradiance over pi. The lamp's radiance is such that it throws `1 - ambient` on the plate at the origin.
    """

    def __init__(self, centres: Array, colours: Array, plate: float, lamp: Lamp, ambient: float) -> None:
        self.radiance = 1.0
        self.centres, self.colours, self.plate, self.lamp, self.ambient = centres, colours, plate, lamp, ambient
        rng = np.random.default_rng(0)
        self.centres, many = np.zeros((0, 3)), np.zeros((400_000, 3))
        self.radiance = (1 - ambient) / self.lamp_light(many, many + np.array([0.0, 0.0, 1.0]), rng).mean()
        self.centres = centres

    def first_hit(self, points: Array, ways: Array) -> tuple[Array, Index]:
        """Distance to, and number of, what rays meet first: a ball, the plate or the sky."""
        down = ways[:, 2] < 0
        near = np.where(down, -points[:, 2] / np.where(down, ways[:, 2], 1), np.inf)
        what = np.where(down, PLATE, SKY)
        for k, centre in enumerate(self.centres):
            offset = points - centre
            b, c = (offset * ways).sum(1), (offset**2).sum(1) - R**2
            root = b * b - c
            far = np.where(root > 0, -b - np.sqrt(np.maximum(root, 0)), np.inf)
            hit = (far > NUDGE) & (far < near)
            near, what = np.where(hit, far, near), np.where(hit, k, what)
        return near, what

    def lamp_light(self, points: Array, normals: Array, rng: np.random.Generator) -> Array:
        """Light of one random spot of the lamp each, over its probability."""
        r, turn = self.lamp.radius * np.sqrt(rng.random(len(points))), rng.uniform(0, 2 * np.pi, len(points))
        spot = self.lamp.position + np.stack([r * np.cos(turn), r * np.sin(turn), 0 * r], axis=1)
        way = spot - points
        far = np.linalg.norm(way, axis=1)
        way /= far[:, None]
        cosines = np.maximum((normals * way).sum(1), 0) * np.maximum(way[:, 2], 0)
        near, _ = self.first_hit(points + NUDGE * normals, way)
        return np.where(near < far, 0, self.radiance * self.lamp.radius**2 * cosines / far**2)

    def light(self, point: Array, normal: Array, paths: int, rng: np.random.Generator) -> tuple[float, float]:
        """Light on a surface there, and its standard error."""
        points, normals = np.tile(point, (paths, 1)), np.tile(normal, (paths, 1))
        weight, total = np.ones(paths), np.zeros(paths)
        for _ in range(BOUNCES):
            total += weight * self.lamp_light(points, normals, rng)
            way = normals + _sphere(paths, rng)
            way /= np.linalg.norm(way, axis=1, keepdims=True)
            near, what = self.first_hit(points + NUDGE * normals, way)
            total += np.where(what == SKY, weight * self.ambient, 0)
            far = np.where(what == SKY, 0, near)
            points = points + far[:, None] * way
            on_ball = what >= 0
            outward = (points - self.centres[np.maximum(what, 0)]) / R
            normals = np.where(on_ball[:, None], outward, [0.0, 0.0, 1.0])
            colour = np.where(on_ball, self.colours[np.maximum(what, 0)], self.plate)
            weight = np.where(what == SKY, 0, weight * colour)
        return float(total.mean()), float(total.std() / np.sqrt(paths))


def _sphere(count: int, rng: np.random.Generator) -> Array:
    found = rng.standard_normal((count, 3))
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def _towards(polar: float, turn: float) -> Array:
    return np.array([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)])


def regions(lamp: Lamp, neighbour: Array | None) -> dict[str, list[tuple[int, Array, Array]]]:
    """By region: (ball or PLATE, point, normal). Ball 0 rests on the origin; neighbour: of ball 1."""
    away = np.arctan2(-lamp.position[1], -lamp.position[0])
    centre, up = np.array([0.0, 0.0, R]), np.array([0.0, 0.0, 1.0])
    steep = np.hypot(*lamp.position[:2]) / lamp.position[2]

    def ball(polar: list[float], turns: list[float]) -> list[tuple[int, Array, Array]]:
        ways = [_towards(np.radians(p), away + np.radians(t)) for p in polar for t in turns]
        return [(0, centre + R * n, n) for n in ways]

    def plate(radii: list[float], turns: list[float]) -> list[tuple[int, Array, Array]]:
        ways = [_towards(np.pi / 2, away + np.radians(t)) for t in turns]
        return [(PLATE, r * R * way, up) for r in radii for way in ways]

    out = {
        "ball, top": ball([5, 25, 45], [0, 120, 240]),
        "ball, side to the lamp": ball([65, 85], [150, 180, 210]),
        "ball, side from the lamp (terminator)": ball([50, 60, 70, 80, 88], [-30, 0, 30]),
        "plate, 3 to 5 radii off": plate([3.0, 5.0], [0, 90, 180, 270]),
        "plate, by the ball": plate([1.2, 1.6, 2.0], [90, 180, 270]),
        "plate, shadow and its edge": [
            (PLATE, np.array([np.cos(away), np.sin(away), 0]) * R * (steep + s), up)
            for s in np.linspace(0.2, 1.3, 12) * np.hypot(steep, 1)
        ],
    }
    if neighbour is not None:
        side = (neighbour - centre) / np.linalg.norm(neighbour - centre)
        cross = np.cross(up, side)
        near = [np.sin(p) * side * np.cos(t) + np.sin(p) * cross * np.sin(t) + np.cos(p) * up
                for p in np.radians([30, 50, 65, 80]) for t in np.radians([-25, 0, 25])]  # fmt: skip
        out["ball, towards its neighbour"] = [(0, centre + R * n, n) for n in near]
        middle = (centre + neighbour) / 2 * [1, 1, 0]
        out["plate, between two"] = [(PLATE, middle + k * R * cross, up) for k in (0.4, 0.7, 1.0, 1.5, -0.7)]
    return out


CASES = {
    "one white ball on wood, lamp to one side": (None, 0.8, 0.4, (0.3, 0.1, 0.5), 0.04, 0.35),
    "one white ball on paper, lamp overhead": (None, 0.8, 0.8, (0.05, 0.0, 0.6), 0.02, 0.35),
    "one white ball on black, no room light": (None, 0.8, 0.04, (0.3, 0.0, 0.4), 0.03, 0.0),
    "two white balls touching, on wood": (2.0, 0.8, 0.4, (0.3, 0.1, 0.5), 0.04, 0.35),
    "two white balls touching, on cloth, much room light": (2.0, 0.8, 0.15, (0.1, 0.3, 0.5), 0.04, 0.7),
    "two white balls half a radius apart, on wood": (2.5, 0.8, 0.4, (0.3, 0.1, 0.5), 0.04, 0.35),
}


def errors(case: str, paths: int, seed: int = 0) -> dict[str, dict[str, float]]:
    """By region: rms and worst error of the light, over the light of the open plate, and the tracer's own."""
    gap, colour, plate, position, radius, ambient = CASES[case]
    lamp, rng = Lamp(np.array(position), radius), np.random.default_rng(seed)
    centres = np.array([[0.0, 0.0, R]])
    if gap:
        centres = np.array([[0.0, 0.0, R], [gap * R * np.cos(0.6), gap * R * np.sin(0.6), R]])
    finish = BallFinish((colour,), (colour,))
    shade = Illumination(
        lamp, SurfaceFinish((finish,) * len(centres), (plate,), ambient=ambient), np.full(len(centres), R), None
    )
    room = Room(centres, np.full(len(centres), colour), plate, lamp, ambient)
    out = {}
    for name, places in regions(lamp, centres[1] if gap else None).items():
        off, own = [], []
        for what, point, normal in places:
            if what == PLATE:
                found = shade.on_plate(point[None], centres)[0, 0]
            else:
                found = shade.on_ball(0, point[None], normal[None], centres, shade.exchange(centres))[0, 0]
            true, error = room.light(point, normal, paths, rng)
            off.append(found - true)
            own.append(error)
        out[name] = {
            "rms": float(np.sqrt(np.mean(np.square(off)))),
            "worst": float(np.abs(off).max()),
            "mean": float(np.mean(off)),
            "tracer": float(np.sqrt(np.mean(np.square(own)))),
        }
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description="Holds room light to a path tracer.")
    parser.add_argument("--paths", type=int, default=40_000)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "room.json")
    options = parser.parse_args()
    figures = {case: errors(case, options.paths) for case in CASES}
    for case, found in figures.items():
        table = Table("region", "rms", "mean", "worst", "tracer's own", title=case)
        for name, values in found.items():
            table.add_row(name, *(f"{values[k]:.4f}" for k in ("rms", "mean", "worst", "tracer")))
        Console(width=100).print(table)
    save(options.output, figures)
    print(f"{options.output}: light on surfaces, over that of the open plate")


if __name__ == "__main__":
    main()
