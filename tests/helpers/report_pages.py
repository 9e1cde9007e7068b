"""Report pages without drawn figures, for tests of what else a command or a search gives."""

from contextlib import contextmanager

import pytest

from synthcam_shared.report.page import PageFigure


@contextmanager
def undrawn():
    """Within it, figures of report pages are made and not drawn, which would take most of the time of a page."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PageFigure, "of", lambda figure, title, caption="": PageFigure(title, "data:,", caption))
        yield
