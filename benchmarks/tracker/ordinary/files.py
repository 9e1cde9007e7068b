"""Cases of given files: a folder of small inputs beside their right values, which this table holds by name."""

from __future__ import annotations

import shutil
from pathlib import Path

from benchmarks.tracker.ordinary.case import Case, Judge, Words
from benchmarks.tracker.ordinary.judges import Measured, Refused, Said, Scored

HALF_A_DIGIT = 5e-4  # right values are given to three decimals
GLINTS = {"v0": 0.508, "b": 0.105, "r": 0.870, "mu_k": 0.187}
MATTE = {"v0": 0.608, "r": 0.854, "mu_k": 0.208}
SOFT = {"r": 0.9}
TABLES = (
    "base.csv", "comma_late.csv", "sep.csv", "hash.csv", "spaces.csv", "headcomma.csv", "headerless.tsv", "savetxt.txt",
    "dash.csv", "minus1.csv", "spots_german.csv", "wide_idtracker.csv", "swap_one.csv",
    "swap_at_hit.csv", "zeros.csv",
)  # fmt: skip
FILMS = {  # camera file, right values, words
    "hdr10.mp4": ("matte.json", MATTE, ()),
    "same8.mp4": ("matte.json", MATTE, ()),
    "vfr.mp4": ("glint.json", GLINTS, ("missing",)),
    "cover.mp4": ("matte.json", MATTE, ()),
    "film.mts": ("matte.json", MATTE, ()),
    "inter.mp4": ("inter.json", MATTE, ("fields",)),
    "sar.mp4": ("sar.json", GLINTS, ("stretched",)),
}
CONTACTS = ("soft14.csv", "soft16.csv", "soft18.csv")
PERFECT = {"hota": 1.0, "missed": 0, "false": 0}


def measured(truth: dict[str, float], says: tuple[str, ...] = ()) -> Measured:
    """The judge of right values to three decimals."""
    return Measured(truth, says=says, off=HALF_A_DIGIT)


def list_files(inputs: Path) -> list[Case]:
    """A case for each file of a folder whose right values are known."""
    measure = ("measure", "--no-pages", "--camera")
    known: dict[str, tuple[tuple[str, ...], Judge]] = {
        name: ((*measure, "cam.json"), measured(GLINTS)) for name in TABLES
    }  # fmt: skip
    known |= {name: ((*measure, "soft.json", "--unit", "m"), measured(SOFT)) for name in CONTACTS}
    known["unit.xml"] = ((*measure, "cam.json", "--unit", "px"), measured(GLINTS))
    known |= {
        name: (("track", "--no-pages", "--camera", camera), measured(truth, says))
        for name, (camera, truth, says) in FILMS.items()
    }
    # twentieths of a pixel, which no unit is: read as decimals they were measured, though every value was blank
    known["thousands_int.csv"] = ((*measure, "cam.json"), Refused(("thousands_int.csv", "--unit")))
    score = ("score", "--truth", "gt.txt")
    known["conf0.txt"] = (score, Scored(PERFECT))
    known["zero_based.txt"] = (score, Scored(PERFECT, ("frames count from 0",)))
    known["empty.txt"] = (score, Scored({"hota": 0.0, "false": 0}))
    known["empty.txt "] = ((*measure, "cam.json"), Said(("a result without a detection",)))

    def copy(name: str, words: tuple[str, ...]) -> Case:
        command, *options = words
        beside = [word for word in options if (inputs / word).is_file()]

        def make(folder: Path) -> Words:
            for each in (name.strip(), *beside):
                shutil.copy(inputs / each, folder / each)
            return ["tracker", command, name.strip(), *options, "-o", "new"]

        return Case("files", name, make, known[name][1])

    return [copy(name, words) for name, (words, _) in known.items() if (inputs / name.strip()).is_file()]
