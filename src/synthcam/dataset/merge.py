"""Merge shards that were made separately into the dataset, byte for byte, that one process makes."""

import hashlib
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, NonNegativeInt, model_validator

from synthcam.dataset.files import VIDEO, read_checksums
from synthcam.dataset.generate import GenerationPlan, complete_dataset
from synthcam.dataset.partial_dataset import PartialDataset, open_partial, place_clip
from synthcam.dataset.video import VIDEO_FILES
from synthcam_shared.errors import InputError
from synthcam_shared.jobs import Progress


class _Machine(BaseModel):
    """The machine that drew, and its OpenGL; empty without video."""

    model_config = ConfigDict(extra="allow", strict=True)
    gl: dict[str, Any]
    machine: dict[str, Any]

    @model_validator(mode="after")
    def _check_renderer(self) -> Self:
        if self.gl and "renderer" not in self.gl:
            raise ValueError("gl: expected a renderer")
        return self


class _ShardDocument(_Machine):
    """Contents of shard.json: the document of a dataset, and which of its clips are in this shard."""

    scenes: list[dict[str, Any]]
    clips_per_scene: NonNegativeInt
    seed: NonNegativeInt
    video: bool
    version: str
    shard: tuple[int, int]
    clips: list[int]
    drawn_by: list[_Machine] | None = None

    @model_validator(mode="after")
    def _check_clips(self) -> Self:
        which, count = self.shard
        if self.version == version("synthcam"):
            plan = replace(GenerationPlan.from_document(self.model_dump()), shard=self.shard)
            if not 1 <= which <= count or self.clips != list(plan.numbers[: len(self.clips) + 1]):
                raise ValueError("clips: expected those of the shard")
        return self


def merge(shards: list[Path], output: Path, progress: Progress, withheld: Path | None = None) -> int:
    """Copy the clips of finished shards, in any order, into the dataset `output`. Returns the number of clips.

    Every file is compared with its shard's checksum on the way. If interrupted, the same call continues. progress:
    takes the clips done and the clips in all. withheld: another folder, for the truth. Raises InputError if the shards
    are not all those of one dataset, or one of their files has changed.
    """
    abouts = [_read_document(s) for s in shards]
    for shard in shards:
        if output.resolve().is_relative_to(shard.resolve()):
            raise InputError(f"{output}: expected a folder outside the shard {shard}")
    _check_complete(shards, abouts)
    plan = GenerationPlan.from_document(abouts[0])
    with open_partial(output, plan.document(), withheld) as made:
        done = made.list_done() if made else set(plan.numbers)
        progress(len(done), plan.total)
        if made:
            for shard, about in zip(shards, abouts, strict=True):
                sums = read_checksums(shard)
                for number in about["clips"]:
                    if number not in done:
                        _copy_clip(shard, sums, number, made)
                        done.add(number)
                        progress(len(done), plan.total)
            complete_dataset(plan, made, _list_machines(abouts))
    return plan.total


def _read_document(shard: Path) -> dict[str, Any]:
    path = shard / "truth" / "shard.json"
    if not path.is_file():
        raise InputError(f"{shard}: not a finished shard (no truth/shard.json)")
    try:
        return _ShardDocument.model_validate_json(path.read_bytes()).model_dump()
    except (OSError, ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
        raise InputError(f"{path}: damaged, expected what `synthcam generate --shard` writes") from None


def _check_complete(shards: list[Path], abouts: list[dict[str, Any]]) -> None:
    """All shards of one dataset, each once."""
    first, seen = abouts[0], dict[int, Path]()
    here = version("synthcam")
    if first["version"] != here:
        raise InputError(f"{shards[0]}: made by synthcam {first['version']}; merge it with that version, not {here}")
    keys_of_shard = {"shard", "clips", "gl", "machine", "drawn_by"}  # in which two shards of a dataset may differ
    for shard, about in zip(shards, abouts, strict=True):
        for key in sorted({*first, *about} - keys_of_shard):
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
    machines: list[dict[str, Any]] = []
    for about in sorted(abouts, key=lambda a: int(a["shard"][0])):
        for machine in about["drawn_by"] or [{"gl": about["gl"], "machine": about["machine"]}]:
            machines += [machine] if machine not in machines else []
    return machines


def _copy_clip(shard: Path, sums: dict[str, str], number: int, made: PartialDataset) -> None:
    name = f"clips/{number:06d}/"
    files = [f for f in sums if f.startswith(name)]
    if not files:
        raise InputError(f"{shard}: clip {number} is missing in its SHA256SUMS")
    of_truth = (f"truth/{each}" for each in ("scene.json", "tracks.parquet", "events.parquet", "energy.parquet"))
    files_of_clip = VIDEO_FILES | {VIDEO, "camera.json", *of_truth}
    if strange := next((f for f in files if f.removeprefix(name) not in files_of_clip), None):
        raise InputError(f"{shard}: {strange}: not a file of a clip")
    final, truth = made.clip(number)
    with place_clip(final, truth if made.withheld else None) as (folder, secret):
        for file in files:
            inside = file.removeprefix(name)
            target = secret / inside.removeprefix("truth/") if inside.startswith("truth/") else folder / inside
            target.parent.mkdir(parents=True, exist_ok=True)
            if (shard / file).resolve() != shard.resolve() / file:
                raise InputError(f"{shard / file}: leads out of its place by a link; expected a file of the shard")
            _copy(shard / file, target, sums[file])


def _copy(source: Path, target: Path, digest: str) -> None:
    found = hashlib.sha256()
    if not source.is_file():
        raise InputError(f"{source}: missing")
    with source.open("rb") as a, target.open("wb") as b:
        while chunk := a.read(1 << 20):
            found.update(chunk)
            b.write(chunk)
    if found.hexdigest() != digest:
        raise InputError(f"{source}: changed since its shard was made (its SHA-256 is not the one recorded)")
