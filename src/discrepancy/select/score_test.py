"""Score tests of all candidates from one fit: what each would explain, were it added or put in another's place."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from discrepancy.arrays import Array
from discrepancy.fitting.jacobian import decouple, differentiate
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips, orthonormal_basis
from discrepancy.fitting.parameters import Candidate, find_parameter, list_candidates, refine_tried_values
from discrepancy.fitting.shape_scan import can_scan, scan_shapes
from discrepancy.fitting.significance import chance_threshold, chi2_to_sigma, count_trials
from discrepancy.policy import current_policy
from synthcam.model import Model


@dataclass(frozen=True)
class RealisticSizes:
    """Realistic sizes (k,) of a candidate's strengths, and how many of them its limits allow.

    side: 1 where a single strength stands at its lower limit and can only grow, -1 at its upper, else 0.
    """

    sizes: Array
    allowed: float
    side: int

    @classmethod
    def of(cls, candidate: Candidate, model: Model) -> RealisticSizes:
        """Of a candidate beside this model."""
        ways = [find_parameter(model, s) for s in candidate.strengths]
        sizes = np.array([p.typical or 1.0 for p in ways])
        allowed = max(max(abs(p.low), abs(p.high)) / size for p, size in zip(ways, sizes, strict=True))
        value, p = model.value(candidate.strengths[0]), ways[0]
        side = int(value <= p.low) - int(value >= p.high) if len(ways) == 1 else 0
        return cls(sizes, allowed, side)


@dataclass(frozen=True)
class CandidateScore:
    """A candidate with its score test.

    Attributes
    ----------
    candidate : Candidate
    shapes : dict of str to float
        The best values tried of its shape parameters, for whose number sigma is corrected.
    sigma : float
    gain : float
        The chi^2 that adding it would take, to first order.
    limit : float
        The detection limit, in realistic sizes of the strength that shows best; infinite where the fit absorbs all.
    identifiable : bool
        False where that limit is absurd, or more than the effect allows.
    signature : (points, m) array
        The derivative at zero strength less all that the fit absorbs, made orthonormal; m <= k directions are seen.
    columns : tuple of (2n, k) arrays
        The derivative of each clip's whitened forecast, before anything is taken out.
    """

    candidate: Candidate
    shapes: dict[str, float]
    sigma: float
    gain: float
    limit: float
    identifiable: bool
    signature: Array
    columns: tuple[Array, ...]

    @property
    def absorbed(self) -> bool:
        """Whether it moves the tracks, but only as the fit's own parameters and launches can."""
        return self.signature.shape[1] == 0 and any(c.any() for c in self.columns)

    @property
    def effect(self) -> str:
        return self.candidate.name

    @property
    def strengths(self) -> tuple[str, ...]:
        return self.candidate.strengths


@dataclass(frozen=True)
class CandidateTrial:
    """A candidate with values of its shape parameters, and the derivatives by its strengths, (2n, k) of each clip."""

    candidate: Candidate
    shapes: dict[str, float]
    columns: tuple[Array, ...]


@dataclass(frozen=True)
class TrialScore:
    """The score of a trial, as in `CandidateScore`. axes (k, m): its signature times these is an orthonormal basis."""

    trial: CandidateTrial
    sigma: float
    gain: float
    limit: float
    identifiable: bool
    axes: Array

    @property
    def order(self) -> tuple[bool, float, float]:
        """The key to sort scores by, the best first."""
        return not self.identifiable, -self.sigma, self.limit

    def scored(self, signature: Array) -> CandidateScore:
        """The candidate as scored. signature (points, k): the trial's columns less all that the fit absorbs."""
        columns = tuple(np.array(c) for c in self.trial.columns)  # no views, which would keep all trials alive
        return CandidateScore(
            self.trial.candidate,
            self.trial.shapes,
            self.sigma,
            self.gain,
            self.limit,
            self.identifiable,
            signature @ self.axes,
            columns,
        )


