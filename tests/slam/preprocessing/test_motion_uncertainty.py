"""Errors of the motion bend a scan, which its segments contain, and displace it, which the sweep covariance states."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from features import Noise
from slam.config import OdometryConfig
from slam.geometry.segments import CornerPoints, Segments
from slam.odometry.error_model import OdometryModel
from slam.odometry.history import wheel_travel
from slam.preprocessing.deskew import DeskewedScan
from slam.preprocessing.motion_uncertainty import add_motion_uncertainty, displaced
from slam.preprocessing.sweep_motion import SweepMotion
from slam.preprocessing.sweep_responses import _responses

BEAMS = 720
END = 0.05
"""Seconds from the middle of the sweep to either end."""
POSES = np.linspace(-END, END, BEAMS)[:, None] * [0.6, 0.0, 0.8]
SPEED_ERROR = 0.005
"""Standard deviation of the relative error of the speed by inexact stamps."""
MODEL = OdometryModel(OdometryConfig(translation_error=0.02, rotation_walk=0.01))
NOISE = Noise(0.01, 0.001)
MOUNT = np.array([0.2, -0.1, 0.3])
BEARINGS = np.linspace(-np.pi, np.pi, BEAMS, endpoint=False)
TIMES = np.linspace(-END, END, BEAMS)
SPEED = wheel_travel(POSES).max() / END
"""Metres of wheel travel per second."""
BREAKPOINTS = np.array([-0.06, -0.037, -0.02, 0.005, 0.03, 0.052])
"""Seconds from the middle of the sweep to readings of odometry."""
NO_CORNERS = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)))
DRAWS = 1500


def sweep(fitted: float) -> DeskewedScan:
    """Return a sweep whose reference is fitted within some seconds from its middle."""
    motion = SweepMotion(TIMES, POSES, SPEED_ERROR, BREAKPOINTS, SPEED * np.diff(BREAKPOINTS), fitted)
    return DeskewedScan(0.0, np.zeros(3), np.ones(BEAMS), BEARINGS, motion)


class Room:
    """Walls that each many successive beams hit: segments in the base's frame, their beams and the fits of lines.

    sigma  of offset (metres) and heading (radians) by the noise of the sensor
    """

    def __init__(self, random: np.random.Generator, ends: list[int], sigma: float) -> None:
        self.first, self.last = np.array(ends), np.array([*ends[1:], ends[0] + BEAMS]) - 1
        frames, half_lengths, self.points, self.gains = [], [], [], []
        for first, last in zip(self.first, self.last, strict=True):
            beams = np.arange(first, last + 1) % BEAMS
            toward = BEARINGS[beams[len(beams) // 2]] + random.uniform(-0.3, 0.3)
            ranges = random.uniform(1.0, 4.0) / np.cos(BEARINGS[beams] - toward)
            angles = MOUNT[2] + BEARINGS[beams]
            points = MOUNT[:2] + ranges[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
            heading = MOUNT[2] + toward + np.pi / 2
            middle = (points[0] + points[-1]) / 2
            along = (points - middle) @ [np.cos(heading), np.sin(heading)]
            across_ray, along_ray = np.cos(BEARINGS[beams] - toward), ranges * np.sin(BEARINGS[beams] - toward)
            weights = 1.0 / ((NOISE.sigma_range * across_ray) ** 2 + (NOISE.sigma_bearing * along_ray) ** 2)
            design = np.column_stack([np.ones(len(along)), along])
            self.gains.append(np.linalg.solve(design.T @ (weights[:, None] * design), design.T * weights))
            self.points.append((beams, points))
            frames.append([*middle, heading])
            half_lengths.append(np.ptp(along) / 2)
        self.last %= BEAMS
        covariance = np.tile(sigma**2 * np.eye(2), (len(ends), 1, 1))
        self.segments = Segments(np.array(frames), np.array(half_lengths), covariance)

    def claimed(self, fitted: float, corners: CornerPoints = NO_CORNERS) -> tuple[Segments, CornerPoints, np.ndarray]:
        """Return segments and corners with the uncertainty of the motion, and the sweep covariance (3, 3)."""
        lines = SimpleNamespace(first=self.first, last=self.last)
        return add_motion_uncertainty(self.segments, corners, lines, sweep(fitted), MODEL, NOISE, MOUNT)  # type: ignore[arg-type]

    def measured(self, motions: np.ndarray) -> np.ndarray:
        """Return (r, n, 2) offset and heading of the lines fitted to beams with errors (r, p, 3) of the pose."""
        result = []
        for (beams, points), gain, frame in zip(self.points, self.gains, self.segments.frame, strict=True):
            turned = motions[:, beams, 2:] * np.column_stack([-points[:, 1], points[:, 0]])
            distances = (motions[:, beams, :2] + turned) @ [-np.sin(frame[2]), np.cos(frame[2])]
            result.append(distances @ gain.T)
        return np.stack(result, axis=1)


FULL_TURN = [0, 40, 100, 190, 270, 330, 420, 480, 560, 620, 690]
FIT = pytest.mark.parametrize(
    "fitted", [0.0, 0.0125, END], ids=["not fitted", "over a quarter", "over the whole sweep"]
)


SIGMAS = pytest.mark.parametrize(
    "sigma",
    [
        pytest.param(1e-4, id="motion dominates", marks=pytest.mark.slow),
        pytest.param(2e-3, id="both"),
        pytest.param(0.02, id="sensor dominates", marks=pytest.mark.slow),
    ],
)


@SIGMAS
@FIT
def test_segments_contain_how_the_motion_bends_the_scan_and_the_pose_how_it_displaces_it(
    sigma: float, fitted: float
) -> None:
    random = np.random.default_rng(1)
    room = Room(random, FULL_TURN, sigma)
    segments, _, of_sweep = room.claimed(fitted)
    errors = room.measured(motion_errors(random, fitted))
    displacements, left = displacements_of(segments, errors)
    nees = np.einsum("ni,ij,nj->n", displacements, np.linalg.inv(of_sweep), displacements).mean() / 3
    assert 0.85 < nees < 1.3  # bends of the room are left to the segments
    bends = segments.covariance - sigma**2 * np.eye(2)
    true = np.einsum("rni,rnj->nij", left, left) / DRAWS
    factors = np.linalg.norm(bends, axis=(1, 2)) / np.linalg.norm(true, axis=(1, 2))
    assert (factors > 0.7).all()
    assert 0.85 < np.exp(np.log(factors).mean()) < 1.3


@SIGMAS
@FIT
def test_the_pose_in_known_walls_has_the_covariance_of_independent_segments_and_of_the_sweep(
    sigma: float, fitted: float
) -> None:
    random = np.random.default_rng(2)
    room = Room(random, FULL_TURN, sigma)
    segments, _, of_sweep = room.claimed(fitted)
    measured = room.measured(motion_errors(random, fitted))
    measured += sigma * random.standard_normal(measured.shape)
    errors, _ = displacements_of(segments, measured)
    jacobians = pose_jacobians(segments)
    normal = np.einsum("nki,nkl,nlj->ij", jacobians, np.linalg.inv(segments.covariance), jacobians)
    claimed = np.linalg.inv(normal) + of_sweep
    nees = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(claimed), errors).mean() / 3
    assert 0.75 < nees < 1.15


def test_a_displacement_does_not_make_walls_uncertain() -> None:
    room = Room(np.random.default_rng(3), FULL_TURN, 1e-3)
    segments, _, of_sweep = room.claimed(0.0)
    total, _ = displaced(segments, NO_CORNERS, of_sweep)
    bends = np.linalg.det(segments.covariance - room.segments.covariance)
    assert (bends < 0.9 * np.linalg.det(total.covariance - room.segments.covariance)).all()


def test_a_single_wall_has_no_part_in_the_direction_that_it_does_not_determine() -> None:
    room = Room(np.random.default_rng(3), FULL_TURN, 1e-3)
    alone = room.first[:1], room.last[:1]
    room.first, room.last = alone
    frame = room.segments.frame[:1]
    room.segments = Segments(frame, room.segments.half_length[:1], room.segments.covariance[:1])
    along = np.array([np.cos(frame[0, 2]), np.sin(frame[0, 2])])
    of_position = room.claimed(0.01)[2][:2, :2]
    assert along @ of_position @ along < 1e-3 * np.trace(of_position)


def test_scans_of_one_wall_and_of_many_run_the_same_compiled_code() -> None:
    room = Room(np.random.default_rng(4), FULL_TURN, 1e-3)
    columns = np.column_stack([room.first, room.last])
    segments = room.segments
    for count in (1, len(columns)):
        lines = SimpleNamespace(first=columns[:count, 0], last=columns[:count, 1])
        some = Segments(segments.frame[:count], segments.half_length[:count], segments.covariance[:count])
        add_motion_uncertainty(some, NO_CORNERS, lines, sweep(0.0), MODEL, NOISE, MOUNT)  # type: ignore[arg-type]
    arguments = [one for types in _responses.signatures for one in types]
    arrays = [one for argument in arguments for one in getattr(argument, "types", [argument]) if hasattr(one, "layout")]
    assert arrays
    assert all(array.layout == "C" for array in arrays)


def test_a_corner_moves_with_its_walls() -> None:
    random = np.random.default_rng(3)
    room = Room(random, FULL_TURN, 1e-5)
    pair, frames = np.array([[1, 2]]), room.segments.frame[[1, 2]]
    across = np.column_stack([-np.sin(frames[:, 2]), np.cos(frames[:, 2])])
    along = np.column_stack([across[:, 1], -across[:, 0]])
    position = np.linalg.solve(across, np.sum(across * frames[:, :2], axis=1))
    corner = CornerPoints(position[None], np.zeros((1, 2, 2)), pair, np.zeros((1, 2)))
    segments, corners, _ = room.claimed(0.0, corner)
    places = np.sum(along * (position - frames[:, :2]), axis=1)
    lines = displacements_of(segments, room.measured(motion_errors(random, 0.0)))[1][:, [1, 2]]
    moves = np.linalg.solve(across, (lines[..., 0] + places * lines[..., 1]).T).T
    of_corner = np.einsum("ri,ij,rj->", moves, np.linalg.inv(corners.covariance[0]), moves) / (2 * DRAWS)
    of_lines = np.einsum("rni,nij,rnj->n", lines, np.linalg.inv(segments.covariance[[1, 2]]), lines) / (2 * DRAWS)
    assert of_corner == pytest.approx(of_lines.mean(), rel=0.15)


def test_a_displacement_moves_corners_with_the_scan() -> None:
    corners = CornerPoints(np.array([[2.0, 1.0]]), np.zeros((1, 2, 2)), np.zeros((1, 2), dtype=int), np.zeros((1, 2)))
    segments = Segments(np.array([[0.0, 3.0, 0.0]]), np.ones(1), np.zeros((1, 2, 2)))
    sweep = np.diag([0.01, 0.02, 0.001]) ** 2
    moved_segments, moved = displaced(segments, corners, sweep)
    np.testing.assert_allclose(np.diag(moved.covariance[0]), [1e-4 + 1e-6, 4e-4 + 4e-6])
    np.testing.assert_allclose(np.diag(moved_segments.covariance[0]), [4e-4, 1e-6])


def displacements_of(segments: Segments, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacements (r, 3) that fit the errors (r, n, 2) of segments best, and the errors left by them."""
    jacobians, weights = pose_jacobians(segments), np.linalg.inv(segments.covariance)
    normal = np.einsum("nki,nkl,nlj->ij", jacobians, weights, jacobians)
    found = np.linalg.solve(normal, np.einsum("nki,nkl,rnl->ir", jacobians, weights, errors)).T
    return found, errors - np.einsum("nki,ri->rnk", jacobians, found)


