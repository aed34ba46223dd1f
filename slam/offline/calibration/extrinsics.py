"""The lidar's mount and the wheels' errors, from a drive: what the scans say of the motion against what the wheels say.

What all ranges are too long by comes first, from the scans alone (see `range_bias`).

Each scan is registered against the map, so the lidar's motion M from one keyframe to the next is known without the
wheels. The base's motion B is what the wheels told, set right by three factors: for each small motion of length ds and
turn dth that they told,

    ds' = distance ds,    dth' = turn dth + pull ds.

The mount T takes one to the other, M = T^-1 B T. The six unknowns are estimated by least squares over all pairs of
keyframes. A mount that is far wrong spoils the registration, so the drive is mapped again with the estimate.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, Scan

from ...config import Config
from ...errors import MapError
from ...geometry.segments import Floats
from ...pipeline import Slam
from .range_bias import estimate_range_bias

ROUNDS = 3
"""Times that the drive is mapped; the third changes the estimate by less than its standard errors."""
FEWEST = 20
"""Pairs of keyframes for an estimate; six unknowns with fewer are no better than a ruler."""
LEAST_TURN = 3.0
"""Radians turned in all, without which x and y of the mount and the turn's factor are guesses."""
OUTLIER = 3.0
"""Standard deviations beyond which a residual counts less: a scan may be registered wrongly, a wheel may slip."""
NORMAL_MAD = 1.4826
"""Standard deviation of a normal distribution by its median absolute deviation."""


@dataclass(frozen=True, slots=True, eq=False)
class Wheels:
    """What is to be made of the motions that odometry tells.

    distance  true metres per metre told
    turn      true radians per radian told
    pull      radians turned per metre told, which odometry does not tell: the wheels differ
    """

    distance: float = 1.0
    turn: float = 1.0
    pull: float = 0.0

    def corrected(self, told: Floats) -> Floats:
        """The path (n, 3) that the told poses (n, 3) stand for, from the same start."""
        motion = se2.between(told[:-1], told[1:])
        straight = np.sinc(motion[:, 2] / (2 * np.pi))  # the chord of an arc by its length
        length = np.copysign(np.hypot(motion[:, 0], motion[:, 1]), motion[:, 0]) / straight
        turn = self.turn * motion[:, 2] + self.pull * length
        chord = self.distance * length * np.sinc(turn / (2 * np.pi))
        heading = told[0, 2] + np.concatenate([[0.0], np.cumsum(turn)])
        steps = chord[:, None] * np.column_stack([np.cos(heading[:-1] + turn / 2), np.sin(heading[:-1] + turn / 2)])
        return np.column_stack([told[0, :2] + np.vstack([np.zeros(2), np.cumsum(steps, axis=0)]), heading])


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """mount   [x, y, heading] of the lidar on the base
    wheels  see `Wheels`
    sigma   (6,) standard errors of x, y, heading, distance, turn, pull
    pairs   of keyframes that were used
    turned  radians turned in all
    range_bias  metres by which all ranges are too long, and its standard error
    """

    mount: se2.Pose
    wheels: Wheels
    sigma: Floats
    pairs: int
    turned: float
    range_bias: tuple[float, float] = (0.0, float("nan"))


def calibrate(messages: Iterable[Message], config: Config | None = None) -> Calibration:
    """Estimate from a drive; it should turn both ways, on the spot, too, and go straight for some metres.

    The mount of the configuration, else of the scans, is where the search begins; its heading should be right to 20
    degrees. Raises MapError where there is no map, or not enough motion.
    """
    drive = [message for message in messages if not isinstance(message, GroundTruth)]
    config = config or Config()
    mount = _first_mount(drive, config)
    wheels = Wheels()
    bias = estimate_range_bias(drive, config)
    for _ in range(ROUNDS):
        lidar = config.lidar.model_copy(update={"mount": tuple(mount.tolist()), "range_bias": bias[0]})
        result = _estimate(drive, config.model_copy(update={"lidar": lidar}), mount, wheels)
        mount, wheels = result.mount, result.wheels
    return replace(result, range_bias=bias)


def _first_mount(drive: Sequence[Message], config: Config) -> se2.Pose:
    stated = next((message.mount for message in drive if isinstance(message, Scan)), None)
    known = config.lidar.mount if config.lidar.mount is not None else stated
    return np.zeros(3) if known is None else np.array(known, dtype=np.float64)


def _estimate(drive: Sequence[Message], config: Config, mount: se2.Pose, wheels: Wheels) -> Calibration:
    """One round: map the drive with the odometry as it is believed to be, and compare with what was told."""
    told = [message for message in drive if isinstance(message, Odometry)]
    if len(told) < FEWEST:
        raise MapError(f"{len(told)} odometry readings are too few to calibrate anything")
    stamps, poses = np.array([reading.stamp for reading in told]), np.array([reading.pose for reading in told])
    slam = Slam(config)
    for message in _with_odometry(drive, wheels.corrected(poses)):
        slam.add(message)
    finished = slam.finish()
    lidar = se2.compose(finished.keyframes, mount)
    seen = se2.between(lidar[:-1], lidar[1:])
    if len(seen) < FEWEST:
        raise MapError(f"{len(seen)} pairs of keyframes are too few to calibrate anything; drive for longer")
    turned = float(np.abs(seen[:, 2]).sum())
    if turned < LEAST_TURN:
        raise MapError(f"the robot turned by {turned:.1f} rad in all, which is too little; drive some curves")

    def difference(unknown: Floats) -> Floats:
        path = _at(Wheels(*unknown[3:]).corrected(poses), stamps, finished.keyframe_stamps)
        at_lidar = se2.compose(path, unknown[:3])
        gap = se2.between(seen, se2.between(at_lidar[:-1], at_lidar[1:]))
        gap[:, 2] = se2.wrap(gap[:, 2])
        return gap

    def scaled(unknown: Floats, spread: Floats) -> Floats:
        return np.asarray((difference(unknown) / spread).ravel())

    fit = least_squares(scaled, [*mount, wheels.distance, wheels.turn, wheels.pull], args=(np.ones(3),))
    spread = NORMAL_MAD * np.median(np.abs(difference(fit.x)), axis=0)  # the noise is what is left
    fit = least_squares(scaled, fit.x, loss="soft_l1", f_scale=OUTLIER, args=(spread,))
    x, y, heading, *factors = fit.x.tolist()
    sigma = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)))
    return Calibration(np.array([x, y, float(se2.wrap(heading))]), Wheels(*factors), sigma, len(seen), turned)


def _with_odometry(drive: Sequence[Message], poses: Floats) -> Iterator[Message]:
    """The messages with other poses (n, 3) for their odometry readings."""
    row = 0
    for message in drive:
        if isinstance(message, Odometry):
            yield replace(message, pose=np.append(poses[row, :2], se2.wrap(poses[row, 2])))
            row += 1
        else:
            yield message


def _at(path: Floats, stamps: Floats, wanted: Floats) -> Floats:
    """A path (n, 3) with unwrapped headings, between its readings: (m, 3)."""
    return np.column_stack([np.interp(wanted, stamps, path[:, column]) for column in range(3)])
