"""Report pages without drawn figures, for tests of what else a command or a search gives."""

from contextlib import contextmanager

import pytest

from synthcam_shared.report.page import PageFigure


@contextmanager
def undrawn():
    """Within it, figures of report pages are made and not drawn, which would take most of the time of a page.

    Those of a score's quantities, with twenty panels each, are not even made.
    """
    from matplotlib.figure import Figure  # here alone: each start of the tests loads this file

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tracker.scoring.score_page.draw_quantity_errors", lambda *_: Figure())
        patch.setattr(PageFigure, "of", lambda figure, title, caption="": PageFigure(title, "data:,", caption))
        yield
