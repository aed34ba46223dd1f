"""How well walls and corners are found, and how honest their covariances are, over levels of noise and of outliers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

import numpy as np

from ..estimators import ESTIMATORS
from ..extract import Extractor
from ..line_tracking import PAPER_DISTANCE
from ..types import Noise
from .rooms import RoomScan, simulate
from .scoring import Score

SCANS = 400
"""Scans of each level."""


class Level(NamedTuple):
    """Noise and outliers that scans are simulated with."""

    sigma_range: float  # metres
    sigma_bearing: float  # radians
    outliers: float  # share of the returns

    @property
    def noise(self) -> Noise:
        """As extractors take it."""
        return Noise(self.sigma_range, self.sigma_bearing)


FINE, COARSE = float(np.radians(0.05)), float(np.radians(0.1955))
"""Bearing noise of a good lidar, and what the RPLIDAR S1's grid of bearings amounts to."""
LEVELS = (
    Level(0.005, FINE, 0.0),
    Level(0.01, FINE, 0.0),
    Level(0.01, COARSE, 0.0),
    Level(0.02, COARSE, 0.0),
    Level(0.05, COARSE, 0.0),
    Level(0.01, FINE, 0.01),
    Level(0.02, COARSE, 0.01),
)
CURVED_LEVELS = LEVELS[:5]
"""Of the rooms with columns and an arc."""


class Method(NamedTuple):
    """One way of extraction; `tracking_sigmas` sets the threshold of tracking by the range noise, 0 to the paper's."""

    method: Literal["split", "tracking"]
    estimator: str
    tracking_sigmas: float = 0.0

    @property
    def name(self) -> str:
        """For tables."""
        if self.method == "split":
            return f"split/{self.estimator}"
        threshold = f"{self.tracking_sigmas:g} sigma" if self.tracking_sigmas else f"{1000 * PAPER_DISTANCE:g} mm"
        return f"tracking {threshold}/{self.estimator}"

    def extractor(self, noise: Noise) -> Extractor:
        """That knows the noise, and does not learn it."""
        distance = self.tracking_sigmas * noise.sigma_range or PAPER_DISTANCE
        return Extractor(
            noise, method=self.method, estimator=self.estimator, adapt_noise=False, tracking_distance=distance
        )


METHODS = (*(Method("split", name) for name in ESTIMATORS), Method("tracking", "wclm"), Method("tracking", "wclm", 3.0))
"""The product's segmentation with every estimator; the paper's, with its threshold and with one to suit the noise."""


class Row(NamedTuple):
    """What one way made of the scans of one level; a NEES of two dimensions, of which 2 is ideal."""

    way: str
    sigma_range: float
    sigma_bearing: float
    outliers: float
    precision: float
    recall: float
    corner_recall: float
    false_corners: float
    corner_error: float  # median, metres
    corner_rms: float  # metres
    corner_nees: float  # mean
    corner_nees_median: float
    line_nees: float
    line_nees_median: float
    curves: int
    curved_lines: float  # per curve
    curved_corners: float


def scans_of(level: Level, scans: int, seed: int, *, curved: bool = False) -> list[RoomScan]:
    """The scans of one level; the same for every way, and with every call."""
    return [
        simulate(
            np.random.default_rng([seed, number]), level.noise, number=number, outliers=level.outliers, curved=curved
        )
        for number in range(scans)
    ]


def measure(
    *,
    scans: int = SCANS,
    seed: int = 0,
    levels: Sequence[Level] = LEVELS,
    ways: Sequence[Method] = METHODS,
    curved: bool = False,
) -> Iterator[Row]:
    """Every way on the scans of every level; rooms with an arc and columns instead of boxes where `curved`."""
    for level in levels:
        rooms = scans_of(level, scans, seed, curved=curved)
        for way in ways:
            extractor, score = way.extractor(level.noise), Score()
            for room in rooms:
                score.add(room, extractor.extract(room.ranges, room.angles), level.sigma_range)
            yield _row(way, level, score)


def _row(way: Method, level: Level, score: Score) -> Row:
    errors = np.array(score.corner_errors or [np.nan])
    corner, line = np.array(score.corner_nees or [np.nan]), np.array(score.line_nees or [np.nan])
    per_curve = np.array([score.curved_lines, score.curved_corners]) / max(score.curves, 1)
    return Row(
        way.name,
        *level,
        score.precision,
        score.recall,
        score.corner_recall,
        1.0 - score.corner_precision,
        float(np.median(errors)),
        float(np.sqrt(np.mean(errors**2))),
        float(corner.mean()),
        float(np.median(corner)),
        float(line.mean()),
        float(np.median(line)),
        score.curves,
        *per_curve.tolist(),
    )
