"""Observables of a granular gas: temperature, velocities, contacts, pair correlation and energies of many balls."""
