"""Effect of lossy video on errors and error bars, with the diameter and the frame rate alone.

    python -m benchmarks.tracker.codecs [--clips 100] [--scene scenes/benchmark.yaml] [--codecs h264_23,mjpeg_3]

`tracker calibrate` calibrates all clips of a codec together. The clips are tracked with the camera file that it writes:
it has the error of its scale, and no lamp, exposure or lens. A row for each codec gives

- the share of the balls found, and the number of false detections;
- the rmse of glints;
- the share of their steps between frames that are quarters of a pixel: by chance 0.24, more where H.264 moves blocks;
- the error of the scale over its standard error;
- z = error / standard error of each quantity by the tied and by the free fit, root mean square with its sampling error
  (an error that all clips share counts once);
- the number of clips by status.

The last row pools all codecs, for a user who does not know how the film was encoded.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import av
import numpy as np
import pandas as pd
import tifffile
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from benchmarks.harness import ROOT, run, save

QUANTITIES = ("v0", "r", "mu_k", "tau1", "tau2", "energy_fraction")
FOUND = 3.0  # px, between a glint and its truth
MOVED, NEAR = 1.0, 0.03  # px a frame, from which a ball counts as moving; px, from a multiple of a quarter
CODECS: dict[str, tuple[str, str, str, dict[str, str], float]] = {  # ending, codec, pixels, options, gamma
    "raw": ("mkv", "ffv1", "gray", {}, 1.0),
    "h264_18": ("mp4", "libx264", "yuv420p", {"crf": "18"}, 1.0),
    "h264_23": ("mp4", "libx264", "yuv420p", {"crf": "23"}, 1.0),
    "h264_28": ("mp4", "libx264", "yuv420p", {"crf": "28"}, 1.0),
    "gamma_h264_23": ("mp4", "libx264", "yuv420p", {"crf": "23"}, 2.2),
    "hevc_28": ("mp4", "libx265", "yuv420p", {"crf": "28", "x265-params": "log-level=none"}, 1.0),
    "mp4v_5": ("mp4", "mpeg4", "yuv420p", {"qmin": "5", "qmax": "5"}, 1.0),
    "mjpeg_3": ("avi", "mjpeg", "yuvj420p", {"qmin": "3", "qmax": "3"}, 1.0),
    "mjpeg_10": ("avi", "mjpeg", "yuvj420p", {"qmin": "10", "qmax": "10"}, 1.0),
}


def encode(frames: Iterable[NDArray[Any]], path: Path, codec: str, rate: float) -> None:
    """Write grey 8-bit frames of full range as a codec stores them: H.264 with black at 16 and white at 235."""
    _, name, pixels, options, gamma = CODECS[codec]
    counts = 255.0 * (np.arange(256) / 255.0) ** (1.0 / gamma)
    codes = np.rint(16 + counts * 219 / 255 if pixels == "yuv420p" else counts).astype(np.uint8)
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(name, rate=round(rate), options=options)
        stream.pix_fmt = pixels
        for k, frame in enumerate(frames):
            if k == 0:
                stream.height, stream.width = frame.shape
            picture = av.VideoFrame(stream.width, stream.height, pixels)
            for number, plane in enumerate(picture.planes):
                rows = np.full((plane.height, plane.line_size), 128, np.uint8)
                if number == 0:
                    rows[:, : plane.width] = codes[frame]
                plane.update(rows.tobytes())
            picture.pts = k
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))


def encode_dataset(film: Path, folder: Path, codec: str) -> Path:
    """The clips of a dataset, encoded; no camera files, no truth."""
    out = folder / codec
    rate = json.loads((film / "clips/000000/camera.json").read_text())["fps"]
    for clip in sorted((film / "clips").iterdir()):
        home = out / "clips" / clip.name
        home.mkdir(parents=True, exist_ok=True)
        encode(tifffile.imread(clip / "frames.tif"), home / f"frames.{CODECS[codec][0]}", codec, rate)
    return out


def places(film: Path, results: Path) -> dict[str, float]:
    """Share of the balls found, false finds a clip, rmse of glints in px, share of steps by quarters of a pixel."""
    found = wanted = false = 0
    square, steps = 0.0, list[NDArray[np.float64]]()
    for clip in sorted((film / "clips").iterdir()):
        truth = pd.read_parquet(clip / "truth/tracks.parquet").query("visible")
        tracks = pd.read_parquet(results / "clips" / clip.name / "tracks.parquet")
        both = truth.merge(tracks, on="frame", suffixes=("_true", ""))
        off = np.hypot(both["glint_x"] - both["glint_x_px"], both["glint_y"] - both["glint_y_px"])
        near = off[off < FOUND]
        wanted, found, false = wanted + len(truth), found + len(near), false + len(tracks) - len(near)
        square += float((near**2).sum()) / 2
        shifts = tracks.sort_values(["particle", "frame"]).groupby("particle")[["glint_x", "glint_y"]].diff().to_numpy()
        steps.append(shifts[np.hypot(*shifts.T) > MOVED].ravel())
    fourths = np.concatenate(steps) * 4
    quarters = float(np.mean(np.abs(fourths - np.rint(fourths)) < 4 * NEAR))
    rmse = float(np.sqrt(square / max(found, 1)))
    return {"found": found / wanted, "false": false / wanted, "rmse_px": rmse, "quarters": quarters}


def spread(table: pd.DataFrame, name: str, fit: str) -> dict[str, float]:
    """Root mean square of z, its sampling error, and the number of clips that claim the quantity."""
    table, suffix = table[table["status"].isin(["ok", "misfit"])], "" if fit == "tied" else "_free"
    z = (table[name + suffix] - table[f"{name}_true"]) / table[f"{name}{suffix}_std"]
    rows = table[z.notna()]
    values = z[z.notna()].to_numpy(float)
    together = np.array([common(row, name, fit) for row in rows["cov"]]) / rows[f"{name}{suffix}_std"].to_numpy(float)
    alike = np.outer(together, together)
    np.fill_diagonal(alike, 1.0)
    n = max(len(values), 1)
    rms = float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
    return {"rms": rms, "error": float(np.sqrt(2 * np.sum(alike**2)) / n / 2), "n": len(values)}


def together(figures: dict[str, dict[str, Any]], fit: str, name: str) -> dict[str, float]:
    """As `spread`, of the clips of all codecs."""
    each = [row["z"][fit][name] for row in figures.values() if row["z"][fit][name]["n"]]
    n = sum(z["n"] for z in each)
    rms = float(np.sqrt(sum(z["n"] * z["rms"] ** 2 for z in each) / max(n, 1)))
    return {"rms": rms, "error": float(np.hypot.reduce([z["n"] * z["error"] for z in each])) / max(n, 1), "n": n}


def common(cov: str, name: str, fit: str) -> float:
    """The change of a quantity by one standard error of the scale."""
    table = json.loads(cov)
    shared = table.get("shared", {}).get("scale")
    return float(shared[fit][table["names"].index(name)] or 0.0) if shared else 0.0


def judge(film: Path, folder: Path, codec: str) -> dict[str, Any]:
    """All figures of one codec."""
    known = json.loads((film / "clips/000000/camera.json").read_text())
    clips, camera, results = folder / codec, folder / f"{codec}.json", folder / f"{codec}_results"
    shutil.rmtree(results, ignore_errors=True)
    camera.unlink(missing_ok=True)
    begun = time.monotonic()
    told = ("--diameter", str(known["ball_diameter"]), "--fps", str(known["fps"]), "-o", str(camera))
    run("tracker", "calibrate", str(clips), *told, quiet=True)
    calibrated = time.monotonic()
    run("tracker", "track", str(clips), "--camera", str(camera), "-o", str(results), quiet=True)
    ended = time.monotonic()
    truth = pd.read_parquet(film / "truth/clips.parquet").drop(columns="striker")
    rows = pd.read_parquet(results / "estimates.parquet").drop_duplicates("clip")
    table = truth.merge(rows, on="clip", suffixes=("_true", ""))
    found = json.loads(camera.read_text())
    off = found["scale"] - known["scale"]
    return places(film, results) | {
        "bytes": sum(p.stat().st_size for p in clips.glob("clips/*/frames.*")),
        "calibrate_s": calibrated - begun, "track_s": ended - calibrated,
        "scale_off": off / known["scale"], "scale_std": found["scale_std"] / known["scale"],
        "scale_z": off / found["scale_std"], "sigma_px": found["psf"]["sigma_px"], "sensor": found["sensor"],
        "status": table["status"].value_counts().to_dict(), "flags": table["flags"].value_counts().to_dict(),
        "chi2": float((table["chi2"] / table["dof"]).median()),
        "z": {fit: {name: spread(table, name, fit) for name in QUANTITIES} for fit in ("tied", "free")},
    }  # fmt: skip


def make_table(figures: dict[str, dict[str, Any]]) -> Table:
    heads = "codec,found,false,rmse px,¼ px,scale off %,std %,z,ok,misfit,other,chi2/dof,fit"
    table = Table(*heads.split(","), *(f"z {name}" for name in QUANTITIES))
    for codec, row in figures.items():
        status = row["status"]
        ok, misfit = status.get("ok", 0), status.get("misfit", 0)
        cells = [codec, f"{row['found']:.4f}", f"{row['false']:.4f}", f"{row['rmse_px']:.4f}", f"{row['quarters']:.2f}"]
        cells += [f"{100 * row['scale_off']:+.3f}", f"{100 * row['scale_std']:.3f}", f"{row['scale_z']:+.2f}"]
        cells += [f"{ok}", f"{misfit}", f"{sum(status.values()) - ok - misfit}", f"{row['chi2']:.2f}"]
        for fit, z in row["z"].items():
            values = [f"{v['rms']:.2f}±{v['error']:.2f} ({v['n']})" for v in z.values()]
            table.add_row(*(cells if fit == "tied" else [""] * len(cells)), fit, *values)
    if len(figures) > 1:
        for fit in ("tied", "free"):
            all_ = [together(figures, fit, name) for name in QUANTITIES]
            table.add_row("all", *[""] * 11, fit, *(f"{v['rms']:.2f}±{v['error']:.2f} ({v['n']})" for v in all_))
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description="Errors that lossy video causes, and their error bars.")
    parser.add_argument("--clips", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scene", default="scenes/benchmark.yaml")
    parser.add_argument("--codecs", default=",".join(CODECS), help="names, with commas between them")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "codecs")
    options = parser.parse_args()
    film = options.output / "film"
    size = ("--clips", str(options.clips), "--seed", str(options.seed))
    run("synthcam", "generate", options.scene, "-o", str(film), *size)
    figures = {}
    for codec in options.codecs.split(","):
        encode_dataset(film, options.output, codec)
        figures[codec] = judge(film, options.output, codec)
        Console(width=220).print(make_table({codec: figures[codec]}))
    Console(width=220).print(make_table(figures))
    save(options.output / "codecs.json", figures)


if __name__ == "__main__":
    main()