@dataclass(frozen=True)
class ScoreTests:
    """The score tests of candidates beside one fit.

    Attributes
    ----------
    fit : Fit
        What the candidates would be added to.
    trials : tuple of CandidateTrial
        Every candidate with each value tried of its shape parameters.
    """

    fit: ModelFit
    trials: tuple[CandidateTrial, ...]

    @classmethod
    def of(
        cls,
        evidence: WhitenedClips,
        fit: ModelFit,
        progress: Callable[[], None] = lambda: None,
        only: Sequence[Candidate] = (),
        about: Model | None = None,
    ) -> ScoreTests:
        """Take the derivatives by the strengths of every candidate, at all values of its shape parameters.

        Parameters
        ----------
        evidence : Evidence
        fit : Fit
        progress : callable
            Told of progress.
        only : sequence of Candidate
            Default: the library's effects and the base parameters held at zero.
        about : Model, optional
            A model near the fit's to take the derivatives about; default: the fit's. Where balls push each other the
            motion takes some eight times as long, and derivatives are taken without that push.

        Returns
        -------
        ScoreTests
        """
        (plain, here), trials = decouple(about or fit.model, fit.launches, evidence.clips), []
        for candidate in only or list_candidates(fit.model, fit.names):
            grid = list(candidate.grid(fit.model))
            if can_scan(candidate, grid):
                trials += _scanned(evidence, plain, fit.launches, candidate, grid, here)
            else:
                trials += [derive_trial(evidence, plain, fit.launches, candidate, shapes, here) for shapes in grid]
            progress()
        return cls(fit, tuple(trials))

    @property
    def numbers(self) -> int:
        """How many numbers all derivatives hold: their memory."""
        return sum(c.size for t in self.trials for c in t.columns)

    def _stacked(self, columns: Sequence[Array]) -> Array:
        """Columns of every clip less what the launches absorb, stacked."""
        return np.concatenate(
            [c - q @ (q.T @ c) for q, c in zip(self.fit.linearisation.launch_bases, columns, strict=True)]
        )

    @cached_property
    def _shared(self) -> Array:
        return self._stacked(self.fit.slopes)

    @cached_property
    def _spans(self) -> list[slice]:
        """Of each trial, its columns among those of all trials."""
        ends = np.cumsum([t.columns[0].shape[1] for t in self.trials]).tolist()
        return [slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True)]

    def _every(self) -> Iterator[Array]:
        """Of each clip the columns of all trials, (2n, K)."""
        return (np.concatenate(c, axis=1) for c in zip(*(t.columns for t in self.trials), strict=True))

    @cached_property
    def _products(self) -> tuple[Array, Array, Array]:
        """Of all trials' columns less what the launches absorb: products (K, K), and some rows; and whole lengths (K,).

        All that is asked of a trial but the best: a second copy of the columns would take more memory than all else.
        """
        count, step = self._spans[-1].stop, self._step
        gram, squares, rows, first = np.zeros((count, count)), np.zeros(count), [], 0
        for q, columns in zip(self.fit.linearisation.launch_bases, self._every(), strict=True):
            squares += np.einsum("nk,nk->k", columns, columns)
            columns -= q @ (q.T @ columns)
            gram += columns.T @ columns
            rows.append(columns[-first % step :: step])
            first += len(columns)
        return gram, np.concatenate(rows), np.sqrt(squares)

    @property
    def _step(self) -> int:
        """Every so many rows count independent trials: some 1500 suffice."""
        return 1 + self.fit.points // 1500

    def _against(self, absorbed: Array, left: Array) -> tuple[Array, Array, Array]:
        """Products of all trials' signatures with themselves (K, K), with `left` (K,), and of columns with `absorbed`.

        Neither `left` nor what is `absorbed` has a part in the launches' span.
        """
        cuts = np.cumsum([len(r) for r in self.fit.residuals])[:-1]
        both = np.split(np.column_stack([absorbed, left]), cuts)
        every = np.asarray(sum(b.T @ columns for b, columns in zip(both, self._every(), strict=True)))
        return self._products[0] - every[:-1].T @ every[:-1], every[-1], every[:-1]

    @cached_property
    def _bases(self) -> tuple[Array, list[Array]]:
        """Products of all trials' signatures, each made an orthonormal basis; and of each basis some rows."""
        left, absorbed = self._left(None)
        _, rows, lengths = self._products
        gram, _, taken = self._against(absorbed, left)
        axes = [detectable_axes(gram[s, s], lengths[s]) for s in self._spans]
        rows = rows - absorbed[:: self._step] @ taken
        whole = block_diag(*axes)
        return whole.T @ gram @ whole, [rows[:, s] @ a for s, a in zip(self._spans, axes, strict=True)]

    @cached_property
    def trials_factors(self) -> dict[str, float]:
        """The trials factor of the shape parameters tried of each candidate, by its name."""
        by_name: dict[str, list[Array]] = {}
        for trial, rows in zip(self.trials, self._bases[1], strict=True):
            by_name.setdefault(trial.candidate.name, []).append(rows)
        return {name: count_trials(every) for name, every in by_name.items()}

    def _left(self, without: Candidate | None) -> tuple[Array, Array]:
        """Residuals (points,) and a basis of what the shared parameters absorb (points, p), launches taken out of both.

        As they are, or to first order with a named effect taken away.
        """
        left = self._stacked([r[:, None] for r in self.fit.residuals])[:, 0]
        names = self.fit.names
        gone = [] if without is None else [k for k, n in enumerate(names) if n in without.strengths + without.shapes]
        for k in gone:
            if without is not None and names[k] in without.strengths:
                held = dict(zip(without.strengths, without.held, strict=False)).get(names[k], 0.0)
                left = left + self._shared[:, k] * (self.fit.model.value(names[k]) - held)
        kept = orthonormal_basis(np.delete(self._shared, gone, axis=1))
        return left - kept @ (kept.T @ left), kept

    def chi2(self, without: Candidate | None = None) -> float:
        """The chi^2 of the fit, or to first order of the fit again without a named effect."""
        left, _ = self._left(without)
        return float(left @ left)

    def signature(self, named: Candidate) -> Array:
        """The derivatives (points, k) by a named effect's strengths, less all that the rest of the fit absorbs."""
        names = self.fit.names
        own = [names.index(s) for s in named.strengths]
        rest = [k for k, n in enumerate(names) if n not in named.strengths + named.shapes]
        kept = orthonormal_basis(self._shared[:, rest])
        return np.asarray(self._shared[:, own] - kept @ (kept.T @ self._shared[:, own]))

    def sharper(
        self, evidence: WhitenedClips, scored: CandidateScore, without: Candidate | None = None
    ) -> CandidateScore:
        """Look for better shape parameters of a candidate between those tried.

        Parameters
        ----------
        evidence : Evidence
        scored : CandidateScore
            As of `ranking`.
        without : Candidate, optional
            A named effect to take away first.

        Returns
        -------
        CandidateScore
            The same candidate, with the best shape parameters found.
        """
        candidate, model = scored.candidate, self.fit.model
        if not scored.shapes:
            return scored
        left, absorbed = self._left(without)
        launches = self.fit.launches
        plain, here = decouple(model, launches, evidence.clips)
        for closer in range(2):  # the grid of a shape parameter is made finer twice
            for name in candidate.shapes:
                for value in refine_tried_values(find_parameter(model, name), scored.shapes[name], closer):
                    trial = derive_trial(evidence, plain, launches, candidate, scored.shapes | {name: value}, here)
                    columns = self._stacked(trial.columns)
                    signature = columns - absorbed @ (absorbed.T @ columns)
                    score = self._score(trial, signature.T @ signature, signature.T @ left, _lengths(trial.columns))
                    if score.gain > scored.gain:
                        scored = score.scored(signature)
        return scored

    def ranking(self, without: Candidate | None = None) -> tuple[CandidateScore, ...]:
        """Each candidate with the best of its shape parameters, most significant first.

        Candidates that are not identifiable come last however well they score: what the fit absorbs of them up to first
        order may leave a remainder that scores by chance.

        Parameters
        ----------
        without : Candidate, optional
            A named effect to take away first: what could take its place?

        Returns
        -------
        tuple of CandidateScore
        """
        if not self.trials:
            return ()
        left, absorbed = self._left(without)
        gram, pulls, _ = self._against(absorbed, left)
        lengths, best = self._products[2], dict[str, TrialScore]()
        for trial, s in zip(self.trials, self._spans, strict=True):
            score = self._score(trial, gram[s, s], pulls[s], lengths[s])
            known = best.get(trial.candidate.name)
            if known is None or score.order < known.order:
                best[trial.candidate.name] = score
        found = []
        for score in sorted(best.values(), key=lambda c: c.order):
            columns = self._stacked(score.trial.columns)
            found.append(score.scored(columns - absorbed @ (absorbed.T @ columns)))
        return tuple(found)

    def leaders(self, claim: float) -> tuple[CandidateScore, ...]:
        """The candidates that a search may add, most significant first.

        Weakly identifiable candidates are considered only if no identifiable one is significant: a refit may tell more.
        """
        ranking = self.ranking()
        told = tuple(c for c in ranking if c.identifiable)
        return told if told and told[0].sigma > claim else tuple(sorted(ranking, key=lambda c: -c.sigma))

    def estimates(self) -> list[tuple[dict[str, float], float, Array]]:
        """Of each trial its shape parameters, the chi^2 that it takes, and its strengths (k,), all to first order."""
        left, absorbed = self._left(None)
        gram, pulls, _ = self._against(absorbed, left)
        found = []
        for trial, s in zip(self.trials, self._spans, strict=True):
            score = self._score(trial, gram[s, s], pulls[s], self._products[2][s])
            strengths = score.axes @ (score.axes.T @ pulls[s])
            found.append((trial.shapes, score.gain, strengths if score.gain else 0 * strengths))
        return found

    def _score(self, trial: CandidateTrial, gram: Array, pull: Array, length: Array) -> TrialScore:
        """The score of one trial; directions that the fit absorbs, as it does a wrong clock, count for nothing.

        gram (k, k), pull (k,): products of its signature with itself and the residuals; length (k,) of its columns. A
        strength that has one sign scores nothing when the data ask for the other.
        """
        axes = detectable_axes(gram, length)
        spread = axes.shape[1]
        candidate, way = trial.candidate, self._ways[trial.candidate]
        chi2 = float(((axes.T @ pull) ** 2).sum())
        if way.side * pull[0] < 0:
            chi2 = 0.0
        seen = float((way.sizes * np.sqrt(np.diag(gram).clip(0))).max())
        limit = current_policy().detection_limit_sigma / max(seen, 1e-300) if spread else np.inf
        sigma = chi2_to_sigma(chi2, spread, self.trials_factors.get(candidate.name, 1.0)) if spread else 0.0
        return TrialScore(
            trial, sigma, chi2, limit, limit <= min(current_policy().max_detection_limit, way.allowed), axes
        )

    @cached_property
    def _ways(self) -> dict[Candidate, RealisticSizes]:
        return {
            candidate: RealisticSizes.of(candidate, self.fit.model) for candidate in {t.candidate for t in self.trials}
        }

    def claim(self, level: float | None = None) -> float:
        """The sigma that the best candidate exceeds by chance in a share of searches, by default that of a claim."""
        if not self.trials:
            return 0.0
        gram, rows = self._bases
        sides = [self._ways[t.candidate].side for t in self.trials]
        signs = np.concatenate([np.full(r.shape[1], side or 1) for r, side in zip(rows, sides, strict=True)])
        trials_factors = [self.trials_factors[t.candidate.name] for t in self.trials]
        sizes = [r.shape[1] for r in rows]
        return chance_threshold(
            gram * np.outer(signs, signs), sizes, [side != 0 for side in sides], level, trials_factors
        )


