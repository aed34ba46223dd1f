"""Where in a map a robot is that may be anywhere, from what it has seen on its last metres.

A fragment is a small map of its own. Its pairs of walls vote for poses in the whole map, the poses with most votes are
refined on all walls, and what is then seen from there is compared with what should be. A place is believed if it
explains most of what was seen, in every direction, and no other place does nearly as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats, Integers, Segments
from ..mapping.mapper import Mapper
from .map_descriptor import MapDescriptor, describe_map, seen_from
from .proposal import DISTINCT, DISTINCT_TURN
from .submap_alignment import Alignment, align_submap, samples_of
from .visibility import VisibilityCounts, look
from .wall_pairs import pair_table, vote

REFINED = 64  # poses with most votes that are refined
LOOKED_AT = 12  # of them, those that explain most wall, that are looked around from
LEAST_WALLS = 3  # in a fragment
# Walls matched, less UNMATCHED for each that is not. One wall falls on some wall of a building by chance at times, but
# not many at once. Metres do not tell that: a long corridor has more of them than ten offices.
LEAST_EVIDENCE, UNMATCHED = 5.0, 0.6
LEAST_LENGTH = 6.0  # metres of wall that must lie on the map's
LEAST_EXPLAINED = 0.55  # share of the fragment's walls that must
# Share of the fragment's walls that the score must reach: what passes one test after the other narrowly is doubtful.
LEAST_ALL_IN_ALL = 0.5
LEAST_AGREEMENT = 0.6  # share of what is seen, where the map knows what there is to be seen
MOST_CONTRADICTED = 0.10  # share of what was seen that the map's walls would have hidden
# Metres and radians, in any direction. One wall by itself leaves 0.03 m and more across it; in buildings where they had
# never been, pieces came out at 0.05 and 0.06 m, hanging on one wall along a corridor. Right ones rarely reach 0.035 m.
WORST_SIGMA, WORST_TURN = 0.04, np.radians(1.5)
RUNNER_UP = 0.60  # share of its score that another place may reach
# Another place must explain clearly less wall as well, in metres or by share of it, whatever is seen from there: how
# well a view agrees depends on how much of a place was mapped, and on what was moved there.
LEAST_LEAD, AS_MUCH_WALL = 4.0, 0.75
LIKELY_RUNNER_UP = 0.85  # share that another place may reach where it is asked again with more seen


@dataclass(frozen=True, slots=True, eq=False)
class MapIndex:
    """A map prepared for recognising places in it; as good as the estimate was when it was made."""

    scene: MapDescriptor
    pairs: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Submap:
    """What was seen lately, in a frame of its own.

    scene  walls and corners
    pose   of the robot at the end
    views  poses with the segments seen from them
    """

    scene: MapDescriptor
    pose: se2.Pose
    views: Sequence[tuple[se2.Pose, Segments]]


@dataclass(frozen=True, slots=True, eq=False)
class PlaceVerdict:
    """Whether a place is believed, why not, and the scores that was decided by.

    likely        whether it would be believed if it were the same again and again as more is seen: all tests hold but
                  that other places lie far behind
    explained     share of the fragment's walls that lies on the map's, `length` metres of `matches` walls; `corners`
                  lie on corners
    agreement     share of what was seen as the map has it, where the map has something
    contradicted  share of what was seen that the map's walls would have hidden
    sigma         metres: standard deviation of the position in its least certain direction; `turn_sigma` radians
    score         metres of wall explained, times the agreement, less what is contradicted
    runner_up     the score of the best other place
    """

    accepted: bool
    likely: bool
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
    """The place in the map that explains a fragment best, believed or not.

    pose        [x, y, heading] of the robot in the map
    covariance  (3, 3) of it, in the map's axes
    motion      [x, y, heading] that takes the fragment's frame into the map's
    pairs       (n, 2) identities of walls of the map and of the fragment that lie on each other
    """

    pose: se2.Pose
    covariance: Floats
    motion: se2.Pose
    pairs: Integers
    verdict: PlaceVerdict


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    laid: Alignment
    sight: VisibilityCounts
    score: float


def index_map(mapper: Mapper) -> MapIndex:
    """Prepare a map. Takes a few milliseconds for each hundred walls."""
    scene = describe_map(mapper.landmarks, mapper.roughness.variance)
    return MapIndex(scene, pair_table(scene))


def submap_of(mapper: Mapper) -> Submap:
    """A small map of the last metres as a fragment."""
    views = [(mapper.graph.keyframe_pose(keyframe), segments) for keyframe, segments in mapper.views]
    return Submap(describe_map(mapper.landmarks, mapper.roughness.variance), mapper.pose, views)


def relocalise(fragment: Submap, index: MapIndex) -> Relocalisation | None:
    """The place of the fragment in the map, with the verdict on it; None where nothing suggests one."""
    seen = seen_from(fragment.pose, fragment.scene)
    if len(seen) < LEAST_WALLS or len(index.scene) < LEAST_WALLS:
        return None
    views = [(se2.between(fragment.pose, pose), segments) for pose, segments in fragment.views]
    places = _places(seen, views, index)
    if not places:
        return None
    best = places[0]
    others = _apart(best.laid.place, np.array([place.laid.place for place in places]))
    rivals = [place for place, other in zip(places, others, strict=True) if other]
    covariance = np.asarray(np.linalg.inv(best.laid.information))
    matched = np.flatnonzero(best.laid.matches >= 0)
    return Relocalisation(
        pose=best.laid.place,
        covariance=covariance,
        motion=se2.compose(best.laid.place, se2.inverse(fragment.pose)),
        pairs=np.column_stack([index.scene.walls[best.laid.matches[matched]], seen.walls[matched]]),
        verdict=_judge(best, rivals, covariance),
    )


def _places(seen: MapDescriptor, views: Sequence[tuple[se2.Pose, Segments]], index: MapIndex) -> list[_Place]:
    """Different places, the best first."""
    samples = samples_of(seen)
    laid = [align_submap(start, seen, samples, index.scene) for start in vote(seen, index.scene, index.pairs, REFINED)]
    places = []
    for some in _different(laid):
        sight = look(some.place, views, index.scene)
        places.append(_Place(some, sight, some.length * sight.agreement * (1.0 - sight.contradicted)))
    return sorted(places, key=lambda place: -place.score)


def _different(laid: Sequence[Alignment]) -> list[Alignment]:
    """Those that explain most wall, each the best of its place."""
    left = sorted(laid, key=lambda some: -some.length)
    different: list[Alignment] = []
    while left and len(different) < LOOKED_AT:
        different.append(left[0])
        apart = _apart(left[0].place, np.array([some.place for some in left]))
        left = [some for some, far in zip(left, apart, strict=True) if far]
    return different


def _apart(place: se2.Pose, places: Floats) -> NDArray[np.bool_]:
    """Which of the places (n, 3) are other places."""
    difference = se2.between(place, places)
    far = np.hypot(difference[:, 0], difference[:, 1]) > DISTINCT
    return np.asarray(far | (np.abs(difference[:, 2]) > DISTINCT_TURN))


def _judge(best: _Place, rivals: Sequence[_Place], covariance: Floats) -> PlaceVerdict:
    """Every test must hold; the first that fails is the reason for refusing."""
    laid, sight = best.laid, best.sight
    matches = int((laid.matches >= 0).sum())
    evidence = matches - UNMATCHED * (len(laid.matches) - matches)
    seen = max(float(laid.seen.sum()), 1e-9)
    overlap_ratio, all_in_all = laid.length / seen, best.score / seen
    sigma = float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    turn_sigma = float(np.sqrt(covariance[2, 2]))
    uncertain = f"uncertain by {sigma:.2f} m and {np.degrees(turn_sigma):.1f} degrees"
    runner_up = max((rival.score for rival in rivals), default=0.0)
    other = max((rival.laid.length for rival in rivals), default=0.0)
    clear = laid.length - other >= LEAST_LEAD or other <= AS_MUCH_WALL * laid.length
    tests = [
        (sigma <= WORST_SIGMA and turn_sigma <= WORST_TURN, uncertain),
        (evidence >= LEAST_EVIDENCE, f"{matches} of {len(laid.matches)} walls are no evidence"),
        (laid.length >= LEAST_LENGTH, f"{laid.length:.1f} m of wall < {LEAST_LENGTH:.0f} m"),
        (overlap_ratio >= LEAST_EXPLAINED, f"explains {overlap_ratio:.0%} < {LEAST_EXPLAINED:.0%}"),
        (sight.contradicted <= MOST_CONTRADICTED, f"{sight.contradicted:.0%} was seen through walls of the map"),
        (sight.agreement >= LEAST_AGREEMENT, f"the view agrees by {sight.agreement:.0%} < {LEAST_AGREEMENT:.0%}"),
        (all_in_all >= LEAST_ALL_IN_ALL, f"all in all {all_in_all:.0%} < {LEAST_ALL_IN_ALL:.0%}"),
    ]
    fits = all(passed for passed, _ in tests)
    tests += [
        (runner_up <= RUNNER_UP * best.score, f"another place scores {runner_up / max(best.score, 1e-9):.0%} as much"),
        (clear, f"another place explains {other:.1f} m of wall, this one {laid.length:.1f} m"),
    ]
    reason = next((text for passed, text in tests if not passed), "")
    return PlaceVerdict(
        accepted=not reason,
        likely=fits and runner_up <= LIKELY_RUNNER_UP * best.score,
        reason=reason or "all tests passed",
        overlap_ratio=overlap_ratio,
        length=laid.length,
        matches=matches,
        corners=laid.corners,
        agreement=sight.agreement,
        contradicted=sight.contradicted,
        sigma=sigma,
        turn_sigma=turn_sigma,
        score=best.score,
        runner_up=runner_up,
    )
