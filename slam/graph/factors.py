"""Factors of the graph as plain data that can be stored; `gtsam_factors` converts them into factors of GTSAM."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace
from enum import StrEnum

import numpy as np
from gtsam.symbol_shorthand import C, L, P, X
from numpy.typing import NDArray

from drivers.immutable import immutable

from ..geometry.segments import Floats, Integers

# Standard deviations at which the weight of a corner's observation is one half.
# Origin: chosen; not measured.
CAUCHY_SCALE = 4.0
# The same for each of the two factors of a wall's observation: together they are as strong as one of both.
# Origin: definition.
WALL_CAUCHY_SCALE = CAUCHY_SCALE / 2**0.5
# The same for motions that scans show. Origin: chosen, smaller because single scans can be matched wrongly; not
# measured.
MOTION_CAUCHY_SCALE = 2.0


class FactorKind(StrEnum):
    """Kinds of factors between a keyframe (or wall) `first` and a variable `second`, as written to session files.

    Their `measured` values, [x, y, heading] or [x, y], and covariances are:
    POSE_PRIOR     the pose of `first`, which defines the map's frame; (3, 3). No `second`
    ODOMETRY       the keyframe `second` in the frame of `first`; (3, 3)
    GAUGE_PRIOR    the wall's frame in the frame of `first`; (1, 1), of its position along the wall
    WALL_HEADING   the wall's frame in the frame of `first`; (1, 1), of its heading. Robust
    WALL_OFFSET    [x, y, heading, lever]: as before; (1, 1), of its offset across plus lever times heading. Robust
    WALL           a segment in the frame of `first`; (2, 2), of its offset across and heading. Not a factor of GTSAM:
                   an observation that waits until the wall `second` is confirmed
    CORNER         the corner's position in the frame of `first`; (2, 2). Robust
    PLAN_WALL      the wall's frame in the map, as a plan states it; (2, 2), as for WALL. `first` and `second` are the
                   wall. Robust
    PINNED_POSE    the pose of the keyframe `first` in the map, as surveyed; (3, 3). `first` and `second` are the
                   keyframe
    PINNED_WALL    as PLAN_WALL, but surveyed and not robust
    WALL_EQUALITY  the frame of the wall `second` in that of the wall `first`: they are one; (2, 2), as for WALL
    LOOP           the keyframe `second` in the frame of `first`, from a loop closure; (3, 3)
    POINT_MAP      the points of the keyframe `first` as a body in its frame: zero; (3, 3), the noise of its scan
    SCAN_MATCH     the keyframe `second` in the frame of the points of `first`, by matching its own points with them and
                   with those of other keyframes nearby; (3, 3). Robust
    SUBMAP_MATCH   the keyframe `second` in the frame of `first`, by matching the points around both on a return to a
                   known place; (3, 3). Robust
    """

    POSE_PRIOR = "pose_prior"
    ODOMETRY = "odometry"
    GAUGE_PRIOR = "gauge_prior"
    WALL_HEADING = "wall_heading"
    WALL_OFFSET = "wall_offset"
    WALL = "wall"
    CORNER = "corner"
    PLAN_WALL = "plan_wall"
    PINNED_POSE = "pinned_pose"
    PINNED_WALL = "pinned_wall"
    WALL_EQUALITY = "wall_equality"
    LOOP = "loop"
    POINT_MAP = "point_map"
    SCAN_MATCH = "scan_match"
    SUBMAP_MATCH = "submap_match"


# Standard deviations at which a factor's weight is one half; the other kinds have no robust kernel.
CAUCHY_SCALES = {
    FactorKind.SCAN_MATCH: MOTION_CAUCHY_SCALE,
    FactorKind.SUBMAP_MATCH: MOTION_CAUCHY_SCALE,
    FactorKind.WALL_HEADING: WALL_CAUCHY_SCALE,
    FactorKind.WALL_OFFSET: WALL_CAUCHY_SCALE,
    FactorKind.CORNER: CAUCHY_SCALE,
    FactorKind.PLAN_WALL: CAUCHY_SCALE,
}


# Bits of a key for the number of its variable; above them is its character. Origin: definition, of GTSAM.
KEY_INDEX_BITS = 56
# Kinds of the factors of a wall's observation. Origin: definition.
OBSERVATION_KINDS = (FactorKind.WALL_HEADING, FactorKind.WALL_OFFSET)
# Kinds that measure a wall's frame only in some directions.
WALL_KINDS = (
    *OBSERVATION_KINDS,
    FactorKind.GAUGE_PRIOR,
    FactorKind.WALL_EQUALITY,
    FactorKind.PLAN_WALL,
    FactorKind.PINNED_WALL,
)
# Kinds that measure a variable in the map. Origin: definition.
PRIOR_KINDS = (FactorKind.POSE_PRIOR, FactorKind.PLAN_WALL, FactorKind.PINNED_POSE, FactorKind.PINNED_WALL)
# Robust kinds by which keyframes are matched with those of earlier passes. Origin: definition.
MATCH_KINDS = (FactorKind.SCAN_MATCH, FactorKind.SUBMAP_MATCH)
# Kinds of factors with surveyed coordinates. Origin: definition.
PIN_KINDS = (FactorKind.PINNED_POSE, FactorKind.PINNED_WALL)
# Keys of the first and the second variable with number 0, from which the others follow. Origin: definition.
_FIRST_KEYS = {
    FactorKind.POSE_PRIOR: (X(0), X(0)),
    FactorKind.WALL_EQUALITY: (L(0), L(0)),
    FactorKind.PLAN_WALL: (L(0), L(0)),
    FactorKind.PINNED_POSE: (X(0), X(0)),
    FactorKind.PINNED_WALL: (L(0), L(0)),
    FactorKind.CORNER: (X(0), C(0)),
    FactorKind.POINT_MAP: (X(0), P(0)),
    FactorKind.SCAN_MATCH: (P(0), X(0)),
    FactorKind.ODOMETRY: (X(0), X(0)),
    FactorKind.LOOP: (X(0), X(0)),
    FactorKind.SUBMAP_MATCH: (X(0), X(0)),
}
# The same of other kinds of factors, which lead from a keyframe to a wall. Origin: definition.
_FIRST_KEYS_OF_OTHERS = (X(0), L(0))


@immutable
class Factor:
    """One factor; see FactorKind.

    bias_slope  change of the measurement per metre of range bias: (1,) of the heading or the offset, (2,) of a corner's
                position or of the offset and heading of kind WALL; (0,) of other kinds
    """

    kind: FactorKind
    first: int
    second: int
    measured: Floats
    covariance: Floats
    bias_slope: Floats = field(default_factory=lambda: np.zeros(0))


def walls_of(factor: Factor) -> tuple[int, ...]:
    """Return the walls that a factor contains."""
    if factor.kind in (FactorKind.WALL_EQUALITY, FactorKind.PLAN_WALL, FactorKind.PINNED_WALL):
        return factor.first, factor.second
    return (factor.second,) if factor.kind in (*WALL_KINDS, FactorKind.WALL) else ()


def keys_of(factor: Factor) -> tuple[int, int]:
    """Return the keys of the variables of a factor; twice the same if it has only one."""
    first, second = _FIRST_KEYS.get(factor.kind, _FIRST_KEYS_OF_OTHERS)
    return first + factor.first, second + factor.second


@immutable
class FactorsOfKind:
    """n factors of one kind as arrays.

    rows         (n,) of the factors among those of all kinds
    keys         (n, 2) of their variables
    measured     (n, d); see FactorKind
    covariances  (n, c, c)
    bias_slopes  (n, s); see `Factor`
    """

    kind: FactorKind
    rows: Integers
    keys: NDArray[np.uint64]
    measured: Floats
    covariances: Floats
    bias_slopes: Floats

    @property
    def numbers(self) -> Integers:
        """(n, 2) numbers `first` and `second` of their keyframes and landmarks."""
        return (self.keys & np.uint64((1 << KEY_INDEX_BITS) - 1)).astype(np.int64)

    def where(self, kept: NDArray[np.bool_]) -> FactorsOfKind:
        """Return those of the factors that are kept of all kinds (f,), with their rows among the kept ones."""
        own, numbers = kept[self.rows], np.cumsum(kept) - 1
        return FactorsOfKind(
            self.kind,
            numbers[self.rows[own]],
            self.keys[own],
            self.measured[own],
            self.covariances[own],
            self.bias_slopes[own],
        )

    def after(self, earlier: FactorsOfKind | None, first: int) -> FactorsOfKind:
        """Return the factors after earlier ones of the same kind; `first` is added to the rows of these ones."""
        later = replace(self, rows=first + self.rows)
        if earlier is None:
            return later
        names = ("rows", "keys", "measured", "covariances", "bias_slopes")
        parts = [np.concatenate([getattr(earlier, name), getattr(later, name)]) for name in names]
        return FactorsOfKind(self.kind, *parts)

    def bias_directions(self) -> Floats:
        """Return the change (n, d) of `measured` per metre of range bias; zero if it does not depend on it."""
        result, slopes = np.zeros_like(self.measured), self.bias_slopes
        match self.kind if slopes.shape[1] else None:
            case FactorKind.WALL_HEADING:
                result[:, 2] = slopes[:, 0]
            case FactorKind.WALL_OFFSET:
                heading = self.measured[:, 2]
                result[:, 0], result[:, 1] = -np.sin(heading) * slopes[:, 0], np.cos(heading) * slopes[:, 0]
            case FactorKind.CORNER:
                result[:] = slopes
        return result

    def without_range_bias(self, bias: float) -> Floats:
        """Return the measurements (n, d) as if all ranges were shorter by `bias` metres."""
        return self.measured - bias * self.bias_directions()

    def covariances_in_polar(self, bias: float) -> Floats:
        """Return the covariances (n, 2, 2) of bearing and range of corners, without a range bias (metres)."""
        x, y = self.without_range_bias(bias).T
        distance = np.hypot(x, y)
        to_polar = np.stack([-y / distance**2, x / distance**2, x / distance, y / distance], axis=-1).reshape(-1, 2, 2)
        return np.asarray(to_polar @ self.covariances @ to_polar.transpose(0, 2, 1))

    def roots_of_information(self) -> Floats:
        """Return R (n, 3, 3) with the information R' R of walls' factors on (along, across, heading)."""
        roots, inverse_sigmas = np.zeros((len(self.measured), 3, 3)), 1.0 / np.sqrt(self.covariances[:, 0, 0])
        match self.kind:
            case FactorKind.GAUGE_PRIOR:
                roots[:, 0, 0] = inverse_sigmas
            case FactorKind.WALL_HEADING:
                roots[:, 0, 2] = inverse_sigmas
            case FactorKind.WALL_OFFSET:
                roots[:, 0, 1], roots[:, 0, 2] = inverse_sigmas, self.measured[:, 3] * inverse_sigmas
            case _:
                roots[:, 1:, 1:] = np.linalg.cholesky(np.linalg.inv(self.covariances)).transpose(0, 2, 1)
        return roots


def by_kind(factors: Sequence[Factor]) -> list[FactorsOfKind]:
    """Return factors as arrays, by their kinds."""
    rows_of_kind: dict[FactorKind, list[int]] = {}
    for row, factor in enumerate(factors):
        rows_of_kind.setdefault(factor.kind, []).append(row)
    result = []
    for kind, rows in rows_of_kind.items():
        chosen = [factors[row] for row in rows]
        numbers = np.array([[f.first for f in chosen], [f.second for f in chosen]], dtype=np.uint64).T
        result.append(
            FactorsOfKind(
                kind,
                np.array(rows),
                numbers + np.array(_FIRST_KEYS.get(kind, _FIRST_KEYS_OF_OTHERS), dtype=np.uint64),
                _stacked([f.measured for f in chosen]),
                _stacked([f.covariance for f in chosen]),
                _stacked([f.bias_slope for f in chosen]),
            )
        )
    return result


def _stacked(arrays: Sequence[Floats]) -> Floats:
    """Return small arrays of one shape as one array, in a third of the time of `np.array`."""
    return np.concatenate(arrays).reshape(len(arrays), *arrays[0].shape)


@immutable
class GraphState:
    """Everything a graph consists of: enough to continue with exactly the same results.

    factors          all factors, in the order in which they were added
    keyframes        (k, 3) linearisation points of the poses, not the estimate
    walls            (w,) landmark ids
    frames           (w, 3) linearisation points of the walls' frames
    corners          (c,) landmark ids
    positions        (c, 2) linearisation points of the corners
    point_maps       (p,) keyframes whose points are a body of their own
    point_map_poses  (p, 3) linearisation points of these bodies
    updates          number of updates of the estimate: every RELINEARIZE_SKIP-th relinearises
    qr               True if factors are eliminated by QR because Cholesky has failed on this graph
    bias             estimate of the range bias, metres, without which the observations are in the graph
    waiting          number of factors, the last ones, with which the graph has not been solved yet
    """

    factors: list[Factor]
    keyframes: Floats
    walls: NDArray[np.int64]
    frames: Floats
    corners: NDArray[np.int64]
    positions: Floats
    point_maps: NDArray[np.int64]
    point_map_poses: Floats
    updates: int
    qr: bool
    bias: float
    waiting: int
