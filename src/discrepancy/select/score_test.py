"""Score tests from one fit: the chi^2 that each candidate would explain if added, or exchanged for another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from discrepancy.fitting.jacobian import differentiate_tracks, drop_mutual_push
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips, orthonormal_basis
from discrepancy.fitting.parameters import Candidate, find_parameter, list_candidates, refine_tried_values
from discrepancy.fitting.shape_scan import can_scan, scan_shapes
from discrepancy.fitting.significance import chance_threshold, chi2_to_sigma, count_trials
from discrepancy.policy import current_policy
from synthcam.model import Model
from synthcam_shared.arrays import Array


@dataclass(frozen=True)
class RealisticSizes:
    """Realistic sizes (k,) of a candidate's strengths, and the largest multiple that its limits allow.

    side: 1 if a single strength is at its lower limit and can only grow, -1 at its upper limit, else 0.
    """

    sizes: Array
    allowed: float
    side: int

    @classmethod
    def of(cls, candidate: Candidate, model: Model) -> RealisticSizes:
        """Look up the sizes of a candidate beside this model."""
        parameters = [find_parameter(model, s) for s in candidate.strengths]
        sizes = np.array([p.typical or 1.0 for p in parameters])
        allowed = max(max(abs(p.low), abs(p.high)) / size for p, size in zip(parameters, sizes, strict=True))
        value, p = model.value(candidate.strengths[0]), parameters[0]
        side = int(value <= p.low) - int(value >= p.high) if len(parameters) == 1 else 0
        return cls(sizes, allowed, side)


@dataclass(frozen=True)
class CandidateScore:
    """A candidate with its score test."""

    candidate: Candidate
    # The best tried values of its shape parameters. Sigma is corrected for the number of trials.
    shapes: dict[str, float]
    sigma: float
    gain: float  # the decrease of chi^2 if it is added, to first order
    # the detection limit, in realistic sizes of the strength that shows best; infinite if the fit absorbs all
    limit: float
    identifiable: bool  # false if that limit is unrealistic, or larger than the effect allows
    # (points, m): the derivative at zero strength less all that the fit absorbs, made orthonormal; m <= k directions
    signature: Array
    columns: tuple[Array, ...]  # (2n, k): the derivative of each clip's whitened prediction, with nothing removed

    @property
    def absorbed(self) -> bool:
        """True if it moves the tracks, but only as the fit's own parameters and launches can."""
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
        """The sort key of scores, the best first."""
        return not self.identifiable, -self.sigma, self.limit

    def scored(self, signature: Array) -> CandidateScore:
        """Make the candidate's score. signature (points, k): the trial's columns less all that the fit absorbs."""
        columns = tuple(np.array(c) for c in self.trial.columns)  # no views, which would keep all trials alive
        tested, own = self.trial, signature @ self.axes
        numbers = self.sigma, self.gain, self.limit, self.identifiable
        return CandidateScore(tested.candidate, tested.shapes, *numbers, own, columns)


