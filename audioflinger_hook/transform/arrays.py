"""Array types of the transform."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
IntArray = NDArray[np.intp]
Frames = NDArray[np.floating[Any]]
"""Input sound: (frames, channels) or (frames,), floating point, full scale +-1."""
