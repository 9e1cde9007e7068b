"""Inputs that a command refuses in one line with status 2: a folder of them, and the commands with what they say."""

import json
import os

import numpy as np
import pandas as pd
from tracker_film import CAMERA

LATIN = os.fsdecode(b"gr\xf6\xdfe")  # no UTF-8
DEEP = ".".join(["a"] * 5000)
REFUSED = {
    f"tracker measure blank.csv --camera camera.json -o {LATIN}": "its name is not UTF-8; rename it, or choose another",
    f"synthcam generate s.yaml -o {LATIN}": "its name is not UTF-8",
    f"synthcam preview s.yaml -o {LATIN}.mp4": "its name is not UTF-8",
    f"tracker calibrate film.tif --diameter 2e-3 --fps 250 -o {LATIN}.json": "its name is not UTF-8",
    "tracker measure blank.csv --camera camera.json -o new": "blank.csv: x, y: blank in all 20 rows",
    "tracker calibrate film.tif --diameter 2e-3 --fps 250 -o loop": "loop: exists and was not made by",
    "synthcam generate s.yaml -o loop": "a link that leads to itself, expected another path",
    "synthcam generate s.yaml -o loop/new": "a link that leads to itself",
    "discrepancy plan s.yaml -o loop": "a link that leads to itself",
    "discrepancy find blank.csv --camera camera.json --model s.yaml -o loop": "a link that leads to itself",
    "synthcam generate surrogate.yaml -o new": "surrogate.yaml, line 2: not plain YAML (",
    'synthcam generate s.yaml -o new --set name="\\ud800"': "the value is not plain YAML (",
    f"synthcam generate s.yaml -o new --set {DEEP}=1": "5000 keys deep, expected at most 9",
    f"synthcam generate s.yaml -o new --set timing={'[' * 5000}": "not plain YAML (nested too deeply)",
    "synthcam effects --effects leaving": "my_effect.py: SystemExit: 0",
    "synthcam preview s.yaml -o new.png --frame 99999999999": "--frame 99999999999: expected 0 to 4; the clip has 5",
    "discrepancy find blank.csv --camera camera.json --model empty.yaml -o new": "empty.yaml: empty; expected a model",
    "discrepancy find blank.csv --camera camera.json --model huge.yaml -o new": "expected a number of 100 or less",
    "discrepancy find blank.csv --camera camera.json --model drag.yaml -o new": "expected a number of 10000 or less",
    "discrepancy find blank.csv --camera camera.json --model twice.yaml -o new": "free: restitution is given twice",
    "discrepancy adopt report --name class": "--name class: a word of Python's grammar; choose another name",
}


def write_refused_inputs(folder):
    """Write the files that the commands name."""
    (folder / "s.yaml").write_text("timing: {frames: 5, contact_frame: 2}\ncamera: {size: [64, 48]}\n")
    (folder / "surrogate.yaml").write_text('timing: {frames: 5}\nname: "\\ud800"\n')
    (folder / "empty.yaml").write_text("# nothing yet\n")
    (folder / "huge.yaml").write_text("model: {sliding_friction: 1e300}\n")
    (folder / "drag.yaml").write_text("model: {rolling_drag: 1e300}\n")
    (folder / "twice.yaml").write_text("free: [restitution, sliding_friction, r]\n")
    (folder / "camera.json").write_text(json.dumps(CAMERA))
    rows = pd.DataFrame({"frame": np.arange(20), "particle": 0, "x": np.nan, "y": np.nan})
    rows.to_csv(folder / "blank.csv", index=False)
    (folder / "loop").symlink_to("loop")
    (folder / "leaving").mkdir()
    (folder / "leaving/my_effect.py").write_text("raise SystemExit(0)\n")
