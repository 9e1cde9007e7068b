"""The tables of the paper's page, as text for HTML and PDF."""

from __future__ import annotations

from benchmarks.paper import numbers
from benchmarks.paper.experiment import OF_MODELS
from benchmarks.paper.kondic import PUBLISHED
from benchmarks.paper.models import contradictions
from benchmarks.paper.models.observed import WAYS
from benchmarks.paper.models.scan import BASE_NUMBERS
from benchmarks.paper.published import NUMBERS, OBSERVED, SLOW
from benchmarks.paper.results import Results
from synthcam_shared.report.page import PageTable


def all_tables(results: Results) -> list[PageTable]:
    """Make all tables, in the order of the page."""
    return [_numbers(results), _added(results), _scan(results), _filmed(results), _observed(), _plan(results)]


def _numbers(results: Results) -> PageTable:
    rows = [[x.what, x.printed, x.truth, x.read, x.fits, x.verdict] for x in numbers.lines(results)]
    note = (
        "All films were made with the paper's best fit as the truth: r = 0.903, C = 0.347, mu_k = 0.232, rolling "
        "loss 0.135 /s and 1.03 cm/s². 'Read': the paper's own analysis of the tracked films. 'Tracker': the tied "
        "fits of our tracker. Errors are those of the mean over clips; those of the fit follow from the scatter "
        "about its lines."
    )
    heads = ["number", "paper", "truth filmed", "paper's analysis of the films", "fits of our tracker", "agreement"]
    return PageTable(heads, rows, "Table 1. The paper's numbers beside ours", note)


def _added(results: Results) -> PageTable:
    found = numbers.added(results)
    rows = [
        [f"{x.reading}{f', {x.unit}' if x.unit else ''}", *(f"{value:+.4f}" for value in x[2:4]), f"{x.iloc[4]:.4f}"]
        for _, x in found.iterrows()
    ]
    note = (
        f"Readings of {results.count('speeds')} filmed collisions nearly head-on minus the truth of the films: mean"
        " bias of slow and of fast"
        " ones, and scatter. The times of the first three: mean time of the two frames that are differenced, after"
        " the hit. 'Corner': a broken line fitted to the velocity; slides under 11 ms cannot be read so at 250 frames"
        " per second. 'Settled': the first frame in which the acceleration is below 0.3 of"
        " its peak."
    )
    return PageTable(list(found.columns[[0, 2, 3, 4]]), rows, "Table 2. Errors that the analysis adds", note)


def _scan(results: Results) -> PageTable:
    found = contradictions.best_of(results.scan)
    least = found["score"].min()
    rows = [
        [str(x["name"]), str(x["words"]), *(f"{x[', '.join(w)]:.1f}" for w in WAYS), f"{x['score'] - least:.1f}"]
        for _, x in found.iterrows()
    ]
    note = (
        "χ² of the numbers of table 5 for the best size of each effect, with r, C and mu fitted. The columns are six"
        " ways of reading the paper: velocities 4, 6 or 8 ms after the hit, and C from the spins of both balls or of"
        " struck balls (target) alone. Δ score: minus twice the logarithm of the likelihood averaged over the six, plus"
        " 2 for each fitted number, minus the smallest of these. Solved motions with a noise of 1.4 µm."
    )
    heads = ["model", "best size tried", *(f"{window}, {balls}" for window, balls in WAYS), "Δ score"]
    return PageTable(heads, rows, "Table 3. χ² of every effect of motion", note)


