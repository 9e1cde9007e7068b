"""glTF: a binary scene (glb) for each clip: plate, steel balls, lamp, camera, and the motion as an animation.

For Blender and other programs that draw. Positions are the truth's at mid-exposure and at impacts, joined by straight
lines; turns are the integral of its spin. With its light and materials a plain renderer shows the plate as bright as
the film's counts above black, over the sensor's full scale.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from synthcam.camera.glints import find_glints
from synthcam.camera.lamp import Lamp
from synthcam.camera.plate import BLACK_PLATE_RADIANCE, compute_irradiance
from synthcam.dataset.recorded_dataset import RecordedClip
from synthcam.scene.clip import Clip
from synthcam.scene.scene import rebuild_clip
from synthcam_shared.arrays import Array


def write(clips: Iterator[RecordedClip], folder: Path) -> None:
    from synthcam.camera.render.gltf_scene import BallMotion, make_glb  # here alone: trimesh is slow to load

    for clip in clips:
        balls = []
        drawn = rebuild_clip(clip.number, clip.drawn, f"{clip.folder}, scene.json")
        finish, matte = drawn.finish, drawn.drawn["surface"].get("ball") == "matte"
        tracks, events = clip.tracks.sort_values("frame"), clip.events
        jumps = events[events["kind"].isin(("contact", "land"))]  # of velocity and spin
        for number in range(int(tracks["particle"].max()) + 1):
            ball = tracks[tracks["particle"] == number]
            own = (jumps["i"] == number) | (jumps["j"] == number)
            times, positions, spins = _keys(ball, jumps.loc[own, "t_s"].to_numpy(float))
            resting = ball.loc[ball["state"] != "fly", "z"]
            radius, height = clip.camera_json["ball_diameter"] / 2, float(drawn.heights[number])
            if height:
                radius = float(drawn.launch.bodies.radius[number])
            elif len(resting):
                radius = float(resting.median())
            first = ball[["qx", "qy", "qz", "qw"]].iloc[0].to_numpy(float) if "qx" in ball else None
            paint = partial(finish.balls[number].paint, sharp=0.02) if finish and matte else None
            balls.append(BallMotion(radius, height, times, positions, *_turns(times, spins, first), paint))
        look = _light_room(drawn) if finish else _light_mirrors(drawn)
        look |= {"steel": drawn.surface.head_on, "plate_z": drawn.plate_z}
        (folder / f"{clip.number:06d}.glb").write_bytes(make_glb(clip.camera_json, balls, **look))


def _light_room(clip: Clip) -> dict[str, Any]:
    """Lamps and materials of matte balls, or of a plate with a colour. glTF has no ambient light: the lamps give it."""
    assert clip.finish
    intensities = _intensities(clip.lamp, 1.0)
    white = np.pi * clip.sensor.glint_peak / (2**clip.sensor.bits - 1) / _light_origin(clip.lamp, intensities)
    lamps = [(lamp, each * white) for lamp, each in zip(clip.lamp.all, intensities, strict=True)]
    return {"lamps": lamps, "roughness": 0.3, "plate": clip.finish.plate * (3 // clip.finish.channels), "dull": True}


def _light_mirrors(clip: Clip) -> dict[str, Any]:
    """Lamps and materials of mirror balls: lamps are points in glTF, so the steel's roughness makes the glint as wide.

    The plate is a metal of GGX's width 1. It reflects 1 / (4 pi) of its colour to all sides, nearly as Lambert's law
    does. A dielectric would add 4 % of its own, more than such a plate.
    """
    camera, first, radius = clip.nominal, clip.lamp, clip.model.ball.radius
    rest = np.array([[[0.0, 0.0, radius]]])
    glint = find_glints(camera, first, rest, np.array([radius]), np.ones((1, 1), bool), clip.surface)
    blur = camera.psf_sigma_px**2 + camera.defocus_px**2 / 4
    peak = float((glint.flux / (2 * np.pi * np.sqrt(np.prod(blur + glint.spread, axis=1)))).sum())
    white = clip.sensor.glint_peak / (2**clip.sensor.bits - 1)  # of the glint's peak
    candela = _intensities(first, white / peak)
    lit = float(compute_irradiance(first, np.zeros(3)))
    plate = BLACK_PLATE_RADIANCE * clip.room * white * lit / _light_origin(first, candela)
    seen = np.sqrt(_area(first) / np.pi) / np.linalg.norm(first.position - rest[0, 0])  # half-angle of the lamp, rad
    slope = np.hypot(clip.surface.roughness, seen / 4)  # rms: a mirror that throws a point as wide as the lamp
    roughness, lamps = float(min(1.0, np.sqrt(np.sqrt(2) * slope))), list(zip(first.all, candela, strict=True))
    return {"lamps": lamps, "roughness": roughness, "plate": min(1.0, 4 * np.pi * plate), "dull": False}


def _intensities(first: Lamp, unit: float) -> list[float]:
    """Intensity of each lamp towards the world's origin, at which the camera looks. unit: of radiance times area."""
    cosines = [max(float(x.position @ -x.axes[:, 2] / np.linalg.norm(x.position)), 0.0) for x in first.all]
    return [unit * lamp.radiance * _area(lamp) * cosine for lamp, cosine in zip(first.all, cosines, strict=True)]


