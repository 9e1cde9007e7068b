"""Score tests of all suspects from one fit: what each would explain, were it added or put in another's place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from discrepancy.claim import LEVEL, by_chance, looks_of, sigmas
from discrepancy.fit import Evidence, Fit, basis, derivative
from discrepancy.forecast import forecast
from discrepancy.parameter import Suspect, between, limits_of, parameter_of, suspects
from discrepancy.scan import scannable, scanned
from synthcam.dynamics import uncoupled
from synthcam.model import Model

Array = NDArray[np.float64]

SEEN = 1e-4  # of a signature's length that must be left when all that the fit absorbs is taken out
LIMIT = 5.0  # sigma expected of a strength at its detection limit
ZOOMS = 2  # times that the grid of a shape is made finer about the best
ROWS = 1500  # of the signatures, to count independent looks by
MOST = 20_000_000  # numbers in the derivatives by one suspect's strengths
UNSEEN = 10.0  # realistic sizes: what only shows beyond them, or beyond what is allowed, cannot be told


@dataclass(frozen=True)
class Candidate:
    """A score test.

    shapes: the best of those tried, for whose number sigma is corrected. gain: the chi^2 that adding it would take, to
    first order. limit: the detection limit, in realistic sizes of the strength that shows best; infinite where the fit
    absorbs all. telling: False where that limit is absurd, or more than the effect allows. signature (points, m): the
    derivative at zero strength less all that the fit absorbs, made orthonormal; m <= k directions leave something to be
    seen. columns: the derivative of each clip's whitened forecast, (2n, k), before anything is taken out.
    """

    suspect: Suspect
    shapes: dict[str, float]
    sigma: float
    gain: float
    limit: float
    telling: bool
    signature: Array
    columns: tuple[Array, ...]

    @property
    def absorbed(self) -> bool:
        """It moves the tracks, but in no way that the fit cannot imitate."""
        return self.signature.shape[1] == 0 and any(c.any() for c in self.columns)

    @property
    def effect(self) -> str:
        return self.suspect.name

    @property
    def strengths(self) -> tuple[str, ...]:
        return self.suspect.strengths


@dataclass(frozen=True)
class Trial:
    """A suspect with some values of its shapes, and the derivatives by its strengths, (2n, k) for each clip."""

    suspect: Suspect
    shapes: dict[str, float]
    columns: tuple[Array, ...]


@dataclass(frozen=True)
class Contest:
    """All suspects at one fit."""

    now: Fit
    trials: tuple[Trial, ...]

    @classmethod
    def of(
        cls,
        evidence: Evidence,
        now: Fit,
        tick: Callable[[], None] = lambda: None,
        only: Sequence[Suspect] = (),
        about: Model | None = None,
    ) -> Contest:
        """Of the library's effects and the base parameters held at zero, or of some of them.

        about: a model near the fit's, with a quicker motion, to take the derivatives about. Where balls push each other
        their motion takes some eight times as long; derivatives are then those without that.
        """
        plain, trials = uncoupled(about or now.model), []
        here = forecast(plain, now.launches, evidence.clips)
        for suspect in only or suspects(now.model, now.names):
            grid = list(suspect.grid(now.model))
            if scannable(suspect, grid):
                trials += _scanned(evidence, plain, now.launches, suspect, grid)
            else:
                trials += [tried(evidence, plain, now.launches, suspect, shapes, here) for shapes in grid]
            tick()
        return cls(now, tuple(trials))

    @cached_property
    def _own(self) -> list[Array]:
        """Of each clip, an orthonormal basis of what its launch absorbs."""
        return [basis(a) for a in self.now.launch_slopes]

    def _stacked(self, columns: Sequence[Array]) -> Array:
        """Columns of every clip less what the launches absorb, stacked."""
        return np.concatenate([c - q @ (q.T @ c) for q, c in zip(self._own, columns, strict=True)])

    @cached_property
    def _shared(self) -> Array:
        return self._stacked(self.now.slopes)

    @cached_property
    def _cleaned(self) -> list[Array]:
        every = self._stacked([np.concatenate(c, axis=1) for c in zip(*(t.columns for t in self.trials), strict=True)])
        cuts = np.cumsum([t.columns[0].shape[1] for t in self.trials])[:-1]
        return np.split(every, cuts, axis=1)

    @cached_property
    def _bases(self) -> list[Array]:
        """Of each trial an orthonormal basis (points, m) of its signature."""
        _, absorbed = self._left(None)
        every = []
        for trial, cleaned in zip(self.trials, self._cleaned, strict=True):
            signature = cleaned - absorbed @ (absorbed.T @ cleaned)
            every.append(signature @ _axes(signature, _lengths(trial.columns))[0])
        return every

    @cached_property
    def looks(self) -> dict[str, float]:
        """How many independent looks at the data all the shapes of a suspect are, by its name."""
        by_name: dict[str, list[Array]] = {}
        for trial, axes in zip(self.trials, self._bases, strict=True):
            by_name.setdefault(trial.suspect.name, []).append(axes[:: 1 + len(axes) // ROWS])
        return {name: looks_of(every) for name, every in by_name.items()}

    def _left(self, without: Suspect | None) -> tuple[Array, Array]:
        """Residuals, and a basis of what the shared parameters absorb: as they are, or with a named effect taken away.

        To first order.
        """
        left = self._stacked([r[:, None] for r in self.now.residuals])[:, 0]
        names = self.now.names
        gone = [] if without is None else [k for k, n in enumerate(names) if n in without.strengths + without.shapes]
        for k in gone:
            if without is not None and names[k] in without.strengths:
                left = left + self._shared[:, k] * self.now.model.value(names[k])
        kept = basis(np.delete(self._shared, gone, axis=1))
        return left - kept @ (kept.T @ left), kept

    def chi2(self, without: Suspect | None = None) -> float:
        """What is left when all is fitted again, a named effect taken away if one is given, to first order."""
        left, _ = self._left(without)
        return float(left @ left)

    def signature(self, named: Suspect) -> Array:
        """Of a named effect's strengths, as a Candidate's: less all that the rest of the fit absorbs."""
        names = self.now.names
        own = [names.index(s) for s in named.strengths]
        rest = [k for k, n in enumerate(names) if n not in named.strengths + named.shapes]
        kept = basis(self._shared[:, rest])
        return np.asarray(self._shared[:, own] - kept @ (kept.T @ self._shared[:, own]))

    def sharper(self, evidence: Evidence, candidate: Candidate, without: Suspect | None = None) -> Candidate:
        """The candidate with shapes that score better, looked for between those tried."""
        suspect, model = candidate.suspect, self.now.model
        if not candidate.shapes:
            return candidate
        left, absorbed = self._left(without)
        plain, launches = uncoupled(model), self.now.launches
        here = forecast(plain, launches, evidence.clips)
        for closer in range(ZOOMS):
            for name in suspect.shapes:
                for value in between(parameter_of(model, name), candidate.shapes[name], closer):
                    trial = tried(evidence, plain, launches, suspect, candidate.shapes | {name: value}, here)
                    scored = self._score(trial, self._stacked(trial.columns), absorbed, left)
                    candidate = max(candidate, scored, key=lambda c: c.gain)
        return candidate

    def ranking(self, without: Suspect | None = None) -> tuple[Candidate, ...]:
        """The best of each suspect, most significant first; with a named effect taken away if one is given."""
        if not self.trials:
            return ()
        left, absorbed = self._left(without)
        best: dict[str, Candidate] = {}
        for trial, cleaned in zip(self.trials, self._cleaned, strict=True):
            scored = self._score(trial, cleaned, absorbed, left)
            known = best.get(trial.suspect.name)
            if known is None or (scored.sigma, -scored.limit) > (known.sigma, -known.limit):
                best[trial.suspect.name] = scored
        return tuple(sorted(best.values(), key=lambda c: -c.sigma))

    def _score(self, trial: Trial, cleaned: Array, absorbed: Array, left: Array) -> Candidate:
        """The score of one trial; directions that the fit absorbs, as it does a wrong clock, count for nothing.

        A strength that has one sign scores nothing when the data ask for the other.
        """
        signature = cleaned - absorbed @ (absorbed.T @ cleaned)
        length = _lengths(trial.columns)
        axes, spread = _axes(signature, length)
        suspect, model = trial.suspect, self.now.model
        pulls = axes.T @ (signature.T @ left)
        chi2 = float(pulls @ pulls)
        if len(suspect.strengths) == 1 and _forbidden(suspect, self.now, float((signature.T @ left)[0])):
            chi2 = 0.0
        ways = [parameter_of(model, s) for s in suspect.strengths]
        sizes = np.array([p.scale or 1.0 for p in ways])
        limit = LIMIT / max(float((sizes * np.linalg.norm(signature, axis=0)).max()), 1e-300) if spread else np.inf
        allowed = max(max(abs(p.low), abs(p.high)) / size for p, size in zip(ways, sizes, strict=True))
        return Candidate(
            suspect,
            trial.shapes,
            sigmas(chi2, spread, self.looks.get(suspect.name, 1.0)) if spread else 0.0,
            chi2,
            limit,
            limit <= min(UNSEEN, allowed),
            signature @ axes,
            trial.columns,
        )

    def claim(self, level: float = LEVEL) -> float:
        """The sigma that the best candidate exceeds by chance in a share `level` of searches."""
        if not self.trials:
            return 0.0
        sides = [_side(t.suspect, self.now) if len(t.suspect.strengths) == 1 else 0 for t in self.trials]
        every = [axes * (side or 1) for axes, side in zip(self._bases, sides, strict=True)]
        looks = [self.looks[t.suspect.name] for t in self.trials]
        return by_chance(every, [side != 0 for side in sides], level, looks)


def tried(
    evidence: Evidence,
    model: Model,
    launches: Array,
    suspect: Suspect,
    shapes: dict[str, float],
    here: Sequence[Array],
) -> Trial:
    """here: the forecast of the model."""
    bent = model.replace(shapes)
    slopes = [derivative(bent, launches, evidence.clips, s, here) for s in suspect.strengths]
    columns = [np.stack([s[k] for s in slopes], axis=-1) for k in range(len(here))]
    return Trial(suspect, shapes, tuple(white(c) for white, c in zip(evidence.whiteners, columns, strict=True)))


def _scanned(
    evidence: Evidence, model: Model, launches: Array, suspect: Suspect, grid: Sequence[dict[str, float]]
) -> list[Trial]:
    """Those of many shapes that show at all, or the first. Of very many clips fewer shapes are tried, for memory."""
    numbers = sum(2 * len(c.frame) for c in evidence.clips) * len(suspect.strengths)
    grid = grid[:: 1 + numbers * len(grid) // MOST]
    every = scanned(model, launches, evidence.clips, suspect, grid)
    white = evidence.white([e.reshape(*e.shape[:2], -1) for e in every])
    parts = [np.split(w, len(grid), axis=1) for w in white]
    trials = [Trial(suspect, shapes, columns) for shapes, columns in zip(grid, zip(*parts, strict=True), strict=True)]
    return [t for t in trials if any(c.any() for c in t.columns)] or trials[:1]


def rank(evidence: Evidence, now: Fit, tick: Callable[[], None] = lambda: None) -> tuple[Candidate, ...]:
    """Rao's score test of every effect whose strengths the fit has not fitted; most significant first."""
    return Contest.of(evidence, now, tick).ranking()


