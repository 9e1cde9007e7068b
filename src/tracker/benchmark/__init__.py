"""A benchmark for every tracker: a suite of films, runs of trackers on it, and a comparison of their entries."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
