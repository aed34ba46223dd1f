"""Synthetic events of a robot in a corridor, and helpers to read logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rerun.chunk import RrdReader

from drivers import se2
from slam.events import Finished, GroundTruthReceived, KeyframeAdded, MapUpdated, Notice, ScanTracked, WallsMerged
from slam.geometry.segments import CornerPoints, Segments
from slam.mapping.map_features import Keyframes, MapCorners, MapWalls
from slam.visualisation.rerun_log import ReviewLog

# A corridor around a block, 24 m by 16 m outside; walls are seen from inside the corridor.
OUTER = np.array([[0.0, 0.0], [24.0, 0.0], [24.0, 16.0], [0.0, 16.0]])
INNER = np.array([[3.0, 3.0], [3.0, 13.0], [21.0, 13.0], [21.0, 3.0]])
ROUTE = np.array([[1.5, 1.5], [22.5, 1.5], [22.5, 14.5], [1.5, 14.5], [1.5, 1.5]])
PIECE = 3.0  # metres; length of walls between doors
EMPTY_SEGMENTS = Segments(np.empty((0, 3)), np.empty(0), np.empty((0, 2, 2)))


def make_corners(position: np.ndarray) -> CornerPoints:
    n = len(position)
    return CornerPoints(
        position=position,
        covariance=np.tile(1e-4 * np.eye(2), (n, 1, 1)),
        segments=np.zeros((n, 2), dtype=np.int64),
        headings=np.zeros((n, 2)),
    )


def bare_keyframe(index: int) -> KeyframeAdded:
    """Return the event of a keyframe at the origin that sees nothing."""
    nothing, unmatched = np.empty(0), np.empty(0, dtype=np.int64)
    return KeyframeAdded(
        index=index, stamp=float(index), pose=np.zeros(3), pose_covariance=np.full((3, 3), np.nan),
        odometry=np.zeros(3), points=np.empty((0, 2)), segments=EMPTY_SEGMENTS, corners=make_corners(np.empty((0, 2))),
        wall_match=unmatched, wall_gate=nothing, wall_nearest=unmatched, corner_match=unmatched, corner_gate=nothing,
        corner_nearest=unmatched, new_walls=unmatched,
        sigma_range=0.01, timings={}, counts={},
    )  # fmt: skip


def corridor_walls() -> np.ndarray:
    """Return walls (n, 4): x, y, heading of the middle, and half length."""
    walls = []
    for polygon in (OUTER, INNER):
        for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            length = np.hypot(*(end - start))
            heading = np.arctan2(*(end - start)[::-1])
            for middle in np.arange(PIECE / 2, length, PIECE):
                share = middle / length
                walls.append([*(start + share * (end - start)), heading, 0.45 * PIECE])
    return np.array(walls)


def drive_poses(step: float, laps: int = 1) -> np.ndarray:
    """Return true poses (k, 3) along the corridor, with turns on the spot at its corners."""
    poses = []
    for start, end in zip(np.tile(ROUTE[:-1], (laps, 1)), np.tile(ROUTE[1:], (laps, 1)), strict=True):
        heading = np.arctan2(*(end - start)[::-1])
        for along in np.arange(0.0, np.hypot(*(end - start)), step):
            poses.append([*(start + along * np.array([np.cos(heading), np.sin(heading)])), heading])
    return np.array(poses)


class Corridor:
    """Events of a robot that drives around a corridor, with a small estimation error and drifting odometry."""

    def __init__(self, step: float = 0.5, laps: int = 1, start: float = 0.0, beams: int = 180, maps_every: int = 5):
        self.rng = np.random.default_rng(5)
        self.walls = corridor_walls()
        self.truth = drive_poses(step, laps)
        self.start, self.beams, self.maps_every = start, beams, maps_every
        self.world_from_map = self.truth[0]
        self.wall_frames = se2.compose(se2.inverse(self.truth[0]), self.walls[:, :3])
        self.wall_frames[:, 1] += self.rng.normal(0, 0.02, len(self.walls))
        self.seen = np.zeros(len(self.walls), dtype=np.int64)

    def events(self):
        estimates, odometry, drifted = [], np.zeros(3), np.zeros(3)
        for index, truth in enumerate(self.truth):
            stamp = self.start + 0.5 * index
            estimate = se2.between(self.truth[0], truth) + self.rng.normal(0, [0.01, 0.01, 0.002]) * (index > 0)
            motion = se2.between(self.truth[index - 1], truth) if index else np.zeros(3)
            drifted = se2.compose(drifted, motion + np.array([0.0, 0.0, 0.004]))
            odometry = se2.compose(np.array([7.0, -3.0, 1.0]), drifted)
            for part in (0.0, 0.5):
                yield GroundTruthReceived(stamp + part / 2, se2.compose(truth, [0.25 * part, 0, 0]))
                yield ScanTracked(stamp + part / 2, se2.compose(estimate, [0.25 * part, 0, 0]), odometry, 0.9, index)
            estimates.append(estimate)
            yield self.keyframe(index, stamp, truth, estimate, odometry)
            if index == 12:
                yield Notice(stamp, "no odometry for 1.2 s")
            if index == 20:
                yield WallsMerged(index, stamp, 3, 4, 2.25)
            if index % self.maps_every == 0:
                path = np.array(estimates)
                yield MapUpdated(index, stamp, path, self.lines(), self.corners(), 3.0 * index, 0.3 * (index == 40))
        path, stamps = np.array(estimates), self.start + 0.5 * np.arange(len(estimates))
        summary: dict[str, object] = {"keyframes": len(estimates), "times": {"median": 1.25, "of": "a|b"}}
        keyframes = Keyframes.without_covariance(stamps, path)
        yield Finished(self.lines(True), self.corners(), keyframes, stamps, path, summary)

    def keyframe(self, index, stamp, truth, estimate, odometry):
        local = se2.compose(se2.inverse(truth), self.walls[:, :3])
        near = np.flatnonzero((np.hypot(local[:, 0], local[:, 1]) < 8.0) & (se2.inverse(local)[:, 1] > 0.2))
        new, once = near[self.seen[near] == 0], near[self.seen[near] == 1]
        self.seen[near] += 1
        match = near.copy()
        match[::7] = -1
        gate = np.where((match < 0) | np.isin(near, new), np.nan, self.rng.chisquare(2, len(near)))
        if index > 10:
            gate[match < 0] = 20.5
        frame = local[near] + self.rng.normal(0, [0.01, 0.01, 0.004], (len(near), 3))
        segments = Segments(frame, self.walls[near, 3] * 0.8, np.tile(np.diag([1e-4, 1e-5]), (len(near), 1, 1)))
        corner = se2.transform(se2.inverse(truth), OUTER)
        seen = np.flatnonzero(np.hypot(*corner.T) < 8.0)
        corners = make_corners(corner[seen] + 0.02)
        spread = 0.01 + 2e-4 * index
        return KeyframeAdded(
            index=index, stamp=stamp, pose=estimate, pose_covariance=np.diag([spread, spread / 2, 0.01]) ** 2,
            odometry=odometry, points=self.scan(local[near], near), segments=segments, corners=corners,
            wall_match=match, wall_gate=gate, wall_nearest=np.where(np.isnan(gate), -1, near),
            corner_match=seen, corner_gate=np.full(len(seen), 1.5), corner_nearest=seen, new_walls=new,
            sigma_range=0.011,
            timings={"features": 1.0 + 0.2 * len(once), "registration": 2.0, "graph": 3.0 + 0.01 * index}
            | ({"closing": 6.0 + index / 20} if index in (20, 40) else {}),
            counts={"walls": int((self.seen > 0).sum()), "corners": len(seen), "keyframes": index + 1},
        )  # fmt: skip

    def scan(self, frames, near):
        pick = self.rng.integers(0, len(near), self.beams)
        along = self.rng.uniform(-1, 1, self.beams) * self.walls[near[pick], 3]
        return se2.transform(frames[pick], np.column_stack([along, self.rng.normal(0, 0.01, self.beams)]))

    def lines(self, final=False):
        known = np.flatnonzero(self.seen)
        half = self.walls[known, 3]
        covariance = np.diag([4e-4, 1e-6]) if final else np.full((2, 2), np.nan)
        covariances = np.tile(covariance, (len(known), 1, 1))
        pieces = tuple(np.column_stack([-half, half])[:, None])
        return MapWalls(known, self.wall_frames[known], -half, half, self.seen[known], covariances, pieces)

    def corners(self):
        position = se2.transform(se2.inverse(self.truth[0]), OUTER)
        covariance = np.tile(np.array([[0.04, 0.015], [0.015, 0.01]]), (4, 1, 1))
        return MapCorners(np.arange(4), position, covariance, np.array([[0, 1]] * 4), np.full(4, 6))


def rows(path: Path, entity: str, component: str) -> list:
    """Return the logged values of a component as (keyframe, value), sorted by keyframe; None for static rows.

    Rows that the steps of other timelines repeat are left out.
    """
    found = []
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if chunk.entity_path != entity or component not in batch.schema.names:
            continue
        if not chunk.is_static and "sensor_time" not in batch.schema.names:
            continue
        stamped = "keyframe" in batch.schema.names
        keyframes = batch.column("keyframe").to_pylist() if stamped else [None] * batch.num_rows
        found += zip(keyframes, batch.column(component).to_pylist(), strict=True)
    return sorted(found, key=lambda row: (row[0] is not None, row[0]))


def last(path: Path, entity: str, component: str):
    """Return the value at the end of the run."""
    return rows(path, entity, component)[-1][1]


def of_kind(events, kind):
    return [event for event in events if isinstance(event, kind)]


def log_events(path: Path, events) -> ReviewLog:
    with ReviewLog(path) as review:
        for event in events:
            review.handle(event)
    return review


def keyframes_in(path: Path) -> set[int]:
    """Return the keyframes whose pose is in a log."""
    return {k for k, _ in rows(path, "/world/keyframe", "Transform3D:translation")}
