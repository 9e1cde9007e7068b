"""Measured collisions without a camera, for the tests of the search: exact paths with noise of a known kind."""

import dataclasses
from functools import cache

import numpy as np

import discrepancy.fitting.parameters
import discrepancy.free_laws.library
import synthcam.model
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.stretches import cut_stretches
from discrepancy.fitting.jacobian import differentiate_launches, differentiate_tracks
from discrepancy.fitting.model_fit import project_out
from discrepancy.fitting.parameters import BASE_PARAMETERS, strength_names
from discrepancy.fitting.predict import predict_tracks
from discrepancy.noise.model import Noise, NoiseComponent, estimate_noise
from discrepancy.noise.whitening import ClipWhitener
from discrepancy.search import search
from synthcam.dynamics import batch
from synthcam.library import library
from synthcam.model import Model
from synthcam.scene.scene import scene_file
from tracker.camera.camera import Camera

STD = 1.6e-6  # m, 0.01 px
FPS, EXPOSURE, FRAMES = 250.0, 5e-4, 80
WAY = 4e-3  # m, over which the displacements of `scattering_stretches` change
CAMERA = Camera.from_dict(
    {"scale": 1.6e-4, "size": [640, 480], "fps": FPS, "exposure": EXPOSURE, "ball_diameter": 2.38e-3, "t": [0, 0, 0.5]}
    | {"lamp": {"position": [0.05, 0.0, 0.45], "radius": 0.01}}
)
EFFECTS = ("velocity_restitution", "rolling_quadratic")
FREE_LAWS = ("restitution_speed", "rolling_speed")
HIDDEN = {
    "nothing": {},
    "velocity_restitution": {"velocity_restitution.e": 0.05},
    "rolling_quadratic": {"rolling_quadratic.K": 0.1},
}


def only(monkeypatch, free_laws=(), **effects):
    """For a test: a library of these effects by name; with none, of EFFECTS and of the free laws in their place.

    free_laws: those there are to be, by name; the fewer, the quicker the search.
    """
    scene_file()  # is kept for all tests to come: with every effect
    few = effects or {name: library()[name] for name in EFFECTS}
    names = free_laws or (() if effects else FREE_LAWS)
    if names:
        kept = tuple(law for law in discrepancy.free_laws.library.list_free_laws() if law.base_name in names)
        monkeypatch.setattr(discrepancy.free_laws.library, "list_free_laws", lambda: kept)
    for module in (discrepancy.fitting.parameters, synthcam.model):
        monkeypatch.setattr(module, "library", lambda: few)


def correlated(rng, frames, rho, axes=2):
    """Unit noise (frames, axes) whose correlation falls as rho^lag."""
    noise = rng.standard_normal((frames, axes))
    for k in range(1, frames):
        noise[k] = rho * noise[k - 1] + np.sqrt(1 - rho**2) * noise[k]
    return noise


def noise_of_pair(rng, rho, frames=FRAMES):
    return STD * np.concatenate([correlated(rng, frames, rho) for _ in range(2)])


def launches(rng, count):
    """(count, 6) as in the scene painter_behringer."""
    for _ in range(count):
        v0, heading, b = rng.uniform(0.1, 0.6), rng.uniform(0, 2 * np.pi), rng.uniform(-0.3, 0.3)
        place = -0.015 * v0 / 0.6 * np.array([np.cos(heading), np.sin(heading)])
        yield np.array([*place, rng.uniform(0.06, 0.1), v0, heading, b])


def blank(number, launch, ends, frames=FRAMES):
    """A clip with both balls in every frame, and nothing measured yet."""
    frame, ball = np.tile(np.arange(frames), 2), np.repeat([0, 1], frames)
    claimed = np.tile(STD**2 * np.eye(2), (2 * frames, 1, 1))
    return MeasuredCollision(number, "b", CAMERA, frame, ball, np.zeros((2 * frames, 2)), claimed, launch, ends)


def absorbable(fit):
    """Unit columns (points, p) of all that a fit can absorb, for dense algebra: its parameters, each clip's launch."""
    ends = np.cumsum([len(r) for r in fit.residuals])
    launches = np.zeros((ends[-1], 6 * len(ends)))
    for k, slopes in enumerate(fit.launch_slopes):
        launches[ends[k] - len(slopes) : ends[k], 6 * k : 6 * k + 6] = slopes
    dense = np.hstack([np.concatenate(fit.slopes), launches])
    return dense / np.linalg.norm(dense, axis=0)


def unabsorbed(fit, columns):
    """Columns (points, k) less all that a fit can absorb."""
    dense = absorbable(fit)
    return columns - dense @ np.linalg.lstsq(dense, columns, rcond=None)[0]


def exact(model, count, seed, frames=FRAMES, spins=None):
    """Clips without noise. spins: rows of SPIN, in turn."""
    starts = np.array(list(launches(np.random.default_rng(seed), count)))
    if spins is not None:
        starts = np.concatenate([starts, np.resize(spins, (count, 3))], axis=1)
    ends = batch.solve_collisions(model, starts, 0.0, frames / FPS).slide_ends.reshape(2, -1).T
    clips = [blank(k, *both, frames) for k, both in enumerate(zip(starts, ends, strict=True))]
    return [dataclasses.replace(c, xy=xy) for c, xy in zip(clips, predict_tracks(model, starts, clips), strict=True)]


