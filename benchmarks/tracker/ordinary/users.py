"""Cases of new users: who strikes, detectors of one's own, units, other datasets, lossy copies, and Python."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tifffile

from benchmarks.harness import ROOT
from benchmarks.tracker.ordinary.case import Case, Judge, Outcome, Program, Words, run_to_the_end
from benchmarks.tracker.ordinary.contacts import NotOk
from benchmarks.tracker.ordinary.films import write_tiff
from benchmarks.tracker.ordinary.judges import ERRORS, Either, Found, Measured, Printed, Refused, Said
from benchmarks.tracker.ordinary.sources import film_glints, know_table, list_rows, measure, track, write_camera
from synthcam.dataset.generate import GenerationPlan, generate_dataset
from synthcam.scene.scene import read_scene

video: Any = importlib.import_module("tracker_video")
SMALL = ("camera.size=[200,160]", "camera.scale=3e-4", "timing.frames=60", "timing.contact_frame=20")
TEN_LINES = '''import numpy as np
from scipy import ndimage


def spot(frame):
    """Centroids of the spots that are brighter than half the brightest pixel."""
    light = frame - np.median(frame)
    labels, count = ndimage.label(light > max(light.max() / 2, 30))
    centres = ndimage.center_of_mass(light, labels, range(1, count + 1))
    return [(x, y) for y, x in centres]
'''
CLASS = '''from tracker.detection.glints import Glints

from spot import spot


class Spots:
    """The same as a class, which is made for each film."""

    def __init__(self, view):
        self.camera = view.camera

    def __call__(self, frame):
        x, y = zip(*spot(frame))
        return Glints.at(x, y, std=0.1, flux=1.0)
'''
READ = """import inspect, json, sys
import numpy as np
import pandas as pd
import synthcam
import tracker

