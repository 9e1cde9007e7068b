"""The edits of one clip, in a file that is written at each change; what is undone can be done again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

from synthcam_shared.errors import InputError
from synthcam_shared.outputs import write_atomically
from synthcam_shared.settings import Settings, build_settings
from tracker.edits import TrackEdits


class EditStep(Settings):
    """A step that the page asks for: an edit more, or one back or forth."""

    step: Literal["add", "undo", "redo"] = "add"
    edit: dict[str, Any] | None = None


class EditHistory:
    """Edits, and the file that holds them. Without a file they begin with `given`."""

    def __init__(self, file: Path, given: Sequence[dict[str, Any]] = ()) -> None:
        self.file = file
        self.undone: list[dict[str, Any]] = []
        self._known = _read(file)
        self.edits = TrackEdits.of({"edits": list(given)} if self._known is None else file).to_keys()["edits"]

    def take(self, values: Any, check: Callable[[list[dict[str, Any]]], object]) -> None:
        """Take a step, and write the file. Raises InputError where `check` does, or the file was changed elsewhere."""
        order = build_settings(values, EditStep, "edits")
        edits, undone = list(self.edits), list(self.undone)
        if order.step == "undo":
            if not edits:
                raise InputError("edits: there is nothing to undo")
            undone.append(edits.pop())
        elif order.step == "redo":
            if not undone:
                raise InputError("edits: there is nothing to do again")
            edits.append(undone.pop())
        else:
            edits, undone = [*edits, order.edit], []
        checked = TrackEdits.of({"edits": edits})
        check(checked.to_keys()["edits"])
        if _read(self.file) != self._known:
            raise InputError(f"{self.file}: changed by another program; start tracker open again")
        text = checked.write()
        self.file.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(self.file, text)
        self.edits, self.undone, self._known = checked.to_keys()["edits"], undone, text


def _read(file: Path) -> str | None:
    return file.read_text(encoding="utf-8", errors="replace") if file.is_file() else None
