"""Result and input of the line estimators."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .types import Floats


@dataclass(frozen=True, slots=True, eq=False)
class LineFit:
    """One line fitted to the rays of one wall, in the lidar's frame.

    uv                    (2,) 1/metres: the line is u x + v y = 1
    covariance            (2, 2) of uv
    parameters            (k,) the estimator's own parameters of the line
    parameter_covariance  (k, k) of parameters
    """

    uv: Floats
    covariance: Floats
    parameters: Floats
    parameter_covariance: Floats


def ray_arrays(ranges: Floats, angles: Floats) -> tuple[Floats, Floats, Floats]:
    """Return 1/range, cos and sin (n,) of n rays, contiguous float64, as input of the compiled functions.

    Raises ValueError if the arguments are not two vectors of the same length.
    """
    bearings = np.asarray(angles, dtype=np.float64)
    distances = np.asarray(ranges, dtype=np.float64)
    if distances.ndim != 1 or distances.shape != bearings.shape:
        raise ValueError(f"ranges {distances.shape} and angles {bearings.shape} must be two vectors of one length")
    return 1.0 / distances, np.cos(bearings), np.sin(bearings)
