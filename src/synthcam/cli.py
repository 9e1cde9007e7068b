"""The command `synthcam`: generate, stream, merge, verify, preview, serve, export, schema, effects, doctor."""

import importlib.util
import inspect
import json
import math
import sys
import textwrap
import time
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from synthcam_shared.application import make_command_line, progress_bar
from synthcam_shared.application import run as run_command
from synthcam_shared.errors import InputError, NoGL

app = make_command_line(
    "synthcam", "Simulate and render rolling balls that collide, with the ground truth of their motion."
)
Json = Annotated[bool, typer.Option("--json", help="Print a machine-readable summary.")]
Withhold = Annotated[
    Path | None, typer.Option(metavar="TRUTH", help="Another folder for the truth; the dataset is then a challenge.")
]
Set = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override a value of the scene.")]

EffectsDir = Annotated[
    list[Path] | None,
    typer.Option("--effects", metavar="DIR", help="A folder with your own effects, NAME.py; repeatable."),
]

ModelFile = Annotated[
    Path | None,
    typer.Option(
        "--model", metavar="MODEL", help="A model file that replaces ball, model, effects and free laws of the scenes."
    ),
]


def add_effect_folders(folders: list[Path] | None) -> None:
    """Add the effects of these folders to the library. Raises InputError."""
    from synthcam.library import add_effects

    for folder in folders or ():
        add_effects(folder)


