"""Messages about the collisions of a run: misfits, flags, and errors that differ from the claimed ones."""

from __future__ import annotations

import json
from collections import Counter

import numpy as np
import pandas as pd

from tracker.measurement.collision.adequacy import CROWD, MEASURED, MISFIT, USUAL_BIAS, Flag, find_gliding_hits
from tracker.notes import Note, NoteKind

_EXPLANATIONS: dict[str, str] = {  # of a flag: what it means, and what to check
    **dict.fromkeys(
        (flag for flag in Flag if flag.is_impossible),
        "no two equal balls collide so; such a collision is a misfit where it passes the limit by more than 3 errors. "
        "Check the scale, the masses of the balls, and whether the striker slides or spins",
    ),
    Flag.MU_K_UNDER_0: "friction cannot be negative; check the scale and fps",
    Flag.MU_K_OVER_1_5: "no plate has so much friction; check fps, the scale, and whether the balls hit anything else",
    Flag.V0_UNDER_0: "a speed cannot be negative; check the tracks",
    Flag.V0_OVER_20: "balls do not roll so fast; check fps and the scale",
    Flag.OVERLAP: "the tracks come nearer than one diameter; check the scale, ball_diameter and fps",
    Flag.NO_TOUCH: "the balls change direction more than one diameter apart; check the scale, ball_diameter and fps, "
    "and whether the tracks are smoothed",
    Flag.STRIKER_SLIDES: "the fit lets the striker slide up to the contact, with a spin of its own (u2ix, u2iy, "
    "side2i)",
    Flag.STRIKER_SPINS: "the fit lets the striker spin about the vertical (side2i); anything else that adds to the "
    "friction of the hit has the same effect",
    Flag.ROLLS_LATE: "the fit leaves out the first positions of the striker, where it does not roll",
    Flag.LASTS: "the balls push each other for {duration}, as rubber or springs do; the fits leave out {frames}",
    Flag.LASTS_OR_SMALLER: "the paths cross within one diameter, because the contact lasts {duration} or "
    "because ball_diameter is too large; r of the free fit holds for both. "
    "Check ball_diameter, or film at a higher rate",
    Flag.TOUCH_AGAIN: "the balls come back and touch again, as rolling ones do whose r is under .4; the fits leave out "
    "all frames from then on",
    Flag.TOGETHER: "the balls do not part in {frames}; r is 0 within its error",
    Flag.ENCODED: "the codec of the video moves what it shows, the likely cause of this misfit; v0, b and r of the "
    "free fit have errors as large as its residuals. Film again without compression, or with less of it",
    Flag.LOSSES_DIFFER: "one rolling loss for both balls does not fit, though all else does: one ball is dirty or "
    "dented, or the plate is uneven or slopes. The local estimate needs no common loss",
    Flag.FRICTION_CHANGES: "one friction for all speeds of slip does not fit, though all else does: the plate is oily, "
    "or friction falls with the speed. The local estimate needs no common friction",
    Flag.GLIDES: "many hits of this film fit only bodies that glide, as on air. So no hit has a friction or a slide. "
    "If that is right, write support: air (and body) into the camera file; if the bodies roll, support: cloth",
    Flag.STRAIGHT: "the balls move straight after the hit: r is that of straight lines, and nothing shows friction",
}
_BROKEN_LAWS = frozenset((Flag.LASTS_OR_SMALLER, Flag.LOSSES_DIFFER, Flag.FRICTION_CHANGES))
SAME_BODIES = (
    "This takes a number for the same body in all clips. Tracks of films are numbered in each clip by itself: check "
    "them, or give ball_masses in the camera file"
)


