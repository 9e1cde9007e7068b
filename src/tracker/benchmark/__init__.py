"""One benchmark for every tracker: a suite of films, trackers run on it, entries beside one another."""