@app.command()
def generate(
    scenes: Annotated[list[Path], typer.Argument(metavar="SCENE...", help="Scene files (YAML).")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DATASET", help="Folder to make.")],
    clips: Annotated[int, typer.Option(min=1, help="Clips of each scene.")] = 1,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of everything random; default: 0.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; default: as many as are quickest.")] = None,
    shard: Annotated[str, typer.Option(metavar="I/N", help="Make only every N-th clip from the I-th on.")] = "",
    scheduler: Annotated[str, typer.Option(metavar="ADDRESS", help="A Dask scheduler for the work.")] = "",
    no_video: Annotated[bool, typer.Option("--no-video", help="Write truth and camera only, without frames.")] = False,
    compression: Annotated[str, typer.Option(help="Compression of the frames: none, or zstd (lossless).")] = "none",
    encode: Annotated[str, typer.Option(metavar="CODEC", help="A video too: h264:crf=23,gamma=2.2, mjpeg, ffv1.")] = "",
    withhold_truth: Withhold = None,
    set_: Set = None,
    model: ModelFile = None,
    effects_dir: EffectsDir = None,
    as_json: Json = False,
) -> None:
    """Make a dataset from SCENE: simulate, render, expose, write. If interrupted, the same command continues.

    Example: synthcam generate scenes/benchmark.yaml -o out/benchmark --clips 100
    """
    add_effect_folders(effects_dir)
    from synthcam.dataset.generate import MAX_CLIPS, GenerationPlan, generate_dataset
    from synthcam.dataset.partial_dataset import check_apart
    from synthcam.scene.scene import read_scene
    from synthcam.scene.visibility import describe_unseen_balls

    started = time.monotonic()
    if clips * len(scenes) > MAX_CLIPS:
        raise InputError(f"--clips {clips}: expected at most {MAX_CLIPS} clips in all")
    if withhold_truth:
        check_apart(output, withhold_truth)
    if withhold_truth and seed is None:
        reason = "which nobody can guess: scene and seed determine the truth"
        raise InputError(f"--withhold-truth: expected --seed too, {reason}")
    changes = list(set_ or ())
    if encode:
        from synthcam.dataset.video import parse_encoding  # here alone: FFmpeg's libraries are slow to load

        changes += [f"video.{key}={value}" for key, value in parse_encoding(encode, "--encode").items()]
    read = tuple(read_scene(s, tuple(changes), model) for s in scenes)
    plan = GenerationPlan(read, clips, seed or 0, not no_video, _compression(compression), _shard(shard))
    if plan.shard and withhold_truth:
        raise InputError("--shard: a shard keeps its truth; give --withhold-truth to `synthcam merge`")
    hints = [describe_unseen_balls(scene, k * clips, plan.seed) for k, scene in enumerate(read)]
    with progress_bar("clips") as progress:
        tell = partial(print, file=sys.stderr) if sys.stderr.isatty() and not scheduler else None

        def show(done: int, total: int) -> None:
            while hints:  # once all that would refuse the command is checked
                _print_hint(hints.pop(0))
            progress(done, total)

        outcome = generate_dataset(plan, output, workers or 0, show, withhold_truth, scheduler, tell)
    listed = 20  # failed clips; --json lists all
    for line in outcome.failed[:listed]:
        print(f"synthcam: {line}", file=sys.stderr)
    if len(outcome.failed) > listed:
        print(f"synthcam: and {len(outcome.failed) - listed} more clips", file=sys.stderr)
    seconds = time.monotonic() - started
    summary: dict[str, Any] = {"dataset": str(output), "clips": plan.total, "made": outcome.made}
    summary |= {"failed": len(outcome.failed), "failures": list(outcome.failed), "seconds": round(seconds, 2)}
    made = f"{plan.total} clips, {outcome.made} of them made in this run, in {seconds:.1f} s"
    _print_result(summary, as_json, f"{output}: {made}")
    if outcome.failed:
        kept = f"; the rest are kept in {output}.partial" if len(outcome.failed) < plan.total else ""
        raise InputError(f"{output}: {len(outcome.failed)} of {plan.total} clips could not be made{kept}")


def _shard(text: str) -> tuple[int, int] | None:
    if not text:
        return None
    which, slash, of = text.partition("/")
    if slash and which.isdecimal() and of.isdecimal() and 1 <= int(which) <= int(of):
        return int(which), int(of)
    raise InputError(f"--shard {text}: expected I/N with I from 1 to N, as in 1/3")


def _compression(name: str) -> str:
    if name not in ("none", "zstd"):
        raise InputError(f"--compression {name}: expected none or zstd")
    if name == "zstd" and importlib.util.find_spec("imagecodecs") is None:
        raise InputError("--compression zstd: imagecodecs is not installed; type: pip install 'synthcam[zstd]'")
    return name


@app.command()
def stream(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="A scene file (YAML).")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FOLDER", help="Folder for the shards.")],
    frames: Annotated[int | None, typer.Option(min=1, help="Write clips with at least so many frames.")] = None,
    clips: Annotated[int | None, typer.Option(min=1, help="Write so many clips.")] = None,
    shards_of: Annotated[int | None, typer.Option(min=1, help="Clips of a shard; default: about 1,000 frames.")] = None,
    every: Annotated[int, typer.Option(min=1, help="Make every n-th frame of a clip only.")] = 1,
    kind: Annotated[str, typer.Option("--format", metavar="NAME", help="webdataset or zarr.")] = "webdataset",
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; default: as many as are quickest.")] = None,
    set_: Set = None,
    model: ModelFile = None,
    effects_dir: EffectsDir = None,
    as_json: Json = False,
) -> None:
    """Write frames with boxes and masks of their balls, for training, until --frames, --clips or Ctrl-C.

    Each shard appears when it is complete. The same command continues; with more --clips, it goes further.

    Example: synthcam stream scenes/tray.yaml -o out/stream --frames 10000
    """
    add_effect_folders(effects_dir)
    from synthcam.dataset.shards import plan_shards, write_shards
    from synthcam.scene.scene import read_scene
    from synthcam.scene.visibility import describe_unseen_balls

    started = time.monotonic()
    read = read_scene(scene, tuple(set_ or ()), model)
    plan = plan_shards(read, seed, frames, clips, shards_of, every, kind)
    _print_hint(describe_unseen_balls(read, 0, seed))
    with progress_bar("clips") as progress:
        outcome = write_shards(plan, output, workers or 0, progress)
    for line in outcome.left_out:
        _print_hint(line)
    seconds = time.monotonic() - started
    summary: dict[str, Any] = {"output": str(output), "format": kind, "clips": plan.clips, "shards": outcome.shards}
    summary |= {"frames": outcome.frames, "left_out": list(outcome.left_out), "seconds": round(seconds, 2)}
    made = f"{outcome.shards} shards with {outcome.frames} frames made in this run, in {seconds:.1f} s"
    _print_result(summary, as_json, f"{output}: {plan.clips} clips, {made}")