@dataclass(frozen=True)
class ScoreTests:
    """The score tests of candidates beside one fit."""

    fit: ModelFit
    trials: tuple[CandidateTrial, ...]

    @classmethod
    def of(
        cls, evidence: WhitenedClips, fit: ModelFit, only: Sequence[Candidate] = (), about: Model | None = None
    ) -> ScoreTests:
        """Take the derivatives by the strengths of every candidate, at all values of its shape parameters.

        only: the candidates; default: the library's effects and the base parameters held at zero.

        about: a model near the fit's, at which to take the derivatives; default: the fit's. If balls push each other,
        the motion takes some eight times as long to compute. The derivatives are then taken without that push.
        """
        (plain, here), trials = drop_mutual_push(about or fit.model, fit.launches, evidence.clips), []
        for candidate in only or list_candidates(fit.model, fit.names):
            grid = list(candidate.grid(fit.model))
            if can_scan(candidate, grid):
                trials += _scanned(evidence, plain, fit.launches, candidate, grid, here)
            else:
                trials += [prepare_trial(evidence, plain, fit.launches, candidate, shapes, here) for shapes in grid]
        return cls(fit, tuple(trials))

    @property
    def numbers(self) -> int:
        """The count of numbers in all derivatives, as a measure of memory."""
        return sum(c.size for t in self.trials for c in t.columns)

    def _stacked(self, columns: Sequence[Array]) -> Array:
        """Stack the columns of every clip, less the part that the launches absorb."""
        return np.concatenate(
            [c - q @ (q.T @ c) for q, c in zip(self.fit.linearisation.launch_bases, columns, strict=True)]
        )

    @cached_property
    def _shared(self) -> Array:
        return self._stacked(self.fit.slopes)

    @cached_property
    def _spans(self) -> list[slice]:
        """The columns of each trial among those of all trials."""
        ends = np.cumsum([t.columns[0].shape[1] for t in self.trials]).tolist()
        return [slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True)]

    def _every(self) -> Iterator[Array]:
        """Yield the columns of all trials, (2n, K), for each clip."""
        return (np.concatenate(c, axis=1) for c in zip(*(t.columns for t in self.trials), strict=True))

    @cached_property
    def _products(self) -> tuple[Array, Array, Array]:
        """Products (K, K), some rows and lengths (K,) of all columns less the launches' part, without a copy."""
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
        """The step between the rows that count independent trials: some 1500 rows suffice."""
        return 1 + self.fit.points // 1500

    def _against(self, absorbed: Array, left: Array) -> tuple[Array, Array, Array]:
        """Products of signatures with themselves and `left`, and of columns with `absorbed`, both off the launches."""
        cuts = np.cumsum([len(r) for r in self.fit.residuals])[:-1]
        both = np.split(np.column_stack([absorbed, left]), cuts)
        every = np.asarray(sum(b.T @ columns for b, columns in zip(both, self._every(), strict=True)))
        return self._products[0] - every[:-1].T @ every[:-1], every[-1], every[:-1]

    @cached_property
    def _bases(self) -> tuple[Array, list[Array]]:
        """Make the signature of each trial an orthonormal basis; return their products and some rows of each."""
        left, absorbed = self._left(None)
        _, rows, lengths = self._products
        gram, _, taken = self._against(absorbed, left)
        axes = [detectable_axes(gram[s, s], lengths[s]) for s in self._spans]
        rows = rows - absorbed[:: self._step] @ taken
        whole = block_diag(*axes)
        return whole.T @ gram @ whole, [rows[:, s] @ a for s, a in zip(self._spans, axes, strict=True)]

    @cached_property
    def trials_factors(self) -> dict[str, float]:
        """The trials factor of the shape parameters of each candidate, by its name."""
        by_name: dict[str, list[Array]] = {}
        for trial, rows in zip(self.trials, self._bases[1], strict=True):
            by_name.setdefault(trial.candidate.name, []).append(rows)
        return {name: count_trials(every) for name, every in by_name.items()}

    def _left(self, without: Candidate | None) -> tuple[Array, Array]:
        """Residuals and a basis of the shared parameters, less the launches' part, with or without an effect."""
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
        """The chi^2 of the fit or, to first order, of the fit without an effect."""
        left, _ = self._left(without)
        return float(left @ left)

    def signature(self, named: Candidate) -> Array:
        """The derivatives (points, k) by an effect's strengths, less all that the rest of the fit absorbs."""
        names = self.fit.names
        own = [names.index(s) for s in named.strengths]
        rest = [k for k, n in enumerate(names) if n not in named.strengths + named.shapes]
        kept = orthonormal_basis(self._shared[:, rest])
        return np.asarray(self._shared[:, own] - kept @ (kept.T @ self._shared[:, own]))

    def sharper(
        self, evidence: WhitenedClips, scored: CandidateScore, without: Candidate | None = None
    ) -> CandidateScore:
        """Search for better shape parameters between the grid values; without: an effect to remove first."""
        candidate, model = scored.candidate, self.fit.model
        if not scored.shapes:
            return scored
        left, absorbed = self._left(without)
        launches = self.fit.launches
        plain, here = drop_mutual_push(model, launches, evidence.clips)
        for closer in range(2):  # the grid of a shape parameter is made finer twice
            for name in candidate.shapes:
                for value in refine_tried_values(find_parameter(model, name), scored.shapes[name], closer):
                    trial = prepare_trial(evidence, plain, launches, candidate, scored.shapes | {name: value}, here)
                    columns = self._stacked(trial.columns)
                    length = np.sqrt(sum((c**2).sum(axis=0) for c in trial.columns))
                    signature = columns - absorbed @ (absorbed.T @ columns)
                    score = self._score(trial, signature.T @ signature, signature.T @ left, length)
                    if score.gain > scored.gain:
                        scored = score.scored(signature)
        return scored

    def ranking(self, without: Candidate | None = None) -> tuple[CandidateScore, ...]:
        """Each candidate with the best of its shape parameters, most significant first.

        Candidates that are not identifiable come last, however well they score. The fit absorbs them to first order,
        and the remainder may score by chance.

        without: an effect of the fit to remove first. The ranking then shows what could replace it.
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
        """The candidates that a search may add, the best first; weakly identifiable ones if no other is significant."""
        ranking = self.ranking()
        identifiable = tuple(c for c in ranking if c.identifiable)
        significant = bool(identifiable) and identifiable[0].sigma > claim
        return identifiable if significant else tuple(sorted(ranking, key=lambda c: -c.sigma))

    def estimates(self) -> list[tuple[dict[str, float], float, Array]]:
        """Shape parameters, decrease of chi^2, and strengths (k,) of each trial, to first order."""
        left, absorbed = self._left(None)
        gram, pulls, _ = self._against(absorbed, left)
        found = []
        for trial, s in zip(self.trials, self._spans, strict=True):
            score = self._score(trial, gram[s, s], pulls[s], self._products[2][s])
            strengths = score.axes @ (score.axes.T @ pulls[s])
            found.append((trial.shapes, score.gain, strengths if score.gain else 0 * strengths))
        return found

    def _score(self, trial: CandidateTrial, gram: Array, pull: Array, length: Array) -> TrialScore:
        """Score one trial. Directions that the fit absorbs do not count, as with a wrong clock.

        gram (k, k) and pull (k,) are the products of its signature with itself and with the residuals; length (k,) is
        that of its columns. A strength of one sign scores zero if the data ask for the other sign.
        """
        axes = detectable_axes(gram, length)
        spread = axes.shape[1]
        candidate, realistic = trial.candidate, self._realistic_sizes[trial.candidate]
        chi2 = float(((axes.T @ pull) ** 2).sum())
        if realistic.side * pull[0] < 0:
            chi2 = 0.0
        seen = float((realistic.sizes * np.sqrt(np.diag(gram).clip(0))).max())
        limit = current_policy().detection_limit_sigma / max(seen, 1e-300) if spread else np.inf
        sigma = chi2_to_sigma(chi2, spread, self.trials_factors.get(candidate.name, 1.0)) if spread else 0.0
        return TrialScore(
            trial, sigma, chi2, limit, limit <= min(current_policy().max_detection_limit, realistic.allowed), axes
        )

    @cached_property
    def _realistic_sizes(self) -> dict[Candidate, RealisticSizes]:
        return {c: RealisticSizes.of(c, self.fit.model) for c in dict.fromkeys(t.candidate for t in self.trials)}

    def claim(self, level: float | None = None) -> float:
        """The sigma that the best candidate exceeds by chance in this share of searches; default: the policy's."""
        if not self.trials:
            return 0.0
        gram, rows = self._bases
        sides = [self._realistic_sizes[t.candidate].side for t in self.trials]
        signs = np.concatenate([np.full(r.shape[1], side or 1) for r, side in zip(rows, sides, strict=True)])
        trials_factors = [self.trials_factors[t.candidate.name] for t in self.trials]
        sizes = [r.shape[1] for r in rows]
        return chance_threshold(
            gram * np.outer(signs, signs), sizes, [side != 0 for side in sides], level, trials_factors
        )


