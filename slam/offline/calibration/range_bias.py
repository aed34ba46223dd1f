"""Estimate the range bias, an error common to all ranges of a lidar, from a drive: it is an unknown of the graph."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.messages import Message

from ...config import Config
from ...errors import MapError
from ...pipeline import Slam


def estimate_range_bias(drive: Sequence[Message], config: Config) -> tuple[float, float]:
    """Return the range bias of a drive and its standard deviation, metres, starting from the configured bias.

    Raises MapError if there is no map, or if it has no walls.
    """
    slam = Slam(config)
    for message in drive:
        slam.add(message)
    slam.finish()
    return range_bias_of(slam)


def range_bias_of(slam: Slam) -> tuple[float, float]:
    """Return the range bias and its standard deviation, metres, of a finished run, with the configured bias added.

    Raises MapError if the map has no walls.
    """
    bias = slam.slam_state.mapper.graph.range_bias
    if np.isnan(bias.sigma):
        raise MapError("the map has no walls to calibrate the ranges from")
    return slam.config.lidar.range_bias + bias.metres, bias.sigma
