"""Loop closure by evidence: the drive through a known place must fit there, as a whole, better than elsewhere.

Looks at old places find loops and agree on them (see `loop_closure.agreement`). A look compares shares of points, so a
bare corridor fits along all of its length. Therefore the drive since the first look that supports a loop is searched as
a whole where it may be by the uncertainty of the estimate, and the evidence of all its submaps must suffice for the
place that the looks agree on; see `location`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats
from ..localisation.local_field import LocalField
from ..loop_closure.criteria import differ
from ..loop_closure.decision import LoopDecision
from ..loop_closure.look import Look
from ..loop_closure.loop_status import LoopStatus
from ..loop_closure.submap_search import SUBMAP_LENGTH
from ..loop_closure.submaps import Submaps
from ..mapping.mapper import Mapper
from ..matching.distance_field import FIELD_HALF_WIDTH
from .drive_scans import DriveScans
from .location import DOUBTED, RECOGNISED, RETURNED, Expectation, locate
from .placements import Uncertainty
from .scanned_map import scan_keyframes


def check_evidence(
    mapper: Mapper, local_field: LocalField, decision: LoopDecision, among: NDArray[np.bool_]
) -> LoopDecision:
    """Return a loop that looks agree on, rejected if the evidence of the drive does not suffice for its place.

    among  (k,) keyframes of the connected part of the map
    """
    place, poses = decision.matches[-1].old, mapper.keyframe_poses
    look = Look(mapper, local_field, Submaps(), among, doubted=decision.doubted)
    first = look.keyframe_at(decision.matches[0].travelled - SUBMAP_LENGTH)
    reach = _distances(poses[first:], poses[first]).max() + look.uncertainty.search_radius(place) + FIELD_HALF_WIDTH
    travelled = np.asarray(mapper.travelled)
    old = among & (travelled < travelled[first] - SUBMAP_LENGTH) & (_distances(poses, look.pose) < reach)
    drive, known = DriveScans().take(mapper, local_field, first), scan_keyframes(mapper, local_field, old)
    uncertainty = Uncertainty(look.uncertainty.covariance(place))
    location = locate(drive, known, _expected(look, decision), uncertainty)
    if location.accepted and not differ(look, location.members[-1].motion, decision.correction):
        return decision
    where = "fits at another place" if location.accepted else "does not fit there"
    reason = f"the drive as a whole {where}: {location.reason}"
    return replace(decision, status=LoopStatus.REJECTED, reason=reason)


def _expected(look: Look, decision: LoopDecision) -> Expectation:
    """Return what is known before about where the drive is."""
    if decision.doubted:
        return DOUBTED
    return RECOGNISED if differ(look, decision.correction, np.zeros(3)) else RETURNED


def _distances(poses: Floats, pose: se2.Pose) -> Floats:
    """Return the distances (k,) of poses (k, 3) from another one, metres."""
    return np.asarray(np.hypot(*(poses[:, :2] - pose[:2]).T))
