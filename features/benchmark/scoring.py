"""Comparison of extracted lines and corners with the true walls of simulated scans.

Walls and lines count if they have at least ten rays and 0.3 m. A line is matched to a wall if they share half of the
union of their rays. A true corner is where two such walls follow each other and meet; it is found if a corner lies
within 0.1 m plus three standard deviations of range.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..types import Features, Flags, Floats, Integers
from .rooms import NOTHING, RoomScan

# Minimum number of rays of a wall or line that counts.
MIN_RAYS = 10
# Metres; its minimum length.
MIN_LENGTH = 0.3
# Minimum share of common rays of a wall and its line.
MIN_OVERLAP = 0.5
# Metres, and standard deviations of range that are added: maximum distance of a corner from the true one.
CORNER_DISTANCE = 0.10
CORNER_DISTANCE_SIGMAS = 3.0
# Metres within which two ends of walls are the same vertex.
SAME_VERTEX = 1e-9


@dataclass(slots=True)
class Score:
    """Counts of true, found, extracted and correct walls, lines and corners, and errors of the found ones.

    walls, walls_found            true walls that count, and those matched to a line
    lines, lines_right            extracted lines that count, and those matched to a wall
    corners, corners_found        true corners, and those near an extracted one
    corners_given, corners_right  extracted corners, and those near a vertex of the room
    curves                        arcs with enough rays to count
    curved_lines                  lines with most of their rays on an arc
    curved_corners                corners of such lines that are not vertices of the room
    line_nees, corner_nees        squared errors in units of their covariance, of two dimensions
    corner_errors                 metres
    """

    walls: int = 0
    walls_found: int = 0
    lines: int = 0
    lines_right: int = 0
    corners: int = 0
    corners_found: int = 0
    corners_given: int = 0
    corners_right: int = 0
    curves: int = 0
    curved_lines: int = 0
    curved_corners: int = 0
    line_nees: list[float] = field(default_factory=list)
    corner_nees: list[float] = field(default_factory=list)
    corner_errors: list[float] = field(default_factory=list)

    @property
    def precision(self) -> float:
        """Share of the extracted lines that are walls."""
        return _share(self.lines_right, self.lines)

    @property
    def recall(self) -> float:
        """Share of the true walls that were found."""
        return _share(self.walls_found, self.walls)

    @property
    def corner_recall(self) -> float:
        """Share of the true corners that were found."""
        return _share(self.corners_found, self.corners)

    @property
    def corner_precision(self) -> float:
        """Share of the extracted corners that are vertices of the room."""
        return _share(self.corners_right, self.corners_given)

    def add(self, scan: RoomScan, features: Features, sigma_range: float) -> None:
        """Add the comparison of one scan."""
        lines, beams = features.lines, len(scan.ranges)
        runs = true_runs(scan)
        wall_rays = np.zeros((len(runs), beams), dtype=bool)
        for mask, (_, rays) in zip(wall_rays, runs, strict=True):
            mask[rays] = True
        line_rays = np.zeros((len(lines), beams), dtype=bool)
        for mask, first, last in zip(line_rays, lines.first, lines.last, strict=True):
            mask[np.arange(first, last + 1 + (beams if last < first else 0)) % beams] = True
        shared = wall_rays.astype(np.int64) @ line_rays.T.astype(np.int64)
        either = wall_rays.sum(axis=1)[:, None] + line_rays.sum(axis=1)[None, :] - shared
        straight = np.array([surface < len(scan.walls) for surface, _ in runs], dtype=bool)
        seen_well = np.array([_counts(scan, rays) for _, rays in runs], dtype=bool)
        is_wall = (shared >= MIN_OVERLAP * either) & straight[:, None]
        self._add_lines(scan, features, runs, straight & seen_well, is_wall)
        on_arc = (line_rays & (scan.surface >= len(scan.walls))).sum(axis=1) > MIN_OVERLAP * line_rays.sum(axis=1)
        self.curves += int((seen_well & ~straight).sum())
        self.curved_lines += int(on_arc.sum())
        self._add_corners(
            scan, features, runs, straight & seen_well, on_arc, CORNER_DISTANCE + CORNER_DISTANCE_SIGMAS * sigma_range
        )

    def _add_lines(
        self,
        scan: RoomScan,
        features: Features,
        runs: list[tuple[int, Integers]],
        counted: Flags,
        is_wall: Flags,
    ) -> None:
        lines = features.lines
        large = (lines.count >= MIN_RAYS) & (np.hypot(*(lines.end - lines.start).T) >= MIN_LENGTH)
        self.walls += int(counted.sum())
        self.walls_found += int(is_wall[counted].any(axis=1).sum())
        self.lines += int(large.sum())
        self.lines_right += int(is_wall[:, large].any(axis=0).sum())
        for run, line in np.argwhere(is_wall & counted[:, None]):
            error = lines.uv[line] - _uv(scan.walls[runs[run][0]])
            self.line_nees.append(float(error @ np.linalg.solve(lines.covariance[line], error)))

    def _add_corners(
        self,
        scan: RoomScan,
        features: Features,
        runs: list[tuple[int, Integers]],
        counted: Flags,
        on_arc: Flags,
        reach: float,
    ) -> None:
        corners = features.corners
        known = true_corners(scan, runs, counted)
        self.corners += len(known)
        self.corners_given += len(corners)
        vertices = scan.walls.reshape(-1, 2)
        real = np.linalg.norm(corners.position[:, None] - vertices, axis=2).min(axis=1, initial=np.inf) < reach
        self.corners_right += int(real.sum())
        self.curved_corners += int((on_arc[corners.lines].any(axis=1) & ~real).sum())
        for true in known:
            distances = np.linalg.norm(corners.position - true, axis=1)
            if distances.min(initial=np.inf) < reach:
                nearest = int(distances.argmin())
                error = corners.position[nearest] - true
                self.corners_found += 1
                self.corner_errors.append(float(distances[nearest]))
                self.corner_nees.append(float(error @ np.linalg.solve(corners.covariance[nearest], error)))


def true_runs(scan: RoomScan) -> list[tuple[int, Integers]]:
    """Return (surface, its rays in order) of every uninterrupted view; spurious and lost rays do not interrupt one."""
    rays = np.flatnonzero(scan.surface != NOTHING)
    starts = np.flatnonzero(scan.surface[rays] != np.roll(scan.surface[rays], 1))
    if len(starts) == 0:
        return [(int(scan.surface[rays[0]]), rays)]
    rays = np.roll(rays, -starts[0])
    parts = np.split(rays, np.flatnonzero(np.diff(scan.surface[rays]) != 0) + 1)
    return [(int(scan.surface[part[0]]), part) for part in parts]


def true_corners(scan: RoomScan, runs: list[tuple[int, Integers]], counted: Flags) -> Floats:
    """Return the vertices (k, 2) at which two walls that count follow each other."""
    found = []
    for k, (surface, _) in enumerate(runs):
        following = (k + 1) % len(runs)
        after = runs[following][0]
        if counted[k] and counted[following] and surface != after:
            ends, others = scan.walls[surface].reshape(2, 2), scan.walls[after].reshape(2, 2)
            found += [p for p in ends for q in others if np.abs(p - q).max() < SAME_VERTEX]
    return np.array(found).reshape(-1, 2)


def _counts(scan: RoomScan, rays: Integers) -> bool:
    ends = scan.true_ranges[rays[[0, -1]]] * np.exp(1j * scan.angles[rays[[0, -1]]])
    return bool(len(rays) >= MIN_RAYS and abs(ends[1] - ends[0]) >= MIN_LENGTH)


def _uv(wall: Floats) -> Floats:
    x0, y0, x1, y1 = wall
    return np.asarray(np.array([y1 - y0, x0 - x1]) / (x0 * y1 - x1 * y0))


def _share(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")
