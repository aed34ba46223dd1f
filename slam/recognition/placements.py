"""Placements of a map in another one: candidates from walls and points of its submaps, refined submap by submap.

A match of one submap implies a placement of all submaps. The others are refined one after the other. Each starts where
it is predicted from its pose relative to a submap refined before, and must stay within the covariance of this
prediction: so a map can bend as far as its own drift, and no farther.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, zip_longest

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ..geometry.pose_covariance import position_sigma, squared_distance
from ..geometry.segments import Floats, Integers
from ..loop_closure.relative_uncertainty import MAX_SQUARED_DISTANCE
from ..loop_closure.submap_search import MAX_REFINED, are_distinct
from ..matching.distance_field import DistanceField
from ..matching.point_matcher import (
    POINTS_PER_OBJECT,
    PointMatch,
    Prediction,
    match_from,
    match_points,
    point_cost,
)
from .grid_search import search_grid
from .map_index import MAX_CANDIDATES, align_candidates
from .scanned_map import DriveSubmap, ScannedDrive, ScannedMap
from .submap_alignment import SUBMAP_HEADING_GATES, SUBMAP_OFFSET_GATES, align_submap, sample_walls

# Candidates at random poses: they show how well places fit that have nothing in common with the drive. Origin: chosen,
# their cells are some hundred.
RANDOM_CANDIDATES = 16
# Metres, metres, radians: standard deviations of a candidate from walls. Origin: definition, the last gates of
# `submap_alignment` in offset, and half of that in heading.
ALIGNMENT_SIGMAS = np.array([SUBMAP_OFFSET_GATES[-1], SUBMAP_OFFSET_GATES[-1], 0.5 * SUBMAP_HEADING_GATES[-1]])


@immutable
class Uncertainty:
    """Uncertainty of a drive whose map is already in the frame of the other one, but has drifted.

    covariance  (3, 3) of the pose of its last keyframe, in the pose's frame
    """

    covariance: Floats

    def admits(self, submap: DriveSubmap, pose: se2.Pose) -> bool:
        """Return True if a submap may be at a pose in the other map. No submap has drifted farther than the last."""
        return squared_distance(submap.pose, pose, self.covariance) < MAX_SQUARED_DISTANCE

    def draw(self, submap: DriveSubmap, random: np.random.Generator) -> se2.Pose:
        """Return a pose of a submap in the other map, drawn from those that are admitted with equal probability."""
        direction = random.standard_normal(3)
        direction *= random.random() ** (1.0 / 3.0) / np.linalg.norm(direction)
        offset = math.sqrt(MAX_SQUARED_DISTANCE) * np.linalg.cholesky(self.covariance) @ direction
        return se2.compose(submap.pose, se2.exp(offset))

    def log_density(self, submap: DriveSubmap, pose: se2.Pose) -> float:
        """Return the logarithm of the density of a submap's pose, relative to that of equally likely admitted poses."""
        unit_volume = math.sqrt((2.0 * math.pi) ** 3 * float(np.linalg.det(self.covariance)))
        return math.log(self.volume / unit_volume) - 0.5 * squared_distance(submap.pose, pose, self.covariance)

    @property
    def volume(self) -> float:
        """Square metres times radians of the poses that are admitted, an ellipsoid."""
        return 4.0 / 3.0 * math.pi * math.sqrt(MAX_SQUARED_DISTANCE**3 * float(np.linalg.det(self.covariance)))


@immutable
class Placement:
    """Placement of n submaps in another map.

    poses         (n, 3) of their last keyframes in the other map
    informations  (n, 3, 3) of these poses from the points of each submap alone, in their own frames; zero for a submap
                  that is only predicted, as its points fit elsewhere
    cost          of the points of all submaps
    """

    poses: Floats
    informations: Floats
    cost: float

    def has_matched(self, submap: int, pose: se2.Pose) -> bool:
        """Return True if the points of a submap determine its pose here, at the same place as another pose."""
        return bool(self.informations[submap].any()) and not are_distinct(self.poses[submap], pose)

    def differs(self, other: Placement) -> bool:
        """Return True if another placement has some submap at a different place."""
        return any(are_distinct(pose, rival) for pose, rival in zip(self.poses, other.poses, strict=True))


def find_placements(new: ScannedDrive, old: ScannedMap, near: Uncertainty | None) -> list[Placement]:
    """Return the different placements of a map in another one that walls and points of its submaps suggest.

    near  admits only some poses, suggests the one that the drive has by its own map, and random ones; None if it may be
          anywhere
    """
    placements: list[Placement] = []
    random = () if near is None else _random_candidates(new, near)
    for submap, pose in chain(_candidates(new, old, near), random):
        if any(placement.has_matched(submap, pose) for placement in placements):
            continue
        placement = _refine(new, old, submap, pose)
        others = [other for other in placements if placement.differs(other)]
        same = [other for other in placements if not placement.differs(other)]
        placements = [*others, min([*same, placement], key=lambda one: one.cost)]
        if len(placements) == MAX_CANDIDATES:
            break
    return placements


