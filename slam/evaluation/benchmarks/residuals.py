"""Test the noise model of walls on recordings, where the truth is unknown (`wclm bench residuals`).

Whitened residuals of the observations of a wall should be independent, with a variance of one. Errors that observations
share, such as a bend of the wall, show as a correlation between successive observations: the variance of a mean of n
observations is larger than modelled by the factor 1 + 2 sum rho_k.

The two halves of a drive, mapped separately, have independent measurements. The walls that both contain should differ
by what the joint covariances of both maps state, except for the motion between the two maps' frames.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from drivers.messages import Message

from ...config import Config
from ...errors import MapError
from ...events import Finished
from ...geometry.segments import Floats
from ...graph.factors import OBSERVATION_KINDS, FactorKind
from ...graph.wall_correlation import MAX_LAG, whitened_residuals
from ...io.tum import Trajectory
from ...mapping.mapper import Mapper
from ...pipeline import Slam
from .map_comparison import MapComparison, compare_maps
from .relocalisation import split_halves


@dataclass(frozen=True, slots=True)
class ResidualStatistics:
    """Whitened residuals of one kind.

    count        number of residuals
    rms          root of their mean square; 1 if the standard deviations are right
    correlation  1 + 2 sum of the autocorrelation up to MAX_LAG observations of a wall; 1 if they are independent, below
                 for short series because each wall's own estimate is subtracted
    """

    count: int
    rms: float
    correlation: float


@dataclass(frozen=True, slots=True)
class RecordingConsistency:
    """Result for one recording; `halves` is None if they have too few common walls, or one gives no map."""

    name: str
    heading: ResidualStatistics
    offset: ResidualStatistics
    halves: MapComparison | None

    def as_data(self) -> dict[str, Any]:
        """Return the result as plain data for JSON."""
        return asdict(self)


def examine(name: str, messages: Sequence[Message], config: Config) -> RecordingConsistency:
    """Map a recording and its two halves. Raises MapError if the recording gives no map."""
    slam, finished = _map(messages, config)
    residuals = wall_residuals(slam.slam_state.mapper)
    statistics = {kind: residual_statistics(list(residuals[kind].values())) for kind in OBSERVATION_KINDS}
    path = Trajectory.sorted(finished.stamps, finished.poses)
    try:
        first, second = (_map(half, config) for half in split_halves(messages))
        comparison = compare_maps(first, second, path)
    except MapError:
        comparison = None
    return RecordingConsistency(
        name, statistics[FactorKind.WALL_HEADING], statistics[FactorKind.WALL_OFFSET], comparison
    )


def _map(messages: Sequence[Message], config: Config) -> tuple[Slam, Finished]:
    slam = Slam(config)
    for message in messages:
        slam.add(message)
    return slam, slam.finish()


# --- Residuals


def wall_residuals(mapper: Mapper) -> dict[FactorKind, dict[int, Floats]]:
    """Return the whitened residuals (n,) of each wall by its id, in the order of the keyframes, for each kind.

    Observations are those without the range bias that was estimated with the map.
    """
    solver = mapper.graph.solver
    poses = dict(enumerate(mapper.graph.keyframe_poses(mapper.keyframe_count)))
    found: dict[FactorKind, dict[int, Floats]] = {}
    for kind in OBSERVATION_KINDS:
        factors = [factor for factor in solver.factors.values() if factor.kind is kind]
        factors.sort(key=lambda factor: factor.first)
        of_wall = np.array([factor.second for factor in factors], dtype=np.int64)
        walls = np.unique(of_wall).tolist()
        frames = dict(zip(walls, mapper.graph.wall_frames(walls), strict=True))
        values = whitened_residuals(factors, poses, frames, solver.range_bias.metres) if factors else np.zeros(0)
        found[kind] = {wall: values[of_wall == wall] for wall in walls}
    return found


def residual_statistics(series: Sequence[Floats]) -> ResidualStatistics:
    """Return the statistics of whitened residuals, one series (n,) for each wall.

    The autocorrelation at a lag is the mean product of residuals of one wall that far apart, over the mean square.
    """
    values = np.concatenate(series) if series else np.zeros(0)
    if not len(values):
        return ResidualStatistics(0, math.nan, math.nan)
    square = float(np.mean(values**2))
    total = 1.0
    for lag in range(1, MAX_LAG + 1):
        products = np.concatenate([one[lag:] * one[:-lag] for one in series])
        total += 2.0 * float(np.mean(products)) / square if len(products) else 0.0
    return ResidualStatistics(len(values), math.sqrt(square), total)


def residual_table(results: Sequence[RecordingConsistency]) -> list[str]:
    """Return the lines of a Markdown table."""
    lines = [
        "| recording | observations | heading: rms | 1 + 2 sum rho | offset: rms | 1 + 2 sum rho | common walls | NEES "
        "| median | gross |",
        "|---" * 10 + "|",
    ]
    for row in results:
        heading, offset, halves = row.heading, row.offset, row.halves
        last = (
            "- | - | - | -"
            if halves is None
            else (f"{halves.common} | {halves.nees:.2f} | {halves.median:.2f} | {100 * halves.gross:.0f} %")
        )
        lines.append(
            f"| {row.name} | {heading.count} | {heading.rms:.2f} | {heading.correlation:.1f} | {offset.rms:.2f} "
            f"| {offset.correlation:.1f} | {last} |"
        )
    return lines
