"""Shards made apart, put together: the same dataset as one process makes."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

from synthcam.dataset import read_sums
from synthcam.generate import Plan, complete
from synthcam.partial import Partial, aside, begin, settle
from synthcam.settings import InputError

OWN = {"shard", "clips", "gl", "machine", "drawn_by"}  # what two shards of a dataset need not share
CHUNK = 1 << 20


def merge(shards: list[Path], output: Path, tick: Callable[[int, int], None], withheld: Path | None = None) -> int:
    """Copy the clips of finished shards into one dataset; how many.

    Every file is held to its shard's checksum on the way. Interrupted, the same call goes on. Raises InputError when
    the shards are not all those of one dataset, or when one of their files has changed.
    """
    abouts = [_about(s) for s in shards]
    _check_complete(shards, abouts)
    plan = Plan.of(abouts[0])
    made = begin(output, plan.document(), withheld)
    if made is None:
        tick(plan.total, plan.total)
        return plan.total
    try:
        done = made.done()
        tick(len(done), plan.total)
        for shard, about in zip(shards, abouts, strict=True):
            sums = read_sums(shard)
            for number in about["clips"]:
                if number not in done:
                    _copy_clip(shard, sums, number, made)
                    done.add(number)
                    tick(len(done), plan.total)
        complete(plan, made, _drawn_by(abouts))
    finally:
        made.close()
    return plan.total


def _about(shard: Path) -> dict[str, Any]:
    path = shard / "truth" / "shard.json"
    if not path.is_file():
        raise InputError(f"{shard}: not a finished shard (no truth/shard.json)")
    try:
        about = json.loads(path.read_text())
        complete = {"scenes", "clips_per_scene", "seed", "video", "version"} | OWN - {"drawn_by"} <= set(about)
    except (ValueError, TypeError):
        complete = False
    if not complete:
        raise InputError(f"{path}: damaged, expected what `synthcam generate --shard` writes")
    return dict(about)


def _check_complete(shards: list[Path], abouts: list[dict[str, Any]]) -> None:
    """All shards of one dataset, each once."""
    first, seen = abouts[0], dict[int, Path]()
    here = version("synthcam")
    if first["version"] != here:
        raise InputError(f"{shards[0]}: made by synthcam {first['version']}; merge it with that version, not {here}")
    for shard, about in zip(shards, abouts, strict=True):
        for key in sorted({*first, *about} - OWN):
            if about.get(key) != first.get(key):
                raise InputError(f"{shard}: a shard of another dataset than {shards[0]} (another {key})")
        which, of = about["shard"]
        if of != first["shard"][1]:
            raise InputError(f"{shard}: shard {which}/{of}, expected one of {first['shard'][1]} as {shards[0]}")
        if which in seen:
            raise InputError(f"{shard}: shard {which}/{of} is given twice, as {seen[which]} too")
        seen[which] = shard
    missing = sorted(set(range(1, first["shard"][1] + 1)) - set(seen))
    if missing:
        raise InputError(f"shard {missing[0]}/{first['shard'][1]} is missing among the {len(shards)} given")


def _drawn_by(abouts: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Each kind of machine that drew, once, in the order of the shards."""
    kinds: list[dict[str, Any]] = []
    for about in sorted(abouts, key=lambda a: int(a["shard"][0])):
        for kind in about.get("drawn_by", [{"gl": about["gl"], "machine": about["machine"]}]):
            kinds += [kind] if kind not in kinds else []
    return kinds


def _copy_clip(shard: Path, sums: dict[str, str], number: int, made: Partial) -> None:
    name = f"clips/{number:06d}/"
    final, hidden = made.clip(number)
    apart = made.withheld is not None
    folder = aside(final)
    secret = aside(hidden) if apart else folder / "truth"
    files = [f for f in sums if f.startswith(name)]
    if not files:
        raise InputError(f"{shard}: clip {number} is missing in its SHA256SUMS")
    try:
        for file in files:
            inside = file.removeprefix(name)
            target = secret / inside.removeprefix("truth/") if inside.startswith("truth/") else folder / inside
            target.parent.mkdir(parents=True, exist_ok=True)
            _copy(shard / file, target, sums[file])
        if apart:
            settle(secret, hidden)
        settle(folder, final)
    except BaseException:
        for leftover in (folder, secret):
            shutil.rmtree(leftover, ignore_errors=True)
        raise


def _copy(source: Path, target: Path, digest: str) -> None:
    found = hashlib.sha256()
    try:
        with source.open("rb") as a, target.open("wb") as b:
            while chunk := a.read(CHUNK):
                found.update(chunk)
                b.write(chunk)
    except FileNotFoundError:
        raise InputError(f"{source}: missing") from None
    if found.hexdigest() != digest:
        raise InputError(f"{source}: changed since its shard was made (its SHA-256 is not the one recorded)")
