"""A report folder is whole or not there, and other files are never removed."""

import pytest

from synthcam_shared.errors import InputError
from synthcam_shared.outputs import replace_folder

FILES = ("report.json", "index.html")


def write(folder, text):
    for name in FILES:
        (folder / name).write_text(text)


def test_an_earlier_report_is_replaced(tmp_path):
    for text in ("old", "new"):
        with replace_folder(tmp_path / "report", FILES, "an earlier report") as folder:
            write(folder, text)
    assert {p.name: p.read_text() for p in (tmp_path / "report").iterdir()} == dict.fromkeys(FILES, "new")
    assert [p.name for p in tmp_path.iterdir()] == ["report"]


def test_a_failure_leaves_what_was_there(tmp_path):
    with replace_folder(tmp_path / "report", FILES, "an earlier report") as folder:
        write(folder, "old")

    def fail():
        with replace_folder(tmp_path / "report", FILES, "an earlier report") as folder:
            write(folder, "new")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert (tmp_path / "report" / "index.html").read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["report"]


def test_other_files_are_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("precious")
    with (
        pytest.raises(InputError, match="holds something else; expected an earlier report, or nothing"),
        replace_folder(tmp_path, FILES, "an earlier report"),
    ):
        raise AssertionError
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]
