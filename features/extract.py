"""Lines and corners of one scan after the other."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from . import pieces, rays, segmentation, tracking
from .condense import Found, condense
from .estimators import ESTIMATORS
from .settings import Settings
from .types import Corners, Features, Floats, Lines, Noise

ROUGHNESS = 0.01
"""Metres by which a real wall, and ranges along it, stray from a straight line other than by white noise."""

NOISE_FLOOR = 0.002
"""Least range noise that adaptation may arrive at, metres; no lidar on a robot is better, and simulations often are."""

NOISE_CEILING = 0.10
"""Largest range noise that adaptation may arrive at, metres."""

PRIOR_SCANS = 2.0
"""Scans that the given range noise is worth against those seen."""

SLOWEST_GAIN = 0.03
"""Least weight of a new scan in the range variance, once many are seen: a memory of about 30 scans."""


class Extractor:
    """Condenses the scans of one lidar into lines and corners.

    method          "split": recursive splitting, merging, bridging; "tracking": the paper's line tracking
    estimator       of the lines, a name in ESTIMATORS
    noise           standard deviations of a ray's range (metres) and bearing (radians)
    adapt_noise     learn the standard deviation of range from the residuals of long walls, scan by scan
    range_min, range_max  metres; returns outside are ignored. Many lidars report "no return" as a range above 80 m.
    minimum_count   rays of a line. Two parameters are fitted; five leave three degrees of freedom to tell a wall by.
    minimum_length  metres of a line; shorter ones are furniture and door frames more than walls
    maximum_gap     metres of opening in a wall beyond which its two parts stay two lines
    roughness       metres by which real walls stray from straight lines; breaks must stand out from it
    penalty         gain of chi-square that a further break must bring
    tracking_distance  metres from a tracked line within which a ray belongs to it
    known_from      scans that the given noise of ranges is worth against those seen
    """

    def __init__(
        self,
        noise: Noise,
        *,
        method: Literal["split", "tracking"] = "split",
        estimator: str = "wclm-ml",
        adapt_noise: bool = True,
        range_min: float = 0.05,
        range_max: float = 80.0,
        minimum_count: int = 5,
        minimum_length: float = 0.25,
        maximum_gap: float = 0.4,
        penalty: float = segmentation.PENALTY,
        roughness: float = ROUGHNESS,
        tracking_distance: float = tracking.PAPER_DISTANCE,
        known_from: float = PRIOR_SCANS,
    ) -> None:
        if estimator not in ESTIMATORS:
            raise ValueError(f"no estimator {estimator!r}; there are {', '.join(ESTIMATORS)}")
        if method not in ("split", "tracking"):
            raise ValueError(f"no method {method!r}; there are split, tracking")
        if not (noise.sigma_range > 0.0 and noise.sigma_bearing >= 0.0):
            raise ValueError(f"noise must be positive, is {noise}")
        self._noise = noise
        self._adapt = adapt_noise
        self._scans = known_from
        settings = Settings(
            sigma_range=float(noise.sigma_range),
            sigma_bearing=float(noise.sigma_bearing),
            range_min=max(float(range_min), 1e-3),
            range_max=float(range_max),
            minimum_count=max(int(minimum_count), 3),
            minimum_length=float(minimum_length),
            maximum_gap=float(maximum_gap),
            penalty=float(penalty),
            roughness=float(roughness),
            tracking_distance=float(tracking_distance) if method == "tracking" else 0.0,
            estimator=ESTIMATORS[estimator].code,
        )
        self._settings = tuple(settings)
        self._capacity = 0
        self._make_room(1)

    @property
    def noise(self) -> Noise:
        """What the next scan will be condensed with."""
        return self._noise

    def extract(self, ranges: Floats, angles: Floats) -> Features:
        """Lines and corners of one scan, in the lidar's frame.

        `ranges` (n,) metres, `angles` (n,) radians in increasing order, up to a full revolution or a little more; n may
        change from scan to scan. Ranges that are not finite, not positive or out of limits are ignored.
        """
        count = len(ranges)
        if len(angles) != count:
            raise ValueError(f"{count} ranges and {len(angles)} angles; they must be as many")
        if count != len(self._ranges):
            self._make_room(count)
        # copies, as a read-only or otherwise typed array would make the compiler start over
        self._ranges[:] = ranges
        self._angles[:] = angles
        used = self._noise
        lines, corners, variance = self.condense()
        if self._adapt and not math.isnan(variance):
            self._learn(variance)
        return Features(self._lines(lines), self._corners(corners), used)

    def condense(self) -> tuple[int, int, float]:
        """The compiled part of `extract`, on the last scan: numbers of lines and corners, range variance shown."""
        return condense(self._ranges, self._angles, self._settings, self._memory, tuple(self._found))

    def _make_room(self, beams: int) -> None:
        """Memory for scans of `beams` beams; that of a larger scan stays."""
        self._ranges, self._angles = np.empty(beams), np.empty(beams)
        if beams <= self._capacity:
            return
        self._capacity = beams
        self._memory = (*rays.allocate(beams), *pieces.allocate(beams))
        self._found = Found(
            lines=np.zeros((beams + 1, 12)),
            spans=np.zeros((beams + 1, 5), dtype=np.int64),
            curved=np.zeros(beams + 1, dtype=np.bool_),
            corners=np.zeros((beams + 1, 7)),
            pairs=np.zeros((beams + 1, 2), dtype=np.int64),
            evidence=np.zeros(beams + 1),
        )

    def _learn(self, variance: float) -> None:
        """Take the range variance that a scan shows into the running mean, a geometric one: noise errs by factors."""
        gain = max(1.0 / (self._scans + 1.0), SLOWEST_GAIN)
        self._scans += 1.0
        shown = min(max(variance, NOISE_FLOOR**2), NOISE_CEILING**2)
        sigma = self._noise.sigma_range ** (1.0 - gain) * shown ** (0.5 * gain)
        self._noise = Noise(sigma, self._noise.sigma_bearing)
        self._settings = (sigma, *self._settings[1:])

    def _lines(self, count: int) -> Lines:
        rows = self._found.lines[:count].copy()
        spans = self._found.spans[:count].copy()
        return Lines(
            rows[:, 0:2],  # uv
            rows[:, 2:6].reshape(count, 2, 2),  # covariance
            rows[:, 6:8],  # start
            rows[:, 8:10],  # end
            spans[:, 0],  # first
            spans[:, 1],  # last
            spans[:, 2],  # count
            rows[:, 10],  # chi2
            self._found.curved[:count].copy(),
        )

    def _corners(self, count: int) -> Corners:
        rows = self._found.corners[:count].copy()
        covariance = rows[:, 2:6].reshape(count, 2, 2)
        return Corners(rows[:, 0:2], covariance, self._found.pairs[:count].copy())


def warm_up() -> None:
    """Compile, or load from the cache on disk, all that extraction needs, so that the first scan is as fast as any."""
    angles = np.linspace(-math.pi, math.pi, 90, endpoint=False)
    ranges = 2.0 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    Extractor(Noise(0.01, 0.001)).extract(ranges, angles)
