"""Adjustment of pins: the place of a map in the frame of a survey, and pins that are grossly wrong.

The surveyed values are compared with those of the map, by the covariance of both, at the place that fits them best by
generalised least squares. The pin whose residuals are least probable (Baarda 1968) is left out and the rest is tested
again, until no pin is significant at ERROR_RATE divided by the number of pins.

Equations, whose symbols the code uses: docs/corrections.md#wrong-pins.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import combinations, pairwise

import numpy as np
from scipy.special import chdtrc

from drivers import se2
from drivers.immutable import immutable

from ...errors import MapError
from ...geometry.segments import Floats
from .pinned_value import PinnedValue

ERROR_RATE = 1e-3
"""Probability that any correct pin is left out."""
MIN_REDUNDANCY = 1e-6
"""Share of its information with which the other pins must check a pin."""
MIN_DETERMINED = 1e-9
"""Ratio of the least to the largest eigenvalue of the scaled information of the motion if it is determined."""
SEPARABLE = 0.99
"""Share of the largest test statistic from which another one is not distinguishable from it."""
MAX_ITERATIONS = 20
CONVERGED = 1e-9
"""Metres and radians; a smaller step ends the iteration."""
SEARCH_SCALE = 4.0
"""Standard deviations at which a pin has half its weight while the motion is searched."""
SEARCH_STEPS = 5
"""Robust steps that improve each motion of the search."""
MAX_PAIRS = 200
"""Pairs of poses, the farthest ones, from which the motion is searched."""


@immutable
class Adjustment:
    """Result of an adjustment of n pins.

    motion   (3,) takes the survey into the map
    used     (n,) False for pins that are left out as grossly wrong
    p_value  (n,) probability of a difference as large as that of the pin, or larger; NaN if no other pin checks it
    chi2     of all used pins, with `dof` degrees of freedom
    """

    motion: se2.Pose
    used: np.ndarray[tuple[int], np.dtype[np.bool_]]
    p_value: Floats
    chi2: float
    dof: int


def adjust(pins: Sequence[PinnedValue], names: Sequence[str], map_covariance: Floats, *, fixed: bool) -> Adjustment:
    """Find the motion of the survey into the map, and the pins that are grossly wrong.

    names           of the pins, for errors
    map_covariance  joint one of the pins' values in the map, in their order
    fixed           True if the survey is in the frame of the map: then no motion is estimated

    Raises MapError if the pins do not determine the motion, or contradict each other without one of them being
    identifiable as wrong.
    """
    model = _Model(pins, map_covariance, fixed=fixed)
    used = np.ones(len(pins), dtype=bool)
    while (wrong := model.wrong_pin(motion := model.search(used), used, names)) is not None:
        used[wrong] = False
    motion = model.solve(motion, used)
    p_value = np.full(len(pins), np.nan)
    squared, sizes, chi2 = model.test(motion, used)
    p_value[used] = np.where(sizes > 0, chdtrc(sizes, squared), np.nan)
    model.add_p_values_of_unused(motion, used, p_value)
    dof = sum(pin.size for pin, is_used in zip(pins, used, strict=True) if is_used) - (0 if fixed else 3)
    return Adjustment(motion, used, p_value, chi2, dof)


class _Model:
    """Differences of all pins, their covariances and Jacobians."""

    def __init__(self, pins: Sequence[PinnedValue], map_covariance: Floats, *, fixed: bool) -> None:
        self.pins, self.map_covariance, self.fixed = pins, map_covariance, fixed
        ends = np.cumsum([0, *(pin.size for pin in pins)])
        self.rows = [np.arange(begin, end) for begin, end in pairwise(ends.tolist())]

    def linearised(self, motion: se2.Pose, used: np.ndarray) -> tuple[Floats, Floats, Floats, Floats]:
        """Return differences, Jacobian, covariance and the centre of the used pins."""
        chosen = np.flatnonzero(used).tolist()
        rows = np.concatenate([self.rows[k] for k in chosen])
        points = np.array([se2.transform(motion, self.pins[k].point) for k in chosen])
        centre = np.asarray(points.mean(axis=0))
        covariance = self.map_covariance[np.ix_(rows, rows)].copy()
        start = 0
        for k in chosen:
            end = start + self.pins[k].size
            covariance[start:end, start:end] += self.pins[k].noise(motion)
            start = end
        differences = np.concatenate([self.pins[k].differences(motion) for k in chosen])
        jacobian = np.vstack([self.pins[k].jacobian(motion, centre) for k in chosen])
        return differences, jacobian, covariance, centre

    def solve(self, motion: se2.Pose, used: np.ndarray) -> se2.Pose:
        """Return the motion by generalised least squares, from a guess. Raises MapError if it is not determined."""
        if self.fixed:
            return motion
        for _ in range(MAX_ITERATIONS):
            differences, jacobian, covariance, centre = self.linearised(motion, used)
            weighted = np.linalg.solve(covariance, jacobian)
            information = jacobian.T @ weighted
            _check_determined(information)
            step = np.asarray(-np.linalg.solve(information, weighted.T @ differences), dtype=np.float64)
            motion = _moved(motion, step, centre)
            if np.abs(step).max() < CONVERGED:
                break
        return motion

    def wrong_pin(self, motion: se2.Pose, used: np.ndarray, names: Sequence[str]) -> int | None:
        """Return the used pin that is the most certain to be wrong; None if none is. Raises MapError as `adjust`."""
        squared, sizes, _ = self.test(motion, used)
        p_value = np.where(sizes > 0, chdtrc(sizes, squared), 1.0)
        worst = int(np.lexsort((-squared, p_value))[0])  # tiny probabilities are zero
        if p_value[worst] * len(self.pins) > ERROR_RATE:
            return None
        rivals = np.flatnonzero((squared > SEPARABLE * squared[worst]) & (sizes > 0))
        chosen = np.flatnonzero(used)
        if len(rivals) > 1:
            suspects = " or ".join(names[k] for k in chosen[rivals].tolist())
            raise MapError(f"the pins contradict each other or the map, and either {suspects} is wrong; pin more")
        return int(chosen[worst])

    def test(self, motion: se2.Pose, used: np.ndarray) -> tuple[Floats, Floats, float]:
        """Return T of each used pin with its degrees of freedom, zero if none checks it, and the sum for all."""
        differences, jacobian, covariance, _ = self.linearised(motion, used)
        inverse = np.linalg.inv(covariance)
        projector = inverse
        if not self.fixed:
            weighted = inverse @ jacobian
            _check_determined(jacobian.T @ weighted)
            projector = inverse - weighted @ np.linalg.solve(jacobian.T @ weighted, weighted.T)
        whitened = projector @ differences
        squared, sizes, start = [], [], 0
        for k in np.flatnonzero(used).tolist():
            part = slice(start, start + self.pins[k].size)
            own = projector[part, part]
            scale = 1.0 / np.sqrt(np.diag(inverse[part, part]))
            values, vectors = np.linalg.eigh(own * np.outer(scale, scale))
            seen = values > MIN_REDUNDANCY
            squared.append(float((((vectors.T @ (scale * whitened[part])) ** 2)[seen] / values[seen]).sum()))
            sizes.append(float(seen.sum()))
            start = part.stop
        return np.array(squared), np.array(sizes), float(differences @ whitened)

    def add_p_values_of_unused(self, motion: se2.Pose, used: np.ndarray, p_value: Floats) -> None:
        """Test each pin that is left out against all used ones."""
        for k in np.flatnonzero(~used).tolist():
            among = used.copy()
            among[k] = True
            squared, sizes, _ = self.test(motion, among)
            row = np.flatnonzero(among).tolist().index(k)
            p_value[k] = chdtrc(sizes[row], squared[row])

    def search(self, used: np.ndarray) -> se2.Pose:
        """Return the motion that most used pins agree with, of all motions that are defined by one or two pins."""
        if self.fixed:
            return np.zeros(3)
        pins = [pin for pin, is_used in zip(self.pins, used, strict=True) if is_used]
        candidates = [self._improved(motion, used) for motion in _candidates(pins)]
        return min(candidates, key=lambda motion: self._cost(motion, used))

    def _blocks(self, motion: se2.Pose, used: np.ndarray) -> Iterator[tuple[int, Floats, float]]:
        """Yield each used pin, the inverse of the covariance of its difference, and its robust weight."""
        for k in np.flatnonzero(used).tolist():
            own = self.map_covariance[np.ix_(self.rows[k], self.rows[k])] + self.pins[k].noise(motion)
            inverse = np.linalg.inv(own)
            difference = self.pins[k].differences(motion)
            yield k, inverse, 1.0 / (1.0 + float(difference @ inverse @ difference) / SEARCH_SCALE**2)

    def _cost(self, motion: se2.Pose, used: np.ndarray) -> float:
        return -sum(math.log(weight) for _, _, weight in self._blocks(motion, used))

    def _improved(self, motion: se2.Pose, used: np.ndarray) -> se2.Pose:
        """Return a motion after some robust steps, as far as it is determined."""
        for _ in range(SEARCH_STEPS):
            points = [se2.transform(motion, pin.point) for pin in self.pins]
            centre = np.asarray(np.mean(points, axis=0))
            information, gradient = np.zeros((3, 3)), np.zeros(3)
            for k, inverse, weight in self._blocks(motion, used):
                jacobian = self.pins[k].jacobian(motion, centre)
                information += weight * jacobian.T @ inverse @ jacobian
                gradient += weight * jacobian.T @ inverse @ self.pins[k].differences(motion)
            step = np.asarray(-np.linalg.lstsq(information, gradient, rcond=MIN_DETERMINED)[0], dtype=np.float64)
            motion = _moved(motion, step, centre)
            if np.abs(step).max() < CONVERGED:
                break
        return motion


def _candidates(pins: Sequence[PinnedValue]) -> list[se2.Pose]:
    """Return motions of the survey into the map: none, those that poses with headings state, and those of two poses."""
    poses = [pin for pin in pins if not pin.is_wall]
    found = [np.zeros(3)]
    for pin in poses:
        if pin.heading is not None:
            found.append(se2.compose(pin.estimate, se2.inverse(np.array([*pin.point, pin.heading[0]]))))
    pairs = sorted(combinations(poses, 2), key=lambda pair: -float(np.hypot(*(pair[1].point - pair[0].point))))
    for one, other in pairs[:MAX_PAIRS]:
        surveyed, mapped = other.point - one.point, other.estimate[:2] - one.estimate[:2]
        turn = math.atan2(mapped[1], mapped[0]) - math.atan2(surveyed[1], surveyed[0])
        frame = np.array([*one.estimate[:2], turn])
        found.append(se2.compose(frame, se2.inverse(np.array([*one.point, 0.0]))))
    return found


def _moved(motion: se2.Pose, step: Floats, centre: Floats) -> se2.Pose:
    """Return a motion followed by a turn about a centre (2,) and a shift."""
    turn = np.array([0.0, 0.0, step[2]])
    shift = np.array([*(centre + step[:2] - se2.transform(turn, centre)), step[2]])
    return se2.compose(shift, motion)


def _check_determined(information: Floats) -> None:
    """Raise MapError if the information (3, 3) of the motion is singular."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values = np.linalg.eigvalsh(information / np.outer(scale, scale))
    if not values[0] > MIN_DETERMINED * values[-1]:
        raise MapError(
            "the pins do not determine the place of the map: pin two poses, a pose with its heading, or three points "
            "on walls in two directions"
        )
