"""Extractor of lines and corners, scan by scan."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from . import line_tracking, rays, segmentation, segments
from .estimators import ESTIMATORS
from .feature_buffers import FeatureBuffers, NoiseEstimate
from .kernel import extract_features
from .running_noise import PRIOR_LINES, given_noise, updated
from .settings import Settings
from .types import Corners, Features, Floats, LearnedNoise, Lines, Noise

# Metres. Deviation of real walls, and of ranges along them, from a straight line beyond white noise.
# Origin: chosen; not measured.
ROUGHNESS = 0.01
# Extractions from one scan after which the estimate of its noise is used as it is. Origin: numerical, from a third of
# the true standard deviation it changes by less than a hundredth after three.
MAX_SETTLING_EXTRACTIONS = 5
# Relative change of the standard deviation of range below which it has settled. Origin: numerical.
SETTLED = 0.01


class Extractor:
    """Extractor of lines and corners from the scans of one lidar.

    method          "split": recursive splitting, merging and bridging; "tracking": the paper's line tracking
    estimator       line estimator, a name in ESTIMATORS
    noise           standard deviations of a ray's range (metres) and bearing (radians)
    adapt_noise     estimate the standard deviations from the residuals of long walls, scan by scan. The bearing noise
                    that is estimated is that of the covariances only: with it, segmentation would take clutter and
                    pieces of two surfaces at a grazing angle for walls.
    range_min, range_max  metres; returns outside are ignored. Many lidars report a no-return as a range above 80 m.
    minimum_count   rays of a line. Two parameters are fitted; five rays leave three degrees of freedom for its test.
    minimum_length  metres of a line; shorter ones are furniture and door frames rather than walls
    maximum_gap     metres; across wider openings the two parts of a wall stay two lines
    penalty         decrease of chi-square that a further break must bring
    roughness       metres by which real walls deviate from straight lines; breaks must exceed it
    tracking_distance  metres from a tracked line within which a ray belongs to it
    learned         noise that earlier scans of this lidar have determined; it changes slowly
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
        tracking_distance: float = line_tracking.PAPER_DISTANCE,
        learned: LearnedNoise | None = None,
    ) -> None:
        if estimator not in ESTIMATORS:
            raise ValueError(f"no estimator {estimator!r}; known: {', '.join(ESTIMATORS)}")
        if method not in ("split", "tracking"):
            raise ValueError(f"no method {method!r}; known: split, tracking")
        if not (noise.sigma_range > 0.0 and noise.sigma_bearing >= 0.0):
            raise ValueError(f"noise must be positive, not {noise}")
        self._adapt = adapt_noise
        self._noise = learned if learned is not None and adapt_noise else given_noise(noise)
        settings = Settings(
            sigma_range=float(self.noise.segmentation_range),
            sigma_bearing=float(noise.sigma_bearing),
            learned_range=float(self.noise.sigma_range),
            learned_bearing=float(self.noise.sigma_bearing),
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
        self._allocate(1)

    @property
    def noise(self) -> LearnedNoise:
        """Noise assumed for the next scan."""
        return self._noise

    def extract(self, ranges: Floats, angles: Floats) -> Features:
        """Extract the lines and corners of one scan, in the lidar's frame.

        ranges  (n,) metres; ranges that are not finite, not positive or out of limits are ignored
        angles  (n,) radians in increasing order, up to a full revolution or slightly more

        n may change from scan to scan. Raises ValueError if the lengths differ.
        """
        self._load(ranges, angles)
        used = self.noise
        lines, corners, estimate = self.run_kernel()
        if self._adapt:
            self._assume(updated(used, estimate))
        return Features(self._lines(lines), self._corners(corners), used)

    def settle_noise(self, ranges: Floats, angles: Floats) -> bool:
        """Estimate the noise from one scan, by repeated extraction; return False if it does not determine it.

        The given noise may be wrong by a factor. What is extracted with it, as from the first scan of a drive, would
        have wrong covariances, and a running mean corrects it too late. The given range noise counts as PRIOR_LINES
        lines in a geometric mean with those of the scan. Arguments are those of `extract`. Without effect if noise is
        not adapted.
        """
        if not self._adapt:
            return True
        self._load(ranges, angles)
        given, share = self.noise, 0.0
        for _ in range(MAX_SETTLING_EXTRACTIONS):
            before = replace(self.noise, sigma_bearing=given.sigma_bearing, scans=0.0, lines=given.lines)
            lines, _, estimate = self.run_kernel()
            if not estimate.segmentation_weight > 0.0:
                break
            self._assume(updated(before, estimate))
            share = lines / (lines + PRIOR_LINES)
            changes = (
                self.noise.sigma_range / before.sigma_range,
                self.noise.segmentation_range / before.segmentation_range,
            )
            if all(abs(change - 1.0) < SETTLED for change in changes):
                break
        noise = LearnedNoise(
            given.sigma_range ** (1.0 - share) * self.noise.sigma_range**share,
            self.noise.sigma_bearing,
            given.segmentation_range ** (1.0 - share) * self.noise.segmentation_range**share,
            given.scans,
            given.lines,
        )
        self._assume(noise)
        return share > 0.0

    def run_kernel(self) -> tuple[int, int, NoiseEstimate]:
        """Run the compiled part of `extract` on the last scan; return the kernel's result."""
        return extract_features(self._ranges, self._angles, self._settings, self._memory, tuple(self._output))

    def _load(self, ranges: Floats, angles: Floats) -> None:
        """Copy a scan, as a read-only array or another data type would trigger a new compilation."""
        count = len(ranges)
        if len(angles) != count:
            raise ValueError(f"{count} ranges but {len(angles)} angles")
        if count != len(self._ranges):
            self._allocate(count)
        self._ranges[:] = ranges
        self._angles[:] = angles

    def _allocate(self, beams: int) -> None:
        """Allocate memory for scans of `beams` beams; larger memory is kept."""
        self._ranges, self._angles = np.empty(beams), np.empty(beams)
        if beams <= self._capacity:
            return
        self._capacity = beams
        self._memory = (*rays.allocate(beams), *segments.allocate(beams))
        self._output = FeatureBuffers(
            lines=np.zeros((beams + 1, 12)),
            spans=np.zeros((beams + 1, 5), dtype=np.int64),
            curved=np.zeros(beams + 1, dtype=np.bool_),
            corners=np.zeros((beams + 1, 7)),
            pairs=np.zeros((beams + 1, 2), dtype=np.int64),
            noise=np.zeros((beams + 1, len(NoiseEstimate._fields))),
        )

    def _assume(self, noise: LearnedNoise) -> None:
        """Assume a noise for the next scan."""
        self._noise, (_, given_bearing, _, _, *others) = noise, self._settings
        self._settings = (noise.segmentation_range, given_bearing, noise.sigma_range, noise.sigma_bearing, *others)

    def _lines(self, count: int) -> Lines:
        rows = self._output.lines[:count].copy()
        spans = self._output.spans[:count].copy()
        return Lines(
            rows[:, 0:2],  # uv
            rows[:, 2:6].reshape(count, 2, 2),  # covariance
            rows[:, 6:8],  # start
            rows[:, 8:10],  # end
            spans[:, 0],  # first
            spans[:, 1],  # last
            spans[:, 2],  # count
            rows[:, 10],  # chi2
            self._output.curved[:count].copy(),
        )

    def _corners(self, count: int) -> Corners:
        rows = self._output.corners[:count].copy()
        covariance = rows[:, 2:6].reshape(count, 2, 2)
        return Corners(rows[:, 0:2], covariance, self._output.pairs[:count].copy())


def warm_up() -> None:
    """Compile the extraction, or load it from the cache on disk, so that the first scan is not delayed."""
    angles = np.linspace(-math.pi, math.pi, 90, endpoint=False)
    ranges = 2.0 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    Extractor(Noise(0.01, 0.001)).extract(ranges, angles)
