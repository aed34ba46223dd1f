"""Corners that have moved, are gone or are new: those of walls that have."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from drivers import se2
from drivers.immutable import immutable
from features.corner_angle import MIN_SINE

from ...geometry.segments import Floats
from ...mapping.wall_cells import END_ERROR_CELLS, WALL_CELL
from ...measuring.wall_map import WallGeometry
from .changes import Change, ChangeKind, MapDiff

# Metres by which a corner may be beyond the stretch that is gone or new. Origin: chosen, the margin at the ends of a
# wall that is never seen through, and a cell.
END_MARGIN = (END_ERROR_CELLS + 1) * WALL_CELL


@immutable
class CornerChange:
    """A change of a corner.

    kind      MOVED, GONE or NEW
    identity  of the corner, in the new map if it is new, else in the old one
    position  (2,) in the old map's frame, metres
    shift     (2,) by which a moved corner is displaced, metres; else NaN
    """

    kind: ChangeKind
    identity: int
    position: Floats
    shift: Floats


def corner_changes(diff: MapDiff, old: WallGeometry, new: WallGeometry) -> list[CornerChange]:
    """Return the changes of corners that follow from those of the walls."""
    return [*_of_old_map(diff, old), *_on_stretches(diff, new, ChangeKind.NEW, diff.motion)]


def _of_old_map(diff: MapDiff, old: WallGeometry) -> Iterator[CornerChange]:
    gone = list(_on_stretches(diff, old, ChangeKind.GONE, np.zeros(3)))
    yield from gone
    done = {change.identity for change in gone}
    moved = {change.old: change for change in diff.changes if change.kind is ChangeKind.MOVED}
    corners = old.corners
    for identity, walls, position in zip(
        corners.identity.tolist(), corners.walls.tolist(), corners.position, strict=True
    ):
        if identity not in done and not moved.keys().isdisjoint(walls) and min(walls) >= 0:
            shift = _displacement(old, walls, [moved.get(wall) for wall in walls])
            if shift is not None:
                yield CornerChange(ChangeKind.MOVED, identity, position, shift)


def _displacement(old: WallGeometry, walls: Sequence[int], moves: Sequence[Change | None]) -> Floats | None:
    """Return the displacement (2,) of the intersection of two walls, each of which may have moved; None if parallel."""
    if not set(walls) <= set(old.walls.identity.tolist()):
        return None
    normals = np.array([old.normal(old.row(wall)) for wall in walls])
    if abs(np.linalg.det(normals)) <= MIN_SINE:
        return None
    return np.linalg.solve(normals, np.array([0.0 if move is None else move.shift for move in moves]))


def _on_stretches(diff: MapDiff, wall_map: WallGeometry, kind: ChangeKind, motion: se2.Pose) -> Iterator[CornerChange]:
    """Yield the corners of a map on stretches that are gone or new; `motion` leads from its frame to the old map's."""
    corners = wall_map.corners
    places = se2.transform(motion, corners.position).reshape(-1, 2)
    for identity, walls, position in zip(corners.identity.tolist(), corners.walls.tolist(), places, strict=True):
        for change in diff.changes:
            wall = change.new if kind is ChangeKind.NEW else change.old
            if change.kind is kind and wall in walls and _near(position, change.stretches):
                yield CornerChange(kind, identity, position, np.full(2, np.nan))
                break


def _near(position: Floats, stretches: Floats) -> bool:
    """Return True if a point is on one of some stretches (k, 2, 2), or at most END_MARGIN beyond."""
    along = stretches[:, 1] - stretches[:, 0]
    length = np.hypot(along[:, 0], along[:, 1])
    reached = np.einsum("ki,ki->k", position - stretches[:, 0], along) / np.maximum(length, np.finfo(float).tiny)
    return bool(((reached > -END_MARGIN) & (reached < length + END_MARGIN)).any())
