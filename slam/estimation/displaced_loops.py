"""Close loops at the end of a drive where scans fit the map of the other scans better elsewhere.

Looks search old places along the drive. They miss a loop if the drive ends near its beginning and not at it, if it is
shorter than looks are apart, or if the estimate is more certain than it should be. A scan that fits the map of the
other scans better at another pose is displaced. Several in a row propose a loop between their keyframes and those that
have observed the same surfaces. It is closed on a copy, and stays closed if all scans of the drive together are more
likely in the corrected map.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.immutable import immutable
from features.normal_limits import NORMAL_LIMIT

from ..checks.adapter import drive_of
from ..checks.displaced_scans import Refits, displaced_groups, map_gain, refit_scans
from ..checks.drive import Drive
from ..checks.step_checks import MIN_DISPLACEMENT, displacement
from ..checks.steps import FIELD_SCANS, MAX_SEARCH
from ..errors import MapError
from ..geometry.pose_covariance import position_sigma
from ..geometry.segments import Floats, Integers
from ..loop_closure.criteria import fits, is_determined
from ..loop_closure.decision import Check, LoopDecision, LoopMatch
from ..loop_closure.loop_hypothesis import OldPlace
from ..loop_closure.loop_status import LoopStatus
from ..loop_closure.submap_search import SUBMAP_LENGTH, Submap, SubmapMatch, improve
from ..loop_closure.submaps import submap_of
from ..mapping.mapper import Mapper
from ..matching.distance_field import FIELD_HALF_WIDTH
from ..matching.point_matcher import point_cost
from .journal import Journal
from .loop_update import close_loop
from .slam_state import SlamState

REASON = "the scans of the whole drive fit the corrected map better"
"""Reason of the closures."""


def close_displaced_loops(state: SlamState, journal: Journal) -> Iterator[tuple[SlamState, LoopDecision]]:
    """Close the loops of a finished drive that its displaced scans propose, the clearest one first.

    Yields the state after each closure, which replaces the one before, and the decision. `state` is unchanged.
    """
    tried = set[float]()
    while (closed := _close_next(state, journal, tried)) is not None:
        yield closed
        state = closed[0]


def _close_next(state: SlamState, journal: Journal, tried: set[float]) -> tuple[SlamState, LoopDecision] | None:
    """Close the clearest loop that corrects the map; None if there is none.

    tried  stamps of the displaced scans that were examined so far; those of this search are added
    """
    drive = _sampled_drive(state, journal)
    if len(drive) < 2:
        return None
    found = refit_scans(drive)
    groups = sorted(displaced_groups(found), key=lambda rows: -found.gain[rows].max())
    if groups and not state.mapper.is_solved:
        state = state.copy()
        state.mapper.solve_waiting()
    for group in groups:
        displaced = _DisplacedKeyframes.of(state, drive, found, group)
        if displaced.stamp in tried:
            continue
        tried.add(displaced.stamp)
        try:
            loop = displaced.find_loop()
            closed = None if loop is None else _close(state, drive, loop, found.threshold)
        except MapError:  # the graph cannot be solved with this loop: the map stays as it is
            continue
        if closed is not None:
            return closed
    return None


def _close(
    state: SlamState, drive: Drive, loop: LoopDecision, required: float
) -> tuple[SlamState, LoopDecision] | None:
    """Close a loop on a copy of the state; None if the scans stay displaced, or if the gain of the map is too small.

    required  logarithm of how much more likely the scans must be in the corrected map

    Scans stay displaced if other factors, which may be wrong, hold the keyframes where they are.
    """
    closed = state.copy()
    decision = close_loop(closed, None, closed.loops.number(loop))
    if decision.status is not LoopStatus.ACCEPTED or _is_displaced(closed, loop.matches[0]):
        return None
    stamps, poses = closed.trajectory.at_scans(closed.mapper.keyframe_poses)
    gain = map_gain(drive, replace(drive, poses=poses[np.searchsorted(stamps, drive.stamps)]))
    check = Check("gain", gain, required, at_least=True)
    return (closed, replace(decision, checks=(check,))) if check.passed else None


def _is_displaced(state: SlamState, match: LoopMatch) -> bool:
    """Return True if the points of a match's keyframe are displaced relative to the pose of the match."""
    poses = state.mapper.keyframe_poses
    points = state.local_field.points(match.keyframe)[:, :2]
    placed = se2.between(poses[match.old], poses[match.keyframe])
    return displacement(points, placed, match.relative) > MIN_DISPLACEMENT


def _sampled_drive(state: SlamState, journal: Journal) -> Drive:
    """Return the scans that are compared, where they are placed now."""
    placed = state.trajectory.at_scans(state.mapper.keyframe_poses)
    start = journal.scans[0].stamp if len(journal.scans) else 0.0
    return drive_of(journal.scans, journal.segments, placed, state.odometry_model, start).sampled()


def are_apart(stamps: Floats, compared: Floats, group: Integers) -> NDArray[np.bool_]:
    """Return (k,) which keyframes, at `stamps` (k,), are more than FIELD_SCANS scans before or after a group of scans.

    compared  (n,) stamps of the scans that are compared
    group     rows of these
    """
    apart: NDArray[np.bool_] = stamps < compared[max(0, group[0] - FIELD_SCANS)]
    after = group[-1] + FIELD_SCANS
    if after < len(compared):
        apart |= stamps > compared[after]
    return apart


