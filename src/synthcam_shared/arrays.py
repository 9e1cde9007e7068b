"""Types of arrays by content; each use documents its shape."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Index = NDArray[np.intp]
Flags = NDArray[np.bool_]
