"""Restore stamps whose microseconds were written without leading zeros.

Some loggers print the seconds and the microseconds of a clock as two integers with a point between them. 0.081719 s is
then written as `0.81719`, and as `0.817190` after a second program has read and printed it as a number: a fraction
below a tenth is written ten, a hundred, etc. times too large. About one stamp of ten is affected; it is up to 0.9 s
late, and the stamps after it seem to go back.

Such a log has no fraction that begins with a zero. A fraction that ends with zeros may have lost as many leading ones,
or none: that is decided by the order of the lines, which is the order in which the measurements reached the logger.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

MICROSECONDS = 1_000_000
MIN_STAMPS = 200
"""Stamps from which a missing leading zero is significant. Origin: binomial; 0.9^200 is below 1e-9."""
MAX_DIGITS = 12
"""Digits of the seconds at most: more microseconds do not fit into 64 bits. Origin: definition."""
MIN_EXPLAINED = 0.9
"""Least share of the backward steps that disappears. Origin: chosen; either they have this cause or another."""


def restore_microseconds(stamps: Iterable[bytes]) -> list[float] | None:
    """Return the stamps in seconds if their microseconds were written without leading zeros, None if they were not.

    stamps  as written, in the order of the lines: decimal numbers with at most six decimals

    Of all readings of the fractions that end with zeros, the one is returned whose stamps go back least in sum, and
    among these, the one with the most even steps (least sum of their squares), since sensors measure periodically.
    """
    candidates: list[list[int]] = []
    for stamp in stamps:
        seconds, _, fraction = stamp.partition(b".")
        known = seconds.isdigit() and len(seconds) <= MAX_DIGITS and fraction.isdigit() and len(fraction) <= 6
        if not known or fraction.startswith(b"0"):
            return None  # nearly always within the first stamps
        candidates.append(_readings(int(seconds), fraction.ljust(6, b"0")))
    if len(candidates) < MIN_STAMPS:
        return None
    restored = _most_orderly(candidates)
    before, after = _backward_steps([written for written, *_ in candidates]), _backward_steps(restored)
    if before == 0 or after > (1.0 - MIN_EXPLAINED) * before:
        return None
    return [stamp / MICROSECONDS for stamp in restored]


def _readings(seconds: int, fraction: bytes) -> list[int]:
    """Return the microseconds that a stamp with six decimals may mean, the value as written first."""
    readings = [seconds * MICROSECONDS + int(fraction)]
    while fraction.endswith(b"0"):
        fraction = fraction[:-1]
        readings.append(seconds * MICROSECONDS + int(fraction))
    return readings


def _most_orderly(candidates: Sequence[Sequence[int]]) -> list[int]:
    """Return one candidate of each stamp such that the sequence goes back least, and has the most even steps.

    Dynamic programming over the stamps: the best sequence that ends with each candidate of one stamp extends the best
    sequence that ends with one of the candidates of the stamp before.
    """
    costs = [(0, 0)] * len(candidates[0])  # sum of the backward steps; sum of all steps squared
    origins: list[list[int]] = []
    for previous, current in pairwise(candidates):
        best = []
        for stamp in current:
            extended = []
            for index, (back, squares) in enumerate(costs):
                step = stamp - previous[index]
                extended.append((back + max(0, -step), squares + step * step, index))
            best.append(min(extended))
        costs = [(back, squares) for back, squares, _ in best]
        origins.append([index for *_, index in best])
    index = costs.index(min(costs))
    restored = [candidates[-1][index]]
    for origin, stamps in zip(reversed(origins), reversed(candidates[:-1]), strict=True):
        index = origin[index]
        restored.append(stamps[index])
    return restored[::-1]


def _backward_steps(stamps: Sequence[int]) -> int:
    return sum(later < earlier for earlier, later in pairwise(stamps))