camera = json.load(open("camera.json"))
"""


def write_table(path: Path, strikers: tuple[int, ...] = (1, 0, 1), named: bool = False, scale: float = 1.0) -> None:
    """Clips of two balls, of which either strikes; their numbers, or names that follow the bodies."""
    rng, frame, parts = np.random.default_rng(0), np.arange(40), []
    for clip, striker in enumerate(strikers):
        moving = 100 + 9.0 * np.minimum(frame, 20) + 4.0 * np.maximum(frame - 20, 0)
        struck = 295 + 5.0 * np.maximum(frame - 20, 0)
        x = np.concatenate([moving, struck] if striker == 0 else [struck, moving]) + rng.normal(0, 0.05, 80)
        ball = np.repeat(["a", "b"] if named else [0, 1], 40)
        rows = {"clip": clip, "frame": np.tile(frame, 2), "particle": ball, "x": scale * x}
        parts.append(pd.DataFrame({**rows, "y": scale * (240 + rng.normal(0, 0.05, 80))}))
    pd.concat(parts).to_csv(path, index=False)


WIDE: dict[str, Any] = {"fps": 250.0, "size": [640, 480], "scale": 1.6e-4, "ball_diameter": 2.4e-3}


def make_dataset(folder: Path, seed: int = 0, clips: int = 1, filmed: bool = False) -> Path:
    """A small dataset, of one clip without frames unless more is asked for."""
    scene = read_scene(ROOT / "scenes/painter_behringer.yaml", SMALL)
    generate_dataset(GenerationPlan((scene,), clips, seed, filmed), folder, 1, lambda done, of: None)
    return folder


def score_positions(columns: tuple[str, str], seed: int) -> Callable[[Path], Words]:
    """True positions of a dataset as a table, scored as centres against it, or against one of another seed."""

    def make(folder: Path) -> Words:
        make_dataset(folder / "dataset", 0)
        truth = make_dataset(folder / "other", seed) if seed else folder / "dataset"
        true = pd.read_parquet(folder / "dataset/clips/000000/truth/tracks.parquet").query("visible")
        noisy = true[list(columns)].to_numpy() + 0.02 * np.random.default_rng(0).standard_normal((len(true), 2))
        table = true[["frame", "particle"]].assign(x=noisy[:, 0], y=noisy[:, 1])
        table.to_csv(folder / "t.csv", index=False)
        return ["tracker", "score", "results", "--truth", truth.name, "-o", "new"]

    return make


def measure_first(program: Program, folder: Path, words: Words) -> Outcome:
    """Measure the table, then score the results."""
    camera = "dataset/clips/000000/camera.json"
    first = run_to_the_end(
        program, folder, ["tracker", "measure", "t.csv", "--camera", camera, "-o", "results", "--no-pages"]
    )
    return first if first.status else run_to_the_end(program, folder, words)


def run_python(script: str, prepare: Callable[[Path], object] = lambda folder: None) -> Callable[[Path], Words]:
    """A script that reads camera.json and t.csv."""

    def make(folder: Path) -> Words:
        write_camera(folder, know_table())
        pd.DataFrame(list_rows(), columns=["frame", "particle", "x", "y"]).to_csv(folder / "t.csv", index=False)
        prepare(folder)
        return ["python", "-c", READ + script]

    return make


def track_with(detector: str) -> Callable[[Path], Words]:
    """The film of glints, tracked by a detector of the user on the command line."""

    def write(folder: Path) -> Path:
        (folder / "spot.py").write_text(TEN_LINES)
        (folder / "spots.py").write_text(CLASS)
        return write_tiff("film.tif", lambda frames: frames)(folder)

    return track(write, film_glints, "--detector", detector)


def write_copy(name: str, codec: str, pixels: str, **options: str) -> Callable[[Path], Path]:
    """A lossy copy of the film of glints."""
    return lambda folder: Path(
        video.encode(folder / name, film_glints().frames, codec, pixels, rate=60, options=options, full=True)
    )


def write_beside(folder: Path) -> Words:
    """A film and camera.json in one folder, tracked without --camera."""
    write_camera(folder, film_glints().camera)
    tifffile.imwrite(folder / "film.tif", film_glints().frames)
    return ["tracker", "track", "film.tif", "-o", "new", "--no-pages"]


def generate_too_fast(folder: Path) -> Words:
    """A scene of 30 m/s."""
    return ["synthcam", "generate", "painter_behringer", "-o", "new", "--no-video", "--set", "launch.v0=30",
            *(word for key in SMALL[:2] for word in ("--set", key))]  # fmt: skip


def extend_dataset(program: Program, folder: Path, words: Words) -> Outcome:
    """Make forty clips, then sixty in the same folder."""
    base = [*words, *(word for key in SMALL for word in ("--set", key))]
    first = run_to_the_end(program, folder, [*base, "--clips", "40"])
    before = {str(p): p.read_bytes() for p in sorted(folder.glob("new/clips/*/truth/tracks.parquet"))}
    second = run_to_the_end(program, folder, [*base, "--clips", "60"])
    after = [p.read_bytes() for p in sorted(folder.glob("new/clips/*/truth/tracks.parquet"))]
    kept = len(before) == 40 and list(before.values()) == after[:40]
    out = f'{{"clips": {len(after)}, "kept": {str(kept).lower()}}}'
    return Outcome(
        status=second.status, out=out, err=first.err + second.err, folder=folder, seconds=first.seconds + second.seconds
    )


PYTHON: dict[str, tuple[str, Judge]] = {
    "measure_all of a table of two clips": (
        """
one = pd.read_csv("t.csv")
table = pd.concat([one.assign(clip=clip) for clip in (3, 7)])
results = tracker.measure_all(table, camera)
every = pd.concat([result.estimates for result in results])
print(json.dumps({"clips": every["clip"].tolist(), "r": every["r"].mean()}))
""",
        Printed({"clips": [3, 7], "r": 0.903}, near=1e-3),
    ),
    "measure of a table of two clips": (
        """
one = pd.read_csv("t.csv")
try:
    tracker.measure(pd.concat([one.assign(clip=clip) for clip in (3, 7)]), camera)
except tracker.InputError as error:
    print(json.dumps({"error": str(error)}))
""",
        Printed({"error": "2 clips (3, 7), expected 1; tracker.measure_all(tracks, camera) takes them all"}),
    ),
    "clip of concatenated results": (
        """
one = pd.read_csv("t.csv")
named = [tracker.measure(one, camera, number=4), tracker.measure(one.assign(clip=9), camera)]
every = pd.concat([result.estimates for result in named])
print(json.dumps({"clips": every["clip"].tolist(), "flags": every["flags"].tolist()}))
""",
        Printed({"clips": [4, 9], "flags": ["", ""]}),
    ),
    "columns with the names of attributes are documented": (
        """
result = tracker.measure(pd.read_csv("t.csv"), camera)
text = " ".join(inspect.getdoc(type(result).estimates).split())
print(json.dumps({"text": text, "clip": result.estimates["clip"].tolist()}))
""",
        Printed({"text": 'Take ``estimates["clip"]`` and ``estimates["flags"]`` by brackets', "clip": [0]}),
    ),
    "wrong arguments, each one an InputError in one line": (
        """
