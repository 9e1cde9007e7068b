"""Estimates the noise again from a fitted model's residuals over whole clips, which also show slow noise.

It is used when the model explains the data. The launches and the shared parameters absorb part of the noise; restricted
maximum likelihood (Patterson & Thompson 1971; Harville 1974) allows for that. A missing effect cannot hide in this
noise:

- noise that the phases of motion exclude is rejected;
- the slow noise that they allow is spread over about ten modes per clip. So z sigma become z / sqrt(1 + z^2 / modes),
  which is still far above the threshold of a claim.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.model_fit import ModelFit, orthonormal_basis
from discrepancy.noise import model
from discrepancy.noise.model import BallPairs, Noise, NoiseComponent
from discrepancy.noise.whitening import ClipWhitener
from discrepancy.policy import current_policy
from synthcam_shared.arrays import Array


def refit_noise(
    clips: Sequence[MeasuredCollision], fit: ModelFit, noise: Noise, explained: bool = True
) -> Noise | None:
    """Estimate the noise from the residuals of a fit that was made with `noise`.

    explained: whether the fit contains every known effect. If not, a missing effect may move both balls as a shaking
    camera does; then only each ball's own noise is estimated.

    Returns None if one of these holds:

    - the gain in likelihood is below `SearchPolicy`'s;
    - the phases of motion exclude it;
    - already the noise of whole phases contained motion;
    - the shared noise grows much over whole clips, since a tilted table moves both balls in the same way.
    """
    if (noise.shared and not explained) or noise.whole_phase_scale:
        return None
    max_clips = 12  # evenly spread: they determine the noise well enough
    indices = np.unique(np.linspace(0, len(clips) - 1, min(max_clips, len(clips))).astype(int)).tolist()
    left = RestrictedResiduals.of(clips, fit, noise, indices)
    within = BallPairs(pair for k in indices for pair in clips[k].paired_stretches())
    tests_shared = explained and not noise.shared and bool(within.pairs)
    sigma, rho = left.common_mode_score(noise) if tests_shared else (0.0, 0.0)
    if noise.shared:
        new = left.best(noise)[1]
        if new.common_mode_rms > current_policy().max_shared_noise_growth * noise.common_mode_rms:
            return None
    elif sigma > current_policy().shared_noise_sigma:
        own, size = within.own(), float(np.mean([np.mean(c.claimed_std() ** 2) for c in left.clips]))
        slow = NoiseComponent(0.2 * own.variance * size, (rho,))
        new = left.best(Noise(own, (slow, slow)))[1]
    else:
        slow = NoiseComponent(noise.own.variance, (0.95,), 0.5)
        new = min((left.best(n) for n in (noise, Noise(slow))), key=lambda pair: pair[0])[1]
    if left.cost(noise) - left.cost(new) < (current_policy().min_noise_gain if explained else 0.0):
        return None
    return new if within.cost(new) - within.cost(noise) < current_policy().noise_excluded_by else None


@dataclass(frozen=True)
class RestrictedResiduals:
    """Residuals of clips, with the derivatives that absorb part of them.

    columns: (n, 2, p + S + 1) of each clip, in claimed errors: derivatives by the launch and the shared parameters, and
    residuals.
    """

    clips: Sequence[MeasuredCollision]
    columns: tuple[Array, ...]
    own: int  # numbers of a launch
    penalty: float  # of a number more, Schwarz

    @classmethod
    def of(
        cls, clips: Sequence[MeasuredCollision], fit: ModelFit, noise: Noise, indices: Sequence[int]
    ) -> RestrictedResiduals:
        """The residuals of the clips with these indices."""
        size = np.sqrt(sum((s**2).sum(axis=0) for s in fit.slopes))
        unit, columns = 1 / np.where(size > 0, size, 1), []
        for k in indices:
            both = np.column_stack([fit.launch_slopes[k], fit.slopes[k] * unit, fit.residuals[k]])
            white = ClipWhitener.of(clips[k], noise)
            columns.append(white.scale(white.undo(both)))
        some = tuple(clips[k] for k in indices)
        own = fit.launches.shape[1]
        return cls(some, tuple(columns), own, float(np.log(sum(2 * len(c.frame) - own for c in some))))

    def _groups(self, share_noise: bool) -> list[tuple[MeasuredCollision, Array]]:
        """Group clips that one filter whitens: the first of each group, and the columns (k, n, 2, m) of all.

        share_noise: the balls share noise, so that the filter depends on the claimed errors too.
        """
        return self._with_shared_noise if share_noise else self._without_shared_noise

    @cached_property
    def _without_shared_noise(self) -> list[tuple[MeasuredCollision, Array]]:
        return self._group(lambda clip: b"")

    @cached_property
    def _with_shared_noise(self) -> list[tuple[MeasuredCollision, Array]]:
        return self._group(lambda clip: clip.roots.tobytes())

    def _group(self, more: Callable[[MeasuredCollision], bytes]) -> list[tuple[MeasuredCollision, Array]]:
        groups: dict[tuple[object, ...], list[int]] = {}
        for k, (clip, columns) in enumerate(zip(self.clips, self.columns, strict=True)):
            parts = clip.frame.tobytes(), clip.ball.tobytes(), clip.resting_offset.tobytes(), more(clip)
            free = columns[..., : self.own].any(axis=(0, 1)).tobytes()  # columns of the launch
            groups.setdefault((*parts, free) if clip.scatter is None else (k,), []).append(k)
        return [(self.clips[g[0]], np.stack([self.columns[k] for k in g])) for g in groups.values()]

    def cost(self, noise: Noise) -> float:
        """-2 log restricted likelihood, up to a constant."""
        size = self.columns[0].shape[2] - self.own
        gram, logs = np.zeros((size, size)), 0.0
        for clip, columns in self._groups(bool(noise.shared)):
            white, (k, n, _, m) = ClipWhitener.of(clip, noise), columns.shape
            seen = white.decorrelate(columns.transpose(1, 2, 0, 3)).reshape(2 * n, k, m).transpose(1, 0, 2)
            own = seen[..., : self.own]
            q, r = np.linalg.qr(own[..., own.any(axis=(0, 1))])
            rest = seen[..., self.own :] - q @ (q.swapaxes(1, 2) @ seen[..., self.own :])
            gram += (rest.swapaxes(1, 2) @ rest).sum(axis=0)
            sizes = np.maximum(np.abs(np.diagonal(r, axis1=1, axis2=2)), 1e-300)
            logs += k * white.log_determinant + 2 * float(np.log(sizes).sum())
        values, axes = np.linalg.eigh(gram[:-1, :-1])
        values = np.maximum(values, 1e-8)  # less information than that counts as none
        pulls = axes.T @ gram[:-1, -1]
        with np.errstate(over="ignore"):  # columns without information give infinity, never the best
            return float(logs + np.log(values).sum() + gram[-1, -1] - (pulls**2 / values).sum())

    def best(self, start: Noise) -> tuple[float, Noise]:
        """(cost with the penalty of its numbers, noise): the most likely noise of the same order, from `start`."""
        shape, common = model.order_of(start.own), model.order_of(start.shared[0]) if start.shared else None
        numbers = [np.log([start.own.variance]), model.numbers_from_component(start.own)]
        if start.shared:
            numbers += [np.log([s.variance for s in start.shared]), model.numbers_from_component(start.shared[0])]
        build = partial(model.noise_from_numbers, shape, common)

        def cost(y: Array) -> float:
            return self.cost(build(y))

        x = model.minimise_cost(cost, np.concatenate(numbers))
        return model.finite_cost(cost, x) + self.penalty * len(x), build(x)

    def common_mode_score(self, noise: Noise) -> tuple[float, float]:
        """The most significant score of shared noise over correlations and axes, in sigma, and its correlation.

        As within phases (`BallPairs.common_mode_score`), but without the part that the launches absorb. Let z be white
        residuals, P the projection off the launches, and B the kernel between the balls. The score z'Bz / 2 then has
        mean tr(PB) / 2 and variance tr(PBPB) / 2.
        """
        scores, means, variances = (np.zeros((len(model.SHARED_NOISE_CORRELATIONS), 2)) for _ in range(3))
        for clip, columns in zip(self.clips, self.columns, strict=True):
            white = ClipWhitener.of(clip, noise)
            seen = white.decorrelate(columns)
            q = orthonormal_basis(seen[:, : self.own])
            left = seen[:, -1] - q @ (q.T @ seen[:, -1])
            rows = [np.flatnonzero(clip.ball == ball) for ball in (0, 1)]
            apart = np.abs(np.subtract.outer(clip.frame[rows[0]], clip.frame[rows[1]]))
            for axis in (0, 1):
                units = [np.zeros((len(white.roots), 2, len(r))) for r in rows]
                for unit, r in zip(units, rows, strict=True):
                    unit[r, axis, np.arange(len(r))] = 1
                pushes = [white(unit) for unit in units]  # by a unit displacement of each of these rows
                pulls = [p.T @ left for p in pushes]
                taken = [p.T @ q for p in pushes]
                own = [p.T @ p - t @ t.T for p, t in zip(pushes, taken, strict=True)]
                cross = -taken[1] @ taken[0].T
                for j, rho in enumerate(model.SHARED_NOISE_CORRELATIONS):
                    kernel = rho**apart
                    scores[j, axis] += pulls[0] @ kernel @ pulls[1]
                    means[j, axis] += np.trace(kernel @ cross)
                    variances[j, axis] += np.sum((kernel @ own[1]) * (own[0] @ kernel))
                    variances[j, axis] += np.trace(kernel @ cross @ kernel @ cross)
        off = scores - means
        both = off.sum(axis=1) / np.sqrt(variances.sum(axis=1))
        best = np.maximum((off / np.sqrt(variances)).max(axis=1), both)
        return float(best.max()), float(model.SHARED_NOISE_CORRELATIONS[int(best.argmax())])
