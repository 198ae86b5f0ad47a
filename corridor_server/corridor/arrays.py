"""The kinds of arrays that the corridor is made of, each with a leading axis of areas."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Counts = NDArray[np.int64]
Parameters = Mapping[str, Floats]