def derive_trial(
    evidence: WhitenedClips,
    model: Model,
    launches: Array,
    candidate: Candidate,
    shapes: dict[str, float],
    here: Sequence[Array],
) -> CandidateTrial:
    """Take the derivatives by a candidate's strengths, with these values of its shape parameters.

    Parameters
    ----------
    evidence : Evidence
    model : Model
        Without the candidate.
    launches : (clips, p) array
    candidate : Candidate
    shapes : dict of str to float
    here : sequence of (n, 2) array
        The forecast of the model for each clip, m.

    Returns
    -------
    CandidateTrial
        Its columns whitened.
    """
    bent = model.replace(shapes)
    slopes = [differentiate(bent, launches, evidence.clips, s, here) for s in candidate.strengths]
    columns = [np.stack([s[k] for s in slopes], axis=-1) for k in range(len(here))]
    return CandidateTrial(
        candidate, shapes, tuple(white(c) for white, c in zip(evidence.whiteners, columns, strict=True))
    )


def _scanned(
    evidence: WhitenedClips,
    model: Model,
    launches: Array,
    candidate: Candidate,
    grid: Sequence[dict[str, float]],
    here: Sequence[Array],
    max_numbers: int = 20_000_000,
) -> list[CandidateTrial]:
    """`tried` at many values of the shape parameters at once, by integrals over the motion (`shape_scan`).

    Only values at which the strengths move any track are kept, or else the first. With very many clips only some of the
    values are tried, so that no more than `max_numbers` are held in memory.
    """
    numbers = sum(2 * len(c.frame) for c in evidence.clips) * len(candidate.strengths)
    grid = grid[:: 1 + numbers * len(grid) // max_numbers]
    every = scan_shapes(model, launches, evidence.clips, candidate, grid, here)
    shown = np.flatnonzero(np.any([e.any(axis=(0, 1, 3)) for e in every], axis=0))
    kept = shown.tolist() or [0]
    both = zip(evidence.whiteners, every, strict=True)
    white = [whiten(e[:, :, kept].reshape(*e.shape[:2], -1)) for whiten, e in both]
    parts = [np.split(w, len(kept), axis=1) for w in white]
    return [
        CandidateTrial(candidate, grid[k], columns) for k, columns in zip(kept, zip(*parts, strict=True), strict=True)
    ]


def _lengths(columns: Sequence[Array]) -> Array:
    """The lengths (k,) of columns (2n, k) of each clip, stacked."""
    return np.asarray(np.sqrt(sum((c**2).sum(axis=0) for c in columns)))


def detectable_axes(gram: Array, length: Array, min_share: float = 1e-4) -> Array:
    """(k, m) that makes an orthonormal basis of the m directions of a signature that are seen; gram: its products."""
    scale = np.where(length > 0, length, 1)
    values, axes = np.linalg.eigh(gram / np.outer(scale, scale))
    seen = values > min_share**2
    return np.asarray(axes[:, seen] / np.sqrt(values[seen]) / scale[:, None])


def largest_cosine(one: Array, other: Array) -> float:
    """The largest cosine between the spans of two signatures."""
    a, b = orthonormal_basis(one), orthonormal_basis(other)
    return float(np.linalg.svd(a.T @ b, compute_uv=False).max()) if a.size and b.size else 0.0