import discrepancy
table = pd.read_csv("t.csv")
wrong = {
    "track": lambda: tracker.track(5, camera),
    "camera": lambda: tracker.measure(table, 5),
    "key": lambda: tracker.measure(table, {**camera, "fps": "fast"}),
    "missing": lambda: tracker.measure(table, "none.json"),
    "columns": lambda: tracker.measure(table.rename(columns={"x": "place"}), camera),
    "unit": lambda: tracker.measure(table, camera, unit=3),
    "find": lambda: discrepancy.find(5, "painter_behringer", camera=camera),
    "model": lambda: discrepancy.find(table, 5, camera=camera),
    "no camera": lambda: discrepancy.find(table, "painter_behringer"),
    "scene": lambda: synthcam.Scene.build(timing=3),
    "value": lambda: synthcam.Scene.build(launch={"v0": "fast"}),
    "dataset": lambda: synthcam.open_dataset(3),
    "number": lambda: synthcam.Scene.read("painter_behringer").draw("one"),
}
ends = {}
for name, call in wrong.items():
    try:
        call()
    except Exception as error:
        fine = type(error).__name__ == "InputError" and "--" not in str(error) and len(str(error).splitlines()) == 1
        ends[name] = "fine" if fine else f"{type(error).__name__}: {error}"
    else:
        ends[name] = "accepted"
print(json.dumps({"not fine": {name: end for name, end in ends.items() if end != "fine"}, "calls": len(ends)}))
""",
        Printed({"not fine": {}, "calls": 13}),
    ),
    "a scene built in Python, filmed, tracked and measured": (
        """
camera = {"size": [200, 160], "scale": 3e-4}
timing = {"frames": 50, "contact_frame": 15}
scene = synthcam.Scene.build(model={"restitution": 0.8}, launch={"v0": 0.4, "b": 0.1}, camera=camera, timing=timing)
clip = scene.draw(seed=1)
row = tracker.track(clip.film(), clip.camera_json).estimates.iloc[0]
print(json.dumps({"status": row["status"], "true": clip.truth["r"], "errors": abs(row["r"] - 0.8) / row["r_std"]}))
""",
        Printed({"status": "ok", "true": 0.8, "errors": 0.0}, near=ERRORS),
    ),
    "a dataset opened: frames one at a time, truth, camera": (
        """
opened = synthcam.open_dataset("films")
first = opened[0]
film = first.film()
row = tracker.track(film, first.camera_json).estimates.iloc[0]
errors = abs(row["r"] - first.truth["r"]) / row["r_std"]
lengths = {"clips": len(opened), "frames": len(film), "rows": len(first.tracks)}
print(json.dumps({**lengths, "frame": list(film[3].shape), "errors": errors}))
""",
        Printed({"clips": 2, "frame": [160, 200], "frames": 60, "rows": 120, "errors": 0.0}, near=ERRORS),
    ),
    "errors that name arguments, not options": (
        """
try:
    tracker.measure([1, 2], camera)
except tracker.measure.__globals__["InputError"] as error:
    print(json.dumps({"error": str(error), "options": "--" in str(error)}))
""",
        Printed({"error": "tracks: of type list, expected DataFrame", "options": False}),
    ),
    "a scene built in Python, and a dataset opened": (
        """
scene = synthcam.Scene.build(timing={"frames": 5, "contact_frame": 2}, camera={"size": [64, 48]})
clip = scene.draw(seed=1)
opened = synthcam.open_dataset("dataset")
first = next(iter(opened))
print(json.dumps({"frames": len(clip.tracks["frame"].unique()), "clips": len(opened), "fps": first.camera_json["fps"]}))
""",
        Printed({"frames": 5, "clips": 1, "fps": 250.0}),
    ),
    "find takes a table and a dict": (
        """
import discrepancy
scene = synthcam.Scene.read("painter_behringer")
parts = []
for k in range(6):
    true = scene.draw(k).tracks
    rng = np.random.default_rng(k)
    xy = true[["x_mean_px", "y_mean_px"]].to_numpy() + 0.02 * rng.standard_normal((len(true), 2))
    rows = {"clip": k, "frame": true.frame, "particle": true.particle, "x": xy[:, 0], "y": xy[:, 1]}
    parts.append(pd.DataFrame(rows))
