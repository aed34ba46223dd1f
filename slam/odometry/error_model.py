"""What wheel odometry gets wrong: always in the same way, which is taken out, and by chance, which is believed less."""

from __future__ import annotations

import math

import numpy as np

from drivers import se2

from ..config import OdometryConfig
from ..geometry.degeneracy import weakest_direction
from ..geometry.segments import Floats
from .history import wheel_travel

LEAST_WAY = 0.05  # metres: shorter motions say more of registration than of the wheels
WINDOW = 200  # motions
# Motions that the configured values count for, in the geometric mean: they may be wrong by a factor, and in an
# arithmetic one a start that is five times too large would still rule after a hundred motions.
START_COUNT = 10
LEAST_RATE = 1e-8  # of variance; no wheels err by less than a tenth of a millimetre or of a milliradian in a metre
HELD_SIGMA = 0.05  # metres: worse than this, what was seen does not tell how far odometry erred in a step
ADRIFT_SIGMA = 0.3  # metres: a direction in which what is seen holds the robot worse than this is left to odometry
# Metres of way over which the wheels' errors are the same: wheels larger than believed stay so. Where every step is
# seen to be right or wrong that does not matter; where many steps in a row are not, their errors add up (`adrift`).
ALIKE_WAY = 20.0
MEMORY = 500  # motions from which is learned what is common to all
MOST_WRONG = 2.0  # factor; wheels that turn the robot by more or less than that are not calibrated badly, but broken
STRAIGHT = math.radians(4.0)  # a motion that turns by less tells of length and veer, one that turns by more of turning
NORMAL_MEDIAN = 0.4549  # median of a squared standard normal variable
PLANE_MEDIAN = 1.3863  # of the sum of two


