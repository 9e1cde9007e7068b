"""The tracking measures against TrackEval's and motmetrics' own programs, where they are installed."""

import importlib
from pathlib import Path

import numpy as np
import pytest

from tracker.scoring.tracking_metrics import GATE_PX, TrackPoints, score_tracks
from tracker.tables.content import FileContent
from tracker.tables.formats import mot

EXACT = 1e-9
PUBLISHED = {  # what motmetrics prints of its own two example sets: IDF1, MOTA, 1 - MOTP, switches (its README)
    "TUD-Campus": (0.558, 0.526, 0.277, 7),
    "TUD-Stadtmitte": (0.645, 0.564, 0.346, 7),
}

# alpha, beta, JSC, JSC_theta of TrackMate's own program for the challenge's measures (trackmate-sc/TrackMate-CTCRunner,
# ISBIScoring, gate 5) of `crowd(seed, boxes=False)`, each track cut at its gaps: there TrackMate goes on counting
TRACKMATE = {
    0: (0.22135348069398697, 0.143481203552335, 0.22888283378746593, 0.22641509433962265),
    1: (0.25386856922279144, 0.17680132499444406, 0.2849002849002849, 0.2222222222222222),
    2: (0.2502512975164839, 0.16973566266335427, 0.28895184135977336, 0.19672131147540983),
}


def crowd(seed, boxes, n=6, frames=40):
    """Truth, and tracks with noise, misses, false finds, exchanged and broken ids, and frames without either."""
    rng = np.random.default_rng(seed)
    start, pace = rng.uniform(0, 80, (n, 2)), rng.normal(0, 1.5, (n, 2))
    rows, found = [], []
    names = list(range(n))
    for f in range(frames):
        if f % 11 == 5:
            names[f % n] = n + f  # a new id
        if f % 13 == 7:
            names[0], names[1] = names[1], names[0]
        for k in range(n):
            x, y = start[k] + f * pace[k]
            size = (12 + k, 14 - k) if boxes else ()
            if f != 20:
                rows.append((f, k, x, y, *size))
            if rng.random() > 0.15 and f != 30:
                off = rng.normal(0, 1.5, 2)
                grown = tuple(np.array(size) * rng.uniform(0.8, 1.2, 2)) if boxes else ()
                found.append((f, names[k], x + off[0], y + off[1], *grown))
        if rng.random() < 0.4:
            found.append((f, 1000 + f, *rng.uniform(0, 80, 2), *((10, 10) if boxes else ())))
    return dots(rows), dots(found)


def dots(rows):
    table = np.array(rows, dtype=float)
    size = table[:, 4:6] if table.shape[1] > 4 else None
    return TrackPoints.of(table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2:4], size)


def cut(whole):
    """Each track as several, one for each stretch of frames without a gap."""
    order = np.lexsort((whole.frame, whole.track))
    frame, track = whole.frame[order], whole.track[order]
    begins = np.concatenate([[True], (np.diff(track) != 0) | (np.diff(frame) != 1)])
    return TrackPoints.of(frame, np.cumsum(begins), whole.xy[order])


def overlaps(one, other):
    """Intersection over union, by the corners of the boxes."""
    low = np.maximum((one[0] - one[1] / 2)[:, None], (other[0] - other[1] / 2)[None])
    high = np.minimum((one[0] + one[1] / 2)[:, None], (other[0] + other[1] / 2)[None])
    inside = np.clip(high - low, 0, None).prod(axis=-1)
    return inside / (one[1].prod(axis=1)[:, None] + other[1].prod(axis=1)[None] - inside)


def for_trackeval(truth, found, reach):
    """TrackEval's own form of one sequence; reach: where points are no longer alike, or None of boxes."""
    data = {"gt_ids": [], "tracker_ids": [], "similarity_scores": []}
    frames = range(int(max(truth.frame.max(), found.frame.max())) + 1)
    for f in frames:
        i, j = truth.frame == f, found.frame == f
        if reach is None:
            alike = overlaps((truth.xy[i], truth.size[i]), (found.xy[j], found.size[j]))
        else:
            alike = np.maximum(0, 1 - np.linalg.norm(truth.xy[i][:, None] - found.xy[j][None], axis=2) / reach)
        for key, value in (("gt_ids", truth.track[i]), ("tracker_ids", found.track[j]), ("similarity_scores", alike)):
            data[key].append(value)
    return data | {
        "num_timesteps": len(frames),
        "num_gt_ids": truth.tracks,
        "num_tracker_ids": found.tracks,
        "num_gt_dets": len(truth.frame),
        "num_tracker_dets": len(found.frame),
    }


