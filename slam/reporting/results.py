"""Results of a settled estimate: checked against itself, published, and returned as plain data."""

from __future__ import annotations

from collections.abc import Sequence

from ..checks.adapter import (
    contradicted_places,
    drive_of,
    unconnected_parts,
    unconstrained_stretches,
    unmatched_stretches,
)
from ..checks.report import find_suspects
from ..checks.suspect import Suspect
from ..estimation.map_view import final_result
from ..estimation.slam_state import SlamState
from ..events import Finished
from ..geometry.segments import Floats
from ..mapping.odometry_segments import OdometrySegments
from ..preprocessing.preprocessor import ProcessedScan
from ..preprocessing.scan_sequence import ScanSequence
from .publisher import Publisher


def publish_results(
    state: SlamState,
    scans: Sequence[ProcessedScan],
    segments: OdometrySegments,
    path: tuple[Floats, Floats],
    sweep_covariances: Floats,
    summary: dict[str, object],
    publisher: Publisher,
) -> Finished:
    """Check a settled estimate; publish its residuals, the suspects, and the result, which is returned.

    scans              all scans of the session, in time order
    segments           odometry, with indices in `scans`
    path               stamps (m,) and poses (m, 3) of the results; suspects before the first stamp are left out
    sweep_covariances  (k, 3, 3) of the keyframes, see `ScanFeatures`
    summary            of the run; the result's is extended by the suspects
    """
    start, end = float(path[0][0]), float(path[0][-1])
    publisher.publish_residuals(end, state.mapper)
    suspects = [suspect for suspect in _all_suspects(state, scans, segments, start) if suspect.stamp >= start]
    publisher.publish_suspects(suspects, state.keyframe_stamps, start)
    rows = [suspect.row(start) for suspect in suspects]
    result = final_result(state, path, sweep_covariances, summary | {"suspects": rows})
    publisher.publish(result)
    return result


def _all_suspects(
    state: SlamState, scans: Sequence[ProcessedScan], segments: OdometrySegments, start: float
) -> list[Suspect]:
    """Return the findings of all checks, with texts that count times from the stamp `start` (seconds)."""
    mapper, trajectory, model = state.mapper, state.trajectory, state.odometry_model
    drive = drive_of(scans, segments, trajectory.at_scans(mapper.keyframe_poses), model, start)
    suspects = [
        *unconnected_parts(mapper, state.keyframe_stamps, start),
        *contradicted_places(mapper, state.loops.unresolved, state.keyframe_stamps),
        *find_suspects(drive),
    ]
    if model.measured:
        suspects += unmatched_stretches(mapper, trajectory, state.keyframe_stamps)
    sequence = ScanSequence.of(scans)
    measured = sequence.stamps[sequence.measured & model.measured]
    sigma = state.unmeasured_model.unobserved_sigma
    return suspects + unconstrained_stretches(trajectory, mapper.keyframe_poses, measured, sigma)
