"""The outcome of a search as plain values: discrepancy.json, and residuals.parquet, the residuals of all positions."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.noise.whitening import ClipWhitener
from discrepancy.outcome import SearchOutcome
from discrepancy.report.figures import list_models
from discrepancy.select.effect_claim import EffectClaim
from discrepancy.wording import describe_rejection
from synthcam_shared.json_values import replace_non_finite


def to_document(found: SearchOutcome) -> dict[str, Any]:
    """Return the contents of ``discrepancy.json``; docs/format.md describes the keys."""
    noise, law, changed = found.data.noise, found.law_summary, found.policy.changed()
    document: dict[str, Any] = replace_non_finite(
        {
            "verdict": str(found.verdict),
            "models": list_models(found),
            "named": [_claim_document(c) for c in found.claims],
            "aliases": [list(c.aliases) for c in found.claims if len(c.aliases) > 1],
            "outside": [law.document() | {"in_model": found.model_holds_law}] if law else [],
            "where": [vars(p) for p in found.base_disagreements],
            "left": [vars(p) for p in found.disagreements],
            "ranking": [{"effect": c.effect, "sigma": c.sigma} for c in found.scores],
            "claim": found.required_sigma,
            "undetectable": list(found.undetectable),
            "untold": list(found.undetectable),  # its former name, kept for one version
            "alike": list(map(str, found.uniform)),
            "processed": list(map(str, found.processed)),
            "withdrawn": [
                {"claim": t.name, "own_sigma": t.sigma, "why": describe_rejection(t, found.data.unit)} | t.document()
                for t in found.rejected
            ],
            "gap": dataclasses.asdict(found.gap) | {"by_claim": {t.name: t.document() for t in found.accepted}},
            "experiment": found.experiment,
            "scatter": dataclasses.asdict(found.data.scatter),
            "contacts": [dataclasses.asdict(claim) for claim in found.contacts],
            "cut_short": vars(found.interrupted) if found.interrupted else None,
            "noise": {"scale": noise.scale, "quick": noise.innovation_scale, "correlation": noise.correlation}
            | {"shake": noise.common_mode_rms}
            | ({"over_phases": noise.whole_phase_scale} if noise.whole_phase_scale else {}),
            "clips": {
                "fitted": len(found.data.clips),
                "kept_out": len(found.data.held_out),
                "left_out": list(map(str, found.left_out)),
            },
        }
    )
    return document | ({"policy": changed} if changed else {})


def _claim_document(claim: EffectClaim) -> dict[str, Any]:
    return {
        "effect": claim.effect,
        "parameters": claim.values | claim.shapes,
        "std": {k: np.nan if claim.at_limit(k) else std for k, std in (claim.std | claim.shape_std).items()},
        "at_limit": [k for k in claim.values if claim.at_limit(k)],
        "sigma": claim.sigma,
        "limit": claim.limit,
        "naming_limit": claim.naming,
        "alike": [{"effects": list(names), "cosine": cosine} for names, cosine in claim.alike],
    }


def tabulate_residuals(found: SearchOutcome) -> pd.DataFrame:
    """Make a row for each position that the search used; docs/format.md describes the columns."""
    fitted = _tabulate(found, found.data.clips, found.base_fit, found.best_fit)
    held_out = _tabulate(found, found.data.held_out, found.gap_fits.before, found.gap_fits.after)
    tables = [(False, table) for table in fitted] + [(True, table) for table in held_out]
    return pd.concat([table.assign(held_out=is_held_out) for is_held_out, table in tables], ignore_index=True)


def _tabulate(
    found: SearchOutcome, clips: Sequence[MeasuredCollision], base: ModelFit, best: ModelFit
) -> Iterator[pd.DataFrame]:
    for clip, before, after in zip(clips, base.residuals, best.residuals, strict=True):
        white = ClipWhitener.of(clip, found.data.noise)
        columns = {"": clip.xy, "_base": white.undo_noise(before)}
        columns["_best"] = np.full_like(clip.xy, np.nan) if found.is_empty else white.undo_noise(after)
        metres = {f"{axis}{name}": xy[:, k] for name, xy in columns.items() for k, axis in enumerate("xy")}
        yield pd.DataFrame({"clip": clip.clip, "ball": clip.ball + 1, "frame": clip.frame, **metres})