@app.command()
def merge(
    shards: Annotated[list[Path], typer.Argument(metavar="SHARD...", help="Finished shards, in any order.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DATASET", help="Folder to make.")],
    withhold_truth: Withhold = None,
    effects_dir: EffectsDir = None,
    as_json: Json = False,
) -> None:
    """Merge each SHARD into the dataset, byte for byte, that one process makes. The shards are not changed.

    Example: synthcam merge out/part1 out/part2 out/part3 -o out/benchmark
    """
    add_effect_folders(effects_dir)
    from synthcam.dataset.merge import merge as merge_shards

    with progress_bar("clips") as progress:
        clips = merge_shards(shards, output, progress, withhold_truth)
    summary = {"dataset": str(output), "clips": clips}
    _print_result(summary, as_json, f"{output}: {clips} clips from {len(shards)} shards")


@app.command()
def preview(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="A scene file (YAML).")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="A .png, .gif or .mp4 to write.")],
    clip: Annotated[int, typer.Option(min=0, help="Number of the clip.")] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    frame: Annotated[int | None, typer.Option(min=0, help="Number of the frame; default: before contact.")] = None,
    magnify: Annotated[
        int, typer.Option(min=0, help="Magnification of the balls below the frame, at most; 0: none.")
    ] = 12,
    from_above: Annotated[
        bool, typer.Option("--from-above", help="Draw the motion from above, with walls and events, not as filmed.")
    ] = False,
    set_: Set = None,
    model: ModelFile = None,
    effects_dir: EffectsDir = None,
    as_json: Json = False,
) -> None:
    """Render one frame of SCENE (.png), with the balls magnified below it.

    For .gif and .mp4: render all frames in slow motion, cropped to the paths of the balls and magnified.

    With --from-above: draw paths, walls and events (.png), or the bodies as they move (.gif, .mp4), in less time.

    Example: synthcam preview scenes/painter_behringer.yaml -o frame.png
    """
    add_effect_folders(effects_dir)
    from synthcam.dataset.preview import write_animation, write_motion_map, write_preview
    from synthcam.scene.scene import read_scene
    from synthcam.scene.visibility import describe_unseen_balls

    kind = output.suffix.lower()
    if kind not in (".png", ".gif", ".mp4"):
        raise InputError(f"{output}: expected a name that ends in .png, .gif or .mp4")
    if from_above and frame is not None:
        raise InputError("--frame: of a film; expected no --from-above with it")
    read = read_scene(scene, tuple(set_ or ()), model)
    drawn = read.draw(clip, seed)
    summary: dict[str, Any] = {"output": str(output)}
    if from_above:
        write_motion_map(drawn, output)
        _print_result(summary, as_json, f"{output}: the motion of clip {clip} of {scene} from above")
    elif kind == ".png":
        write_preview(drawn, output, frame, magnify)
        _print_result(summary, as_json, f"{output}: a frame of clip {clip} of {scene}")
    else:
        slower = write_animation(drawn, output)
        text = f"{output}: clip {clip} of {scene}, in {slower:.3g} times slow motion"
        _print_result(summary | {"slower": slower}, as_json, text)
    _print_hint(describe_unseen_balls(read, clip, seed, clip=drawn))


@app.command()
def serve() -> None:
    """Answer requests for pictures of scenes: a line of JSON each, on standard input and output.

    The page of `tracker open` starts it for its sliders. docs/format.md lists the keys.

    Example: synthcam serve < requests.jsonl
    """
    from synthcam.dataset.live_preview import answer_requests

    answer_requests(sys.stdin, partial(print, flush=True))


@app.command()
def verify(dataset: Annotated[Path, typer.Argument(metavar="DATASET")], as_json: Json = False) -> None:
    """Compare every file of DATASET with its checksum. Exit status 1 if one is changed, missing or new.

    Example: synthcam verify out/benchmark
    """
    from synthcam.dataset.files import verify as verify_dataset

    with progress_bar("files") as progress:
        found = verify_dataset(dataset, progress)
    for problem in found.problems:
        print(problem, file=sys.stderr)
    summary = {"dataset": str(dataset), "files": found.files, "problems": list(found.problems)}
    verdict = f"{len(found.problems)} problems" if found.problems else "all unchanged"
    _print_result(summary, as_json, f"{dataset}: {found.files} files, {verdict}")
    if found.problems:
        raise typer.Exit(1)


