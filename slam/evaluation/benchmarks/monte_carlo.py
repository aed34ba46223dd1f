"""Monte Carlo test of the covariances of lines and corners, for the documentation's plots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.immutable import immutable
from features import ESTIMATORS, LineFit, Noise
from features.conversions import covariance_through, polar_of_uv

from ...geometry.chi_square import chi_square_quantile
from ...geometry.segments import Floats

TRIALS = 3000
NOISE = Noise(sigma_range=0.02, sigma_bearing=float(np.radians(0.1)))
BEAM_SPACING = float(np.radians(0.5))
"""Between neighbouring rays, radians."""
FIT, CORNER, _ = ESTIMATORS["wclm-ml"]
CHI2_95 = chi_square_quantile(0.95, 2)
"""Chi-square, 2 degrees of freedom, 95 %."""


@dataclass(frozen=True, slots=True)
class Wall:
    """A straight wall observed from the origin.

    distance   metres
    normal     direction of the normal, radians
    low, high  bearings between which the wall is observed, radians
    """

    distance: float
    normal: float
    low: float
    high: float

    @property
    def bearings(self) -> Floats:
        """(n,) bearings of the rays on the wall, radians."""
        return np.arange(self.low, self.high, BEAM_SPACING)

    def ranges(self, bearings: Floats) -> Floats:
        """Return the true ranges (n,) at bearings (n,), metres."""
        return np.asarray(self.distance / np.cos(bearings - self.normal))

    def points(self, along: Floats) -> Floats:
        """Return points (n, 2) of the wall, `along` (n,) metres from the one closest to the lidar."""
        c, s = np.cos(self.normal), np.sin(self.normal)
        return np.asarray(self.distance * np.array([c, s]) + along[:, None] * np.array([-s, c]))

    @property
    def span(self) -> Floats:
        """(2,) ends of the observed part, metres along the wall."""
        return np.asarray(self.distance * np.tan(self.bearings[[0, -1]] - self.normal))

    def measure(self, random: np.random.Generator, noise: Noise = NOISE) -> Floats:
        """Return noisy ranges (n,) at the nominal `bearings`, with range and bearing noise."""
        bearings = self.bearings
        actual = bearings + random.normal(0.0, noise.sigma_bearing, len(bearings))
        return np.asarray(self.ranges(actual) + random.normal(0.0, noise.sigma_range, len(bearings)))

    def fit(self, random: np.random.Generator, noise: Noise = NOISE) -> LineFit:
        """Fit a line to one noisy sweep."""
        return FIT(self.measure(random, noise), self.bearings, noise)


@immutable
class Deviations:
    """Offsets of fitted lines from the true wall.

    along    (n,) metres from the point closest to the lidar
    found    (TRIALS, n) offsets, metres
    claimed  (n,) standard deviation of the offset by the first fit's covariance, metres
    """

    along: Floats
    found: Floats
    claimed: Floats


def deviations(wall: Wall, seed: int, *, beyond: float = 0.5, places: int = 41) -> Deviations:
    """Return the offsets of many fits, at `places` points up to `beyond` times the wall's length past its ends.

    The distance of a point p of the wall from the line (u, v) is (1 - p.(u, v)) / |(u, v)|, so its variance d^2 p' C p.
    """
    random = np.random.default_rng(seed)
    low, high = wall.span
    along = np.linspace(low - beyond * (high - low), high + beyond * (high - low), places)
    points = wall.points(along)
    fits = [wall.fit(random) for _ in range(TRIALS)]
    lines = np.array([fit.uv for fit in fits])
    found = (1.0 - lines @ points.T) / np.linalg.norm(lines, axis=1)[:, None]
    variance = wall.distance**2 * np.einsum("ni,ij,nj->n", points, fits[0].covariance, points)
    return Deviations(along, found, np.sqrt(variance))


@immutable
class Cloud:
    """Many estimates of one quantity, and the covariance of one of them.

    found       (TRIALS, 2) estimates
    truth       (2,)
    covariance  (2, 2) of the first estimate
    within      share of the estimates within their own 95 % ellipse
    """

    found: Floats
    truth: Floats
    covariance: Floats
    within: float


def line_parameters(wall: Wall, noise: Noise, seed: int) -> tuple[Cloud, Cloud]:
    """Return many fits of one wall as (u, v), and as distance and direction (d, alpha)."""
    random = np.random.default_rng(seed)
    fits = [wall.fit(random, noise) for _ in range(TRIALS)]
    uv = np.array([np.cos(wall.normal), np.sin(wall.normal)]) / wall.distance
    polar = [polar_of_uv(fit.uv) for fit in fits]
    polar_covariances = [
        covariance_through(jacobian, fit.covariance) for fit, (_, jacobian) in zip(fits, polar, strict=True)
    ]
    return (
        _cloud([fit.uv for fit in fits], uv, [fit.covariance for fit in fits]),
        _cloud([parameters for parameters, _ in polar], np.array([wall.distance, wall.normal]), polar_covariances),
    )


def corner_positions(first: Wall, second: Wall, seed: int) -> Cloud:
    """Return many estimates of the corner of two walls."""
    random = np.random.default_rng(seed)
    found = [CORNER(first.fit(random), second.fit(random)) for _ in range(TRIALS)]
    normals = np.array([[np.cos(wall.normal), np.sin(wall.normal)] for wall in (first, second)])
    truth = np.linalg.solve(normals, np.array([first.distance, second.distance]))
    return _cloud([f[0] for f in found], truth, [f[1] for f in found])


def _cloud(found: list[Floats], truth: Floats, covariances: list[Floats]) -> Cloud:
    values = np.array(found)
    error = values - truth
    squared = np.einsum("ni,ni->n", error, np.linalg.solve(np.array(covariances), error[..., None])[..., 0])
    return Cloud(values, truth, covariances[0], float(np.mean(squared <= CHI2_95)))
