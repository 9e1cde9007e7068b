"""Where the repository stands, for tests that read its other files."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
