"""Propagation of the covariance of a pose."""

from __future__ import annotations

import numpy as np

from drivers import se2

from .segments import Floats


def covariance_after(covariance: Floats, motion: se2.Pose) -> Floats:
    """Transform the covariance (3, 3) of a pose, in its own frame, by a motion without error that follows it."""
    adjoint = se2.adjoint(se2.inverse(motion))
    return np.asarray(adjoint @ covariance @ adjoint.T)
