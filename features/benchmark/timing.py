"""Time of the extraction on simulated rooms."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from ..arras_siegwart import direction_by_double_sums
from ..estimators import ESTIMATORS
from ..extract import Extractor, warm_up
from ..line_fit import ray_arrays
from ..types import Floats, Noise

NOISE = Noise(sigma_range=0.01, sigma_bearing=0.001)
BEAMS = (180, 360, 920, 1100)
# Metres; size of the rooms.
SIZE = (7.0, 5.0)
# Number of rays of the reference: the most of a line in the environments of the paper.
REFERENCE_RAYS = 230
# Rounds of the reference timed with one extractor. The position of its arrays in memory changes its speed by up to a
# tenth, which no number of rounds averages out.
ROUNDS_PER_EXTRACTOR = 250


class Row(NamedTuple):
    """One measurement: method, number of beams, mean number of lines per scan, microseconds per scan.

    Median and 99th percentile are over all calls. `best_us` is the median over scans of the fastest call of each, which
    is least affected by other processes, and `compiled_us` the same for the compiled function alone.
    """

    name: str
    beams: int
    lines: float
    median_us: float
    p99_us: float
    best_us: float
    compiled_us: float


def run(*, beams: Sequence[int] = BEAMS, scans: int = 100, rounds: int = 10, seed: int = 0) -> list[Row]:
    """Time every estimator, and the paper's tracking, on `scans` scans, `rounds` times each, after a warm-up.

    Names are method/estimator. Times are of complete calls of Extractor.extract on one core.
    """
    warm_up()
    rows = []
    for count in beams:
        angles, ranges = scans_of(count, scans, seed)
        for estimator in ESTIMATORS:
            rows.append(measure("split", estimator, ranges, angles, rounds))
        rows.append(measure("tracking", "wclm", ranges, angles, rounds))
    return rows


def scans_of(beams: int, scans: int, seed: int) -> tuple[Floats, list[Floats]]:
    """Return bearings (n,), and the ranges (n,) of `scans` rooms."""
    angles = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    rng = np.random.default_rng(seed)
    return angles, [room_scan(rng, angles) for _ in range(scans)]


def measure(
    method: Literal["split", "tracking"], estimator: str, ranges: list[Floats], angles: Floats, rounds: int
) -> Row:
    """Time one method on scans with the same bearings."""
    extractor = Extractor(NOISE, method=method, estimator=estimator)
    lines = [len(extractor.extract(scan, angles).lines) for scan in ranges]
    times, inside = np.empty((rounds, len(ranges))), np.empty((rounds, len(ranges)))
    for of_round, compiled in zip(times, inside, strict=True):
        for k, scan in enumerate(ranges):
            start = time.perf_counter()
            extractor.extract(scan, angles)
            middle = time.perf_counter()
            extractor.run_kernel()
            of_round[k], compiled[k] = middle - start, time.perf_counter() - middle
    median, p99 = np.percentile(times, (50, 99)) * 1e6
    best, within = (float(np.median(each.min(axis=0))) * 1e6 for each in (times, inside))
    return Row(f"{method}/{estimator}", len(angles), float(np.mean(lines)), float(median), float(p99), best, within)


def relative(*, beams: int = 920, scans: int = 20, rounds: int = 2000, seed: int = 0) -> tuple[float, float]:
    """Return the time of a scan relative to a reference, and the reference in microseconds.

    The reference is eq. (27) of the paper as printed, double sums over 230 rays: compiled scalar code, independent of
    the extractor. Both are timed alternately and the fastest of each counts, so that neither a slower processor nor
    its load changes the ratio much. All rounds together take more than a second: during a tenth of a second another
    program may slow down every one of them. Extractors with other positions in memory are timed in turn.
    """
    angles, ranges = scans_of(beams, scans, seed)
    extractors = [Extractor(NOISE, adapt_noise=False) for _ in range(0, rounds, ROUNDS_PER_EXTRACTOR)]
    line = ray_arrays(ranges[0][:REFERENCE_RAYS], angles[:REFERENCE_RAYS])
    direction_by_double_sums(*line)
    for extractor in extractors:  # allocates its arrays
        extractor.extract(ranges[0], angles)
    times, reference = np.empty((rounds, scans)), np.empty(rounds)
    for k in range(rounds):
        extractor = extractors[k // ROUNDS_PER_EXTRACTOR]
        start = time.perf_counter()
        direction_by_double_sums(*line)
        reference[k] = time.perf_counter() - start
        for i, scan in enumerate(ranges):
            start = time.perf_counter()
            extractor.extract(scan, angles)
            times[k, i] = time.perf_counter() - start
    unit = float(reference.min())
    return float(np.median(times.min(axis=0))) / unit, unit * 1e6


def room_scan(rng: np.random.Generator, angles: Floats) -> Floats:
    """Return ranges (n,) at a random position in a room with a niche in one wall and a cabinet at another."""
    width, height = SIZE
    niche, cabinet = rng.uniform(0.15, 0.6, 2) * width
    outline = [(0, 0), (cabinet, 0), (cabinet, 0.4), (cabinet + 1, 0.4), (cabinet + 1, 0), (width, 0), (width, height)]
    outline += [(niche + 1, height), (niche + 1, height + 0.3), (niche, height + 0.3), (niche, height), (0, height)]
    start = np.array(outline, dtype=np.float64) - rng.uniform(0.3, 0.7, 2) * SIZE
    along = np.roll(start, -1, axis=0) - start
    bearings = angles + rng.uniform(-np.pi, np.pi) + rng.normal(0.0, NOISE.sigma_bearing, len(angles))
    c, s = np.cos(bearings)[:, None], np.sin(bearings)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        cross = c * along[:, 1] - s * along[:, 0]
        distance = (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]) / cross
        share = (start[:, 0] * s - start[:, 1] * c) / cross
        hit = np.where((distance > 0.0) & (share >= 0.0) & (share <= 1.0), distance, np.inf).min(axis=1)
    return np.asarray(hit + rng.normal(0.0, NOISE.sigma_range, len(angles)))
