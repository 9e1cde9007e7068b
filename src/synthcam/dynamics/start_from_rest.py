"""How a ball at rest starts when the push of a rolling ball overcomes what holds it.

The ball starts in the direction of the push. Let s be its speed and f the push on it. Its lag d behind the push's
    direction phi obeys (s/f) d' + sin d = (s/f) phi'. This equation has one smooth solution.
"""

import numpy as np

from synthcam.dynamics.collocation import make_matrices, multiply_on_nodes
from synthcam.dynamics.forces import STOP_SPEED_M_S, TINY, BallStates, Forces, move_vectors_to_last_axis
from synthcam.dynamics.integrated_motion import IntegratedMotion
from synthcam.dynamics.kinematics import push_share, rolling_state
from synthcam.dynamics.propagate import propagate_back
from synthcam.model import Bodies, Model
from synthcam_shared.arrays import Array, Flags, Index

START_NODE_COUNTS = (12, 20, 32, 56)  # nodes of a piece that begins at rest, tried in this order
MIN_IMPACT_SPEED_OF_PAIR_M_S = 1e-4  # softer impacts of balls that push each other belong to an endless sequence
UNKNOWN_PAST = "a ball that slides or flies at its launch, pushed by another, has no past: start the run at the launch"
PUSHED_AWAY = "the ball at rest would be pushed away faster than the other comes"


def push_at_rest(model: Model, bodies: Bodies, states: Array, other: Array) -> Array:
    """Return the push on balls at rest, states (k, 9), with the others at (2, k, n): (2, k, n), m/s^2."""
    place = np.broadcast_to(states[:, :2].T[..., None], (2, len(states), other.shape[-1]))
    return Forces.of(model, bodies).push(place, np.zeros(place.shape), move_vectors_to_last_axis(other - place))


def excess_push(model: Model, bodies: Bodies, states: Array, other: Array) -> Array:
    """Return by how much 5/7 of the push exceeds the force over mass that holds balls at rest, (k, n), m/s^2."""
    push = push_at_rest(model, bodies, states, other)
    size = np.hypot(push[0], push[1])
    place = np.broadcast_to(states[:, :2].T[..., None], push.shape)
    velocity, speed = STOP_SPEED_M_S * push / np.maximum(size, TINY), np.full(size.shape, STOP_SPEED_M_S)
    apart = move_vectors_to_last_axis(other - place)
    known = Forces.of(model, bodies).list_inputs(place, velocity, apart, speed=speed)
    decel = Forces.of(model, bodies).base["rolling_decel"]
    loss = model.laws("rolling", decel, known)
    return np.asarray(size * push_share(bodies.inertia)[:, None] - np.maximum(decel, loss))


def solve_approach(
    model: Model, bodies: Bodies, touching: Array, lasted: Array
) -> tuple[Array, list[tuple[Index, IntegratedMotion]], Array]:
    """Solve the past of k contacts at time 0 between a ball that rested and a ball that rolls towards it.

    A ball at rest starts when the push on it overcomes what holds it. It never starts before the other ball is within 8
    distances of touching. Raises ValueError if there is no such past.

    bodies: the k balls that rested, then the k rolling ones.
    touching: (2 k, 9), states at the contacts; the velocities of the first balls are not used.
    lasted: (k,), how far to go back, s; further where a ball started earlier.

    Returns the states at the contacts, with the velocities that the first balls have then. It also returns the motions
    of units back from the contacts, and when the balls at rest started, (k,), s.
    """
    k = len(lasted)
    hit, then, onset, pieces = touching.copy(), touching.copy(), np.zeros(k), list[tuple[Index, IntegratedMotion]]()
    lasts, held = _guess_pull_duration(model, bodies, touching)
    left = np.flatnonzero(lasts > 0)
    for size in START_NODE_COUNTS:
        if len(left) == 0:
            break
        rows = np.concatenate([left, left + k])
        motion, good = solve_start(model, bodies[rows], touching[rows], -lasts[left], -1, ~held[left], size)
        if not good.any():
            continue
        found, own = left[good], np.flatnonzero(np.tile(good, 2))
        pieces.append((found, motion[own]))
        rows = np.concatenate([found, found + k])
        hit[found, 3:5] = motion.at(0 * motion.durations[:, None])[own[: len(found)], 0, 3:5]
        then[rows] = motion.at(motion.durations[:, None])[own, 0]
        onset[found], left = motion.durations[own[: len(found)]], left[~good]
    if len(left):
        raise ValueError(
            "no approach was found to such a contact: for a push so strong the ball that comes, at "
            f"{np.hypot(*touching[k + left[0], 3:5]):.4g} m/s, is too slow, or the one at rest is held again on its way"
        )
    hit[:k] = rolling_state(hit[:k, :2], hit[:k, 3:5], hit[:k, 8], bodies.radius[:k])
    then[:k, 3:8] = 0.0
    pieces += propagate_back(BallStates.without_drilling(model, bodies, then, 2), onset, -lasted)
    return hit, pieces, onset