def _light_origin(first: Lamp, intensities: list[float]) -> float:
    """Light of lamps of these intensities on the plate at the world's origin."""
    pairs = zip(intensities, first.all, strict=True)
    return float(sum(each * lamp.position[2] / float(np.linalg.norm(lamp.position)) ** 3 for each, lamp in pairs))


def _area(lamp: Lamp) -> float:
    """m^2."""
    return float(lamp.cells(np.inf).areas.sum())


def _keys(ball: pd.DataFrame, jumps: Array) -> tuple[Array, Array, Array]:
    """Times (T,) and positions (T, 3) at the frames and at the first impact between two frames.

    Also the spins (T - 1, 2, 3), rad/s, at the two ends of each interval, just inside it.
    """
    names = ("t_s", "x y z", "vx vy vz", "wx wy wz")
    time, position, velocity, spin = (ball[columns.split()].to_numpy(float) for columns in names)
    times, positions, spins = [time[0, 0]], [position[0]], []
    for k, (start, end) in enumerate(zip(time[:-1, 0], time[1:, 0], strict=True)):
        inside = jumps[(jumps > start) & (jumps < end)]
        if len(inside):
            times.append(inside[0])
            positions.append(position[k] + velocity[k] * (inside[0] - start))
            spins += [[spin[k], spin[k]], [spin[k + 1], spin[k + 1]]]
        else:
            spins.append([spin[k], spin[k + 1]])
        times.append(end)
        positions.append(position[k + 1])
    return np.array(times), np.array(positions), np.array(spins).reshape(-1, 2, 3)


def _turns(times: Array, spins: Array, first_turn: Array | None) -> tuple[Array, Array]:
    """Times (S,) and unit quaternions (S, 4) from spins that change linearly within each interval."""
    largest_turn = 1.0  # rad between two keys: players take the shorter rotation
    at, turns = [times[0]], [Rotation.identity() if first_turn is None else Rotation.from_quat(first_turn)]
    for start, end, (first, last) in zip(times[:-1], times[1:], spins, strict=True):
        fastest = max(np.linalg.norm(first), np.linalg.norm(last))
        count = max(1, int(np.ceil(fastest * (end - start) / largest_turn)))
        for share in (np.arange(count) + 0.5) / count:
            turns.append(Rotation.from_rotvec((first + share * (last - first)) * (end - start) / count) * turns[-1])
            at.append(start + (share + 0.5 / count) * (end - start))
    return np.array(at), np.array([turn.as_quat() for turn in turns])
