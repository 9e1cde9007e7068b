"""The search of the library and of the free laws by themselves, for tests."""

from discrepancy.fitting.model_fit import WhitenedClips
from discrepancy.select.free_law_contest import FreeLawFits
from discrepancy.select.library_fits import LibraryFits
from discrepancy.select.library_search import complete_search, describe_claims, make_selection


def library_fits(clips, base, noise):
    """A library of which nothing but the base is fitted."""
    return LibraryFits(WhitenedClips.of(clips, noise), base)


def selected(clips, base, noise):
    """The library's fits, and the selection that a search leads to."""
    library = library_fits(clips, base, noise)
    return library, make_selection(library, complete_search(library, ()))


def claimed(clips, base, noise):
    """The effects that are claimed."""
    library, found = selected(clips, base, noise)
    return describe_claims(library, found.state)


def challenged(clips, base, noise):
    """The free laws that were fitted in full beside the base."""
    laws = FreeLawFits(WhitenedClips.of(clips, noise), base)
    laws.challenge(base)
    return laws.fitted
