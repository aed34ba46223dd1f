"""What covariances claim of a wall and of a corner, beside what thousands of noisy sweeps show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from features import ESTIMATORS, LineFit, Noise
from features.conversions import covariance_through, polar_of_uv
from features.types import Floats

TRIALS = 3000
NOISE = Noise(sigma_range=0.02, sigma_bearing=float(np.radians(0.1)))
BEAM = float(np.radians(0.5))
"""Between neighbouring rays."""
FIT, CORNER, _ = ESTIMATORS["wclm-ml"]
WITHIN_95 = 5.991
"""Squared Mahalanobis distance within which 95 % of what has two dimensions lie."""


@dataclass(frozen=True, slots=True)
class Wall:
    """A straight wall seen from the origin: its distance (metres), the direction of its normal, and the bearings
    between which it is seen (radians)."""

    distance: float
    normal: float
    low: float
    high: float

    @property
    def bearings(self) -> Floats:
        """(n,) of the rays that meet it, radians."""
        return np.arange(self.low, self.high, BEAM)

    def ranges(self, bearings: Floats) -> Floats:
        """(n,) true ranges at these bearings, metres."""
        return np.asarray(self.distance / np.cos(bearings - self.normal))

    def points(self, along: Floats) -> Floats:
        """(n, 2) points of the wall, `along` (n,) metres from the one closest to the lidar."""
        c, s = np.cos(self.normal), np.sin(self.normal)
        return np.asarray(self.distance * np.array([c, s]) + along[:, None] * np.array([-s, c]))

    @property
    def span(self) -> Floats:
        """(2,) metres along the wall between which it is seen."""
        return np.asarray(self.distance * np.tan(self.bearings[[0, -1]] - self.normal))

    def measure(self, random: np.random.Generator, noise: Noise = NOISE) -> Floats:
        """(n,) ranges as a noisy lidar tells them at its `bearings`; each ray goes a little beside its own."""
        bearings = self.bearings
        beside = bearings + random.normal(0.0, noise.sigma_bearing, len(bearings))
        return np.asarray(self.ranges(beside) + random.normal(0.0, noise.sigma_range, len(bearings)))

    def fit(self, random: np.random.Generator, noise: Noise = NOISE) -> LineFit:
        """The line through one noisy sweep."""
        return FIT(self.measure(random, noise), self.bearings, noise)


@dataclass(frozen=True, slots=True, eq=False)
class Deviations:
    """How far fitted lines lie beside the true wall at places along it.

    along    (n,) metres from the point closest to the lidar
    found    (TRIALS, n) metres across
    claimed  (n,) metres: the standard deviation that the first of the fits claims
    """

    along: Floats
    found: Floats
    claimed: Floats


def deviations(wall: Wall, seed: int, *, beyond: float = 0.5, places: int = 41) -> Deviations:
    """Fit the wall again and again; look at it from `beyond` times its length before it to as far behind it.

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


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """What was estimated again and again, and what one estimate claims: `found` (TRIALS, 2), `truth` (2,),
    `covariance` (2, 2), and the share of the estimates within their own 95 % ellipse."""

    found: Floats
    truth: Floats
    covariance: Floats
    within: float


def line_parameters(wall: Wall, noise: Noise, seed: int) -> tuple[Cloud, Cloud]:
    """The same lines by (u, v) and by distance and direction (d, alpha)."""
    random = np.random.default_rng(seed)
    fits = [wall.fit(random, noise) for _ in range(TRIALS)]
    uv = np.array([np.cos(wall.normal), np.sin(wall.normal)]) / wall.distance
    polar = [polar_of_uv(fit.uv) for fit in fits]
    carried = [covariance_through(jacobian, fit.covariance) for fit, (_, jacobian) in zip(fits, polar, strict=True)]
    return (
        _cloud([fit.uv for fit in fits], uv, [fit.covariance for fit in fits]),
        _cloud([parameters for parameters, _ in polar], np.array([wall.distance, wall.normal]), carried),
    )


def corner_positions(first: Wall, second: Wall, seed: int) -> Cloud:
    """The corner of two walls, intersected again and again."""
    random = np.random.default_rng(seed)
    found = [CORNER(first.fit(random), second.fit(random)) for _ in range(TRIALS)]
    normals = np.array([[np.cos(wall.normal), np.sin(wall.normal)] for wall in (first, second)])
    truth = np.linalg.solve(normals, np.array([first.distance, second.distance]))
    return _cloud([f[0] for f in found], truth, [f[1] for f in found])


def _cloud(found: list[Floats], truth: Floats, covariances: list[Floats]) -> Cloud:
    values = np.array(found)
    error = values - truth
    squared = np.einsum("ni,ni->n", error, np.linalg.solve(np.array(covariances), error[..., None])[..., 0])
    return Cloud(values, truth, covariances[0], float(np.mean(squared <= WITHIN_95)))
