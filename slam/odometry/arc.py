"""Motions along arcs: how their chords point."""

from __future__ import annotations

import math

import numpy as np

from drivers import se2

from ..geometry.segments import Floats


def with_turn(motion: se2.Pose, turn: float | Floats) -> se2.Pose:
    """Return motions (..., 3) that turn by another angle `turn` (...,), radians, along an arc of the same length.

    The chord of an arc points ahead by half its turn, so the direction changes by half the difference.
    """
    if motion.ndim == 1:
        ahead, left, before = motion.tolist()
        half = 0.5 * (float(turn) - before)
        cosine, sine = math.cos(half), math.sin(half)
        return np.array([cosine * ahead - sine * left, sine * ahead + cosine * left, float(se2.wrap(turn))])
    bend = 0.5 * (turn - motion[..., 2])
    x, y = motion[..., 0], motion[..., 1]
    c, s = np.cos(bend), np.sin(bend)
    turned = np.empty(motion.shape)
    turned[..., 0], turned[..., 1], turned[..., 2] = c * x - s * y, s * x + c * y, se2.wrap(turn)
    return turned
