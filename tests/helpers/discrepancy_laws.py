"""Free laws for tests."""

import dataclasses


def with_constant(law):
    """The law with the constant that it has not, since launches or base parameters absorb it."""
    kind = type(type(law).__name__, (type(law),), {"centred": False, "__module__": type(law).__module__})
    return kind(**{f.name: getattr(law, f.name) for f in dataclasses.fields(law)})