def solve_start(
    model: Model, bodies: Bodies, states: Array, lasts: Array, anchor: int, onset: Flags, size: int
) -> tuple[IntegratedMotion, Flags]:
    """Solve k balls that start from rest together with the balls that pull them; also return whether that is a
    solution.

    bodies, states: 2 k balls at time 0: those at rest, then the others.
    lasts: (k,), length of the motion, s; negative: back in time.
    anchor: 0: the balls start at time 0; -1: they started `lasts` (negative) from then.
    onset: (k,), whether the start is to be found where the pull overcomes what holds the ball.
    size: number of nodes.
    """
    iterations, whole_steps = 120, 5  # the start moves in whole steps at first, then in half steps
    converged = 2e-13  # m/s, of the change of an iteration
    accurate_m, accurate_m_s = 3e-14, 5e-13  # of the last coefficients
    on, k = make_matrices(size), len(lasts)
    integral = on.integral / 2
    slope = 2 * on.coefficients @ on.slope @ on.values
    one, two, decel = Forces.of(model, bodies[:k]), Forces.of(model, bodies[k:]), model.rolling_decel
    where, v_in = states[:, :2].T[..., None], states[k:, 3:5].T[..., None]
    long = lasts[:, None].copy()
    place, v1 = np.repeat(where, size, axis=-1), np.repeat(v_in, size, axis=-1)
    place[:, k:] += v_in * (long * (1 + on.nodes) / 2)
    pull = push_share(bodies.inertia[:k, None]) * push_at_rest(model, bodies[:k], states[:k], place[:, k:, :1])
    hat = pull / np.maximum(np.hypot(pull[0], pull[1]), TINY)
    lag, change = np.zeros((k, size)), np.full(k, np.inf)
    gain = np.maximum(np.hypot(pull[0], pull[1]) - decel, 0.0)
    s = np.abs(long * (on.nodes - on.nodes[anchor]) / 2) * gain / 2
    e = np.repeat(hat, size, axis=-1)
    place[:, :k] += long * multiply_on_nodes(s * e, integral)
    with np.errstate(all="ignore"):
        for turn in range(iterations):
            apart = move_vectors_to_last_axis(place[:, k:] - place[:, :k])
            pull, loss = _pull_and_loss(one, place[:, :k], s, e, apart)
            force = two.accelerate_rolling(place[:, k:], v1, -apart)
            strength = np.maximum(np.hypot(pull[0], pull[1]), TINY)
            early = strength - np.maximum(loss, decel)
            beyond = np.clip(early[:, -1:] / (early @ slope[:, -1:]), -0.3, 0.3)
            long = np.where(onset[:, None], long * (1 - beyond * (1.0 if turn < whole_steps else 0.5)), long)
            phi = np.arctan2(hat[0] * pull[1] - hat[1] * pull[0], hat[0] * pull[0] + hat[1] * pull[1])
            gain = (strength * np.cos(lag) - loss) @ integral
            s = long * (gain - gain[:, anchor, None])
            weight = s / (long * strength)
            lag = _solve_lag(weight, slope, phi, lag)
            c, d = np.cos(phi - lag), np.sin(phi - lag)
            e = np.stack([c * hat[0] - d * hat[1], d * hat[0] + c * hat[1]])
            v1 = v_in + long * multiply_on_nodes(force, integral)
            old, v = place, np.concatenate([s * e, v1], axis=1)
            place = where + np.tile(long, (2, 1)) * multiply_on_nodes(v, integral)
            moved = np.abs(place - old).max(axis=(0, 2)).reshape(2, k).max(axis=0) / np.abs(long[:, 0])
            last, change = change, moved
            to_come = change * np.minimum(change / np.maximum(last, TINY), 1.0)
            if turn > 0 and not np.any((to_come >= converged) & (to_come < np.inf)):
                break
    last_ones = np.abs(multiply_on_nodes(np.concatenate([place, v]), on.coefficients)[..., -2:])
    rough = np.maximum(last_ones[:2].max(axis=(0, 2)) / accurate_m, last_ones[2:].max(axis=(0, 2)) / accurate_m_s)
    resolved = (rough.reshape(2, k).max(axis=0) < 1) & (to_come < converged)
    good = resolved & (s.min(axis=1) >= 0) & (np.sign(long[:, 0]) == np.sign(lasts))
    long = np.tile(long, (2, 1))
    piece, none = (long * (1 + on.nodes) / 2, np.concatenate([place, v])), np.zeros(2 * k, dtype=bool)
    return IntegratedMotion(0 * long[:, 0], long[:, 0], states, bodies, model.gravity, [piece], 0, none), good