@app.command()
def export(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET")],
    kind: Annotated[str, typer.Option("--format", metavar="NAME", help="mot, zarr, ffv1, h264:crf=23, ...")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder to make.")],
    truth: Annotated[Path | None, typer.Option(metavar="TRUTH", help="The truth, if it was withheld.")] = None,
    effects_dir: EffectsDir = None,
    as_json: Json = False,
) -> None:
    """Export DATASET with -o to the format of another program.

    Example: synthcam export out/benchmark --format mot -o out/benchmark_mot
    """
    add_effect_folders(effects_dir)
    from synthcam.dataset.export import export as export_dataset

    with progress_bar("clips") as progress:
        clips = export_dataset(dataset, kind, output, progress, truth)
    _print_result({"output": str(output), "format": kind, "clips": clips}, as_json, f"{output}: {clips} clips")


@app.command()
def effects(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="One effect; default: all.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="FILE", help="A .png to draw.")] = None,
    folder: EffectsDir = None,
    as_json: Json = False,
) -> None:
    """List the effects: laws, parameters, typical values. With -o, draw what one of them does to the tracks.

    Example: synthcam effects hop -o hop.png
    """
    add_effect_folders(folder)
    from synthcam.library import library
    from synthcam_shared.settings import did_you_mean

    known = library()
    if name is not None and name not in known:
        near = did_you_mean(name, known) or f"; expected one of {', '.join(known)}"
        raise InputError(f"{name}: no such effect{near}")
    if output is not None and (name is None or output.suffix.lower() != ".png"):
        raise InputError(f"-o {output}: expected the NAME of one effect, and a file that ends in .png")
    for effect in known.values() if name is None else [known[name]]:
        doc = inspect.cleandoc(effect.__doc__ or "")
        if as_json:
            about = {"effect": effect.name(), "law": doc, "bends": list(effect.laws)}
            keys = [{"scale" if k == "typical" else k: v for k, v in vars(p).items()} for p in effect.parameters()]
            for own in keys:  # null: no limit
                own |= {k: own[k] if math.isfinite(own[k]) else None for k in ("low", "high")}
            print(json.dumps(about | {"parameters": keys}))
            continue
        print(f"{effect.name()}: {doc.splitlines()[0]}")
        if name is not None:
            print(textwrap.indent("\n".join(doc.splitlines()[1:]), "    "))
            for p in effect.parameters():
                kind = ("shape parameter, given" if p.given else "shape parameter") if p.fixed else "strength"
                print(f"    {p.name}: {kind}, {p.unit}, typically {p.typical:g}, from {p.low:g} to {p.high:g}")
    if output is not None and name is not None:
        from synthcam.dataset.effect_drawing import draw_effect
        from synthcam.dataset.preview import check_picture_output
        from synthcam.effect import with_typical_values

        check_picture_output(output, "synthcam effects")
        apart = draw_effect(with_typical_values(known[name]), output)
        if not as_json:
            print(f"    {output}: the effect shifts the tracks by up to {apart:.3g} um")
    elif name is not None and not as_json:
        print(f"    to draw what it does to the tracks: synthcam effects {name} -o {name}.png")


@app.command()
def schema(effects_dir: EffectsDir = None) -> None:
    """Print the JSON Schema of a scene, for editors and other programs.

    Example: synthcam schema > scene.schema.json
    """
    add_effect_folders(effects_dir)
    from synthcam.scene.scene import schema as scene_schema

    print(json.dumps(scene_schema(), indent=1))


@app.command()
def doctor(as_json: Json = False) -> None:
    """Show which OpenGL renders the frames and how fast; if none works, what to install.

    Example: synthcam doctor
    """
    from synthcam.camera.render import gl_info

    info: dict[str, Any] = dict(gl_info())
    from synthcam.dataset.preview import measure_speed  # slow to load, and needless where nothing draws

    info["frames_per_second"] = round(measure_speed(), 1)
    text = "\n".join(f"{key}: {value}" for key, value in info.items())
    _print_result(info, as_json, text + "\n(two balls, 640 x 480 px, rendered and exposed by one process)")


def _print_hint(text: str) -> None:
    if text:
        print(f"synthcam: {text}", file=sys.stderr)


def _print_result(summary: dict[str, Any], as_json: bool, text: str) -> None:
    print(json.dumps(summary) if as_json else text)


def main() -> None:
    """Run the command line `synthcam`; exit status: 0 done, 1 a check failed, 2 bad input, 130 interrupted."""
    run_command(app, "synthcam", (InputError, NoGL), ("generate", "merge", "stream"))


if __name__ == "__main__":
    main()
