"""Models of billiard hits: the path of both balls from few numbers, by laws of friction, impact and hop.

A hit has a striker that slides and then rolls, a ball at rest, and an impact. Then both balls slide, and roll in the
end. `predict` gives the positions of many hits at once. Three kinds of numbers determine them:

- numbers of one hit, such as its instant and the velocity of the striker (`OWN`);
- numbers that all hits share, such as the friction of the cloth (`SHARED`);
- random effects of one hit, in units of a scatter that all hits share (`SCATTERS`).

The laws of the impact are these. The slip of a ball is the velocity of its lowest point; impulses are over the mass.

- **Normal.** The struck ball gets (1 + r)/2 v_n along the line of centres n.
- **Slip of the surfaces.** In the plane it is v_t and R times the spin about the vertical. Downwards it is the speed
  with which the striker rolls along n.
- **Friction.** It opposes that slip. It is a share C of 2/5 of it, or mu times the normal impulse. An impulse J changes
  the slip between two equal solid balls by 7 J. So friction is at most 1/7 of the slip, which ends it.
- **Spin.** The vertical part J of the friction adds 5/2 J along n to the slip of both balls.
- **Hop.** The cloth, with the friction m, takes m J more from the struck ball, against its slip. From the striker it
  takes m J less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.real.recordings import FRAME_S, RecordedHit, read_balls
from synthcam_shared.arrays import Array, Flags, Ints
from tracker.camera.camera import Camera
from tracker.measurement.collision.collision_model import GRAVITY, SLIP_RATE

WINDOW_S, LEAST_POSITIONS = 0.5, 8  # of positions, to either side of the contact
USUAL_SLIP_M_S = 2.5
MAX_FRICTION_OF_SLIP = 1 / 7  # impulse over the mass that ends the slip between two equal solid balls, over that slip
ROLLS_S = -9.0  # end of a slide so long ago that the striker rolls throughout
TINY_M_S = 1e-9

# t_c from the usual instant, s; position of the resting ball, m; direction of the line of centres, rad; velocity of the
# striker just before the hit, m/s; end of its slide from the contact on, s; direction of its acceleration, rad
OWN = ("t_c", "x", "y", "normal", "vx", "vy", "slide_end", "acceleration_angle")
OF_SLIDE = ("slide_end", "acceleration_angle")  # those that a striker without a slide lacks
POSITION, VELOCITY = ([OWN.index(name) for name in names] for names in (("x", "y"), ("vx", "vy")))
# fall_per_ln_slip: of the friction between the balls, from a slip to e times that slip
SHARED = ("cloth", "loss", "drag", "r", "friction", "fall_per_ln_slip", "hop", "distance")
SCATTERS = {  # the random effects that have each scatter
    "spin": 1,  # R times the spin of the striker about the vertical over its speed
    "r": 1,
    "friction": 1,  # between the balls
    "turn": 1,  # rad, of the line of centres
    "distance": 1,  # m, of the centres at the contact
    "cloth": 3,  # logarithm of the friction of the cloth, of each stretch
    "kick": 4,  # velocities of both balls just after the hit, over the speed of the striker
    "slip": 4,  # their slips, likewise
}
RANDOM = tuple(name for name, count in SCATTERS.items() for _ in range(count))
NUMBERS = (*OWN, *RANDOM)


@dataclass(frozen=True)
class HitPositions:
    """Positions of n hits near the contact; times are in s from `contact`, and nan where a hit has fewer positions."""

    diameter: float  # m
    contact: Array  # (n,) s
    rest: Array  # (n, 2) m, of the resting ball, which was read once
    struck_time: Array  # (n, k)
    struck: Array  # (n, k, 2) m
    striker_time: Array  # (n, l)
    striker: Array  # (n, l, 2) m

    @classmethod
    def of(cls, hits: Sequence[RecordedHit], contacts: Array | None = None) -> HitPositions:
        """Read the positions of hits near the contact; contacts: its instants (n,), s, if they are known."""
        tables = [_read_hit(hit) for hit in hits]
        usual, rest, struck, striker = zip(*tables, strict=True)
        contact = np.array(usual) if contacts is None else contacts
        balls = [
            [_cut_window(time - at, position) for at, (time, position) in zip(contact, each, strict=True)]
            for each in (struck, striker)
        ]
        padded = (_pad(list(part)) for each in balls for part in zip(*each, strict=True))
        return cls(float(hits[0].camera["ball_diameter"]), contact, np.array(rest), *padded)

    def select(self, rows: Ints) -> HitPositions:
        """Select hits by their indices, which may repeat."""
        parts = (self.contact, self.rest, self.struck_time, self.struck, self.striker_time, self.striker)
        return HitPositions(self.diameter, *(part[rows] for part in parts))

    @property
    def since(self) -> Array:
        """Time (n, m) of each coordinate from the contact, as `predict` lists them; nan of missing ones."""
        rest = np.full((len(self.rest), 2), -np.inf)
        return np.concatenate([rest, *(np.repeat(t, 2, axis=1) for t in (self.struck_time, self.striker_time))], axis=1)

    @property
    def coordinates(self) -> Array:
        """All coordinates (n, m), as `predict` lists them."""
        return np.concatenate([self.rest, *(p.reshape(len(p), -1) for p in (self.struck, self.striker))], axis=1)

    def tell_near(self, frames: float) -> Flags:
        """Tell which coordinates (n, m) are of moving balls within so many frames of the contact."""
        return np.asarray(np.abs(self.since) < frames * FRAME_S)


def _read_hit(hit: RecordedHit) -> tuple[float, Array, tuple[Array, Array], tuple[Array, Array]]:
    """Read a guess of the instant, the position of the ball at rest, and times and positions of both as they move."""
    struck, striker = read_balls(hit, Camera.of(hit.camera))
    rests = np.hypot(*(struck.position - struck.position[0]).T) < 1e-9
    rests &= struck.time <= struck.time[~rests].min()
    contact = (float(struck.time[rests].max()) + float(struck.time[~rests].min())) / 2
    moving = (struck.time[~rests], struck.position[~rests])
    return contact, struck.position[0], moving, (striker.time, striker.position)


def _cut_window(since: Array, position: Array) -> tuple[Array, Array]:
    """Cut out the positions of a ball near the contact, and at least LEAST_POSITIONS to either side if it has them."""
    used = np.abs(since) < WINDOW_S
    for side in (since < 0, since >= 0):
        nearest = np.flatnonzero(side)[np.argsort(np.abs(since[side]))[:LEAST_POSITIONS]]
        used[nearest] = True
    return since[used], position[used]


def _pad(parts: Sequence[Array]) -> Array:
    """Stack arrays of unequal lengths, filled with nan."""
    out = np.full((len(parts), max(map(len, parts)), *parts[0].shape[1:]), np.nan)
    for row, part in zip(out, parts, strict=True):
        row[: len(part)] = part
    return out


@dataclass(frozen=True)
class HitLaws:
    """The laws of a model. striker: `rolls`, `state` (it rolls or slides up to the hit) or `slides, then rolls`."""

    striker: str = "slides, then rolls"
    slides_after: bool = True
    coulomb: bool = True


@dataclass(frozen=True)
class Common:
    """Numbers that all hits share, and scatters, by the names of SHARED and SCATTERS; those not named are zero."""

    numbers: dict[str, float]
    scatters: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class BallsAtContact:
    """The same ball of n hits at the contact: position, velocity and slip (n, 2), and deceleration (n,) of a slide."""

    position: Array
    velocity: Array
    slip: Array
    deceleration: Array


def predict(hits: HitPositions, own: Array, common: Common, laws: HitLaws) -> Array:
    """Predict coordinates (n, m) of hits: of the ball at rest, of the same ball after the hit, and of the striker.

    own: numbers (n, p) of each hit, in the order of NUMBERS; random effects in units of their scatter.
    """
    values, shared = dict(zip(OWN, own.T, strict=False)), dict.fromkeys(SHARED, 0.0) | common.numbers
    effects = _scale_effects(own, common)
    cloth = shared["cloth"] * GRAVITY * np.exp(effects["cloth"])
    position = own[:, POSITION]
    along = _unit(values["normal"])
    towards = _unit(values["acceleration_angle"])
    slides_s = np.maximum(values["slide_end"], 0.0)
    slip = -SLIP_RATE * (cloth[:, 0] * slides_s)[:, None] * towards
    distance = hits.diameter + shared["distance"] + effects["distance"][:, 0]
    before = BallsAtContact(position - distance[:, None] * along, own[:, VELOCITY], slip, cloth[:, 0])
    struck, striker = collide(before, values["normal"] + effects["turn"][:, 0], effects, shared, laws)
    struck = replace(struck, position=position, deceleration=cloth[:, 1])
    striker = replace(striker, deceleration=cloth[:, 2])
    if not laws.slides_after:
        struck, striker = (replace(ball, slip=np.zeros_like(ball.slip)) for ball in (struck, striker))
    late = values["t_c"][:, None]
    since = hits.striker_time - late
    early = _go_back(before, towards, np.maximum(-since, 0.0), values["slide_end"], shared, laws)
    after = _go_on(striker, np.maximum(since, 0.0), shared)
    first = _go_on(struck, np.maximum(hits.struck_time - late, 0.0), shared)
    path = np.where((since < 0)[..., None], early, after)
    return np.concatenate([position, first.reshape(len(own), -1), path.reshape(len(own), -1)], axis=1)


def _scale_effects(own: Array, common: Common) -> dict[str, Array]:
    """The random effects of each scatter (n, count), in their units."""
    out, at = {}, len(OWN)
    for name, count in SCATTERS.items():
        out[name] = common.scatters.get(name, 0.0) * own[:, at : at + count]
        at += count
    return out


def collide(
    before: BallsAtContact, normal: Array, effects: dict[str, Array], shared: dict[str, float], laws: HitLaws
) -> tuple[BallsAtContact, BallsAtContact]:
    """The struck ball and the striker just after the impact; normal: direction (n,) of the line of centres, rad."""
    n = _unit(normal)
    t = np.column_stack([-n[:, 1], n[:, 0]])
    speed = np.hypot(*before.velocity.T)
    rolling = before.velocity - before.slip
    v_n = np.sum(before.velocity * n, axis=1)
    push = (1 + shared["r"] + effects["r"][:, 0]) / 2 * v_n
    across = np.sum(before.velocity * t, axis=1) + effects["spin"][:, 0] * speed
    down = np.sum(rolling * n, axis=1)
    slip = np.maximum(np.hypot(across, down), TINY_M_S)
    rubs = shared["friction"] + effects["friction"][:, 0]
    coulomb = np.maximum((rubs - shared["fall_per_ln_slip"] * np.log(slip / USUAL_SLIP_M_S)) * push, 0.0)
    strength = np.minimum(coulomb if laws.coulomb else 0.4 * rubs * slip, MAX_FRICTION_OF_SLIP * slip)
    drag, press = strength * across / slip, strength * down / slip
    kick = push[:, None] * n + drag[:, None] * t
    out = []
    for ball, sign in ((0, 1), (1, -1)):
        velocity = (before.velocity if ball else 0.0) + sign * kick
        lowest = (before.slip if ball else 0.0) + sign * kick + 2.5 * press[:, None] * n
        size = np.maximum(np.hypot(*lowest.T), TINY_M_S)[:, None]
        hop = (sign * shared["hop"] * shared["cloth"] * press)[:, None] * lowest / size
        axes = slice(2 * ball, 2 * ball + 2)
        velocity = velocity - hop + speed[:, None] * effects["kick"][:, axes]
        lowest = lowest - SLIP_RATE * hop + speed[:, None] * effects["slip"][:, axes]
        out.append(replace(before, velocity=velocity, slip=lowest))
    return out[0], out[1]


def _go_on(ball: BallsAtContact, since: Array, shared: dict[str, float]) -> Array:
    """Positions (n, k, 2) of balls that slide and then roll, at times (n, k) after the contact."""
    size = np.maximum(np.hypot(*ball.slip.T), TINY_M_S)
    acceleration = -(ball.deceleration / size)[:, None] * ball.slip
    slides = np.minimum(since, (size / (SLIP_RATE * ball.deceleration))[:, None])
    end = ball.velocity - 2 / 7 * ball.slip
    speed, loss, heading = _roll(end, shared)
    rolls = np.minimum(since - slides, (speed / loss)[:, None])
    way = speed[:, None] * rolls - loss[:, None] * rolls**2 / 2
    slid = ball.velocity[:, None] * slides[..., None] + acceleration[:, None] * (slides**2 / 2)[..., None]
    return np.asarray(ball.position[:, None] + slid + way[..., None] * heading[:, None])


def _go_back(
    ball: BallsAtContact, towards: Array, before: Array, end: Array, shared: dict[str, float], laws: HitLaws
) -> Array:
    """Positions (n, k, 2) of strikers at times (n, k) before the contact, whose slides end at `end` (n,) from it."""
    rolls = np.minimum(before, np.maximum(-end, 0.0)[:, None])
    if laws.striker == "state":
        rolls = np.where((end < ROLLS_S / 2)[:, None], before, 0.0)
    slides = before - rolls
    speed, loss, heading = _roll(ball.velocity, shared)
    faster = speed[:, None] + loss[:, None] * rolls
    way = (speed[:, None] + faster) / 2 * rolls + faster * slides
    bend = (ball.deceleration[:, None] * slides**2 / 2)[..., None] * towards[:, None]
    return np.asarray(ball.position[:, None] - way[..., None] * heading[:, None] + bend)


def _roll(velocity: Array, shared: dict[str, float]) -> tuple[Array, Array, Array]:
    """Speed (n,), loss (n,), m/s^2, and heading (n, 2) of balls that roll."""
    speed = np.maximum(np.hypot(*velocity.T), TINY_M_S)
    loss = np.maximum(shared["loss"] + shared["drag"] * speed, 1e-3)
    return speed, loss, velocity / speed[:, None]


def _unit(angle: Array) -> Array:
    return np.column_stack([np.cos(angle), np.sin(angle)])
