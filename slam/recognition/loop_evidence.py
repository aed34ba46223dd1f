"""Loop closure by evidence: decide on a loop that looks have found but cannot decide on.

Single looks support several places where these look alike, and then none of them prevails (see
`loop_closure.agreement`). The drive since the first look that supports the strongest hypothesis is searched as a whole
where it may be by the uncertainty of the estimate, and the evidence of all its submaps decides; see `location`.

A place that looks alike may be mapped while the true one is not. As the robot may be off by the search radius, the
drive must extend as far before it is searched: then a part of the true place is mapped as well, and is compared.
"""

from __future__ import annotations

import copy

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats
from ..localisation.local_field import LocalField
from ..loop_closure.agreement import LoopAgreement
from ..loop_closure.decision import LoopDecision
from ..loop_closure.look import MAX_SQUARED_DISTANCE, SUBMAP_HALF_WIDTH, SUBMAP_LENGTH, Look, Submaps
from ..mapping.mapper import Mapper
from .decision import decide, scan_keyframes
from .drive_scans import DriveScans
from .location import LOST, PlacedSubmap, locate
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

    def search(
        self, mapper: Mapper, local_field: LocalField, loops: LoopAgreement, among: NDArray[np.bool_]
    ) -> LoopDecision | None:
        """Return the decision to close a loop that the last look supports, if the evidence of the drive suffices.

        loops  hypotheses of the looks
        among  (k,) keyframes of the connected part of the map
        """
        hypothesis = loops.undecided
        if hypothesis is None:
            return None
        travelled, look = np.asarray(mapper.travelled), Look(mapper, local_field, Submaps(), among)
        first = look.keyframe_at(hypothesis.support[0].travelled - SUBMAP_LENGTH)
        place = hypothesis.support[-1].old
        extent, radius = _extent(mapper.keyframe_poses[first:]), look.search_radius(place)
        old = among & (travelled < travelled[first] - SUBMAP_LENGTH)
        old &= _distances(mapper.keyframe_poses, look.pose) < extent + radius + SUBMAP_HALF_WIDTH
        if extent < radius or not old.any() or not self._drive.is_due(mapper, first):
            return None
        drive, known = self._drive.take(mapper, local_field, first), scan_keyframes(mapper, local_field, old)
        location = locate(drive, known, LOST, Uncertainty(look.covariance(place)))
        if not location.accepted or _agrees(mapper, location.members[-1]):
            return None
        if loops.is_excluded(look, location.members[-1].motion):
            return None
        since = min(first, look.keyframe_at(loops.doubted_since(hypothesis)))
        return decide(look, mapper, location, np.flatnonzero(old), since=since, joins=False)


def _extent(poses: Floats) -> float:
    """Return the largest distance (metres) of poses (k, 3) from the first of them."""
    return float(_distances(poses, poses[0]).max())


def _distances(poses: Floats, pose: se2.Pose) -> Floats:
    """Return the distances (k,) of poses (k, 3) from another one, metres."""
    return np.asarray(np.hypot(*(poses[:, :2] - pose[:2]).T))


def _agrees(mapper: Mapper, member: PlacedSubmap) -> bool:
    """Return True if the estimate agrees with the place of a submap: nothing has to be corrected."""
    error = se2.between(mapper.keyframe_poses[member.keyframes[-1]], member.pose)
    return bool(error @ np.linalg.solve(member.covariance, error) < MAX_SQUARED_DISTANCE)