def _lengths(columns: Sequence[Array]) -> Array:
    """Of the derivative before the fit took its part, (k,)."""
    return np.asarray(np.sqrt(sum((c**2).sum(axis=0) for c in columns)))


def _axes(signature: Array, length: Array) -> tuple[Array, int]:
    """(k, m) that makes an orthonormal basis of the signature's columns, and m: in directions that are seen."""
    scale = np.where(length > 0, length, 1)
    unit = signature / scale
    values, axes = np.linalg.eigh(unit.T @ unit)
    seen = values > SEEN**2
    return axes[:, seen] / np.sqrt(values[seen]) / scale[:, None], int(seen.sum())


def _side(suspect: Suspect, now: Fit) -> int:
    """1 where a single strength stands at its lower limit and can only grow, -1 at its upper, else 0."""
    value, (low, high) = now.model.value(suspect.strengths[0]), limits_of(now.model, suspect.strengths[0])
    return int(value <= low) - int(value >= high)


def _forbidden(suspect: Suspect, now: Fit, pull: float) -> bool:
    return _side(suspect, now) * pull < 0


def likeness(one: Array, other: Array) -> float:
    """The largest cosine between the spans of two signatures."""
    a, b = basis(one), basis(other)
    return float(np.linalg.svd(a.T @ b, compute_uv=False).max()) if a.size and b.size else 0.0
