"""Calibrate the lidar's mount and the odometry's systematic errors from a drive.

The range bias is that of the map (see `range_bias`).

Each scan is registered against the map, so the lidar's motion M from one keyframe to the next is known independently of
the odometry. The base's motion B is that of the odometry with three corrections: for each small motion of length ds and
turn dth that odometry reports,

    ds' = length ds,    dth' = turning dth + veer ds,

with the factors of the same names in `slam.odometry.systematic_errors`.

The mount T relates the two, M = T^-1 B T. The six unknowns are estimated by robust least squares over all pairs of
consecutive keyframes. A mount with a large error degrades the registration, so the drive is mapped again with the
estimate.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import astuple, replace

import numpy as np
from scipy.optimize import least_squares

from drivers import se2
from drivers.immutable import immutable
from drivers.messages import GroundTruth, Message, Odometry, Scan, delay_odometry
from drivers.timing.mount_heading import mount_equations

from ...config import Config
from ...errors import MapError
from ...geometry.normal_distribution import NORMAL_SCALE
from ...geometry.segments import Floats
from ...pipeline import Slam
from .range_bias import range_bias_of

MOUNT_ITERATIONS = 3
"""Times that the drive is mapped; the third changes the estimate by less than its standard errors."""
MIN_PAIRS = 20
"""Pairs of keyframes, and odometry readings, for an estimate of six unknowns; fewer are no better than a ruler."""
MIN_TOTAL_TURN = 3.0
"""Radians turned in total; with less, x and y of the mount and the scale of turns are undetermined."""
KEYFRAME_SHARE = 0.5
"""Distance and turn between keyframes, as a share of those configured: a drive of some metres has enough pairs."""
ROBUST_SIGMAS = 3.0
"""Standard deviations from which on residuals are down-weighted: a scan may be registered wrongly, a wheel may slip."""


@immutable
class OdometryCorrection:
    """Correction of the odometry's systematic errors.

    length   true metres per metre of odometry
    turning  true radians per radian of odometry
    veer     radians turned to the left per metre of odometry that odometry does not report, since the wheels differ
    """

    length: float = 1.0
    turning: float = 1.0
    veer: float = 0.0

    def apply(self, poses: Floats) -> Floats:
        """Return the corrected odometry poses (n, 3), with the same first pose and unwrapped headings."""
        motion = se2.between(poses[:-1], poses[1:])
        chord_ratio = np.sinc(motion[:, 2] / (2 * np.pi))  # of an arc's chord to its length
        arc = np.copysign(np.hypot(motion[:, 0], motion[:, 1]), motion[:, 0]) / chord_ratio
        turn = self.turning * motion[:, 2] + self.veer * arc
        chord = self.length * arc * np.sinc(turn / (2 * np.pi))
        heading = poses[0, 2] + np.concatenate([[0.0], np.cumsum(turn)])
        steps = chord[:, None] * np.column_stack([np.cos(heading[:-1] + turn / 2), np.sin(heading[:-1] + turn / 2)])
        return np.column_stack([poses[0, :2] + np.vstack([np.zeros(2), np.cumsum(steps, axis=0)]), heading])


@immutable
class Calibration:
    """Result of a calibration.

    mount       (3,) [x, y, heading] of the lidar on the base
    odometry    correction of the odometry
    sigma       (6,) standard errors of x, y, heading, length, turning, veer
    pairs       number of pairs of keyframes used
    turned      radians turned in total
    range_bias  range bias and its standard error, metres
    """

    mount: se2.Pose
    odometry: OdometryCorrection
    sigma: Floats
    pairs: int
    turned: float
    range_bias: tuple[float, float]


def calibrate(messages: Iterable[Message], config: Config | None = None) -> Calibration:
    """Calibrate from a drive with turns in both directions, turns on the spot, and some metres straight ahead.

    The drive is mapped with the mount of the configuration, else with that of the scans; its heading may be any, as
    scans are matched also against the odometry. The delay of the lidar in the configuration is compensated. Raises
    MapError if there is no map or too little motion.
    """
    config = config or Config()
    delay, mapping = config.lidar.delay or 0.0, config.mapping
    drive = [delay_odometry(message, delay) for message in messages if not isinstance(message, GroundTruth)]
    dense = {
        "keyframe_distance": KEYFRAME_SHARE * mapping.keyframe_distance,
        "keyframe_turn": KEYFRAME_SHARE * mapping.keyframe_turn,
    }
    lidar = config.lidar.model_copy(update={"delay": None})
    config = config.model_copy(update={"lidar": lidar, "mapping": mapping.model_copy(update=dense)})
    mount = _initial_mount(drive, config)
    correction = OdometryCorrection()
    bias = config.lidar.range_bias
    for _ in range(MOUNT_ITERATIONS):
        lidar = config.lidar.model_copy(update={"mount": tuple(mount.tolist()), "range_bias": bias})
        result = _estimate(drive, config.model_copy(update={"lidar": lidar}), mount, correction)
        mount, correction, bias = result.mount, result.odometry, result.range_bias[0]
    return result


def _initial_mount(drive: Sequence[Message], config: Config) -> se2.Pose:
    of_scans = next((message.mount for message in drive if isinstance(message, Scan)), None)
    mount = config.lidar.mount if config.lidar.mount is not None else of_scans
    return np.zeros(3) if mount is None else np.array(mount, dtype=np.float64)


def _estimate(drive: Sequence[Message], config: Config, mount: se2.Pose, correction: OdometryCorrection) -> Calibration:
    """Run one round: map the drive with corrected odometry, then fit the six unknowns to the original odometry."""
    readings = [message for message in drive if isinstance(message, Odometry)]
    if len(readings) < MIN_PAIRS:
        raise MapError("odometry readings are too few to calibrate from")
    stamps, poses = np.array([r.stamp for r in readings]), np.array([r.pose for r in readings])
    slam = Slam(config)
    for message in _replace_odometry(drive, correction.apply(poses)):
        slam.add(message)
    finished = slam.finish()
    lidar = se2.compose(finished.keyframes.poses, mount)
    observed = se2.between(lidar[:-1], lidar[1:])
    if len(observed) < MIN_PAIRS:
        raise MapError("keyframes are too few to calibrate from; drive for longer")
    turned = float(np.abs(observed[:, 2]).sum())
    if turned < MIN_TOTAL_TURN:
        raise MapError(f"the robot turned by {turned:.1f} rad in total, which is too little; drive some curves")

    def residuals(unknowns: Floats) -> Floats:
        path = _interpolate(OdometryCorrection(*unknowns[3:]).apply(poses), stamps, finished.keyframes.stamps)
        at_lidar = se2.compose(path, unknowns[:3])
        difference = se2.between(observed, se2.between(at_lidar[:-1], at_lidar[1:]))
        difference[:, 2] = se2.wrap(difference[:, 2])
        return difference

    def scaled_residuals(unknowns: Floats, sigma: Floats) -> Floats:
        return np.asarray((residuals(unknowns) / sigma).ravel())

    path = _interpolate(correction.apply(poses), stamps, finished.keyframes.stamps)
    start = [*_closed_form_mount(se2.between(path[:-1], path[1:]), observed), *astuple(correction)]
    fit = least_squares(scaled_residuals, start, args=(np.ones(3),))
    noise = NORMAL_SCALE * np.median(np.abs(residuals(fit.x)), axis=0)
    fit = least_squares(scaled_residuals, fit.x, loss="soft_l1", f_scale=ROBUST_SIGMAS, args=(noise,))
    x, y, heading, *factors = fit.x.tolist()
    # SciPy weights the Jacobian as the robust loss requires, but not the residuals.
    weighted = fit.fun * (1.0 + (fit.fun / ROBUST_SIGMAS) ** 2) ** 0.25
    sigma = np.sqrt(np.diag(_covariance(fit.jac.reshape(-1, 3, 6), weighted.reshape(-1, 3))))
    mount = np.array([x, y, float(se2.wrap(heading))])
    return Calibration(mount, OdometryCorrection(*factors), sigma, len(observed), turned, range_bias_of(slam))


def _covariance(jacobians: Floats, residuals: Floats) -> Floats:
    """Return the covariance (6, 6) of the unknowns, of which consecutive pairs of keyframes are not independent.

    A keyframe's error is in two pairs, with opposite signs: it nearly cancels in a mean over a drive. So the covariance
    is that of Newey and West, whose weights keep it positive, with as many pairs as they recommend [1].

    jacobians  (n, 3, 6) of the residuals (n, 3), both weighted by the robust loss

    [1] W. K. Newey, K. D. West, Automatic lag selection in covariance matrix estimation, Rev. Econ. Stud. 61(4), 1994.
    """
    gradients = np.einsum("nip,ni->np", jacobians, residuals)
    lags = int(4.0 * (len(gradients) / 100.0) ** (2.0 / 9.0))
    spread = gradients.T @ gradients
    for lag in range(1, lags + 1):
        shared = gradients[:-lag].T @ gradients[lag:]
        spread += (1.0 - lag / (lags + 1.0)) * (shared + shared.T)
    inverse = np.linalg.inv(np.einsum("nip,niq->pq", jacobians, jacobians))
    return np.asarray(inverse @ spread @ inverse)


def _closed_form_mount(driven: Floats, observed: Floats) -> se2.Pose:
    """Return the mount that relates motions of the base (n, 3) and of the lidar (n, 3) best, whatever its heading."""
    (*position, cosine, sine), *_ = np.linalg.lstsq(mount_equations(driven, observed), driven[:, :2].T.ravel())
    return np.array([*position, np.arctan2(sine, cosine)])


def _replace_odometry(drive: Sequence[Message], poses: Floats) -> Iterator[Message]:
    """Yield the messages, with `poses` (n, 3) in the n odometry readings."""
    row = 0
    for message in drive:
        if isinstance(message, Odometry):
            yield replace(message, pose=np.append(poses[row, :2], se2.wrap(poses[row, 2])))
            row += 1
        else:
            yield message


def _interpolate(path: Floats, stamps: Floats, wanted: Floats) -> Floats:
    """Return (m, 3) a path (n, 3) with unwrapped headings at the stamps `wanted` (m,)."""
    return np.column_stack([np.interp(wanted, stamps, path[:, column]) for column in range(3)])