def pose_jacobians(segments: Segments) -> np.ndarray:
    """Return (n, 2, 3) the derivatives of offsets and headings by the pose."""
    across = np.column_stack([-np.sin(segments.frame[:, 2]), np.cos(segments.frame[:, 2])])
    lever = across[:, 1] * segments.frame[:, 0] - across[:, 0] * segments.frame[:, 1]
    zero = np.zeros(len(lever))
    return np.stack([np.column_stack([across, lever]), np.column_stack([zero, zero, zero + 1.0])], axis=1)


def motion_errors(random: np.random.Generator, fitted: float) -> np.ndarray:
    """Return (r, p, 3) errors of position and heading at beams.

    They are proportional to travel, of the speed, and a random walk of the readings. This one is relative to the middle
    of a parabola fitted within `fitted` seconds from the middle; if that is zero, to the middle itself.
    """
    translation, rotation = MODEL.variances(np.ones(()))
    steps = np.sqrt(rotation * SPEED * np.diff(BREAKPOINTS)) * random.standard_normal((DRAWS, len(BREAKPOINTS) - 1))
    there = np.column_stack([np.zeros(DRAWS), np.cumsum(steps, axis=1)])
    walks = np.array([np.interp(TIMES, BREAKPOINTS, walk) for walk in there])
    inside = np.abs(TIMES) <= fitted
    if fitted:
        middles = np.polyfit(TIMES[inside], walks[:, inside].T, 2)[-1]
    else:
        middles = np.array([np.interp(0.0, TIMES, walk) for walk in walks])
    positions = np.sqrt(translation) * random.standard_normal((DRAWS, 1, 2)) * SPEED * TIMES[:, None]
    of_speed = SPEED_ERROR * random.standard_normal((DRAWS, 1, 1)) * POSES
    return of_speed + np.concatenate([positions, (walks - middles[:, None])[..., None]], axis=2)
