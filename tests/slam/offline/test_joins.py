"""What is separated if a person forbids a closure that joined parts of a map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.recordings.mcap import McapWriter
from slam.errors import MapError
from slam.graph.factors import FactorKind
from slam.io.output_dir import TRAJECTORY
from slam.io.run_results import read_run_results
from slam.io.sessions import read_session
from slam.io.tum import read_tum
from slam.mapping.map_parts import MapParts
from slam.offline.corrections.joins import Separation, separation_of

from ..estimation.test_lost_robot import kidnapped, office

FIRSTS = [0, 10, 20, 30]
BETWEEN_KEYFRAMES = FactorKind.ODOMETRY, FactorKind.LOOP, FactorKind.SCAN_MATCH


def decision(number: int, old: int, keyframe: int, status: str = "accepted") -> dict[str, Any]:
    return {"candidate": number, "old": old, "keyframe": keyframe, "status": status}


def parts(*groups: int) -> MapParts:
    return MapParts(FIRSTS[: len(groups)], list(groups), [True] * len(groups))


def test_a_loop_within_a_part_or_between_joined_parts_is_no_join() -> None:
    decisions = [decision(1, 2, 8), decision(2, 3, 15), decision(3, 4, 18)]
    assert separation_of(parts(0, 0), decisions, 1) is None
    assert separation_of(parts(0, 0), decisions, 3) is None


def test_a_join_is_forbidden_with_the_loops_that_rest_on_it() -> None:
    decisions = [decision(1, 3, 15), decision(2, 4, 18), decision(3, 12, 19), decision(4, 5, 19, "rejected")]
    assert separation_of(parts(0, 0), decisions, 1) == Separation(1, 2, frozenset({2}))


def test_parts_that_are_joined_with_the_later_side_go_with_it() -> None:
    decisions = [decision(1, 3, 15), decision(2, 12, 25)]
    assert separation_of(parts(0, 0, 0), decisions, 1) == Separation(1, 3, frozenset())
    separated = parts(0, 0, 0)
    separated.separate(1)
    assert separated.groups == [0, 1, 1]


def test_parts_of_other_groups_stay_as_they_are() -> None:
    separated = parts(0, 0, 2, 0)
    separated.separate(1)
    assert separated.groups == [0, 1, 2, 1]


def test_a_later_part_that_is_joined_with_the_earlier_side_is_named() -> None:
    decisions = [decision(1, 3, 15), decision(2, 4, 25)]
    with pytest.raises(MapError, match="before loop 2"):
        separation_of(parts(0, 0, 0), decisions, 1)
    assert separation_of(parts(0, 0, 0), decisions, 2) == Separation(2, 3, frozenset())


def test_parts_that_merging_connected_cannot_be_separated() -> None:
    with pytest.raises(MapError, match="merged session"):
        separation_of(parts(0, 0, 0), [decision(1, 3, 15)], 1)


@pytest.mark.slow
def test_a_join_is_forbidden_and_closed_again(wclm: Any, tmp_path: Path) -> None:
    """A robot is carried while it drives; without the join, odometry alone places what it mapped afterwards.

    The drive ends after the robot has gone twice along the way from before it was carried.
    """
    with McapWriter(tmp_path / "drive.mcap") as writer:
        for message in kidnapped(office(230.0), 60.0, 75.0):
            writer.write(message)
    session = tmp_path / "out"
    assert wclm("run", tmp_path / "drive.mcap", "--out", session, "--no-review").exit_code == 0
    joined, path = read_run_results(session), read_tum(session / TRAJECTORY)
    result = wclm("correct", session, "--forbid-loop", 1)
    assert result.exit_code == 0, result.output
    assert "unconnected" in result.stdout
    mapper = read_session(session).slam_state.mapper
    first = mapper.landmarks.parts.firsts[1]
    assert mapper.landmarks.parts.apart == [1]
    observers: dict[int, set[bool]] = {}
    for keyframe, wall in mapper.graph.wall_observations():
        observers.setdefault(wall, set()).add(keyframe >= first)
    assert all(len(sides) == 1 for sides in observers.values())
    between = [f for f in mapper.graph.solver.sorted_factors() if f.kind in BETWEEN_KEYFRAMES]
    assert [f.kind for f in between if f.first < first <= f.second] == [FactorKind.ODOMETRY]
    assert mapper.covariances.relative(0, mapper.keyframe_count - 1)[0, 0] > 1.0
    assert "parts that no scan connects" in str(read_run_results(session).summary["slam"]["suspects"])
    assert wclm("correct", session, "--close", 1).exit_code == 0
    again = read_tum(session / TRAJECTORY)
    assert np.hypot(*(again.poses - path.poses)[:, :2].T).max() < 0.05
    assert abs(len(read_run_results(session).walls) - len(joined.walls)) < 5
