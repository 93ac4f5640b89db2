"""Types of arrays."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Float64: TypeAlias = NDArray[np.float64]
Int64: TypeAlias = NDArray[np.int64]
Bool: TypeAlias = NDArray[np.bool_]
Intp: TypeAlias = NDArray[np.intp]
Records: TypeAlias = NDArray[np.void]
AnyArray: TypeAlias = NDArray[Any]
