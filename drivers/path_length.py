"""Length of a driven path: the motion beyond the jitter of a robot that stands."""

from __future__ import annotations

import math

from .messages import Floats

# Metres between the positions that the length is summed over. Origin: chosen, above the jitter of positions from scan
# matching, some millimetres with the noisiest lidars; a curve of 0.3 m radius is measured 0.1 % too short.
MIN_STEP = 0.05


def path_length(positions: Floats) -> float:
    """Return the length (metres) of a path through `positions` (n, 2), over steps of at least MIN_STEP.

    So the length does not grow with the time for which a robot stands, though its position jitters.
    """
    if not len(positions):
        return 0.0
    length, rest = 0.0, 0.0
    from_x, from_y = positions[0].tolist()
    for x, y in positions.tolist():
        rest = math.hypot(x - from_x, y - from_y)
        if rest >= MIN_STEP:
            length, from_x, from_y, rest = length + rest, x, y, 0.0
    return length + rest
