"""Fits the scatter of bodies on air: its sizes, how it grows with the speed, its tails, and displacements.

A few stretches may have accelerations many times those of others. A scatter without long tails follows these few. It
then tells wrongly how accelerations grow with the speed, how long they last, and whether positions are displaced. All
forms of the scatter are therefore compared by one likelihood, which has the tails.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from discrepancy.fitting.noise_refit import RestrictedResiduals
from discrepancy.fitting.scatter_tails import FREEDOMS, TailLikelihood
from discrepancy.fitting.stretch_moves import DISPLACED, ON_AIR, AirMoves, Moves, ScatterSizes, StretchScatter
from discrepancy.noise.model import minimise_cost
from discrepancy.policy import current_policy
from synthcam_shared.arrays import Array

SPEED_POWERS = (0, 1, 2)
RESIDUAL_TO_PUSH = 27.0  # a constant acceleration a leaves an rms of a T^2 / 27 about a straight line, in a time T
MAX_ROUNDS = 4  # of the sizes and the shared parameters, each by the other
CONVERGED = 0.5  # -2 log likelihood; less is not worth another round


def guess_air_sizes(
    left: RestrictedResiduals, moves: Sequence[Moves], way: float, noise_m: float
) -> tuple[Mapping[str, float], float]:
    """Guess the sizes on air, from which their fit starts, and the median speed, m/s.

    way: the median length of a path, m. noise_m: the size of the noise of a position, m.
    """
    lasts = np.array([np.ptp(clip.frame) / clip.fps for clip in left.clips])
    both = zip(left.columns, left.clips, strict=True)
    size = np.array([np.std(columns[..., -1]) * np.mean(clip.claimed_std()) for columns, clip in both])
    push = float(np.median(RESIDUAL_TO_PUSH * size / lasts**2))
    start = {"loss_m_s2": push, "across_m_s2": push, "lasts_s": float(np.median(lasts)) / 2}
    # Displacements over more are like accelerations; from small ones, a descent may end at a map of the noise.
    start |= {"displacement_m": 4 * noise_m, "reach_m": 0.06 * way}
    return start, float(np.median(np.concatenate([move.speeds for move in moves if isinstance(move, AirMoves)])))


class ScatterForm(NamedTuple):
    """The parts of a scatter on air."""

    power: int = 0  # of the speed, to which accelerations are proportional
    freedom: float = 0.0  # of Student's t; 0: no tails
    displaced: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """The sizes that such a scatter has."""
        return (*ON_AIR, *DISPLACED) if self.displaced else ON_AIR

    def neighbours(self) -> Iterator[ScatterForm]:
        """Forms with longer or shorter tails, another power of the speed, and with or without displacements.

        The tails form a ring, so that those without any are next to the longest and to the shortest ones.
        """
        tails = (0.0, *FREEDOMS)
        at = tails.index(self.freedom)
        for k in (at - 1, (at + 1) % len(tails)):
            yield self._replace(freedom=tails[k])
        for power in (self.power - 1, self.power + 1):
            if power in SPEED_POWERS:
                yield self._replace(power=power)
        yield self._replace(displaced=not self.displaced)


class AirFit(NamedTuple):
    """The most likely scatter of a form."""

    form: ScatterForm
    cost: float  # -2 log likelihood
    x: Array  # logarithms of the sizes over those of the start
    scatter: StretchScatter

    @property
    def price(self) -> float:
        """The cost, and what displacements and tails have to gain: they hardly differ from accelerations."""
        least, form = current_policy().min_noise_gain, self.form
        return self.cost + least * form.displaced + (least + 2) * bool(form.freedom)


@dataclass(frozen=True)
class AirScatterFits:
    """Fits of all forms of the scatter on air by one likelihood."""

    tails: TailLikelihood
    sizes: ScatterSizes
    fits: dict[ScatterForm, AirFit] = field(default_factory=dict)

    def find_best(self) -> AirFit:
        """Find the most likely form: from accelerations that are as large in all stretches, change one thing at a time.

        The search ends where no neighbour is better.
        """
        best = self.fit(ScatterForm(), [np.zeros(len(ON_AIR))])
        while better := self._find_better(best):
            best = better
        return best

    def cost_without_scatter(self) -> float:
        """-2 log likelihood if no stretch is pushed or displaced."""
        none = self.sizes.build(ON_AIR, np.zeros(len(ON_AIR)))
        none = replace(none, loss_m_s2=0.0, across_m_s2=0.0)
        return self.tails.cost(none, self.tails.find_multiples(none)[1])

    def fit(self, form: ScatterForm, starts: Sequence[Array]) -> AirFit:
        """Fit the sizes of a form, or return the earlier fit; starts: logarithms of sizes over those of the start."""
        if form not in self.fits:
            self.fits[form] = min((self._descend(form, x) for x in starts), key=lambda fit: fit.cost)
        return self.fits[form]

    def _find_better(self, known: AirFit) -> AirFit | None:
        """Find the first neighbour that is better; None if there is none.

        A scatter that lacks displacements or tails has accelerations shorter than a frame instead. No descent leads
        back from there, so forms with displacements or tails are fitted from the start of all sizes as well.
        """
        for form in known.form.neighbours():
            x = known.x[: len(form.names)]
            starts = [np.pad(x, (0, len(form.names) - len(x)))]
            if form.displaced > known.form.displaced or bool(form.freedom) > bool(known.form.freedom):
                starts.append(np.zeros(len(form.names)))
            tried = self.fit(form, starts)
            if tried.price < known.price:
                return tried
        return None

    def _descend(self, form: ScatterForm, x: Array) -> AirFit:
        """Fit the sizes from a start, and the changes of the shared parameters by these sizes, in turn."""

        def build(x: Array) -> StretchScatter:
            return replace(self.sizes.build(form.names, x, form.power), freedom=form.freedom)

        def price(x: Array, shared: Array) -> float:
            return self.tails.cost(build(x), shared)

        shared, cost = self.tails.find_multiples(build(x))[1], np.inf
        for _ in range(MAX_ROUNDS):
            x, before = minimise_cost(partial(price, shared=shared), x), cost
            shared = self.tails.find_multiples(build(x))[1]
            cost = price(x, shared)
            if cost > before - CONVERGED:
                break
        return AirFit(form, cost, x, build(x))
