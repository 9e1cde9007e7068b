"""One local fit: the stretches of a hit with their motions, what is known of them, and its solution.

The parameters are the instant of the contact, the place of each body there, and for each stretch a start of its own.
Weak knowledge keeps short stretches regular, as rows of the least squares:

- the bodies touch at about one diameter, and each is in about one place before and after the contact;
- the slip of a ball that was at rest is about its velocity, which tells how long it slides;
- the plate's friction, and its rolling loss, are about the same in all stretches, and the loss falls with the speed;
- dry friction is opposite to the velocity, and about the same in all stretches.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np

from synthcam_shared.arrays import Array, Flags
from tracker.measurement.collision.collision_model import GRAVITY
from tracker.measurement.local.stretches import MotionKind, Stretch

ANY_TURN = float(np.pi / np.sqrt(3))  # rad, error of a direction of which nothing is known


@dataclass(frozen=True)
class KnownSlips:
    """What is known of the slips of both balls just after a contact. They slide until two sevenths of these are lost.

    A slip is what is left of an earlier one, plus the change of the ball's velocity, plus what the surfaces of both
    balls drag one another along the line of centres: a share of the sum of the speeds with which both roll along it.
    Arrays have a row for each ball.
    """

    slips: Array  # (2, 2) m/s, estimated before the fit
    left: Array  # (2, 2) m/s, what is left of earlier slips
    left_std: tuple[float, float]  # of either component
    normal: Array  # (2,) unit vector along the line of centres
    share: float  # of the sum of both speeds along it
    drag_std: float  # m/s, by the error of the share
    std: float  # m/s, any other error of a component

    @cached_property
    def drag(self) -> Array:
        """The matrix (2, 2) by which the sum of both velocities without slips gives the drag of the surfaces."""
        return np.asarray(self.share * np.outer(self.normal, self.normal))

    @cached_property
    def whiten(self) -> Array:
        """The matrix (4, 4) that makes the errors of both slips independent and of size 1."""
        cov = self.std**2 * np.eye(4)
        alike = self.drag_std * np.tile(self.normal, 2)
        cov += np.outer(alike, alike)
        for ball, std in enumerate(self.left_std):
            effect = np.vstack([np.eye(2) * (own == ball) - self.drag for own in (0, 1)])
            cov += std**2 * effect @ effect.T
        return np.linalg.inv(np.linalg.cholesky(cov))

    def find_duration(self, ball: int, friction: float) -> float:
        """Find the duration of the slide of ball 1 or 2 on a plate of this friction, s."""
        return 2 * float(np.hypot(*self.slips[ball - 1])) / (7 * friction * GRAVITY)


@dataclass(frozen=True)
class KnownEnd:
    """What an earlier contact shows of a slide that lasts into the positions before this contact."""

    towards: float  # rad, the direction in which friction pushes the ball
    turn: float  # rad, its error
    rolls: float  # s, how long the ball has rolled at the contact; negative if it still slides
    rolls_std: float


@dataclass(frozen=True)
class LocalPriors:
    """Prior values of a fit, with their errors."""

    diameter: float  # m
    distance_share: float = 0.016  # error of the distance at which the bodies touch, diameters
    shift_share: float = 0.005  # by which a body may be elsewhere after the contact, diameters
    friction: float = 0.2  # the plate's
    friction_factor: float = 0.7  # error of its logarithm
    friction_scatter: float = 0.04  # from stretch to stretch, relative
    turn: float = 0.5  # rad, of friction from the direction in which a ball that did not slide is slowed or sped up
    slide_s: float = 0.1  # duration of a slide
    slide_factor: float = 3.0  # error of its logarithm
    slips: KnownSlips | None = None  # just after the contact, if they are known
    ends: tuple[KnownEnd | None, KnownEnd | None] = (None, None)  # of slides of ball 1 and ball 2 before it, likewise
    roll_s: float = 0.1  # how long a ball has rolled before the contact, after a slide
    roll_factor: float = 3.0  # error of its logarithm
    loss: float = 0.05  # of rolling, m/s^2; its error is as large
    fall: float = 0.1  # of the loss with time, over the loss, 1/s
    fall_error: float = 0.1  # 1/s
    loss_scatter: float = 0.03  # from stretch to stretch, m/s^2: balls of steel lose more the faster they roll
    push: float = 1.0  # acceleration of bodies that glide, m/s^2
    # Scatter of dry friction along and across the path, over the common one. Even pressure gives a disc whose rim turns
    # as fast as it slides 0.85 of the friction. A plate that is tilted by a degree pushes by 0.1 of it.
    dry_scatter: tuple[float, float] = (0.2, 0.1)


@dataclass(frozen=True)
class LocalProblem:
    """The stretches of one hit with their motions; `glide` if the bodies slide on air, where pushes are unlike.

    slides: of stretches whose slide has an assumed duration, that duration, s, and the error of its logarithm.
    """

    stretches: tuple[Stretch, ...]
    motions: tuple[MotionKind, ...]
    priors: LocalPriors
    glide: bool
    slides: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    start: tuple[int, ...] = field(init=False)  # of each stretch in the vector of parameters
    spans: tuple[float, ...] = field(init=False)  # duration of each stretch, s

    COMMON = 8  # t_c; x, y of ball 1; x, y of ball 2; log of the friction; loss; its fall

    def __post_init__(self) -> None:
        ends = np.cumsum([self.COMMON, *(motion.size for motion in self.motions)])
        object.__setattr__(self, "start", tuple(int(end) for end in ends))
        object.__setattr__(self, "spans", tuple(float(np.ptp(s.time)) for s in self.stretches))

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.start[-1]

    @property
    def form(self) -> tuple[object, ...]:
        """What problems must have in common to be solved together: motions, and the side that each stretch shows."""
        known = tuple(each is None for each in (self.priors.slips, *self.priors.ends))
        return (self.motions, self.glide, tuple((s.ball, s.after) for s in self.stretches), known)

    def values(self, x: Array, k: int, span: Array | None = None) -> Array:
        """The parameters (..., size) of a stretch, with its place at the contact, of all parameters (..., n).

        span: duration of the stretch in each of m problems of the same form, s.
        """
        own = x[..., self.start[k] : self.start[k + 1]].copy()
        own[..., :2] += x[..., self.place(k)]
        if self.rubs(k):
            size, angle = np.exp(x[..., 5] + own[..., 4]) * GRAVITY, own[..., 5].copy()
            own[..., 4], own[..., 5] = size * np.cos(angle), size * np.sin(angle)
        if self.slides_first(k):
            lasts = self.spans[k] if span is None else span[:, None]
            own[..., 2:4] -= own[..., 4:6] * np.minimum(np.exp(own[..., 6:7]), lasts)
        return own

    def rubs(self, k: int) -> bool:
        """Decide whether a stretch is pushed by friction: its size over the common one and its direction are fitted."""
        return self.motions[k].pushed and not self.glide

    def slides_first(self, k: int) -> bool:
        """Decide whether a stretch begins with a slide; the velocity at its end, which is known better, is fitted.

        The end is that of the slide or that of the stretch, whichever is earlier.
        """
        return self.stretches[k].after and self.motions[k].ends

    def find_end(self, k: int) -> KnownEnd | None:
        """Find what is known of the end of the slide of a stretch before the contact."""
        slides = self.motions[k].ends and not self.stretches[k].after
        return self.priors.ends[self.stretches[k].ball - 1] if slides else None

    def find_turn(self, k: int) -> float:
        """Find the error of the direction of friction, rad; after the contact all but unknown if the body slid."""
        end = self.find_end(k)
        if end is not None:
            return end.turn
        before = self.motions[self.find_stretch(self.stretches[k].ball, after=False)]
        return ANY_TURN if before.pushed else self.priors.turn

    @cached_property
    def slips(self) -> tuple[int, ...]:
        """The stretches of ball 1 and ball 2 whose slips just after the contact are known, if they are."""
        firsts = [k for k in range(len(self.motions)) if self.slides_first(k)]
        return tuple(firsts) if self.priors.slips is not None and len(firsts) == 2 else ()

    @cached_property
    def dry(self) -> tuple[int, ...]:
        """The stretches of bodies that slide on a dry plate."""
        return tuple(k for k, motion in enumerate(self.motions) if motion.stops)

    @cached_property
    def turns(self) -> tuple[int, ...]:
        """The stretches of which the direction of friction is known, and no slip."""
        firsts = [k for k in range(len(self.motions)) if self.slides_first(k) and k not in self.slips]
        return (*firsts, *(k for k in range(len(self.motions)) if self.find_end(k) is not None))

    def place(self, k: int) -> slice:
        """Find the position of a stretch's body in the vector of parameters."""
        return slice(1, 3) if self.stretches[k].ball == 1 else slice(3, 5)

    def list_rows(self) -> list[slice]:
        """List the rows of each stretch among the coordinates (2n,) of all."""
        ends = np.cumsum([0, *(2 * len(s) for s in self.stretches)]).tolist()
        return [slice(*pair) for pair in pairwise(ends)]

    @cached_property
    def counted(self) -> Flags:
        """Tell which coordinates (2n,) show the size of the errors: not those beside the contact."""
        return np.concatenate([np.repeat(~s.near, 2) for s in self.stretches])

    @cached_property
    def known(self) -> tuple[Array, Array]:
        """Prior knowledge as equations with errors of one: values, and matrix of the parameters.

        The first rows, of the distance, of directions of friction, of slips and of dry friction, are not linear; they
        are zero here.
        """
        rows = self._list_known()
        matrix = np.zeros((len(rows), self.size))
        for i, (_, error, factors) in enumerate(rows):
            for j, factor in factors.items():
                matrix[i, j] = factor / error
        return np.array([value / error if by else 0.0 for value, error, by in rows]), matrix

    def find_log_density(self, x: Array) -> float:
        """Find the logarithm of the prior density of slips and dry friction, over what `log_width` and the cost hold.

        The scatter of dry friction goes with the fitted friction; `log_width` holds that of the prior one.
        The prior of a slip u is normal in both components of u; the fit has the logarithm of its duration and its
        direction instead, so that the density has a factor u^2. It also stands in place of the usual prior of the
        duration. Durations that are assumed one by one have an even prior of their logarithm, besides.
        """
        priors = self.priors
        log = 2 * len(self.dry) * (float(np.log(priors.friction)) - float(x[5]))
        for k in self.slips:
            at = self.start[k]
            log += 2 * float(np.log(3.5 * GRAVITY) + x[5] + x[at + 4] + x[at + 6])
            if k in self.slides:
                log -= float(np.log(2 * np.pi)) / 2
            else:
                away = (float(x[at + 6]) - float(np.log(priors.slide_s))) / priors.slide_factor
                log += float(np.log(priors.slide_factor)) + away**2 / 2
        if self.slips and priors.slips is not None:
            log += float(np.linalg.slogdet(priors.slips.whiten)[1])
        return log

    @cached_property
    def free_turns(self) -> tuple[int, ...]:
        """The stretches that friction pushes in any direction; only positions show it."""
        return tuple(k for k in range(len(self.motions)) if self.rubs(k) and k not in (*self.turns, *self.slips))

    @cached_property
    def log_width(self) -> float:
        """Logarithm of the volume of what is known of the motions, any direction of a slide before the contact."""
        free = len(self.free_turns) * float(np.log(2 * np.pi) / 2)
        return float(sum(np.log(error) for _, error, _ in self._list_known())) + free

    def _list_known(self) -> list[tuple[float, float, dict[int, float]]]:
        """Prior knowledge: value, error, and factors of the parameters; none of what is not linear."""
        p = self.priors
        rows: list[tuple[float, float, dict[int, float]]] = [(0.0, p.distance_share * p.diameter, {})]
        rows += [(0.0, self.find_turn(k), {}) for k in self.turns]
        rows += [(0.0, 1.0, {})] * (2 * len(self.slips))
        rows += [(0.0, scatter * p.friction * GRAVITY, {}) for _ in self.dry for scatter in p.dry_scatter]
        rows += [(np.log(p.friction), p.friction_factor, {5: 1.0}), (p.loss, p.loss, {6: 1.0})]
        rows.append((p.fall, p.fall_error, {7: 1.0}))
        for k, motion in enumerate(self.motions):
            at, last = self.start[k], self.start[k + 1] - 1
            rows += [(0.0, p.shift_share * p.diameter, {at + axis: 1.0}) for axis in (0, 1)]
            if motion.stops:
                pass
            elif motion.pushed and self.glide:
                rows += [(0.0, p.push, {at + 4 + axis: 1.0}) for axis in (0, 1)]
            elif motion.pushed:
                rows.append((0.0, p.friction_scatter, {at + 4: 1.0}))
            if motion.ends:
                usual = (p.slide_s, p.slide_factor) if self.stretches[k].after else (p.roll_s, p.roll_factor)
                lasts, factor = self.slides.get(k, usual)
                rows.append((np.log(lasts), factor, {at + 6: 1.0}))
            if motion.rolls:
                rows.append((0.0, p.loss_scatter, {last: 1.0, 6: -1.0}))
        return rows

    def find_stretch(self, ball: int, after: bool) -> int:
        """Find the stretch of a body before or after the contact."""
        return next(k for k, s in enumerate(self.stretches) if (s.ball, s.after) == (ball, after))


