"""Distributions in a scene, drawn for each clip: {uniform: [lo, hi]}, {normal: [mean, sd]}, {choice: [...]}."""

import zlib
from collections.abc import Callable
from typing import Any

import numpy as np

from synthcam_shared.errors import InputError

NORMAL_CUT_SIGMA = 4.0  # a normal distribution is cut off there, so that its extremes can be checked


def parse_distribution(value: Any, key: str, where: str) -> tuple[str, list[Any]] | None:
    """Return (kind, numbers) if a value is a distribution. Raises InputError if it is a wrong one."""
    if not (isinstance(value, dict) and len(value) == 1 and next(iter(value)) in ("uniform", "normal", "choice")):
        return None
    kind, args = next(iter(value.items()))
    largest = float(np.finfo(float).max)  # YAML has integers beyond it
    numbers = isinstance(args, list) and all(
        isinstance(a, int | float) and not isinstance(a, bool) and abs(a) <= largest for a in args
    )
    if kind == "choice":
        if not isinstance(args, list) or not args:
            raise InputError(f"{where}: {key}.choice: expected a list of values")
    elif not numbers or len(args) != 2:
        raise InputError(f"{where}: {key}.{kind}: expected two numbers, found {args!r}")
    elif kind == "uniform" and args[0] > args[1]:
        raise InputError(f"{where}: {key}.uniform: expected low before high, found {args!r}")
    elif kind == "normal" and args[1] < 0:
        raise InputError(f"{where}: {key}.normal: expected a standard deviation of 0 or more, found {args[1]!r}")
    return kind, args


def replace_distributions(value: Any, by: Callable[[str, str, list[Any]], Any], where: str = "", key: str = "") -> Any:
    """Replace every distribution in settings. by: takes its dotted key, its kind and its numbers."""
    if found := parse_distribution(value, key, where):
        return by(key, *found)
    if isinstance(value, dict):
        return {k: replace_distributions(v, by, where, f"{key}.{k}" if key else str(k)) for k, v in value.items()}
    if isinstance(value, list):
        return [replace_distributions(v, by, where, f"{key}.{k}") for k, v in enumerate(value)]
    return value


def replace_by_extremes(value: Any, which: str, where: str) -> Any:
    """Replace every distribution in settings by its lowest ("low") or highest ("high") value."""

    def pick(_: str, kind: str, args: list[Any]) -> Any:
        if kind == "normal":
            return args[0] + (-1 if which == "low" else 1) * NORMAL_CUT_SIGMA * args[1]
        return args[0] if which == "low" else args[-1]

    return replace_distributions(value, pick, where)


def find_distributions(value: Any) -> list[tuple[str, str, list[Any]]]:
    """Find every distribution in checked settings: its dotted key, its kind and its numbers."""
    found = list[tuple[str, str, list[Any]]]()
    replace_distributions(value, lambda *distribution: found.append(distribution))
    return found


def find_choices(value: Any) -> list[tuple[tuple[str, ...], list[Any]]]:
    """Find every choice in checked settings: its key and its options."""
    return [(tuple(key.split(".")), args) for key, kind, args in find_distributions(value) if kind == "choice"]


def pick_representatives(options: list[Any], key: str, where: str, most: int = 1000) -> list[Any]:
    """Pick the options of a choice to check: the extremes of the numbers, and each other value once.

    Raises InputError for more than `most` different other values, as each is checked.
    """
    numbers: list[Any] = []
    for kind in (int, float):
        of_kind = [x for x in options if type(x) is kind]
        numbers += {min(of_kind), max(of_kind)} if of_kind else set()
        numbers += [x for x in of_kind if x != x][:1]
    others = {repr(x): x for x in options if type(x) not in (int, float)}
    if len(others) > most:
        raise InputError(f"{where}: {key}.choice: expected at most {most} different values, found {len(others)}")
    return [*numbers, *others.values()]


def replace_at(plain: Any, key: tuple[str, ...], value: Any) -> Any:
    """Copy the nested settings of a scene with another value at `key`, such as a number in place of a distribution."""
    if not key:
        return value
    if isinstance(plain, list):
        k = int(key[0])
        return [*plain[:k], replace_at(plain[k], key[1:], value), *plain[k + 1 :]]
    return plain | {key[0]: replace_at(plain[key[0]], key[1:], value)}


def draw_settings(value: Any, number: int, seed: int) -> Any:
    """Draw every distribution in settings, each from its own random stream: (seed, clip number, key)."""

    def draw(key: str, kind: str, args: list[Any]) -> Any:
        stream = np.random.SeedSequence(seed, spawn_key=(number, zlib.crc32(key.encode())))
        rng = np.random.Generator(np.random.PCG64(stream))
        if kind == "uniform":
            return float(rng.uniform(*args))
        if kind == "normal":
            return float(args[0] + args[1] * np.clip(rng.standard_normal(), -NORMAL_CUT_SIGMA, NORMAL_CUT_SIGMA))
        return args[int(rng.integers(len(args)))]

    return replace_distributions(value, draw)