def _pull_and_loss(one: Forces, place: Array, s: Array, e: Array, apart: Array) -> tuple[Array, Array]:
    """Return 5/7 of the push, (2, k, n), and the rolling loss, (k, n), of balls with speeds s along e."""
    model, speed = one.model, np.maximum(s, STOP_SPEED_M_S)
    v = speed * e
    known = one.list_inputs(place, v, apart, speed=speed)
    base = model.rolling_drag * np.maximum(s, 0.0) + model.rolling_decel
    return push_share(one.inertia) * one.push(place, v, apart), model.laws("rolling", base, known) + 0 * s


def _solve_lag(weight: Array, slope: Array, phi: Array, lag: Array) -> Array:
    """Solve w d' + sinc(lag) d = w phi' for the next lag d, (k, n), by collocation. weight: w = s/f."""
    size = len(slope)
    lines = weight[..., None] * slope.T
    lines[:, range(size), range(size)] += np.sinc(lag / np.pi)
    lines = np.where(np.isfinite(lines), lines, np.eye(size))
    return np.asarray(np.linalg.solve(lines, (weight * (phi @ slope))[..., None])[..., 0])


def _guess_pull_duration(model: Model, bodies: Bodies, touching: Array) -> tuple[Array, Flags]:
    """Estimate how long the first balls move before the contact, (k,) s, as if the others rolled at a constant speed.

    Also returns whether that is longer than the search, which goes back to 8 distances of touching.
    """
    k = len(touching) // 2
    here, way = touching[k:, :2].T[..., None], touching[k:, 3:5].T[..., None]

    def early(tau: Array) -> Flags:
        return np.asarray(excess_push(model, bodies[:k], touching[:k], here - tau[:, None] * way)[:, 0] > 0)

    far = 8.0 * (bodies.radius[:k] + bodies.radius[k:]) / np.hypot(way[0, :, 0], way[1, :, 0])
    pulled, held = early(0 * far), early(far)
    low, high = 1e-4 * far, far
    for _ in range(12):
        middle = np.sqrt(low * high)
        still = early(middle)
        low, high = np.where(still, middle, low), np.where(still, high, middle)
    return np.where(pulled, np.where(held, far, low), 0.0), pulled & held
