"""Particle Tracking Challenge: one XML a clip, as in Chenouard et al. 2014, Nature Methods 11, 281."""

import math
from collections.abc import Iterator
from pathlib import Path

from synthcam.dataset.recorded_dataset import RecordedClip
from synthcam_shared.track_formats import make_challenge_xml


def write(clips: Iterator[RecordedClip], folder: Path) -> None:
    for clip in clips:
        sensor = clip.drawn["sensor"]
        peak, dark = sensor["glint_peak"] * sensor["gain"], sensor["dark"] * clip.camera_json["exposure"]
        snr = float(peak / math.sqrt(peak + dark + sensor["read_noise"] ** 2))  # peak over its own noise
        scenario = "".join(c if c.isalnum() or c in "-_." else "_" for c in clip.scene)
        text = make_challenge_xml(clip.visible_tracks(), f"{snr:.1f}", scenario)
        (folder / f"{clip.number:06d}.xml").write_text(text, encoding="UTF-8")
