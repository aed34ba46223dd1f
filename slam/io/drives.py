"""Drives of a path that was driven in several, as in a merged map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from .tum import Trajectory


def split_drives(trajectory: Trajectory, recordings: Sequence[Mapping[str, Any]]) -> list[Trajectory]:
    """Return the trajectories of the drives: what leads from one to the next is not known, and not to be drawn.

    recordings  entries of `recordings` in `summary.json`, each with its `first` and `last` stamp, seconds; those
                without numbers are ignored

    Drives are separated in the middle between two recordings, as delays move some stamps.
    """
    spans = sorted((one["first"], one["last"]) for one in recordings if _has_span(one))
    middles = [0.5 * (before + after) for (_, before), (after, _) in pairwise(spans)]
    rows = np.unique(np.searchsorted(trajectory.stamps, middles))
    rows = rows[(rows > 0) & (rows < len(trajectory))]
    if not len(rows):
        return [trajectory]
    parts = zip(np.split(trajectory.stamps, rows), np.split(trajectory.poses, rows), strict=True)
    return [Trajectory(stamps, poses) for stamps, poses in parts]


def _has_span(recording: Mapping[str, Any]) -> bool:
    return all(isinstance(recording.get(name), int | float) for name in ("first", "last"))