def list_messages(estimates: pd.DataFrame, results: str = "RESULTS") -> list[Note]:
    """List messages about the collisions of a run, which the reader of estimates.parquet has to know.

    Misfits come first, then flags, then errors of the positions that differ from the claimed ones. The messages name
    the folder `results`.
    """
    notes = []
    explained = estimates["flags"].str.split("|").map(_BROKEN_LAWS.intersection).astype(bool)
    # the flags tell of the other misfits
    rejected = estimates[(estimates["status"] == MISFIT) & estimates["model_rejected"].astype(bool) & ~explained]
    if len(rejected):
        measured = int(estimates["status"].isin(MEASURED).sum())
        median = float((rejected["chi2"] / rejected["dof"]).median())
        others = int(rejected["recommended"].isin(["local", "free"]).sum())
        have = f" {others} of them {'have' if others != 1 else 'has'} another estimate with errors." if others else ""
        text = (
            f"{len(rejected)} of {_count(measured)} {'do' if len(rejected) != 1 else 'does'} not fit the model"
            f" (median chi2/dof {median:.3g}).\n"
            "  Likely causes, the most frequent first: in a video its compression; bodies that do not roll, a"
            " wrong scale, a tilted plate, unequal balls, a striker that slides or spins.\n"
            f"  The values of their tied fits are indicative and carry no errors.{have}"
            f" To find the cause: discrepancy find {results} --model MODEL"
        )
        notes.append(Note(NoteKind.MISFIT, text))
    notes += _describe_local(estimates)
    flags = Counter(flag for row in estimates["flags"] for flag in row.split("|") if flag)
    for name, count in sorted(flags.items()):
        flagged = estimates[[name in text.split("|") for text in estimates["flags"]]]
        by_fit = flagged["contact_duration_s"]
        seconds = flagged.get("contact_duration_local", by_fit).fillna(by_fit).median()
        duration = f"{1e3 * seconds:.3g} ms" + (" (median)" if len(flagged) > 1 else "")
        text = _EXPLANATIONS.get(name, "").format(duration=duration, frames=_name_frames(flagged))
        notes.append(Note(NoteKind.FLAG, f"{name} ({_count(count)}): {text}"))
    ratio = estimates["noise_ratio"].dropna().to_numpy(float)
    if len(ratio):
        text = (
            f"{_count(len(ratio))}: positions scatter about smooth motion by {np.median(ratio):.3g} times their"
            " claimed errors; the fits use the scatter"
        )
        notes.append(Note(NoteKind.NOISE, text))
    rho = estimates.loc[estimates["noise_rho"] > 0, "noise_rho"].to_numpy(float)
    if len(rho):
        text = (
            f"{_count(len(rho))}: the errors of neighbouring frames are correlated by {np.median(rho):.2f};"
            " the fits account for that"
        )
        notes.append(Note(NoteKind.NOISE, text))
    return notes


def _describe_local(estimates: pd.DataFrame) -> list[Note]:
    """Describe the errors of local estimates and what they say about the masses, where one is recommended."""
    used, texts = estimates[estimates["recommended"] == "local"], list[str]()
    if not len(used):
        return []
    hits, along, across = int(used["local_hits"].max()), used["local_error_n"].max(), used["local_error_t"].max()
    if hits:
        bias = float(used["local_bias"].iloc[0])
        texts.append(
            f"local estimates: the balance of momentum of {hits} hits shows errors beyond the residuals, {along:.2%} of"
            f" v0 along the line of centres and {across:.2%} across it"
            + (f"; a bias of {bias:.1%} of the normal speed counts as an error" if abs(bias) > 5e-4 else "")
        )
    elif along > 0:
        texts.append(
            f"local estimates: each component of a velocity has a further error of at most {along:.1%} of v0, assumed,"
            f" because {_count(len(used))} cannot show it by the balance of momentum"
        )
    gliding = len(find_gliding_hits(used.to_dict("records")))  # type: ignore[arg-type]  # columns are text
    if gliding < len(used) and gliding:
        texts.append(
            f"bodies glide, as on air, in {gliding} of {_count(len(used))}. The others might slide and roll, but none"
            " has a friction. If support: air is right, write it into the camera file, and measure again"
        )
    texts += _describe_masses(used, hits)
    return [Note(NoteKind.FLAG, text) for text in texts]