SHOWN = (
    ("r, fit", "r by the fit", 4, "r, fit"),
    ("C, fit", "C by the fit", 4, "C, fit"),
    ("mu_k, fit", "μ_k by the fit", 4, "mu_k, fit"),
    ("r, differences at 4 ms", "r by differences, 4 ms", 3, "r, differences"),
    ("r, differences at 6 ms", "r by differences, 6 ms", 3, "r, differences"),
    ("r, differences at 8 ms", "r by differences, 8 ms", 3, "r, differences"),
    ("slope of r at 4 ms", "its slope with v0 at 4 ms, s/m", 2, None),
    ("C, spins, both, 4 ms", "C from the spins, both balls, 4 ms", 3, "C, spins"),
    ("C, spins, target, 4 ms", "C from the spins, struck balls, 4 ms", 3, "C, spins"),
    ("C, spins, striker, 4 ms", "C from the spins, strikers, 4 ms", 3, "C, spins"),
    ("dn", "change of spin along n", 4, "dn"),
    ("energy", "energy left", 3, "energy"),
    ("momentum", "momentum left", 3, "momentum"),
    ("kept 4 ms", "momentum of both balls 4 ms after the hit", 3, None),
    (SLOW.name, "τ of the struck ball at 10 cm/s, s", 3, "tau at 10 cm/s"),
)


def _filmed(results: Results) -> PageTable:
    leaders = contradictions.leaders(results.scan)
    columns = {"base": contradictions.read_model(results, "base")} | {
        x.name: contradictions.read_model(results, x.folder) for x in leaders
    }
    rows = []
    for key, word, digits, name in SHOWN:
        number = NUMBERS[name] if name else None
        printed = "" if number is None else f"{number.value:g}" + (f" ± {number.error:g}" if number.error else "")
        rows.append([word, printed, *(f"{values[key]:.{digits}f}" for values in columns.values())])
    for window, balls in WAYS:
        rows.append(
            [
                f"χ², {window}, {balls}",
                "",
                *(f"{values[f'chi2, {balls}, {window}']:.1f}" for values in columns.values()),
            ]
        )
    made = "; ".join(f"{x.name}: {_numbers_of(x)}" for x in leaders)
    note = (
        "Each model through video, tracker and the paper's own analysis:"
        f" {sum(map(results.count, OF_MODELS))} clips a model. The base model as printed"
        f" (r = {PUBLISHED.r}, C = {PUBLISHED.C}, mu_k = {PUBLISHED.mu}); the others with the numbers that suit the"
        f" paper best: {made}."
    )
    heads = ["", "paper", *(name.replace("_", " ") for name in columns)]  # a long name then breaks into lines
    return PageTable(heads, rows, "Table 4. Published values, base model and leading effects, from video", note)


def _numbers_of(leader: contradictions.Leader) -> str:
    names = dict(zip(BASE_NUMBERS, ("r", "C", "mu"), strict=True))
    return ", ".join(f"{names.get(n, n)} {value:.3g}" for n, value in leader.numbers.items())


def _observed() -> PageTable:
    rows = [[x.name, f"{x.value:g}", f"{x.error:.3g}", x.why] for x in OBSERVED]
    rows.append([SLOW.name, f"{SLOW.value:g}", f"{SLOW.error:g}", SLOW.why])
    note = "These numbers enter χ². The last column says which errors are ours, because the paper prints none."
    return PageTable(["number", "value", "error", "error from"], rows, "Table 5. Published numbers that enter χ²", note)


def _plan(results: Results) -> PageTable:
    found = contradictions.plan(results.output)
    rows = []
    for x in found["effects"]:
        naming = x["naming_then"]
        rows.append(
            [
                str(x["effect"]),
                f"{x['typical']:.3g}",
                f"{x['limit']:.2g}",
                "none" if x["naming_limit"] is None else f"{x['naming_limit']:.2g}",
                f"{x['rival']} ({x['cosine']:.3f})",
                str(x["best_change"]),
                "none" if naming is None else f"{naming:.2g}",
            ]
        )
    pairs = " ".join(str(p["advice"]) for p in found["pairs"])
    note = (
        f"By discrepancy plan, for 30 collisions of the paper's scene, measured as by our tracker. {found['said']}"
        f" {pairs}"
    )
    heads = [
        "effect",
        "realistic",
        "detection limit",
        "naming limit",
        "most similar effect (cosine)",
        "change that names it soonest",
        "naming limit then",
    ]
    return PageTable(heads, rows, "Table 6. Measurements that would decide", note)
