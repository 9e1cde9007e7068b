"""Free laws for tests."""

import dataclasses


def with_constant(law):
    """The law with the constant that it has not, since launches or base parameters absorb it."""
    return dataclasses.replace(law, centred=False)
