"""A listener that knows the truth: it holds every decision on a loop, and the map at the end, against it."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from drivers import se2
from drivers.simulation import Simulation

from ...events import (
    Event,
    Finished,
    KeyframeAdded,
    LoopDecided,
    MapUpdated,
    MapWalls,
    Relocalised,
    ScanTracked,
    WallsMerged,
)
from ..ground_truth import match_walls, true_walls
from ..metrics import align, motion_errors

SAME_PLACE = 1.0  # metres between two true poses that are at one place
AWAY = 20.0  # metres of driving between two visits to one place
LEAST_SHARED = 0.5  # metres of one true wall that two mapped ones must both show to be doubled
LEAST_SIGHTINGS = 3  # of a true wall by a mapped one


@dataclass(frozen=True, slots=True)
class Decided:
    """What became of one candidate, and how far its motion was off the true one (metres, radians)."""

    keyframe: int
    status: str
    reason: str
    error: float
    turn: float


@dataclass(frozen=True, slots=True)
class Visit:
    """A keyframe at a place where an earlier keyframe has been, and by how many metres it was off when it was added."""

    keyframe: int
    earlier: int
    error: float


class Witness:
    """A sink for one run of a simulation.

    decided    every decision on a loop
    visits     every keyframe at a place known before
    misplaced  metres, for each time that a robot that was lost was found: how far off that is, as seen from the nearest
               keyframe
    """

    def __init__(self, simulation: Simulation) -> None:
        self._trajectory, self._walls = simulation.trajectory, true_walls(simulation.world, np.zeros(3))
        self._tracked = np.zeros(3)  # where the robot was believed to be, before a closure could move it
        # Of the keyframes that were told of. A robot that was lost makes some that are not.
        self._estimate: dict[int, se2.Pose] = {}
        self._truth: dict[int, se2.Pose] = {}
        self._ways: dict[int, float] = {}
        self._kept: dict[int, int] = {}
        self._sightings: dict[int, dict[int, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
        self.decided: list[Decided] = []
        self.visits: list[Visit] = []
        self.misplaced: list[float] = []

    def handle(self, event: Event) -> None:
        """Take one event."""
        match event:
            case ScanTracked():
                self._tracked = event.pose
            case KeyframeAdded():
                self._add(event)
            case MapUpdated():
                self._estimate = dict(enumerate(event.keyframes))
            case WallsMerged():
                self._kept[event.absorbed] = event.kept
            case LoopDecided():
                self._judge(event)
            case Relocalised():
                self._look_up(event)

    def _add(self, event: KeyframeAdded) -> None:
        truth = self._trajectory.poses_at(np.array([event.stamp]))[0]
        before = max(self._truth, default=None)
        step = 0.0 if before is None else float(np.hypot(*(truth - self._truth[before])[:2]))
        way = step if before is None else self._ways[before] + step
        self._estimate[event.index], self._truth[event.index], self._ways[event.index] = event.pose, truth, way
        told = np.array(list(self._truth))
        gap = np.hypot(*(np.array(list(self._truth.values()))[:, :2] - truth[:2]).T)
        gap[np.array(list(self._ways.values())) > way - AWAY] = np.inf
        if gap.min() < SAME_PLACE:
            earlier = int(told[gap.argmin()])
            self.visits.append(Visit(event.index, earlier, self._motion_error(earlier, event.index, event.pose)[0]))
        self._see(event, truth)

    def _motion_error(self, old: int, keyframe: int, pose: se2.Pose) -> tuple[float, float]:
        """By how much (metres, radians) the motion from one keyframe to another at `pose` is off the true one."""
        old = max(told for told in self._truth if told <= old)
        estimated = se2.between(self._estimate[old], pose)
        true = se2.between(self._truth[old], self._truth[keyframe])
        errors = motion_errors(estimated[None], true[None])
        return float(errors.translation[0]), float(errors.rotation[0])

    def _judge(self, event: LoopDecided) -> None:
        for old, recent in event.merged:
            self._kept[recent] = old
        there = se2.compose(self._tracked, event.motion)
        error, turn = self._motion_error(event.old, event.index, there)
        self.decided.append(Decided(event.index, event.status, event.reason, error, turn))

    def _look_up(self, event: Relocalised) -> None:
        told = list(self._truth)
        nearest = told[int(np.hypot(*(np.array([self._estimate[k] for k in told]) - event.pose)[:, :2].T).argmin())]
        estimated = se2.between(self._estimate[nearest], event.pose)
        true = se2.between(self._truth[nearest], self._trajectory.poses_at(np.array([event.stamp]))[0])
        self.misplaced.append(float(motion_errors(estimated[None], true[None]).translation[0]))

    @property
    def drift(self) -> float:
        """Metres by which the robot was off at most, relative to its earlier visit, when it came back to a place."""
        return max((visit.error for visit in self.visits), default=0.0)

    # --- the map at the end

    def joined(self, finished: Finished, within: float) -> float:
        """Share of the visits after which the final map has the two keyframes within some metres of the truth."""
        self._estimate = dict(enumerate(finished.keyframes))
        errors = [self._motion_error(v.earlier, v.keyframe, self._estimate[v.keyframe])[0] for v in self.visits]
        return float(np.mean(np.array(errors) < within)) if errors else 1.0

    def last_error(self, finished: Finished) -> float:
        """Metres by which the last keyframe is off, as seen from the first."""
        truth = self._trajectory.poses_at(finished.keyframe_stamps[[0, -1]])
        ends = np.array([se2.between(poses[0], poses[-1]) for poses in (finished.keyframes, truth)])
        return float(motion_errors(ends[:1], ends[1:]).translation[0])

    def ate(self, finished: Finished) -> float:
        """Metres, root mean square of the keyframes' positions after alignment with the truth."""
        estimate, truth = finished.keyframes[:, :2], self._trajectory.poses_at(finished.keyframe_stamps)[:, :2]
        left = se2.transform(align(estimate, onto=truth), estimate) - truth
        return float(np.sqrt(np.mean(np.sum(left**2, axis=1))))

    def _see(self, event: KeyframeAdded, truth: se2.Pose) -> None:
        """Note which true walls, and where along them, the walls seen by a keyframe show."""
        half, none = event.segments.half_length, np.zeros((len(event.segments), 2, 2))
        frames = se2.compose(truth, event.segments.frame).reshape(-1, 3)
        pieces = tuple(np.column_stack([-half, half])[:, None])
        seen = MapWalls(event.line_match, frames, -half, half, np.ones(len(half), dtype=np.int64), none, pieces)
        ends = seen.end_points()
        for row, true in enumerate(match_walls(seen, self._walls)):
            if true >= 0 and event.line_match[row] >= 0:
                low, high = sorted(se2.transform(se2.inverse(self._walls.frame[true]), ends[row])[:, 0].tolist())
                self._sightings[int(event.line_match[row])][int(true)].append((low, high))

    def doubled(self, lines: MapWalls) -> int:
        """How many walls of the final map show a part of a true wall that another one shows as well."""
        shown: dict[int, dict[int, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
        there = set(lines.identity.tolist())
        for identity, by_true in self._sightings.items():
            while identity in self._kept:
                identity = self._kept[identity]
            for true, spans in by_true.items():
                shown[true][identity] += spans
        return sum(
            _overlaps([_hull(spans) for wall, spans in walls.items() if wall in there]) for walls in shown.values()
        )


def _hull(spans: list[tuple[float, float]]) -> tuple[float, float]:
    """From where to where along a true wall a mapped one was seen; nothing where that was but once or twice."""
    if len(spans) < LEAST_SIGHTINGS:
        return 0.0, 0.0
    return min(low for low, _ in spans), max(high for _, high in spans)


def _overlaps(spans: list[tuple[float, float]]) -> int:
    """How many spans share a part with an earlier one."""
    count, reached = 0, -np.inf
    for low, high in sorted(spans):
        count += min(high, reached) - low > LEAST_SHARED
        reached = max(reached, high)
    return count
