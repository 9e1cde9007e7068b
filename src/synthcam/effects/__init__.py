"""The library: one file, one effect. Found by scanning this folder."""
