"""Convert the features and points of scans to table columns and back.

In the table of all scans, walls and corners are stored in single precision (1e-6 m at a range of 10 m) and points as
integer millimetres: they are measured less accurately than that. With `exact`, all are stored in double precision.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ...bounds import MAX_COORDINATE, MAX_DEVIATION
from ...errors import MapError
from ...geometry.segments import CornerPoints, Floats, Integers, Segments
from ...matching.scan_features import ScanFeatures
from ...matching.scan_points import MAX_POINT_UNITS, POINT_UNIT, ScanPoints
from .tables import Ragged, TableReader, are_covariances, to_ragged

Number = TypeVar("Number", bound=np.generic)
SEGMENT_COLUMNS = (
    *("x", "y", "heading", "half_length", "offset_offset", "offset_heading", "heading_heading"),
    *("offset_bias_slope", "heading_bias_slope"),
)
SEGMENT_LIMITS = *4 * (MAX_COORDINATE,), *3 * (MAX_DEVIATION**2,), *2 * (MAX_COORDINATE,)
CORNER_COLUMNS = ("x", "y", "xx", "xy", "yy")
CORNER_LIMITS = *2 * (MAX_COORDINATE,), *3 * (MAX_DEVIATION**2,)
POINT_COLUMNS = ("point_x", "point_y")
SWEEP_COLUMN = "sweep_covariance"
"""Upper triangles of the sweep covariances. Earlier versions had them in the covariances of segments and corners."""
SIGMA_COLUMN = "point_sigma"
"""Standard deviations of the ranges of points. Earlier versions had none."""
UPPER_TRIANGLE = np.triu_indices(3)
MIN_HALF_LENGTH = 1e-3
"""Smallest half length of a line, metres: those of scans have some decimetres."""
# Share of a covariance's trace by which an eigenvalue may be negative, as entries are rounded. Origin: numerical, some
# units of single precision.
ROUNDED = 1e-6
# Smallest difference of a correlation of two coordinates of a feature from one. Origin: numerical, some units of single
# precision.
MIN_DECORRELATION = 1e-6


def feature_columns(scans: Sequence[ScanFeatures], *, exact: bool) -> dict[str, Ragged]:
    """Return the columns of features and points, with a row for each of the n scans."""
    dtype = np.float64 if exact else np.float32
    columns: dict[str, Ragged] = {}
    segments, corners = [scan.segments for scan in scans], [scan.corners for scan in scans]
    counts, corner_counts = (np.array([len(one) for one in of], dtype=np.int64) for of in (segments, corners))
    frame, slope = _joined([s.frame for s in segments], (3,)), _joined([s.bias_slope for s in segments], (2,))
    half_length = _joined([s.half_length for s in segments], ())
    values = [*frame.T, half_length, *_upper_triangles([s.covariance for s in segments]), *slope.T]
    for name, column in zip(SEGMENT_COLUMNS, values, strict=True):
        columns[f"segment_{name}"] = Ragged(column.astype(dtype), counts)
    values = [*_joined([c.position for c in corners], (2,)).T, *_upper_triangles([c.covariance for c in corners])]
    for name, column in zip(CORNER_COLUMNS, values, strict=True):
        columns[f"corner_{name}"] = Ragged(column.astype(dtype), corner_counts)
    for k, name in enumerate(("before", "after")):
        columns[f"corner_{name}"] = to_ragged([scan.corners.segments[:, k] for scan in scans], np.int32)
    columns[SWEEP_COLUMN] = to_ragged([scan.sweep_covariance[UPPER_TRIANGLE] for scan in scans], dtype)
    columns[SIGMA_COLUMN] = to_ragged([np.array([scan.points.sigma]) for scan in scans], np.float32)
    return columns | _point_columns([scan.points.xy for scan in scans], exact=exact)


def _joined(arrays: Sequence[Floats], shape: tuple[int, ...]) -> Floats:
    """Return arrays (m, ...) with rows of a shape as one array; empty without arrays."""
    return np.concatenate([np.zeros((0, *shape)), *arrays])


def _upper_triangles(covariances: Sequence[Floats]) -> Floats:
    """Return (3, n) the upper triangles of covariances (m, 2, 2), joined, without correlations of nearly one.

    In single precision these, as of segments whose motion during the sweep is hardly known, would be rounded to one.
    They become so much smaller that what is read is not changed again.
    """
    upper = _joined(covariances, (2, 2))[:, [0, 0, 1], [0, 1, 1]].T
    first, mixed, second = upper.astype(np.float32).astype(np.float64)
    singular = np.abs(mixed) > (1.0 - MIN_DECORRELATION) * np.sqrt((first * second).clip(min=0.0))
    full = np.sqrt(upper[0, singular] * upper[2, singular])
    upper[1, singular] = (1.0 - 2.0 * MIN_DECORRELATION) * np.copysign(full, upper[1, singular])
    return upper


def _point_columns(points: Sequence[Floats], *, exact: bool) -> dict[str, Ragged]:
    lengths, columns = np.array([len(values) for values in points], dtype=np.int64), {}
    for k, name in enumerate(POINT_COLUMNS):
        column = Ragged(np.concatenate([np.zeros(0), *(values[:, k] for values in points)]), lengths)
        columns[name] = column if exact else _to_point_units(column)
    return columns


def _to_point_units(column: Ragged) -> Ragged:
    """Return coordinates (metres) as numbers of POINT_UNIT; those of the column are overwritten, to save memory."""
    counts = np.divide(column.values, POINT_UNIT, out=column.values)
    np.rint(counts, out=counts)
    np.clip(counts, -MAX_POINT_UNITS, MAX_POINT_UNITS, out=counts)
    return Ragged(counts.astype(np.int32), column.lengths)


def read_features(table: TableReader, file: Path, *, exact: bool) -> list[ScanFeatures]:
    """Read the columns of features and points of all rows. Raises MapError naming the file."""
    values, lengths = table.ragged_floats(*(f"segment_{name}" for name in SEGMENT_COLUMNS), limit=SEGMENT_LIMITS)
    if (values[:, 3] < MIN_HALF_LENGTH).any():
        raise MapError(f"{file}: a segment is shorter than {2.0 * MIN_HALF_LENGTH:g} m")
    segments = split_rows(values, lengths)
    corners = split_rows(*table.ragged_floats(*(f"corner_{name}" for name in CORNER_COLUMNS), limit=CORNER_LIMITS))
    pairs = split_rows(*table.ragged_integers("corner_before", "corner_after"))
    points, sweeps = _read_points(table, exact=exact), _read_sweep_covariances(table, file)
    sigmas = _read_sigmas(table, file)
    contiguous = np.ascontiguousarray  # as in a run: compiled functions need not be compiled for another layout
    scans = []
    for name, rows, first in (("segment", segments, 4), ("corner", corners, 2)):
        upper = np.concatenate([np.zeros((0, first + 3)), *(values[:, : first + 3] for values in rows)])[:, first:]
        if not are_covariances(upper[:, [0, 1, 1, 2]].reshape(-1, 2, 2)):
            raise MapError(f"{file}: the covariance of a {name} is not positive definite")
    for row in range(len(table)):
        frame = contiguous(segments[row][:, :3])
        if len(pairs[row]) != len(corners[row]) or not ((pairs[row] >= 0) & (pairs[row] < len(frame))).all():
            raise MapError(f"{file}: a corner refers to segments that do not exist")
        scans.append(
            ScanFeatures(
                Segments(
                    frame,
                    contiguous(segments[row][:, 3]),
                    contiguous(segments[row][:, [4, 5, 5, 6]]).reshape(-1, 2, 2),
                    contiguous(segments[row][:, 7:]),
                ),
                CornerPoints(
                    contiguous(corners[row][:, :2]),
                    contiguous(corners[row][:, [2, 3, 3, 4]]).reshape(-1, 2, 2),
                    pairs[row],
                    frame[pairs[row], 2].reshape(-1, 2),
                ),
                ScanPoints(points[row], sigmas[row]),
                sweeps[row],
            )
        )
    return scans


def are_rounded_from(rounded: Sequence[ScanFeatures], exact: Sequence[ScanFeatures]) -> bool:
    """Return True if the features that were stored with reduced precision are those of the exact ones."""
    before, after = (feature_columns(features, exact=False) for features in (rounded, exact))
    return all(
        np.array_equal(before[name].lengths, after[name].lengths)
        and np.array_equal(before[name].values, after[name].values)
        for name in before
    )


def _read_sweep_covariances(table: TableReader, file: Path) -> Floats:
    """Return the sweep covariances (n, 3, 3), zero for scans without. Raises MapError naming the file."""
    covariances = np.zeros((len(table), 3, 3))
    if SWEEP_COLUMN not in table:
        return covariances
    values, lengths = table.ragged_floats(SWEEP_COLUMN)
    rows = np.flatnonzero(lengths)
    if not np.isin(lengths, (0, len(UPPER_TRIANGLE[0]))).all():
        raise MapError(f"{file}: a sweep covariance does not have {len(UPPER_TRIANGLE[0])} entries")
    for k, (i, j) in enumerate(zip(*UPPER_TRIANGLE, strict=True)):
        covariances[rows, i, j] = covariances[rows, j, i] = values[k :: len(UPPER_TRIANGLE[0]), 0]
    if (np.linalg.eigvalsh(covariances) < -ROUNDED * np.trace(covariances, axis1=1, axis2=2)[:, None]).any():
        raise MapError(f"{file}: a sweep covariance has a negative variance")
    return covariances


def _read_sigmas(table: TableReader, file: Path) -> list[float]:
    """Return the standard deviations of the ranges of points, 0 for scans without. Raises MapError naming the file."""
    if SIGMA_COLUMN not in table:
        return [0.0] * len(table)
    values, lengths = table.ragged_floats(SIGMA_COLUMN)
    if lengths.max(initial=0) > 1 or (values < 0.0).any():
        raise MapError(f"{file}: a standard deviation of points is negative, or there are several for one scan")
    sigmas = np.zeros(len(table))
    sigmas[lengths > 0] = values[:, 0]
    return sigmas.tolist()


def _read_points(table: TableReader, *, exact: bool) -> list[Floats]:
    if exact:
        return split_rows(*table.ragged_floats(*POINT_COLUMNS, limit=MAX_COORDINATE))
    counts, lengths = table.ragged_integers(*POINT_COLUMNS)
    return split_rows(POINT_UNIT * counts.astype(np.float64), lengths)


def split_rows(values: NDArray[Number], lengths: Integers) -> list[NDArray[Number]]:
    """Return the values of each row of a ragged column."""
    return np.split(values, np.cumsum(lengths)[:-1]) if len(lengths) else []
