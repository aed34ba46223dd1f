"""Fisher's exact test of whether scans of two drives see through a stretch of a wall equally often."""

from __future__ import annotations

import math
from typing import NamedTuple


class Votes(NamedTuple):
    """Numbers of scans that see through a stretch of a wall, and that see the wall there."""

    through: int
    seen: int


def exact_p_value(votes: Votes, other: Votes) -> float:
    """Return the probability that so many scans of a drive see through, or more, if both drives are equally likely to.

    votes  of this drive
    other  of the other one

    Given how many see through in all, the number of those of one drive has a hypergeometric distribution.
    """
    through, count, others = votes.through + other.through, sum(votes), sum(other)
    ways, tail = math.comb(count, votes.through) * math.comb(others, other.through), 0
    for k in range(votes.through, min(count, through) + 1):
        tail += ways
        ways = ways * (count - k) * (through - k) // ((k + 1) * (others - through + k + 1))
    return tail / math.comb(count + others, through)
