"""The stepwise selection by itself, for tests."""

from discrepancy.fitting.model_fit import WhitenedClips
from discrepancy.select.fit_store import FitStore
from discrepancy.select.library_search import Stepwise


def stored(clips, base, noise):
    """A store that holds no fit but the base's."""
    return FitStore(WhitenedClips.of(clips, noise), base, lambda: None)


def selected(clips, base, noise):
    """The steps, and the selection that they lead to."""
    steps = Stepwise.of(stored(clips, base, noise))
    return steps, steps.selection(steps.end(()))


def named(clips, base, noise):
    """The effects that are named."""
    steps, found = selected(clips, base, noise)
    return steps.named(found.state)