def noisy(clips, seed, rho=0.0):
    """The clips with noise, and first guesses of launch and slide ends that are a little off."""
    rng, out = np.random.default_rng([seed, 1]), []
    for clip in clips:
        off = rng.standard_normal(6) * [1e-6, 1e-6, 2e-5, 2e-4, 3e-4, 3e-4]
        off = np.concatenate([off, 1e-3 * (clip.launch[6:] != 0)])
        late = 1e-3 * rng.standard_normal(2)
        xy = clip.xy + noise_of_pair(rng, rho, len(clip.frame) // 2)
        out.append(dataclasses.replace(clip, xy=xy, launch=clip.launch + off, slide_ends=clip.slide_ends + late))
    return out


def scattering_stretches(model, count, scatter=0.0, warp=0.0, same=True, seed=5):
    """Stretches of collisions, each with a friction of its own, and displaced by a smooth map.

    scatter: of the friction, relative. warp: of the displacements, m. same: all stretches share the map.
    """
    rng, clips = np.random.default_rng(seed), []
    for k, clip in enumerate(exact(model, count, seed - 1)):
        friction = model.sliding_friction * (1 + scatter * rng.standard_normal())
        own = exact(model.replace({"sliding_friction": friction}), count, seed - 1)[k] if scatter else clip
        clips.append(dataclasses.replace(clip, xy=own.xy, slide_ends=own.slide_ends))
    waves, phases = rng.normal(size=(12, 2)) / WAY, rng.uniform(0, 2 * np.pi, (12, 2))
    cut = []
    for clip in cut_stretches(noisy(clips, seed - 2)):
        if not same:
            phases = rng.uniform(0, 2 * np.pi, (12, 2))
        shift = np.cos((clip.xy @ waves.T)[..., None] + phases).sum(axis=1) / np.sqrt(6)
        cut.append(dataclasses.replace(clip, xy=clip.xy + warp * shift))
    return cut


def collisions(model, count, seed, rho=0.0, frames=FRAMES):
    return noisy(exact(model, count, seed, frames), seed, rho)


def searched(hidden, rho=0.0):
    """A search of eight collisions in which something is hidden: one search, however it is asked for."""
    return _searched(hidden, rho)


@cache
def _searched(hidden, rho):
    return search(collisions(Model().replace(HIDDEN[hidden]), 8, 3, rho), Model())


class Design:
    """Score tests of many draws of noise on one set of clips: everything is linear about the true base model."""

    def __init__(self, clips, model):
        self.clips, self.model = clips, model
        self.launches = np.array([c.launch for c in clips])
        _, self.own = differentiate_launches(model, self.launches, clips)
        self.shared = self._slopes(BASE_PARAMETERS)
        self.effects = {n: self._slopes(strength_names(library()[n])) for n in EFFECTS}

    def _slopes(self, names):
        each = [differentiate_tracks(self.model, self.launches, self.clips, n) for n in names]
        return [np.stack(columns, axis=-1) for columns in zip(*each, strict=True)]

    def scores(self, errors, whitened=True):
        """{effect: (signature, residuals)} for errors (n, 2) of each clip; the noise is read off their tracks.

        Not whitened: taken for white, and as large as it is.
        """
        measured = [dataclasses.replace(c, xy=c.xy + e) for c, e in zip(self.clips, errors, strict=True)]
        noise = estimate_noise(measured) if whitened else Noise(NoiseComponent(1.0))
        white = [ClipWhitener.of(c, noise) for c in self.clips]
        own = [w(a) for w, a in zip(white, self.own, strict=True)]

        def cleaned(columns):
            return np.concatenate([project_out(a, w(c)) for a, w, c in zip(own, white, columns, strict=True)])

        shared = cleaned(self.shared)
        left = project_out(shared, cleaned([e[..., None] for e in errors]))[:, 0]
        return {name: (project_out(shared, cleaned(columns)), left) for name, columns in self.effects.items()}

    def z(self, errors, effect, whitened=True):
        signature, left = self.scores(errors, whitened)[effect]
        return float(signature[:, 0] @ left / np.linalg.norm(signature[:, 0]))


@cache
def design(count=8):
    return Design(exact(Model(), count, 5), Model())


@cache
def nulls(clips, count, rho, whitened=True):
    """z of every effect, (count,), in draws of noise alone on so many clips."""
    rng, where = np.random.default_rng(int(1000 * rho)), design(clips)
    draws = [[noise_of_pair(rng, rho) for _ in where.clips] for _ in range(count)]
    scores = [where.scores(d, whitened) for d in draws]
    return {e: np.array([s[e][0][:, 0] @ s[e][1] / np.linalg.norm(s[e][0][:, 0]) for s in scores]) for e in EFFECTS}