def _random_candidates(new: ScannedDrive, near: Uncertainty) -> Iterator[tuple[int, se2.Pose]]:
    """Yield the last submap at random poses that are admitted."""
    random, submap = np.random.default_rng(0), new.submaps[-1]
    for _ in range(RANDOM_CANDIDATES):
        yield len(new.submaps) - 1, near.draw(submap, random)


def _candidates(new: ScannedDrive, old: ScannedMap, near: Uncertainty | None) -> Iterator[tuple[int, se2.Pose]]:
    """Yield submaps with their poses in the other map: where walls coincide, most wall length first.

    In turn with them, if it may be anywhere: where the points of the last submap fit, the best first.
    """
    found = [
        (alignment.length, row, alignment.pose)
        for row, submap in enumerate(new.submaps)
        for alignment in align_candidates(submap.scan.descriptor, old.index)
        if near is None or near.admits(submap, alignment.pose)
    ]
    on_walls = [(row, pose) for _, row, pose in sorted(found, key=lambda candidate: -candidate[0])]
    last = len(new.submaps) - 1
    if near is not None:
        yield from (*on_walls, (last, new.submaps[last].pose))
        return
    on_grid = [(last, pose) for pose in search_grid(new.submaps[last], old, MAX_REFINED)]
    for pair in zip_longest(on_walls, on_grid):
        yield from (candidate for candidate in pair if candidate is not None)


def _refine(new: ScannedDrive, old: ScannedMap, first: int, pose: se2.Pose) -> Placement:
    """Return the placement of all submaps if the `first` one is at `pose`: the best predicted one next."""
    count = len(new.submaps)
    poses, informations = np.zeros((count, 3)), np.zeros((count, 3, 3))
    predicted = {first: (pose, np.diag(ALIGNMENT_SIGMAS**2))}
    placed: set[int] = set()
    while predicted:
        row = min(predicted, key=lambda k: position_sigma(predicted[k][1]))
        pose, covariance = predicted.pop(row)
        prediction, points = Prediction(pose, np.linalg.inv(covariance)), new.submaps[row].points.points
        if row == first:
            match = match_from(old.field, points, pose, prediction)
        else:
            match = _match_within(old.field, points, prediction)
        poses[row], informations[row] = match.pose, match.information / POINTS_PER_OBJECT
        refined = np.linalg.inv(informations[row] + prediction.information)
        placed.add(row)
        for other in range(count):
            if other in placed or (row, other) not in new.relations:
                continue
            relative, drift = new.relations[row, other]
            adjoint = se2.adjoint(se2.inverse(relative))
            covariance = adjoint @ refined @ adjoint.T + drift
            if other not in predicted or position_sigma(covariance) < position_sigma(predicted[other][1]):
                predicted[other] = se2.compose(match.pose, relative), covariance
    pairs = zip(new.submaps, poses, strict=True)
    cost = sum(point_cost(old.field, submap.points.points, pose)[0] for submap, pose in pairs)
    return Placement(poses, informations, cost)


def _match_within(field: DistanceField, points: Floats, prediction: Prediction) -> PointMatch:
    """Return the match of a submap's points (p, 6), or its prediction, without information, if that excludes the match.

    What was moved, or only looks alike, fits best beside its place. A prediction of a scan match has a wide tail, as
    wheels may slip; the submaps of a map have been matched with each other.
    """
    match = match_points(field, points, [prediction], exhaustive=True)[0]
    if prediction.squared_distance(match.pose) < MAX_SQUARED_DISTANCE:
        return match
    return replace(match, pose=prediction.pose, information=np.zeros((3, 3)))


def matched_walls(new: ScannedDrive, old: ScannedMap, submap: int, pose: se2.Pose) -> Integers:
    """Return the landmark ids (n, 2) of walls, of the old and of the new map, that coincide with a submap at `pose`."""
    descriptor = new.submaps[submap].scan.descriptor
    alignment = align_submap(pose, descriptor, sample_walls(descriptor), old.index.descriptor)
    if are_distinct(alignment.pose, pose):
        return np.zeros((0, 2), dtype=np.int64)
    matched = np.flatnonzero(alignment.matches >= 0)
    return np.column_stack([old.index.descriptor.walls[alignment.matches[matched]], descriptor.walls[matched]])
