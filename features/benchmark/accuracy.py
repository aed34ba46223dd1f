"""Accuracy and consistency of walls and corners, by level of noise and outliers."""

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

# Number of scans per level. Origin: chosen, half a per cent of scatter; not measured.
SCANS = 400


class Level(NamedTuple):
    """Noise and outliers of simulated scans."""

    sigma_range: float  # metres
    sigma_bearing: float  # radians
    outliers: float  # share of the returns

    @property
    def noise(self) -> Noise:
        """Noise as an argument of Extractor."""
        return Noise(self.sigma_range, self.sigma_bearing)


# Radians; bearing noise of a good lidar.
FINE = float(np.radians(0.05))
# Radians; bearing noise equivalent to the grid of bearings of the RPLIDAR S1.
COARSE = float(np.radians(0.1955))
LEVELS = (
    Level(0.005, FINE, 0.0),
    Level(0.01, FINE, 0.0),
    Level(0.01, COARSE, 0.0),
    Level(0.02, COARSE, 0.0),
    Level(0.05, COARSE, 0.0),
    Level(0.01, FINE, 0.01),
    Level(0.02, COARSE, 0.01),
)
# Levels of rooms with columns and an arc.
CURVED_LEVELS = LEVELS[:5]


class ExtractionMethod(NamedTuple):
    """Segmentation and estimator.

    tracking_sigmas  threshold of tracking in units of the range noise; 0 for the threshold of the paper
    """

    segmentation: Literal["split", "tracking"]
    estimator: str
    tracking_sigmas: float = 0.0

    @property
    def name(self) -> str:
        """Name in tables."""
        if self.segmentation == "split":
            return f"split/{self.estimator}"
        threshold = f"{self.tracking_sigmas:g} sigma" if self.tracking_sigmas else f"{1000 * PAPER_DISTANCE:g} mm"
        return f"tracking {threshold}/{self.estimator}"

    def extractor(self, noise: Noise) -> Extractor:
        """Return an extractor with the given noise, which it does not adapt."""
        distance = self.tracking_sigmas * noise.sigma_range or PAPER_DISTANCE
        return Extractor(
            noise, method=self.segmentation, estimator=self.estimator, adapt_noise=False, tracking_distance=distance
        )


# Recursive splitting with every estimator; the paper's tracking with its threshold and with one adapted to the noise.
METHODS = (
    *(ExtractionMethod("split", name) for name in ESTIMATORS),
    ExtractionMethod("tracking", "wclm"),
    ExtractionMethod("tracking", "wclm", 3.0),
)


class Row(NamedTuple):
    """Result of one method on the scans of one level; a NEES is not divided by its two dimensions, 2 is consistent."""

    method: str
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
    """Return the scans of one level, the same for every method and call."""
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
    methods: Sequence[ExtractionMethod] = METHODS,
    curved: bool = False,
) -> Iterator[Row]:
    """Evaluate every method on the scans of every level; if `curved`, in rooms with an arc and columns."""
    for level in levels:
        rooms = scans_of(level, scans, seed, curved=curved)
        for method in methods:
            extractor, score = method.extractor(level.noise), Score()
            for room in rooms:
                score.add(room, extractor.extract(room.ranges, room.angles), level.sigma_range)
            yield _row(method, level, score)


def _row(method: ExtractionMethod, level: Level, score: Score) -> Row:
    errors = np.array(score.corner_errors or [np.nan])
    corner, line = np.array(score.corner_nees or [np.nan]), np.array(score.line_nees or [np.nan])
    per_curve = np.array([score.curved_lines, score.curved_corners]) / max(score.curves, 1)
    return Row(
        method.name,
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
