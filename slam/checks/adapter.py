"""Bring the results of a run into the form that the checks need: the only place that knows both."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.elapsed import elapsed

from ..geometry.degeneracy import weakest_direction
from ..geometry.pose_covariance import position_sigma
from ..geometry.segments import Floats
from ..loop_closure.submap_search import DISTINCT_SHIFT
from ..mapping.mapper import Mapper
from ..mapping.odometry_segments import OdometrySegments
from ..mapping.trajectory_builder import TrajectoryBuilder
from ..odometry.dead_reckoning import DeadReckoning
from ..odometry.error_model import OdometryModel
from ..odometry.history import OdometryHistory, wheel_travel
from ..odometry.velocity import MAX_VELOCITIES
from ..preprocessing.preprocessor import ProcessedScan
from ..preprocessing.scan_sequence import ScanSequence
from .drive import Drive
from .row_groups import MAX_GAP, consecutive_groups
from .scan_links import ScanLinks
from .suspect import MAP, PARTS, UNCONSTRAINED, Suspect
from .weak_places import MIN_LENGTH

# Metres of driving that are reported if nothing determines them, and that a robot may have driven while its velocity
# was not known: velocities hardly change before.
# Origin: definition, the shortest stretch that is reported as weak.
MIN_BLIND_LENGTH = MIN_LENGTH
# Metres: standard deviation of the positions after a stretch without a match, relative to those before it, from which
# on it is reported. Origin: definition, half the distance from which on loop closure takes two places as different.
MAX_BLIND_SIGMA = 0.5 * DISTINCT_SHIFT
# Parts of the map whose times are named. Origin: chosen; more are not read.
SHOWN_PARTS = 4


def drive_of(
    scans: Sequence[ProcessedScan],
    segments: OdometrySegments,
    placed: tuple[Floats, Floats],
    odometry_model: OdometryModel,
    start: float,
) -> Drive:
    """Return the drive for the checks.

    scans     all scans in time order
    segments  odometry, with indices in `scans`
    placed    stamps (m,) and final poses (m, 3) of the scans that have a pose, in time order; the others are left out
    start     stamp (seconds) from which times in texts are counted
    """
    scans = ScanSequence.of(scans)
    stamps, poses = placed
    of_scans = scans.stamps
    found = np.minimum(np.searchsorted(stamps, of_scans), max(len(stamps) - 1, 0))
    rows = np.flatnonzero(stamps[found] == of_scans) if len(stamps) else np.zeros(0, dtype=np.int64)
    segment = np.searchsorted(np.asarray(segments.starts, dtype=np.int64), rows, side="right")
    dead_reckoning = DeadReckoning(odometry_model, OdometryHistory.joined(segments.histories))
    motions = dead_reckoning.motions(of_scans[rows], scans.odometry[rows])
    return Drive(
        stamps=of_scans[rows],
        poses=poses[found[rows]],
        odometry=_corrected_path(scans.odometry[rows], motions),
        segment=segment,
        points=[scans.points(row) for row in rows.tolist()],
        deviations=odometry_model.deviations,
        floors=odometry_model.floors,
        measured=scans.measured[rows],
        dropped=~scans.has_features[rows],
        has_odometry=odometry_model.measured,
        start=start,
        readings=np.concatenate([np.zeros(0), *(history.measured_stamps for history in segments.histories)]),
    )


def unconstrained_stretches(
    trajectory: TrajectoryBuilder, keyframe_poses: Floats, measured: Floats, unobserved_sigma: float
) -> list[Suspect]:
    """Return a suspect for each stretch in which neither odometry nor the scans determine the motion along it.

    keyframe_poses    (k, 3) of the finished map
    measured          stamps of the scans to which odometry leads, seconds
    unobserved_sigma  metres, see `OdometryModel`

    The length of such a stretch is a guess.
    """
    stamps, poses = trajectory.at_scans(keyframe_poses)
    informations = trajectory.relative_poses()[3]
    blind = [
        not is_measured and weakest_direction(pose, information, unobserved_sigma) is not None
        for is_measured, pose, information in zip(np.isin(stamps, measured), poses, informations, strict=True)
    ]
    travelled = np.concatenate([[0.0], np.cumsum(wheel_travel(se2.between(poses[:-1], poses[1:])))])
    suspects = []
    for group in consecutive_groups(np.flatnonzero(blind), MAX_GAP):
        first, last = int(group[0]), int(group[-1])
        length = float(travelled[last] - travelled[first])
        seconds = float(stamps[last] - stamps[first])
        possible = max(length, seconds * float(MAX_VELOCITIES[0]))
        if possible > MIN_BLIND_LENGTH:
            extent = f"{length:.1f} m" if length > MIN_BLIND_LENGTH else f"{seconds:.0f} s"
            text = (
                f"for {extent} the scans do not determine the motion in one direction, and no odometry measures it: "
                "constant velocity is assumed, and the length may be wrong"
            )
            weight, times = possible / MIN_BLIND_LENGTH, (float(stamps[first]), float(stamps[last]))
            suspects.append(Suspect(UNCONSTRAINED, times[0], *times, poses[first, :2].copy(), weight, text))
    return suspects


def unmatched_stretches(
    mapper: Mapper, trajectory: TrajectoryBuilder, keyframe_stamps: Sequence[float]
) -> list[Suspect]:
    """Return a suspect for each stretch without a match, if odometry alone leaves the map behind uncertain.

    Its scans match nothing, or it has none. `keyframe_stamps` (k,) are the times of the keyframes, seconds. A loop
    closed later may make the map behind certain. If scans on both sides of a stretch without scans show the same, as
    in a log of a scan per metre, they determine the turn.
    """
    links = ScanLinks(mapper)
    stamps, poses = trajectory.at_scans(mapper.keyframe_poses)
    is_matched = np.asarray(trajectory.relative_poses()[3].any(axis=(1, 2)))
    suspects = []
    for first, last, before, after in _stretches_without_match(stamps, poses, is_matched, np.array(keyframe_stamps)):
        length = mapper.travelled[after] - mapper.travelled[before]
        one_part = np.ptp(mapper.landmarks.parts.groups_of(np.array([before, after]))) == 0
        if not one_part or length < MIN_BLIND_LENGTH:
            continue
        # without the correlated drift, which a closed loop does not reduce
        covariance = mapper.graph.relative_covariance(before, after)
        shift, turn = position_sigma(covariance), float(np.sqrt(covariance[2, 2]))
        seen_by_both = bool(is_matched[first]) and links.connect(before, after)
        sigma = shift if seen_by_both else math.hypot(shift, _displacement_by_turn(mapper, before, after, turn))
        if sigma > MAX_BLIND_SIGMA:
            shown = "there are no scans" if is_matched[first] else "the scans show nothing that was mapped"
            text = (
                f"for {length:.1f} m {shown}: what is mapped afterwards is placed by odometry only (standard "
                f"deviations {shift:.2f} m and {np.degrees(turn):.1f} degrees)"
            )
            times = float(stamps[first]), float(stamps[last])
            position, weight = poses[first, :2].copy(), sigma / MAX_BLIND_SIGMA
            suspects.append(Suspect(UNCONSTRAINED, times[0], *times, position, weight, text))
    return suspects


def _stretches_without_match(
    stamps: Floats, poses: Floats, is_matched: NDArray[np.bool_], keyframe_stamps: Floats
) -> list[tuple[int, int, int, int]]:
    """Return the stretches between scans at `poses` (n, 3) that no match determines, by time.

    They are the first and the last scan of each, and the keyframes before and after it. Its scans match nothing, or
    MIN_BLIND_LENGTH is driven between two scans that both match.
    """
    steps = wheel_travel(se2.between(poses[:-1], poses[1:]))
    gaps = np.flatnonzero((steps >= MIN_BLIND_LENGTH) & is_matched[:-1] & is_matched[1:])
    groups = consecutive_groups(np.flatnonzero(~is_matched), MAX_GAP)
    found: dict[tuple[int, int], tuple[int, int]] = {}  # by the keyframes, since a gap may be beside a group
    for first, last in [*((group[0], group[-1]) for group in groups), *((row, row + 1) for row in gaps)]:
        before = np.searchsorted(keyframe_stamps, stamps[first], side="right" if is_matched[first] else "left") - 1
        after = np.searchsorted(keyframe_stamps, stamps[last], side="left" if is_matched[last] else "right")
        if before >= 0 and after < len(keyframe_stamps):
            found.setdefault((int(before), int(after)), (int(first), int(last)))
    return sorted((*scans, *keyframes) for keyframes, scans in found.items())


def _displacement_by_turn(mapper: Mapper, before: int, after: int, turn: float) -> float:
    """Return the standard deviation (metres) of the positions on one side of a stretch by its error of the heading.

    before, after  keyframes at its ends
    turn           standard deviation of the heading of the second one relative to the first, radians

    The error turns one side of the map relative to the other, so the side of the smaller reach is meant. A loop that
    was closed there may have made its far end certain.
    """
    groups = mapper.landmarks.parts.groups_of(np.arange(mapper.keyframe_count))
    offset = mapper.keyframe_poses[:, :2] - mapper.keyframe_poses[after, :2]
    distance = np.where(groups == groups[after], np.hypot(offset[:, 0], offset[:, 1]), 0.0)
    ends = int(np.argmax(distance[: before + 1])), after + int(np.argmax(distance[after:]))
    pair = (after, ends[0]) if distance[ends[0]] < distance[ends[1]] else (before, ends[1])
    reach = float(distance[list(ends)].min())
    return min(turn * reach, position_sigma(mapper.graph.relative_covariance(*pair)))


def unconnected_parts(mapper: Mapper, keyframe_stamps: Sequence[float], start: float) -> list[Suspect]:
    """Return a suspect where parts of the map begin that are not connected with its first part; empty without any.

    `keyframe_stamps` (k,) are the times of the keyframes, seconds; those in texts are counted from the stamp `start`.
    """
    parts = mapper.landmarks.parts
    apart = [group for group in parts.apart if parts.firsts[group] < mapper.keyframe_count]
    if not apart:
        return []
    firsts = [parts.firsts[group] for group in apart]
    stamps = [float(keyframe_stamps[first]) for first in firsts]
    where = "from here on" if len(apart) == 1 else f"beginning at {_listed([elapsed(at - start) for at in stamps])}"
    how = "where they lie relative to each other is not known, as the robot may have been carried"
    if all(parts.measured[group] for group in apart):
        sigma, turn_sigma = _largest_deviations(mapper, firsts)
        sigmas = f"standard deviations of up to {sigma:.2f} m and {np.degrees(turn_sigma):.1f} degrees"
        how = f"only odometry places each relative to the one before it, with {sigmas}"
    text = f"the map has {len(apart) + 1} parts that no scan connects, {where}; {how}"
    last = float(keyframe_stamps[-1])
    return [Suspect(PARTS, stamps[0], stamps[0], last, mapper.keyframe_poses[firsts[0], :2].copy(), 1.0, text)]


def contradicted_places(mapper: Mapper, looks: Sequence[float], keyframe_stamps: Sequence[float]) -> list[Suspect]:
    """Return a suspect for looks at old places that contradict the map; empty without any.

    looks            metres driven up to each, in order
    keyframe_stamps  (k,) seconds

    No closure of a loop has explained them, and no later look agrees with the map.
    """
    if not looks:
        return []
    keyframes = np.searchsorted(mapper.travelled, looks, side="right") - 1
    first, last = int(keyframes[0]), int(keyframes[-1])
    text = (
        f"{len(looks)} looks over {looks[-1] - looks[0]:.0f} m do not fit what was mapped before at these places: the "
        "pose may be wrong from here on, and places may be in the map twice"
    )
    times = float(keyframe_stamps[first]), float(keyframe_stamps[last])
    return [Suspect(MAP, times[0], *times, mapper.keyframe_poses[first, :2].copy(), 1.0, text)]


def _listed(times: Sequence[str]) -> str:
    """Return times as text, the first SHOWN_PARTS of them."""
    more = len(times) - SHOWN_PARTS
    return ", ".join(times[:SHOWN_PARTS]) + (f" and {more} later times" if more > 0 else "")


def _largest_deviations(mapper: Mapper, firsts: Sequence[int]) -> tuple[float, float]:
    """Return the largest standard deviations (metres, radians) of keyframes relative to those before them."""
    covariances = [mapper.covariances.relative(first - 1, first) for first in firsts]
    position = max(position_sigma(covariance) for covariance in covariances)
    return position, float(np.sqrt(max(covariance[2, 2] for covariance in covariances)))


def _corrected_path(odometry: Floats, motions: Floats) -> Floats:
    """Return the poses (n, 3) that motions (n - 1, 3) lead to from odometry's first one, with unwrapped headings."""
    path = odometry.copy()
    path[1:, 2] = odometry[:1, 2] + np.cumsum(motions[:, 2])
    turned = se2.transform(np.column_stack([np.zeros((len(motions), 2)), path[:-1, 2]]), motions[:, :2])
    path[1:, :2] = odometry[:1, :2] + np.cumsum(turned, axis=0)
    return path
