"""A search that is cut short says so, and names nothing."""

from itertools import groupby

import numpy as np
import pytest
from discrepancy_clips import HIDDEN, collisions, only, searched

from discrepancy.fitting.predict import predict_tracks
from discrepancy.free_laws.library import free_laws_over
from discrepancy.search import search
from discrepancy.time_left import Deadline, OutOfTime, in_stage, report_progress, showing_stages
from discrepancy.wording import write_story
from synthcam.library import library
from synthcam.model import Model


def test_the_time_counts_only_where_it_is_limited():
    told = []
    with showing_stages(told.append):
        report_progress()  # of no stage
        with in_stage("fit"):
            report_progress()
            with Deadline(1e6).limited(), in_stage("search"):
                report_progress()
            with pytest.raises(OutOfTime), Deadline(-1.0).limited():
                report_progress()
            report_progress()
    report_progress()
    assert told == ["fit", "search", "fit", "fit"]


def test_each_stage_is_shown_while_it_works_and_not_where_its_result_is_known(monkeypatch):
    """The estimate of the time left takes the lengths of stages from what is shown."""
    only(monkeypatch, ("force_speed",), air_drag=library()["air_drag"])
    told = []
    search(collisions(Model().replace({"air_drag.share": 5.0}), 8, 3), Model(), told.append)
    stages = [stage for stage, _ in groupby(told)]
    assert stages[:4] == ["noise", "fit", "noise", "fit"]  # outliers are sought beside a first fit
    assert stages[4:] == ["search", "free laws", "search", "free laws", "gap", "where"]


def test_each_forecast_asks_for_the_time():
    """One candidate's derivatives may take minutes: where balls push each other, each clip is solved alone."""
    clips = collisions(Model(), 2, 3)
    launches = np.array([c.launch for c in clips])
    with Deadline(1e6).limited():
        predict_tracks(Model(), launches, clips)
    with pytest.raises(OutOfTime), Deadline(-1.0).limited():
        predict_tracks(Model(), launches, clips)
    predict_tracks(Model(), launches, clips)


def test_each_derivative_of_a_free_law_asks_for_the_time():
    clips = collisions(Model(), 2, 3)
    launches = np.array([c.launch for c in clips])
    (law, *_) = (law for law in free_laws_over(Model(), launches, clips) if law.base_name == "friction_speed")
    law.derivatives(Model(), launches, clips)
    with pytest.raises(OutOfTime), Deadline(-1.0).limited():
        law.derivatives(Model(), launches, clips)


def test_a_search_cut_short_names_nothing(monkeypatch):
    only(monkeypatch)
    clips = collisions(Model().replace(HIDDEN["velocity_restitution"]), 8, 3)
    found = search(clips, Model(), seconds=0.0)
    assert found.verdict == "inadequate"
    assert (found.claims, found.free_law, found.is_empty) == ((), None, True)
    first, rest = found.sentence().split(". ", 1)
    assert first.startswith("The search stopped early, after 0 minutes, and names nothing: its gap is that of the base")
    assert rest.startswith("On the fitted collisions the base model has chi^2 per point ")
    assert "The search stopped early: a finished one may leave out clips" in write_story(found)[2]
    assert found.document()["cut_short"]["effects"] == list(found.interrupted.effects)
    assert found.document()["gap"]["before"] > found.document()["gap"]["floor"]


def test_a_whole_search_is_not_cut_short():
    assert searched("velocity_restitution").document()["cut_short"] is None
    assert "stopped early" not in " ".join([searched("nothing").sentence(), *write_story(searched("nothing"))])


def test_nothing_hidden_is_nothing_found_however_short_the_time(monkeypatch):
    only(monkeypatch)
    assert search(collisions(Model(), 8, 3), Model(), seconds=0.0).verdict == "none"


def test_what_score_tests_show_is_not_nothing_however_short_the_time(monkeypatch):
    """No residual is significant by itself, but the signature of an effect is."""
    only(monkeypatch)
    monkeypatch.setattr("discrepancy.outcome.is_unexplained", lambda where, policy: False)
    clips = collisions(Model().replace(HIDDEN["velocity_restitution"]), 8, 3)
    assert search(clips, Model(), seconds=0.0).verdict == "inadequate"
    assert search(collisions(Model(), 8, 3), Model(), seconds=0.0).verdict == "none"
