"""The studies of a blind trial: what is hidden in their boxes, and how many boxes of each make a round."""

from __future__ import annotations

from synthcam.library import library

from .boxes import AT, UNDRAWN, Study
from .ordinary import UNKNOWN
from .outsiders import OUTSIDERS
from .worlds import WORLDS

ALL = {"none": 0.2, "one": 0.35, "two": 0.1, "outside": 0.1, "ordinary": 0.15, "defect": 0.1}
EVERY = len(library()) - len(UNDRAWN)
STUDIES = {
    s.name: s
    for s in (
        Study("tracks", ALL, 300),
        Study("nulls", {"none": 0.8, "defect": 0.2}, 300),
        Study("limit", {"one": 1}, 100, within=AT),
        Study("every", {"one": 1}, EVERY, ratios=(2, 5), integrated=0.6, all=True),
        Study("power", {"one": 1}, 200, ratios=(1, 2, 5, 10)),
        Study("naming", {"one": 1}, 100, ratios=(2,), naming=True),
        Study("pairs", {"two": 1}, 100, ratios=(5,)),
        Study("outside", {"outside": 1}, 100, ratios=(2, 5)),
        Study("ordinary", {"ordinary": 1}, 100, ratios=(5,)),
        Study("ordinary_weak", {"ordinary": 1}, 100, ratios=(2,)),
        Study("hostile", {"hostile": 1}, 6 * len(WORLDS), within=(5, 12), integrated=0.0),
        Study("air_drag", {"one": 1}, 5, ratios=(7,), effects=("air_drag",)),
        Study("video", ALL, 40, filmed=True),
        Study("filmed", {"none": 0.2, "one": 0.8}, 40, ratios=(1.5, 5), filmed=True),
        Study("filmed_nulls", {"none": 1}, 30, filmed=True),
        Study("filmed_power", {"one": 1}, 20, ratios=(2,), filmed=True),
        Study("filmed_naming", {"one": 1}, 20, ratios=(2,), naming=True, filmed=True),
        Study("filmed_pairs", {"two": 1}, 20, ratios=(5,), filmed=True),
        Study("filmed_outside", {"outside": 1}, 20, ratios=(2, 5), filmed=True),
        Study("filmed_ordinary", {"ordinary": 1}, 20, ratios=(5,), filmed=True),
        Study("defects", {"defect": 1}, 20, filmed=True),
    )
}

# Boxes of each study in a round of 200 or so: some 170 from tracks, 30 from film. Each effect, each outsider and each
# ordinary fault takes its turn at least once.
ROUND = {
    "nulls": 30,
    "every": EVERY,
    "limit": 18,
    "naming": 15,
    "pairs": 15,
    "outside": 2 * len(OUTSIDERS) - 6,
    "ordinary": 2 * len(UNKNOWN) - 6,
    "ordinary_weak": 12,
    "filmed_nulls": 5,
    "filmed": 9,
    "filmed_pairs": 3,
    "filmed_outside": 4,
    "filmed_ordinary": 6,
    "defects": 3,
}