class OdometryModel:
    """How far wheel odometry strays, learned by comparing its motion between keyframes with what registration finds.

    What is common to all motions is taken out of them: wheels larger or smaller than believed make a motion longer by a
    factor, a track wider than believed turns by another, unequal wheels veer with the way. The rest is noise:
    translation errs in proportion to the way, heading as a random walk over it. Medians are deaf to single gross
    errors, which the kernel of the graph's odometry factors has to bear.
    """

    def __init__(self, config: OdometryConfig) -> None:
        self._config = config
        self._start = np.array([config.translation_error**2, config.rotation_walk**2])
        self._samples: Floats = np.zeros((0, 6))
        self._rates = self._start
        self._length = self._turning = 1.0
        self._veer = 0.0  # radians a metre

    @property
    def deviations(self) -> Floats:
        """(2,): standard deviations of translation after one metre of way (metres) and of heading (radians)."""
        return np.asarray(np.sqrt(self._rates))

    @property
    def systematic(self) -> Floats:
        """(3,): factors of length and of turning, and radians that are turned a metre besides what odometry says."""
        return np.array([self._length, self._turning, self._veer])

    @property
    def samples(self) -> Floats:
        """(n, 6) motions as they were claimed and found, on which the estimate rests; `add_samples` has them again."""
        return self._samples

    def add_samples(self, samples: Floats) -> None:
        """Go on from what another estimate rested on."""
        self._samples = np.concatenate([self._samples, samples])[-MEMORY:]
        self._estimate()

    def add_motion(self, claimed: se2.Pose, found: se2.Pose, held_by: Floats) -> None:
        """Take a motion [x, y, heading] as the odometry claims it, and as it was found to be.

        `held_by` (3, 3) is the information of what was seen at its end. Where that leaves a direction open, as along a
        bare corridor, what was found is what odometry had claimed, and says nothing of how far that is right.
        """
        if not self._config.learn or wheel_travel(claimed) < LEAST_WAY:
            return
        if weakest_direction(found, held_by, HELD_SIGMA) is None:
            self.add_samples(np.concatenate([claimed, found])[None])

    def _estimate(self) -> None:
        claimed, found = self._samples[:, :3], self._samples[:, 3:]
        ahead, turned = claimed[:, 0], claimed[:, 2]
        # Chosen by what was found: what is claimed is noisy, and of turns chosen by noise most are too large.
        turns = np.abs(found[:, 2]) > STRAIGHT
        straight = (np.abs(ahead) > LEAST_WAY) & ~turns
        self._length = 1.0 + _trusted(found[straight, 0] / ahead[straight] - 1.0)
        self._veer = _trusted(se2.wrap(found[straight, 2] - turned[straight]) / ahead[straight])
        by_wheels = se2.wrap(found[turns, 2] - self._veer * ahead[turns])
        self._turning = 1.0 / np.clip(1.0 + _trusted(turned[turns] / by_wheels - 1.0), 1 / MOST_WRONG, MOST_WRONG)
        claimed, found = claimed[-WINDOW:], found[-WINDOW:]
        error, travel = se2.between(self.correct(claimed), found), wheel_travel(claimed)
        squared = (
            (error[:, 0] ** 2 + error[:, 1] ** 2) / (PLANE_MEDIAN * travel**2),
            error[:, 2] ** 2 / NORMAL_MEDIAN / travel,
        )
        observed = np.maximum([np.median(some) if len(some) else LEAST_RATE for some in squared], LEAST_RATE)
        trust = len(claimed) / (len(claimed) + START_COUNT)
        self._rates = np.maximum(self._start, LEAST_RATE) ** (1 - trust) * observed**trust

    def correct(self, motion: se2.Pose) -> se2.Pose:
        """Motions (..., 3) as odometry claims them, without the errors that are common to all."""
        turn = self._turning * motion[..., 2] + self._veer * motion[..., 0]
        bend = 0.5 * (turn - motion[..., 2])  # the chord of an arc points half its turn ahead
        x, y = self._length * motion[..., 0], self._length * motion[..., 1]
        c, s = np.cos(bend), np.sin(bend)
        return np.stack([c * x - s * y, s * x + c * y, se2.wrap(turn)], axis=-1)

    def variances(self, travel: Floats) -> tuple[Floats, Floats]:
        """Variances (...,) of translation along each axis and of heading after `way` metres (...,)."""
        return self._rates[0] * travel**2, self._rates[1] * travel

    def covariance(self, motion: se2.Pose) -> Floats:
        """(3, 3) covariance of a motion [x, y, heading] between two readings, in the frame of its end."""
        travel = wheel_travel(motion)
        translation, rotation = self.variances(travel)
        translation += self._config.translation_floor**2
        rotation += self._config.rotation_floor**2
        return np.diag([translation, translation, rotation])

    def correlated_drift(self, motion: se2.Pose, held_by: Floats) -> Floats:
        """(2, 2): what a motion adds to the covariance of the position, in the frame of its end, by errors that it has
        in common with its neighbours.

        That is in the direction that what was seen at its end leaves open, given the information (3, 3) of that.
        """
        direction = weakest_direction(np.zeros(3), held_by, ADRIFT_SIGMA)
        if direction is None:
            return np.zeros((2, 2))
        along = np.array([math.cos(direction), math.sin(direction)])
        return np.asarray(self._rates[0] * wheel_travel(motion) * ALIKE_WAY * np.outer(along, along))


def fuse_motion(
    claimed: se2.Pose, covariance: Floats, found: se2.Pose, point_information: Floats
) -> tuple[se2.Pose, Floats]:
    """The motion between two keyframes, and its covariance (3, 3), from odometry and from points on no wall.

    Walls say nothing along a corridor; door jambs and clutter do, with `point_information` (3, 3). The motion that
    registration `found` rests on them there. Where they say nothing, the motion stays the odometry's.
    """
    fused: Floats = np.asarray(np.linalg.inv(np.linalg.inv(covariance) + point_information), dtype=np.float64)
    correction = found - claimed
    correction[2] = se2.wrap(correction[2])
    return claimed + fused @ point_information @ correction, fused


def _trusted(values: Floats) -> float:
    """The median of how far motions stray from none, as far as there are enough of them to believe it."""
    return float(np.median(values)) * len(values) / (len(values) + START_COUNT) if len(values) else 0.0