def _name_frames(rows: pd.DataFrame) -> str:
    if len(rows) != 1:
        return "the frames in contact"
    first, last = (int(rows[column].iloc[0]) for column in ("contact_first", "contact_last"))
    return f"frames {first} to {last}" if last > first else f"frame {first}"


def _describe_masses(used: pd.DataFrame, hits: int) -> list[str]:
    """Say what recoil says about the masses; hits: by which the errors of the estimates were fitted, or 0."""
    texts = list[str]()
    ratio, std = (used[name].to_numpy(float) for name in ("mass_ratio", "mass_ratio_std"))
    known = used["local"].str.contains('"masses_known":true').to_numpy(bool)
    clipped = np.clip(ratio, 0.01, 100)
    unequal = ~known & (np.abs(np.log(clipped)) > np.maximum(5 * std / clipped, 0.02))
    if unequal.any():
        least, most = ratio[unequal].min(), ratio[unequal].max()
        between = f"ratios from {least:.3g} to {most:.3g}"
        one = f"a ratio of {np.median(ratio[unequal]):.3g} (median)"
        texts.append(
            f"masses: recoil contradicts equal masses in {_count(int(unequal.sum()))}, with"
            f" {between if most > 1.5 * least else one}. Either the masses differ, and ball_masses in the camera file"
            " gives them, or a ball lifts off or hits something else. Energies are those of equal masses"
        )
    balance, balance_std = (used[name].to_numpy(float) for name in ("balance_n_local", "balance_n_local_std"))
    lost = known & (np.abs(balance) > 5 * balance_std)
    if lost.any() and not hits:
        sigmas = np.median(np.abs(balance / balance_std)[lost])
        texts.append(
            f"masses: with ball_masses of the camera file momentum is off by {sigmas:.2g} errors in"
            f" {_count(int(lost.sum()))}. By recoil the struck ball has {np.median(ratio[lost]):.3g} times the mass of"
            " the striker. ball_masses is [ball a, ball b], and b is the striker if no column striker says otherwise:"
            " check which ball is which"
        )
    bias, bias_std = _read_bias(used.iloc[0])
    if hits and abs(bias) > max(2 * USUAL_BIAS, 5 * bias_std) and not (used["status"] == CROWD).any():
        texts.append(
            f"masses: momentum along the line of centres changes by {bias:.1%} of the normal speed. Errors of"
            f" velocities rarely exceed {2 * USUAL_BIAS:.0%}. Check ball_masses of the camera file, and whether bodies"
            " lift off or touch something else"
        )
    # effects of the camera may name it too
    fitted = used[["mass_ratio" in effects for effects in used["local_shared"].map(json.loads)]]
    if len(fitted):
        row = fitted.iloc[0]
        texts.append(
            f"masses: the struck particle {row['particle1']} has {row['mass_ratio']:.4g} of the mass of particle"
            f" {row['particle2']}, by {_count(hits)}. {SAME_BODIES}"
        )
    wrong = next((e["ball_masses"]["of"] for e in used["local_shared"].map(json.loads) if "ball_masses" in e), None)
    if wrong is not None:
        row = used.iloc[0]
        low, high = sorted((row["particle1"], row["particle2"]))
        texts.append(
            f"masses: recoil contradicts the masses of the camera file: by {_count(hits)}, particle {low} has"
            f" {np.exp(wrong):.3g} times the mass over that of particle {high} that they give. Check ball_masses, and"
            " which ball is which. Energies are those of the given masses, and their errors count the difference"
        )
    return texts


def _read_bias(row: pd.Series) -> tuple[float, float]:
    """Read the bias of a set, over the normal speed, and its standard error, which the shared errors contain too."""
    shared, bias = json.loads(row["local_shared"]), float(row["local_bias"])
    effects = [block["effect"].get("balance_n", 0.0) for key, block in shared.items() if key.startswith("bias_")]
    size = float(np.linalg.norm(effects)) / max(float(json.loads(row["local"])["vn"]), 1e-300)
    return bias, float(np.sqrt(max(size**2 - bias**2, 0.0)))


def _count(number: int) -> str:
    return f"{number} collision{'s' * (number != 1)}"
