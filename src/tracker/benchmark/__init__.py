"""One benchmark for every tracker: a suite of films, trackers run on it, entries beside one another."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
