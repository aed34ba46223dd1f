"""Removal of the estimated range bias from the features of a scan."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..geometry.segments import CornerPoints, Segments, without_range_bias
from .line_matcher import ScanFeatures


def correct_range_bias(features: ScanFeatures, bias: float) -> ScanFeatures:
    """Return the features of a scan as if all its ranges were shorter by `bias` metres; its points stay as they are.

    Points are matched to points of earlier scans, which have the same bias.
    """
    if not bias:
        return features
    segments, corners = without_range_bias(features.segments, features.corners, bias)
    return replace(features, segments=segments, corners=corners)


def correct_range_bias_of_scans(scans: Sequence[ScanFeatures], bias: float) -> list[ScanFeatures]:
    """Return the features of several scans as `correct_range_bias` does, in one step for all of them."""
    if not bias or not scans:
        return list(scans)
    segments, corners = [scan.segments for scan in scans], [scan.corners for scan in scans]
    ends, corner_ends = np.cumsum([len(one) for one in segments]), np.cumsum([len(one) for one in corners])
    starts = ends - [len(one) for one in segments]
    all_segments = Segments(
        np.concatenate([one.frame for one in segments]),
        np.concatenate([one.half_length for one in segments]),
        np.concatenate([one.covariance for one in segments]),
        np.concatenate([one.bias_slope for one in segments]),
    )
    all_corners = CornerPoints(
        np.concatenate([one.position for one in corners]),
        np.concatenate([one.covariance for one in corners]),
        np.concatenate([one.segments + start for one, start in zip(corners, starts.tolist(), strict=True)]),
        np.concatenate([one.headings for one in corners]),
    )
    moved, moved_corners = without_range_bias(all_segments, all_corners, bias)
    rows, corner_rows = _slices(ends.tolist()), _slices(corner_ends.tolist())
    return [
        replace(
            scan,
            segments=replace(scan.segments, frame=moved.frame[row]),
            corners=replace(scan.corners, position=moved_corners.position[at], headings=moved_corners.headings[at]),
        )
        for scan, row, at in zip(scans, rows, corner_rows, strict=True)
    ]


def _slices(ends: Sequence[int]) -> Iterator[slice]:
    """Yield the slices of consecutive rows that end at `ends`."""
    start = 0
    for end in ends:
        yield slice(start, end)
        start = end