@dataclass(frozen=True)
class LocalSolution:
    """The minimum of a problem.

    chi2 and dof are those of the positions that are not beside the contact. Their errors are smaller or larger than
    assumed, so that they say nothing about the size of the others.
    """

    problem: LocalProblem
    x: Array
    cov: Array
    sizes: tuple[float, ...]  # of the errors of each stretch, over the claimed ones
    cost: float  # chi^2 with what is known
    log_volume: float  # logarithm of the volume of the errors: half that of the determinant of cov
    weigh: Callable[[], tuple[Array, Array, float]]  # the next three, which many solutions never need

    @property
    def residual(self) -> Array:
        """Whitened residuals (2n,) of all positions."""
        return self._weighed[0]

    @property
    def freedom(self) -> Array:
        """Degrees of freedom (2n,) of each residual."""
        return self._weighed[1]

    @property
    def cost_of_known(self) -> float:
        """The part of the cost that is not of positions."""
        return self._weighed[2]

    @cached_property
    def _weighed(self) -> tuple[Array, Array, float]:
        return self.weigh()

    @cached_property
    def chi2(self) -> float:
        """Sum of squared residuals."""
        return float((self.residual[self.problem.counted] ** 2).sum())

    @cached_property
    def dof(self) -> float:
        """Degrees of freedom."""
        return max(float(self.freedom[self.problem.counted].sum()), 0.5)

    @property
    def is_good(self) -> bool:
        """True if chi^2 is no larger than the claimed errors make it, and nothing known is far off."""
        usual = self.chi2 - self.dof < 3 * float(np.sqrt(2 * self.dof))
        return usual and self.cost_of_known < 15

    @cached_property
    def log_evidence(self) -> float:
        """Logarithm of the probability of the positions by the motions of the problem, but for a constant."""
        density = self.problem.find_log_density(self.x)
        return self.log_volume - self.cost / 2 - self.problem.log_width + density

    @property
    def cost_with_price(self) -> float:
        """Cost with a price for each parameter that the positions determine, by which problems are compared."""
        n = len(self.residual)
        return self.cost + (n - float(self.freedom.sum())) * float(np.log(max(n, 2)))