@pytest.fixture
def trackeval(monkeypatch):
    pytest.importorskip("trackeval.metrics.hota", exc_type=ImportError)
    metrics = importlib.import_module("trackeval.metrics")
    quiet = {"PRINT_CONFIG": False}

    def judged(truth, found):
        boxes = truth.size is not None
        plain = for_trackeval(truth, found, None if boxes else 2 * GATE_PX)
        hota = plain if boxes else for_trackeval(truth, found, GATE_PX)
        return (
            metrics.CLEAR(quiet).eval_sequence(plain)
            | metrics.Identity(quiet).eval_sequence(plain)
            | metrics.HOTA().eval_sequence(hota)
        )

    return judged


@pytest.mark.parametrize("boxes", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_trackeval_gives_the_same(trackeval, seed, boxes):
    truth, found = crowd(seed, boxes)
    got, theirs = score_tracks([(truth, found)]), trackeval(truth, found)
    assert 0.3 < got["mota"] < 0.9
    for name, key in (("mota", "MOTA"), ("motp", "MOTP"), ("idf1", "IDF1"), ("swaps", "IDSW")):
        assert got[name] == pytest.approx(theirs[key], abs=EXACT), name
    for name, key in (("hota", "HOTA"), ("deta", "DetA"), ("assa", "AssA")):
        assert got[name] == pytest.approx(np.mean(theirs[key]), abs=EXACT), name


def example(name):
    motmetrics = pytest.importorskip("motmetrics")
    folder = Path(motmetrics.__file__).parent / "data" / name
    return motmetrics, *(boxes_of(folder / f"{kind}.txt") for kind in ("gt", "test"))


@pytest.mark.parametrize("seed", TRACKMATE)
def test_trackmate_gives_the_same(seed):
    got = score_tracks([tuple(map(cut, crowd(seed, boxes=False)))])
    assert [got[name] for name in ("alpha", "beta", "jsc", "jsc_theta")] == pytest.approx(TRACKMATE[seed], abs=EXACT)


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_example_sets_of_motmetrics(name):
    """Read from its files as any are, held to what it prints of them and to its program."""
    motmetrics, truth, found = example(name)
    got = score_tracks([(truth, found)])
    idf1, mota, motp, swaps = PUBLISHED[name]
    assert (round(got["idf1"], 3), round(got["mota"], 3), got["swaps"]) == (idf1, mota, swaps)
    assert round(1 - got["motp"], 3) == motp
    own = accumulated(motmetrics, truth, found)
    assert got["mota"] == pytest.approx(own["mota"], abs=EXACT)
    assert got["idf1"] == pytest.approx(own["idf1"], abs=EXACT)
    assert 1 - got["motp"] == pytest.approx(own["motp"], abs=EXACT)


@pytest.mark.parametrize("name", PUBLISHED)
def test_trackeval_gives_the_same_of_those_sets(trackeval, name):
    _, truth, found = example(name)
    got, theirs = score_tracks([(truth, found)]), trackeval(truth, found)
    for ours, key in (("mota", "MOTA"), ("motp", "MOTP"), ("idf1", "IDF1")):
        assert got[ours] == pytest.approx(theirs[key], abs=EXACT)
    assert got["hota"] == pytest.approx(np.mean(theirs["HOTA"]), abs=EXACT)


def boxes_of(path):
    rows = mot.read(FileContent.of(path)).rows
    columns = [rows[name].to_numpy(float) for name in ("frame", "particle", "x", "y", "width", "height")]
    return TrackPoints.of(
        columns[0].astype(int), columns[1].astype(int), np.stack(columns[2:4], 1), np.stack(columns[4:], 1)
    )


def accumulated(motmetrics, truth, found):
    """motmetrics' figures, from distances 1 - IoU up to .5."""
    events = motmetrics.MOTAccumulator(auto_id=True)
    for f in range(int(max(truth.frame.max(), found.frame.max())) + 1):
        i, j = truth.frame == f, found.frame == f
        apart = 1 - overlaps((truth.xy[i], truth.size[i]), (found.xy[j], found.size[j]))
        events.update(truth.track[i], found.track[j], np.where(apart > 0.5, np.nan, apart))
    table = motmetrics.metrics.create().compute(events, metrics=["mota", "motp", "idf1"])
    return table.iloc[0]
