"""Format the tables of `wclm bench features`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np

from features.benchmark.accuracy import Row
from features.benchmark.start import Start
from features.benchmark.timing import Row as Time


def accuracy_table(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the accuracy of walls and corners by noise level."""
    yield ""
    yield "Rooms with recesses, cabinets and boxes. NEES of two dimensions: mean (expected 2) / median (expected 1.39)"
    for level, same in groupby(rows, key=_level):
        yield ""
        yield (
            f"{level:<28} precision  recall  corner recall  false corners  error mm (rms)"
            "     corner NEES       line NEES"
        )
        for row in same:
            error = f"{1000 * row.corner_error:.1f} ({1000 * row.corner_rms:.1f})"
            yield (
                f"{row.method:<28} {row.precision:9.4f} {row.recall:7.4f} {row.corner_recall:14.4f} "
                f"{row.false_corners:14.4f}  {error:>14}  {_pair(row.corner_nees, row.corner_nees_median):>14}  "
                f"{_pair(row.line_nees, row.line_nees_median):>14}"
            )


def curved_table(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the features extracted on arcs and columns, by noise level."""
    yield ""
    yield "Rooms with four round columns and an arc: features per curve"
    for level, same in groupby(rows, key=_level):
        yield ""
        yield f"{level:<28} curves  lines each  corners each  walls found"
        for row in same:
            yield (
                f"{row.method:<28} {row.curves:6d} {row.curved_lines:11.2f} "
                f"{row.curved_corners:13.3f} {row.recall:12.4f}"
            )


def time_table(rows: Sequence[Time], relative: tuple[float, float]) -> Iterator[str]:
    """Yield the extraction times per scan; `relative` is the ratio to the reference and the reference, microseconds."""
    ratio, reference = relative
    yield ""
    yield "Microseconds per scan, one core, warm. best: fastest call of each scan; compiled: without Python's overhead"
    yield "method/estimator      beams  lines   median   99 %    best  compiled"
    for row in rows:
        yield (
            f"{row.name:<21} {row.beams:5d} {row.lines:6.1f} {row.median_us:8.1f} {row.p99_us:6.1f} "
            f"{row.best_us:7.1f} {row.compiled_us:9.1f}"
        )
    yield f"920 beams take {ratio:.2f} times a reference of {reference:.1f} us, timed alternately"


def start_table(rows: Sequence[Start]) -> Iterator[str]:
    """Yield the cost and benefit of compilation."""
    yield ""
    yield "Processor seconds           import  first scan  later scans us  memory MB  of it NumPy and Python"
    for row in rows:
        yield (
            f"{row.name:<25} {row.import_s:8.2f} {row.first_scan_s:11.2f} {row.scan_us:15.1f} {row.memory_mb:10.0f} "
            f"{row.numpy_mb:23.0f}"
        )


def _level(row: Row) -> str:
    noise = f"{100 * row.sigma_range:g} cm, {np.degrees(row.sigma_bearing):.3g} deg"
    return noise + (f", {100 * row.outliers:g} % outliers" if row.outliers else "")


def _pair(mean: float, median: float) -> str:
    return f"{mean:.2f} / {median:.2f}"
