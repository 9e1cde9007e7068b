"""Reading YAML: what is taken, what is refused, in one line."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from repository import ROOT

from synthcam.settings import SCENES, read_yaml
from synthcam_shared.errors import InputError
from synthcam_shared.settings import parse_yaml

REFUSED = {
    "python tag": ("a: !!python/object/apply:os.system ['true']", "line 1: not plain YAML"),
    "python name": ("a: !!python/name:os.system", "not plain YAML"),
    "aliases": ("a: &a [1]\nb: *a", "line 2: not plain YAML .aliases are not taken"),
    "a bomb": ("a: &a [x]\n" + "\n".join(f"{c}: &{c} [*a,*a]" for c in "bcdefgh"), "aliases are not taken"),
    "a key twice": ("a: 1\na: 2", "line 2: not plain YAML .key a given twice"),
    "a list": ("[1, 2]", "expected keys and values, found list"),
    "a word": ("hello", "expected keys and values, found str"),
    "a date that is none": ("a: 2001-99-99", "not plain YAML .month"),
    "endless digits": ("a: " + "9" * 5000, "not plain YAML"),
    "depth": ("a: " + "[" * 5000, "not plain YAML .nested too deeply"),
    "a depth that would end libyaml": ("[" * 10**6, "line 1: not plain YAML .nested too deeply"),
    "half a character": ('a: "\\ud800"', "line 1: not plain YAML"),
    "a tab": ("a:\n\tb: 1", "line 2: not plain YAML"),
    "control characters": ('a: "\x01"', "not plain YAML"),
    "a list as key": ("? [1]\n: 2", "not plain YAML"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_in_one_line(tmp_path, case):
    text, message = REFUSED[case]
    (tmp_path / "f.yaml").write_text(text)
    with pytest.raises(InputError, match=message) as e:
        read_yaml(tmp_path / "f.yaml")
    assert str(e.value).startswith(str(tmp_path / "f.yaml"))
    assert "\n" not in str(e.value)


def test_what_cannot_be_opened(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_yaml(tmp_path / "none.yaml")
    with pytest.raises(InputError, match="a folder, expected a YAML file"):
        read_yaml(tmp_path)
    (tmp_path / "raw.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not text, expected a YAML file"):
        read_yaml(tmp_path / "raw.yaml")


@pytest.mark.parametrize(
    ("text", "value"),
    [("1e-3", 1e-3), ("-2E5", -2e5), ("1.5e+2", 150.0), ("3", 3), ("'1e-3'", "1e-3"), ("x1e3", "x1e3"), ("", None)],
)
def test_numbers_are_what_they_look_like(text, value):
    found = parse_yaml(text)
    assert found == value
    assert type(found) is type(value)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=200)
@given(st.text(alphabet="ab:{}[]&*!?-|>'\"%@`#,\n 0129eE.~<=", max_size=40))
def test_any_text_is_taken_or_refused(tmp_path, text):
    (tmp_path / "f.yaml").write_text(text)
    try:
        read = read_yaml(tmp_path / "f.yaml")
    except InputError as e:
        read = {"refused": str(e)}
    assert isinstance(read, dict)
    assert "\n" not in str(read.get("refused", ""))


def test_the_package_carries_the_repository_s_scenes(tmp_path, monkeypatch):
    own = {p.name: p.read_text() for p in (ROOT / "scenes").glob("*.yaml")}
    assert {p.name: p.read_text() for p in SCENES.glob("*.yaml")} == own
    monkeypatch.chdir(tmp_path)
    assert read_yaml(Path("scenes/dim.yaml")) == parse_yaml(own["dim.yaml"])
    for absent in ("scenes/dimmer.yaml", "dim.yaml", "scenes/../dim.yaml"):
        with pytest.raises(InputError, match="no such file"):
            read_yaml(Path(absent))
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes" / "dim.yaml").write_text("name: my own")
    assert read_yaml(Path("scenes/dim.yaml")) == {"name": "my own"}
