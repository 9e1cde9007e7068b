"""Particle Tracking Challenge: one XML a clip, as in Chenouard et al. 2014, Nature Methods 11, 281."""

import math
from collections.abc import Iterator
from pathlib import Path

from synthcam.dataset.recorded_clip import RecordedClip
from synthcam_shared.track_formats import challenge_xml


def write(clips: Iterator[RecordedClip], folder: Path) -> None:
    for clip in clips:
        scenario = "".join(c if c.isalnum() or c in "-_." else "_" for c in clip.scene)
        text = challenge_xml(clip.visible_tracks(), f"{_snr(clip):.1f}", scenario)
        (folder / f"{clip.number:06d}.xml").write_text(text, encoding="UTF-8")


def _snr(clip: RecordedClip) -> float:
    """Peak over its own noise, the challenge's measure."""
    sensor, exposure = clip.drawn["sensor"], clip.camera["exposure"]
    peak = sensor["glint_peak"] * sensor["gain"]
    return float(peak / math.sqrt(peak + sensor["dark"] * exposure + sensor["read_noise"] ** 2))
