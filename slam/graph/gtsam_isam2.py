"""GTSAM's iSAM2 with the parameters of this project, and its reconstruction with another elimination."""

from __future__ import annotations

import gtsam
import numpy as np

# Change of a variable beyond which it is relinearised: metres along its axes and radians. Factors are linear in
# positions but not in headings, so the threshold on the heading is the small one.
# Origin: measured, a quarter less time than 0.05 m and rad on every axis, with no worse results.
RELINEARIZE_POSE = np.array([0.2, 0.2, 0.02])
# The same for a wall's frame (along, across, heading). Origin: definition, as it may slide along the wall.
RELINEARIZE_WALL = RELINEARIZE_POSE * np.array([2.0, 1.0, 1.0])
# Metres; the same for a corner. Origin: definition.
RELINEARIZE_CORNER = RELINEARIZE_POSE[:2]
# The same by the characters of the variables' keys.
THRESHOLDS = {"x": RELINEARIZE_POSE, "p": RELINEARIZE_POSE, "l": RELINEARIZE_WALL, "c": RELINEARIZE_CORNER}
# Updates, each with some keyframes, from one relinearisation to the next. Origin: measured, on a recording of 1900
# keyframes: with every tenth, online poses differ three times as much from those of solving at each keyframe, for 6 %
# less time.
RELINEARIZE_SKIP = 3


def empty_isam2(*, qr: bool) -> gtsam.ISAM2:
    """Return an iSAM2 without factors, which eliminates by QR if `qr`, else by Cholesky."""
    parameters = gtsam.ISAM2Params()
    thresholds = gtsam.ISAM2ThresholdMap()
    for symbol, threshold in THRESHOLDS.items():
        thresholds.insert((symbol, threshold))
    parameters.setRelinearizeThreshold(thresholds)
    parameters.relinearizeSkip = RELINEARIZE_SKIP
    parameters.setFactorization("QR" if qr else "CHOLESKY")
    return gtsam.ISAM2(parameters)


def rebuilt_by_qr(isam: gtsam.ISAM2) -> tuple[gtsam.ISAM2, dict[int, int]]:
    """Return an iSAM2 with the same factors and linearisation points that eliminates by QR.

    Returns also the numbers of its factors by those of `isam`, whose removed factors have left empty slots.
    Raises RuntimeError if QR fails as well.
    """
    slots, factors, renumbered = isam.getFactorsUnsafe(), gtsam.NonlinearFactorGraph(), {}
    for number in range(slots.size()):
        if slots.at(number) is not None:
            renumbered[number] = factors.size()
            factors.add(slots.at(number))
    rebuilt = empty_isam2(qr=True)
    rebuilt.update(factors, isam.getLinearizationPoint())
    return rebuilt, renumbered
