"""Values that are drawn anew for each clip: {uniform: [lo, hi]}, {normal: [mean, sd]}, {choice: [...]}."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from synthcam_shared.errors import InputError

LARGEST = float(np.finfo(float).max)  # YAML has integers beyond it
MOST = 1000  # different options of a choice that are no numbers
WIDEST = 4.0  # a normal distribution is cut at so many standard deviations


def parse_distribution(value: Any, key: str, where: str) -> tuple[str, list[Any]] | None:
    """(kind, numbers) when a value is a distribution. Raises InputError when it is a wrong one."""
    if not (isinstance(value, dict) and len(value) == 1 and next(iter(value)) in ("uniform", "normal", "choice")):
        return None
    kind, args = next(iter(value.items()))
    numbers = isinstance(args, list) and all(
        isinstance(a, int | float) and not isinstance(a, bool) and abs(a) <= LARGEST for a in args
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


def replace_by_extremes(value: Any, which: str, key: str, where: str) -> Any:
    """Settings with every distribution replaced by its lowest or highest value."""
    found = parse_distribution(value, key, where)
    if found:
        kind, args = found
        sign = -1 if which == "low" else 1
        if kind == "normal":
            return args[0] + sign * WIDEST * args[1]
        return args[0] if which == "low" else args[-1]
    if isinstance(value, dict):
        return {k: replace_by_extremes(v, which, f"{key}.{k}" if key else str(k), where) for k, v in value.items()}
    return value


def find_choices(value: Any, key: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], list[Any]]]:
    """Every choice in the settings: its key and its options."""
    if isinstance(value, dict):
        if set(value) == {"choice"}:
            yield key, value["choice"]
        else:
            for k, v in value.items():
                yield from find_choices(v, (*key, k))


def pick_representatives(options: list[Any], key: str, where: str) -> list[Any]:
    """Those options whose check is a check of all: of numbers the extremes, of others each once. Raises InputError."""
    numbers: list[Any] = []
    for kind in (int, float):
        alike = [x for x in options if type(x) is kind]
        numbers += {min(alike), max(alike)} if alike else set()
        numbers += [x for x in alike if x != x][:1]
    others = {repr(x): x for x in options if type(x) not in (int, float)}
    if len(others) > MOST:
        raise InputError(f"{where}: {key}.choice: expected at most {MOST} different values, found {len(others)}")
    return [*numbers, *others.values()]


def replace_at(plain: Any, key: tuple[str, ...], value: Any) -> Any:
    """A copy of nested settings with the value at `key` changed."""
    return value if not key else plain | {key[0]: replace_at(plain[key[0]], key[1:], value)}


def draw(value: Any, number: int, seed: int, key: str = "") -> Any:
    """Settings with every distribution drawn, each from its own stream: (seed, clip number, key)."""
    found = parse_distribution(value, key, "")
    if found:
        kind, args = found
        stream = np.random.SeedSequence(seed, spawn_key=(number, zlib.crc32(key.encode())))
        rng = np.random.Generator(np.random.PCG64(stream))
        if kind == "uniform":
            return float(rng.uniform(*args))
        if kind == "normal":
            return float(args[0] + args[1] * np.clip(rng.standard_normal(), -WIDEST, WIDEST))
        return args[int(rng.integers(len(args)))]
    if isinstance(value, dict):
        return {k: draw(v, number, seed, f"{key}.{k}" if key else str(k)) for k, v in value.items()}
    return value
