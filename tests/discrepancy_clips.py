"""Measured collisions without a camera, for the tests of the search: exact paths with noise of a known kind."""

import dataclasses
from functools import cache

import numpy as np

from discrepancy.find import find
from discrepancy.fit import BASE, LAUNCH_STEP, Whitener, _off, derivative, predict
from discrepancy.measured import Measured
from discrepancy.name import strengths_of
from discrepancy.noise import estimate
from synthcam.dynamics import solve
from synthcam.effect import library
from synthcam.launch import Launch
from synthcam.model import Model

STD = 1.6e-6  # m, 0.01 px
FPS, EXPOSURE, FRAMES = 250.0, 5e-4, 80
HIDDEN = {
    "nothing": {},
    "velocity_restitution": {"velocity_restitution.e": 0.05},
    "rolling_quadratic": {"rolling_quadratic.K": 0.1},
}


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
    return Measured(number, "b", FPS, EXPOSURE, frame, ball, np.zeros((2 * frames, 2)), claimed, launch, ends)


def exact(model, count, seed):
    """Clips without noise."""
    rng, clips = np.random.default_rng(seed), []
    for number, launch in enumerate(launches(rng, count)):
        start = Launch.pair(model.ball.radius, launch[2], launch[3], launch[5], launch[4], launch[:2])
        motion = solve(model, start, 0.0, FRAMES / FPS)
        clip = blank(number, launch, np.array([motion.first("slide_end", ball).t for ball in (0, 1)]))
        clips.append(dataclasses.replace(clip, xy=predict(model, launch, clip)))
    return clips


def noisy(clips, seed, rho=0.0):
    """The clips with noise, and first guesses of launch and slide ends that are a little off."""
    rng, out = np.random.default_rng([seed, 1]), []
    for clip in clips:
        off = rng.standard_normal(6) * [1e-6, 1e-6, 2e-5, 2e-4, 3e-4, 3e-4]
        late = 1e-3 * rng.standard_normal(2)
        xy = clip.xy + noise_of_pair(rng, rho)
        out.append(dataclasses.replace(clip, xy=xy, launch=clip.launch + off, ends=clip.ends + late))
    return out


def collisions(model, count, seed, rho=0.0):
    return noisy(exact(model, count, seed), seed, rho)


@cache
def searched(hidden, rho=0.0):
    """A search of eight collisions in which something is hidden."""
    return find(collisions(Model().replace(HIDDEN[hidden]), 8, 3, rho), Model())


class Design:
    """Score tests of many draws of noise on one set of clips: everything is linear about the true base model."""

    def __init__(self, clips, model):
        self.clips, self.model = clips, model
        self.own = [np.stack([self._by_launch(c, k) for k in range(6)], axis=-1) for c in clips]
        self.shared = [self._slopes(c, BASE) for c in clips]
        self.effects = {n: [self._slopes(c, strengths_of(e)) for c in clips] for n, e in library().items()}

    def _by_launch(self, clip, k):
        step = np.eye(6)[k] * LAUNCH_STEP[k]
        ahead, behind = (predict(self.model, clip.launch + s, clip) for s in (step, -step))
        return (ahead - behind) / (2 * LAUNCH_STEP[k])

    def _slopes(self, clip, names):
        return np.stack([derivative(self.model, clip.launch, clip, n) for n in names], axis=-1)

    def scores(self, errors, whitened=True):
        """{effect: (signature, residuals)} for errors (n, 2) of each clip; the noise is read off their tracks."""
        measured = [dataclasses.replace(c, xy=c.xy + e) for c, e in zip(self.clips, errors, strict=True)]
        noise = estimate(s for c in measured for s in c.stretches())
        if not whitened:
            noise = dataclasses.replace(noise, covariance=noise.covariance * (np.arange(6) == 0))
        white = [Whitener.of(c, noise) for c in self.clips]
        own = [w(a) for w, a in zip(white, self.own, strict=True)]

        def cleaned(columns):
            return np.concatenate([_off(a, w(c)) for a, w, c in zip(own, white, columns, strict=True)])

        shared = cleaned(self.shared)
        left = _off(shared, cleaned([e[..., None] for e in errors]))[:, 0]
        return {name: (_off(shared, cleaned(columns)), left) for name, columns in self.effects.items()}

    def z(self, errors, effect, whitened=True):
        signature, left = self.scores(errors, whitened)[effect]
        return float(signature[:, 0] @ left / np.linalg.norm(signature[:, 0]))

    def nulls(self, count, rho, effect="velocity_restitution", whitened=True):
        rng = np.random.default_rng(int(1000 * rho))
        draws = [[noise_of_pair(rng, rho) for _ in self.clips] for _ in range(count)]
        return np.array([self.z(d, effect, whitened) for d in draws])


@cache
def design():
    return Design(exact(Model(), 8, 5), Model())
