"""Loop closure by evidence: the drive through a known place must fit there, as a whole, better than elsewhere.

Looks at old places find loops, and agree on most of them (see `loop_closure.agreement`). A look compares shares of
points, so a bare corridor fits along all of its length, and where places look alike several of them fit. Therefore the
drive since the first look that supports a loop is searched as a whole where it may be by the uncertainty of the
estimate, and the evidence of all its submaps decides; see `location`.

- A loop that looks agree on is closed if the evidence suffices for its place.
- Where looks support several places, the evidence decides alone. A place that looks alike may be mapped while the true
  one is not. As the robot may be off by the search radius, the drive must extend as far before it is searched: then a
  part of the true place is mapped as well, and is compared. The same is expected of the share that is mapped as of a
  robot that is LOST.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats
from ..localisation.local_field import LocalField
from ..loop_closure.agreement import LoopAgreement
from ..loop_closure.criteria import differ
from ..loop_closure.decision import LoopDecision, LoopMatch
from ..loop_closure.look import MAX_SQUARED_DISTANCE, SUBMAP_HALF_WIDTH, SUBMAP_LENGTH, Look, Submaps
from ..loop_closure.loop_status import LoopStatus
from ..mapping.mapper import Mapper
from .decision import decide, scan_keyframes
from .drive_scans import DriveScans
from .location import LOST, RECOGNISED, Expectation, Location, PlacedSubmap, locate
from .placements import Uncertainty


class LoopEvidence:
    """Searches for the drive through a known place."""

    def __init__(self) -> None:
        self._drive = DriveScans()

    def __deepcopy__(self, memo: dict[int, object]) -> LoopEvidence:
        """Return an independent copy."""
        other = LoopEvidence()
        other._drive = copy.deepcopy(self._drive)
        return other

    def clear(self) -> None:
        """Discard all submaps: the map has been corrected."""
        self._drive.clear()

    def test(
        self, mapper: Mapper, local_field: LocalField, decision: LoopDecision, among: NDArray[np.bool_]
    ) -> LoopDecision:
        """Return a loop that looks agree on, rejected if the evidence does not suffice for its place.

        among  (k,) keyframes of the connected part of the map
        """
        drive = _RecentDrive(mapper, local_field, decision.matches, among)
        location = drive.locate(self._drive, RECOGNISED)
        if location.accepted and not differ(drive.look, location.members[-1].motion, decision.correction):
            return decision
        reason = f"the drive as a whole does not fit there: {location.reason}"
        return replace(decision, status=LoopStatus.REJECTED, reason=reason)

    def search(
        self, mapper: Mapper, local_field: LocalField, loops: LoopAgreement, among: NDArray[np.bool_]
    ) -> LoopDecision | None:
        """Return the decision to close a loop that the last look supports, if the evidence of the drive suffices.

        loops  hypotheses of the looks
        among  as in `test`
        """
        hypothesis = loops.undecided
        if hypothesis is None:
            return None
        drive = _RecentDrive(mapper, local_field, hypothesis.support, among)
        if drive.extent < drive.search_radius or not drive.old.any() or not self._drive.is_due(mapper, drive.first):
            return None
        location = drive.locate(self._drive, LOST)
        if not location.accepted or _agrees(mapper, location.members[-1]):
            return None
        if loops.is_excluded(drive.look, location.members[-1].motion):
            return None
        since = min(drive.first, drive.look.keyframe_at(loops.doubted_since(hypothesis)))
        return decide(drive.look, mapper, location, np.flatnonzero(drive.old), since=since, joins=False)


class _RecentDrive:
    """Drive since the first of some matches with old places.

    look           from the last keyframe
    first          first keyframe
    extent         largest distance (metres) of its keyframes from the first one
    search_radius  metres by which the last position may be wrong
    old            (k,) keyframes of earlier passes that it may be near
    """

    def __init__(
        self, mapper: Mapper, local_field: LocalField, matches: Sequence[LoopMatch], among: NDArray[np.bool_]
    ) -> None:
        self._mapper, self._local_field = mapper, local_field
        self.look = Look(mapper, local_field, Submaps(), among)
        self.first = self.look.keyframe_at(matches[0].travelled - SUBMAP_LENGTH)
        self._covariance = self.look.covariance(matches[-1].old)
        self.search_radius = self.look.search_radius(matches[-1].old)
        poses, travelled = mapper.keyframe_poses, np.asarray(mapper.travelled)
        self.extent = float(_distances(poses[self.first :], poses[self.first]).max())
        self.old = among & (travelled < travelled[self.first] - SUBMAP_LENGTH)
        self.old &= _distances(poses, self.look.pose) < self.extent + self.search_radius + SUBMAP_HALF_WIDTH

    def locate(self, scans: DriveScans, expected: Expectation) -> Location:
        """Search for the drive in the map of the old keyframes, where its uncertainty admits it."""
        drive = scans.take(self._mapper, self._local_field, self.first)
        known = scan_keyframes(self._mapper, self._local_field, self.old)
        return locate(drive, known, expected, Uncertainty(self._covariance))


def _distances(poses: Floats, pose: se2.Pose) -> Floats:
    """Return the distances (k,) of poses (k, 3) from another one, metres."""
    return np.asarray(np.hypot(*(poses[:, :2] - pose[:2]).T))


def _agrees(mapper: Mapper, member: PlacedSubmap) -> bool:
    """Return True if the estimate agrees with the place of a submap: nothing has to be corrected."""
    error = se2.between(mapper.keyframe_poses[member.keyframes[-1]], member.pose)
    return bool(error @ np.linalg.solve(member.covariance, error) < MAX_SQUARED_DISTANCE)