def prepare_trial(
    evidence: WhitenedClips,
    model: Model,
    launches: Array,
    candidate: Candidate,
    shapes: dict[str, float],
    here: Sequence[Array],
) -> CandidateTrial:
    """Prepare the score test of a candidate: the derivatives by its strengths, at these values of its shape parameters.

    model: without the candidate; here: its prediction (n, 2) for each clip, m.
    """
    bent = model.replace(shapes)
    slopes = [differentiate_tracks(bent, launches, evidence.clips, s, here) for s in candidate.strengths]
    columns = [np.stack([s[k] for s in slopes], axis=-1) for k in range(len(here))]
    return CandidateTrial(candidate, shapes, evidence.whiten(columns))


def _scanned(
    evidence: WhitenedClips,
    model: Model,
    launches: Array,
    candidate: Candidate,
    grid: Sequence[dict[str, float]],
    here: Sequence[Array],
    max_numbers: int = 20_000_000,
) -> list[CandidateTrial]:
    """Do `prepare_trial` at many shapes at once (`shape_scan`), and keep those that move a track."""
    numbers = sum(2 * len(c.frame) for c in evidence.clips) * len(candidate.strengths)
    grid = grid[:: 1 + numbers * len(grid) // max_numbers]
    every = scan_shapes(model, launches, evidence.clips, candidate, grid, here)
    shown = np.flatnonzero(np.any([e.any(axis=(0, 1, 3)) for e in every], axis=0))
    kept = shown.tolist() or [0]
    white = evidence.whiten([e[:, :, kept].reshape(*e.shape[:2], -1) for e in every])
    parts = [np.split(w, len(kept), axis=1) for w in white]
    return [
        CandidateTrial(candidate, grid[k], columns) for k, columns in zip(kept, zip(*parts, strict=True), strict=True)
    ]


def detectable_axes(gram: Array, length: Array, min_share: float = 1e-4) -> Array:
    """Find the m directions of a signature that a score test can detect: (k, m); gram: products of the signature."""
    scale = np.where(length > 0, length, 1)
    values, axes = np.linalg.eigh(gram / np.outer(scale, scale))
    seen = values > min_share**2
    return np.asarray(axes[:, seen] / np.sqrt(values[seen]) / scale[:, None])


def largest_cosine(one: Array, other: Array) -> float:
    """Compute the largest cosine between the spans of the signatures of two score tests."""
    a, b = orthonormal_basis(one), orthonormal_basis(other)
    return float(np.linalg.svd(a.T @ b, compute_uv=False).max()) if a.size and b.size else 0.0
