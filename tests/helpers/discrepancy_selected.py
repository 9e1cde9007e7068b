"""The search of the library by itself, for tests."""

from discrepancy.fitting.model_fit import WhitenedClips
from discrepancy.select.library_search import LibrarySearch


def library_search(clips, base, noise):
    """A search that has fitted nothing but the base."""
    return LibrarySearch(WhitenedClips.of(clips, noise), base, lambda: None)


def selected(clips, base, noise):
    """The search, and the selection that it leads to."""
    steps = library_search(clips, base, noise)
    return steps, steps.select(steps.finish(()))


def claimed(clips, base, noise):
    """The effects that are claimed."""
    steps, found = selected(clips, base, noise)
    return steps.claims(found.state)
