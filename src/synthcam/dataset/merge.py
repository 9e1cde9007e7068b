"""Shards made apart, put together: the same dataset as one process makes."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from synthcam.dataset.files import VIDEO, read_sums
from synthcam.dataset.generate import GenerationPlan, complete_dataset
from synthcam.dataset.staging import PartialDataset, check_apart, move_into_place, name_temporary, open_partial
from synthcam.dataset.video import FILMS
from synthcam_shared.errors import InputError
from synthcam_shared.outputs import as_input_error

OWN = {"shard", "clips", "gl", "machine", "drawn_by"}  # what two shards of a dataset need not share
CHUNK = 1 << 20
FILES = FILMS | {VIDEO, "camera.json", "truth/scene.json", "truth/tracks.parquet", "truth/events.parquet"}  # of a clip


def merge(shards: list[Path], output: Path, progress: Callable[[int, int], None], withheld: Path | None = None) -> int:
    """Copy the clips of finished shards into one dataset. Interrupted, the same call goes on.

    Parameters
    ----------
    shards : list of Path
        All of one dataset, in any order. Every file is held to its shard's checksum on the way.
    output : Path
        Folder to make.
    progress : callable
        Takes clips done and clips in all.
    withheld : Path, optional
        Another folder, for the truth.

    Returns
    -------
    int
        How many clips.

    Raises
    ------
    InputError
        Where the shards are not all those of one dataset, or one of their files has changed.
    """
    if withheld:
        check_apart(output, withheld)
    abouts = [_about(s) for s in shards]
    for shard in shards:
        if output.resolve().is_relative_to(shard.resolve()):
            raise InputError(f"{output}: expected a folder outside the shard {shard}")
    _check_complete(shards, abouts)
    plan = GenerationPlan.from_document(abouts[0])
    made = open_partial(output, plan.document(), withheld)
    if made is None:
        progress(plan.total, plan.total)
        return plan.total
    try:
        with as_input_error(made.folder, "; the same command goes on where it stopped"):
            done = made.list_done()
            progress(len(done), plan.total)
            for shard, about in zip(shards, abouts, strict=True):
                sums = read_sums(shard)
                for number in about["clips"]:
                    if number not in done:
                        _copy_clip(shard, sums, number, made)
                        done.add(number)
                        progress(len(done), plan.total)
            complete_dataset(plan, made, _list_machines(abouts))
    except BaseException:
        if not made.list_done():
            made.discard()
        raise
    finally:
        made.close()
    return plan.total


def _about(shard: Path) -> dict[str, Any]:
    path = shard / "truth" / "shard.json"
    if not path.is_file():
        raise InputError(f"{shard}: not a finished shard (no truth/shard.json)")
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
        keys = {"scenes", "clips_per_scene", "seed", "video", "version"} | OWN - {"drawn_by"}
        whole = keys <= set(about) and (about["version"] != version("synthcam") or _sound(about))
    except (OSError, ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
        whole = False
    if not whole:
        raise InputError(f"{path}: damaged, expected what `synthcam generate --shard` writes")
    return dict(about)


def _sound(about: Any) -> bool:
    """Whether a shard's document is of the right kinds throughout, and lists the clips that are this shard's."""
    which, of = about["shard"]
    numbers = [about["clips_per_scene"], about["seed"], which, of]
    if not all(type(x) is int for x in numbers) or not 1 <= which <= of or min(numbers) < 0:
        return False
    drawn_by = about.get("drawn_by", [about])
    kinds = [about["gl"], about["machine"], *(part for d in drawn_by for part in (d["gl"], d["machine"]))]
    if not all(isinstance(kind, dict) for kind in kinds):
        return False
    if not all("renderer" in d["gl"] or not d["gl"] for d in drawn_by):
        return False
    plan = replace(GenerationPlan.from_document(about), shard=(which, of))
    return (
        type(plan.video) is bool
        and isinstance(about["version"], str)
        and isinstance(about["clips"], list)
        and len(about["clips"]) == plan.total
        and about["clips"] == list(plan.numbers)
    )


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


def _list_machines(abouts: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Each kind of machine that drew, once, in the order of the shards."""
    kinds: list[dict[str, Any]] = []
    for about in sorted(abouts, key=lambda a: int(a["shard"][0])):
        for kind in about.get("drawn_by", [{"gl": about["gl"], "machine": about["machine"]}]):
            kinds += [kind] if kind not in kinds else []
    return kinds


def _copy_clip(shard: Path, sums: dict[str, str], number: int, made: PartialDataset) -> None:
    name = f"clips/{number:06d}/"
    final, hidden = made.clip(number)
    apart = made.withheld is not None
    folder = name_temporary(final)
    secret = name_temporary(hidden) if apart else folder / "truth"
    files = [f for f in sums if f.startswith(name)]
    if not files:
        raise InputError(f"{shard}: clip {number} is missing in its SHA256SUMS")
    if strange := next((f for f in files if f.removeprefix(name) not in FILES), None):
        raise InputError(f"{shard}: {strange}: not a file of a clip")
    try:
        for file in files:
            inside = file.removeprefix(name)
            target = secret / inside.removeprefix("truth/") if inside.startswith("truth/") else folder / inside
            target.parent.mkdir(parents=True, exist_ok=True)
            if (shard / file).resolve() != shard.resolve() / file:
                raise InputError(f"{shard / file}: leads out of its place by a link; expected a file of the shard")
            _copy(shard / file, target, sums[file])
        if apart:
            move_into_place(secret, hidden)
        move_into_place(folder, final)
    except BaseException:
        for leftover in (folder, secret):
            shutil.rmtree(leftover, ignore_errors=True)
        raise


def _copy(source: Path, target: Path, digest: str) -> None:
    found = hashlib.sha256()
    if not source.is_file():
        raise InputError(f"{source}: missing")
    with source.open("rb") as a, target.open("wb") as b:
        while chunk := a.read(CHUNK):
            found.update(chunk)
            b.write(chunk)
    if found.hexdigest() != digest:
        raise InputError(f"{source}: changed since its shard was made (its SHA-256 is not the one recorded)")
