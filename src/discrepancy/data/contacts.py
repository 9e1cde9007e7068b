"""Contacts of two bodies as evidence on the impact: what the tracker's local estimates say of each."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import pandas as pd
from numpy.polynomial.hermite_e import hermegauss

from discrepancy.data.momentum_balances import MomentumBalance, balance_groups
from discrepancy.data.slips import AXES, Slip, trace_slips
from synthcam_shared.arrays import Array, Flags, Ints
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.measurement.camera_errors import remove_shared, shared_effects
from tracker.measurement.collision.adequacy import CROWD, GLIDE, MISFIT, TOGETHER, USUAL_BIAS, find_gliding_hits
from tracker.measurement.local.recommendation import NONE, recommend
from tracker.recording import Result
from tracker.results import read_clip
from tracker.results import read_contact_table as read_all_contacts

NAMES = ("v0", "b", "r", "s", "mass_ratio")  # what is read of the local estimate
QUANTITIES = ("restitution", "friction", "recoil")
SLIP_COLUMNS = ("slip_t", "slip_t_std", "slip_down", "slip_down_std", "slip")
MAX_SHARED = 0.95  # of the error of a contact, what it shares with others
NODES = 7  # of a quadrature over the error of each component of a slip


@dataclass(frozen=True, eq=False)
class Contacts:
    """n contacts; NaN where the tracks do not show a quantity.

    Velocities are of approach, along and across the line of centres, m/s. friction: tangential over normal impulse.
    recoil: logarithm of the mass ratio, struck over striking body, that recoil shows, over that of the camera file.
    turn: sine of the angle between the change of one velocity and the opposite of the other's; 0 without a third body.
    """

    clip: Ints  # (n,)
    bodies: Ints  # (n, k): the tracker's ids of the struck and the striking body in a film of a crowd; -1 in others
    levers: Array  # (n, k): change of the recoil by the logarithm of the mass of each body; 1 and -1 of two that meet
    share: Array  # (n,): of a contact that a row is; groups of contacts have two rows, as `momentum_balances` says
    a_strikes: Flags  # (n,): whether ball a of the camera file strikes
    glides: Flags  # (n,): whether the bodies glide, and do not roll
    speed_n: Array
    speed_t: Array
    slip_t: Array  # of the surfaces, across the line of centres in the plane, with the sign of the velocity, m/s
    slip_t_std: Array  # 0 where the velocities alone show the slip, as of two balls
    slip_down: Array  # its vertical part, m/s, with its standard error
    slip_down_std: Array
    slip: Array  # its size by the best estimates of both parts, m/s
    restitution: Array
    restitution_std: Array
    friction: Array
    friction_std: Array
    recoil: Array
    recoil_std: Array
    turn: Array
    turn_std: Array
    shared: Array  # (n, 3, k): changes of QUANTITIES by one standard error of each error that several contacts share
    shared_of_recoil: Array  # (n, k): the same of the recoil, with a bias of the momentum that is at most usual

    @classmethod
    def of(
        cls,
        rows: Iterable[Mapping[Any, Any]],
        stated: Mapping[int, float] | None = None,
        slips: Mapping[int, Mapping[int, Slip]] | None = None,
    ) -> Self:
        """Take them from rows of the estimates; stated: mass of ball a over that of b by clip, default 1.

        slips: of films of a crowd, by clip and number of the collision.

        Rows without a usable local estimate are left out, such as those whose momentum is not conserved. If the bodies
        of a set do not glide (`find_gliding_hits`), those of each hit roll, also if gliding describes its paths better.
        """
        every = [row for row in rows if _is_usable(row)]
        gliding = bool(find_gliding_hits(every))
        read = [_read_row(row, (stated or {}).get(int(row["clip"]), 1.0), gliding) for row in every]
        for one, row in zip(read, every, strict=True):
            if row["status"] == CROWD:
                one |= _read_slip(row, (slips or {}).get(int(row["clip"]), {}), one["friction_std"])
        names = [f.name for f in fields(cls) if not f.name.startswith("shared")]
        columns = {name: np.array([row[name] for row in read]) for name in names}
        columns["bodies"] = columns["bodies"].reshape(-1, 2).astype(np.int64)
        columns["levers"] = columns["levers"].reshape(-1, 2)
        changes = np.array([_differentiate_quantities(row) for row in every]).reshape(-1, len(QUANTITIES), len(NAMES))
        table = pd.DataFrame({"local_shared": [row["local_shared"] for row in every], "fit": "local"})
        usual = table.assign(local_shared=[_limit_bias(text) for text in table["local_shared"]])
        shared, limited = (changes @ shared_effects(each, NAMES) for each in (table, usual))
        return cls(**columns, shared=shared, shared_of_recoil=limited[:, QUANTITIES.index("recoil")])

    def with_balances(self, clip: int, balances: Sequence[MomentumBalance]) -> Self:
        """Add two rows for each group of contacts of a film, one for each component; they have a recoil alone."""
        count = 2 * len(balances)
        if not count:
            return self
        most = max(self.bodies.shape[1], *(len(each.balls) for each in balances))
        bodies, levers = np.full((count, most), -1), np.zeros((count, most))
        for k, each in enumerate(balances):
            bodies[2 * k : 2 * k + 2, : len(each.balls)] = each.balls
            levers[2 * k : 2 * k + 2, : len(each.balls)] = each.levers.T
        own: dict[str, Any] = {f.name: np.full(count, np.nan) for f in fields(self)}
        own |= {"clip": np.full(count, clip), "bodies": bodies, "levers": levers, "share": np.full(count, 0.5)}
        own |= dict.fromkeys(("a_strikes", "glides"), np.zeros(count, dtype=bool))
        own |= {"recoil": np.concatenate([each.gained for each in balances])}
        own |= {"recoil_std": np.repeat([each.std for each in balances], 2)}
        own |= {name: np.zeros((count, *getattr(self, name).shape[1:])) for name in ("shared", "shared_of_recoil")}
        wide = np.pad(self.bodies, ((0, 0), (0, most - self.bodies.shape[1])), constant_values=-1)
        here = vars(self) | {"bodies": wide, "levers": np.pad(self.levers, ((0, 0), (0, most - self.levers.shape[1])))}
        return replace(self, **{name: np.concatenate([here[name], own[name]]) for name in own})

    def __len__(self) -> int:
        return len(self.clip)

    @property
    def speed(self) -> Array:
        """Speed of approach, m/s."""
        return np.hypot(self.speed_n, self.speed_t)

    @property
    def of_crowd(self) -> Flags:
        """True for contacts (n,) of a crowd, in which a third body may meet two that are measured."""
        return np.asarray(self.bodies[:, 0] >= 0)

    def select(self, rows: Flags) -> Self:
        """Some of the contacts."""
        return replace(self, **{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def spread_slips(self) -> tuple[Array, list[Self]]:
        """The contacts with slips (k times) that are spread by their errors, and the weights (k,) of these slips."""
        points, weights = hermegauss(NODES)
        share = np.outer(weights, weights).ravel() / weights.sum() ** 2
        across = [self.slip_t + point * self.slip_t_std for point in points]
        down = [self.slip_down + point * self.slip_down_std for point in points]
        return share, [replace(self, slip_t=one, slip_down=other) for one in across for other in down]

    def split_errors(self, quantity: str) -> tuple[Array, Array]:
        """The standard errors (n,) of each contact alone, and the effects (n, k) of errors that several share.

        Balances of a crowd may show errors that are smaller than the effect of the friction, which all share. An effect
        is then limited, so that each contact keeps an error of its own.

        Momentum that all hits lose may be an error of velocities, as far as that is usual. The rest is a mass or a law.
        """
        std, shared = getattr(self, f"{quantity}_std"), self.shared[:, QUANTITIES.index(quantity)]
        effects = self.shared_of_recoil if quantity == "recoil" else shared
        size = np.sqrt((effects**2).sum(axis=1))
        most = np.where(self.of_crowd, MAX_SHARED * std, np.inf)
        limited = effects * np.minimum(1.0, most / np.maximum(size, 1e-300))[:, None]
        known = np.where(self.of_crowd[:, None], limited, shared)
        return remove_shared(std, known[:, None]), limited


def _limit_bias(local_shared: str) -> str:
    """Limit the bias of the momentum among the shared errors of a local estimate to USUAL_BIAS."""
    blocks = json.loads(local_shared)
    for key, block in blocks.items():
        if key.startswith("bias_") and abs(block["of"]) > USUAL_BIAS:
            share = USUAL_BIAS / abs(block["of"])
            blocks[key] = block | {"effect": {name: share * v for name, v in block["effect"].items()}}
    return json.dumps(blocks)


def _is_usable(row: Mapping[Any, Any]) -> bool:
    """Decide by the tracker's rule, without a tied fit; in a crowd one ball may be heavier.

    In a crowd a third ball may hit one of both, and then no free motion describes its positions.
    """
    if row["status"] == CROWD and bool(row.get("misfit_local", False)):
        return False
    if row["status"] == TOGETHER or not (_is_known(row, "v0_local") and _is_known(row, "b_local")):
        return False
    hits = {"local_hits": 0} if row["status"] == CROWD else {}
    return recommend({**row, "status": MISFIT, **hits})["recommended"] != NONE


def _is_known(row: Mapping[Any, Any], name: str) -> bool:
    value, std = row.get(name), row.get(f"{name}_std")
    return value is not None and std is not None and bool(np.isfinite(value) and 0 < std < np.inf)


def _read_values(row: Mapping[Any, Any]) -> dict[str, tuple[float, float]]:
    """Read the values of NAMES and their standard errors; NaN where the tracks do not show one."""
    columns = {name: name if name == "mass_ratio" else f"{name}_local" for name in NAMES}
    known = {name: _is_known(row, column) for name, column in columns.items()}
    return {n: (float(row[c]), float(row[f"{c}_std"])) if known[n] else (np.nan, np.nan) for n, c in columns.items()}


def _differentiate_quantities(row: Mapping[Any, Any]) -> Array:
    """Differentiate QUANTITIES by NAMES: (3, 5); 0 where one is not known."""
    _, b, r, s, ratio = (value for value, _ in _read_values(row).values())
    root = np.sqrt(max(1 - b * b, 1e-6))
    steepness = abs(b) / ((1 + r) * root)  # the friction that would stop the centres' tangential velocity
    out = np.zeros((len(QUANTITIES), len(NAMES)))
    out[0, NAMES.index("r")] = 1.0
    out[1, 1:4] = np.sign(b) * (1 - s) / ((1 + r) * root**3), -(1 - s) * steepness / (1 + r), -steepness
    out[2, NAMES.index("mass_ratio")] = 1 / ratio
    return np.nan_to_num(out)


def _read_row(row: Mapping[Any, Any], stated: float, gliding: bool) -> dict[str, Any]:
    """Read a contact; gliding: whether the bodies of recordings of two may glide."""
    values = _read_values(row)
    (v0, _), (b, b_std), (r, r_std), (s, s_std), (ratio, ratio_std) = values.values()
    told = 1 / stated if row["striker"] == "a" else stated
    turn, turn_std = _find_turn(row)
    speed_n, speed_t = v0 * np.sqrt(max(1 - b * b, 0.0)), v0 * abs(b)
    by_b, by_r, by_s = _differentiate_quantities(row)[1, 1:4]
    glides = row.get("motion_local") == GLIDE and (gliding or row["status"] == CROWD)
    return {
        "clip": int(row["clip"]),
        "bodies": (-1, -1),
        "levers": (1.0, -1.0),
        "share": 1.0,
        "a_strikes": row["striker"] == "a",
        "glides": glides,
        "speed_n": speed_n,
        "speed_t": speed_t,
        "slip_t": speed_t,
        "slip_t_std": 0.0,
        "slip_down": 0.0 if glides else speed_n,  # a rolling striker's surface moves down at about its speed
        "slip_down_std": 0.0,
        "slip": speed_t if glides else v0,
        "restitution": r,
        "restitution_std": r_std,
        "friction": (1 - s) * speed_t / ((1 + r) * speed_n),
        "friction_std": float(np.linalg.norm([by_b * b_std, by_r * r_std, by_s * s_std])),
        "recoil": float(np.log(ratio / told)) if ratio > 0 else np.nan,
        "recoil_std": ratio_std / ratio if ratio > 0 else np.nan,
        "turn": turn,
        "turn_std": turn_std,
    }


def _find_turn(row: Mapping[Any, Any]) -> tuple[float, float]:
    """Find by how much the velocities of both bodies do not change in opposite directions; NaN if it is not known.

    Masses do not matter. The error is that of the balance of momentum across the line of centres.
    """
    names = [f"v{k}{axis}_local" for k in AXES for axis in "xy"]
    if not (_is_known(row, "balance_t_local") and all(_is_known(row, name) for name in names)):
        return np.nan, np.nan
    into1, into2, out1, out2 = np.array([float(row[name]) for name in names]).reshape(4, 2)
    one, other = out1 - into1, into2 - out2
    size = float(np.hypot(*one) * np.hypot(*other))
    if not size > 0:
        return np.nan, np.nan
    return float(one[0] * other[1] - one[1] * other[0]) / size, float(row["balance_t_local_std"]) / size**0.5


def _read_slip(row: Mapping[Any, Any], slips: Mapping[int, Slip], friction_std: float) -> dict[str, Any]:
    """The columns of a contact of a crowd that depend on spins; NaN where the slip is not traced."""
    out: dict[str, Any] = {"bodies": (int(row["particle1"]), int(row["particle2"]))}
    slip = slips.get(int(row["collision"]))
    if slip is None:
        return out | dict.fromkeys((*SLIP_COLUMNS, "friction", "friction_std"), np.nan)
    values = (slip.across, slip.across_std, slip.down, slip.down_std, slip.size)
    out |= dict(zip(SLIP_COLUMNS, values, strict=True))
    return out if np.isfinite(friction_std) else out | {"friction": slip.friction, "friction_std": slip.friction_std}


def read_contacts(measured: Path | Sequence[Result] | pd.DataFrame) -> Contacts:
    """Read contacts as evidence on the impact, from a tracker's RESULTS or results in memory; none from a table."""
    if isinstance(measured, pd.DataFrame) or (isinstance(measured, Path) and not measured.is_dir()):
        return Contacts.of([])
    rows, stated, slips = list[dict[Any, Any]](), dict[int, float](), dict[int, dict[int, Slip]]()
    balances = dict[int, list[MomentumBalance]]()
    for film in _iterate_films(measured):
        own = film.rows.to_dict("records")
        rows += own
        stated[film.clip] = film.mass_ratio
        if (film.rows["status"] == CROWD).any():
            contacts = film.read_contacts()
            tracks, camera = film.read_tracks()
            slips[film.clip] = trace_slips(own, contacts, camera.ball_diameter if camera.knows_diameter else None)
            known = {int(row["collision"]) for row in own if np.isfinite(row["mass_ratio"])}
            balances[film.clip] = balance_groups(tracks, camera, contacts, known)
    found = Contacts.of(rows, stated, slips)
    for clip, groups in balances.items():
        found = found.with_balances(clip, groups)
    return found


