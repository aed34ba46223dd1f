"""Returns to known places: looks at old places that agree with the estimate, so that no loop has to be closed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers import se2

from .decision import LoopMatch
from .look import Look
from .submap_search import REVISIT_GAP, SubmapMatch


@dataclass(frozen=True, slots=True)
class Return:
    """Look that agrees with the estimate.

    match           of the look with an old place
    position, turn  distance (metres) and angle (radians) of the estimated pose from the one that fits the old place
    """

    match: LoopMatch
    position: float
    turn: float

    @classmethod
    def of(cls, look: Look, old: int, match: SubmapMatch) -> Return:
        """Return the record of a look's match with an old place."""
        x, y, turn = se2.between(look.relative(old, np.zeros(3)), match.pose).tolist()
        return cls(look.loop_match(old, match), float(np.hypot(x, y)), abs(turn))


def summarise(returns: Sequence[Return]) -> dict[str, float]:
    """Return how often the robot returned, the looks, and how well the map fitted there, RMS and largest (metres)."""
    if not returns:
        return {"count": 0, "looks": 0}
    gaps = np.diff([one.match.travelled for one in returns])
    position = np.array([one.position for one in returns])
    return {
        "count": 1 + int((gaps > REVISIT_GAP).sum()),
        "looks": len(returns),
        "position_rms": round(float(np.sqrt(np.mean(position**2))), 4),
        "position_max": round(float(position.max()), 4),
    }
