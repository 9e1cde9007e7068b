"""Datasets: their files, how they are made by many processes, merged, checked, shown and exported."""