camera = {name: scene.draw(0).camera_json[name] for name in ("fps", "size", "scale", "ball_diameter")}
table = pd.concat(parts).dropna()
found = discrepancy.find(table, "painter_behringer", camera=camera, minutes=0.0)
clips = found.document()["clips"]
print(json.dumps({"verdict": found.verdict, "clips": sum(clips[name] for name in ("fitted", "kept_out"))}))
""",
        Printed({"verdict": "none", "clips": 6}),
    ),
    "a detector that is a function": (
        """
from spot import spot
import tifffile
result = tracker.track(tifffile.imread("film.tif"), json.load(open("film.json")), detector=spot)
print(json.dumps({"follows": len(result.tracks) > 100}))
""",
        Printed({"follows": True}),
    ),
}


def prepare_python(folder: Path) -> None:
    """The files that scripts read."""
    (folder / "spot.py").write_text(TEN_LINES)
    tifffile.imwrite(folder / "film.tif", film_glints().frames)
    (folder / "camera.json").rename(folder / "table.json")
    write_camera(folder, film_glints().camera)
    (folder / "camera.json").rename(folder / "film.json")
    (folder / "table.json").rename(folder / "camera.json")
    make_dataset(folder / "dataset")
    make_dataset(folder / "films", 1, clips=2, filmed=True)


def list_cases() -> list[Case]:
    """Cases of new users."""
    glints = film_glints()
    tied = {name: glints.truth[name] for name in ("v0", "r")}
    lossy = Either(Measured(tied), Measured({"r_free": tied["r"]}, ("misfit",), ("the codec", "compression")))
    near = Found(glints.places, near_px=0.5, share=0.85, false=2)  # ten lines lose a glint that is much dimmer

    def table(write: Callable[[Path], object]) -> Callable[[Path], Words]:
        return measure("t.csv", write, **WIDE)

    cases: dict[str, tuple[Callable[[Path], Words], Judge]] = {
        "clips in which either number strikes": (table(write_table), Said(("add a column striker",))),
        "clips whose balls have names": (
            table(lambda path: write_table(path, named=True)), Said(("(ball a) strikes in 1 clip",)),
        ),
        "--detector spot.py, ten lines": (track_with("spot.py"), near),
        "--detector spot:spot": (track_with("spot:spot"), near),
        "--detector spots:Spots, a class": (track_with("spots:Spots"), near),
        "positions in millimetres": (
            table(lambda path: write_table(path, (1,), scale=0.16)), Refused(("positions look like mm", "--unit mm")),
        ),
        "positions in metres": (
            table(lambda path: write_table(path, (1,), scale=1.6e-4)), Refused(("not metres", "--unit m")),
        ),
        "v0: 30": (generate_too_fast, Said(("lower launch.v0",))),
        "a film with camera.json beside it": (write_beside, Said(("camera: camera.json; --camera takes another",))),
        "H.264 copy of a film of glints": (
            track(write_copy("film.mp4", "libx264", "yuv420p", crf="23")), lossy,
        ),
        "H.264 copy of a film of glints, which hardly shows them": (
            track(write_copy("film.mp4", "libx264", "yuv420p", crf="35")),
            Either(Measured(tied), NotOk(("the compression of the video may be the cause",))),
        ),
        "MJPEG copy of a film of glints": (
            track(write_copy("film.avi", "mjpeg", "yuvj420p", qmin="3", qmax="3")), lossy,
        ),
        "mp4v copy of a film of glints, strongly compressed": (
            track(write_copy("film.mp4", "mpeg4", "yuv420p", qmin="9", qmax="9")), lossy,
        ),
    }  # fmt: skip
    scripts = {
        kind: (run_python(script, prepare_python), judge) for kind, (script, judge) in PYTHON.items()
    }  # fmt: skip
    return [
        *(Case("users", kind, make, judge) for kind, (make, judge) in cases.items()),
        *(Case("python", kind, make, judge) for kind, (make, judge) in scripts.items()),
        Case("users", "glints scored as centres", score_positions(("glint_x_px", "glint_y_px"), 0),
             Said(("--point glint",)), run=measure_first),
        Case("users", "the truth of another dataset", score_positions(("x_mean_px", "y_mean_px"), 5),
             Refused(("the dataset that was tracked",)), run=measure_first),
        Case("users", "--clips 60 extends a dataset of 40", lambda folder: [
            "synthcam", "generate", "painter_behringer", "-o", "new", "--no-video"],
            Printed({"clips": 60, "kept": True}), run=extend_dataset),
    ]  # fmt: skip
