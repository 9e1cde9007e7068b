"""Property tests draw the same cases everywhere, HYPOTHESIS_PROFILE=random new ones; tests find benchmarks/sealed."""

import os
import sys
from pathlib import Path

from hypothesis import settings

sys.path.append(str(Path(__file__).parent.parent / "benchmarks"))

settings.register_profile("same", derandomize=True, deadline=None)
settings.register_profile("random", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))
