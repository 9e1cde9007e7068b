"""Balls that are seen whole: which regions are discs, and where their centres are."""
