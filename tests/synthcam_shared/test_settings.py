"""YAML files: those that are too long are refused before they are read into memory."""

import contextlib
import gc

import pytest
import yaml

from synthcam.scene.bodies import MAX_BODIES
from synthcam_shared import settings
from synthcam_shared.errors import InputError

MOST = settings.MAX_ENTRIES
TOO_LONG = {
    "line 20003: bodies: expected at most 20000 entries": "a: 1\nbodies:\n" + "- {}\n" * (MOST + 1),
    "line 2: b: expected at most 20000 entries": "a: 1\nb: {c: [" + "0, " * (MOST + 1) + "]}\n",
    "line 20002: a: expected at most 20000 entries": "a:\n" + "".join(f" k{k}: 0\n" for k in range(MOST + 1)),
    "line 1: the whole: expected at most 20000 entries": "[" + "[]," * (MOST + 1) + "]",
    "line 20001: the whole: expected at most 20000 entries": "- a\n" * (MOST + 1),
}


@pytest.mark.parametrize("message", TOO_LONG)
def test_a_list_that_is_too_long(tmp_path, monkeypatch, message):
    path = tmp_path / "long.yaml"
    path.write_text(TOO_LONG[message])
    monkeypatch.setattr(yaml, "load", lambda text, Loader: pytest.fail("the file was read"))
    with pytest.raises(InputError) as refused:
        settings.read_yaml(path)
    assert str(refused.value) == f"{path}, {message}"


def test_a_file_of_too_many_lists(tmp_path, monkeypatch):
    path = tmp_path / "wide.yaml"
    path.write_text("".join(f"k{k}: [[0, 0], [0, 0]]\n" for k in range(100)) + "#" * 50_000)
    assert len(settings.read_yaml(path)) == 100
    monkeypatch.setattr(settings, "MAX_VALUES", 800)  # with the mapping itself there are 801
    with pytest.raises(InputError, match="line 100: k99: expected at most 800 values in all"):
        settings.read_yaml(path)


def test_a_long_file_with_a_mistake_is_not_plain_yaml(tmp_path):
    path = tmp_path / "wrong.yaml"
    path.write_text("a: " + "[0, 0]" * MOST)
    with pytest.raises(InputError, match=r"wrong\.yaml, line 1: not plain YAML \("):
        settings.read_yaml(path)


def test_a_scene_of_as_many_bodies_as_it_may_have_is_not_too_long():
    assert MAX_BODIES <= MOST
    body = {"position": [0.1, 0.2], "velocity": [0.1, 0.2], "slip": [0.1, 0.2], "drilling": 1, "time": 1}
    kind = {"mass": 0.1, "shape": "disc", "diameter": 0.1, "sticks": 0.1}
    values = sum(1 for event in yaml.parse(yaml.safe_dump([body, kind])) if isinstance(event, yaml.NodeEvent))
    assert MAX_BODIES * values <= settings.MAX_VALUES


def test_libyaml_reads_files_where_it_is_there():
    assert issubclass(settings._Loader, yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader)


@pytest.mark.parametrize("text", ["a: [1, 2]", "a: &a [1]\nb: *a", "a: 1\na: 2"])
def test_reading_leaves_the_garbage_collector_on(text):
    with contextlib.suppress(yaml.YAMLError):
        settings.parse_yaml(text)
    assert gc.isenabled()
