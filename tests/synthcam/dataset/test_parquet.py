"""Parquet files against those that pandas writes."""

import io

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

import synthcam
from synthcam.dataset.parquet import build_array, encode_table
from synthcam.scene import ground_truth
from synthcam.scene.clip import list_track_columns

COLUMNS = {
    "frame": np.arange(5),
    "x": np.array([1.0, np.nan, -0.0, np.inf, 1e-300]),
    "single": np.arange(5, dtype=np.float32),
    "seen": np.array([True, False, True, True, False]),
    "state": np.array(["rest", "", "slide", "roll", "ä"]),
    "view": np.arange(10.0)[::2],
}


@pytest.mark.parametrize("rows", [0, 1, 5])
def test_each_kind_of_column_has_the_bytes_of_pandas(rows):
    columns = {name: column[:rows] for name, column in COLUMNS.items()}
    assert encode_table(columns) == pd.DataFrame(columns).to_parquet(index=False)


@pytest.mark.parametrize("name", COLUMNS)
@pytest.mark.parametrize("null", [True, False])
def test_each_column_is_the_array_that_arrow_makes_of_it(name, null):
    column = COLUMNS[name]
    arrow = pa.array(column, from_pandas=null)
    built = build_array(column, arrow.type, nan_is_null=null)
    built.validate(full=True)
    assert built.null_count == arrow.null_count == (null and name == "x")
    np.testing.assert_array_equal(built.to_numpy(zero_copy_only=False), arrow.to_numpy(zero_copy_only=False))


def test_the_truth_of_a_clip_has_the_bytes_of_pandas():
    clip = synthcam.Scene.read("oblique", timing={"frames": 30, "contact_frame": 9}).draw(seed=1)
    assert encode_table(list_track_columns(clip)) == clip.tracks.to_parquet(index=False)
    events = clip.solve().events
    assert len(events) > 2
    columns = ground_truth.list_true_events(clip.view.motion, clip.camera.fps)
    encoded = encode_table(columns)
    assert encoded == events.to_parquet(index=False)
    pd.testing.assert_frame_equal(pd.read_parquet(io.BytesIO(encoded)), events)
