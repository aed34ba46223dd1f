"""Relocalisation: pose of a submap in a map without a prior.

Pairs of walls of the submap vote for poses in the whole map. The poses with most votes are aligned on all walls, and
the submap's views are compared with what the map should show from there. A pose is accepted if it explains most of what
was seen, in every direction, and no alternative does nearly as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..formatting import percent
from ..geometry.segments import Floats, Segments
from ..mapping.mapper import Mapper
from .map_descriptor import MapDescriptor, describe_map, express_in_frame
from .submap_alignment import Alignment, align_submap, sample_walls
from .submap_search import DISTINCT_SHIFT, DISTINCT_TURN
from .visibility import VisibilityCounts, compare_visibility
from .wall_pairs import build_pair_table, vote_for_poses

# Poses with most votes that are aligned. Origin: chosen, for speed; not measured.
MAX_ALIGNED_POSES = 64
# Distinct alignments with most wall length whose visibility is compared. Origin: chosen, for speed; not measured.
MAX_CANDIDATES = 12
# Walls of a submap and of a map. Origin: chosen, one more than determine a pose; not measured.
MIN_WALLS = 3
# Matched walls less UNMATCHED_PENALTY for each unmatched one. A single wall of a building matches by chance, many at
# once do not; metres are no evidence of that, as one corridor is longer than ten offices.
# Origin: chosen, any four walls match four walls of most buildings; not measured.
MIN_EVIDENCE = 5.0
# Walls by which an unmatched wall lowers the evidence. Origin: chosen; not measured.
UNMATCHED_PENALTY = 0.6
# Metres of the submap's walls that must lie on the map's. Origin: chosen; not measured.
MIN_ALIGNED_LENGTH = 6.0
# Share of the submap's observed wall length that must lie on the map's walls. Origin: chosen; not measured.
MIN_SUBMAP_OVERLAP = 0.55
# Least score as a share of the submap's observed wall length: passing each check narrowly is not enough.
# Origin: chosen; not measured.
MIN_SCORE_SHARE = 0.5
# Least agreement of the views, see `VisibilityCounts`. Origin: chosen; not measured.
MIN_AGREEMENT = 0.6
# Largest share of rays that walls of the map would have blocked. Origin: chosen; not measured.
MAX_CONTRADICTED = 0.10
# Metres, largest standard deviation of the position in any direction. Origin: measured, on submaps searched in maps of
# other buildings: wrong poses that rest on one wall along a corridor have 0.05 and 0.06 m; a single wall alone leaves
# 0.03 m and more across it; right poses rarely exceed 0.035 m.
MAX_POSITION_SIGMA = 0.04
# Radians, largest standard deviation of the heading. Origin: chosen; not measured.
MAX_HEADING_SIGMA = np.radians(1.5)
# Share of the score that an alternative may reach.
# Origin: chosen, tightened from 0.70 during development; not measured.
MAX_ALTERNATIVE_SCORE = 0.60
# Metres of wall by which the pose must exceed every alternative, unless MAX_ALTERNATIVE_LENGTH is kept. Wall length is
# compared as well because the views depend on how completely a place was mapped and on what was moved.
# Origin: chosen, raised from 3 m during development; not measured.
MIN_LENGTH_LEAD = 4.0
# Share of the matched wall length that an alternative may reach. Origin: chosen, see MIN_LENGTH_LEAD; not measured.
MAX_ALTERNATIVE_LENGTH = 0.75


@dataclass(frozen=True, slots=True, eq=False)
class MapIndex:
    """Map prepared for relocalisation: its descriptor and pair table. Not updated when the map changes."""

    descriptor: MapDescriptor
    pairs: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Submap:
    """Walls and corners seen recently, in a frame of their own.

    descriptor  walls and corners
    pose        of the robot at the end
    views       poses with the segments seen from there
    """

    descriptor: MapDescriptor
    pose: se2.Pose
    views: Sequence[tuple[se2.Pose, Segments]]


@dataclass(frozen=True, slots=True, eq=False)
class PlaceVerdict:
    """Decision on the best pose of a submap, with its scores.

    plausible      true if all checks pass except those of alternatives: something else must tell these apart
    overlap_ratio  share of the submap's observed wall length that lies on the map's walls: `length` metres
    matches        matched walls
    corners        matched corners
    agreement      share of agreeing rays, see `VisibilityCounts`
    contradicted   share of rays that walls of the map would have blocked
    sigma          standard deviation of the position in its least certain direction, metres
    turn_sigma     standard deviation of the heading, radians
    score          length times agreement times the share of rays not contradicted, metres
    runner_up      score of the best alternative
    """

    accepted: bool
    plausible: bool
    reason: str
    overlap_ratio: float
    length: float
    matches: int
    corners: int
    agreement: float
    contradicted: float
    sigma: float
    turn_sigma: float
    score: float
    runner_up: float


@dataclass(frozen=True, slots=True, eq=False)
class Relocalisation:
    """Best pose of a submap in a map, accepted or not.

    pose        [x, y, heading] of the robot in the map
    covariance  (3, 3) of the pose, in the map's axes
    motion      [x, y, heading] of the submap's frame in the map
    rivals      the same for each alternative that comes too near the best pose
    """

    pose: se2.Pose
    covariance: Floats
    motion: se2.Pose
    rivals: Sequence[se2.Pose]
    verdict: PlaceVerdict


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    """Aligned submap with its visibility comparison; score as in `PlaceVerdict`."""

    alignment: Alignment
    visibility: VisibilityCounts
    score: float


def index_map(mapper: Mapper, observers: NDArray[np.bool_] | None = None) -> MapIndex:
    """Prepare a map for relocalisation. Takes a few milliseconds per hundred walls.

    With `observers` (k,), only of landmarks that one of these keyframes saw last.
    """
    descriptor = describe_map(mapper.landmarks, mapper.roughness.variance, observers)
    return MapIndex(descriptor, build_pair_table(descriptor))


def submap_of(mapper: Mapper, observers: NDArray[np.bool_] | None = None) -> Submap:
    """Return the map of a short drive as a submap; with `observers` (k,), what these keyframes of it saw last."""
    views = [
        (mapper.graph.keyframe_pose(keyframe), segments)
        for keyframe, segments in mapper.recent_segments
        if observers is None or observers[keyframe]
    ]
    return Submap(describe_map(mapper.landmarks, mapper.roughness.variance, observers), mapper.pose, views)


def relocalise(submap: Submap, index: MapIndex) -> Relocalisation | None:
    """Find the pose of a submap in a map and decide on it; None if there are no candidates."""
    observed = express_in_frame(submap.pose, submap.descriptor)
    views = [(se2.between(submap.pose, pose), segments) for pose, segments in submap.views]
    candidates = _find_candidates(observed, views, index)
    if not candidates:
        return None
    best = candidates[0]
    distinct = _are_distinct(best.alignment.pose, np.array([candidate.alignment.pose for candidate in candidates]))
    alternatives = [candidate for candidate, other in zip(candidates, distinct, strict=True) if other]
    covariance = np.asarray(np.linalg.inv(best.alignment.information))
    near = [other for other in alternatives if not all(passed for passed, _ in _check_alternatives(best, [other]))]
    to_submap = se2.inverse(submap.pose)
    return Relocalisation(
        pose=best.alignment.pose,
        covariance=covariance,
        motion=se2.compose(best.alignment.pose, to_submap),
        rivals=[se2.compose(other.alignment.pose, to_submap) for other in near],
        verdict=_decide(best, alternatives, covariance),
    )


def align_candidates(observed: MapDescriptor, index: MapIndex, count: int = MAX_CANDIDATES) -> list[Alignment]:
    """Return `count` distinct alignments of a submap with a map that have most votes, most wall length first."""
    if len(observed) < MIN_WALLS or len(index.descriptor) < MIN_WALLS:
        return []
    samples = sample_walls(observed)
    starts = vote_for_poses(observed, index.descriptor, index.pairs, MAX_ALIGNED_POSES)
    return _select_distinct([align_submap(start, observed, samples, index.descriptor) for start in starts], count)


def _find_candidates(
    observed: MapDescriptor, views: Sequence[tuple[se2.Pose, Segments]], index: MapIndex
) -> list[_Candidate]:
    """Return distinct candidates, by descending score."""
    candidates = []
    for alignment in align_candidates(observed, index):
        visibility = compare_visibility(alignment.pose, views, index.descriptor)
        score = alignment.length * visibility.agreement * (1.0 - visibility.contradicted)
        candidates.append(_Candidate(alignment, visibility, score))
    return sorted(candidates, key=lambda candidate: -candidate.score)


def _select_distinct(aligned: Sequence[Alignment], count: int) -> list[Alignment]:
    """Return `count` alignments with most wall length, one for each distinct pose."""
    remaining = sorted(aligned, key=lambda alignment: -alignment.length)
    selected: list[Alignment] = []
    while remaining and len(selected) < count:
        selected.append(remaining[0])
        distinct = _are_distinct(remaining[0].pose, np.array([alignment.pose for alignment in remaining]))
        remaining = [alignment for alignment, other in zip(remaining, distinct, strict=True) if other]
    return selected


def _are_distinct(pose: se2.Pose, poses: Floats) -> NDArray[np.bool_]:
    """Return (n,) which of the poses (n, 3) are distinct places from `pose`."""
    difference = se2.between(pose, poses)
    far = np.hypot(difference[:, 0], difference[:, 1]) > DISTINCT_SHIFT
    return np.asarray(far | (np.abs(difference[:, 2]) > DISTINCT_TURN))


def _decide(best: _Candidate, alternatives: Sequence[_Candidate], covariance: Floats) -> PlaceVerdict:
    """Decide on the best candidate: every check must pass; the first that fails is the reason for rejection."""
    alignment, visibility = best.alignment, best.visibility
    matches = int((alignment.matches >= 0).sum())
    evidence = matches - UNMATCHED_PENALTY * (len(alignment.matches) - matches)
    observed = max(float(alignment.observed.sum()), 1e-9)
    overlap_ratio, score_share = alignment.length / observed, best.score / observed
    sigma = float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    turn_sigma = float(np.sqrt(covariance[2, 2]))
    uncertain = f"standard deviations {sigma:.2f} m and {np.degrees(turn_sigma):.1f} degrees"
    checks = [
        (sigma <= MAX_POSITION_SIGMA and turn_sigma <= MAX_HEADING_SIGMA, uncertain),
        (evidence >= MIN_EVIDENCE, f"{matches} of {len(alignment.matches)} walls matched are not enough evidence"),
        (alignment.length >= MIN_ALIGNED_LENGTH, f"{alignment.length:.1f} m of wall < {MIN_ALIGNED_LENGTH:.0f} m"),
        (
            overlap_ratio >= MIN_SUBMAP_OVERLAP,
            f"overlap ratio {percent(overlap_ratio)} < {percent(MIN_SUBMAP_OVERLAP)}",
        ),
        (
            visibility.contradicted <= MAX_CONTRADICTED,
            f"{percent(visibility.contradicted)} of the rays passed through walls of the map",
        ),
        (
            visibility.agreement >= MIN_AGREEMENT,
            f"{percent(visibility.agreement)} of the rays agree with the map < {percent(MIN_AGREEMENT)}",
        ),
        (score_share >= MIN_SCORE_SHARE, f"total score {percent(score_share)} < {percent(MIN_SCORE_SHARE)}"),
    ]
    fits = all(passed for passed, _ in checks)
    runner_up = max((candidate.score for candidate in alternatives), default=0.0)
    checks += _check_alternatives(best, alternatives)
    reason = next((text for passed, text in checks if not passed), "")
    return PlaceVerdict(
        accepted=not reason,
        plausible=fits,
        reason=reason or "all checks passed",
        overlap_ratio=overlap_ratio,
        length=alignment.length,
        matches=matches,
        corners=alignment.corners,
        agreement=visibility.agreement,
        contradicted=visibility.contradicted,
        sigma=sigma,
        turn_sigma=turn_sigma,
        score=best.score,
        runner_up=runner_up,
    )


def _check_alternatives(best: _Candidate, alternatives: Sequence[_Candidate]) -> list[tuple[bool, str]]:
    """Check that no alternative comes near the best candidate in score or in wall length."""
    score = max((candidate.score for candidate in alternatives), default=0.0)
    length, other = best.alignment.length, max((candidate.alignment.length for candidate in alternatives), default=0.0)
    clear = length - other >= MIN_LENGTH_LEAD or other <= MAX_ALTERNATIVE_LENGTH * length
    return [
        (
            score <= MAX_ALTERNATIVE_SCORE * best.score,
            f"an alternative scores {percent(score / max(best.score, 1e-9))} as much",
        ),
        (clear, f"an alternative matches {other:.1f} m of wall, the best pose {length:.1f} m"),
    ]