@immutable
class _DisplacedKeyframes:
    """Keyframes of displaced scans in a row.

    state   that the loop is proposed for
    stamp   of the scan that fits better elsewhere by most, seconds
    own     (n,) the keyframes
    centre  the one that is nearest to that scan in time
    motion  (3,) in the map, from where that scan was placed to where it fits
    others  (m,) keyframes of the scans with which that scan was compared: some may have observed the same surfaces
    """

    state: SlamState
    stamp: float
    own: Integers
    centre: int
    motion: se2.Pose
    others: Integers

    @classmethod
    def of(cls, state: SlamState, drive: Drive, found: Refits, group: Integers) -> _DisplacedKeyframes:
        """Return the keyframes of a `group` of rows of a sampled drive; there is at least one."""
        stamps = np.array(state.keyframe_stamps)
        worst = int(group[np.argmax(found.gain[group])])
        centre = int(np.abs(stamps - drive.stamps[worst]).argmin())
        first, last = drive.stamps[group[[0, -1]]]
        own = np.union1d(np.flatnonzero((stamps >= first) & (stamps <= last)), [centre])
        others = are_apart(stamps, drive.stamps, group)
        others &= state.mapper.landmarks.parts.connected(np.arange(len(stamps)), centre)
        pose = drive.poses[worst]
        motion = se2.compose(se2.compose(pose, found.motion[worst]), se2.inverse(pose))
        return cls(state, float(drive.stamps[worst]), own, centre, motion, np.flatnonzero(others))

    @property
    def _mapper(self) -> Mapper:
        return self.state.mapper

    def find_loop(self) -> LoopDecision | None:
        """Return the decision to close the loop between these keyframes and others that show the same surfaces.

        None if their scans do not fit there or do not determine the pose, or if the pose is too uncertain.
        """
        submap = self._submap(self.own, self.centre)
        other = self._find_other(submap)
        if other is None:
            return None
        poses, travelled = self._mapper.keyframe_poses, np.asarray(self._mapper.travelled)
        around = self.others[np.abs(travelled[self.others] - travelled[other]) < SUBMAP_LENGTH]
        same_pass = (around > self.centre) == (other > self.centre)  # near along the drive, but not across `centre`
        place = self._submap(around[same_pass], other)
        start = se2.between(poses[other], se2.compose(self.motion, poses[self.centre]))
        match = improve(submap, place, start)
        loop = self._loop_match(other, match)
        if not (fits(match) and is_determined(match) and self._covers_uncertainty(loop)):
            return None
        shown = {self.centre: submap.points[:, :2], other: place.points[:, :2]}
        recent, old = (se2.transform(poses[k], shown[k]) for k in (loop.keyframe, loop.old))
        return self._decision(loop, (recent, old))

    def _find_other(self, submap: Submap) -> int | None:
        """Return the other keyframe of which most points fit the submap of these ones; None if no points do."""
        poses = self._mapper.keyframe_poses
        there = se2.compose(self.motion, poses[self.centre])
        near = self.others[np.hypot(*(poses[self.others, :2] - there[:2]).T) < FIELD_HALF_WIDTH]
        best, most = None, 0.0
        for keyframe in near.tolist():
            points = self.state.local_field.points(keyframe)
            _, fit, known = point_cost(submap.field, points, se2.between(there, poses[keyframe]))
            if fit * known > most:
                best, most = keyframe, fit * known
        return best

    def _covers_uncertainty(self, loop: LoopMatch) -> bool:
        """Return True if the search for a better pose has covered the uncertainty of the estimate.

        If not, a place that looks alike may have been found, and the right one is farther away.
        """
        covariance = self._mapper.covariances.relative(loop.old, loop.keyframe)
        sigmas = np.array([position_sigma(covariance), np.sqrt(covariance[2, 2])])
        return bool((NORMAL_LIMIT * sigmas < MAX_SEARCH[1:]).all())

    def _submap(self, keyframes: Integers, centre: int) -> Submap:
        """Return the submap of some keyframes (n,) in the frame of one of them."""
        poses = self._mapper.keyframe_poses
        place = OldPlace(keyframes, se2.between(poses[centre], poses[keyframes]).reshape(-1, 3))
        return submap_of(place, self.state.local_field)

    def _loop_match(self, other: int, match: SubmapMatch) -> LoopMatch:
        """Return the match of these keyframes with another one as that of the later keyframe with the earlier one."""
        old, keyframe, relative, covariance = other, self.centre, match.pose, match.covariance
        if old > keyframe:
            old, keyframe, relative = keyframe, old, se2.inverse(match.pose)
            adjoint = se2.adjoint(match.pose)
            covariance = adjoint @ covariance @ adjoint.T
        travelled = float(self._mapper.travelled[keyframe])
        return LoopMatch(keyframe, old, relative, covariance, travelled, match.fit, match.known)

    def _decision(self, loop: LoopMatch, compared: tuple[Floats, Floats]) -> LoopDecision:
        """Return the decision to close a loop; it has no number yet. For `compared` see `LoopDecision`."""
        before = self._mapper.keyframe_poses[loop.keyframe]
        moved = se2.compose(self._mapper.keyframe_poses[loop.old], loop.relative)
        begin = int(np.searchsorted(self._mapper.travelled, loop.travelled - SUBMAP_LENGTH))
        return LoopDecision(
            candidate=0,
            keyframe=loop.keyframe,
            old=loop.old,
            motion=se2.between(before, moved),
            correction=se2.compose(moved, se2.inverse(before)),
            status=LoopStatus.CONFIRMED,
            reason=REASON,
            matches=(loop,),
            runner_up=0.0,
            contradicted=0.0,
            checks=(),
            since=max(loop.old + 1, begin),
            compared=compared,
        )
