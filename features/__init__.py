"""Lines and corners of 2-D lidar scans, with covariances.

    from features import Extractor, Noise, warm_up

    warm_up()
    extractor = Extractor(Noise(sigma_range=0.01, sigma_bearing=0.002))
    for ranges, angles in scans:
        features = extractor.extract(ranges, angles)
        features.lines.uv, features.lines.covariance, features.corners.position

The estimators of single lines and corners are listed in ESTIMATORS and implemented in `wclm`, `arras_siegwart`,
`siadat` and `corner`; `conversions` has other parametrisations of a line.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .estimators import ESTIMATORS, Estimator
    from .extract import Extractor, warm_up
    from .line_fit import LineFit
    from .types import Corners, Features, LearnedNoise, Lines, Noise

__all__ = [
    "ESTIMATORS",
    "Corners",
    "Estimator",
    "Extractor",
    "Features",
    "LearnedNoise",
    "LineFit",
    "Lines",
    "Noise",
    "warm_up",
]

_MODULES = {
    "ESTIMATORS": "estimators",
    "Corners": "types",
    "Estimator": "estimators",
    "Extractor": "extract",
    "Features": "types",
    "LearnedNoise": "types",
    "LineFit": "line_fit",
    "Lines": "types",
    "Noise": "types",
    "warm_up": "extract",
}


def __getattr__(name: str) -> Any:
    # Imported on first use: numba takes most of a second to load, and reports and drawings need some constants only.
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_MODULES[name]}", __name__), name)
