"""The report: the contract's keys, a model that reads back, and a page that needs nothing but itself."""

import dataclasses
import html
import json
import re

import pytest
from discrepancy_clips import searched
from discrepancy_outsiders import OUTSIDERS, outsider

from discrepancy.report import search_page as report
from discrepancy.report.figures import _fits_to_draw, _gap_by_phase_figure, name_best_model
from discrepancy.validate.claim_tests import leave_one_out_residuals
from discrepancy.wording import VERDICT_MEANINGS, format_chi2, write_story
from synthcam.model import read_model
from synthcam.scene.scene import read_scene
from synthcam_shared.report.numbers import round_to_error

WITH_A_MAP = pytest.param("friction_place", marks=pytest.mark.gate)


@pytest.fixture(scope="module", params=["nothing", "velocity_restitution", WITH_A_MAP, "restitution_speed"])
def written(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    found = outsider(request.param) if request.param in OUTSIDERS else searched(request.param)
    paths = {"measured": "out/my_tracks", "base_model": "my_model.yaml"}
    found = dataclasses.replace(found, left_out=("clip 9: <b>no</b> collision",), **paths)
    report.write(found, folder)
    return found, folder


@pytest.fixture
def without_figures(monkeypatch):
    """Pages of tables and sentences alone, which cost little."""
    monkeypatch.setattr(report, "draw_search_figures", lambda found: [])


def test_its_files_and_no_more(written):
    assert sorted(p.name for p in written[1].iterdir()) == list(report.FILES)


def test_the_document_is_strict_json_with_every_key(written):
    def refuse(word):
        raise AssertionError(word)

    found, folder = written
    document = json.loads((folder / "discrepancy.json").read_text(), parse_constant=refuse)
    assert {"verdict", "named", "aliases", "outside", "where", "ranking", "gap", "experiment"} <= document.keys()
    assert document["verdict"] == found.verdict


def test_the_page_needs_no_network(written):
    page = (written[1] / "index.html").read_text()
    assert re.findall(r'(?:src|href)\s*=\s*["\'](?!data:)', page) == []
    assert "http" not in re.sub(r"base64,[A-Za-z0-9+/=]*", "", page)
    assert page.count("data:image/svg+xml;base64,") == 5 + bool(written[0].free_law)
    assert "<script" not in page


def test_the_page_says_the_sentence_and_what_was_left_out(written):
    page = (written[1] / "index.html").read_text()
    listed = html.unescape(page[page.index("<ol>") : page.index("</ol>")])
    assert re.findall(r"<li>(.*?)</li>", listed, re.DOTALL) == write_story(written[0])
    assert "clip 9: &lt;b&gt;no" in page


def test_the_page_gives_the_verdict_and_defines_its_terms(written):
    page = (written[1] / "index.html").read_text()
    assert f'<p class="summary">Verdict: {written[0].verdict}</p>' in page
    assert "Ball 1 is struck, ball 2 strikes." in page
    assert "a point is one coordinate of one position. Noise alone gives slightly less than 1" in page
    assert f"<li>Verdict {written[0].verdict}: {VERDICT_MEANINGS[written[0].verdict]}.</li>" in page
    assert '<p class="summary">Tracks: out/my_tracks. Base model: my_model.yaml.</p>' in page


def test_no_table_lists_disagreements_that_are_not_significant(written):
    found, folder = written
    page = (folder / "index.html").read_text()
    left = found.base_disagreements if found.is_empty else found.disagreements
    remains = "" if found.is_empty else " remains"
    sentence = (
        f"No significant disagreement{remains} (largest: {left[0].sigma:.1f} sigma, corrected for {len(left)} tests;"
    )
    assert (sentence in page) == (left[0].sigma <= found.policy.unexplained_sigma)


def test_the_caption_counts_the_effects(written):
    total, page = len(written[0].scores), html.unescape((written[1] / "index.html").read_text())
    which = f"The 20 most significant of {total}" if total > 20 else f"All {total}"
    assert f"{which} effects, each added alone" in page


def test_a_model_that_lacks_nothing_is_drawn_once(written):
    found, _ = written
    labels = [bars.get_label() for bars in _gap_by_phase_figure(found).axes[0].containers]
    assert labels == ["base model", *(() if found.is_empty else [name_best_model(found)]), "noise alone"]
    assert len(_fits_to_draw(found)) == len(labels) - 1


def test_the_page_distinguishes_a_similar_effect_from_an_alias(tmp_path, without_figures):
    """A smaller claim leaves too little chi^2 to exclude the similar effect; the data never exclude an alias."""
    found = searched("velocity_restitution")
    (claim,) = found.claims

    def similar(**change):
        one = dataclasses.replace(claim, alike=((("hop",), 0.98),), **change)
        report.write(dataclasses.replace(found, claims=(one,)), tmp_path)
        return (tmp_path / "index.html").read_text()

    alone = (claim.effect,)
    strong = similar(sigma=100.0, aliases=alone)
    assert f"The data exclude each of these in place of {claim.effect}: hop (cosine 0.980)." in strong
    assert re.search(r"<td[^>]*>none</td>", strong)
    assert "The data do not exclude: hop (cosine 0.980)." in similar(sigma=10.0, aliases=alone)
    assert "The data do not exclude: hop (cosine 0.980)." in similar(sigma=100.0, aliases=(*alone, "hop"))


def test_the_table_of_tests_counts_all_collisions_that_it_predicts(tmp_path, without_figures):
    """The second test is on the fitted collisions, each left out once, and on the held-out ones too."""
    found = searched("velocity_restitution")
    left_out = [*leave_one_out_residuals(found.best_fit), *found.gap_fits.after.residuals]
    chi2 = sum(float(r @ r) for r in left_out) / sum(map(len, left_out))
    report.write(found, tmp_path)
    page = (tmp_path / "index.html").read_text()
    table = page[page.index("<h2>Tests of each claim") : page.index("<h2>Disagreements")]
    heads, cells = (re.findall(f"<{tag} [^>]*>(.*?)</{tag}>", table) for tag in ("th", "td"))
    row = dict(zip(heads, cells, strict=True))
    assert row["all collisions, each left out of the fit, χ² per point: with it"] == format_chi2(chi2)
    assert f"predicts all {len(left_out)} collisions, each by a fit that did not use it" in table
    assert row["result"] == "passed all tests"


def test_the_model_reads_back_and_is_a_scene(written):
    found, folder = written
    assert read_model(folder / "model.yaml") == found.model
    bends = found.free_law.law.bends[0] if found.free_law else "restitution"
    assert read_scene(folder / "model.yaml").draw(0, 0).model.laws.has_effect_on(bends) == bool(
        found.named or found.free_law
    )


@pytest.mark.parametrize("written", ["velocity_restitution", WITH_A_MAP], indirect=True)
def test_the_same_search_gives_the_same_files(written, tmp_path):
    report.write(written[0], tmp_path)
    for path in written[1].iterdir():
        one, other = (re.sub(b"<footer>.*</footer>", b"", p.read_bytes()) for p in (path, tmp_path / path.name))
        assert one == other  # but for when the page was made


def test_a_place_without_a_size_has_an_empty_cell(tmp_path, without_figures):
    found = searched("velocity_restitution")
    first, second = (dataclasses.replace(found.base_disagreements[0], size=size) for size in (float("nan"), 12345.6))
    report.write(dataclasses.replace(found, base_disagreements=(first, second)), tmp_path)
    (table,) = re.findall(
        r"<h2>Disagreements of the base model</h2>(.*?)</table>", (tmp_path / "index.html").read_text(), re.DOTALL
    )
    assert re.findall(r'<td class="">([^<]*)</td></tr>', table) == ["", "12000"]
    assert [p["size"] for p in json.loads((tmp_path / "discrepancy.json").read_text())["where"]] == [None, 12345.6]


@pytest.mark.parametrize("written", ["restitution_speed"], indirect=True)
def test_the_formula_and_its_curve_are_on_the_page(written):
    found, folder = written
    drawn = re.findall(r'<img alt="(.*?)" src="data:image/svg', (folder / "index.html").read_text())
    assert f"Free law: {found.law_summary.formula}" in map(html.unescape, drawn)
    assert len(drawn) == 6


def test_strengths_and_fitted_parameters_have_their_units(written):
    found, folder = written
    page = (folder / "index.html").read_text()
    rows = [re.findall(r"<td[^>]*>(.*?)</td>", line) for line in re.findall(r"<tr>(.*?)</tr>", page)]
    units = {row[0]: row[1] for row in rows if len(row) == 3 + (not found.is_empty)}
    assert (units["rolling_drag"], units["rolling_decel"], units["restitution"]) == ("1/s", "m/s^2", "")
    shown = [row[3] for row in rows if row[:2] == ["velocity_restitution", "e"]]
    assert shown == [""] * len(found.named)


def test_parameters_have_errors_only_where_nothing_more_is_missing(tmp_path, without_figures):
    found = searched("velocity_restitution")
    value, std = found.best_fit.model.restitution, found.best_fit.std["restitution"]
    base = f"{found.base_fit.model.restitution:.6g}"
    more = (dataclasses.replace(found.base_disagreements[0], sigma=9.0),)
    for left, best in ((found.disagreements, f"{round_to_error(value, std, 2)} ± {std:.2g}"), (more, f"{value:.6g}")):
        report.write(dataclasses.replace(found, disagreements=left), tmp_path)
        page = (tmp_path / "index.html").read_text()
        rows = [re.findall(r"<td[^>]*>(.*?)</td>", line) for line in re.findall(r"<tr>(.*?)</tr>", page)]
        assert ["restitution", "", base, best] in rows
        assert ("No errors are given" in page) == (left is more)