class _Film(NamedTuple):
    """The local estimates of a clip, and functions that read more of it."""

    clip: int
    rows: pd.DataFrame
    mass_ratio: float  # that the camera file states
    read_contacts: Callable[[], pd.DataFrame]
    read_tracks: Callable[[], tuple[Tracks, Camera]]


def _iterate_films(measured: Path | Sequence[Result]) -> Iterator[_Film]:
    """Yield the clips with local estimates."""
    needed = {"v0_local", "b_local", "r_local", "s_local", "mass_ratio", "local", "local_shared", "status"}
    if isinstance(measured, Path):
        table = pd.read_parquet(measured / "estimates.parquet")
        for number, rows in table.groupby("clip") if needed <= set(table) else ():
            clip = int(str(number))
            ratio = read_clip(measured, clip)[1].mass_ratio
            read = partial(read_all_contacts, measured, clip), partial(read_clip, measured, clip)
            yield _Film(clip, rows, ratio or 1.0, *read)
        return
    for k, result in enumerate(measured):
        if needed <= set(result.estimates):
            ratio = result.camera.mass_ratio
            read = partial(getattr, result, "contacts"), partial(_get_tracks, result)
            yield _Film(k, result.estimates.assign(clip=k), ratio or 1.0, *read)


def _get_tracks(result: Result) -> tuple[Tracks, Camera]:
    return result.found, result.camera
