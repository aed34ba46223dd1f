"""Loops that displaced scans show at the end of a drive."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers import GroundTruth, Message, Scan, se2
from drivers.simulation import LIDAR_MODELS, WHEEL_MODELS, LidarModel, Simulation
from drivers.simulation.world import World
from slam import Slam
from slam.errors import MapError
from slam.estimation import displaced_loops, estimator
from slam.estimation.displaced_loops import REASON, are_apart

STRETCH = 0.99
"""Factor of the bearings that the lidar states: no covariance contains that turns are measured wrong by 1 %."""
BOXES = ((5.0, 0.4), (9.5, 1.6), (15.6, 5.0), (14.4, 8.0), (11.0, 11.6), (6.0, 10.4), (0.4, 8.0))
"""Middles of boxes in the corridor, metres: between them nothing shows how far the robot has driven."""


def block() -> World:
    """Return a corridor of 2 m around a block of 12 by 8 m, and a drive that ends 3.6 m before its beginning."""
    outlines = [rectangle((0.0, 0.0), (16.0, 12.0)), rectangle((2.0, 2.0), (14.0, 10.0))]
    boxes = [rectangle((x - 0.4, y - 0.4), (x + 0.4, y + 0.4)) for x, y in BOXES]
    waypoints = np.array([[2.0, 1.0], [15.0, 1.0], [15.0, 11.0], [1.0, 11.0], [1.0, 4.5]])
    return World("block", "block", np.concatenate([*outlines, *boxes]), np.zeros((0, 3)), waypoints, 0.5)


def rectangle(low: tuple[float, float], high: tuple[float, float]) -> np.ndarray:
    """Return the sides (4, 4) of a rectangle between two corners."""
    (left, bottom), (right, top) = low, high
    corners = np.array([[left, bottom], [right, bottom], [right, top], [left, top]])
    return np.hstack([corners, np.roll(corners, -1, axis=0)])


def drive(simulation: Simulation, stretch: float) -> Iterator[Message]:
    """Yield the messages of a drive, with all bearings multiplied by a factor."""
    for message in simulation:
        if isinstance(message, Scan):
            yield replace(message, angles=stretch * message.angles)
        elif not isinstance(message, GroundTruth):
            yield message


def mapped(simulation: Simulation, stretch: float = 1.0) -> Slam:
    slam = Slam()
    for message in drive(simulation, stretch):
        slam.add(message)
    slam.finish()
    return slam


def end_error(slam: Slam, simulation: Simulation) -> float:
    """Return the error (metres) of the last keyframe of a saved map, relative to the first one."""
    state = slam.session.slam_state
    truth = simulation.trajectory.poses_at(np.array(state.keyframe_stamps)[[0, -1]])
    error = se2.between(se2.between(*truth), se2.between(*state.mapper.keyframe_poses[[0, -1]]))
    return float(np.hypot(*error[:2]))


def closures(slam: Slam) -> list[dict[str, Any]]:
    """Return the rows of the loops that displaced scans have shown."""
    return [row for row in slam.session.loop_decisions if row["reason"] == REASON]


@pytest.mark.parametrize("seed", [1, 2])
def test_a_drive_that_ends_before_its_beginning_is_closed(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """No look finds the loop: the robot is farther from the places of the beginning than looks search."""
    simulation = Simulation(block(), seed=seed, lidar=LidarModel(beams=181, rate=4.0, range_max=8.0))
    slam = mapped(simulation, STRETCH)
    (row,) = closures(slam)
    assert row["status"] == "accepted"
    assert row["keyframe"] - row["old"] > 50
    monkeypatch.setattr(estimator, "close_displaced_loops", lambda *_: ())
    assert end_error(mapped(simulation, STRETCH), simulation) > 0.25
    assert end_error(slam, simulation) < 0.1


def test_a_place_is_not_taken_for_another_one_if_the_robot_may_be_farther_away() -> None:
    """With large errors of the wheels, the robot is 5 m from where the estimate has it, among equal rooms."""
    simulation = Simulation("square", 2, 145.0, lidar=LIDAR_MODELS["short"], wheels=WHEEL_MODELS["bad"])
    assert not closures(mapped(simulation))


def test_keyframes_after_the_last_compared_scan_belong_to_the_scans_before_it() -> None:
    """The scan of the last keyframe may be too near to the last compared one to be compared itself."""
    compared = np.arange(40.0)
    stamps = np.array([0.0, 10.0, 20.0, 39.0, 39.5])
    assert are_apart(stamps, compared, np.array([37, 38, 39])).tolist() == [True, True, True, False, False]
    assert are_apart(stamps, compared, np.array([0, 1, 2])).tolist() == [False, False, True, True, True]


def unsolvable(*_: object) -> None:
    raise MapError("the map cannot be estimated")


@pytest.mark.parametrize(
    ("function", "result"), [("map_gain", lambda *_: 0.0), ("displacement", lambda *_: 1.0), ("close_loop", unsolvable)]
)
def test_a_correction_is_discarded_if_the_map_is_not_better_or_cannot_be_solved(
    function: str, result: Callable[..., object], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also if the scans stay displaced."""
    simulation = Simulation(block(), seed=1, lidar=LidarModel(beams=181, rate=4.0, range_max=8.0))
    monkeypatch.setattr(displaced_loops, function, result)
    slam = mapped(simulation, STRETCH)
    assert not closures(slam)
    assert end_error(slam, simulation) > 0.25
