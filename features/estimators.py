"""Line estimators by name, with a common interface."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from . import arras_siegwart, corner, siadat, wclm
from .compiled import compiled
from .line_fit import LineFit
from .types import Floats, Noise

MAXIMUM_LIKELIHOOD = 0
WCLM = 1
ARRAS_SIEGWART = 2
SIADAT = 3


class Estimator(NamedTuple):
    """Line fit, corner of two such lines, and code of the estimator in compiled functions."""

    fit: Callable[[Floats, Floats, Noise], LineFit]
    corner: Callable[[LineFit, LineFit], tuple[Floats, Floats]]
    code: int


ESTIMATORS = {
    "wclm-ml": Estimator(wclm.fit_maximum_likelihood, corner.corner, MAXIMUM_LIKELIHOOD),
    "wclm": Estimator(wclm.fit, corner.corner, WCLM),
    "arras-siegwart": Estimator(arras_siegwart.fit, arras_siegwart.corner, ARRAS_SIEGWART),
    "siadat": Estimator(siadat.fit, siadat.corner, SIADAT),
}


@compiled
def fit_by_code(
    code: int, inverse: Floats, cos: Floats, sin: Floats, sigma_range: float, sigma_bearing: float
) -> tuple[float, float, float, float, float]:
    """Return (u, v, Cuu, Cuv, Cvv) of one of the non-iterative estimators; NaN for any other code.

    inverse, cos, sin           (n,) 1/range of the rays, 1/metres, and cosine and sine of their bearings
    sigma_range, sigma_bearing  noise of a ray, metres and radians
    """
    if code == WCLM:
        return wclm.fit_wclm(inverse, cos, sin, sigma_range, sigma_bearing)
    if code == ARRAS_SIEGWART:
        return arras_siegwart.fit_arras_siegwart(inverse, cos, sin, sigma_range, sigma_bearing)
    if code == SIADAT:
        return siadat.fit_siadat(inverse, cos, sin, sigma_range, sigma_bearing)
    return math.nan, math.nan, math.nan, math.nan, math.nan
