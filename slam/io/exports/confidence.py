"""Confidence map of a run: standard deviations of its walls by place, and its weak places."""

from __future__ import annotations

import numpy as np

from drivers.immutable import immutable

from ...checks.weak_places import KeyframePath, WeakPlace, find_weak_places, sigma_across
from ...errors import MapError
from ...geometry.segments import Floats
from ...mapping.map_features import MapWalls
from ..output_dir import SUMMARY
from ..run_results import RunResults

CLASS_LIMITS = (0.02, 0.05, 0.1, 0.2)
"""Standard deviations, metres, between the classes that drawings have colours for."""
STEP = 0.25
"""Metres along a wall between the places at which its standard deviation is computed."""


@immutable
class WallStretch:
    """A stretch of a wall, all of it in one class of uncertainty.

    identity  landmark id of the wall
    points    (2, 2) its ends in the map, metres
    level     number of CLASS_LIMITS that its standard deviations are not below
    sigma     largest standard deviation across the wall, metres
    """

    identity: int
    points: Floats
    level: int
    sigma: float


def wall_stretches(walls: MapWalls) -> list[WallStretch]:
    """Return the observed pieces of all walls with a covariance, split where the class changes."""
    stretches = []
    for row in range(len(walls)):
        if not np.isfinite(walls.covariance[row]).all():
            continue
        x, y, heading = walls.frame[row]
        direction = np.array([np.cos(heading), np.sin(heading)])
        for low, high in walls.pieces[row]:
            ends = np.linspace(low, high, 1 + max(1, round((high - low) / STEP)))
            sigma = sigma_across(walls, row, ends)
            step_sigma = np.maximum(sigma[:-1], sigma[1:])
            level = np.searchsorted(CLASS_LIMITS, step_sigma, side="right")
            bounds = np.concatenate([[0], np.flatnonzero(np.diff(level)) + 1, [len(level)]])
            for start, end in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
                points = np.array([x, y]) + ends[[start, end], None] * direction
                stretches.append(
                    WallStretch(int(walls.identity[row]), points, int(level[start]), float(step_sigma[start:end].max()))
                )
    return stretches


def weak_places(results: RunResults) -> list[WeakPlace]:
    """Return the weak places of a run; none if its keyframes are unknown. Raises MapError if its summary is damaged."""
    keyframes = results.keyframes
    if keyframes is None:
        return []
    try:
        parts = (results.summary.get("slam") or {}).get("parts") or []
        apart = [int(part["keyframe"]) for part in parts if not part["joined"]]
    except (LookupError, TypeError, ValueError) as error:
        raise MapError(f"{results.path / SUMMARY}: slam.parts has an entry that is not a part of a map") from error
    path = KeyframePath(keyframes.stamps, keyframes.poses[:, :2], keyframes.position_sigma())
    return find_weak_places(results.walls, path, apart)
