"""Parameters of the simulated lidar, and mixed pixels: beams that are split by an edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..messages import Floats

EDGE_STEP = 0.1
"""Metres. Two neighbouring beams lie on different surfaces if their ranges differ by more than this beyond
EDGE_STEP_RATIO times the differences beside them."""
EDGE_STEP_RATIO = 1.5
"""Ratio of successive range differences. Along a wall at grazing incidence they grow by less from beam to beam."""


@dataclass(frozen=True, slots=True)
class LidarModel:
    """Parameters of a rotating lidar and its noise; the defaults are those of an RPLIDAR S1.

    beams          beams per revolution, counter-clockwise; the first of a full revolution points backwards
    rate           revolutions per second
    field_of_view  radians, symmetric about the lidar's x axis; beams outside are not measured
    range_min, range_max  metres; ranges outside are invalid
    sigma_range    standard deviation of the white noise of each range, metres
    sigma_bearing  standard deviation of the white noise of each beam's direction, radians
    range_bias     constant error of all ranges, metres
    dropouts       share of the beams that are no-returns
    mixed          share of the beams beside an edge that measure a range between the two surfaces (mixed pixels)
    """

    beams: int = 920
    rate: float = 10.0
    field_of_view: float = float(2 * np.pi)
    range_min: float = 0.1
    range_max: float = 40.0
    sigma_range: float = 0.01
    sigma_bearing: float = float(np.radians(0.05))
    range_bias: float = 0.0
    dropouts: float = 0.01
    mixed: float = 0.3


LIDAR_MODELS = {
    "long": LidarModel(),
    "short": LidarModel(beams=360, rate=5.5, range_max=6.0, sigma_range=0.015),
    "half": LidarModel(field_of_view=float(np.pi)),
}
"""Lidars by name: a long-range one that covers a hall, a low-cost one that covers a room, and the long-range one with a
field of view of half a circle."""


def add_mixed_pixels(ranges: Floats, selected: NDArray[np.bool_], share: Floats) -> None:
    """Replace, in place, ranges (n,) beside an edge by ranges between its two surfaces.

    ranges    (n,) metres, of neighbouring beams; the last is the neighbour of the first
    selected  (n,) beams that become mixed pixels if they are beside an edge
    share     (n,) position between the two surfaces, 0 to 1
    """
    step = _range_steps(ranges)
    mixed = _is_at_edge(step) & selected
    ranges[mixed] += share[mixed] * step[mixed]


def _range_steps(ranges: Floats) -> Floats:
    """Return the range of the next beam minus each beam's own (n,), metres; zero if either is infinite."""
    with np.errstate(invalid="ignore"):  # infinity minus infinity if neither beam meets anything
        step = _of_next(ranges) - ranges
    return np.where(np.isfinite(step), step, 0.0)


def _of_next(values: Floats) -> Floats:
    """Return for each beam the value (n,) of the next one, in a tenth of the time of NumPy's `roll`."""
    return np.concatenate([values[1:], values[:1]])


def _is_at_edge(step: Floats) -> NDArray[np.bool_]:
    """Return (n,) true if a beam and the next lie on different surfaces, from the range steps (n,) of a revolution.

    Range steps along a wall at grazing incidence are large too, but grow slowly from beam to beam.
    """
    size = np.abs(step)
    around = np.maximum(np.concatenate([size[-1:], size[:-1]]), _of_next(size))
    return np.asarray(size > EDGE_STEP + EDGE_STEP_RATIO * around)
